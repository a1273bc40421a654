"""Reduction of linear models to a tolerance over a band, or to a prescribed order.

The result is a reduced model with a certificate.

The reduction has two steps. The first step (:mod:`kc2spice.rom.intermediate_reduction`) replaces
the full-order model by an intermediate model that is far more accurate than the tolerance. The
second step computes bases of the intermediate model with all suitable reductors, and selects the
smallest order whose error estimate is within the tolerance. After the order is selected, the
stability and passivity of the reduced model are proven where possible.

Rigid-body modes are separated before the reduction and remain exact. The error estimate is the sum
of the error of the intermediate model, and of the largest difference between the reduced and the
intermediate model. The difference is computed at and beside every resonance and at every notch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np

from kc2spice.core.errors import UsageError, name_part_in_errors, unknown
from kc2spice.core.unit_spelling import convert_percentage
from kc2spice.core.user_warnings import warn_user
from kc2spice.linalg.factor import require_memory_for_factors
from kc2spice.linalg.solver import DirectSolver, use_solver
from kc2spice.rom.band import choose_natural_band
from kc2spice.rom.certification import certify, certify_with_full_order
from kc2spice.rom.constraints import eliminate_algebraic_unknowns
from kc2spice.rom.definiteness import allows_cholesky, is_definite
from kc2spice.rom.intermediate_model import IntermediateModel
from kc2spice.rom.intermediate_reduction import build_intermediate_model
from kc2spice.rom.linear_model import LinearModel, Norm
from kc2spice.rom.minimax_fit import find_lower_order
from kc2spice.rom.order_search import require_order, select_basis, select_fewest_states
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.reduced_basis import ReducedBasis, ReductionTask
from kc2spice.rom.reductors.base import Reductor, describe_errors_in_method, require_basis
from kc2spice.rom.reductors.block_krylov import BlockArnoldi, make_nested_model
from kc2spice.rom.reductors.registry import (
    BLOCK_KRYLOV,
    advise_more_vectors,
    find_reductor,
    is_built_in,
    list_suited_reductors,
)
from kc2spice.rom.stability import StabilityProof, prove_stability
from kc2spice.rom.structural_damping_reduction import approximate_causally, reduce_to_first_order

# largest frequency [Hz] of a band; the square of the angular frequency must be a finite float
MAX_FREQUENCY = 1e30
# Smallest tolerance: ten times MIN_ERROR_ESTIMATE.
# Solutions of the full-order model are hardly more accurate than this tolerance.
MIN_TOLERANCE = 1e-10
# requested error of the intermediate model, as a small share of the tolerance; found by trials
INTERMEDIATE_SHARE = 0.02
# Largest permitted error of the intermediate model, as a share of the tolerance.
# If rounding errors make the requested error of the intermediate model unreachable, the reduction
# accepts an error up to this share of the tolerance.
MAX_INTERMEDIATE_SHARE = 0.5
# Smallest share of the tolerance that must remain after rounding errors are subtracted.
# If rounding errors use three quarters of the tolerance, the reduced model needs one or two
# additional states.
# If rounding errors use more than three quarters of the tolerance, the reduction does not subtract
# rounding errors. In this case, the error estimate exceeds the tolerance, and the reduction warns.
MIN_REMAINING_SHARE = 0.25
# Relative error above which a reduced model of prescribed order causes a warning. A model whose
# response is zero has the relative error 1.
USELESS_ERROR = 1.0
# Requested error of the intermediate model if the order is prescribed, found by trials.
FIXED_ORDER_TARGET = 1e-8


def reduce_model(
    fom: LinearModel,
    *,
    tolerance: float | None = None,
    order: int | None = None,
    band: tuple[float, float] | None = None,
    norm: Norm = "pointwise",
    contact: bool = False,
    method: str | Reductor | None = None,
    solver: DirectSolver | str | None = None,
) -> LinearModel:
    """Reduce a linear model to a relative error ``tolerance``, or to an ``order``.

    For a ``tolerance``, the result is the smallest of the tried reductions within the tolerance.
    The result has the ports of the full-order model ``fom``. The certificate contains the error
    estimate over ``band`` [Hz] in the given ``norm``.

    * If ``order`` is given, a proportionally damped second-order model with a positive definite
      stiffness matrix is reduced by block Arnoldi at s0 = 0 (Schütz, Maeter and Bechtold,
      Actuators 10 (2021) 279, section 2.3).
    * Models whose ports are all signals are also reduced to first-order models by balanced
      truncation. A model by balanced truncation is the result if it has fewer states than the
      model by response POD. If definite matrices prove the stability of the response-POD model, the
      balanced-truncation model is the result only with at least about 9 % fewer states. Passive
      symmetric models of first order remain passive.
    * Structural damping is replaced by viscous damping of each mode, or by relaxations where
      relaxations are much more accurate. The error estimate includes the error of the replacement.
      The function warns if the error of the replacement exceeds the tolerance.
    * The inertia of a symmetric model with only real poles is omitted if the model without inertia
      has fewer states and the same response.
    * If rounding errors of the full model's matrix entries change the response by more than
      ``tolerance``, the error estimate includes the change, and the function warns.

    Parameters
    ----------
    fom : LinearModel
        Full-order model of n unknowns, in SI units.
    tolerance : float, optional
        Largest permitted relative error over the band; less than 1.
    order : int, optional
        Number of unknowns of the reduced model. Exactly one of ``tolerance`` and ``order`` is
        required.
    band : tuple of two floats, optional
        Lowest and highest frequency in Hz. The default is the band of the model. If the model has
        no band, the band ends a little above the fifth natural frequency. The natural frequencies
        of a first-order model are the corner frequencies 1 / (2 pi tau) of its time constants tau.
    norm : "pointwise" or "peak", default "pointwise"
        Divisor of the error of each response entry: the size of the entry at the same frequency
        (pointwise), or the largest size of the entry in the band (peak).
    contact : bool, default False
        Whether to keep a third more states than the tolerance requires, for bodies with contacts.
        The additional states represent the response above the band. Contacts excite a body at
        frequencies above the band.
    method : str or Reductor, optional
        Method of reduction. By default, response POD and the variants of balanced truncation that
        suit the model are tried.
    solver : callable or "pardiso", optional
        Direct solver, as for :func:`kc2spice.reduce`. The default is CHOLMOD or SuperLU.

    Returns
    -------
    LinearModel
        Reduced-order model with the ports of ``fom`` and with a certificate.

    Raises
    ------
    UsageError : both or none of ``tolerance`` and ``order`` are given, or one of them is out of
        range; the band is empty; the norm is unknown; the model is too large for the free memory;
        or an output contains derivatives of an input.
    SimulationError : the tolerance cannot be met, or a point of the band is a pole.

    Examples
    --------
    Block Arnoldi at s0 = 0 preserves the static compliance of four springs of 2000 N/m in series.

    >>> from kc2spice.rom.linear_model import Port
    >>> stiffness = 2e3 * (np.diag([2.0, 2, 2, 1]) - np.eye(4, k=1) - np.eye(4, k=-1))
    >>> tip = Port("tip", "mechanical")
    >>> chain = LinearModel(M=1e-3 * np.eye(4), K=stiffness, B=np.eye(4)[:, 3:], ports=(tip,))
    >>> small = reduce_model(chain, order=2, band=(0.0, 100.0))
    >>> small.order
    2
    >>> print(f"{small.transfer([0.0])[0, 0, 0].real:.9f} m/N")
    0.002000000 m/N
    """
    with use_solver(solver):
        return reduce_to_target(fom, ReductionTarget(tolerance, order, band, norm, contact, method))


def reduce_to_target(fom: LinearModel, target: ReductionTarget) -> LinearModel:
    """Reduce a model so that it meets the requirements ``target``."""
    require_valid_target(target)
    if fom.structural:
        return _reduce_structural_damping(fom, target)
    rom, tolerance = _reduce_viscous_damping(fom, target), target.tolerance
    if tolerance is None or target.contact or target.method or fom.first_order:
        return rom
    return reduce_to_first_order(fom, rom, _make_congruence(target), tolerance, target.norm)


@dataclass(frozen=True)
class ReductionTarget:
    """Requirements on a reduced-order model, and the method of reduction.

    If ``keep_form`` is true, only congruences are used. If ``exact`` is true, the error of the
    intermediate model must be at most ``MAX_INTERMEDIATE_SHARE`` times the tolerance. If ``exact``
    is false, any error of the intermediate model is accepted. ``space`` is the Krylov subspace at s
    = 0 from an earlier reduction of the same model, if there is one.
    """

    tolerance: float | None
    order: int | None
    band: tuple[float, float] | None
    norm: Norm
    contact: bool
    method: str | Reductor | None
    keep_form: bool = False
    exact: bool = True
    space: BlockArnoldi | None = None


def _reduce_viscous_damping(fom: LinearModel, target: ReductionTarget) -> LinearModel:
    """Reduce a model with viscous damping."""
    pencil = eliminate_algebraic_unknowns(fom.pencil)
    band = choose_band(fom, pencil, target.band)
    intermediate, full_order_proof = compute_first_step(pencil, band, target)
    task = ReductionTask.from_models(fom, pencil, intermediate, band, target.norm, target.tolerance)
    reductors = list_methods(task, target)
    if target.tolerance is None:
        basis, order = find_basis_of_order(task, reductors, target)
    else:
        basis, order = find_smallest_basis(task, reductors, target)
    rom = certify(basis, order)
    warn_of_inaccuracy(rom, intermediate.floor, target.tolerance)
    return certify_with_full_order(rom, full_order_proof)


def choose_band(
    fom: LinearModel, pencil: Pencil, band: tuple[float, float] | None
) -> tuple[float, float]:
    """Return the prescribed ``band`` [Hz], or the model's band, or the default band."""
    if not pencil.B.any() or not pencil.C.any():
        letter = "C" if pencil.B.any() else "B"
        raise UsageError(
            "no input acts on the model" if letter == "B" else "no output depends on the model",
            where=fom.name,
            got=f"only zeros in the matrix {letter}",
            expected="at least one entry in each of the matrices B and C",
            hint=f"export the matrix {letter} again",
        )
    band = band or fom.band or choose_natural_band(pencil)
    if not 0 <= band[0] < band[1] <= MAX_FREQUENCY:
        raise UsageError(
            "this value is not a frequency band",
            where="band",
            got=f"{band[0]:g} to {band[1]:g} Hz",
            expected=f"0 <= f0 < f1 <= {MAX_FREQUENCY:g} in Hz",
            hint=f"write band=({band[1]:g}, {band[0]:g})"
            if 0 <= band[1] < band[0] <= MAX_FREQUENCY
            else "for example band=(0, 20e3)",
        )
    return float(band[0]), float(band[1])


def compute_first_step(
    pencil: Pencil, band: tuple[float, float], target: ReductionTarget
) -> tuple[IntermediateModel, StabilityProof]:
    """Compute the first reduction step: an intermediate model and a stability proof.

    The returned stability proof states whether the full-order model is stable and whether it is
    passive. If ``target.exact`` is false, any error of the intermediate model is accepted, and the
    caller must check the error.
    """
    # If the stiffness matrix proves to be indefinite, the required memory is checked again later.
    require_memory_for_factors(
        pencil.assemble_bordered_matrix(1.0, 1.0, 1.0), definite=allows_cholesky(pencil)
    )
    goal, limit = FIXED_ORDER_TARGET, np.inf
    if target.tolerance is not None:
        goal = max(INTERMEDIATE_SHARE * target.tolerance, 0.1 * MIN_TOLERANCE)
        limit = MAX_INTERMEDIATE_SHARE * target.tolerance if target.exact else np.inf
    by_krylov = target.method in (None, BLOCK_KRYLOV.name, BLOCK_KRYLOV)
    result = None
    try:
        if target.order is not None and by_krylov and is_definite(pencil):
            result = make_nested_model(pencil, target.order, target.space)
        else:
            # a deflated model may have fewer states than the prescribed order
            deflated = target.order is None
            result = build_intermediate_model(pencil, band, goal, limit, deflated=deflated)
    finally:
        proof = prove_stability(pencil, band, result.poles if result else None)
        if proof.stable is False:
            warn_user(
                "the full model is unstable: the frequency response neglects its unstable "
                "modes; check the signs of the matrices, and that the upper and lower triangles "
                "of each matrix are present"
            )
    return result, proof


def list_methods(task: ReductionTask, target: ReductionTarget) -> list[Reductor]:
    """List the prescribed reduction method, or all suitable methods by default."""
    if target.method is not None:
        return [find_reductor(target.method)]
    if not task.intermediate.proof:
        return [BLOCK_KRYLOV]
    return list_suited_reductors(task)


def find_basis_of_order(
    task: ReductionTask,
    reductors: Sequence[Reductor],
    target: ReductionTarget,
    bases: dict[int, tuple[Reductor | None, list[ReducedBasis]]] | None = None,
) -> tuple[ReducedBasis, int]:
    """Return the basis with the smallest error at ``target.order``, and this order.

    ``bases`` contains the bases that earlier calls computed. Each value of ``bases`` contains a
    reductor and its bases; the reductor is None if no reduction method is prescribed. The keys are
    the ``id`` of the reductors, because two reductors may have the same name. The function adds new
    bases to ``bases``.
    """
    assert target.order is not None
    bases = {} if bases is None else bases
    reductor = reductors[0] if target.method is not None else None
    key = id(reductor)
    if key not in bases:
        if reductor is not None:
            bases[key] = reductor, [_compute_basis_of_prescribed_method(task, reductor)]
        else:
            suited = (item for item in reductors if item.congruence and item.applies_to(task))
            candidates = ((item.name, item.basis(task)) for item in suited)
            bases[key] = (
                None,
                [basis.copy_with_method(name) for name, basis in candidates if basis is not None],
            )
    prescribed = reductor is not None
    return select_basis(bases[key][1], target.order, prescribed=prescribed), target.order


def find_smallest_basis(
    task: ReductionTask, reductors: Sequence[Reductor], target: ReductionTarget
) -> tuple[ReducedBasis, int]:
    """Return the basis that needs the fewest states for the tolerance, and the order."""
    assert target.tolerance is not None
    tolerance = _subtract_rounding_error(target.tolerance, task.intermediate)
    if target.method is not None:
        basis = _compute_basis_of_prescribed_method(task, reductors[0])
        return basis, require_order(basis, tolerance, advise_more_vectors(reductors[0]))
    basis, order = select_fewest_states(
        task, reductors, tolerance, shorten=not target.contact, keep_form=target.keep_form
    )
    return (basis, order) if target.contact else find_lower_order(basis, order, tolerance)


def _subtract_rounding_error(tolerance: float, intermediate: IntermediateModel) -> float:
    """Subtract rounding errors from the tolerance, unless too little remains.

    If the difference is too small for a reduction, the result is the whole tolerance.
    """
    remaining = tolerance - intermediate.floor
    attainable = max(MIN_REMAINING_SHARE * tolerance, intermediate.error / MAX_INTERMEDIATE_SHARE)
    enough = remaining > min(MAX_INTERMEDIATE_SHARE * tolerance, attainable)
    return remaining if enough else tolerance


def _compute_basis_of_prescribed_method(task: ReductionTask, reductor: Reductor) -> ReducedBasis:
    """Compute the basis of a prescribed reduction method.

    Raises
    ------
    UsageError : the method does not apply to the model.
    """
    basis = None
    # an exception in a built-in method is an error of kc2spice, and remains unchanged
    described = nullcontext() if is_built_in(reductor) else describe_errors_in_method(reductor)
    with described:
        reason = reductor.obstacle(task) or "its applies_to() returns False"
        if reductor.applies_to(task):
            reason = reductor.no_basis
            with name_part_in_errors(f"method {reductor.name!r}"):
                basis = require_basis(reductor, reductor.basis(task))
    if basis is None:
        raise UsageError(
            f"this reduction method does not apply to the model: {reason}",
            where="method",
            got=reductor.name,
            expected="a method that supports the structure of the model",
            hint="leave method out, so that kc2spice selects a method",
        )
    return replace(basis, method=reductor.name, origin=f"{reductor.name}; ")


def warn_of_inaccuracy(rom: LinearModel, floor: float, tolerance: float | None) -> None:
    """Warn if rounding errors or a small order make a reduced model inaccurate.

    ``floor`` is the relative change of the full model's response due to rounding errors of its
    matrix entries. The function warns if ``floor``, or the error estimate of ``rom``, exceeds the
    ``tolerance``. If the ``tolerance`` is None, the order is prescribed, and the function warns if
    the error estimate exceeds ``USELESS_ERROR``.
    """
    assert rom.certificate is not None
    estimate = rom.certificate.error_estimate
    if tolerance is None:
        if estimate > USELESS_ERROR:
            warn_user(
                f"the reduced model of order {rom.order} does not represent the full model: its "
                f"error estimate is {estimate:.3g}, and 1 is 100 % of the response; increase the "
                f"order, or replace the order by a tolerance, such as 1e-4"
            )
        return
    if floor > tolerance:
        warn_user(
            f"the response of the full model has an error of {floor:.1e}, because its matrix "
            f"entries are rounded; other units or fewer elements may reduce this error"
        )
    elif tolerance < estimate:
        warn_user(
            f"the error estimate of the reduced model is {estimate:.2g}, more than the tolerance "
            f"{tolerance:g}, because it includes rounding errors of the matrix entries, which "
            f"change the response of the full model by {floor:.1e}"
        )


def _make_congruence(
    target: ReductionTarget,
) -> Callable[[LinearModel, float, tuple[float, float]], LinearModel]:
    """Return a function that reduces a model by a congruence, within a tolerance."""

    def reduce_by_congruence(
        fom: LinearModel, tolerance: float, band: tuple[float, float]
    ) -> LinearModel:
        """Reduce a model with viscous damping by a congruence."""
        return _reduce_viscous_damping(
            fom, replace(target, tolerance=tolerance, order=None, band=band, keep_form=True)
        )

    return reduce_by_congruence


def _reduce_structural_damping(fom: LinearModel, target: ReductionTarget) -> LinearModel:
    """Reduce a model with structural damping to a causal, passive model."""
    if target.tolerance is None:
        raise UsageError(
            "a model with structural damping cannot be reduced to a prescribed order",
            where="order",
            got=target.order,
            expected="a tolerance instead of the order",
            hint="replace the order by a tolerance, such as 1e-4",
        )
    if target.method is not None and not find_reductor(target.method).congruence:
        raise UsageError(
            "this method cannot reduce a model with structural damping",
            where="method",
            got=target.method,
            expected="a method that uses a Galerkin projection",
            hint="leave out the method",
        )
    undamped = replace(fom, loss_factor=0.0, loss=None)
    band = (
        target.band
        or fom.band
        or choose_natural_band(eliminate_algebraic_unknowns(undamped.pencil))
    )
    return approximate_causally(fom, _make_congruence(target), target.tolerance, band, target.norm)


def require_valid_target(target: ReductionTarget) -> None:
    """Reject a reduction target with invalid tolerance, order, norm or method."""
    tolerance, order = target.tolerance, target.order
    if (tolerance is None) == (order is None):
        raise UsageError(
            "the reduction needs either a tolerance or an order",
            where="reduce",
            got="neither tolerance nor order"
            if order is None
            else f"tolerance {tolerance}, order {order}",
            expected="tolerance for the largest relative error, or order for the number of states",
            hint="leave out order" if order is not None else "add tolerance=1e-4",
        )
    if tolerance is not None and not MIN_TOLERANCE <= tolerance < 1:
        fraction = convert_percentage(tolerance)
        raise UsageError(
            "the tolerance is out of range",
            where="tolerance",
            got=f"{tolerance:g}",
            expected=f"at least {MIN_TOLERANCE:g} and below 1",
            hint="write tolerance=1e-4, which is an error estimate of 0.01 %"
            if fraction is None or fraction >= 1
            else f"for {tolerance:g} %, write tolerance={fraction:g}",
        )
    if order is not None and (order < 1 or order != int(order)):
        raise UsageError(
            "the order, which is the number of states, is not a positive whole number",
            where="order",
            got=order,
            expected="a whole number of at least 1",
            hint=f"for example {max(1, int(order))}",
        )
    if target.norm not in get_args(Norm):
        raise unknown("this norm does not exist", target.norm, get_args(Norm), "norm")
    if target.method is not None:
        find_reductor(target.method)
