"""Tolerance in, order out: a generous Krylov model first, then as few of its states as suffice.

Stage one adds Krylov blocks, at s0 = 0 while that pays and else where the residual is largest,
until the residual estimate is far below the tolerance. Stage two keeps the exact static vectors
of all ports and adds the proper orthogonal directions of the model's own frequency response, each
snapshot relative to its port's response. Frequencies above the band count with a small weight:
contact excites them, and a basis fitted to the band alone is erratic there.
"""

from __future__ import annotations

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.fem.piezo.operator import ShiftedSolver
from kc2spice.rom.krylov import extend
from kc2spice.rom.model import ReducedModel
from kc2spice.rom.project import certify, project, project_again
from kc2spice.rom.residual import ResidualEstimator
from kc2spice.rom.response import (
    FLOOR,
    frequency_response,
    relative_error,
    relative_size,
    states,
)
from kc2spice.rom.schur import CondensedSystem

FIT, CHECK = 101, 211  # samples: the error is judged at frequencies that no snapshot was taken at
HEADROOM = 0.03  # of the tolerance is left to the first stage
GAIN = 3.0  # a block that improves less than this calls for another expansion point
START = 4  # blocks before convergence is judged
STATES = 600
TAIL = 8.0  # snapshots reach so many times the band's upper edge
TAIL_SAMPLES = 150
TAIL_DECAY = 4  # power of the fall of the tail's weight: contact forces are smooth on the whole
TAIL_WEIGHTS = 4e-3, 1e-2  # less makes launches erratic, more costs states within the band
TAIL_PER_ROOT = 8.0  # ... and per root of the tolerance, as errors go with its square


def reduce_to_tolerance(
    model: CondensedSystem, band: tuple[float, float], tolerance: float
) -> ReducedModel:
    """Fewest states found whose estimated relative error over ``band`` is below ``tolerance``.

    The estimate is the difference to the first stage plus that stage's residual estimate, the
    largest over all port pairs and ``CHECK`` frequencies.

    Raises
    ------
    SimulationError : the tolerance is out of reach of double precision or of ``STATES`` states.
    """
    check = np.linspace(*band, CHECK)
    large, residual = krylov_model(model, check, HEADROOM * tolerance)
    exact = frequency_response(large, check)
    ordered = directions(large, band, tolerance)
    for order in range(min(large.B.shape[1], large.order), large.order + 1):
        reduced = project_again(large, ordered[:, :order])
        error = relative_error(frequency_response(reduced, check), exact) + residual
        if error <= tolerance:
            method = f"difference to {large.order} states, and their residual"
            return certify(reduced, band, error, method)
    raise _out_of_reach(tolerance, error, large.order)


def krylov_model(
    model: CondensedSystem, frequency: np.ndarray, tolerance: float
) -> tuple[ReducedModel, float]:
    """Stage one: the projected model and its largest relative residual estimate at ``frequency``.

    Expansion at s = j w uses the real pencil K - w^2 M, which serves the pair of points +-j w.

    Raises
    ------
    SimulationError : neither ``STATES`` states nor every frequency as a point reach the tolerance.
    """
    solver, error = model.static, np.inf
    untried = np.ones(len(frequency), dtype=bool)
    V = images = flexible = np.empty((model.B.shape[0], 0))
    candidates = model.solve(model.B)
    while V.shape[1] < STATES:
        columns, column_images = extend(V, images, candidates, model.stiffness)
        V, images = np.hstack([V, columns]), np.hstack([images, column_images])
        flexible = np.hstack([flexible, model.solve(model.mass(columns))])
        before = error
        reduced = project(model, V)
        estimate = ResidualEstimator(model, V, flexible).error(reduced, frequency)
        size = relative_size(estimate, frequency_response(reduced, frequency))
        error = float(size.max())
        if error <= tolerance:
            return reduced, error
        if columns.shape[1] and (len(V.T) <= START * len(model.B.T) or error < before / GAIN):
            candidates = solver.solve(model.mass(columns))
            continue
        worst = int(np.argmax(np.where(untried, size.max(axis=(1, 2)), -1.0)))
        if not untried[worst]:
            break
        untried[worst] = False
        solver = ShiftedSolver(model.system, -((2 * np.pi * frequency[worst]) ** 2), 1.0)
        candidates = solver.solve(model.B)
    raise _out_of_reach(tolerance, error, V.shape[1])


def directions(large: ReducedModel, band: tuple[float, float], tolerance: float) -> np.ndarray:
    """Orthogonal matrix (states, states): static vectors first, then by falling weighted energy.

    The large model's coordinates are K-orthonormal, so lengths are energies. A snapshot counts by
    the root of its energy over its port's response, which makes errors relative.
    """
    weight = np.clip(TAIL_PER_ROOT * np.sqrt(tolerance), *TAIL_WEIGHTS)
    fit = np.linspace(*band, FIT)
    tail = np.linspace(band[1], TAIL * band[1], TAIL_SAMPLES)
    far = weight * (band[1] / tail) ** TAIL_DECAY
    x = states(large, np.r_[fit, tail])
    own = np.abs(np.einsum("ki,fki->fi", large.B, x) + np.diag(large.D))
    own = np.maximum(own, FLOOR * own.max(axis=0))
    share = np.r_[np.full(FIT, FIT**-0.5), far * TAIL_SAMPLES**-0.5]
    snapshots = (x * (share[:, None] / np.sqrt(own))[:, None, :]).transpose(1, 0, 2)
    snapshots = snapshots.reshape(large.order, -1)
    snapshots = np.hstack([snapshots.real, snapshots.imag])
    static, _ = np.linalg.qr(np.linalg.solve(large.K, large.B))
    for _ in range(2):
        snapshots = snapshots - static @ (static.T @ snapshots)
    directions = np.linalg.svd(snapshots)[0]
    return np.linalg.qr(np.hstack([static, directions]))[0][:, : large.order]


def _out_of_reach(tolerance: float, error: float, states: int) -> SimulationError:
    return SimulationError(
        "tolerance is out of reach",
        where="rom.tolerance",
        got=f"estimated error {error:.1e} with {states} states",
        expected=f"at most {tolerance:g}",
        hint="ask for a larger tolerance or a narrower rom.band",
    )
