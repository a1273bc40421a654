"""Law of a junction diode, with the equations and the constants of ngspice.

The independent integrator solves this law. The netlist contains the built-in diode model of the
simulator instead.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from kc2spice.core.constitutive_laws import AcrossInput, Device, Flow, LawPin
from kc2spice.core.quantities import DEFAULT_TEMPERATURE

# Boltzmann constant [J/K] and elementary charge [C] of ngspice, from CODATA 2014.
# Source: the file include/ngspice/const.h of ngspice.
# With exact SI constants instead of the values of ngspice, the thermal voltage is 0.34 ppm larger.
# With exact SI constants instead of the values of ngspice, the current at 0.6 V is 8 ppm smaller.
SIMULATOR_BOLTZMANN = 1.38064852e-23
SIMULATOR_CHARGE = 1.6021766208e-19
THERMAL_VOLTAGE = SIMULATOR_BOLTZMANN * DEFAULT_TEMPERATURE / SIMULATOR_CHARGE  # V, at 27 C
MIN_CONDUCTANCE = 1e-12  # conductance [S] in parallel with each junction in ngspice (option gmin)
# default parameters of the SPICE diode model; the grading coefficient M is 0.5
BUILT_IN_VOLTAGE = 1.0  # built-in voltage VJ [V]
FORWARD_SHARE = 0.5  # FC, fraction of VJ; at higher voltages, the capacitance rises linearly
BREAKDOWN_CURRENT = 1e-3  # current IBV [A] at the breakdown voltage
# Reverse voltage, divided by the thermal voltage, above which ngspice uses a cubic law.
REVERSE_RANGE = 3.0
BREAKDOWN_ITERATIONS = 25  # fixed-point iterations; each iteration multiplies the error by 1e-5
# Distance from the breakdown voltage, in thermal voltages, below which Newton steps are limited.
BREAKDOWN_MARGIN = 10.0
# A Newton step is not limited if its voltage change is at most this number of thermal voltages.
MAX_UNLIMITED_CHANGE = 2.0


def limit_junction_voltage(v: float, last: float, scale: float, critical: float) -> float:
    """Return the next voltage [V] at which Newton's method linearises a diode.

    The diode has an exponential law. ``v`` is the solution of the equations, linearised at the
    voltage ``last``. If ``v`` is above the ``critical`` voltage, the current of the exponential law
    at ``v`` would be far too large. The next voltage is then the voltage at which the exponential
    law gives the current of the linearised law (Nagel, SPICE2, Memorandum ERL-M520, Berkeley
    1975)::

        exp(next / scale) = exp(last / scale) (1 + (v - last) / scale)

    >>> round(limit_junction_voltage(10.0, 0.6, 0.025, 0.5), 3)
    0.748
    """
    if v <= critical or abs(v - last) <= MAX_UNLIMITED_CHANGE * scale:
        return v
    if last <= 0.0:
        return scale * math.log(v / scale)
    ratio = 1.0 + (v - last) / scale
    return last + scale * math.log(ratio) if ratio > 0.0 else critical


def _compute_exponential(x: float) -> float:
    """Return ``exp(x)``; infinity if the result is too large for a float."""
    try:
        return math.exp(x)
    except OverflowError:
        return math.inf


@dataclass(frozen=True)
class Junction(Device):
    """Law of a diode from ``anode`` to ``cathode``: junction and series resistance.

    At the junction voltage ``v``, the current is ``i(v)`` plus the time derivative of the charge
    ``q(v)``. The equations contain the parameter names of SPICE. Breakdown begins at the junction
    voltage ``-VB``, where VB is chosen so that ``i(-BV) = -1 mA``::

        i = IS (exp(v/(N VT)) - 1) + gmin v                   for v > -3 N VT
        i = -IS (1 + (3 N VT/(e v))^3) + gmin v               in reverse
        i = -IS exp(-(v + VB)/(N VT)) + gmin v                for v < -VB
        q = TT i + integral of CJO/sqrt(1 - v/VJ)             up to VJ/2, then its tangent

    The series resistance may be zero.
    """

    name: str
    saturation_current: float  # A, SPICE parameter IS
    emission: float  # SPICE parameter N
    series_resistance: float  # Ohm, SPICE parameter RS
    capacitance: float  # F, SPICE parameter CJO
    transit_time: float  # s, SPICE parameter TT
    breakdown_voltage: float  # V, SPICE parameter BV

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Anode, cathode, and the inner node between series resistance and junction.

        Without a series resistance, there is no inner node.
        """
        ends = LawPin("anode", "electrical"), LawPin("cathode", "electrical", grounded=True)
        return (*ends, LawPin("inner", "electrical")) if self.series_resistance else ends

    @property
    def _positive_pin(self) -> str:
        """Pin or inner node at the positive end of the junction."""
        return "inner" if self.series_resistance else "anode"

    @property
    def across_inputs(self) -> tuple[AcrossInput, ...]:
        """Inputs of the device: voltages across the junction and the series resistance."""
        junction = AcrossInput(self._positive_pin, "cathode")
        return (junction, AcrossInput("anode", "inner")) if self.series_resistance else (junction,)

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Currents through the junction and through the series resistance."""
        junction = Flow(self._positive_pin, "cathode")
        return (junction, Flow("anode", "inner")) if self.series_resistance else (junction,)

    storing_flow_indices = (0,)

    @cached_property
    def _emission_voltage(self) -> float:
        """Emission coefficient N times thermal voltage VT [V].

        If the forward voltage rises by this value, the current rises by the factor e = 2.718.
        """
        return self.emission * THERMAL_VOLTAGE

    @cached_property
    def _critical_voltage(self) -> float:
        """Voltage [V] at which the curve ``i(v)`` has its largest curvature."""
        return self._emission_voltage * math.log(
            self._emission_voltage / (math.sqrt(2.0) * self.saturation_current)
        )

    @cached_property
    def _breakdown_onset(self) -> float:
        """Reverse voltage VB [V] above which the current rises exponentially.

        At the breakdown voltage BV, the current is the larger of IBV and ``IS BV / VT``::

            VB = BV - N VT ln(IBV / IS + 1 - VB / VT)
        """
        ratio = BREAKDOWN_CURRENT / self.saturation_current
        start = self.breakdown_voltage
        if ratio < start / THERMAL_VOLTAGE:
            return start
        start -= self._emission_voltage * math.log(1.0 + ratio)
        for _ in range(BREAKDOWN_ITERATIONS):
            rise = math.log(ratio + 1.0 - start / THERMAL_VOLTAGE)
            start = self.breakdown_voltage - self._emission_voltage * rise
        return start

    def _compute_current(self, v: float) -> tuple[float, float, float]:
        """Return the current [A] at a voltage, its slope [S], and its integral [W].

        The integral begins at 0 V.
        """
        current, slope, content = self._compute_exponential_current(v)
        return (
            current + MIN_CONDUCTANCE * v,
            slope + MIN_CONDUCTANCE,
            content + 0.5 * MIN_CONDUCTANCE * v**2,
        )

    def _compute_exponential_current(self, v: float) -> tuple[float, float, float]:
        """Compute the current [A], its slope [S] and integral [W], all without ``gmin``.

        The integral begins at 0 V.
        """
        current, scale = self.saturation_current, self._emission_voltage
        first, last = -REVERSE_RANGE * scale, -self._breakdown_onset
        if v >= first:
            rise = current * _compute_exponential(v / scale)
            return rise - current, rise / scale, scale * (rise - current) - current * v
        begin = current * (scale * (math.exp(-REVERSE_RANGE) - 1.0) - first)
        width = REVERSE_RANGE * scale / math.e

        def integrate_reverse(v: float) -> float:
            """Return the integral [W] of the current from 0 V to the reverse voltage ``v``."""
            return begin - current * (v - first + 0.5 * width**3 * (first**-2 - v**-2))

        if v >= last:
            decay = (width / v) ** 3
            return -current * (1.0 + decay), 3.0 * current * decay / v, integrate_reverse(v)
        rise = current * _compute_exponential((last - v) / scale)
        return -rise, rise / scale, integrate_reverse(last) + scale * (rise - current)

    def _compute_depletion_charge(self, v: float) -> tuple[float, float, float]:
        """Return the charge [C], capacitance [F] and coenergy [J] of the depletion layer."""
        volt, below = BUILT_IN_VOLTAGE, min(v, FORWARD_SHARE * BUILT_IN_VOLTAGE)
        root = math.sqrt(1.0 - below / volt)
        charge, farad = 2.0 * self.capacitance * volt * (1.0 - root), self.capacitance / root
        coenergy = 2.0 * self.capacitance * volt * (below - volt * (1.0 - root * root * root) / 1.5)
        over = v - below
        # Above the voltage FC*VJ, the capacitance C rises with the constant slope dC/dv.
        slope = 0.5 * farad / (volt * root * root)
        coenergy += over * (charge + over * (farad / 2.0 + over * slope / 6.0))
        return charge + over * (farad + over * slope / 2.0), farad + slope * over, coenergy

    def _compute_charge(self, v: float) -> tuple[float, float, float]:
        """Return the total charge [C] of the junction, its capacitance [F] and energy [J].

        The charge is the sum of depletion charge and diffusion charge.
        """
        current, slope, content = self._compute_current(v)
        charge, farad, coenergy = self._compute_depletion_charge(v)
        charge += self.transit_time * current
        energy = v * charge - coenergy - self.transit_time * content
        return charge, farad + self.transit_time * slope, energy

    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the currents [A] and conductances [S] of junction and series resistance."""
        slope = [self._compute_current(float(e[0]))[1]]
        if self.series_resistance:
            slope.append(1.0 / self.series_resistance)
        return self.evaluate_outputs(e, mode), np.diag(slope)

    def evaluate_outputs(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return the currents [A] through the junction and through the resistance."""
        current = self._compute_current(float(e[0]))[0]
        return np.array([current, *(e[1:] / (self.series_resistance or 1.0))])

    def evaluate_storage(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the charge [C] of the junction and its derivatives [F].

        The derivatives are taken with respect to the inputs ``e``.
        """
        charge, farad, _ = self._compute_charge(float(e[0]))
        return np.array([charge]), np.array([[farad, *np.zeros(len(e) - 1)]])

    def evaluate_stored_quantities(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return the charge [C] that the junction stores."""
        return np.array([self._compute_charge(float(e[0]))[0]])

    def energy(self, e: np.ndarray, mode: Any) -> float:
        """Return the energy [J] of the charge that the junction stores."""
        return self._compute_charge(float(e[0]))[2]

    def loss(self, e: np.ndarray, mode: Any) -> float:
        """Return the power [W] that junction and resistance dissipate."""
        return float(e @ self.evaluate(e, mode)[0])

    def compute_noise_weights(
        self, s: complex, e: np.ndarray, mode: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the noise weights: amplitudes of shot noise and of thermal noise.

        The shot noise has the spectral density ``2 q |i|``.
        """
        out, slope = self.evaluate(e, mode)
        powers = np.diagonal(slope).copy()
        powers[0] = abs(out[0]) / (2.0 * THERMAL_VOLTAGE)
        return np.diag(np.sqrt(powers)), np.zeros((1, len(e)))

    def limit_change(self, e: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Return the inputs of the law with a limited change of the junction voltage.

        ``e`` contains the inputs of the present Newton step, ``last`` the inputs of the previous
        Newton step. The change is limited in the forward direction and in breakdown.
        """
        v, before = float(e[0]), float(last[0])
        start, scale, critical = (
            self._breakdown_onset,
            self._emission_voltage,
            self._critical_voltage,
        )
        if v < min(0.0, -start + BREAKDOWN_MARGIN * scale):
            over = limit_junction_voltage(-v - start, -before - start, scale, critical)
            v = -over - start
        else:
            v = limit_junction_voltage(v, before, scale, critical)
        return np.array([v, *e[1:]])
