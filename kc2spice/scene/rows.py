"""Records that part types return: initial states, results, numerical needs, shaken frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

Pin = tuple[str, str]
SQUARE = 1e-9  # cosine of two directions at a right angle, but for rounding


@dataclass(frozen=True)
class Neglected:
    """An effect without a model, why, and what its absence changes at most."""

    effect: str
    why: str
    error: str


@dataclass(frozen=True)
class State:
    """How a motion begins: velocity [m/s] and height over touching [m]."""

    velocity: float
    height: float


#: All motion of a part, which has none of its own, or a part without cards and results of its own,
#: as cards of another one have copies of it.
Governed = Literal["moved", "copied"]


#: Frequency [Hz] up to which a part excites others, of a time constant [s] in between.
HighestFrequency = Callable[[float], float]


@dataclass(frozen=True)
class Rest:
    """Constraints and loads of a part at rest on pins that need a path to their reference.

    ``paths`` are pairs of them, or such a pin and ``gnd``, between which it holds a distance or
    leads heat. ``ideal`` are pairs of any pins whose difference it sets as an ideal
    source. On ``pushed`` ones it puts a constant force or flow at t = 0. ``kinked`` is the key of a
    motion that it prescribes with jumps of velocity, ``inert`` are pins whose velocity no finite
    force makes jump.
    """

    paths: tuple[tuple[str, str], ...] = ()
    ideal: tuple[tuple[str, str], ...] = ()
    pushed: tuple[str, ...] = ()
    kinked: str = ""
    inert: tuple[str, ...] = ()


@dataclass(frozen=True)
class Vector:
    """A result: an ngspice expression (``a+b`` is a sum), the factor to SI, the SI unit; the pins
    where, as a current or force, it ``leaves`` and ``enters`` the part."""

    expression: str
    factor: float
    unit: str
    leaves: tuple[str, ...] = ()
    enters: tuple[str, ...] = ()


@dataclass(frozen=True)
class LargestRealPart:
    """The frequency at which the real part of a response has its largest magnitude."""

    of: str


@dataclass(frozen=True)
class Swept:
    """The source that a dc sweep of a key moves, its volts or amperes per SI unit, and first and
    last value in SI where they are not the scene's."""

    source: str
    scale: float
    range: tuple[float, float] | None = None


@dataclass(frozen=True)
class Sampled:
    """A function outside of the simulator that sets ``source`` (a card's name in lower case).

    ``call(time, values)`` sees the saved node voltages every ``period`` [s], first at zero; what
    it returns is held from ``delay`` [s] later on. A function that remembers earlier calls has
    ``reload``, which returns it as it is before its first call.
    """

    source: str
    period: float
    delay: float
    call: Callable[[float, Mapping[str, float]], float]
    reload: Callable[[], Callable[[float, Mapping[str, float]], float]] | None = None

    @property
    def at_start(self) -> Sampled:
        """The same before the first call of a run."""
        return self if self.reload is None else replace(self, call=self.reload())


@dataclass(frozen=True)
class StepLimit:
    """A largest time step [s] and why."""

    step: float
    why: str


@dataclass(frozen=True)
class Numerics:
    """Time scales of a part and its numerical requirements.

    ``step`` is the longest time step [s] that resolves the part, ``content`` the highest frequency
    [Hz] that it excites in others. A step that ``decides`` overrides all others. ``reltol`` and
    ``chgtol`` are the factors, 1 or less, of the solver's tolerances that the part requires.
    ``options`` are options of the simulator by name: value and reason. Driven waves repeat after
    ``period`` [s]; 0 without one.
    """

    what: str
    step: float = math.inf
    content: float = 0.0
    decides: bool = False
    reltol: float = 1.0
    chgtol: float = 1.0
    period: float = 0.0
    options: Mapping[str, tuple[str, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Shake:
    """The acceleration at a ``pin`` of a body, on the node ``net``, and how much of it is ``along``
    a displacement: the cosine between both, None where a direction is not known."""

    net: str
    pin: Pin
    along: float | None


@dataclass(frozen=True)
class ShakenFrame:
    """Accelerations that shake the frame of a net; empty if all are at a right angle to it."""

    body: str
    shakes: tuple[Shake, ...]

    @property
    def acts(self) -> frozenset[tuple[str, float | None]]:
        """Nodes of the accelerations and their shares, by which frames differ."""
        return frozenset((shake.net, shake.along) for shake in self.shakes)

    @property
    def words(self) -> str:
        """For ``explain``."""
        shares = []
        for shake in self.shakes:
            pin = ".".join(shake.pin)
            if shake.along is None:
                shares.append(f"an unknown share of {pin}")
            elif abs(shake.along - 1.0) <= SQUARE:
                shares.append(pin)
            else:
                shares.append(f"{shake.along:.4g} of {pin}")
        return ", ".join(shares) or f"{self.body}, whose acceleration is at a right angle"
