"""A controller that is a Python function: sampled inputs, an output held in between.

The function stands in a file beside the scene, which only runs when it is trusted, or is handed
over in Python (``kc.simulate(scene, functions={"NAME": function})``).
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator, Mapping
from typing import Literal

from pydantic import Field

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Section, Time
from kc2spice.scene.model import FileName, Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Modelled, PartType, Sampled, Vector, register

Function = Callable[[float, Mapping[str, float]], float]
UNITS = {"um": 1e-6, "V": 1.0, "m/s": 1.0}


class ControllerKeys(Section):
    """``function(time, inputs) -> output``, called every ``period``, inputs and output in SI.

    ``output`` is a voltage [V] or a current [A] out of ``out``; it holds from ``delay`` after the
    sample on.
    """

    kind: Literal["python"] = "python"
    file: FileName | None = Field(None, description="Python file beside the scene; needs --trust")
    function: str = Field("control", pattern=r"^[A-Za-z_]\w{0,63}$")
    period: Time = Field(1e-5, gt=0)
    delay: Time = Field(0.0, ge=0)
    inputs: tuple[str, ...] = Field((), max_length=16, description="names of its input pins")
    units: dict[str, Literal["um", "V", "m/s"]] = Field(
        default_factory=dict, description="of an input pin; um unless told"
    )
    output: Literal["voltage", "current"] = "voltage"


class Controller(PartType):
    name = "controller"
    title = "controller that is a Python function, sampled"
    schema = ControllerKeys
    controls = True
    example = """
[controller]
part = "controller"
inputs = ["tip"]
period = "50 us"
pins = { tip = "beam.tip", out = "beam.anode" }

[beam]
part = "bimorph"
length = "30 mm"
width = "5 mm"
layers = [
  { material = "PZT-5A", thickness = "0.3 mm" },
  { material = "PZT-5A", thickness = "0.3 mm" },
]
wiring = "parallel"
"""

    def files(self, part: Part, scene: Scene) -> tuple[str, ...]:
        return () if part.keys.file is None else (part.keys.file,)

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        keys = part.keys
        inputs = (
            Terminal(name, keys.units.get(name, "um"), "-", required=True) for name in keys.inputs
        )
        ends = (Terminal("out", "V", "A", required=True), Terminal("ret", "V", "A", "gnd"))
        return (*inputs, *ends)

    def problems(self, part: Part, scene: Scene) -> Iterator[UsageError]:
        keys = part.keys
        if keys.delay >= keys.period:
            yield UsageError(
                "answers come after the next sample",
                where=f"{part.name}.delay",
                got=f"{keys.delay:g} s",
                expected=f"less than the period, {keys.period:g} s",
            )
        if scene.analysis.type != "transient":
            yield UsageError(
                "a function is asked in time",
                where=part.name,
                got=scene.analysis.type,
                expected="the analysis transient",
            )
        if not keys.inputs:
            yield UsageError(
                "sees nothing",
                where=f"{part.name}.inputs",
                got="no input",
                expected='names of its input pins, such as inputs = ["y"]',
            )

    def own_names(self, part: Part, scene: Scene) -> tuple[tuple[str, ...], ...]:
        return ((part.name.lower(), "held"),)

    def cards(self, part: Part, build: Build) -> tuple[str, ...]:
        out, ret = build.net(part, "out"), build.net(part, "ret")
        if part.keys.output == "voltage":
            return (f"V{part.name} {out} {ret} EXTERNAL",)
        held = build.own(part, part.name.lower(), "held")
        return (f"V{part.name} {held} 0 EXTERNAL", f"G{part.name} {ret} {out} {held} 0 1")

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        found = {}
        for name in part.keys.inputs:
            unit = part.keys.units.get(name, "um")
            node = build.net(part, name)
            si = {"um": "m"}.get(unit, unit)
            found[f"{part.name}.{name}"] = Vector(f"v({node})", UNITS[unit], si)
        return found

    def sampled(self, part: Part, build: Build) -> Sampled:
        """What the simulator calls."""
        keys = part.keys
        function = build.functions.get(part.name) or self._function(part, build)
        nodes = {name: build.net(part, name) for name in keys.inputs}
        factors = {name: UNITS[keys.units.get(name, "um")] for name in keys.inputs}

        def call(time: float, values: Mapping[str, float]) -> float:
            inputs = {name: factors[name] * values[node] for name, node in nodes.items()}
            return float(function(time, inputs))

        return Sampled(f"v{part.name}".lower(), keys.period, keys.delay, call)

    def _function(self, part: Part, build: Build) -> Function:
        keys = part.keys
        where = f"{part.name}.file"
        if keys.file is None:
            raise UsageError(
                "no function",
                where=where,
                expected="a Python file, or a function handed over",
                hint=f"kc.simulate(scene, functions={{'{part.name}': function}})",
            )
        if not build.trust:
            raise UsageError(
                "runs a Python file of the scene",
                where=where,
                got=keys.file,
                hint="read the file; if you trust every line of it, repeat with --trust",
            )
        path = build.scene.home / keys.file
        spec = importlib.util.spec_from_file_location(f"kc2spice_{part.name}", path)
        if spec is None or spec.loader is None or not path.is_file():
            raise UsageError("no such Python file", where=where, got=str(path))
        module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except Exception as error:
            raise UsageError("the file fails", where=where, got=repr(error)) from error
        found = getattr(module, keys.function, None)
        if not callable(found):
            raise UsageError(
                "the file has no such function", where=f"{part.name}.function", got=keys.function
            )
        return found

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        keys = part.keys
        detail = f"{keys.output} every {keys.period:g} s, held from {keys.delay:g} s later on"
        return Modelled(part.name, "Python function", detail)


register(Controller())
