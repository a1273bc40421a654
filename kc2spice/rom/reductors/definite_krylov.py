"""Rational Krylov subspaces of definite models at zero and at real shifts w^2.

The real matrix ``K - w^2 M`` belongs to both expansion points +j w and -j w, so all vectors and all
factorisations are real. Blocks of vectors are added at one shift w^2 as long as each block changes
the response much less than the previous block. The next shift is at the frequency at which the last
block changed the response most.
"""

from __future__ import annotations

import operator
from dataclasses import replace
from functools import partial

import numpy as np

from kc2spice.core.progress import ConvergenceTimer
from kc2spice.linalg.factor import require_memory_for_factors
from kc2spice.rom.error_estimate import compute_relative_errors
from kc2spice.rom.free_body import FreeBody
from kc2spice.rom.intermediate_model import IntermediateModel, make_no_convergence_error
from kc2spice.rom.pencil import GrowingProjection, Pencil
from kc2spice.rom.reductors.block_krylov import Operator, OrthonormalBasis
from kc2spice.rom.reductors.rational_krylov import CONFIRMATIONS, MAX_VECTORS
from kc2spice.rom.response import GRID_FREQUENCIES, Response, sample_band
from kc2spice.rom.rigid_body import estimate_hidden_frequency
from kc2spice.rom.rounding import add_rounding_floor, estimate_removed_stiffness, find_zero_entries

# Numbers of Krylov blocks, found by trials, after which slow convergence leads to a new expansion
# point: BLOCKS_AT_ZERO at the expansion point zero, BLOCKS_AT_SHIFT at every other expansion point.
# Blocks at the expansion point zero are cheaper, as long as the response converges. The Cholesky
# factor of K takes only a fraction of the time and memory of a factor of the shifted K - w^2 M.
BLOCKS_AT_ZERO = 60
BLOCKS_AT_SHIFT = 3
# Usual number of blocks for solids with several modes in the band.
# The first estimate of the remaining time assumes USUAL_BLOCKS blocks.
USUAL_BLOCKS = 14
# A response change is the largest relative change of the response due to one Krylov block.
# Convergence is slow if (previous response change) / (last response change) < MIN_REDUCTION.
# After slow convergence, the next Krylov block is computed at a new expansion point.
MIN_REDUCTION = 3.0
# smallest distance of two expansion points, relative to the upper band limit
MIN_POINT_DISTANCE = 1e-3


def reduce_definite_model(
    pencil: Pencil,
    band: tuple[float, float],
    target: float,
    limit: float,
    body: FreeBody | None = None,
) -> IntermediateModel:
    """Reduce a definite model to an error of at most ``target`` over ``band`` [Hz].

    If rounding errors keep the error above ``target``, an error of at most ``limit`` is accepted.
    The error estimate is the change of the response by the last block. The estimates of the last
    two blocks must be at most ``target``.

    For an unsupported ``body``, rigid-body modes are deflated, and a small negative shift replaces
    the expansion point zero.

    Raises
    ------
    SimulationError : the error exceeds even ``limit``.
    """
    K, _, M = pencil.coefficients
    projection = GrowingProjection(pencil)
    if body is None:
        solve: Operator = pencil.factorise_shifted_stiffness(0.0).solve
        space = OrthonormalBasis(partial(operator.matmul, K), pencil.size)
        candidates = pencil.static_response
    else:
        solve = body.solve
        space = OrthonormalBasis(body.apply_shifted_stiffness, pencil.size)
        space.append(body.vectors)
        projection.extend(space.vectors, K @ space.vectors, M @ space.vectors)
        candidates = solve(pencil.B)
    used, met, change, before = [0.0], 0, np.inf, np.inf
    blocks = BLOCKS_AT_ZERO
    previous: Response | None = None
    timer = ConvergenceTimer(target, CONFIRMATIONS, USUAL_BLOCKS, "Krylov block")
    while space.vectors.shape[1] < MAX_VECTORS:
        columns, images = space.extend(candidates)
        V, inertia = space.vectors, M @ columns
        projection.extend(V, images if body is None else K @ columns, inertia)
        small, basis = projection.pencil, V
        if body is not None:
            small, coordinates = body.separate_rigid_body_modes(projection.pencil, V)
            basis = V @ coordinates
        response = Response(small)
        response.zero = find_zero_entries(pencil, basis, response, band)
        # Some samples are beside resonances, because notches are often close to resonances.
        # As Krylov blocks are added, the relative error at notches is the last to become small.
        frequency = sample_band(response, band, GRID_FREQUENCIES, not small.free, (0.0, 1.0, 4.0))
        s = 2j * np.pi * frequency
        H = response.transfer(s)
        size = np.ones((len(s), 1, 1))
        if previous is not None:
            entries = response.compute_error_scales(frequency, H)
            size = compute_relative_errors(previous.transfer(s) - H, H, entries)
        before, change = change, float(size.max())
        met = met + 1 if change <= target else 0
        timer.end_step(change if previous is not None else np.inf)
        if met == CONFIRMATIONS or (not columns.shape[1] and change <= limit):
            proof = f"more states change the response by {change:.0e}"
            result = IntermediateModel(
                response, change, True, proof, basis=basis, points=tuple(used)
            )
            if small.free:
                hidden = estimate_hidden_frequency(pencil, basis[:, : small.free], band[0])
                floor = estimate_removed_stiffness(projection.pencil, small, band)
                result = replace(result, floor=floor, hidden=hidden)
            return add_rounding_floor(pencil, basis, band, result, target)
        previous = response
        blocks -= 1
        if columns.shape[1] and (blocks >= 0 or change <= before / MIN_REDUCTION):
            candidates = solve(inertia)
            continue
        distant = (
            np.abs(frequency[:, None] - np.array(used)).min(axis=1) > MIN_POINT_DISTANCE * band[1]
        )
        if not distant.any():
            break
        worst = float(frequency[np.argmax(np.where(distant, size.max(axis=(1, 2)), -1.0))])
        used.append(worst)
        blocks = BLOCKS_AT_SHIFT - 1
        require_memory_for_factors(pencil.assemble_bordered_matrix(1.0, 1.0, 1.0))
        solve = pencil.factorise_shifted_stiffness((2 * np.pi * worst) ** 2).solve
        candidates = solve(pencil.B)
    raise make_no_convergence_error(response, band, change, limit)
