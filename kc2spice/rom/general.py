"""Reduction of any linear model: a tolerance and a band in, the fewest states found out.

Two stages. :mod:`kc2spice.rom.sampling` finds a subspace that is far more accurate than asked and
checks it against the full model at frequencies it was not fitted on. Inside it, the proper
orthogonal decomposition of the model's own response, each frequency weighted to unit energy so
that relative errors count, orders the directions; the first q of them make the model of order q.
Everything is a congruence with one real basis, so symmetry, definiteness and skewness survive, and
with them stability and passivity, at every order. Static answers are the first directions: static
gains are exact as soon as q covers them. A model that is free to move has its rigid body motions
there instead.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, cholesky, solve_triangular

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.fem.piezo.system import Port
from kc2spice.linalg.factor import Solver
from kc2spice.rom.foreign import ForeignModel
from kc2spice.rom.memory import require_memory
from kc2spice.rom.model import Certificate, FirstOrderModel, ReducedModel
from kc2spice.rom.pencil import Pencil, largest, poles, response, states
from kc2spice.rom.response import relative_error
from kc2spice.rom.sampling import CANCELLED, Sampled, grid, sample
from kc2spice.rom.structure import Structure, structure

Reduced = ReducedModel | FirstOrderModel
ACCURACY = 1e-10  # direct solutions are hardly better than this in the response
MARGIN = 0.02  # the subspace is this much more accurate than the model asked for
FIXED_ORDER_TARGET = 1e-8  # of the subspace when the order is given
SAMPLES = 200
NOTCHES, NOTCH_SAMPLES = 20, 9
RIGID = 100.0  # times the rounding of the projected stiffness
RANK = 1e-13  # singular values of the response below this are rounding
# A resonance sharper than this cannot be hit by a frequency that is not exact to rounding; errors
# are then measured on its flanks, at this relative distance.
SHARPEST = 1e-6
FLANK = 1e-4


@dataclass(frozen=True)
class Reduction:
    """The subspace model, its ordered directions and the frequencies where errors are measured.

    ``pencil`` (order N) is already expressed in the directions, so the model of order q is its
    leading part. ``cancelled`` (outputs, inputs) marks transfer functions that are zero but for
    rounding; their errors do not count.
    """

    pencil: Pencil
    ports: tuple[Port, ...]
    band: tuple[float, float]
    sampled: Sampled
    frequency: np.ndarray
    reference: np.ndarray
    cancelled: np.ndarray

    @property
    def size(self) -> int:
        """Largest order."""
        return self.pencil.size

    def leading(self, order: int) -> Pencil:
        """The pencil of the first ``order`` directions."""
        q = slice(order)
        P = self.pencil
        return Pencil(tuple(A[q, q] for A in P.coefficients), P.B[q], P.C[:, q], P.D)

    def error(self, order: int) -> float:
        """Estimated largest relative error of any transfer function over the band."""
        if order == self.size:
            return self.sampled.error
        found = response(self.leading(order), 2j * np.pi * self.frequency)
        found[:, self.cancelled] = self.reference[:, self.cancelled]
        return relative_error(found, self.reference) + self.sampled.error

    def structure(self, order: int) -> Structure:
        """Stability and passivity of the model of this order."""
        return structure(self.leading(order), 2 * np.pi * self.band[1])

    def model(self, order: int) -> Reduced:
        """The reduced model with its certificate.

        Raises
        ------
        UsageError : no such order.
        """
        if not 1 <= order <= self.size:
            raise UsageError(
                "no model of this order", where="--order", got=order, expected=f"1 to {self.size}"
            )
        found = self.structure(order)
        method = (
            f"difference to {self.size} states, those checked against the full model at "
            f"{self.sampled.points} frequencies; stability from {found.proof}"
        )
        if not self.sampled.static:
            method += "; free to move at zero frequency"
        certificate = Certificate(
            self.band, self.error(order), method, found.stable, found.passive
        )  # fmt: skip
        P = self.leading(order)
        if P.degree == 1:
            A, E = -P.coefficients[0], P.coefficients[1]
            return FirstOrderModel(E, A, P.B, P.C, P.D, self.ports, certificate)
        K, E, M = P.coefficients
        return ReducedModel(M, E, K, P.B, P.C, P.D, self.ports, certificate)


def reduce_model(
    model: ForeignModel,
    band: tuple[float, float],
    *,
    tolerance: float | None = None,
    order: int | None = None,
    solver: Solver = "scipy",
) -> Reduced:
    """The smallest model found within ``tolerance`` over ``band`` [Hz], or the one of ``order``.

    Raises
    ------
    UsageError : neither or both of tolerance and order, an empty band, a tolerance below rounding,
        an order beyond what the response has.
    SimulationError : the tolerance cannot be met, or a point of the band is a pole.
    """
    if (tolerance is None) == (order is None):
        raise UsageError("give either a tolerance or an order", where="reduction")
    if tolerance is not None and not ACCURACY <= tolerance < 1:
        raise UsageError(
            "not a tolerance that can be certified",
            where="tolerance",
            got=tolerance,
            expected=f"between {ACCURACY:g} and 1",
        )
    target = FIXED_ORDER_TARGET if tolerance is None else max(MARGIN * tolerance, ACCURACY)
    limit = np.inf if tolerance is None else 0.5 * tolerance
    sampled = sample_model(model, band, target, limit, solver)
    found = [ordered(model, band, sampled, two_sided) for two_sided in _sides(model.pencil)]
    if order is not None:
        candidates = [(r.error(min(order, r.size)), i) for i, r in enumerate(found)]
        return found[min(candidates)[1]].model(order)
    assert tolerance is not None
    orders = [smallest_order(r, tolerance) for r in found]
    best = int(np.argmin(orders))
    return found[best].model(orders[best])


def sample_model(
    model: ForeignModel,
    band: tuple[float, float],
    target: float,
    limit: float | None = None,
    solver: Solver = "scipy",
) -> Sampled:
    """Subspace of the scaled model; see :func:`kc2spice.rom.sampling.sample`."""
    if not (0 <= band[0] < band[1] and np.isfinite(band[1])):
        raise UsageError(
            "not a frequency band", where="band", got=band, expected="0 <= f0 < f1 in Hz"
        )
    require_memory(model.pencil, solver)
    limit = target if limit is None else limit
    return sample(_scaled(model, band), band, target, limit, solver)


def _scaled(model: ForeignModel, band: tuple[float, float]) -> Pencil:
    return model.pencil.scaled(2 * np.pi * band[1])


def _sides(pencil: Pencil) -> tuple[bool, ...]:
    """Whether output directions may join the input directions."""
    return (False,) if pencil.symmetric and pencil.collocated else (False, True)


def ordered(
    model: ForeignModel, band: tuple[float, float], sampled: Sampled, two_sided: bool
) -> Reduction:
    """Order the directions of the subspace by what they contribute to the response."""
    omega = 2 * np.pi * band[1]
    full = _scaled(model, band)
    V = sampled.basis @ _energy_basis(full.project(sampled.basis), omega)
    pencil = full.project(V)
    first = np.empty((pencil.size, 0)) if sampled.static else _rigid(full, V, pencil)
    frequency = grid(band, SAMPLES, sampled.static)
    frequency = np.union1d(frequency, _resonances(pencil, band))
    frequency = np.union1d(frequency, _notches(frequency, response(pencil, 2j * np.pi * frequency)))
    s = 2j * np.pi * frequency
    snapshots = [states(pencil, s)]
    if frequency[0] == 0:
        first = _range(snapshots[0][0].real)
    if two_sided:
        C, B = pencil.C.T, pencil.B.T
        snapshots.append(states(Pencil(tuple(P.T for P in pencil.coefficients), C, B, B), s))
    pencil = pencil.project(_directions(snapshots, first))
    if not sampled.static:
        rest = pencil.coefficients[0].copy()
        rest[: first.shape[1]] = rest[:, : first.shape[1]] = 0.0
        pencil = Pencil((rest, *pencil.coefficients[1:]), pencil.B, pencil.C, pencil.D)
    reference = response(pencil, s)
    factors = np.linalg.norm(pencil.C, axis=1)[:, None] * np.linalg.norm(snapshots[0], axis=1).max(
        axis=0
    )
    cancelled = np.abs(reference).max(axis=0) <= CANCELLED * factors
    return Reduction(pencil, model.ports, band, sampled, frequency, reference, cancelled)


def _rigid(full: Pencil, V: np.ndarray, pencil: Pencil) -> np.ndarray:
    """Directions of a symmetric model that cost no energy at rest, within rounding of ``V'KV``."""
    rest = pencil.coefficients[0]
    if largest(rest - rest.T) > 0:
        return np.empty((pencil.size, 0))
    values, vectors = np.linalg.eigh(rest)
    rounding = np.finfo(float).eps * largest(abs(V).T @ (abs(full.coefficients[0]) @ abs(V)))
    return vectors[:, np.abs(values) <= RIGID * rounding]


def _energy_basis(pencil: Pencil, omega: float) -> np.ndarray:
    """Coordinates in which the energy at ``omega`` is the plain square, where there is one."""
    energy = pencil.coefficients[0] + omega**pencil.degree * pencil.coefficients[-1]
    energy = 0.5 * (energy + energy.T)
    try:
        upper = cholesky(energy)
    except LinAlgError:
        return np.eye(pencil.size)  # no definite energy: the scaled unknowns must do
    return np.asarray(solve_triangular(upper, np.eye(pencil.size)))


def _resonances(pencil: Pencil, band: tuple[float, float]) -> np.ndarray:
    """Frequencies [Hz] of the peaks in the band, and of the flanks of the sharpest."""
    found = poles(pencil, 2 * np.pi * band[1])
    found = found[found.imag > 0]
    frequency, damping = found.imag / (2 * np.pi), np.abs(found.real) / np.abs(found)
    sharp = frequency[damping < FLANK]
    frequency = np.r_[frequency[damping > SHARPEST], sharp * (1 - FLANK), sharp * (1 + FLANK)]
    return frequency[(frequency > max(band[0], 1e-4 * band[1])) & (frequency < band[1])]


def _directions(snapshots: list[np.ndarray], first: np.ndarray) -> np.ndarray:
    """Orthonormal directions: ``first``, then the principal ones of all others."""
    columns = np.concatenate([np.moveaxis(x, 0, 1).reshape(x.shape[1], -1) for x in snapshots], 1)
    both = np.hstack([columns.real, columns.imag])
    both = both / np.tile(np.linalg.norm(columns, axis=0) + np.finfo(float).tiny, 2)
    for _ in range(2):
        both = both - first @ (first.T @ both)
    return np.hstack([first, _range(both, 1.0)])


def _range(columns: np.ndarray, unit: float | None = None) -> np.ndarray:
    """Principal directions of the columns, those beyond rounding of ``unit`` (the largest)."""
    U, size, _ = np.linalg.svd(columns, full_matrices=False)
    scale = size.max(initial=0.0) if unit is None else unit
    return np.asarray(U[:, size > RANK * max(scale, np.finfo(float).tiny)])


def _notches(frequency: np.ndarray, H: np.ndarray) -> np.ndarray:
    """Finer samples around the deepest local minima of all entries: relative errors peak there."""
    size = np.abs(H) / (np.abs(H).max(axis=0) + np.finfo(float).tiny)
    inner = (size[1:-1] < size[:-2]) & (size[1:-1] < size[2:])
    depth = np.where(inner, size[1:-1], np.inf).reshape(len(size) - 2, -1).min(axis=1)
    deepest = np.argsort(depth)[: min(NOTCHES, int(np.isfinite(depth).sum()))]
    spans = [np.linspace(frequency[k], frequency[k + 2], NOTCH_SAMPLES) for k in deepest]
    return np.concatenate([frequency[:0], *spans])


def smallest_order(reduction: Reduction, tolerance: float) -> int:
    """Bisect for an order whose estimate is within ``tolerance`` while one less is not.

    A stable subspace model must not lose its stability on the way.

    Raises
    ------
    SimulationError : not even all directions meet the tolerance.
    """
    keep = reduction.structure(reduction.size).stable

    def good(order: int) -> bool:
        return reduction.error(order) <= tolerance and (
            not keep or reduction.structure(order).stable
        )

    low, high = 0, reduction.size
    if not good(high):
        raise SimulationError(
            "the tolerance cannot be met",
            where="reduction",
            got=f"estimate {reduction.error(high):.1e} with {high} states",
            expected=f"at most {tolerance:g}",
        )
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (low, middle) if good(middle) else (middle, high)
    return high
