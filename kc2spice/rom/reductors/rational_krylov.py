"""Rational Krylov subspaces: solutions of a model at several expansion points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.progress import ConvergenceTimer
from kc2spice.core.user_warnings import warn_user
from kc2spice.rom.intermediate_model import IntermediateModel, make_no_convergence_error
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.reduced_basis import ReducedBasis, ReductionTask
from kc2spice.rom.reductors.base import Reductor
from kc2spice.rom.reductors.greedy_basis import GreedyBasis
from kc2spice.rom.rigid_body import estimate_hidden_frequency
from kc2spice.rom.rounding import add_rounding_floor, estimate_removed_stiffness

# limits of the computing time, found by trials; the method fails beyond these limits
MAX_VECTORS = 600  # largest number of vectors of a basis
MAX_POINTS = 180  # largest number of factorisations
# number of successive points whose errors must meet the target; a single error may be small by
# chance
CONFIRMATIONS = 2
MANY_POINTS = 20  # a warning is printed if a large model needs more factorisations than this number
LARGE_UNKNOWNS = 10_000  # smallest number of unknowns of a large model, found by trials
USUAL_POINTS = 10  # number of factorisations assumed for the first estimate of the remaining time
# error at which the basis is complete, relative to the tolerance; found by trials
BASIS_SHARE = 0.01


class RationalKrylov(Reductor):
    """Reduction by rational Krylov vectors at greedily chosen expansion points.

    The basis contains the solutions ``P(s)^-1 B``, and the derivatives of these solutions, at
    points ``s = j w``. The projection interpolates the response and its slope at each point. For an
    unsymmetric model, solutions of the dual model are added. The vectors are in the order in which
    expansion points are added: first zero frequency, then the end of the band, then greedily chosen
    points.

    Parameters
    ----------
    points : sequence of floats, optional
        Expansion points in Hz that replace the greedily chosen points. The basis vectors are sorted
        like the given points.

    Raises
    ------
    UsageError : there are no points, or a point is negative or not finite.

    Examples
    --------
    The response at the end of the band is exact, because this frequency is an expansion point.

    >>> import numpy as np
    >>> import kc2spice as kc
    >>> K = 2 * np.eye(40) - np.eye(40, k=1) - np.eye(40, k=-1)
    >>> chain = kc.LinearModel(M=np.eye(40), K=K, E=0.1 * K, B=np.eye(40)[:, :1])
    >>> rom = kc.reduce(chain, order=6, band=(0, 0.05), method="rational Krylov")
    >>> bool(np.allclose(rom.transfer([0.05]), chain.transfer([0.05]), rtol=1e-9))
    True
    """

    name = "rational Krylov"
    reference = (
        "Grimme, PhD thesis, University of Illinois (1997); greedy choice of points: Feng, "
        "Antoulas and Benner, ESAIM: M2AN 51 (2017), doi:10.1051/m2an/2017014"
    )

    def __init__(self, points: Sequence[float] | None = None) -> None:
        self.points = None if points is None else _require_frequencies(points)

    def basis(self, task: ReductionTask) -> ReducedBasis:
        """Return the basis of Krylov vectors, in the order of their expansion points."""
        if self.points is not None:
            search = GreedyBasis(task.pencil_without_rigid_modes, task.band, static=False)
            for s in 2j * np.pi * self.points:
                search.extend(s, *search.solve(s if s else 0.0))
            return task.project(search.basis)
        target = BASIS_SHARE * (task.tolerance or 0.0)
        search = GreedyBasis(task.pencil_without_rigid_modes, task.band)
        end = 2j * np.pi * task.band[1]
        search.extend(end, *search.solve(end))
        confirmations, limit = 0, task.pencil_without_rigid_modes.size
        while (
            confirmations < CONFIRMATIONS
            and search.basis.shape[1] < limit
            and search.points < MAX_POINTS
        ):
            try:
                error, grown = search.add_checked_point(search.choose_next_point())
            except SimulationError:  # no candidate frequency is left
                break
            confirmations = (
                confirmations + 1 if max(error, search.change) <= target or not grown else 0
            )
        return task.project(search.basis)


def _require_frequencies(points: Sequence[float]) -> np.ndarray:
    """Check the expansion points, and return them as an array of frequencies [Hz]."""
    try:
        result = np.array(points, dtype=float).ravel()
    except (TypeError, ValueError):
        result = np.empty(0)
    if not result.size or not (np.isfinite(result) & (result >= 0)).all():
        raise UsageError(
            "this value is not a list of expansion points",
            where="points",
            got=repr(points),
            expected="a list of frequencies in Hz, not negative, such as [0, 2e3, 2e4]",
        )
    return result


def reduce_by_rational_krylov(
    pencil: Pencil, band: tuple[float, float], target: float, limit: float, most: int
) -> IntermediateModel:
    """Return a reduced model with an error within ``target`` over ``band`` [Hz].

    If rounding errors make an error of ``target`` unreachable, the function accepts a larger error
    up to ``limit``. At each expansion point after the first, the error is computed before the
    solution at this point is added to the basis. The error of the result is the larger error at the
    last two expansion points. If the last expansion point does not extend the basis, errors that
    were computed before the last extension are ignored. ``most`` is the largest number of
    factorisations.

    Raises
    ------
    SimulationError : the error exceeds even ``limit``.
    """
    search = GreedyBasis(pencil, band)
    confirmations, error, recent, idle = 0, np.inf, [np.inf], 0
    timer = ConvergenceTimer(target, CONFIRMATIONS, USUAL_POINTS, "frequency")
    end = 2j * np.pi * band[1]
    search.extend(end, *search.solve(end))
    while search.points < most and search.basis.shape[1] < MAX_VECTORS:
        error, grown = search.add_checked_point(search.choose_next_point())
        confirmations = confirmations + 1 if max(error, search.change) <= target else 0
        timer.end_step(max(error, search.change))
        if search.points == MANY_POINTS + 1 and pencil.size >= LARGE_UNKNOWNS:
            modes = search.response.select_band_resonances(band)[0].size
            advice = "use a narrower band, a larger tolerance or proportional damping"
            warn_user(
                f"the reduction needs more than {MANY_POINTS} factorisations for at least {modes} "
                f"resonances in the band; the current error is {error:.0e}, the target "
                f"{target:.0e}; {advice}"
            )
        # Errors that were computed before an extension of the basis no longer apply.
        # A frequency close to an earlier expansion point does not extend the basis.
        # The error at one frequency may be small by chance, so the last two errors are used.
        recent = [*recent[-1:], error] if grown or idle else [error]
        idle = 0 if grown else idle + 1
        if CONFIRMATIONS in (confirmations, idle):
            break
    worst = max(recent)
    proof = f"compared with the full model at {search.points} frequencies"
    small = search.response.pencil
    floor = estimate_removed_stiffness(search.projected, small, band) if small.free else 0.0
    hidden = estimate_hidden_frequency(pencil, search.modal_basis[:, : small.free], band[0])
    static = search.static or small.free > 0
    result = IntermediateModel(
        search.response, worst, static, proof, floor, hidden=hidden,
        basis=search.basis @ search.turn, points=search.frequencies,
    )  # fmt: skip
    result = add_rounding_floor(pencil, search.modal_basis, band, result, target)
    if worst > max(limit, result.floor) or not np.isfinite(worst):
        raise make_no_convergence_error(search.response, band, worst, limit)
    return replace(result, error=min(worst, limit))
