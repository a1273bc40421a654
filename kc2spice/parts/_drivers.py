"""What all drivers share: electronics between a command and electrodes or coils."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Section
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.magnetics.table import EMTable, inductances
from kc2spice.netlist.circuit import Param, Pin, Subcircuit, positive
from kc2spice.netlist.naming import self_contained
from kc2spice.netlist.render import render
from kc2spice.parts._opamp import Level, opamp_subcircuit
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Modelled, PartType, Vector
from kc2spice.spice.header import Header, parameter_list, part_header

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


def coil_load(table: EMTable, height: float) -> Load:
    """``L11 + L22 - 2 L12`` and both resistances, with the sphere at ``height`` [m]."""
    matrix = inductances(table, height)
    return Load(
        float(matrix[0, 0] + matrix[1, 1] - 2 * matrix[0, 1]), float(table.resistance.sum())
    )


AMPLIFIER = {
    "rail": "supply",
    "resistance": "between amplifier and chip",
    "bandwidth": "of the closed loop",
    "slew": "fastest change of the output",
    "current_limit": "largest output current",
}
# The operational amplifier that each driver contains.
_AMPLIFIERS: dict[str, Level] = {
    "amplifier": "slew", "charge": "slew", "linear": "slew", "pwm": "pole",
}  # fmt: skip
_UNITS = {
    "rail": "V", "resistance": "Ohm", "gate_resistance": "Ohm", "supply_resistance": "Ohm",
    "current_limit": "A", "reservoir": "F", "capacitance": "F", "sense": "F",
    "bandwidth": "Hz", "slew": "V/s",
}  # fmt: skip


def driver_part(
    header: Header,
    template: str,
    name: str,
    title: str,
    drive: Section,
    docs: dict[str, str],
    terminals: tuple[str, ...] = ("out",),
) -> Subcircuit:
    """A driver whose parameters are the keys of its scene section."""
    params = tuple(
        positive(key, getattr(drive, key), _UNITS[key], doc) for key, doc in docs.items()
    )
    return rendered_driver(header, template, name, title, params, terminals)


def rendered_driver(
    header: Header,
    template: str,
    name: str,
    title: str,
    params: tuple[Param, ...],
    terminals: tuple[str, ...],
    **values: object,
) -> Subcircuit:
    pins = (
        Pin("command", *_SIGNAL),
        *(Pin(terminal, *_VOLT) for terminal in terminals),
        Pin("ref", *_VOLT),
    )
    text = render(
        f"driver_{template}.j2",
        header=part_header(
            header, f"{name}: {title}", pins, params, rating=LIMITED, validity=VALIDITY
        ),
        name=name,
        pins=[pin.name for pin in pins],
        parameters=parameter_list(params),
        **values,
    )
    helpers = [opamp_subcircuit(header, level)] if (level := _AMPLIFIERS.get(template)) else []
    return self_contained(Subcircuit(name, pins, params, text), helpers)


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


class Driver(PartType):
    """From ``command`` to its terminals; the subcircuit's last resistor is ``Rout``."""

    terminals: tuple[str, ...] = ("out",)

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

    def pins(self, part: Part, scene: Scene) -> tuple[Terminal, ...]:
        ends = (Terminal(name, *_VOLT, required=True) for name in self.terminals)
        return (Terminal("command", *_SIGNAL), *ends, Terminal("ref", *_VOLT, "gnd"))

    def modelled(self, part: Part, scene: Scene) -> Modelled:
        values = ", ".join(f"{key} {value:g}" for key, value in part.keys)
        return Modelled(f"{part.name} ({self.name})", "circuit", values)

    def current(self, part: Part, pin: str, build: Build) -> Vector | None:
        if pin == self.terminals[0] and self.terminals[0] != "drive":
            return Vector(f"@r.x{part.name.lower()}.rout[i]", 1.0, "A")
        return None


class CoilDriver(Driver):
    terminals = ("drive", "ret")

    def links(self, part: Part, scene: Scene) -> Mapping[str, str]:
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
        height = control.keys.setpoint if control else 0.0
        return coil_load(build.model(coils), height)


def neighbour(part: Part, pin: str, scene: Scene, kind: str) -> Part | None:
    """The part of this kind that a pin is joined to."""
    for name, _ in scene.joined(part.name, pin):
        if scene.parts[name].type.name == kind:
            return scene.parts[name]
    return None
