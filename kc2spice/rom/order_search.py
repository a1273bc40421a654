"""Search for the smallest order of a basis that meets a tolerance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.rom.error_estimate import choose_default_norm, make_inaccuracy_error
from kc2spice.rom.reduced_basis import ReducedBasis, ReductionTask
from kc2spice.rom.reductors.base import Reductor
from kc2spice.rom.stability import DEFINITE_EVIDENCE, StabilityProof

# If a congruence needs at most this number of states, a general projection is also computed.
# The certificate then states how many states the congruence and the general projection need.
# Found by trials; a larger value increases the computing time.
MAX_COMPARED_STATES = 200
# A general projection replaces a congruence if the general projection needs at most this fraction
# of the states that the congruence needs.
# For example, a general projection with 10 states replaces a congruence with 11 states.
# A congruence of definite matrices has an advantage: its reduced model consists of resonators,
# whose form proves stability.
SAVING_RATIO = 0.91


def find_least_order(basis: ReducedBasis, tolerance: float, states: float = np.inf) -> int | None:
    """Find the least order whose model meets the limits of error and state count.

    The error is at most ``tolerance``. The reduced model has fewer than ``states`` first-order
    states. The result is None if no order is acceptable. All orders are tried in ascending order,
    because the error may increase with the order, and because models of low order need little
    computing time.
    """
    most = int(min(basis.size, (states - 1) // basis.pencil.degree))
    orders = range(max(basis.fixed, 1), most + 1)
    return next((order for order in orders if basis.is_acceptable(order, tolerance)), None)


def select_basis(
    bases: Sequence[ReducedBasis], order: int, *, prescribed: bool = False
) -> ReducedBasis:
    """Return the basis with the smallest error estimate at the given order.

    ``prescribed`` states that the user has selected the reduction method.

    Raises
    ------
    UsageError : every basis has fewer vectors than the order.
    """
    most = max(basis.size for basis in bases)
    if order > most:
        expected = f"1 to {most}"
        problem = "the full model has fewer states than this order"
        if prescribed:
            problem = "the basis of the reduction method has fewer vectors than this order"
        raise UsageError(
            problem,
            where="order",
            got=order,
            expected=expected,
            hint=f"use the order {most}",
        )
    candidates = (basis for basis in bases if order <= basis.size)
    return min(candidates, key=lambda basis: basis.estimate_model_error(order))


def select_fewest_states(
    task: ReductionTask,
    reductors: Sequence[Reductor],
    tolerance: float,
    *,
    shorten: bool,
    keep_form: bool,
) -> tuple[ReducedBasis, int]:
    """Find the basis and the order that meet the tolerance with the fewest states.

    Congruences are preferred. An oblique projection is used only if all ports are signals, and if
    the projection needs fewer states than a congruence. An oblique projection replaces a congruence
    of definite matrices only if the oblique projection needs at least about 9 % fewer states. For
    passive symmetric models of first order, only congruences are used, because balanced truncation
    is a congruence of such models. If ``keep_form`` is true, only congruences are used. If
    ``shorten`` is true, the reductor that computed the congruence first searches for a basis of
    fewer vectors.

    Raises
    ------
    SimulationError : no model of any order is acceptable.
    """
    congruences = [item for item in reductors if item.congruence]
    others = [] if keep_form else [item for item in reductors if not item.congruence]
    signals = choose_default_norm(task.fom) == "peak" and not keep_form
    form = _prove_stability(task)
    share = SAVING_RATIO if form and form.proof == DEFINITE_EVIDENCE else 1.0
    relaxing = form is not None and form.passive and task.response.pencil.degree == 1
    other = None
    if signals and not relaxing:
        other = _select_fewest_states(task, others, tolerance, task.state_count + 1)
    if other and not form:  # without a proof of stability, a congruence has no advantage
        return _describe_origin(other)
    most = int(other[1] / share) if other else np.inf
    # a basis with more states than `most` may need fewer states after it is shortened
    limit = np.inf if shorten else most + 1
    reductor, basis, order = _select_smallest_order(
        task, congruences, tolerance, limit, bool(other)
    )
    if order is not None and shorten:
        basis, order = reductor.shorten_basis(basis, order, tolerance)
        order = find_least_order(basis, tolerance, basis.count_states(order)) or order
    if other and (order is None or basis.count_states(order) > most):
        need = f"more than {most}" if order is None else f"{basis.count_states(order)}"
        return _describe_origin(
            other, f"a congruence transformation needs {need} first-order states; "
        )
    assert order is not None
    states = basis.count_states(order)
    if other is None and (signals or basis.count_states(basis.size) <= MAX_COMPARED_STATES):
        other = _select_fewest_states(task, others, tolerance, int(np.ceil(share * states)))
    if other and other[1] < states:
        text = f"{states} first-order states by a congruence transformation, "
        text += f"{other[1]} by an oblique projection; "
        basis = replace(basis, origin=text)
    return basis, order


def _prove_stability(task: ReductionTask) -> StabilityProof | None:
    """Prove that a model and its congruent projections are stable, or return None.

    The proof is for the intermediate model. The result is None for a first-order model that is not
    symmetric, because a congruence does not preserve the stability of such a model.
    """
    pencil = task.response.pencil
    if pencil.degree == 2 or (pencil.is_symmetric and pencil.is_collocated):
        return task.proof
    return None


def _select_fewest_states(
    task: ReductionTask, reductors: Sequence[Reductor], tolerance: float, states: float
) -> tuple[ReducedBasis, int] | None:
    """Select a basis, and the fewest states of this basis that meet the tolerance.

    The number of states must be smaller than ``states``; otherwise, the result is None. If the
    error is measured in the norm *peak*, the basis that meets the tolerance with the fewest states
    is selected. In the norm *pointwise*, the first basis that meets the tolerance is selected. By
    default, this basis comes from balancing over the band, which represents notches accurately.
    """
    best = None
    for reductor in reductors:
        basis = reductor.basis(task) if reductor.applies_to(task) else None
        order = find_least_order(basis, tolerance, states) if basis else None
        if basis is None or order is None:
            continue
        best, states = (basis.copy_with_method(reductor.name), order), basis.count_states(order)
        if task.norm == "pointwise":
            break
    return best


def _select_smallest_order(
    task: ReductionTask,
    reductors: Sequence[Reductor],
    tolerance: float,
    states: float,
    optional: bool,
) -> tuple[Reductor, ReducedBasis, int | None]:
    """Select the reductor that meets the tolerance with the smallest order.

    Return this reductor, its basis and the order. If no reductor meets the tolerance with fewer
    than ``states`` states and ``optional`` is true, return the first applicable reductor, its
    basis and None. If ``optional`` is false, raise an error instead.
    """
    bases = [(item, item.basis(task)) for item in reductors if item.applies_to(task)]
    rows = [(item, basis.copy_with_method(item.name)) for item, basis in bases if basis is not None]
    orders = [find_least_order(basis, tolerance, states) for _, basis in rows]
    acceptable = [(order, k) for k, order in enumerate(orders) if order is not None]
    if not acceptable:
        if not optional:
            raise make_tolerance_error([basis for _, basis in rows], tolerance)
        return *rows[0], None
    order, k = min(acceptable)
    return *rows[k], order


def _describe_origin(result: tuple[ReducedBasis, int], text: str = "") -> tuple[ReducedBasis, int]:
    """Describe the origin of a basis by the name of its method, followed by ``text``.

    ``result`` contains the basis and the order of its reduced model; the order is unchanged.
    """
    basis, order = result
    return replace(basis, origin=f"{basis.method}; {text}"), order


def require_order(basis: ReducedBasis, tolerance: float, advice: str) -> int:
    """Return the smallest order within tolerance; raise an error if there is none.

    ``advice`` is the hint for the user if the basis has fewer vectors than the model has unknowns.

    Raises
    ------
    SimulationError : no model of any order is acceptable.
    """
    order = find_least_order(basis, tolerance)
    if order is not None:
        return order
    if basis.size < basis.task.pencil_without_rigid_modes.size:
        count = "1 vector" if basis.size == 1 else f"{basis.size} vectors"
        problem = f"the basis of the reduction method has only {count}"
        raise make_tolerance_error([basis], tolerance, problem, advice)
    raise make_tolerance_error([basis], tolerance)


def make_tolerance_error(
    bases: Sequence[ReducedBasis],
    tolerance: float,
    problem: str = "",
    advice: str = "use a larger tolerance or a narrower band",
) -> Exception:
    """Make the error for bases that do not meet the tolerance at any order.

    ``problem`` is the cause if it is known, and ``advice`` is the hint for the user.
    """
    errors = [(basis.estimate_model_error(basis.size), basis.size) for basis in bases]
    error, size = min(errors)
    return make_inaccuracy_error(
        "the tolerance is out of reach" + (f": {problem}" if problem else ""),
        f"estimate {error:.1e} with {size} basis vectors",
        tolerance,
        advice,
    )
