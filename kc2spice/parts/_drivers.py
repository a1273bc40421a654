"""What all drivers share: electronics between a command and electrodes or coils."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Section
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.magnetics.table import EMTable, inductances
from kc2spice.netlist.circuit import Param, Subcircuit, positive
from kc2spice.netlist.transforms import self_contained
from kc2spice.parts._opamp import Level, opamp_subcircuit
from kc2spice.scene.judge import Check
from kc2spice.scene.keys import model_keys
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, PartType, Vector
from kc2spice.spice.header import Header
from kc2spice.spice.library import library

VALIDITY = "27 C, or what .options temp says of transistors; nothing heats up, ages or breaks"
LIMITED = (
    "voltage and current stay within its parameters; compare rms current and power with the data "
    "sheet of your devices"
)
CARRIER = 10.0  # V, peak of the modulator's triangle
_VOLT, _SIGNAL = ("V", "A"), ("V", "-")


@dataclass(frozen=True)
class Load:
    """What the coils are between ``drive`` and ``ret``: both in series, the lower one reversed."""

    inductance: float  # H
    resistance: float  # Ohm
    current: float = 1.0  # A, the largest that its controller asks for


def coil_load(table: EMTable, height: float, current: float) -> Load:
    """``L11 + L22 - 2 L12`` and both resistances, with the sphere at ``height`` [m]."""
    matrix = inductances(table, height)
    inductance = float(matrix[0, 0] + matrix[1, 1] - 2 * matrix[0, 1])
    return Load(inductance, float(table.resistance.sum()), current)


def parameters(keys: Section, *names: str) -> tuple[Param, ...]:
    """A driver's keys, or those with these ``names``, as parameters of its netlist."""
    return tuple(
        positive(key.name, getattr(keys, key.name), key.unit or "-", key.doc)
        for key in model_keys(type(keys))
        if not names or key.name in names
    )


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
    driven = (Terminal(name, *_VOLT, required=True) for name in terminals)
    return (Terminal("command", *_SIGNAL), *driven, Terminal("ref", *_VOLT, "gnd"))


class Driver(PartType):
    """From ``command`` to its terminals; the subcircuit's last resistor is ``Rout``.

    Its netlist is made from the template ``driver_CIRCUIT``, whose ``heading`` says what it is,
    with an operational amplifier of the level ``opamp``.
    """

    circuit: str
    heading: str
    opamp: Level | None = "slew"
    terminals: tuple[str, ...] = ("out",)
    fixed = ends("out")

    def library(self, part: Part, scene: Scene) -> str:
        return self.circuit if len(scene.of(self.name)) == 1 else part.name

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        name = build.libraries[part.name]
        return (self.subcircuit(header, name, parameters(part.keys)),)

    def subcircuit(
        self, header: Header, name: str, params: tuple[Param, ...], **values: Any
    ) -> Subcircuit:
        """Its netlist with the ``values`` that its template asks for."""
        words = {"rating": LIMITED, "validity": VALIDITY}
        template = f"driver_{self.circuit}"
        made = library(template, header, name, self.heading, self.fixed, params, **words, **values)
        helpers = [opamp_subcircuit(header, self.opamp)] if self.opamp else []
        return self_contained(made, helpers)

    @abstractmethod
    def limits(
        self, part: Part, build: Build, time: np.ndarray, wave: Mapping[str, np.ndarray]
    ) -> Iterable[Check]:
        """What its output obeys by its keys: ``wave`` has ``i``, the current [A] out of the first
        terminal, and the voltages [V] of its pins over ``ref``."""

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        if build.scene.analysis.type != "transient":
            return {}
        through = Vector(f"@r.x{part.name.lower()}.rout[i]", 1.0, "A")
        return potentials(part, build, ("command", *self.terminals)) | {f"{part.name}.i": through}

    def checks(self, part: Part, build: Build, waves: Waveforms) -> Iterable[Check]:
        if "time" not in waves or f"{part.name}.i" not in waves:
            return ()
        still = np.zeros_like(waves["time"])  # a pin on ref
        pins = ("i", "command", *self.terminals)
        wave = {pin: waves.data.get(f"{part.name}.{pin}", still) for pin in pins}
        return self.limits(part, build, waves["time"], wave)

    def detail(self, part: Part, scene: Scene) -> str:
        return f"{self.name}, " + ", ".join(f"{key} {value:g}" for key, value in part.keys)

    def current(self, part: Part, pin: str, build: Build) -> Vector | None:
        if pin == self.terminals[0] and self.terminals[0] != "drive":
            return Vector(f"@r.x{part.name.lower()}.rout[i]", 1.0, "A")
        return None


class CoilDriver(Driver):
    """A source of current, whose loop is made for the coils at its terminals."""

    terminals, fixed = ("drive", "ret"), ends("drive", "ret")

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        name = build.libraries[part.name]
        return (self.for_load(header, part.keys, self.load(part, build), name),)

    @abstractmethod
    def for_load(self, header: Header, keys: Any, load: Load, name: str) -> Subcircuit:
        """Coil current ``V(command) / 100 Ohm``."""

    def default_joins(self, part: Part, scene: Scene) -> Mapping[str, str]:
        control = scene.only("pid")
        return {} if control is None else {"command": f"{control.name}.command"}

    def load(self, part: Part, build: Build) -> Load:
        """What the coils at its terminals are, with the sphere at the set point."""
        coils = neighbour(part, "drive", build.scene, "ring_magnet_coils")
        if coils is None:
            raise UsageError(
                "drives no coils, whose inductance its current loop is made for",
                where=f"{part.name}.drive",
                expected="joined to a part of type ring_magnet_coils",
                hint="for a load of your own, put your driver's circuit into a netlist part",
            )
        control = neighbour(part, "command", build.scene, "pid")
        height, current = (
            (control.keys.setpoint, control.keys.current_limit) if control else (0.0, 1.0)
        )
        return coil_load(build.model(coils), height, float(current))


def neighbour(part: Part, pin: str, scene: Scene, kind: str) -> Part | None:
    """The part of this kind that a pin is joined to."""
    for name, _ in scene.joined(part.name, pin):
        if scene.parts[name].type.name == kind:
            return scene.parts[name]
    return None
