"""Fit of a passive circuit to a measured one-port.

The circuit consists of parallel branches in series with leads. The circuit is passive if all
amplitudes G, C0, g_i, a_k and c_j are at least zero (s = j w)::

    Y_p(s) = G + s C0 + sum_i g_i / (1 + s t_i) + sum_k s a_k / (1 + s t_k)
               + sum_j s c_j w_j^2 / (s^2 + d_j s + w_j^2)
    1 / Y(s) = R + s L + 1 / Y_p(s)

The elements in parallel are:

* a resistor G and a capacitor C0,
* branches of R and L in series (windings with eddy currents),
* branches of R and C in series (the loss of a dielectric),
* Butterworth-Van Dyke branches (C = c_j, L = 1 / (c_j w_j^2), R = d_j L).

The leads in series with all branches have the resistance R and the inductance L. If the impedance
of a part is capacitive at the lowest frequencies, the part blocks direct current, and G and g_i are
omitted.

The fit minimises the sum of squares of log(Y / Y_measured) over the logarithms of all parameters
(Levenberg and Marquardt; J. J. More, Lecture Notes in Mathematics 630 (1978) 105). For small
deviations, log(Y / Y_measured) is the relative deviation of Y. As the fitted admittance Y
approaches zero, the magnitude of log(Y / Y_measured) grows without limit, but the relative
deviation of Y only approaches 1.

Elements are added one by one. The start value for the frequency of a resonance is the frequency of
the largest conductance that no element describes yet. The start values for the time constants of
R-C branches and of R-L branches are on a logarithmic grid. The start values of leads are fractions
of the largest possible lead impedance. An element remains if the element reduces the Bayesian
information criterion (G. Schwarz, Ann. Statist. 6 (1978) 461). An element is removed if the removal
reduces the criterion. Series leads, R or L, replace branches whose resonance or corner frequency is
above the band.

Rounding errors of the samples do not change the number of elements. Each sum of elements is fitted
completely before the criterion is evaluated. If two sums of elements have equal Bayesian
information criteria, the fit selects the sum that was tried first. The search ends if rounding
errors of the sampled frequencies explain the deviation from the samples.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from kc2spice.rom.element_fit import (
    CONDUCTING_FORMS,
    LEAD_FORMS,
    PARALLEL_FORMS,
    SIMPLER_FORMS,
    AdmittanceSamples,
    Elements,
    FitElement,
)
from kc2spice.rom.linear_model import Certificate, LinearModel
from kc2spice.rom.one_port_network import IDEAL_LEAD, CircuitBranch, ParallelBranches

MAX_ELEMENTS = 40
MIN_IMPROVEMENT = 0.1  # minimum relative reduction of the deviation per added element
# the search ends after this number of successive elements with improvements < MIN_IMPROVEMENT
PATIENCE = 2
# While the deviation of the fit exceeds POOR_DEVIATION, the search ends after this number of
# successive elements with improvements < MIN_IMPROVEMENT.
POOR_PATIENCE = 5
POOR_DEVIATION = 0.2  # relative rms deviation above which a fit is poor
START_Q_FACTORS = (5.0, 30.0, 200.0, 1500.0)  # start values of the Q factor of a resonance
# start values of a lead impedance, as fractions of the largest possible lead impedance
LEAD_SHARES = (1e-3, 0.03, 0.5)
STARTS_PER_DECADE = 2  # number of start values in each decade of time constants
# largest numbers of residual evaluations in the fit of a candidate circuit and in the final fit
SELECTION_EVALUATIONS = 100
FINAL_EVALUATIONS = 400
# smaller differences of the information criterion are insignificant (Kass and Raftery, 1995)
CRITERION_TOLERANCE = 2.0
# a simpler element replaces a resonance if (frequency / end of the band) exceeds this ratio
MAX_FREQUENCY_RATIO = 3.0
# longest time constant, relative to the reciprocal of the lowest angular frequency
MAX_TIME_RATIO = 1e4
MAX_Q = 1e7  # largest Q factor, for resonances without measurable loss


def fit_one_port(
    f: np.ndarray, Y: np.ndarray, noise: float, conductance: float | None = None
) -> tuple[LinearModel | None, float]:
    """Fit a circuit to admittances ``Y`` (n,) [S] at ``f`` (n,) [Hz].

    Return the model, with one electrical port ``anode``, and the relative rms deviation of the
    model from the samples. If the rms deviation exceeds :data:`POOR_DEVIATION`, the first result is
    None. The error estimate in the certificate is the largest relative deviation from the samples.

    Parameters
    ----------
    noise : relative standard deviation of the real or imaginary part of Y, for the certificate.
    conductance : conductance at zero frequency [S]: 0 for a part that blocks direct current, None
    if the samples determine the conductance.
    """
    samples = AdmittanceSamples(f, Y, conductance)
    elements = fit_branches(samples)
    rms = samples.compute_rms_deviation(elements) if elements else np.inf
    if rms > POOR_DEVIATION:
        return None, rms
    network = _make_network(elements)
    deviation = np.abs(network.admittance(f) / Y - 1)
    largest = int(np.argmax(deviation))
    error, dc = float(deviation[largest]), network.conductance
    origin = "extrapolated from the lowest frequencies" if conductance is None else "as stated"
    resonances = sum(element.form == "resonant" for element in elements)
    text = (
        f"{len(elements)} elements, {resonances} of them resonances, fitted to {len(f)} samples: "
        f"largest deviation {error:.2g} at {f[largest]:.6g} Hz, rms {rms:.2g}, noise of the "
        f"samples {np.sqrt(2) * noise:.2g}; "
        + (f"{1 / dc:.4g} Ohm at zero frequency, {origin}" if dc else "no direct current flows")
    )
    certificate = Certificate((float(f[0]), float(f[-1])), error, text, True, True)
    return network.to_linear_model(certificate), rms


def _make_network(elements: Elements) -> ParallelBranches:
    """Make the circuit of the parallel elements and leads in ``elements``.

    Resonant branches come first, in ascending frequency. If there is only one branch, the leads
    become a part of this branch.
    """
    capacitance = sum(float(np.exp(e.logs[0])) for e in elements if e.form == "capacitance")
    order = sorted(
        (e for e in elements if e.is_in_parallel and e.form != "capacitance"),
        key=lambda e: (e.form != "resonant", e.form, e.logs[1:]),
    )
    branches = tuple(element.make_branch() for element in order)
    if not branches:  # a model needs at least one unknown
        branches, capacitance = (CircuitBranch(0.0, elastance=1 / capacitance),), 0.0
    leads = [element.make_branch() for element in elements if not element.is_in_parallel]
    lead = CircuitBranch(sum(b.resistance for b in leads), sum(b.inductance for b in leads))
    if len(branches) == 1 and capacitance == 0:
        resistance = branches[0].resistance + lead.resistance
        inductance = branches[0].inductance + lead.inductance
        branches, lead = (CircuitBranch(resistance, inductance, branches[0].elastance),), IDEAL_LEAD
    return ParallelBranches(capacitance, branches, lead)


def fit_branches(samples: AdmittanceSamples) -> Elements:
    """Return a circuit with few elements that fits the samples within their noise."""
    elements: Elements = ()
    best, least, useless = elements, np.inf, 0
    patience = POOR_PATIENCE
    while len(elements) < MAX_ELEMENTS and useless < patience:
        ends = list(map(samples.refine_elements, _propose_start_circuits(samples, elements)))
        ends = [end for end in ends if _exceeds_noise(samples, end)]
        if not ends:
            break
        elements = samples.refine_elements(
            _select_best_circuit(samples, ends), SELECTION_EVALUATIONS
        )
        elements = _simplify_circuit(samples, elements, _select_outside_band(samples, elements))
        value = samples.compute_information_criterion(elements)
        enough = _count_parameters(elements) <= _count_parameters(best)
        enough |= not best or samples.compute_rms_deviation(elements) < (
            1 - MIN_IMPROVEMENT
        ) * samples.compute_rms_deviation(best)
        if value < least - CRITERION_TOLERANCE and enough:
            best, least, useless = elements, value, 0
        else:
            useless += 1
        patience = (
            PATIENCE if samples.compute_rms_deviation(best) < POOR_DEVIATION else POOR_PATIENCE
        )
        if samples.is_within_tolerance(best):
            break
    best = samples.refine_elements(_simplify_circuit(samples, best, best), FINAL_EVALUATIONS)
    slowest = np.log(MAX_TIME_RATIO / (2 * np.pi * samples.f[0]))
    return best if samples.conductance else tuple(_limit_element(e, slowest) for e in best)


def _count_parameters(elements: Elements) -> int:
    """Return the total number of parameters of all elements of a circuit."""
    return sum(len(e.logs) for e in elements)


def _select_best_circuit(samples: AdmittanceSamples, ends: Sequence[Elements]) -> Elements:
    """Select the circuit with the smallest information criterion.

    Criteria that differ by less than ``CRITERION_TOLERANCE`` count as equal, so that rounding
    errors do not change the selection. If several circuits have equal criteria, the first circuit
    is selected.
    """
    values = list(map(samples.compute_information_criterion, ends))
    good = (
        end
        for end, value in zip(ends, values, strict=True)
        if value < min(values) + CRITERION_TOLERANCE
    )
    return next(good)


def _limit_element(element: FitElement, slowest: float) -> FitElement:
    """Limit the time constant and the Q factor of an element.

    ``slowest`` is the logarithm of the largest time constant [s], and :data:`MAX_Q` is the largest
    Q factor. The samples do not determine a time constant or a Q factor above its limit. Limiting
    an element does not change its admittance Y in the band.
    """
    amplitude, *others = element.logs
    excess = _compute_log_time(element) - slowest if others else 0.0
    if element.form == "resonant":
        w, d = others
        if excess > 0:  # the inductance L = 1 / (c w^2) remains the same
            amplitude, w = amplitude - 2 * excess, w + excess
        return FitElement(element.form, (amplitude, w, max(d, w - float(np.log(MAX_Q)))))
    if excess <= 0:
        return element
    # A shorter time constant leaves the inductance of an R-L branch, or the resistance of an R-C
    # branch, unchanged.
    return FitElement(element.form, (amplitude - excess, others[0] - excess))


def _select_outside_band(samples: AdmittanceSamples, elements: Elements) -> Elements:
    """Select the elements whose frequencies are outside of the band.

    The selected elements can be replaced by simpler elements, which have almost the same admittance
    within the band.
    """
    low = np.log(2 * np.pi * samples.f[0] / MAX_FREQUENCY_RATIO)
    high = np.log(2 * np.pi * samples.f[-1] * MAX_FREQUENCY_RATIO)
    timed = [e for e in elements if len(e.logs) > 1]
    return tuple(e for e in timed if not low < -_compute_log_time(e) < high)


def _compute_log_time(element: FitElement) -> float:
    """Return log(time constant [s]) of an element; for a resonance, log(1 / omega)."""
    return -element.logs[1] if element.form == "resonant" else element.logs[1]


def _exceeds_noise(samples: AdmittanceSamples, elements: Elements) -> bool:
    """Return whether every element has an effect above the noise.

    The effect of each element must exceed the rms deviation at more samples than the element has
    parameters.
    """
    left = -np.expm1(-samples.compute_rms_deviation(elements))  # rms deviation relative to Y
    return all(
        np.count_nonzero(np.abs(by_amplitude) > left) > len(others) + 1
        for by_amplitude, *others in samples.compute_log_slopes(elements)
    )


def _simplify_circuit(
    samples: AdmittanceSamples, elements: Elements, doubtful: Elements
) -> Elements:
    """Remove or simplify doubtful elements if this reduces the information criterion."""
    value = samples.compute_information_criterion(elements)
    for element in doubtful:
        for fewer in _propose_simpler_circuits(samples, elements, element):
            end = samples.refine_elements(fewer)
            if end and samples.compute_information_criterion(end) < value:
                return _simplify_circuit(samples, end, end)
    return elements


def _propose_simpler_circuits(
    samples: AdmittanceSamples, elements: Elements, element: FitElement
) -> Iterable[Elements]:
    """Yield circuits in which ``element`` is omitted or replaced by a simpler element.

    In the band, the simpler element has almost the same admittance as the replaced element.
    """
    others = tuple(e for e in elements if e is not element)
    if any(e.is_in_parallel for e in others):
        yield others
    for form in SIMPLER_FORMS[element.form]:
        if samples.conducts_direct_current or form not in CONDUCTING_FORMS:
            replaced = samples.fit_amplitudes((*others, _convert_form(element, form)))[0]
            if len(replaced) == len(elements):
                yield replaced
    present = {e.form for e in others}
    for elements in _replace_by_leads(element, others):
        if elements[-1].form not in present:
            yield elements


def _replace_by_leads(element: FitElement, others: Elements) -> Iterable[Elements]:
    """Yield circuits in which a series lead, R or L, replaces one parallel element.

    A series resistance R or inductance L can replace a parallel branch whose resonance or corner
    frequency is above the band. At low frequencies, leads in series with C0 have the same effect as
    branches in parallel with C0::

    s C0 / (1 + s R C0 + s^2 L C0) = s C0 - s^2 R C0^2 - s^3 L C0^2 + ...
    s c w^2 / (s^2 + d s + w^2) = s c - s^2 c d / w^2 - s^3 c / w^2 + ...
    s a / (1 + s t) = s a - s^2 a t + ...
    """
    if element.form not in ("resonant", "relaxing"):
        return
    log_c, *times = element.logs
    total = float(np.logaddexp.reduce([log_c, *(e.logs[0] for e in others if _is_capacitance(e))]))
    clamped = *(e for e in others if not _is_capacitance(e)), FitElement("capacitance", (total,))
    scale = log_c - 2 * total
    if element.form == "relaxing":
        yield (*clamped, FitElement("lead resistance", (scale + times[0],)))
    else:
        log_w, log_d = times
        yield (*clamped, FitElement("lead inductance", (scale - 2 * log_w,)))
        yield (*clamped, FitElement("lead resistance", (scale + log_d - 2 * log_w,)))


def _is_capacitance(element: FitElement) -> bool:
    """Return whether a circuit element has the form ``capacitance``."""
    return element.form == "capacitance"


def _convert_form(element: FitElement, form: str) -> FitElement:
    """Make an element of the simpler ``form`` with the time constant of ``element``."""
    if form in ("conductance", "capacitance"):
        return FitElement(form, (0.0,))
    log_t = element.logs[2] - 2 * element.logs[1]  # time constant R C = d / w^2 of the branch
    return FitElement(form, (0.0, -element.logs[2] if form == "inductive" else log_t))


def _propose_start_circuits(samples: AdmittanceSamples, elements: Elements) -> list[Elements]:
    """Propose start circuits of the next fits: the circuit with added elements."""
    result = [_fit_peak(samples, elements)]
    for options in _propose_elements(samples, elements):
        tried = [samples.fit_amplitudes((*elements, option)) for option in options]
        result.append(min(tried, key=lambda item: item[1])[0])
    result += [samples.fit_amplitudes(item)[0] for item in _split_resonance(samples, elements)]
    return list(filter(None, result))


def _fit_peak(samples: AdmittanceSamples, elements: Elements) -> Elements:
    """Add a resonance at the largest conductance that no element describes yet.

    The added resonance has the same height and the same width at half height as the peak of the
    conductance. If the sum of elements has no capacitance, a capacitance is also added.
    """
    missing = samples.unexplained_admittance(elements)
    top = int(np.argmax(missing.real))
    if missing.real[top] <= 0:
        return ()
    below = np.flatnonzero(missing.real < 0.5 * missing.real[top])
    first = max((k for k in below if k < top), default=0)
    last = min((k for k in below if k > top), default=len(missing) - 1)
    w, d = 2 * np.pi * samples.f[top], 2 * np.pi * (samples.f[last] - samples.f[first]) / 2
    resonance = FitElement("resonant", tuple(np.log([missing.real[top] * d / w**2, w, d]).tolist()))
    if any(e.form == "capacitance" for e in elements):
        return (*elements, resonance)
    rest = missing - resonance.response(samples.s)[0]
    clamped = float(np.median(rest.imag / (2 * np.pi * samples.f)))
    more = (FitElement("capacitance", (float(np.log(clamped)),)),) if clamped > 0 else ()
    return (*elements, resonance, *more)


def _propose_elements(samples: AdmittanceSamples, elements: Elements) -> Iterable[list[FitElement]]:
    """Propose circuit elements; each list contains start values of one new element."""
    present = {element.form for element in elements}
    forms = [
        form
        for form in PARALLEL_FORMS
        if samples.conducts_direct_current or form not in CONDUCTING_FORMS
    ]
    low, high = 2 * np.pi * samples.f[0], 2 * np.pi * samples.f[-1]
    decades = int(np.ceil(STARTS_PER_DECADE * np.log10(100 * high / low))) + 1
    times = -np.log(np.geomspace(low / 10, high * 10, decades))
    for form in ("conductance", "capacitance"):
        if form in forms and form not in present:
            yield [FitElement(form, (0.0,))]
    for form in ("inductive", "relaxing"):
        if form in forms:
            yield [FitElement(form, (0.0, float(t))) for t in times]
    for w in _find_worst_frequencies(samples, elements):
        yield [FitElement("resonant", (0.0, np.log(w), np.log(w / Q))) for Q in START_Q_FACTORS]
    if elements:
        for form in LEAD_FORMS:
            if form not in present:
                yield from ([lead] for lead in _propose_leads(samples, form))


def _propose_leads(samples: AdmittanceSamples, form: str) -> list[FitElement]:
    """Propose start values for the series resistance or inductance of the leads.

    The start values are fractions of the largest possible lead impedance. The impedance of a lead
    cannot exceed the measured impedance of any sample.
    """
    per_unit = FitElement(form, (0.0,)).response(samples.s)[0]
    largest = float(np.min(np.abs(1 / (per_unit * samples.Y))))
    return [FitElement(form, (float(np.log(share * largest)),)) for share in LEAD_SHARES]


def _find_worst_frequencies(samples: AdmittanceSamples, elements: Elements) -> list[float]:
    """Return up to three angular frequencies [rad/s] at which ``elements`` fit worst.

    At these frequencies, the missing conductance, the ratio (missing conductance / abs(Y)), or the
    deviation is largest.
    """
    left = samples.compute_deviation(elements)
    missing = samples.unexplained_admittance(elements).real
    at = (missing, missing / np.abs(samples.Y), np.abs(left))
    indices = dict.fromkeys(int(np.argmax(item)) for item in at)
    return [float(2 * np.pi * samples.f[k]) for k in indices]


def _split_resonance(samples: AdmittanceSamples, elements: Elements) -> list[Elements]:
    """Replace the resonance nearest to the largest deviation by two resonances.

    The frequencies of the two resonances differ by half of the width of the replaced resonance.
    """
    resonant = [e for e in elements if e.form == "resonant"]
    if not resonant:
        return []
    worst = np.log(np.abs(samples.s[int(np.argmax(np.abs(samples.compute_deviation(elements))))]))
    nearest = min(resonant, key=lambda e: abs(e.logs[1] - worst))
    log_c, log_w, log_d = nearest.logs
    apart = float(0.25 * np.exp(log_d - log_w))
    pair = [
        FitElement("resonant", (log_c, log_w + shift, log_d - 0.5)) for shift in (-apart, apart)
    ]
    return [(*(e for e in elements if e is not nearest), *pair)]
