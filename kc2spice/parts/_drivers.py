"""What all drivers share: electronics between a command and electrodes or coils."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Param
from kc2spice.parts._template import Level, TemplatePart
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Vector

SLACK = 1e-3  # of the span or the current: rails give by millivolts, saved points have reltol
OUTPUT = 0.1  # Ohm, of the amplifier in it
LOADED = "its load drives it beyond its rails, where diodes of a real output would conduct"


class Load(NamedTuple):
    """What the coils are between ``drive`` and ``ret``: both in series, the lower one reversed."""

    inductance: float  # H
    resistance: float  # Ohm
    current: float = 1.0  # A, the largest that its controller asks for


def potentials(part: Part, build: Build, pins: Iterable[str]) -> dict[str, Vector]:
    """Voltages ``PART.PIN`` of pins over ``ref``, or over node 0 where it has no such pin."""
    base = build.net(part, "ref") if (part.name, "ref") in build.scene.nets else "0"
    found = {}
    for pin in pins:
        net = build.net(part, pin)
        ends = "".join(f"{sign}v({n})" for sign, n in (("", net), ("-", base)) if n != "0")
        if ends and net != base:
            found[f"{part.name}.{pin}"] = Vector(ends, 1.0, "V")
    return found


def ends(*terminals: str) -> tuple[Terminal, ...]:
    """Pins of a driver: ``command``, what it drives and ``ref``."""
    driven = (Terminal(name, "V", "A", required=True) for name in terminals)
    return (Terminal("command", "V", "-"), *driven, Terminal("ref", "V", "A", "gnd"))


class Driver(TemplatePart):
    """From ``command`` to its terminals; the last resistor of its netlist is ``Rout``."""

    opamp: ClassVar[Level | None] = "slew"
    terminals: tuple[str, ...] = ("out",)
    fixed = ends("out")
    validity = "27 C, or what .options temp says of transistors; nothing heats up, ages or breaks"
    rating = (
        "voltage and current stay within its parameters; compare rms current and power with the "
        "data sheet of your devices"
    )

    def library(self, part: Part, scene: Scene) -> str:
        return self.template.removeprefix("driver_") if len(scene.of(self.name)) == 1 else part.name

    def rails(self, keys: Any) -> tuple[float, float] | None:
        """Between what [V] its output stays, None where its own diodes see to it."""
        return None

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        if build.scene.analysis.type != "transient":
            return {}
        found = potentials(part, build, ("command", *self.terminals))
        read = f"@r.x{part.name.lower()}.rout[i]"
        return found | {f"{part.name}.i": Vector(read, 1.0, "A", self.terminals[:1])}

    def checks(self, part: Part, build: Build, waves: Waveforms) -> Iterator[Check]:
        """Whether its load drives its output, behind all resistance, beyond its rails."""
        keys, name = part.keys, f"{part.name}.{self.terminals[0]}"
        rails, i = self.rails(keys), waves.data.get(f"{part.name}.i")
        if "time" in waves and rails and i is not None and name in waves:
            inner = waves[name] + (getattr(keys, "resistance", 0.0) + OUTPUT) * i
            yield within(part.name, inner, *rails, SLACK * (rails[1] - rails[0]), LOADED)

    def notes(self, part: Part, scene: Scene) -> Iterator[str]:
        given = (f"{key} {value:g}" for key, value in part.keys if value is not None)
        yield f"{self.name}, " + ", ".join(given)


class CoilDriver(Driver):
    """A source of the current ``V(command) / 100 Ohm``, whose loop is made for the coils at its
    terminals."""

    terminals, fixed = ("drive", "ret"), ends("drive", "ret")

    def design(self, part: Part, build: Build) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        return self.for_load(part.keys, self.load(part, build))

    @abstractmethod
    def for_load(self, keys: Any, load: Load) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """Parameters and values of its template for these coils."""

    def default_joins(self, part: Part, scene: Scene) -> Mapping[str, str]:
        control = scene.only("pid")
        return {} if control is None else {"command": f"{control.name}.command"}

    def load(self, part: Part, build: Build) -> Load:
        """What the coils at its terminals are, with the sphere at the set point."""
        coils = _neighbour(part, "drive", build.scene, "ring_magnet_coils")
        if coils is None:
            raise UsageError(
                "drives no coils, whose inductance its current loop is made for",
                where=f"{part.name}.drive",
                expected="joined to a part of type ring_magnet_coils",
                hint="for a load of your own, put your driver's circuit into a netlist part",
            )
        control = _neighbour(part, "command", build.scene, "pid")
        height, current = (
            (control.keys.setpoint, control.keys.current_limit) if control else (0.0, 1.0)
        )
        table = build.model(coils)
        series = np.array([1.0, -1.0])
        inductance = float(series @ table.coenergy.inductances(height) @ series)
        return Load(inductance, float(table.resistance.sum()), float(current))


def _neighbour(part: Part, pin: str, scene: Scene, kind: str) -> Part | None:
    """The part of this kind that a pin is joined to."""
    joined = (scene.parts[name] for name, _ in scene.joined(part.name, pin))
    return next((other for other in joined if other.type.name == kind), None)


def within(
    name: str, volts: np.ndarray, low: float, high: float, slack: float, advice: str
) -> Check:
    """``low <= volts <= high`` but for ``slack`` [V]; an edited deck may differ on purpose."""
    beyond = max(0.0, float(np.maximum(volts - high, low - volts).max()))
    return Check(f"{name} within its rails", beyond, slack, "V beyond", advice, wiring=True)
