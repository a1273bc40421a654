"""Certificates of reduced-order models: error estimate, stability and passivity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.rom.error_estimate import estimate_errors_above_band
from kc2spice.rom.linear_model import Certificate, LinearModel, make_linear_model
from kc2spice.rom.reduced_basis import MIN_ERROR_ESTIMATE, ReducedBasis
from kc2spice.rom.response import FLANK_DISTANCE, MIN_DAMPING_RATIO
from kc2spice.rom.stability import DEFINITE_EVIDENCE, StabilityProof
from kc2spice.rom.transfer_function_error_scales import EntryScales

# Smallest error estimate at a resonance, as a multiple of eps / (damping ratio); found by trials.
# A relative rounding error eps of the stiffness changes the response by eps / (2 damping ratio).
RESONANCE_ROUNDING = 4.0
# A certificate lists at most this number of names of entries that are zero by symmetry.
# For further zero entries, the certificate states only their number.
MAX_LISTED_ZEROS = 6


def certify(basis: ReducedBasis, order: int) -> LinearModel:
    """Return the reduced-order model of the given order, with a certificate.

    Raises
    ------
    SimulationError : a state of the model has no stiffness, damping or inertia above rounding
    errors.
    UsageError : the model has no state-space form, so it cannot become a netlist.
    """
    task, response, proof = (
        basis.task,
        basis.get_response_of_order(order),
        basis.prove_order_stability(order),
    )
    estimator = task.estimator
    error = basis.estimate_model_error(order) + task.intermediate.floor
    if not np.isfinite(error):
        raise SimulationError(
            "the reduced model has no finite response: one state has no stiffness, damping or "
            "inertia",
            where=task.fom.name,
            got="matrix entries that are smaller than their rounding errors",
            hint="reduce by a tolerance, such as 1e-4, in place of an order",
        )
    sharpest = max(
        estimator.exact.select_visible_resonances(task.band)[1].min(initial=1.0), MIN_DAMPING_RATIO
    )
    rounding = RESONANCE_ROUNDING * float(np.finfo(float).eps) / sharpest
    certificate = Certificate(
        task.band,
        max(error, MIN_ERROR_ESTIMATE, rounding),
        _describe_evidence(basis, proof),
        proof.stable,
        proof.passive,
        estimate_errors_above_band(task.fom.ports, estimator.exact, response, task.band),
        task.norm,
        basis.method,
        estimator.find_largest_pointwise_error(response) if task.norm == "peak" else None,
    )
    labels = {key: getattr(task.fom, key) for key in ("ports", "facts", "name")}
    labels["basis"] = basis.expand_basis(order)
    result = make_linear_model(response.pencil, **labels, certificate=certificate, band=task.band)
    result.state_space()  # raises an error if no netlist can represent the model
    return result


def certify_with_full_order(rom: LinearModel, full: StabilityProof) -> LinearModel:
    """Update a certificate by the stability and passivity of the full-order model."""
    certificate = rom.certificate
    assert certificate is not None
    both = (full.stable, certificate.stable)
    stable = False if False in both else None if None in both else True
    method = certificate.method
    if not full.stable or full.proof != DEFINITE_EVIDENCE:
        method += f"; stability of the full model {full.evidence}"
    passive = certificate.passive and full.passive
    certificate = replace(certificate, method=method, stable=stable, passive=passive)
    return replace(rom, certificate=certificate)


def _describe_evidence(basis: ReducedBasis, proof: StabilityProof) -> str:
    """Describe the evidence for the error estimate and for stability."""
    task = basis.task
    exact, estimator = task.intermediate, task.estimator
    count = exact.pencil.size
    method = (
        f"{basis.origin}difference from a model of {count} states at resonances, on their flanks "
        "and at response minima"
    )
    if exact.proof:
        method += f"; {exact.proof}; stability {proof.evidence}"
    method += _describe_zeros(estimator.exact_response_and_scales[1], task.fom)
    if not exact.static or exact.pencil.free:
        method += "; free to move at zero frequency"
        if hidden := exact.hidden:
            method += (
                f"; a support with a resonance below {hidden:.1e} Hz is not detectable because of "
                "rounding errors"
            )
    if estimator.exact.select_visible_resonances(task.band)[1].min(initial=1.0) < MIN_DAMPING_RATIO:
        method += (
            f"; at resonances with a damping ratio below {MIN_DAMPING_RATIO:g}, errors are "
            f"computed at a relative frequency offset of {FLANK_DISTANCE:g} from the resonance"
        )
    return method


def _describe_zeros(entries: EntryScales, model: LinearModel) -> str:
    """Return a text that lists the entries of the response that are zero by symmetry."""
    places = zip(*np.nonzero(entries.zero), strict=True)
    names = [f"{model.outputs[i]}/{model.inputs[j]}" for i, j in places]
    if not names:
        return ""
    more = f" and {len(names) - MAX_LISTED_ZEROS} more" if len(names) > MAX_LISTED_ZEROS else ""
    return f"; zero by symmetry: {', '.join(names[:MAX_LISTED_ZEROS])}{more}"
