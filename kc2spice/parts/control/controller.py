"""The part ``controller``: a Python function that is called at equal intervals.

Between two calls, the output of the controller is constant. The function is defined in a Python
file in the folder of the scene. A run executes the Python file only with the option ``--trust``. A
Python program may pass the function instead: ``kc.run(scene, functions={"NAME": function})``. If
kc2spice repeats the run with other settings, the file is read again, and a passed function is
called again from time 0.
"""

from __future__ import annotations

import runpy
from collections.abc import Callable, Iterator, Mapping
from typing import Literal, cast

from pydantic import Field

from kc2spice.core.constitutive_laws import MissingEquations
from kc2spice.core.errors import UsageError
from kc2spice.core.key_actions import SetKey
from kc2spice.core.quantities import Section, Time
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.netlist.circuit import Element, Item
from kc2spice.scene.part_records import PartResult, SampledSource
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    BuiltScene,
    GovernedScene,
    JoinedScene,
    Part,
    PartType,
    Scene,
    Terminal,
    WiredScene,
)
from kc2spice.scene.settings import FileName

Function = Callable[[float, Mapping[str, float]], float]


class ControllerKeys(Section):
    """Keys of a sampled controller ``function(time, inputs) -> output`` in SI units.

    The function is called once per ``period``. ``output`` is a voltage [V], or a current [A] out of
    the pin ``out``. Each output value takes effect at a time ``delay`` after its sample.
    """

    kind: Literal["python"] = Field(
        "python", description="Kind of controller; the only kind is `python`, a Python function"
    )
    file: FileName | None = Field(
        None,
        description=(
            "Python file in the scene's folder that contains the controller's function; a "
            "run needs the option --trust"
        ),
    )
    function: str = Field(
        "control",
        pattern=r"^[A-Za-z_]\w{0,63}$",
        description="Name of the controller's function in the Python file",
    )
    period: Time = Field(1e-5, gt=0, description="Sampling period of the controller")
    delay: Time = Field(
        0.0,
        ge=0,
        description=(
            "Delay from each sample of the inputs to the change of the controller's output"
        ),
    )
    inputs: tuple[str, ...] = Field(
        (), max_length=16, description="Names of the controller's input pins"
    )
    units: dict[str, Literal["um", "V", "m/s"]] = Field(
        default_factory=dict, description="Unit of each input pin of the controller; by default um"
    )
    output: Literal["voltage", "current"] = Field(
        "voltage",
        description="Quantity at the output pin of the controller: a voltage or a current",
    )


class Controller(PartType[ControllerKeys]):
    """Part type ``controller``: sampled controller that is a Python function."""

    name = "controller"
    origin_of_pins = "The key `inputs` of a part lists the names of its input pins."
    title = "controller that is a Python function, sampled"
    schema = ControllerKeys
    source = "Python function"
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

    def pins(self, part: Part[ControllerKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        keys = part.keys
        inputs = (
            Terminal(name, keys.units.get(name, "um"), "-", required=True) for name in keys.inputs
        )
        ends = (Terminal("out", "V", "A", required=True), Terminal("ret", "V", "A", "gnd"))
        return (*inputs, *ends)

    def problems(self, part: Part[ControllerKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        keys = part.keys
        if keys.delay >= keys.period:
            yield part.wrong(
                "delay",
                "the delay is not shorter than the sampling period",
                got=f"{keys.delay:g} s",
                expected=f"less than the period, {keys.period:g} s",
            )
        if (kind := scene.analysis.type) != "transient":
            yield part.wrong(
                "",
                "a controller in Python needs a transient analysis",
                got=kind,
                expected='analysis.type = "transient"',
                hint='write  type = "transient"  and  stop = "10 ms"  below [analysis]',
            )
        if not keys.inputs:
            yield part.wrong(
                "inputs",
                "the controller has no inputs",
                got="no input",
                expected='names of its input pins, such as inputs = ["y"]',
                hint='add  inputs = ["y"]',
            )

    def cards(self, part: Part[ControllerKeys], build: BuiltScene) -> tuple[Item, ...]:
        """Return the cards of the part at the top level of the deck."""
        out, ret = build.get_net(part, "out"), build.get_net(part, "ret")
        if part.keys.output == "voltage":
            return (Element.from_words(f"V{part.name}", out, ret, "EXTERNAL"),)
        level = build.get_inner_name(part, part.name.lower(), "held")
        return (
            Element.from_words(f"V{part.name}", level, "0", "EXTERNAL"),
            Element.from_words(f"G{part.name}", ret, out, level, "0", "1"),
        )

    def list_inner_names(
        self, part: Part[ControllerKeys], scene: WiredScene
    ) -> Iterator[tuple[str, ...]]:
        """Yield the name of the inner node that represents the sampled output."""
        yield part.name.lower(), "held"

    def law(self, part: Part[ControllerKeys], build: BuiltScene) -> MissingEquations:
        """Return no law, but the reason why the part has no model equations."""
        return MissingEquations("its equations are a Python function")

    def vectors(self, part: Part[ControllerKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        return {
            f"{part.name}.{name}": build.get_pin_vector(part, name) for name in part.keys.inputs
        }

    def settable_quantities(
        self, part: Part[ControllerKeys], build: BuiltScene
    ) -> Mapping[str, SampledSource]:
        """Return the settable quantity ``out``: the source that the user's function sets."""
        keys = part.keys
        sources = {}
        for name in keys.inputs:
            sources[name] = build.get_net(part, name), build.get_pin_vector(part, name).factor

        def make_output_function() -> Callable[[float, Mapping[str, float]], float]:
            """Return a function of time and node voltages that calls the user's function."""
            function = build.functions.get(part.name) or self._load_function(part, build)

            def compute_output(time: float, values: Mapping[str, float]) -> float:
                """Return the output of the user's function for a time and node voltages."""
                inputs = {name: factor * values[net] for name, (net, factor) in sources.items()}
                return float(function(time, inputs))

            return compute_output

        return {
            "out": SampledSource(
                f"v{part.name}".lower(),
                keys.period,
                keys.delay,
                make_output_function(),
                make_output_function,
            )
        }

    def _load_function(self, part: Part[ControllerKeys], build: BuiltScene) -> Function:
        """Load the Python function of the controller from its file."""
        keys = part.keys
        if keys.file is None:
            raise part.wrong(
                "file",
                "the controller has neither a file nor a passed function",
                expected=(
                    f"file = \"NAME.py\", or kc.run(scene, functions={{'{part.name}': FUNCTION}})"
                ),
                hint=SetKey(
                    part.name, "file", '"NAME.py"', verb="add", end=", a file beside the scene"
                ),
            )
        if not build.trust:
            raise part.wrong(
                "file",
                "this scene runs a Python file, which needs --trust",
                got=keys.file,
                hint="read the file; if you trust every line of it, repeat with --trust",
            )
        path = build.scene.get_folder(part) / keys.file
        if not path.is_file():
            raise part.wrong(
                "file",
                "this file does not exist",
                got=str(path),
                hint=f"write the function {keys.function}(time, inputs) into this file",
            )
        try:
            result = runpy.run_path(str(path), run_name=f"kc2spice_{part.name}").get(keys.function)
        except Exception as error:
            raise part.wrong(
                "file",
                f"{keys.file} ends with an error",
                got=repr(error),
                hint=f"run  python {path}  and correct the file",
            ) from error
        if not callable(result):
            raise part.wrong(
                "function",
                f"{keys.file} defines no function of this name",
                got=keys.function,
                hint=f"write  def {keys.function}(time, inputs):  into {keys.file}",
            )
        return cast(Function, result)

    def notes(self, part: Part[ControllerKeys], scene: Scene) -> Iterator[str]:
        """Yield the assumptions of the model and the effects that it neglects."""
        keys = part.keys
        period, delay = format_quantity(keys.period, "s"), format_quantity(keys.delay, "s")
        yield (
            f"{keys.output} sampled every {period}; each value takes effect {delay} after its "
            "sample, and is held until the next value takes effect"
        )


register_part_type(Controller())
