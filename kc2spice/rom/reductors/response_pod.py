"""Proper orthogonal decomposition of frequency responses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import LinAlgError, block_diag, cholesky, solve_triangular

from kc2spice.rom.error_estimate import Judge
from kc2spice.rom.linear import LinearModel, Norm
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.reduced_basis import Reduction
from kc2spice.rom.response import Response, around, grid

SOFT = 1e12  # condition of an energy that holds a motion which costs none but for rounding
RANK = 1e-13  # singular values of the response below this are rounding
FIT = 101
TAIL = 8.0  # snapshots of mechanical ports reach so many times the band's upper edge
TAIL_SAMPLES = 150
TAIL_DECAY = 4  # power of the fall of the tail's weight: contact forces are smooth on the whole
# Eight kicks of the paper's chip, 45 to 105 V, tolerances 1e-5 to 5e-8: models of 20 to 31 states
# have launch errors within 2.7e-4. With weights of at most 1e-2, 21 states at 2e-7 have up to 9e-4.
TAIL_WEIGHTS = 4e-3, 5e-2
TAIL_PER_ROOT = 120.0  # per root of the tolerance, as errors go with its square
TIGHTENED = 150  # states up to which directions are turned to save some
TRIALS = 12  # how often directions are turned
SPARE = 20  # directions beyond the order, at least, that are turned
SPARED = 0.5  # share of the tolerance that all of these directions must be good to
LEAST = 0.05  # least change of a weight
FADING = 0.5  # factor of the weight of the tail in each trial


def tightened(found: Reduction, order: int, tolerance: float) -> tuple[Reduction, int]:
    """Other directions of which fewer than ``order`` meet the tolerance, as long as there are any.

    Snapshots weigh more where the error of one state fewer is largest (Lawson's minimax fit), and
    those of the ``tail`` above the band, which no certificate sees, less and less.
    """
    size, kept = min(found.size, max(3 * order, order + SPARE)), max(found.first, 1)
    if order <= kept or order > TIGHTENED or found.error(size) > SPARED * tolerance:
        return found, order
    held = found.pencil.leading(size)
    response = Response(held)
    judge = found.judge
    inside, far = _snapshots(judge, response, _tail(found.full, tolerance))
    s = 2j * np.pi * np.r_[inside, far[0]]
    H, count = judge.exact.transfer(s), inside.size
    base = judge.reference[1].base(H[:count], judge.share) + np.finfo(float).tiny
    sides = [_weighted(response, s, np.ones(len(s)), H, judge.norm)]
    if not (held.symmetric and held.collocated):
        sides.append(_weighted(response.dual, s, np.ones(len(s)), H.swapaxes(1, 2), judge.norm))
    weight, share, best = np.ones(count), 1.0, found
    for _ in range(TRIALS):
        both = np.r_[weight, share * far[1]]
        columns = np.hstack(
            [side * np.tile(np.repeat(both, side.shape[1] // (2 * len(s))), 2) for side in sides]
        )
        V = block_diag(np.eye(found.first), _principal(columns[found.first :])[0])
        trial = replace(found, pencil=replace(held.project(V), free=held.free))
        while order > kept:
            fewer = trial.pencil.leading(order - 1)
            off = np.abs(Response(fewer).transfer(s[:count]) - H[:count]) / base
            if off.max() > tolerance or not trial.good(order - 1, tolerance):
                break
            best, order = trial, order - 1
        largest = off.max(axis=(1, 2))
        weight = weight * np.sqrt(largest / largest.max() + LEAST)
        weight, share = weight / weight.max(), FADING * share
    return best, order


def ordered(plain: Reduction, two_sided: bool, tolerance: float | None) -> Reduction:
    """Order the directions of the ``plain`` subspace by what they contribute to the response."""
    model, space, judge = plain.full, plain.space, plain.judge
    whole = space.response
    core, omega = whole.core, 2 * np.pi * judge.band[1]
    free = core.free  # motions that damping couples to the others are kept as they are
    energy = _energy_basis(core.held, omega, static=space.static)
    basis = block_diag(np.eye(free), energy)
    response = Response(core.project(basis))
    pencil = response.pencil
    conservative = any(p.kind in ("mechanical", "rotational") for p in model.ports)
    first = np.empty((pencil.size - free, 0))
    if free:
        K, E, _ = pencil.coefficients
        loads = [pencil.B[free:], E[free:, :free], E[:free, free:].T]
        first = _range(np.linalg.solve(K[free:, free:], np.hstack(loads)))
    elif space.static and ((judge.static and judge.band[0] == 0) or conservative):
        first = _range(response.states(np.zeros(1))[0].real)
    inside, far = _snapshots(judge, response, _tail(model, tolerance))
    weight = np.r_[np.ones(inside.size), far[1]]
    s = 2j * np.pi * np.r_[inside, far[0]]
    H = whole.transfer(s)
    sets = [_weighted(response, s, weight, H, judge.norm)]
    if two_sided:
        sets.append(_weighted(response.dual, s, weight, H.swapaxes(1, 2), judge.norm))
    directions = _directions(np.hstack(sets)[free:], first)
    pencil = pencil.project(block_diag(np.eye(free), directions))
    pencil = replace(pencil, free=free)
    if core is not whole.pencil:
        pencil = pencil.joined(whole.pencil.leading(whole.pencil.free))
    kept = pencil.free + (first.shape[1] if conservative else 0)
    return replace(plain, pencil=pencil, first=kept)


def _energy_basis(pencil: Pencil, omega: float, *, static: bool) -> np.ndarray:
    """Coordinates in which the elastic energy (else that at ``omega``) is the plain square, where
    there is one. A model that is not ``static`` has none at rest, though rounding of its K may let
    a factor of it pass for one."""
    rest, inertia = pencil.coefficients[0], pencil.coefficients[-1]
    moving = rest + omega**pencil.degree * inertia
    for energy in (rest, moving) if static else (moving,):
        energy = 0.5 * (energy + energy.T)
        if np.linalg.cond(energy) > SOFT:
            continue
        try:
            return np.asarray(solve_triangular(cholesky(energy), np.eye(pencil.size)))
        except LinAlgError:
            continue
    return np.eye(pencil.size)  # no definite energy: the scaled unknowns must do


def _tail(model: LinearModel, tolerance: float | None) -> float | None:
    """Weight of what is above the band, where contact may act; a basis fitted to the band alone is
    erratic there."""
    if not any(p.kind in ("mechanical", "rotational") for p in model.ports):
        return None
    return float(np.clip(TAIL_PER_ROOT * np.sqrt(tolerance or 0.0), *TAIL_WEIGHTS))


def _snapshots(
    judge: Judge, response: Response, tail: float | None
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray]]:
    """Frequencies [Hz] of the band and its resonances; those of a tail above with their weights."""
    band = judge.band
    frequency = grid(band, FIT, judge.static)
    at, ratio = response.within(band)
    frequency = np.union1d(frequency, around(at, ratio, np.array([0.0, 1.0])))
    if tail is None:
        return frequency, (np.empty(0), np.empty(0))
    far = np.linspace(band[1], TAIL * band[1], TAIL_SAMPLES)
    weight = tail * (band[1] / far) ** TAIL_DECAY * np.sqrt(FIT / TAIL_SAMPLES)
    return frequency, (far, weight)


def _weighted(
    response: Response, s: np.ndarray, weight: np.ndarray, whole: np.ndarray, norm: Norm
) -> np.ndarray:
    """Real and imaginary parts of the states, each relative to the root of its port's response
    (an energy) where ports have one, else to its own length; with that of a free motion, in the
    response of the ``whole``. Relative to the peaks in that norm."""
    x = response.states(s)
    P = response.pencil
    H = P.C @ x + P.D
    if P.symmetric and P.collocated:
        share = 1.0 if norm == "peak" else 1e-6
        least = share * np.abs(np.einsum("fii->fi", H)).max(axis=0)
        own = np.sqrt(np.maximum(np.abs(np.einsum("fii->fi", whole)), least))
    else:
        own = np.linalg.norm(x, axis=1)
        if norm == "peak":
            own = np.maximum(own, own.max(axis=0))
        size = np.linalg.norm(H, axis=1)
        more = np.divide(
            np.linalg.norm(whole, axis=1), size, out=np.ones_like(size), where=size > 0
        )
        own = own * np.maximum(more, 1.0)
    x = x * (weight[:, None] / (own + np.finfo(float).tiny))[:, None, :]
    columns = np.moveaxis(x, 0, 1).reshape(x.shape[1], -1)
    return np.hstack([columns.real, columns.imag])


def _directions(columns: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Orthonormal directions: ``first``, then the principal ones of all others."""
    for _ in range(2):
        columns = columns - first @ (first.T @ columns)
    both = np.hstack([first, _principal(columns)[0]])
    return np.asarray(np.linalg.qr(both)[0])


def _range(columns: np.ndarray) -> np.ndarray:
    """Principal directions of the columns, those beyond rounding of the largest."""
    U, size = _principal(columns)
    return np.asarray(U[:, size > RANK * max(size.max(initial=0.0), np.finfo(float).tiny)])


def _principal(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Left singular vectors and values."""
    if columns.shape[1] > 2 * columns.shape[0]:  # a thinner matrix of the same directions
        columns = np.asarray(np.linalg.qr(columns.T, mode="r")).T
    U, size, _ = np.linalg.svd(columns, full_matrices=False)
    return U, size
