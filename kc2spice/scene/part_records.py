"""Records of parts: initial states, results and numerical requirements.

The module also contains the records of accelerated reference frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from kc2spice.core.equality import EqualByContent
from kc2spice.netlist.expression import parse_vector, split_terms
from kc2spice.netlist.power_waveforms import PowerTerm

Pin = tuple[str, str]
Powers = tuple[PowerTerm, ...]  # terms whose sum is the power of a part, or the power at a pin
DENSITY_UNIT = "/sqrt(Hz)"  # suffix of the units of spectral densities
# reason for the limit of the time step if the scene sets ``solver.max_step``
STEP_SET_BY_USER = "set by solver.max_step"
PERPENDICULAR_COSINE = 1e-9  # largest rounding error of the cosine of a right angle


@dataclass(frozen=True)
class NeglectedEffect:
    """Effect that a model neglects, with the reason and the largest error.

    ``error`` describes the largest error that the neglected effect causes. If ``summarised`` is
    true, the summary of a run lists the effect. ``size`` is the largest relative change that the
    effect causes in a result, or None if the change is not known.
    """

    effect: str
    why: str
    error: str
    summarised: bool = False
    size: float | None = None


@dataclass(frozen=True)
class InitialState:
    """Initial state of a motion: velocity [m/s] and height [m] above the contact."""

    velocity: float
    height: float


# Relation of a governed part to another part: the other part prescribes its motion ("moved"), or
# copies its cards ("copied").
Governed = Literal["moved", "copied"]


# Function that returns the highest frequency [Hz] at which a part excites other parts.
# The argument of the function is the time constant [s] of the filter, such as a coil, through which
# the part excites other parts.
HighestFrequency = Callable[[float], float]


@dataclass(frozen=True)
class EquilibriumConditions:
    """Constraints and loads of a part, which determine whether an equilibrium exists.

    ``paths`` are pairs of pins, or of a pin and ``gnd``. Between the pins of such a pair, the part
    acts as a spring or clamp, or conducts heat or another flow. ``ideal`` are pairs of pins between
    which the part prescribes the across quantity, like an ideal source. ``loaded_pins`` are pins
    with a constant force or flow at t = 0. ``jump_key`` is the key of a prescribed motion whose
    velocity jumps. ``inertial_pins`` are pins at which the part has a mass, so that the velocity
    cannot jump.
    """

    paths: tuple[tuple[str, str], ...] = ()
    ideal: tuple[tuple[str, str], ...] = ()
    loaded_pins: tuple[str, ...] = ()
    jump_key: str = ""
    inertial_pins: tuple[str, ...] = ()


@dataclass(frozen=True)
class PartResult:
    """Result of a part: ngspice expression, factor to SI units, and SI unit.

    The expression may be a sum, such as ``a+b``. A current or force leaves the part at the pins in
    ``leaves``, and enters the part at the pins in ``enters``. For a sound pressure,
    ``level_reference`` is the rms pressure [Pa] at 0 dB. If ``corrected`` is true, the part
    corrects the result after the run
    (:meth:`kc2spice.scene.scene_classes.PartType.corrected_waves`).
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
        """Terms of the expression: the sign and the ngspice vector of each term."""
        return split_terms(self.expression)

    @property
    def voltage(self) -> str | None:
        """Voltage in ngspice syntax, such as ``v(a,b)``; None if the result is no voltage."""
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
    def noise_density(self) -> PartResult:
        """Result of a noise analysis for this output: its spectral noise density."""
        return PartResult("onoise_spectrum", abs(self.factor), f"{self.unit}{DENSITY_UNIT}")


@dataclass(frozen=True)
class SceneResults:
    """Results of a scene: vectors of the netlist, and powers computed from vectors.

    Attributes
    ----------
    vectors : mapping of str to PartResult
        Vectors of the netlist, keyed by the names of the results.
    powers : mapping of str to tuple of PowerTerm
        Terms of each power of a part or pin that a probe reads.
    """

    vectors: Mapping[str, PartResult] = field(default_factory=dict)
    powers: Mapping[str, Powers] = field(default_factory=dict)

    @property
    def units(self) -> dict[str, str]:
        """SI units of all results, including powers, keyed by name."""
        units = {name: result.unit for name, result in self.vectors.items()}
        return units | dict.fromkeys(self.powers, "W")


@dataclass(frozen=True)
class LargestRealPartFrequency:
    """Frequency at which the real part of a response has its largest magnitude."""

    of: str


@dataclass(frozen=True)
class SweptSource:
    """Voltage or current source that a dc sweep of a key varies.

    ``scale`` is the value of the source in volts or amperes for one SI unit of the key. If the part
    changes the range of the sweep, ``range`` contains the first and the last value of the key in SI
    units. Otherwise, ``range`` is None.
    """

    source: str
    scale: float
    range: tuple[float, float] | None = None


@dataclass(frozen=True, eq=False)
class DcSweep(EqualByContent):
    """Sweep of a dc analysis, which varies a key of the scene and thereby one source.

    Attributes
    ----------
    source : str
        Name of the source in the netlist.
    scale : float
        Volts or amperes of the source for one SI unit of the key.
    unit : str
        SI unit of the key.
    part, key : str
        Part and key of the scene that the sweep varies.
    ends : tuple of two floats
        First and last value of the key in SI units.
    values : ndarray
        Values of the swept variable in SI units. ngspice sweeps only in one direction. To vary the
        key from its start value to ``last`` and back, ngspice sweeps the variable over twice the
        range of the key. If the sweep value v is beyond ``last``, the source has the value ``2 *
        last - v``, so the source returns to its start value. ``last`` is the second value in
        ``ends``.
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
    """Source whose value a Python function sets at sampling times of a transient.

    ``source`` is the name of the source's card in lower case. The function ``call(time, values)``
    is called with the saved node voltages every ``period`` [s], first at t = 0. The returned value
    becomes the value of the source after the ``delay`` [s]. For a function with memory,
    ``reload()`` returns the function in the state before the first call.
    """

    source: str
    period: float
    delay: float
    call: Callable[[float, Mapping[str, float]], float]
    reload: Callable[[], Callable[[float, Mapping[str, float]], float]] | None = None

    @property
    def copy_in_initial_state(self) -> SampledSource:
        """Copy of the sampled source, with its Python function in the initial state."""
        return self if self.reload is None else replace(self, call=self.reload())


@dataclass(frozen=True)
class StepLimit:
    """Upper limit [s] of the time step, and the reason for the limit."""

    step: float
    why: str


@dataclass(frozen=True)
class NumericalRequirements:
    """Numerical requirements of a part: time step, tolerances and simulator options.

    ``step`` is the longest time step [s] that resolves the part. ``description`` states why the
    time step must not exceed ``step``. ``highest_frequency`` [Hz] is the highest frequency at which
    the part excites other parts. If ``overrides_others`` is true, ``step`` overrides the steps of
    all other parts.
    ``reltol`` and ``chgtol`` are factors of at most 1, by which the part reduces the tolerances of
    the solver. ``options`` contains the value of each simulator option and the reason for the
    value, keyed by option. ``period`` [s] is the period of the waves with which the part drives
    other parts, or 0 if the waves are not periodic.
    """

    description: str
    step: float = math.inf
    highest_frequency: float = 0.0
    overrides_others: bool = False
    reltol: float = 1.0
    chgtol: float = 1.0
    period: float = 0.0
    options: Mapping[str, tuple[str, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class FrameAcceleration:
    """Acceleration of a reference frame: the body's pin, its node, and a direction.

    ``net`` is the netlist node of the pin. ``along`` is the cosine of the angle between the
    acceleration and a displacement in the frame, or None if a direction is unknown.
    """

    net: str
    pin: Pin
    along: float | None


@dataclass(frozen=True)
class AcceleratedFrame:
    """Accelerated reference frame of a net: its body and all its accelerations."""

    body: str
    shakes: tuple[FrameAcceleration, ...]

    @property
    def node_cosines(self) -> frozenset[tuple[str, float | None]]:
        """Acceleration nodes with the direction cosines that identify a reference frame.

        Two displacements have the same frame of reference if the pairs (acceleration node,
        direction cosine) of their frames are equal.
        """
        return frozenset((shake.net, shake.along) for shake in self.shakes)

    @property
    def description(self) -> str:
        """Description of the reference frame's accelerations, for the command ``explain``."""
        shares = []
        for shake in self.shakes:
            pin = ".".join(shake.pin)
            if shake.along is None:
                shares.append(f"an unknown share of {pin}")
            elif abs(shake.along - 1.0) <= PERPENDICULAR_COSINE:
                shares.append(pin)
            else:
                shares.append(f"{shake.along:.4g} of {pin}")
        return ", ".join(shares) or f"{self.body}, perpendicular to the displacement"
