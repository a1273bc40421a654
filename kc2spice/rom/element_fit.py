"""Fit of parallel circuit elements, in series with leads, to measured admittances.

The total admittance of parallel elements with admittances ``Y_k``, in series with leads of
impedances ``Z_l``, is

    Y = 1 / (sum_l Z_l + 1 / Y_p),    Y_p = sum_k Y_k,
    dY / dY_k = (Y / Y_p)^2,    dY / dZ_l = -Y^2.

:class:`AdmittanceSamples` contains measured frequencies and admittances. Methods of
:class:`AdmittanceSamples` compute the deviation of a sum of elements (:class:`FitElement`) from the
samples, and fit the parameters of the elements. The module :mod:`kc2spice.rom.branch_fit` chooses
the elements.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.optimize import least_squares, nnls

from kc2spice.rom.one_port_network import CircuitBranch

INSTRUMENT_DEVIATION = 1e-5  # relative rms error that every measuring instrument may have
# accepted deviation, as a multiple of the deviation that rounded frequencies cause
ROUNDING_FACTOR = 1.5
MAX_DIGIT_FRACTION = 0.6  # largest rounding error of a frequency, as a fraction of the last digit
DEVIATION_FLOOR = 1e-6  # smaller relative deviations hardly change the information criterion
# largest number of residual evaluations in the fit of one candidate circuit
TRIAL_EVALUATIONS = 40
# A fit has converged if the parameters and the sum of squares change by less than this ratio.
CONVERGENCE_TOLERANCE = 1e-12
# Largest logarithm of a parameter: larger than for real components, but in the range of floats.
MAX_LOG_PARAMETER = 150.0
DC_WEIGHT = 1e4  # weight of a prescribed dc conductance, relative to the weight of all samples
# a part blocks direct current if (susceptance / conductance) at low frequencies exceeds this ratio
CAPACITIVE_RATIO = np.tan(np.deg2rad(45))
# The mean phase of this number of samples, at the lowest frequencies, determines whether a part
# conducts direct current.
LOWEST_SAMPLES = 5
Logs = tuple[float, ...]
Response = tuple[np.ndarray, list[np.ndarray]]  # Y (n,), and dY / dlog p (n,) for every parameter


def _compute_resistor_response(p: np.ndarray, s: np.ndarray) -> Response:
    """Return the response ``Y = g`` of a resistor."""
    Y = np.full(len(s), np.exp(p[0]), complex)
    return Y, [Y]


def _compute_capacitor_response(p: np.ndarray, s: np.ndarray) -> Response:
    """Return the response ``Y = s c`` of a capacitor."""
    Y = s * np.exp(p[0])
    return Y, [Y]


def _compute_inductor_response(p: np.ndarray, s: np.ndarray) -> Response:
    """Return the response ``Y = g / (1 + s t)`` of R and L in series."""
    g, t = np.exp(p)
    Y = g / (1 + s * t)
    return Y, [Y, -Y * s * t / (1 + s * t)]


def _compute_relaxation_response(p: np.ndarray, s: np.ndarray) -> Response:
    """Return the response ``Y = s a / (1 + s t)`` of R and C in series."""
    a, t = np.exp(p)
    Y = s * a / (1 + s * t)
    return Y, [Y, -Y * s * t / (1 + s * t)]


def _compute_resonance_response(p: np.ndarray, s: np.ndarray) -> Response:
    """Return ``Y = s c w^2 / (s^2 + d s + w^2)`` of R, L and C in series."""
    c, w, d = np.exp(p)
    P = s**2 + d * s + w**2
    Y = s * c * w**2 / P
    return Y, [Y, Y * (2 - 2 * w**2 / P), -Y * d * s / P]


PARALLEL_FORMS: dict[str, Callable[[np.ndarray, np.ndarray], Response]] = {
    "conductance": _compute_resistor_response,
    "capacitance": _compute_capacitor_response,
    "inductive": _compute_inductor_response,
    "relaxing": _compute_relaxation_response,
    "resonant": _compute_resonance_response,
}
# A lead resistance has a constant impedance; a lead inductance has an impedance proportional to s.
LEAD_FORMS = {
    "lead resistance": _compute_resistor_response,
    "lead inductance": _compute_capacitor_response,
}
ELEMENT_FORMS = PARALLEL_FORMS | LEAD_FORMS
CONDUCTING_FORMS = ("conductance", "inductive")
# Keys are forms of elements; values are the simpler forms that may replace an element
# whose time constant is outside of the band.
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
    """Circuit element of a fit: a parallel admittance, or a series impedance (lead).

    ``form`` is the kind of the element. ``logs`` are the logarithms of the element's parameters,
    the amplitude first.
    """

    form: str
    logs: Logs

    def response(self, s: np.ndarray) -> Response:
        """Return the response of the element and its derivatives with respect to the parameters.

        The response is the admittance of a parallel element, or the impedance of a series element
        (lead).
        """
        logs = np.clip(self.logs, -MAX_LOG_PARAMETER, MAX_LOG_PARAMETER)
        return ELEMENT_FORMS[self.form](logs, s)

    def scale_amplitude(self, factor: float) -> FitElement:
        """Return the element with its amplitude multiplied by ``factor``."""
        return FitElement(self.form, (self.logs[0] + float(np.log(factor)), *self.logs[1:]))

    @property
    def is_in_parallel(self) -> bool:
        """Whether the element is a parallel admittance, not a lead in series."""
        return self.form in PARALLEL_FORMS

    @property
    def amplitude(self) -> float:
        """Amplitude of the element, which is its first parameter."""
        return float(np.exp(min(self.logs[0], MAX_LOG_PARAMETER)))

    @property
    def conductance(self) -> float:
        """Conductance [S] of a parallel element at zero frequency; 0 for series elements."""
        return self.amplitude if self.form in CONDUCTING_FORMS else 0.0

    def make_branch(self) -> CircuitBranch:
        """Convert the element to a series R-L-C branch; not possible for a capacitance."""
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
class AdmittanceSamples:
    """Measured admittances ``Y`` (n,) [S] at ``f`` (n,) [Hz], and dc conductance [S].

    ``conductance`` is the conductance at zero frequency, or None if the user states no conductance.
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
        """Whether the measured part conducts direct current.

        If the user states a conductance at zero frequency, direct current flows if the stated
        conductance is positive. Otherwise, direct current flows if the mean phase at the lowest
        frequencies differs from the phase of a capacitor.
        """
        if self.conductance is not None:
            return self.conductance > 0
        low = np.mean(self.Y[:LOWEST_SAMPLES] / np.abs(self.Y[:LOWEST_SAMPLES]))
        return bool(low.imag < CAPACITIVE_RATIO * low.real)

    @cached_property
    def tolerance(self) -> np.ndarray:
        """Tolerance of relative deviations; smaller deviations add no element to a fit.

        The tolerance (n,) combines :data:`INSTRUMENT_DEVIATION` and the effect of frequencies that
        are rounded in the file.
        """
        by_frequency = np.abs(np.gradient(self.Y, self.f) / self.Y)
        return np.asarray(
            np.hypot(
                INSTRUMENT_DEVIATION,
                ROUNDING_FACTOR * estimate_frequency_rounding(self.f) * by_frequency,
            )
        )

    def is_within_tolerance(self, elements: Elements) -> bool:
        """Return whether the rms deviation of a sum of elements is within the tolerance."""
        return bool(np.mean(np.abs(self.compute_log_ratio(elements) / self.tolerance) ** 2) < 1)

    @cached_property
    def _dc_weight(self) -> float:
        """Weight of the dc conductance in the fit; zero without a positive conductance."""
        return DC_WEIGHT * np.sqrt(len(self.f)) if self.conductance else 0.0

    def _sum_elements(self, elements: Elements) -> tuple[np.ndarray, np.ndarray]:
        """Sum the admittances (n,) of parallel elements, and the impedances (n,) of leads."""
        parallel, leads = np.zeros((2, len(self.f)), complex)
        for element in elements:
            if element.is_in_parallel:
                parallel += element.response(self.s)[0]
            else:
                leads += element.response(self.s)[0]
        return parallel, leads

    def response(self, elements: Elements) -> np.ndarray:
        """Compute the response of a circuit of elements: its complex admittance (n,)."""
        parallel, leads = self._sum_elements(elements)
        return np.asarray(parallel / (1 + leads * parallel))

    def unexplained_admittance(self, elements: Elements) -> np.ndarray:
        """Return the measured admittance (n,) that ``elements`` do not explain."""
        parallel, leads = self._sum_elements(elements)
        return np.asarray(self.Y / (1 - leads * self.Y) - parallel)

    def compute_log_slopes(self, elements: Elements) -> list[list[np.ndarray]]:
        """Compute the derivatives of log(Y) with respect to all parameters of elements.

        Each derivative is an array of shape (n,).
        """
        parallel, leads = self._sum_elements(elements)
        Y = parallel / (1 + leads * parallel)
        inner = 1 / (parallel * (1 + leads * parallel))
        return [
            [d * (inner if e.is_in_parallel else -Y) for d in e.response(self.s)[1]]
            for e in elements
        ]

    def compute_deviation(self, elements: Elements) -> np.ndarray:
        """Compute the complex relative deviation (n,) of a sum of elements from samples."""
        return np.asarray(self.response(elements) / self.Y - 1)

    def compute_log_ratio(self, elements: Elements) -> np.ndarray:
        """Compute the complex logarithm (n,) of ``Y / Y_measured`` for a sum of elements."""
        ratio = self.response(elements) / self.Y
        return np.log(np.where(ratio == 0, np.finfo(float).tiny, ratio))

    def compute_rms_deviation(self, elements: Elements) -> float:
        """Compute the rms logarithmic deviation of a sum of elements from the samples."""
        return float(np.sqrt(np.mean(np.abs(self.compute_log_ratio(elements)) ** 2)))

    def compute_information_criterion(self, elements: Elements) -> float:
        """Compute the Bayesian information criterion of a fit.

        Deviations from the samples that are below :data:`DEVIATION_FLOOR` hardly change the
        criterion.
        """
        count = 2 * len(self.f)
        parameters = sum(len(e.logs) for e in elements)
        return float(
            count * np.log(self.compute_rms_deviation(elements) ** 2 + DEVIATION_FLOOR**2)
            + parameters * np.log(count)
        )

    def _stack_rows(self, x: np.ndarray, dc: float) -> np.ndarray:
        """Stack real and imaginary parts of ``x`` (n,), and append the dc residual ``dc``.

        ``dc`` is the residual of the conductance at zero frequency. The residual ``dc`` is omitted
        if the user states no conductance, or a conductance of zero.
        """
        if not self._dc_weight or self.conductance is None:
            return np.concatenate([x.real, x.imag])
        return np.concatenate([x.real, x.imag, [self._dc_weight * dc / self.conductance]])

    def fit_amplitudes(self, elements: Elements) -> tuple[Elements, float]:
        """Fit the amplitudes of parallel elements; the series leads keep their values.

        The amplitudes are not negative, and elements with an amplitude of zero are omitted. The
        second result is the residual norm of the linear least-squares problem for the amplitudes.
        """
        leads = tuple(e for e in elements if not e.is_in_parallel)
        elements = tuple(e for e in elements if e.is_in_parallel)
        share = 1 - self._sum_elements(leads)[1] * self.Y
        dc_share = 1 - sum_lead_resistance(leads) * (self.conductance or 0.0)
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
        positive = tuple(e.scale_amplitude(factor) for e, factor in factors if factor > 0)
        return ((*positive, *leads) if positive else ()), float(left)

    def refine_elements(self, elements: Elements, evaluations: int = TRIAL_EVALUATIONS) -> Elements:
        """Refine the parameters of all circuit elements by nonlinear least squares.

        The residuals are evaluated at most ``evaluations`` times.
        """
        if not elements:
            return elements
        ends = np.cumsum([len(e.logs) for e in elements])[:-1]

        def unpack_elements(logs: np.ndarray) -> Elements:
            """Return elements whose parameters have the stacked logarithms ``logs``."""
            parts = np.split(logs, ends)
            return tuple(
                FitElement(e.form, tuple(map(float, part)))
                for e, part in zip(elements, parts, strict=True)
            )

        def compute_residual(logs: np.ndarray) -> np.ndarray:
            """Return the weighted residuals of the fit."""
            tried = unpack_elements(logs)
            excess = compute_dc_conductance(tried) - (self.conductance or 0.0)
            return self._stack_rows(self.compute_log_ratio(tried), excess)

        def compute_residual_slopes(logs: np.ndarray) -> np.ndarray:
            """Return the derivatives of the residuals."""
            tried = unpack_elements(logs)
            result = []
            for e, (first, *others) in zip(tried, self.compute_log_slopes(tried), strict=True):
                result.append(self._stack_rows(first, _compute_conductance_slope(tried, e)))
                result += [self._stack_rows(other, 0.0) for other in others]
            return np.column_stack(result)

        start = np.concatenate([e.logs for e in elements])
        if len(start) > 2 * len(self.f):
            return elements
        # trial steps may exceed the range of floats, so the result is checked below
        with np.errstate(all="ignore"):
            result = least_squares(
                compute_residual,
                start,
                compute_residual_slopes,
                method="lm",
                xtol=CONVERGENCE_TOLERANCE,
                ftol=CONVERGENCE_TOLERANCE,
                gtol=CONVERGENCE_TOLERANCE,
                max_nfev=evaluations,
            )
        return unpack_elements(result.x) if np.isfinite(result.x).all() else elements


def estimate_frequency_rounding(f: np.ndarray) -> float:
    """Estimate the rms rounding error [Hz] of the listed frequencies ``f`` (n,).

    The estimate is the rms difference between ``f`` and frequencies with equal linear or
    logarithmic steps. If the steps are unequal by more than rounding of the last decimal digit can
    cause, the estimate is 0.

    Examples
    --------
    >>> round(estimate_frequency_rounding(np.round(np.linspace(1e3, 2e3, 60))), 2)
    0.28
    >>> estimate_frequency_rounding(np.linspace(1e3, 2e3, 51)) < 1e-9
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


def sum_lead_resistance(elements: Elements) -> float:
    """Return the total resistance [Ohm] of the leads among ``elements``."""
    return sum(e.amplitude for e in elements if e.form == "lead resistance")


def compute_dc_conductance(elements: Elements) -> float:
    """Return the conductance [S] of ``elements`` at zero frequency."""
    parallel = sum(e.conductance for e in elements)
    return parallel / (1 + sum_lead_resistance(elements) * parallel)


def _compute_conductance_slope(elements: Elements, element: FitElement) -> float:
    """Return d(dc conductance) / d(log amplitude) for the amplitude of ``element``."""
    if element.form == "lead resistance":
        return -(compute_dc_conductance(elements) ** 2) * sum_lead_resistance((element,))
    parallel = sum(e.conductance for e in elements)
    return element.conductance / (1 + sum_lead_resistance(elements) * parallel) ** 2
