"""Laws of parts: what each type of part says of itself to the independent integrator.

A law is plain data in SI with named, typed pins. It knows no scene and no netlist. A pin's kind
says which *across* quantity all pins of a net share and which *through* ones sum to zero there:

================  ===================  ==========================
kind              across               through
================  ===================  ==========================
``electrical``    voltage [V]          current into the part [A]
``displacement``  displacement [m]     force on the part [N]
``velocity``      velocity [m/s]       force on the part [N]
``rotation``      angle [rad]          torque on the part [N m]
``signal``        value                none; one pin of a net sets it
================  ===================  ==========================

Linear laws are stamped into matrices by the assembler (:mod:`kc2spice.reference.assemble`). Every
nonlinear or switched law is a :class:`Device`: smooth expressions within a *mode*, and guards whose
zeros end the mode.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Protocol

import numpy as np

from kc2spice.core.errors import UsageError

MECHANICAL = ("displacement", "velocity", "rotation")
KINDS = ("electrical", *MECHANICAL, "signal")
GROUND = "gnd"


@dataclass(frozen=True)
class Pin:
    """A named pin; one that is ``grounded`` lies on the reference where nothing else is joined."""

    name: str
    kind: str
    grounded: bool = False


class Law(Protocol):
    """What all laws have in common."""

    @property
    def name(self) -> str:
        """Name of the part."""
        ...

    @property
    def pins(self) -> tuple[Pin, ...]:
        """Pins in the order of the part."""
        ...


# --- waveforms ------------------------------------------------------------------------------------


class Waveform(Protocol):
    """A function of time that is smooth between its corners."""

    def value(self, t: Any) -> Any:
        """Value at one time or an array of them."""
        ...

    def rate(self, t: Any, within: float) -> Any:
        """Time derivative at ``t``, of the smooth piece that holds the time ``within``."""
        ...

    def corners(self, stop: float) -> np.ndarray:
        """Times up to ``stop`` where the derivative jumps."""
        ...


@dataclass(frozen=True)
class Line:
    """Straight lines through ``points`` ((t, value), ...), constant before and after.

    ``period`` > 0 repeats what lies between the first point and ``period`` later, ``count`` times.
    Raises UsageError unless times increase strictly (edges take time).
    """

    points: tuple[tuple[float, float], ...]
    period: float = 0.0
    count: int = 1

    def __post_init__(self) -> None:
        times = np.array([t for t, _ in self.points])
        if times.size == 0 or np.any(np.diff(times) <= 0.0):
            raise UsageError("times of a waveform must increase strictly", got=times.tolist())
        if self.count > 1 and times[-1] - times[0] >= self.period:
            raise UsageError("a pulse is longer than its period", got=self.period)

    @classmethod
    def constant(cls, value: float) -> Line:
        """The same value at all times."""
        return cls(((0.0, value),))

    @classmethod
    def pulse(
        cls, high: float, width: float, edge: float, start: float = 0.0, low: float = 0.0,
        period: float = 0.0, count: int = 1,
    ) -> Line:  # fmt: skip
        """A trapezium: rises within ``edge``, falls ``width`` after its start within ``edge``."""
        points = ((0.0, low), (edge, high), (width, high), (width + edge, low))
        if width <= edge:
            raise UsageError("the pulse is shorter than its edge", got=width, expected=f"> {edge}")
        return cls(tuple((start + t, v) for t, v in points), period, count)

    @cached_property
    def _knots(self) -> tuple[np.ndarray, np.ndarray]:
        base = np.array(self.points, dtype=float)
        shifts = self.period * np.arange(max(1, self.count))
        times = (base[:, 0] + shifts[:, None]).ravel()
        return times, np.tile(base[:, 1], shifts.size)

    def value(self, t: Any) -> Any:
        """Value at the times ``t``."""
        return np.interp(t, *self._knots)

    def rate(self, t: Any, within: float) -> Any:
        """Slope of the straight piece that holds ``within``, whatever ``t``."""
        times, values = self._knots
        k = int(np.searchsorted(times, within)) - 1
        inside = 0 <= k < times.size - 1
        slope = (values[k + 1] - values[k]) / (times[k + 1] - times[k]) if inside else 0.0
        return slope + 0.0 * np.asarray(t)

    def corners(self, stop: float) -> np.ndarray:
        """All points up to ``stop``."""
        times = self._knots[0]
        return times[(times > 0.0) & (times < stop)] if times.size > 1 else np.empty(0)


@dataclass(frozen=True)
class Recorded:
    """A smooth curve through ``values`` at ``times`` (n,) of cubics (Akima, J. ACM 17, 589, 1970).

    Every ``stride``-th sample is a corner: no step of an integrator is longer than what was sampled
    there, so that an event after a long rest is not stepped over.
    """

    times: np.ndarray
    values: np.ndarray
    stride: int = 16

    @cached_property
    def _curve(self) -> tuple[Any, Any]:
        from scipy.interpolate import Akima1DInterpolator

        curve = Akima1DInterpolator(self.times, self.values)
        return curve, curve.derivative()

    def value(self, t: Any) -> Any:
        """Value at the times ``t``, constant before and after the samples."""
        return self._curve[0](np.clip(t, self.times[0], self.times[-1]))

    def rate(self, t: Any, within: float) -> Any:
        """Slope at the times ``t``."""
        return self._curve[1](np.clip(t, self.times[0], self.times[-1]))

    def corners(self, stop: float) -> np.ndarray:
        """Every ``stride``-th sample up to ``stop``."""
        times = self.times[:: self.stride]
        return times[(times > 0.0) & (times < stop)]


@dataclass(frozen=True)
class Sine:
    """``offset + amplitude sin(2 pi frequency (t - start))`` from ``start`` on."""

    amplitude: float
    frequency: float
    start: float = 0.0
    offset: float = 0.0

    @property
    def pace(self) -> float:
        """Largest step that cannot miss what the wave makes a guard do [s]."""
        return 0.05 / self.frequency

    def value(self, t: Any) -> Any:
        """Value at the times ``t``."""
        s = np.maximum(np.asarray(t) - self.start, 0.0)
        return self.offset + self.amplitude * np.sin(2 * np.pi * self.frequency * s)

    def rate(self, t: Any, within: float) -> Any:
        """Derivative at ``t``; zero before ``start``."""
        w = 2 * np.pi * self.frequency
        on = float(within > self.start)
        return on * self.amplitude * w * np.cos(w * (np.asarray(t) - self.start))

    def corners(self, stop: float) -> np.ndarray:
        """The start."""
        return np.array([self.start]) if 0.0 < self.start < stop else np.empty(0)


# --- linear laws ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Port:
    """A port of a :class:`LinearBody`: one column of B, one row of C.

    Electrical: voltage in, charge out; ``ret`` names the pin of its return. Mechanical: force in,
    displacement out. ``acceleration``: acceleration of the base in [m/s^2] (a signal pin), reaction
    force out [N], seen in the wave ``NAME.PORT.reaction``.
    """

    name: str
    kind: str
    ret: str = ""


@dataclass(frozen=True)
class LinearBody:
    """``M x'' + E x' + K x = B in``, ``out = C x + D in``.

    ``M``, ``E``, ``K`` (n, n) or, for diagonal ones, (n,); ``B`` (n, p), ``C`` (p, n), ``D`` (p, p)
    or None.
    A port with ``D`` must be electrical or have an own positive compliance.
    """

    name: str
    M: np.ndarray
    E: np.ndarray
    K: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    ports: tuple[Port, ...]

    @property
    def pins(self) -> tuple[Pin, ...]:
        """One pin a port, and the returns."""
        found: list[Pin] = []
        for port in self.ports:
            kind = "signal" if port.kind == "acceleration" else port.kind
            found.append(Pin(port.name, kind))
            if port.ret and port.ret not in {p.name for p in found}:
                found.append(Pin(port.ret, kind, grounded=True))
        return tuple(found)


@dataclass(frozen=True)
class SignalBlock:
    """``E x' = A x + B u``, ``y = C x + D u`` from signals to signals."""

    name: str
    E: np.ndarray
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @property
    def pins(self) -> tuple[Pin, ...]:
        """Inputs, then outputs."""
        return tuple(Pin(n, "signal") for n in (*self.inputs, *self.outputs))


@dataclass(frozen=True)
class Mass:
    """A rigid mass [kg] on pin ``a``, or a moment of inertia on a rotation net.

    ``position`` and ``velocity`` start it there; None starts it where the rest of the system holds
    it in equilibrium. ``gravity`` [m/s^2] pulls towards smaller displacements. ``offset`` is added
    to the displacement in the wave ``NAME.y``.
    """

    name: str
    mass: float
    gravity: float = 0.0
    position: float | None = None
    velocity: float = 0.0
    offset: float = 0.0
    kind: str = "displacement"

    @property
    def pins(self) -> tuple[Pin, ...]:
        """The one pin ``a``."""
        return (Pin("a", self.kind),)


@dataclass(frozen=True)
class Spring:
    """Force ``stiffness (u_a - u_b - free)`` pulls ``a`` and ``b`` together [N/m]."""

    name: str
    stiffness: float
    free: float = 0.0
    kind: str = "displacement"

    @property
    def pins(self) -> tuple[Pin, ...]:
        """``a``, and ``b``, which lies on the base by default."""
        return (Pin("a", self.kind), Pin("b", self.kind, grounded=True))


@dataclass(frozen=True)
class Damper:
    """Force ``damping d(u_a - u_b)/dt`` between ``a`` and ``b`` [N s/m]."""

    name: str
    damping: float
    kind: str = "displacement"

    @property
    def pins(self) -> tuple[Pin, ...]:
        """``a``, and ``b``, which lies on the base by default."""
        return (Pin("a", self.kind), Pin("b", self.kind, grounded=True))


@dataclass(frozen=True)
class _TwoPole:
    name: str

    @property
    def pins(self) -> tuple[Pin, ...]:
        """``a``, and ``b``, which is grounded by default."""
        return (Pin("a", "electrical"), Pin("b", "electrical", grounded=True))


@dataclass(frozen=True)
class Resistor(_TwoPole):
    """``i = v / resistance`` [Ohm]."""

    resistance: float


@dataclass(frozen=True)
class Capacitor(_TwoPole):
    """``i = capacitance dv/dt`` [F]; ``voltage`` at the start, None for that in equilibrium."""

    capacitance: float
    voltage: float | None = None


@dataclass(frozen=True)
class Inductor(_TwoPole):
    """``v = inductance di/dt`` [H]; ``current`` at the start, None for that in equilibrium."""

    inductance: float
    current: float | None = None


@dataclass(frozen=True)
class Source:
    """A prescribed quantity between ``out`` and ``ret``.

    ``kind``: ``voltage`` [V], ``current`` [A] out of ``out``, ``force`` [N] on what is joined to
    ``out``, ``displacement`` [m], ``acceleration``
    [m/s^2] (a signal pin), ``signal``. ``ac`` is the complex amplitude of an ac analysis.
    """

    name: str
    kind: str
    wave: Waveform
    ac: complex = 0.0
    pin_kind: str = ""

    @property
    def pins(self) -> tuple[Pin, ...]:
        """``out``, and ``ret``, which is grounded by default."""
        kinds = {"voltage": "electrical", "current": "electrical", "signal": "signal"} | {
            "acceleration": "signal"
        }
        kind = self.pin_kind or kinds.get(self.kind, "displacement")
        out = Pin("out", kind)
        return (out,) if kind == "signal" else (out, Pin("ret", kind, grounded=True))


@dataclass(frozen=True)
class Sensor:
    """Signal ``out = gain (across(a) - across(b)) + offset``, with a pole at ``bandwidth`` [Hz]."""

    name: str
    gain: float = 1.0
    offset: float = 0.0
    bandwidth: float = np.inf
    kind: str = "displacement"

    @property
    def pins(self) -> tuple[Pin, ...]:
        """``a``, ``b`` (grounded by default) and the signal ``out``."""
        return (Pin("a", self.kind), Pin("b", self.kind, grounded=True), Pin("out", "signal"))


# --- devices --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Tap:
    """An input of a device: across of ``pin`` less those of ``minus`` and ``less``, or its rate."""

    pin: str
    minus: str = ""
    rate: bool = False
    less: str = ""


@dataclass(frozen=True)
class Flow:
    """An output of a device: a through quantity into it at ``pin``, out of it at ``minus``, and as
    much at ``less``."""

    pin: str
    minus: str = ""
    less: str = ""


class Device(ABC):
    """A nonlinear or switched law; subclasses are frozen dataclasses with a ``name``.

    With the taps and then the own states as its inputs ``e`` (m,), in a mode that is any value::

        out = [through of every flow, rate of every state's store, value of every signal it drives]
        d/dt store(e) = rate,   store(e) = the states themselves unless said otherwise

    A mode lasts while every guard is positive.
    """

    name: str

    @property
    @abstractmethod
    def pins(self) -> tuple[Pin, ...]:
        """All pins."""

    @property
    @abstractmethod
    def taps(self) -> tuple[Tap, ...]:
        """What it sees."""

    @property
    def flows(self) -> tuple[Flow, ...]:
        """What it exerts."""
        return ()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of its own states."""
        return ()

    @property
    def drives(self) -> tuple[str, ...]:
        """Signal pins that it sets."""
        return ()

    @property
    def scales(self) -> tuple[float, ...]:
        """Sizes of the states that errors are judged by."""
        return (1.0,) * len(self.states)

    @property
    def affine(self) -> bool:
        """Whether ``evaluate`` is affine in ``e`` and constant in time within a mode."""
        return False

    def initial(self, taps: np.ndarray) -> np.ndarray | None:
        """States at the start (len(states),), given the taps then; None: those in equilibrium."""
        return None

    @abstractmethod
    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """``out`` (k,) and its derivative (k, m) by ``e``."""

    def store(self, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Stored quantities (len(states),) and their derivative (len(states), m) by ``e``."""
        k, m = len(self.states), len(e)
        return e[m - k :], np.eye(k, m, m - k)

    def mode(self, t: float, e: np.ndarray, before: Any = None) -> Any:
        """Mode at ``t``: the first one, or after one of its own corners or a switched guard."""
        return None

    def corners(self, stop: float) -> np.ndarray:
        """Times at which the mode is asked for anew."""
        return np.empty(0)

    def guards(self, t: float, e: np.ndarray, mode: Any) -> np.ndarray:
        """(g,) values that are positive within the mode."""
        return np.empty(0)

    def switch(self, mode: Any, guard: int) -> tuple[Any, str]:
        """Mode after ``guard`` fell to zero, and the words of the event ('' keeps it quiet)."""
        return mode, ""

    def check(self, t: float, e: np.ndarray) -> None:  # noqa: B027 (most laws hold anywhere)
        """Raise SimulationError where the inputs leave the law's range."""

    def energy(self, e: np.ndarray, mode: Any) -> float:
        """Energy stored [J]."""
        return 0.0

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """Power that it turns into heat [W]; negative for what it brings in from outside."""
        return 0.0

    def stores(self, first: np.ndarray, last: np.ndarray, mode: Any) -> float | None:
        """Energy [J] that is stored between two instants of a mode where :meth:`loss` is all power
        that comes in; None where it is that of heat."""
        return None

    @property
    def extra(self) -> tuple[str, ...]:
        """Names of further quantities to record as ``NAME.EXTRA``."""
        return ()

    def waves(self, t: float, e: np.ndarray, mode: Any) -> dict[str, float]:
        """Their values."""
        return {}


@dataclass(frozen=True)
class Contact(Device):
    """One-sided springs from the pins ``ports`` against the pin ``b``, and dry friction.

    ``F_i = stiffness_i pen_i^power max(0, 1 + damping pen_i')``, ``pen_i = u_i - u_b - gap_i > 0``
    (Hunt and Crossley 1975; ``damping`` in s/m). ``stiffness`` (n,) [N/m^power], ``gaps`` (n,) [m].
    Surfaces that part faster than ``1 / damping`` do not pull: the dent is left behind.

    With ``friction`` a force of at most ``friction sum F_i`` (Coulomb) acts against the sliding of
    the pin ``slide`` over ``rail``: ``sum F_i friction clip(v / creep, -1, 1)`` at the speed v;
    below the speed ``creep`` [m/s] it is viscous, which stands for sticking.

    ``curve`` multiplies the force by ``sum_k curve_k sqrt(pen / depth)^k``. Of surfaces that follow
    within ``pace`` [s] all of this is said of ``pen + pace pen'`` instead of ``pen``.

    The surface of ``b`` may carry another pin, whose displacement adds to its own and on which the
    forces act as well.
    """

    name: str
    ports: tuple[str, ...]
    stiffness: np.ndarray
    gaps: np.ndarray
    damping: float = 0.0
    power: float = 1.0
    friction: float = 0.0
    creep: float = 1e-4
    curve: tuple[float, ...] = (1.0,)
    depth: float = 1.0
    pace: float = 0.0
    carried: str = ""
    kind: str = "displacement"

    @property
    def pins(self) -> tuple[Pin, ...]:
        """The ports, what ``b`` carries, ``b``, and with friction ``slide`` and ``rail``."""
        own = tuple(Pin(p, self.kind) for p in (*self.ports, self.carried) if p)
        along = (Pin("slide", self.kind), Pin("rail", self.kind, grounded=True))
        return (*own, Pin("b", self.kind, grounded=True), *(along if self.friction else ()))

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Approach of every pair, their rates where there is damping, the speed of sliding."""
        near = tuple(Tap(p, "b", less=self.carried) for p in self.ports)
        rates = tuple(Tap(p, "b", rate=True, less=self.carried) for p in self.ports if self._rated)
        return near + rates + ((Tap("slide", "rail", rate=True),) if self.friction else ())

    @property
    def _rated(self) -> bool:
        return bool(self.damping or self.pace)

    @property
    def flows(self) -> tuple[Flow, ...]:
        """A force per pair, and the friction."""
        along = (Flow("slide", "rail"),) if self.friction else ()
        return (*(Flow(p, "b", self.carried) for p in self.ports), *along)

    @property
    def affine(self) -> bool:
        """A linear spring without damping or friction."""
        plain = self.power == 1.0 and len(self.curve) == 1
        return plain and not self._rated and not self.friction

    def _penetration(self, e: np.ndarray) -> np.ndarray:
        n = len(self.ports)
        return e[:n] - self.gaps + (self.pace * e[n : 2 * n] if self.pace else 0.0)

    def _factor(self, e: np.ndarray) -> np.ndarray:
        """``1 + damping pen'`` (n,)."""
        n = len(self.ports)
        return 1.0 + self.damping * e[n : 2 * n] if self.damping else np.ones(n)

    def mode(self, t: float, e: np.ndarray, before: Any = None) -> tuple[int, ...]:
        """Of each pair: 0 open, 1 pressing, 2 parting faster than the dent comes back; then the
        direction of sliding, 0 below ``creep``."""
        state = np.where(self._penetration(e) > 0.0, np.where(self._factor(e) > 0.0, 1, 2), 0)
        slides = int(np.sign(e[-1])) * int(abs(e[-1]) > self.creep) if self.friction else 0
        return (*state.tolist(), slides)

    def guards(self, t: float, e: np.ndarray, mode: Any) -> np.ndarray:
        """A closed pair can open, press or not; sliding can begin to either side, or end."""
        state = np.array(mode[:-1])
        edge = np.where(state > 0, 1.0, -1.0) * self._penetration(e)
        pull = np.where(state == 2, -1.0, 1.0) * np.where(state == 0, 1.0, self._factor(e))
        found = [edge, pull] if self.damping else [edge]
        if self.friction:
            slides = mode[-1]
            found.append(np.array(_inside(float(e[-1]), -self.creep, self.creep, slides)))
        return np.concatenate(found)

    def switch(self, mode: Any, guard: int) -> tuple[Any, str]:
        """One pair opens, closes or lets go; sliding begins or ends."""
        n = len(self.ports)
        first = 2 * n if self.damping else n
        if guard >= first:
            slides = 0 if mode[-1] else 2 * (guard - first) - 1
            return (*mode[:-1], slides), f"slide {'begins' if slides else 'ends'}"
        k, state = guard % n, mode[guard % n]
        now = (1 if state == 0 else 0) if guard < n else 3 - state
        said = "opens" if now == 0 else "closes" if state == 0 else ""
        return (*mode[:k], now, *mode[k + 1 :]), f"{self.ports[k]} {said}" if said else ""

    def _elastic(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Undamped forces (n,) of the closed pairs, and their slopes."""
        closed, pen = np.array(mode[:-1]) > 0, self._penetration(e)
        if self.power == 1.0 and len(self.curve) == 1:
            return self.stiffness * pen * closed, self.stiffness * closed
        return self._static(np.maximum(pen, 0.0) * closed)

    def _static(self, deep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forces (n,) at rest, this ``deep`` (n,) [m], and their slopes."""
        s, power = np.sqrt(deep / self.depth), self.power + np.arange(len(self.curve)) / 2
        value, slope = (np.polynomial.polynomial.polyval(s, c) for c in (
            self.curve, power * self.curve,
        ))  # fmt: skip
        return (
            self.stiffness * deep**self.power * value,
            self.stiffness * deep ** (self.power - 1.0) * slope,
        )

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Forces of the pairs, and the friction."""
        press = np.array(mode[:-1]) == 1
        elastic, slope = self._elastic(e, mode)
        factor = self._factor(e) * press
        force, parts = elastic * factor, [np.diag(slope * factor)]
        if self._rated:
            parts.append(np.diag(elastic * self.damping * press + slope * factor * self.pace))
        by_taps = np.hstack(parts)
        if not self.friction:
            return force, by_taps
        slides = mode[-1]
        drag = self.friction * (float(slides) if slides else e[-1] / self.creep)
        steep = 0.0 if slides else self.friction * force.sum() / self.creep
        along = np.append(drag * by_taps.sum(axis=0), steep)
        by_taps = np.vstack((np.column_stack((by_taps, np.zeros(force.size))), along))
        return np.append(force, drag * force.sum()), by_taps

    def energy(self, e: np.ndarray, mode: Any) -> float:
        """``int f d pen``, of every term ``stiffness pen^(power + 1) / (power + 1)``."""
        deep = self._depth(e)
        power = self.power + 1 + np.arange(len(self.curve)) / 2
        series = np.polynomial.polynomial.polyval(
            np.sqrt(deep / self.depth), np.array(self.curve) / power
        )
        return float((self.stiffness * deep ** (self.power + 1) * series).sum())

    def _depth(self, e: np.ndarray) -> np.ndarray:
        return np.maximum(e[: len(self.ports)] - self.gaps, 0.0)

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """What closes damped springs, and friction times speed."""
        n = len(self.ports)
        if self.affine:
            return 0.0
        through = self.evaluate(t, e, mode)[0]
        lost = float(through[-1] * e[-1]) if self.friction else 0.0
        return lost + float(through[:n] @ e[n : 2 * n]) if self._rated else lost

    def stores(self, first: np.ndarray, last: np.ndarray, mode: Any) -> float | None:
        """What the springs hold; where a dent begins or ends is no event, and no quadrature of its
        power would see the kink there."""
        return self.energy(last, mode) - self.energy(first, mode) if self._rated else None


@dataclass(frozen=True)
class Diode(Device):
    """``i = saturation (exp(v / slope) - 1)``, straight on above ``i = 100 A``; [A], [V]."""

    name: str
    saturation: float = 1e-12
    slope: float = 0.02585

    @property
    def pins(self) -> tuple[Pin, ...]:
        """Anode ``a``, cathode ``b``."""
        return (Pin("a", "electrical"), Pin("b", "electrical", grounded=True))

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Forward voltage."""
        return (Tap("a", "b"),)

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Forward current."""
        return (Flow("a", "b"),)

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Current and conductance."""
        knee = self.slope * np.log(100.0 / self.saturation)
        v = min(float(e[0]), knee)
        grown = self.saturation * np.exp(v / self.slope)
        conductance = grown / self.slope
        current = grown - self.saturation + conductance * (e[0] - v)
        return np.array([current]), np.array([[conductance]])

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """``v i``."""
        return float(e[0] * self.evaluate(t, e, mode)[0][0])


@dataclass(frozen=True)
class Switch(Device):
    """A resistance ``on`` or ``off`` [Ohm] between ``a`` and ``b``.

    Toggled at ``times`` [s], starting from ``closed``; or, with a ``threshold``, closed while the
    signal ``control`` is above it, opening ``hysteresis`` below.
    """

    name: str
    on: float
    off: float
    times: tuple[float, ...] = ()
    closed: bool = False
    threshold: float | None = None
    hysteresis: float = 0.0

    @property
    def pins(self) -> tuple[Pin, ...]:
        """``a``, ``b`` and, with a threshold, ``control``."""
        poles = (Pin("a", "electrical"), Pin("b", "electrical", grounded=True))
        return poles if self.threshold is None else (*poles, Pin("control", "signal"))

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Voltage, and the control."""
        return (Tap("a", "b"),) if self.threshold is None else (Tap("a", "b"), Tap("control"))

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Current."""
        return (Flow("a", "b"),)

    @property
    def affine(self) -> bool:
        """Within a mode."""
        return True

    def corners(self, stop: float) -> np.ndarray:
        """The times."""
        return np.array([t for t in self.times if 0.0 < t < stop])

    def mode(self, t: float, e: np.ndarray, before: Any = None) -> bool:
        """Closed or not."""
        if self.threshold is not None:
            return bool(e[1] > self.threshold) if before is None else bool(before)
        return self.closed ^ (sum(s <= t for s in self.times) % 2 == 1)

    def guards(self, t: float, e: np.ndarray, mode: Any) -> np.ndarray:
        """Distance of the control from where it toggles."""
        if self.threshold is None:
            return np.empty(0)
        edge = self.threshold - (self.hysteresis if mode else 0.0)
        return np.array([e[1] - edge if mode else edge - e[1]])

    def switch(self, mode: Any, guard: int) -> tuple[Any, str]:
        """Toggle."""
        return not mode, "opens" if mode else "closes"

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Ohm's law."""
        slope = np.zeros((1, e.size))
        slope[0, 0] = 1.0 / (self.on if mode else self.off)
        return slope @ e, slope

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """``v^2 / R``."""
        return float(e[0] ** 2) / (self.on if mode else self.off)


@dataclass(frozen=True)
class Amplifier(Device):
    """A limited amplifier: ``x' = clip(w (clip(gain (v_p - v_n), low, high) - x), -slew, slew)``.

    ``w = 2 pi bandwidth`` [Hz] of its pole; the output pin ``out`` is ``x`` behind ``resistance``
    [Ohm] > 0. Both clips are modes with located corners.
    """

    name: str
    gain: float
    low: float
    high: float
    bandwidth: float
    resistance: float
    slew: float = np.inf
    input_kind: str = "electrical"

    @property
    def pins(self) -> tuple[Pin, ...]:
        """Inputs ``p`` and ``n``, output ``out``, its return ``ret``."""
        ends = (Pin("out", "electrical"), Pin("ret", "electrical", grounded=True))
        return (Pin("p", self.input_kind), Pin("n", self.input_kind, grounded=True), *ends)

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Input and output voltage."""
        return (Tap("p", "n"), Tap("out", "ret"))

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Current into the output."""
        return (Flow("out", "ret"),)

    @property
    def states(self) -> tuple[str, ...]:
        """Output before its resistance."""
        return ("x",)

    @property
    def affine(self) -> bool:
        """Within a mode."""
        return True

    def _demands(self, e: np.ndarray, rail: int) -> tuple[float, float]:
        aim = self.gain * e[0]
        limited = aim if rail == 0 else (self.high if rail > 0 else self.low)
        return aim, 2 * np.pi * self.bandwidth * (limited - e[2])

    def mode(self, t: float, e: np.ndarray, before: Any = None) -> tuple[int, int]:
        """At which rail the aim lies, and the sign of the slew limit: -1, 0 or 1."""
        aim = self.gain * e[0]
        rail = int(aim > self.high) - int(aim < self.low)
        rate = self._demands(e, rail)[1]
        return rail, int(rate > self.slew) - int(rate < -self.slew)

    def guards(self, t: float, e: np.ndarray, mode: Any) -> np.ndarray:
        """Distances of aim and rate from their limits."""
        aim, rate = self._demands(e, mode[0])
        slews = _inside(rate, -self.slew, self.slew, mode[1])
        return np.array([*_inside(aim, self.low, self.high, mode[0]), *slews])

    def switch(self, mode: Any, guard: int) -> tuple[Any, str]:
        """Meet or leave a limit."""
        which, side = divmod(guard, 2)
        now = list(mode)
        now[which] = 0 if mode[which] else (1 if side else -1)
        words = ("rail", "slew limit")[which]
        return tuple(now), f"{'meets' if now[which] else 'leaves'} its {words}"

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Output current and rate of ``x``."""
        rail, slewing = mode
        w = 2 * np.pi * self.bandwidth
        rate, slope = self._demands(e, rail)[1], np.zeros((2, 3))
        slope[0, 1:] = 1.0 / self.resistance, -1.0 / self.resistance
        if slewing:
            rate = slewing * self.slew
        else:
            slope[1] = 0.0 if rail else w * self.gain, 0.0, -w
        return np.array([slope[0] @ e, rate]), slope

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """Power taken in at the output; negative while it delivers."""
        return float(e[1] * (e[1] - e[2]) / self.resistance)


def _inside(value: float, low: float, high: float, side: int) -> tuple[float, float]:
    """Guards of a clip: towards its low and its high limit while inside, back while outside."""
    if side == 0:
        return value - low, high - value
    return (low - value, 1.0) if side < 0 else (1.0, value - high)


@dataclass(frozen=True)
class ForceTable:
    """``F(y, i) = c0 + sum c_k i_k + sum_{k <= l} c_kl i_k i_l`` by not-a-knot cubic splines.

    ``y`` (n,) [m]; ``columns`` (n, 1 + m + m (m + 1) / 2): c0, c_1 ... c_m, c_11, c_12, ..., c_mm.
    """

    y: np.ndarray
    columns: np.ndarray
    coils: int

    @cached_property
    def _spline(self) -> np.ndarray:
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.y, self.columns, bc_type="not-a-knot").c

    @cached_property
    def _potential(self) -> np.ndarray:
        """Integrals over y from the first node, as quartics (5, n - 1, columns)."""
        c, h = self._spline, np.diff(self.y)[:, None]
        quartic = np.concatenate((c / np.array([4.0, 3.0, 2.0, 1.0])[:, None, None], c[:1] * 0))
        step = (((quartic[0] * h + quartic[1]) * h + quartic[2]) * h + quartic[3]) * h
        quartic[4, 1:] = np.cumsum(step, axis=0)[:-1]
        return quartic

    def coefficients(self, y: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Integral over y, value and slope of all columns; the end cubics go on outside."""
        j = min(max(int(self.y.searchsorted(y, side="right")) - 1, 0), self.y.size - 2)
        s, p = y - self.y[j], self._potential[:, j]
        t = s * s
        powers = np.array((t * t, t * s, t, s, 1.0))
        c = self._spline[:, j]
        return powers @ p, powers[1:] @ c, np.array((3 * t, 2 * s, 1.0)) @ c[:3]

    def powers(self, i: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Monomials (columns,) of the currents and their derivatives (columns, coils)."""
        first, k, m = self._monomials
        slopes = np.zeros((self.columns.shape[1], self.coils))
        n = 1 + self.coils
        slopes[1:n] = first[0]
        slopes[n:] = first[1] * i[m][:, None] + first[2] * i[k][:, None]
        return np.concatenate(((1.0,), i, i[k] * i[m])), slopes

    @cached_property
    def _monomials(self) -> tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray]:
        k, m = np.triu_indices(self.coils)
        unit = np.eye(self.coils)
        return (unit, unit[k], unit[m]), k, m

    def check(self, y: float, where: str, t: float) -> None:
        """Raise SimulationError if ``y`` lies outside the nodes."""
        from kc2spice.core.errors import SimulationError

        if not self.y[0] <= y <= self.y[-1]:
            raise SimulationError(
                "the sphere left the force table",
                where=f"{where} at t = {t:.6e} s",
                got=f"y = {y:.4e} m",
                expected=f"{self.y[0]:.4e} to {self.y[-1]:.4e} m",
                hint="widen the table, or check the gains and the polarity",
            )


@dataclass(frozen=True)
class PositionForce(Device):
    """Force of a table on what is joined to ``y``, with ideal coil currents given as signals.

    ``y_table = u_y + offset``; current k is ``gains[k]`` times the signal on pin ``i1``, ``i2`` ...
    """

    name: str
    table: ForceTable
    gains: tuple[float, ...]
    offset: float = 0.0

    @property
    def _signals(self) -> tuple[str, ...]:
        return tuple(f"i{k + 1}" for k in range(self.table.coils))

    @property
    def pins(self) -> tuple[Pin, ...]:
        """``y``, then the currents."""
        return (Pin("y", "displacement"), *(Pin(n, "signal", grounded=True) for n in self._signals))

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Displacement, its rate, currents."""
        return (Tap("y"), Tap("y", rate=True), *(Tap(n) for n in self._signals))

    @property
    def flows(self) -> tuple[Flow, ...]:
        """The reaction on the coils."""
        return (Flow("y"),)

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Reaction and its slopes in y and the currents."""
        gains = np.asarray(self.gains)
        _, value, slope = self.table.coefficients(float(e[0]) + self.offset)
        powers, by_current = self.table.powers(gains * e[2:])
        derivative = np.concatenate(([slope @ powers, 0.0], (value @ by_current) * gains))
        return np.array([-(value @ powers)]), -derivative[None]

    def check(self, t: float, e: np.ndarray) -> None:
        """Raise SimulationError outside the table."""
        self.table.check(float(e[0]) + self.offset, self.name, t)

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """Minus the work on the moving part: magnets and current sources give it."""
        return float(self.evaluate(t, e, mode)[0][0] * e[1])

    @property
    def extra(self) -> tuple[str, ...]:
        """Scaled currents and the force."""
        return (*(f"coil{k + 1}" for k in range(self.table.coils)), "force")

    def waves(self, t: float, e: np.ndarray, mode: Any) -> dict[str, float]:
        """Coil currents and force."""
        currents = {
            f"coil{k + 1}": g * i for k, (g, i) in enumerate(zip(self.gains, e[2:], strict=True))
        }
        return currents | {"force": -float(self.evaluate(t, e, mode)[0][0])}


@dataclass(frozen=True)
class CoilForce(Device):
    """The same table with real coils: ``v_k = R_k i_k + d lambda_k / dt``, energy consistent.

    Coenergy ``W(y, i) = int F dy + i' L0 i / 2`` gives the force ``dW/dy`` and the flux linkages
    ``lambda_k = dW/di_k``; ``L0`` (m, m) [H] is the inductance at the table's first node.
    """

    name: str
    table: ForceTable
    resistance: np.ndarray
    inductance: np.ndarray
    offset: float = 0.0

    @property
    def pins(self) -> tuple[Pin, ...]:
        """``y``, then both ends of every coil."""
        ends = []
        for k in range(self.table.coils):
            ends.append(Pin(f"a{k + 1}", "electrical", grounded=True))
            ends.append(Pin(f"b{k + 1}", "electrical", grounded=True))
        return (Pin("y", "displacement"), *ends)

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Displacement and coil voltages."""
        return (Tap("y"), *(Tap(f"a{k + 1}", f"b{k + 1}") for k in range(self.table.coils)))

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Reaction force, coil currents."""
        coils = (Flow(f"a{k + 1}", f"b{k + 1}") for k in range(self.table.coils))
        return (Flow("y"), *coils)

    @property
    def states(self) -> tuple[str, ...]:
        """Coil currents."""
        return tuple(f"i{k + 1}" for k in range(self.table.coils))

    @property
    def scales(self) -> tuple[float, ...]:
        """Milliamperes."""
        return (1e-3,) * self.table.coils

    def _split(self, e: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        m = self.table.coils
        return float(e[0]) + self.offset, e[1 : 1 + m], e[1 + m :]

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Reaction, currents, and ``d lambda/dt = v - R i``."""
        m = self.table.coils
        y, volts, i = self._split(e)
        _, value, slope = self.table.coefficients(y)
        powers, by_current = self.table.powers(i)
        out = np.concatenate(([-(value @ powers)], i, volts - self.resistance * i))
        jac = np.zeros((1 + 2 * m, e.size))
        jac[0, 0], jac[0, 1 + m :] = -(slope @ powers), -(value @ by_current)
        jac[1 : 1 + m, 1 + m :] = np.eye(m)
        jac[1 + m :, 1 : 1 + m] = np.eye(m)
        jac[1 + m :, 1 + m :] = -np.diag(self.resistance)
        return out, jac

    def store(self, e: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Flux linkages [Wb] with their slopes."""
        m = self.table.coils
        y, _, i = self._split(e)
        integral, value, _ = self.table.coefficients(y)
        _, by_current = self.table.powers(i)
        jac = np.zeros((m, e.size))
        jac[:, 0] = value @ by_current
        jac[:, 1 + m :] = self._incremental(integral)
        return integral @ by_current + self.inductance @ i, jac

    def _incremental(self, integral: np.ndarray) -> np.ndarray:
        m = self.table.coils
        k, n = np.triu_indices(m)
        half = np.zeros((m, m))
        half[k, n] = integral[1 + m :]
        return half + half.T + self.inductance

    def check(self, t: float, e: np.ndarray) -> None:
        """Raise SimulationError outside the table."""
        self.table.check(float(e[0]) + self.offset, self.name, t)

    def energy(self, e: np.ndarray, mode: Any) -> float:
        """``i' L i / 2 - int c0 dy``."""
        y, _, i = self._split(e)
        integral = self.table.coefficients(y)[0]
        return float(0.5 * i @ self._incremental(integral) @ i - integral[0])

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """``R i^2``."""
        return float(self.resistance @ self._split(e)[2] ** 2)


@dataclass(frozen=True)
class Pid(Device):
    """``out = clip(kp e + I + kd d, -limit, limit)``, ``e = setpoint - (across(y) + offset)``.

    ``d = (e - f) / rolloff``, ``f' = d`` is the rolled-off rate; ``I' = ki e`` while switched on
    and not at the limit. Switched on and off at the times ``enable`` and ``disable``; 0 while off.
    """

    name: str
    kp: float
    ki: float
    kd: float
    rolloff: float
    limit: float
    setpoint: float
    offset: float = 0.0
    enable: tuple[float, ...] = (0.0,)
    disable: tuple[float, ...] = ()
    kind: str = "displacement"

    @property
    def pins(self) -> tuple[Pin, ...]:
        """Measured quantity ``y``, signal ``out``."""
        return (Pin("y", self.kind), Pin("out", "signal"))

    @property
    def taps(self) -> tuple[Tap, ...]:
        """The measured quantity."""
        return (Tap("y"),)

    @property
    def states(self) -> tuple[str, ...]:
        """Followed error and integral part."""
        return ("followed", "integral")

    @property
    def drives(self) -> tuple[str, ...]:
        """The output."""
        return ("out",)

    @property
    def affine(self) -> bool:
        """Within a mode."""
        return True

    @property
    def scales(self) -> tuple[float, ...]:
        """A micrometre, and a hundredth of the limit."""
        return (1e-6, 0.01 * self.limit)

    def initial(self, taps: np.ndarray) -> np.ndarray:
        """At rest."""
        return np.array([self._error(taps), 0.0])

    def _error(self, e: np.ndarray) -> float:
        return self.setpoint - self.offset - float(e[0])

    def demand(self, e: np.ndarray) -> float:
        """What it asks for before the limit."""
        error = self._error(e)
        return self.kp * error + e[2] + self.kd * (error - e[1]) / self.rolloff

    def corners(self, stop: float) -> np.ndarray:
        """Times of switching on and off."""
        return np.array([t for t in (*self.enable, *self.disable) if 0.0 < t < stop])

    def mode(self, t: float, e: np.ndarray, before: Any = None) -> tuple[bool, int]:
        """On or off, and the sign of the limit that holds: -1, 0 or 1."""
        last_on = max((s for s in self.enable if s <= t), default=-np.inf)
        last_off = max((s for s in self.disable if s <= t), default=-np.inf)
        on = last_on > last_off
        demand = self.demand(e)
        return on, (int(demand > self.limit) - int(demand < -self.limit) if on else 0)

    def guards(self, t: float, e: np.ndarray, mode: Any) -> np.ndarray:
        """Distances from the limits."""
        on, side = mode
        return (
            np.array(_inside(self.demand(e), -self.limit, self.limit, side)) if on else np.ones(2)
        )

    def switch(self, mode: Any, guard: int) -> tuple[Any, str]:
        """Meet or leave the limit."""
        on, side = mode
        now = 0 if side else (1 if guard else -1)
        return (on, now), f"out {'meets' if now else 'leaves'} its limit"

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Rates of both states, then the output."""
        on, side = mode
        error = self._error(e)
        out, jac = np.zeros(3), np.zeros((3, 3))
        out[0] = (error - e[1]) / self.rolloff
        jac[0, :2] = -1.0 / self.rolloff
        if on and side == 0:
            out[1], jac[1, 0] = self.ki * error, -self.ki
            out[2] = self.demand(e)
            jac[2] = -self.kp - self.kd / self.rolloff, -self.kd / self.rolloff, 1.0
        elif on:
            out[2] = side * self.limit
        return out, jac

    @property
    def extra(self) -> tuple[str, ...]:
        """The error."""
        return ("error",)

    def waves(self, t: float, e: np.ndarray, mode: Any) -> dict[str, float]:
        """The error."""
        return {"error": self._error(e)}


@dataclass(frozen=True)
class Sampled(Device):
    """A controller in Python: ``outputs = function(t, inputs)`` every ``period`` [s], held between.

    ``inputs`` are pins of ``kind``. The function must be pure or keep its own state.
    """

    name: str
    function: Callable[[float, np.ndarray], Sequence[float]]
    period: float
    inputs: tuple[str, ...]
    outputs: tuple[str, ...] = field(default=("out",))
    kind: str = "displacement"

    @property
    def pins(self) -> tuple[Pin, ...]:
        """Inputs, then outputs."""
        sensed = tuple(Pin(n, self.kind) for n in self.inputs)
        return (*sensed, *(Pin(n, "signal") for n in self.outputs))

    @property
    def taps(self) -> tuple[Tap, ...]:
        """The inputs."""
        return tuple(Tap(n) for n in self.inputs)

    @property
    def drives(self) -> tuple[str, ...]:
        """The outputs."""
        return self.outputs

    def corners(self, stop: float) -> np.ndarray:
        """The sampling instants."""
        return self.period * np.arange(1, int(np.ceil(stop / self.period)))

    @property
    def affine(self) -> bool:
        """Within a mode."""
        return True

    def mode(self, t: float, e: np.ndarray, before: Any = None) -> tuple[float, ...]:
        """The values held."""
        return tuple(float(v) for v in self.function(t, e))

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """The held values."""
        return np.array(mode), np.zeros((len(mode), e.size))


# --- what a part says of itself -------------------------------------------------------------------


@dataclass(frozen=True)
class Reading:
    """A result by the integrator's waves: ``sum factor wave + constant``; ``terms`` are the pairs
    ``(factor, wave)``. ``charge`` divides an ac result by ``j omega``: a current becomes a charge.
    """

    terms: tuple[tuple[float, str], ...]
    constant: float = 0.0
    charge: bool = False


def reading(wave: str, factor: float = 1.0, constant: float = 0.0) -> Reading:
    """``factor`` times one wave, plus ``constant``."""
    return Reading(((factor, wave),), constant)


def difference(plus: str, minus: str) -> Reading:
    """One wave less another."""
    return Reading(((1.0, plus), (-1.0, minus)))


@dataclass(frozen=True)
class Equations:
    """The laws of a part and how they stand for it.

    ``pins`` maps pins of the part to pins of the laws (``NAME.pin``); a pin that is missing has no
    counterpart, because another one stands for it or because it feels nothing. Two pins of the part
    may share a pin of a law: a netlist has a velocity and a displacement node where the law has one
    coordinate. ``nets`` are pins of the laws that meet inside of the part. ``results`` maps the
    part's results to waves, ``sweeps`` its keys that a dc analysis moves to the name of a source
    and its value per SI unit of the key.
    """

    laws: tuple[Law, ...] = ()
    pins: tuple[tuple[str, str], ...] = ()
    results: dict[str, Reading] = field(default_factory=dict)
    sweeps: dict[str, tuple[str, float]] = field(default_factory=dict)
    nets: tuple[tuple[str, ...], ...] = ()
