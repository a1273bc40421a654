"""Circuit elements with lead resistance and inductance in series, and the fit of their total
admittance to measurements.

Admittances ``Y_k`` of elements in parallel and impedances ``Z_l`` of leads make

    Y = 1 / (sum_l Z_l + 1 / Y_p),    Y_p = sum_k Y_k,
    dY / dY_k = (Y / Y_p)^2,    dY / dZ_l = -Y^2.

:class:`Samples` contains frequencies and admittances. The methods of the samples give the deviation
of a sum of :class:`FitElement` from the samples, the best amplitudes, and the nearest minimum over
all parameters. The search for elements is in :mod:`kc2spice.rom.branch_fit`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares, nnls

from kc2spice.rom.network import CircuitBranch

INSTRUMENT_DEVIATION = 1e-5  # relative rms deviation; instruments are not more accurate
ROUNDING_FACTOR = 1.5  # accepted deviation as a multiple of the effect of rounded frequencies
MAX_DIGIT_FRACTION = 0.6  # largest rounding error of a frequency, as a fraction of its last digit
DEVIATION_FLOOR = 1e-6  # largest relative deviation that a fit may ignore
TRIAL_EVALUATIONS = 40  # evaluations of each candidate sum of elements
CONVERGENCE_TOLERANCE = 1e-12  # relative change of the sum of squares and of the parameters
# logarithm of a parameter; larger than for any part, within the range of floats
MAX_LOG_PARAMETER = 150.0
DC_WEIGHT = 1e4  # weight of a given resistance at zero frequency, as a number of samples
# B/G at the lowest frequencies, above which a part blocks direct current
CAPACITIVE_RATIO = np.tan(np.deg2rad(45))
LOWEST_SAMPLES = 5  # lowest samples whose mean phase is used
Logs = tuple[float, ...]
Response = tuple[np.ndarray, list[np.ndarray]]  # Y (n,), and dY / dlog p (n,) for every parameter


def _resistor_response(p: np.ndarray, s: np.ndarray) -> Response:
    """Return the response ``Y = g`` of a resistor."""
    Y = np.full(len(s), np.exp(p[0]), complex)
    return Y, [Y]


def _capacitor_response(p: np.ndarray, s: np.ndarray) -> Response:
    """Return the response ``Y = s c`` of a capacitor."""
    Y = s * np.exp(p[0])
    return Y, [Y]


def _inductor_response(p: np.ndarray, s: np.ndarray) -> Response:
    """Return the response ``Y = g / (1 + s t)`` of R and L in series."""
    g, t = np.exp(p)
    Y = g / (1 + s * t)
    return Y, [Y, -Y * s * t / (1 + s * t)]


def _relaxation_response(p: np.ndarray, s: np.ndarray) -> Response:
    """Return the response ``Y = s a / (1 + s t)`` of R and C in series."""
    a, t = np.exp(p)
    Y = s * a / (1 + s * t)
    return Y, [Y, -Y * s * t / (1 + s * t)]


def _resonance_response(p: np.ndarray, s: np.ndarray) -> Response:
    """Return the response ``Y = s c w^2 / (s^2 + d s + w^2)`` of R, L and C in series."""
    c, w, d = np.exp(p)
    P = s**2 + d * s + w**2
    Y = s * c * w**2 / P
    return Y, [Y, Y * (2 - 2 * w**2 / P), -Y * d * s / P]


PARALLEL_FORMS: dict[str, Callable[[np.ndarray, np.ndarray], Response]] = {
    "conductance": _resistor_response,
    "capacitance": _capacitor_response,
    "inductive": _inductor_response,
    "relaxing": _relaxation_response,
    "resonant": _resonance_response,
}
# Constant impedance, and impedance in proportion to s.
LEAD_FORMS = {"lead resistance": _resistor_response, "lead inductance": _capacitor_response}
ELEMENT_FORMS = PARALLEL_FORMS | LEAD_FORMS
CONDUCTING_FORMS = ("conductance", "inductive")
# Simpler forms of an element for time constants outside of the band.
SIMPLER_FORMS = {
    "conductance": (),
    "capacitance": (),
    "inductive": ("conductance",),
    "relaxing": ("capacitance", "conductance"),
    "resonant": ("capacitance", "conductance", "relaxing", "inductive"),
    "lead resistance": (),
    "lead inductance": (),
}


@dataclass(frozen=True)
class FitElement:
    """Element of a circuit: part of the admittance in parallel, or of the impedance of the leads.

    An element has a form and the logarithms of its parameters, the amplitude first.
    """

    form: str
    logs: Logs

    def response(self, s: np.ndarray) -> Response:
        """Return the admittance of the element, or impedance of a lead, with derivatives."""
        logs = np.clip(self.logs, -MAX_LOG_PARAMETER, MAX_LOG_PARAMETER)
        return ELEMENT_FORMS[self.form](logs, s)

    def scaled(self, factor: float) -> FitElement:
        """The element with its amplitude times ``factor``."""
        return FitElement(self.form, (self.logs[0] + float(np.log(factor)), *self.logs[1:]))

    @property
    def in_parallel(self) -> bool:
        """Whether the element is in parallel and not a lead."""
        return self.form in PARALLEL_FORMS

    @property
    def amplitude(self) -> float:
        """First parameter of the element."""
        return float(np.exp(min(self.logs[0], MAX_LOG_PARAMETER)))

    @property
    def conductance(self) -> float:
        """Conductance at zero frequency [S]; zero for a lead."""
        return self.amplitude if self.form in CONDUCTING_FORMS else 0.0

    def branch(self) -> CircuitBranch:
        """Resistor, inductor and capacitor of the element in series; none for a capacitance."""
        p = np.exp(self.logs).tolist()
        if self.form == "lead resistance":
            return CircuitBranch(p[0])
        if self.form == "lead inductance":
            return CircuitBranch(0.0, p[0])
        if self.form == "conductance":
            return CircuitBranch(1 / p[0])
        if self.form == "inductive":
            return CircuitBranch(1 / p[0], inductance=p[1] / p[0])
        if self.form == "relaxing":
            return CircuitBranch(p[1] / p[0], elastance=1 / p[0])
        inductance = 1 / (p[0] * p[1] ** 2)
        return CircuitBranch(p[2] * inductance, inductance, 1 / p[0])


Elements = tuple[FitElement, ...]


@dataclass(frozen=True, eq=False)
class Samples:
    """Measured admittances ``Y`` (n,) [S] at ``f`` (n,) [Hz], and a ``conductance`` [S].

    ``conductance`` is the conductance at zero frequency, or None if the user does not state it.
    """

    f: np.ndarray
    Y: np.ndarray
    conductance: float | None = None

    @cached_property
    def s(self) -> np.ndarray:
        """Laplace variable ``j w``."""
        return 2j * np.pi * self.f

    @property
    def conducts_direct_current(self) -> bool:
        """Whether direct current flows, as stated or according to the phase at low frequencies.

        If direct current flows, the mean phase at the lowest frequencies differs from the phase of
        a capacitor.
        """
        if self.conductance is not None:
            return self.conductance > 0
        low = np.mean(self.Y[:LOWEST_SAMPLES] / np.abs(self.Y[:LOWEST_SAMPLES]))
        return bool(low.imag < CAPACITIVE_RATIO * low.real)

    @cached_property
    def tolerance(self) -> np.ndarray:
        """Relative deviation (n,) below which no further element is added.

        The tolerance is :data:`INSTRUMENT_DEVIATION`, plus the effect of rounded frequencies in a
        file.
        """
        by_frequency = np.abs(np.gradient(self.Y, self.f) / self.Y)
        return np.asarray(
            np.hypot(
                INSTRUMENT_DEVIATION, ROUNDING_FACTOR * frequency_rounding(self.f) * by_frequency
            )
        )

    def is_described(self, elements: Elements) -> bool:
        """Whether a sum of elements differs from the samples by at most the tolerance.

        The difference is the rms value.
        """
        return bool(np.mean(np.abs(self.misfit(elements) / self.tolerance) ** 2) < 1)

    @cached_property
    def _dc_weight(self) -> float:
        return DC_WEIGHT * np.sqrt(len(self.f)) if self.conductance else 0.0

    def _sum_elements(self, elements: Elements) -> tuple[np.ndarray, np.ndarray]:
        """Admittance (n,) of the elements in parallel, and impedance (n,) of the leads."""
        parallel, leads = np.zeros((2, len(self.f)), complex)
        for element in elements:
            if element.in_parallel:
                parallel += element.response(self.s)[0]
            else:
                leads += element.response(self.s)[0]
        return parallel, leads

    def response(self, elements: Elements) -> np.ndarray:
        """Admittance (n,) complex of a sum of elements."""
        parallel, leads = self._sum_elements(elements)
        return np.asarray(parallel / (1 + leads * parallel))

    def unexplained_admittance(self, elements: Elements) -> np.ndarray:
        """Return the admittance (n,) that the elements in parallel leave unexplained."""
        parallel, leads = self._sum_elements(elements)
        return np.asarray(self.Y / (1 - leads * self.Y) - parallel)

    def slopes(self, elements: Elements) -> list[list[np.ndarray]]:
        """Derivatives (n,) of the logarithm of Y with respect to the parameters of each
        element."""
        parallel, leads = self._sum_elements(elements)
        Y = parallel / (1 + leads * parallel)
        inner = 1 / (parallel * (1 + leads * parallel))
        return [
            [d * (inner if e.in_parallel else -Y) for d in e.response(self.s)[1]] for e in elements
        ]

    def deviation(self, elements: Elements) -> np.ndarray:
        """Relative deviation (n,) complex of a sum of elements from the samples."""
        return np.asarray(self.response(elements) / self.Y - 1)

    def misfit(self, elements: Elements) -> np.ndarray:
        """Complex logarithm (n,) of the ratio of a sum of elements to the samples."""
        ratio = self.response(elements) / self.Y
        return np.log(np.where(ratio == 0, np.finfo(float).tiny, ratio))

    def rms(self, elements: Elements) -> float:
        """Root of the mean square of the logarithmic deviation."""
        return float(np.sqrt(np.mean(np.abs(self.misfit(elements)) ** 2)))

    def criterion(self, elements: Elements) -> float:
        """Compute the Bayesian information criterion of a fit.

        :data:`DEVIATION_FLOOR` is noise in addition to the noise of the samples.
        """
        count = 2 * len(self.f)
        parameters = sum(len(e.logs) for e in elements)
        return float(
            count * np.log(self.rms(elements) ** 2 + DEVIATION_FLOOR**2)
            + parameters * np.log(count)
        )

    def _stack_rows(self, x: np.ndarray, dc: float) -> np.ndarray:
        """Convert complex numbers (n,) to real rows, and append the residual ``dc``.

        The last row is omitted if the conductance has no value or no weight.
        """
        if not self._dc_weight or self.conductance is None:
            return np.concatenate([x.real, x.imag])
        return np.concatenate([x.real, x.imag, [self._dc_weight * dc / self.conductance]])

    def fit_amplitudes(self, elements: Elements) -> tuple[Elements, float]:
        """Fit the non-negative amplitudes of elements behind the leads.

        Elements with an amplitude of zero are left out. The second result is the norm of the
        residual, which is linear in the admittance.
        """
        leads = tuple(e for e in elements if not e.in_parallel)
        elements = tuple(e for e in elements if e.in_parallel)
        share = 1 - self._sum_elements(leads)[1] * self.Y
        dc_share = 1 - lead_resistance(leads) * (self.conductance or 0.0)
        columns = [share**2 / self.Y * e.response(self.s)[0] for e in elements]
        rows = [
            self._stack_rows(x, dc_share**2 * e.conductance)
            for x, e in zip(columns, elements, strict=True)
        ]
        A, target = (
            np.column_stack(rows),
            self._stack_rows(share, dc_share * (self.conductance or 0.0)),
        )
        size = np.linalg.norm(A, axis=0)
        x, left = nnls(A / size, target, maxiter=100 * len(size))
        factors = zip(elements, x / size, strict=True)
        positive = tuple(e.scaled(factor) for e, factor in factors if factor > 0)
        return ((*positive, *leads) if positive else ()), float(left)

    def refine(self, elements: Elements, evaluations: int = TRIAL_EVALUATIONS) -> Elements:
        """Fit all parameters by nonlinear least squares, at most ``evaluations``."""
        if not elements:
            return elements
        ends = np.cumsum([len(e.logs) for e in elements])[:-1]

        def unpack(logs: np.ndarray) -> Elements:
            parts = np.split(logs, ends)
            return tuple(
                FitElement(e.form, tuple(map(float, part)))
                for e, part in zip(elements, parts, strict=True)
            )

        def residual(logs: np.ndarray) -> np.ndarray:
            """Return the weighted residuals of the fit."""
            tried = unpack(logs)
            excess = conductance(tried) - (self.conductance or 0.0)
            return self._stack_rows(self.misfit(tried), excess)

        def slopes(logs: np.ndarray) -> np.ndarray:
            """Return the derivatives of the residuals."""
            tried = unpack(logs)
            result = []
            for e, (first, *others) in zip(tried, self.slopes(tried), strict=True):
                result.append(self._stack_rows(first, _conductance_slope(tried, e)))
                result += [self._stack_rows(other, 0.0) for other in others]
            return np.column_stack(result)

        start = np.concatenate([e.logs for e in elements])
        if len(start) > 2 * len(self.f):
            return elements
        # steps may exceed the range of floats; the result is checked
        with np.errstate(all="ignore"):
            result = least_squares(
                residual,
                start,
                slopes,
                method="lm",
                xtol=CONVERGENCE_TOLERANCE,
                ftol=CONVERGENCE_TOLERANCE,
                gtol=CONVERGENCE_TOLERANCE,
                max_nfev=evaluations,
            )
        return unpack(result.x) if np.isfinite(result.x).all() else elements


def frequency_rounding(f: np.ndarray) -> float:
    """Estimate the rounding error (rms) [Hz] of frequencies ``f`` (n,).

    The estimate is the difference to equal linear or logarithmic steps, if half of the last decimal
    digit explains the difference, and otherwise 0.

    Examples
    --------
    >>> round(frequency_rounding(np.round(np.linspace(1e3, 2e3, 60))), 2)
    0.28
    >>> frequency_rounding(np.linspace(1e3, 2e3, 51)) < 1e-9
    True
    """
    units = 10.0 ** np.arange(np.floor(np.log10(f[0])), -4, -1)
    unit = next((u for u in units if np.abs(f / u - np.round(f / u)).max() < 1e-6), 0.0)
    index = np.arange(len(f))
    for scale, inverse in ((np.asarray, np.asarray), (np.log, np.exp)):
        grid = inverse(np.polyval(np.polyfit(index, scale(f), 1), index))
        if np.abs(f - grid).max() < MAX_DIGIT_FRACTION * unit:
            return float(np.sqrt(np.mean((f - grid) ** 2)))
    return 0.0


def lead_resistance(elements: Elements) -> float:
    """Resistance [Ohm] of the leads among ``elements``."""
    return sum(e.amplitude for e in elements if e.form == "lead resistance")


def conductance(elements: Elements) -> float:
    """Conductance [S] of ``elements`` at zero frequency."""
    parallel = sum(e.conductance for e in elements)
    return parallel / (1 + lead_resistance(elements) * parallel)


def _conductance_slope(elements: Elements, element: FitElement) -> float:
    """Derivative of :func:`conductance` with respect to the logarithm of an amplitude."""
    if element.form == "lead resistance":
        return -(conductance(elements) ** 2) * lead_resistance((element,))
    parallel = sum(e.conductance for e in elements)
    return element.conductance / (1 + lead_resistance(elements) * parallel) ** 2
