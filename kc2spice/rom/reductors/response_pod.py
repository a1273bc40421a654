"""Reduction by proper orthogonal decomposition (POD) of frequency responses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy

from kc2spice.rom.pencil import Pencil
from kc2spice.rom.reduced_basis import ReducedBasis, ReductionTask
from kc2spice.rom.reductors.base import Reductor
from kc2spice.rom.reductors.snapshots import choose_snapshots, choose_tail_weight, weight_states
from kc2spice.rom.response import Response

# condition number of the stiffness matrix above which the smallest elastic energy of a mode is a
# rounding error
MAX_STIFFNESS_CONDITION = 1e12
# largest relative singular value of snapshots that counts as a rounding error
SINGULAR_VALUE_LIMIT = 1e-13
# limits and factors of the fit of snapshot weights, found by trials
MAX_SHORTENED_ORDER = 150  # largest order for which weights are fitted
MAX_TRIALS = 12  # largest number of updates of the weights
# A basis of n vectors may be replaced by fewer vectors from the span of N vectors.
# For a basis of n vectors, the number N is max(3 n, n + MIN_EXTRA_VECTORS).
MIN_EXTRA_VECTORS = 20
# No shorter basis is computed if the model with N basis vectors has an error above
# EXTRA_ERROR_SHARE times the tolerance.
EXTRA_ERROR_SHARE = 0.5
# An update multiplies the weight of each frequency by sqrt(error / largest error + MIN_WEIGHT).
MIN_WEIGHT = 0.05
# Each trial multiplies the weights of snapshots above the band by TAIL_FADING. The certificate does
# not cover frequencies above the band.
TAIL_FADING = 0.5


class ResponsePod(Reductor):
    """Reduction by proper orthogonal decomposition of the response over the band.

    The first basis vectors are the static responses to the ports, so static gains are exact. The
    other vectors are left singular vectors of snapshots of the response. The snapshots are weighted
    so that relative errors are small. The singular vectors are computed in coordinates in which the
    elastic energy is a sum of squares. If ``two_sided`` is true, snapshots of the dual model are
    added, which unsymmetric models require.

    Examples
    --------
    A chain of masses has few directions of motion in a low band.

    >>> import numpy as np
    >>> import kc2spice as kc
    >>> K = 2 * np.eye(40) - np.eye(40, k=1) - np.eye(40, k=-1)
    >>> chain = kc.LinearModel(M=np.eye(40), K=K, B=np.eye(40)[:, :1], rayleigh=(0, 0.1))
    >>> kc.reduce(
    ...     chain, tolerance=1e-2, band=(0, 0.02), norm="peak", method="response POD"
    ... ).order
    3
    """

    reference = "Berkooz, Holmes and Lumley, Annu. Rev. Fluid Mech. 25 (1993) 539"

    def __init__(self, two_sided: bool = False) -> None:
        self.two_sided = two_sided
        self.name = "response POD" + (" of both sides" if two_sided else "")

    def basis(self, task: ReductionTask) -> ReducedBasis:
        """Return the basis of static responses and principal directions of snapshots."""
        core, free = task.pencil_without_rigid_modes, task.pencil_without_rigid_modes.free
        energy = _compute_energy_basis(
            core.without_rigid_body_modes, 2 * np.pi * task.band[1], task.intermediate.static
        )
        response = Response(core.project(scipy.linalg.block_diag(np.eye(free), energy)))
        static = _compute_static_responses(task, response)
        points = choose_snapshots(
            task.estimator, response, choose_tail_weight(task.fom, task.tolerance)
        )
        states = _compute_weighted_states(
            task, response, points.s, points.weights(), self.two_sided
        )
        vectors = _extend_orthonormal_basis(np.hstack(states)[free:], static)
        pencil = response.pencil.project(scipy.linalg.block_diag(np.eye(free), vectors))
        pencil = task.prepend_rigid_modes(replace(pencil, free=free))
        fixed = pencil.free + (static.shape[1] if _has_loaded_port(task) else 0)
        columns = task.add_rigid_body_vectors(
            scipy.linalg.block_diag(np.eye(free), energy @ vectors)
        )
        return ReducedBasis(task, pencil, fixed, vectors=columns)

    def shorten_basis(
        self, basis: ReducedBasis, order: int, tolerance: float
    ) -> tuple[ReducedBasis, int]:
        """Shorten a basis if the tolerance permits; return the basis and its order.

        Each trial increases the weights of snapshots where the model of the next lower order has
        the largest errors (Lawson's minimax fit). Each trial decreases the weights above the band.
        """
        size, least = (
            min(basis.size, max(3 * order, order + MIN_EXTRA_VECTORS)),
            max(basis.fixed, 1),
        )
        if (
            order <= least
            or order > MAX_SHORTENED_ORDER
            or basis.estimate_model_error(size) > EXTRA_ERROR_SHARE * tolerance
        ):
            return basis, order
        pencil, task = basis.pencil.truncate_to_order(size), basis.task
        response = Response(pencil)
        points = choose_snapshots(task.estimator, response, choose_tail_weight(task.fom, tolerance))
        s, inside = points.s, slice(points.inside.size)
        H = task.response.transfer(s[inside])
        base = (
            task.estimator.exact_response_and_scales[1].compute_error_divisors(
                H, task.estimator.min_relative_divisor
            )
            + np.finfo(float).tiny
        )
        states = _compute_weighted_states(
            task, response, s, np.ones(len(s)), not task.is_collocated
        )
        weight, tail, best = np.ones(points.inside.size), 1.0, basis
        for _ in range(MAX_TRIALS):
            factors = points.weights(weight, tail)
            columns = np.hstack([_scale_states(side, factors) for side in states])[basis.fixed :]
            V = scipy.linalg.block_diag(
                np.eye(basis.fixed), _compute_principal_directions(columns)[0]
            )
            rotated_vectors = None if basis.vectors is None else basis.vectors[:, :size] @ V
            projected = replace(pencil.project(V), free=pencil.free)
            trial = replace(basis, pencil=projected, vectors=rotated_vectors)
            while order > least:
                trial_response = Response(trial.pencil.truncate_to_order(order - 1)).transfer(
                    s[inside]
                )
                error = np.abs(trial_response - H) / base
                if error.max() > tolerance or not trial.is_acceptable(order - 1, tolerance):
                    break
                best, order = trial, order - 1
            largest = error.max(axis=(1, 2))
            weight = weight * np.sqrt(largest / largest.max() + MIN_WEIGHT)
            weight, tail = weight / weight.max(), TAIL_FADING * tail
        return best, order


def _has_loaded_port(task: ReductionTask) -> bool:
    """Return whether the input of any port is a load, such as a force or heat flow.

    The static responses to loads remain exact.
    """
    return any(port.is_flow_driven for port in task.fom.ports)


def _compute_static_responses(task: ReductionTask, response: Response) -> np.ndarray:
    """Compute orthonormal vectors (n, k) that span the static responses of a model.

    The unknowns of rigid-body modes are omitted. If damping couples rigid-body modes to other
    motions, the damping forces of rigid-body modes count as loads. If all ports are signals, static
    responses are needed only for a band that begins at zero.
    """
    pencil, free = response.pencil, task.pencil_without_rigid_modes.free
    if free:
        K, E, _ = pencil.coefficients
        loads = [pencil.B[free:], E[free:, :free], E[:free, free:].T]
        return _select_significant_directions(np.linalg.solve(K[free:, free:], np.hstack(loads)))
    needed_at_zero = task.estimator.static and task.band[0] == 0
    if task.intermediate.static and (needed_at_zero or _has_loaded_port(task)):
        return _select_significant_directions(response.states(np.zeros(1))[0].real)
    return np.empty((pencil.size, 0))


def _compute_weighted_states(
    task: ReductionTask, response: Response, s: np.ndarray, weight: np.ndarray, two_sided: bool
) -> list[np.ndarray]:
    """Compute weighted snapshots of states, and of dual states if ``two_sided``."""
    H = task.response.transfer(s)
    result = [weight_states(response, s, weight, H, task.norm)]
    if two_sided:
        dual = weight_states(response.dual_response, s, weight, H.swapaxes(1, 2), task.norm)
        result.append(dual)
    return result


def _scale_states(states: np.ndarray, factors: np.ndarray) -> np.ndarray:
    """Multiply the state vectors of each frequency by the factor of this frequency.

    ``states`` and the result have the shape (n, 2 * frequencies * inputs), with the real parts
    before the imaginary parts.
    """
    inputs = states.shape[1] // (2 * len(factors))
    return np.asarray(states * np.tile(np.repeat(factors, inputs), 2))


def _compute_energy_basis(pencil: Pencil, omega: float, static: bool) -> np.ndarray:
    """Compute coordinates in which the elastic energy is a sum of squares.

    If the stiffness matrix K is not definite, ``K + omega**2 M`` is used instead, with the mass
    matrix M and ``omega`` in rad/s. For a first-order model, ``K + omega E`` is used instead. If
    the matrix with ``omega`` is also not definite, the result is the unit matrix. If ``static`` is
    false, the stiffness matrix counts as singular, even if a Cholesky factor exists due to rounding
    errors.
    """
    rest, inertia = pencil.coefficients[0], pencil.coefficients[-1]
    dynamic = rest + omega**pencil.degree * inertia
    for energy in (rest, dynamic) if static else (dynamic,):
        energy = 0.5 * (energy + energy.T)
        if np.linalg.cond(energy) > MAX_STIFFNESS_CONDITION:
            continue
        try:
            return np.asarray(
                scipy.linalg.solve_triangular(scipy.linalg.cholesky(energy), np.eye(pencil.size))
            )
        except scipy.linalg.LinAlgError:
            continue
    return np.eye(pencil.size)


def _extend_orthonormal_basis(columns: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Extend an orthonormal basis ``first`` by principal directions of ``columns``."""
    for _ in range(2):  # the second projection removes rounding errors of the first
        columns = columns - first @ (first.T @ columns)
    return np.asarray(
        np.linalg.qr(np.hstack([first, _compute_principal_directions(columns)[0]]))[0]
    )


def _select_significant_directions(columns: np.ndarray) -> np.ndarray:
    """Select principal directions of ``columns`` with sizes above rounding errors."""
    U, size = _compute_principal_directions(columns)
    return np.asarray(
        U[:, size > SINGULAR_VALUE_LIMIT * max(size.max(initial=0.0), np.finfo(float).tiny)]
    )


def _compute_principal_directions(columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Compute the left singular vectors and the singular values of ``columns``."""
    # the transposed triangular factor has the same singular values and fewer columns
    if columns.shape[1] > 2 * columns.shape[0]:
        columns = np.asarray(np.linalg.qr(columns.T, mode="r")).T
    U, size, _ = np.linalg.svd(columns, full_matrices=False)
    return U, size
