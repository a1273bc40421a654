"""Certificates of reduced-order models: error estimate, stability and passivity."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.rom.entries import Entries
from kc2spice.rom.error_estimate import errors_above_band
from kc2spice.rom.linear_model import Certificate, LinearModel, make_linear_model
from kc2spice.rom.reduced_basis import LEAST_ERROR, ReducedBasis
from kc2spice.rom.response import FLANK, SHARPEST
from kc2spice.rom.stability import FORM, StabilityProof

# No error estimate of a resonance is below so many eps over its damping ratio: rounding of the
# stiffness by eps moves the response by eps over twice the ratio. The factor is chosen by trial.
ROUNDING_AT_RESONANCE = 4.0
LISTED_ZEROS = 6  # entries of zero by symmetry that a certificate lists; others are counted


def certify(basis: ReducedBasis, order: int) -> LinearModel:
    """Return the reduced-order model of an order with its certificate.

    Raises
    ------
    SimulationError : the model has a state whose rate double precision cannot tell from zero.
    UsageError : the model has no state-space form, which a netlist needs.
    """
    task, response, proof = basis.task, basis.leading(order), basis.proof(order)
    estimator = task.estimator
    error = basis.error(order) + task.intermediate.floor
    if not np.isfinite(error):
        raise SimulationError(
            "the reduced model has a state without stiffness, damping or inertia",
            where=task.fom.name,
            got="matrix entries that are smaller than their rounding errors",
            hint="replace the order by a tolerance: --tolerance 1e-4",
        )
    sharpest = max(estimator.exact.select_visible(task.band)[1].min(initial=1.0), SHARPEST)
    rounding = ROUNDING_AT_RESONANCE * float(np.finfo(float).eps) / sharpest
    certificate = Certificate(
        task.band,
        max(error, LEAST_ERROR, rounding),
        _evidence_text(basis, proof),
        proof.stable,
        proof.passive,
        errors_above_band(task.fom.ports, estimator.exact, response, task.band),
        task.norm,
    )
    labels = {key: getattr(task.fom, key) for key in ("ports", "facts", "name")}
    labels["basis"] = basis.unknowns(order)
    result = make_linear_model(response.pencil, **labels, certificate=certificate, band=task.band)
    result.state_space()  # a model that no netlist can contain is an error
    return result


def with_full_order(rom: LinearModel, full: StabilityProof) -> LinearModel:
    """Return a reduced-order model whose certificate covers the full-order model too."""
    certificate = rom.certificate
    assert certificate is not None
    both = (full.stable, certificate.stable)
    stable = False if False in both else None if None in both else True
    method = certificate.method
    if not full.stable or full.proof != FORM:
        method += f"; stability of the full model from {full.proof}"
    passive = certificate.passive and full.passive
    certificate = replace(certificate, method=method, stable=stable, passive=passive)
    return replace(rom, certificate=certificate)


def _evidence_text(basis: ReducedBasis, proof: StabilityProof) -> str:
    """Return a text on the evidence for the error estimate and for stability."""
    task = basis.task
    exact, estimator = task.intermediate, task.estimator
    count = exact.pencil.size
    method = f"{basis.origin}difference to {count} states at resonances, flanks and notches"
    if exact.proof:
        method += f"; those {exact.proof}; stability from {proof.proof}"
    method += _zeros_text(estimator.reference[1], task.fom)
    if not exact.static or exact.pencil.free:
        method += "; free to move at zero frequency"
        if hidden := exact.hidden:
            method += f", supports that resonate below {hidden:.1e} Hz being hidden by rounding"
    if estimator.exact.select_visible(task.band)[1].min(initial=1.0) < SHARPEST:
        method += f"; beside resonances, by {FLANK:g}, of a damping ratio below {SHARPEST:g}"
    return method


def _zeros_text(entries: Entries, model: LinearModel) -> str:
    """Text on the entries that count as zero."""
    places = zip(*np.nonzero(entries.zero), strict=True)
    names = [f"{model.outputs[i]}/{model.inputs[j]}" for i, j in places]
    if not names:
        return ""
    more = f" and {len(names) - LISTED_ZEROS} more" if len(names) > LISTED_ZEROS else ""
    return f"; zero by symmetry: {', '.join(names[:LISTED_ZEROS])}{more}"
