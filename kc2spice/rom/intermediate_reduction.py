"""First step of a reduction: a very accurate intermediate model.

The method depends on the full model:

* Small models: the whole model in dense form.
* Definite models and free bodies, undamped or with proportional damping:
  :mod:`kc2spice.rom.reductors.definite_krylov`.
* Ill-conditioned dense first-order models: :mod:`kc2spice.rom.reductors.ill_conditioned_models`.
* All other models: :mod:`kc2spice.rom.reductors.rational_krylov`.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError
from kc2spice.linalg.factor import require_memory_for_factors
from kc2spice.rom.definiteness import allows_cholesky, is_definite
from kc2spice.rom.error_estimate import compute_relative_errors, make_inaccuracy_error
from kc2spice.rom.free_body import split_free_body
from kc2spice.rom.intermediate_model import IntermediateModel
from kc2spice.rom.pencil import Pencil, SchurComplement, is_symmetric
from kc2spice.rom.reductors.definite_krylov import reduce_definite_model
from kc2spice.rom.reductors.ill_conditioned_models import reduce_by_samples
from kc2spice.rom.reductors.rational_krylov import (
    MANY_POINTS,
    MAX_POINTS,
    reduce_by_rational_krylov,
)
from kc2spice.rom.response import (
    FLANK_DISTANCE,
    MIN_DAMPING_RATIO,
    Response,
    drop_points_near_poles,
    make_frequency_grid,
)
from kc2spice.rom.rigid_body import (
    estimate_hidden_frequency,
    project_with_rigid_body,
    split_rigid_body,
)
from kc2spice.rom.rounding import (
    CHECKED_RESONANCES,
    TRIAL_FACTOR,
    describe_uncertainty,
    estimate_removed_stiffness,
    estimate_rounding_uncertainty,
    find_zero_entries,
)
from kc2spice.rom.stability import is_dissipative

# Modes of models with more unknowns are not computed with 19 digits, to limit the time.
MAX_EXTENDED_UNKNOWNS = 500
# Small full models are used without reduction; the limits of their size were found by trials.
# largest number of unknowns of a full model that is used without reduction, if a congruence
# decouples the model
MAX_COMPLETE_DECOUPLED = 1300
# Largest number of first-order states of a full model that is used without reduction.
# The limit MAX_COMPLETE_STATES applies to models that no congruence decouples.
MAX_COMPLETE_STATES = 600
# Largest number of first-order states of a full model that is used without reduction.
# The limit MAX_DENSE_STATES applies to models with too many resonances for a Krylov method.
MAX_DENSE_STATES = 2000
# largest number of unknowns of a model whose equations are solved at each frequency separately
MAX_DIRECT_UNKNOWNS = 150


def build_intermediate_model(
    pencil: Pencil,
    band: tuple[float, float],
    target: float,
    limit: float,
    *,
    deflated: bool = True,
) -> IntermediateModel:
    """Build an intermediate model with a relative error of at most ``target``.

    If solutions of the full model have rounding errors above ``target``, an error of at most
    ``limit`` is accepted. If ``deflated`` is true, the rigid-body modes of a free body are
    separated from the other modes, which reduces the number of states.

    Raises
    ------
    SimulationError : the error exceeds ``limit``.
    """
    if pencil.size <= MAX_COMPLETE_DECOUPLED:
        full = pencil.scale_unknowns(2 * np.pi * band[1]).make_dense()
        complete, inaccurate = None, None
        try:
            complete = _use_full_order(full, band, limit)
        except SimulationError as error:
            inaccurate = error
        sound = complete is not None and complete.response.is_decoupled
        # If the stored energy is proven positive, the error of a congruence decreases with more
        # vectors. Without a proof of positive energy, the error of a congruence decreases only if
        # the modes are well-conditioned.
        if pencil.degree == 1 and not sound and not is_dissipative(full):
            try:
                return reduce_by_samples(full, band, target, limit)
            except SimulationError:
                pass  # the model has rigid-body modes, or too many resonances
        if inaccurate is not None:
            raise inaccurate
        if complete is not None:
            return _restore_units(pencil, band, complete)
    if (result := _build_definite_model(pencil, band, target, limit, deflated)) is not None:
        return result
    if allows_cholesky(pencil):  # so far, only the memory of a Cholesky factor has been checked
        require_memory_for_factors(pencil.assemble_bordered_matrix(1.0, 1.0, 1.0))
    scaled = pencil.scale_unknowns(2 * np.pi * band[1])
    states = pencil.degree * pencil.size
    moderate = MAX_COMPLETE_STATES < states <= MAX_DENSE_STATES
    points = MANY_POINTS if moderate else MAX_POINTS
    if not (moderate and pencil.is_dense and pencil.degree == 1):
        try:
            result = reduce_by_rational_krylov(scaled, band, target, limit, points)
            return _restore_units(pencil, band, result)
        except SimulationError:
            if not moderate:
                raise
    complete = _use_full_order(scaled.make_dense(), band, limit, MAX_DENSE_STATES)
    result = complete or reduce_by_rational_krylov(scaled, band, target, limit, MAX_POINTS)
    return _restore_units(pencil, band, result)


def _build_definite_model(
    pencil: Pencil, band: tuple[float, float], target: float, limit: float, deflated: bool
) -> IntermediateModel | None:
    """Build the intermediate model of a definite pencil or of a free body.

    Return None for other models. For a model with electric potentials, the function searches for
    rigid-body modes before it factorises the stiffness matrix K, because the search is faster than
    the factorisation. If a factor of K already exists, the definiteness of K is tested first.
    """
    omega, body = 2 * np.pi * band[1], None
    if (
        deflated
        and isinstance(pencil.coefficients[0], SchurComplement)
        and not pencil.is_factorised
    ):
        body = split_free_body(pencil, omega)
    if body is None and not is_definite(pencil, undamped_too=True):
        body = split_free_body(pencil, omega) if deflated else None
        if body is None:
            return None
    return reduce_definite_model(pencil, band, target, limit, body)


def _restore_units(
    pencil: Pencil, band: tuple[float, float], result: IntermediateModel
) -> IntermediateModel:
    """Convert the basis of a scaled intermediate model to the units of the pencil.

    ``result`` is the intermediate model of ``pencil.scale_unknowns(...)``.
    """
    if result.basis is None:
        return result
    units = pencil.choose_units(2 * np.pi * band[1])
    return replace(result, basis=units[:, None] * result.basis)


def _use_full_order(
    full: Pencil, band: tuple[float, float], limit: float, most: int = MAX_COMPLETE_STATES
) -> IntermediateModel | None:
    """Use a small full-order model as the intermediate model, without reduction.

    Return None if evaluating the response of the model would take too long.

    Raises
    ------
    SimulationError : the response is inaccurate. Solutions with two elimination orders, or direct
        and modal solutions, differ by more than ``limit``.
    """
    original = full
    full, V, static, projected = split_rigid_body(original, 2 * np.pi * band[1])
    hidden = estimate_hidden_frequency(original, V[:, : full.free], band[0]) if static else 0.0
    T = _compute_undamped_modes(full.without_rigid_body_modes) if static else None
    if T is not None:
        V = V @ scipy.linalg.block_diag(np.eye(full.free), T)
        full, projected = project_with_rigid_body(original, V, full.free)
    response = Response(full)
    response.zero = find_zero_entries(original, V, response, band)
    if not response.has_decoupling_congruence and (
        full.degree * full.size > most
        or (full.size > MAX_DIRECT_UNKNOWNS and not response.is_decoupled)
    ):
        return None
    error, floor, rounded = _estimate_solution_error(response, band), 0.0, 0.0
    at, ratio = response.select_visible_resonances(band)
    note = ""
    if at.size:
        looked = np.union1d(
            np.argsort(at)[:CHECKED_RESONANCES], np.argsort(ratio)[:CHECKED_RESONANCES]
        )
        at = at[looked] * (1 + FLANK_DISTANCE * (ratio[looked] < MIN_DAMPING_RATIO))
        s, states, dual = 2j * np.pi * at, None, None
        if T is not None:
            states = V @ response.states(s)
        elif response.modes is not None and original is full:
            states, dual = response.states(s), response.dual_response.states(s)
        size = estimate_rounding_uncertainty(original, at, states, dual, response.zero)
        rounded = TRIAL_FACTOR * float(size.max())
        if T is not None:
            note = describe_uncertainty(at, size, 2 * limit)
        # The response has rounding errors if linear equations are solved or matrices are projected.
        if T is None or full.free or full.size < original.size:
            floor = rounded
    if error > max(limit, rounded):
        raise make_inaccuracy_error(
            "the solution of the full model is too inaccurate",
            f"two direct solutions differ by {error:.1e}",
            limit,
            "increase the tolerance; other units or fewer elements may also help",
        )
    proof = f"compared with all states of the full model, solved with an error of {error:.0e}{note}"
    # At this point, only rounding errors of the matrices can cause an error above the limit.
    error = min(error, limit)
    if projected is not None:
        floor = max(floor, estimate_removed_stiffness(projected, full, band))
    return IntermediateModel(
        response,
        error,
        static,
        proof,
        floor,
        complete=True,
        hidden=hidden,
        basis=V[: original.size],
    )


def _compute_undamped_modes(full: Pencil) -> np.ndarray | None:
    """Compute the modes (n, n) of a model of moderate size.

    Return None if K or M is not symmetric and positive definite. Also return None for a first-order
    model, and for a model of more than :data:`MAX_EXTENDED_UNKNOWNS` unknowns.
    """
    if full.degree == 1 or full.size > MAX_EXTENDED_UNKNOWNS:
        return None
    K, _, M = full.coefficients
    if not (is_symmetric(K) and is_symmetric(M)):
        return None
    try:
        values, T = scipy.linalg.eigh(M, K)
    except np.linalg.LinAlgError:
        return None
    return np.asarray(T) if values.min() > 0 else None


def _estimate_solution_error(response: Response, band: tuple[float, float]) -> float:
    """Return the largest relative difference between direct and modal solutions.

    Direct solutions with two elimination orders are compared with modal solutions.
    """
    full = response.pencil
    at, ratio = response.select_visible_resonances(band)
    sharpest = at[np.argsort(ratio)[:1]] * (
        1 + FLANK_DISTANCE * (ratio.min(initial=1.0) < FLANK_DISTANCE)
    )
    points = np.r_[band[1], 0.31 * band[0] + 0.69 * band[1], sharpest]
    s = 2j * np.pi * points
    coarse = drop_points_near_poles(
        make_frequency_grid(band, 50, False), *response.select_band_resonances(band)
    )
    everywhere = 2j * np.pi * coarse
    entries = response.compute_error_scales(coarse)
    flipped = Pencil(
        tuple(P[::-1, ::-1] for P in full.coefficients), full.B[::-1], full.C[:, ::-1], full.D
    )
    result = [full.transfer(s), flipped.transfer(s), response.transfer(s)]
    apart = [compute_relative_errors(one - result[0], result[0], entries) for one in result[1:]]
    counted = ~response.mask_cancelled_entries(everywhere) | entries.zero
    return float(np.array(apart)[..., counted].max(initial=0.0))
