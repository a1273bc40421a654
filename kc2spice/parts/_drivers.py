"""What all drivers share: electronics between a command and electrodes or coils.

Their checks ask the saved waveforms alone, so that a driver's netlist is held against its keys by
arithmetic that the netlist has no part in.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.waveforms import Waveforms, running
from kc2spice.netlist.circuit import Param
from kc2spice.parts._template import Level, TemplatePart
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import Build, Vector

SLACK = 1e-3  # of the span or the current: rails give by millivolts, saved points have reltol
LAG = 2e-3  # of the swing: saved points with trapezoids between them; up to 2e-4 was found
LINEAR = 0.98  # of slew rate and current up to which a stage is linear
MEANING = "the driver's netlist is not its keys: please report it"


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

    @abstractmethod
    def limits(
        self, part: Part, build: Build, time: np.ndarray, wave: Mapping[str, np.ndarray]
    ) -> Iterable[Check]:
        """What its output obeys by its keys: ``wave`` has ``i``, the current [A] out of the first
        terminal, and the voltages [V] of its pins over ``ref``."""

    def vectors(self, part: Part, build: Build) -> Mapping[str, Vector]:
        if build.scene.analysis.type != "transient":
            return {}
        found = potentials(part, build, ("command", *self.terminals))
        return found | {f"{part.name}.i": _through(part)}

    def checks(self, part: Part, build: Build, waves: Waveforms) -> Iterable[Check]:
        if "time" not in waves or f"{part.name}.i" not in waves:
            return ()
        still = np.zeros_like(waves["time"])  # a pin on ref
        pins = ("i", "command", *self.terminals)
        wave = {pin: waves.data.get(f"{part.name}.{pin}", still) for pin in pins}
        return self.limits(part, build, waves["time"], wave)

    def detail(self, part: Part, scene: Scene) -> str:
        given = (f"{key} {value:g}" for key, value in part.keys if value is not None)
        return f"{self.name}, " + ", ".join(given)

    def current(self, part: Part, pin: str, build: Build) -> Vector | None:
        return _through(part) if pin == self.terminals[0] else None


class CoilDriver(Driver):
    """A source of the current ``V(command) / 100 Ohm``, whose loop is made for the coils at its
    terminals."""

    terminals, fixed = ("drive", "ret"), ends("drive", "ret")

    def design(self, part: Part, build: Build) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        return self.for_load(part.keys, self.load(part, build))

    @abstractmethod
    def for_load(self, keys: Any, load: Load) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """Parameters and values of its template for these coils."""

    def current(self, part: Part, pin: str, build: Build) -> Vector | None:
        return None

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


def _through(part: Part) -> Vector:
    return Vector(f"@r.x{part.name.lower()}.rout[i]", 1.0, "A")


def _neighbour(part: Part, pin: str, scene: Scene, kind: str) -> Part | None:
    """The part of this kind that a pin is joined to."""
    joined = (scene.parts[name] for name, _ in scene.joined(part.name, pin))
    return next((other for other in joined if other.type.name == kind), None)


# --- what waveforms must obey -------------------------------------------------------------------


def check(
    name: str, what: str, value: float, limit: float, unit: str, advice: str = MEANING
) -> Check:
    """A check of a driver, which an edited deck may violate on purpose."""
    return Check(f"{name} {what}", value, limit, unit, advice, wiring=True)


def within(
    name: str,
    volts: np.ndarray,
    low: np.ndarray | float,
    high: np.ndarray | float,
    slack: float,
    advice: str = MEANING,
) -> Check:
    """``low <= volts <= high`` but for ``slack`` [V]."""
    beyond = float(np.maximum(volts - high, low - volts).max())
    return check(name, "within its rails", max(0.0, beyond), slack, "V beyond", advice)


def bounded(name: str, current: np.ndarray, limit: float) -> Check:
    """``|current| <= limit`` [A]."""
    most = float(np.abs(current).max(initial=0.0))
    return check(name, "within its current", most, (1 + SLACK) * limit, "A")


def slewing(
    name: str, time: np.ndarray, volts: np.ndarray, slew: float, slack: float, advice: str = MEANING
) -> Check:
    """``|volts(t2) - volts(t1)| <= slew (t2 - t1)`` for every two times, but for ``slack`` [V]."""
    most = 0.0
    for sign in (1.0, -1.0):
        ahead = sign * volts - slew * time
        most = max(most, float((ahead - np.minimum.accumulate(ahead)).max(initial=0.0)))
    return check(name, "within its slew rate", most, slack, "V ahead", advice)


def stage(
    name: str,
    time: np.ndarray,
    error: np.ndarray,
    volts: np.ndarray,
    current: np.ndarray,
    rails: tuple[float, float],
    slew: float,
    limit: float,
    gbw: float,
    feedback: float = 1.0,
) -> Iterator[Check]:
    """A power stage: ``d volts/dt = 2 pi gbw error`` between rails, with slew rate and current.

    ``error`` [V] is what stands between its inputs, ``volts`` and ``current`` are those of its
    output behind 0.1 Ohm; ``feedback`` is the share of the output that returns. It follows its
    command where the mean of ``error - (d volts/dt) / (2 pi gbw)`` over a time constant of the
    loop, as a voltage at the output, is nothing wherever it is linear.
    """
    (low, high), span, pace = rails, rails[1] - rails[0], 2 * np.pi * gbw
    inner = volts + 0.1 * current  # before the output resistance
    free = np.abs(current) < LINEAR * limit
    loaded = "its load drives it beyond its rails, where diodes of a real output would conduct"
    yield within(name, inner, low, high, SLACK * span, loaded)
    yield bounded(name, current, limit)
    yield slewing(name, time[free], inner[free], slew, LAG * span)
    linear = free & (inner < high - SLACK * span) & (inner > low + SLACK * span)
    linear &= np.abs(error) * pace < LINEAR * slew
    missing = running(error, time) - inner / pace
    breaks = np.r_[0, np.cumsum(~(linear[1:] & linear[:-1]))]  # the same within linear pieces
    last = np.searchsorted(time, time + 1 / (pace * feedback)).clip(max=time.size - 1)
    good = (last > np.arange(time.size)) & (breaks[last] == breaks)
    off = (missing[last] - missing)[good] / (time[last] - time)[good]
    lag = float(np.abs(off).max(initial=0.0)) / feedback
    swing = max(float(np.ptp(inner)), SLACK * span)
    yield check(name, "follows its command", lag / swing, LAG, "of its swing")


def relaxed(time: np.ndarray, towards: np.ndarray, constant: float) -> np.ndarray:
    """``x' = (towards - x) / constant`` from rest, by trapezoids."""
    found = np.empty_like(towards)
    found[0] = towards[0]
    share = np.diff(time) / (2 * constant)
    drive = share * (towards[1:] + towards[:-1])
    for k in range(share.size):
        found[k + 1] = ((1 - share[k]) * found[k] + drive[k]) / (1 + share[k])
    return found
