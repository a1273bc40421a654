"""Records that part types return: states, results, numerical requirements, frames."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from kc2spice.core.equality import EqualByContent
from kc2spice.netlist.expression import parse_vector, split_terms
from kc2spice.netlist.powers import PowerTerm

Pin = tuple[str, str]
Powers = tuple[PowerTerm, ...]  # terms whose sum is the power of a part or pin
DENSITY_UNIT = "/sqrt(Hz)"  # suffix of the unit of a spectral density
PERPENDICULAR_COSINE = 1e-9  # largest cosine of two perpendicular directions (rounding error)


@dataclass(frozen=True)
class Neglected:
    """Neglected effect, the reason, and the largest error that it causes.

    The summary of a run contains ``summarised`` effects.
    """

    effect: str
    why: str
    error: str
    summarised: bool = False


@dataclass(frozen=True)
class State:
    """Initial state of a motion: velocity [m/s] and height above contact [m]."""

    velocity: float
    height: float


# Governed motion: all motion of another part, or a part whose cards this part copies.
Governed = Literal["moved", "copied"]


# Highest frequency [Hz] at which a part excites other parts, as a function of the time constant [s]
# between them.
HighestFrequency = Callable[[float], float]


@dataclass(frozen=True)
class Rest:
    """Constraints and loads of a part in equilibrium.

    ``paths`` are pairs of pins, or a pin and ``gnd``, whose distance the part fixes, or between
    which it conducts heat. ``ideal`` are pairs of pins whose difference the part prescribes, like
    an ideal source. ``pushed`` are pins with a constant force or flow at t = 0. ``kinked`` is the
    key of a prescribed motion with jumps of velocity. ``inert`` are pins whose velocity cannot
    jump.
    """

    paths: tuple[tuple[str, str], ...] = ()
    ideal: tuple[tuple[str, str], ...] = ()
    pushed: tuple[str, ...] = ()
    kinked: str = ""
    inert: tuple[str, ...] = ()


@dataclass(frozen=True)
class Vector:
    """Result of a part: an ngspice expression, the factor to SI, and the SI unit.

    ``a+b`` is a sum. A current or force ``leaves`` and ``enters`` the part at these pins. A sound
    pressure has the ``level_reference`` [Pa], the rms pressure at 0 dB. The part changes a
    ``corrected`` result after the run (:meth:`kc2spice.scene.model.PartType.corrected_waves`).
    """

    expression: str
    factor: float
    unit: str
    leaves: tuple[str, ...] = ()
    enters: tuple[str, ...] = ()
    level_reference: float | None = field(default=None, kw_only=True)
    corrected: bool = field(default=False, kw_only=True)

    @property
    def terms(self) -> list[tuple[float, str]]:
        """Signs and vectors of the sum."""
        return split_terms(self.expression)

    @property
    def voltage(self) -> str | None:
        """The voltage in the syntax of the simulator, None for other results."""
        plus: list[str] = []
        minus: list[str] = []
        for sign, text in self.terms:
            read = parse_vector(text)
            if read is None or read.quantity != "v" or len(read.names) > 1:
                return None
            (plus if sign > 0 else minus).append(read.names[0])
        if max(len(plus), len(minus)) > 1:
            return None
        return f"v({','.join(plus + minus)})"

    @property
    def density(self) -> Vector:
        """Spectral density of the noise."""
        return Vector("onoise_spectrum", abs(self.factor), f"{self.unit}{DENSITY_UNIT}")


@dataclass(frozen=True)
class SceneResults:
    """Results of a scene.

    Attributes
    ----------
    vectors : mapping of str to Vector
        Vectors of the netlist by the names of the results.
    powers : mapping of str to tuple of PowerTerm
        Terms of each power of a part or pin that a probe reads.
    """

    vectors: Mapping[str, Vector] = field(default_factory=dict)
    powers: Mapping[str, Powers] = field(default_factory=dict)

    @property
    def units(self) -> dict[str, str]:
        """SI units of all results, including powers."""
        units = {name: result.unit for name, result in self.vectors.items()}
        return units | dict.fromkeys(self.powers, "W")


@dataclass(frozen=True)
class LargestRealPart:
    """Frequency at which the real part of a response has its largest magnitude."""

    of: str


@dataclass(frozen=True)
class SweptSource:
    """Source that a dc sweep of a key varies, with its volts or amperes per SI unit.

    ``range`` contains the first and the last value in SI, if they differ from the range of the
    scene.
    """

    source: str
    scale: float
    range: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class DcSweep(EqualByContent):
    """Sweep of a dc analysis: the key and the source that it varies.

    Attributes
    ----------
    source : str
        Name of the source in the netlist.
    scale : float
        Volts or amperes of the source for one SI unit of the key.
    unit : str
        SI unit of the key.
    part, key : str
        Key of the scene that the sweep moves.
    ends : tuple of two floats
        First and last value in SI units.
    values : ndarray
        Values in SI units. ngspice sweeps in one direction only. Values of the return sweep are
        therefore beyond the second value of ``ends``. On the way back, the source has the value
        ``2 last - value``.
    """

    source: str
    scale: float
    unit: str
    part: str
    key: str
    ends: tuple[float, float]
    values: np.ndarray


@dataclass(frozen=True)
class SampledSource:
    """Function outside of the simulator that sets a source.

    ``source`` is the name of its card in lower case. ``call(time, values)`` receives the saved node
    voltages every ``period`` [s], first at zero. The result of the function is the value of the
    source from ``delay`` [s] later on. A function with memory has ``reload``, which returns the
    function in its state before the first call.
    """

    source: str
    period: float
    delay: float
    call: Callable[[float, Mapping[str, float]], float]
    reload: Callable[[], Callable[[float, Mapping[str, float]], float]] | None = None

    @property
    def reset_function(self) -> SampledSource:
        """Function in its state before the first call of a run."""
        return self if self.reload is None else replace(self, call=self.reload())


@dataclass(frozen=True)
class StepLimit:
    """Upper limit [s] of the time step, and its reason."""

    step: float
    why: str


@dataclass(frozen=True)
class Numerics:
    """Time scales of a part and its numerical requirements.

    ``step`` is the longest time step [s] that resolves the part, ``content`` the highest frequency
    [Hz] that it excites in others. A step that ``decides`` overrides all others. ``reltol`` and
    ``chgtol`` are the factors, 1 or less, of the solver's tolerances that the part requires.
    ``options`` are options of the simulator by name: value and reason. Driven waves repeat after
    ``period`` [s]; 0 if they do not repeat.
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
class FrameShake:
    """Acceleration at a ``pin`` of a body, on the node ``net``.

    ``along`` is the cosine between acceleration and displacement, None if a direction is unknown.
    """

    net: str
    pin: Pin
    along: float | None


@dataclass(frozen=True)
class ShakenFrame:
    """Accelerations of the frame of a net; empty if all are perpendicular to the motion."""

    body: str
    shakes: tuple[FrameShake, ...]

    @property
    def acts(self) -> frozenset[tuple[str, float | None]]:
        """Nodes of the accelerations and their shares, by which frames differ."""
        return frozenset((shake.net, shake.along) for shake in self.shakes)

    @property
    def words(self) -> str:
        """Accelerations in words, for ``explain``."""
        shares = []
        for shake in self.shakes:
            pin = ".".join(shake.pin)
            if shake.along is None:
                shares.append(f"an unknown share of {pin}")
            elif abs(shake.along - 1.0) <= PERPENDICULAR_COSINE:
                shares.append(pin)
            else:
                shares.append(f"{shake.along:.4g} of {pin}")
        return ", ".join(shares) or f"{self.body}, whose acceleration is at a right angle"
