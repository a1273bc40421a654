"""Errors of reduced models in the time domain, compared with larger models.

The error in a certificate is the largest error of a reduced model at any frequency. If a sharp
resonance is shifted by a thousandth of its frequency, the error in the certificate is 100 %, even
if the loads of a run do not excite the resonance. Therefore, this module compares the reduced model
with a model of more states. Both models respond over time to the recorded loads of a run. The
responses are exact for loads that are linear between the recorded points. The model with more
states also contains modes above the band, because contacts excite such modes.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.linalg import LinAlgError, eig

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.rom.constraints import eliminate_algebraic_unknowns
from kc2spice.rom.definiteness import is_definite
from kc2spice.rom.intermediate_reduction import build_intermediate_model
from kc2spice.rom.linear_model import LinearModel, Norm, make_linear_model
from kc2spice.rom.modal_models import (
    Resonators,
    compute_resonators,
    integrate_modal_states,
    simulate_resonators,
)
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.reduce import ReductionTarget, reduce_to_target
from kc2spice.rom.reductors.block_krylov import BlockArnoldi, make_krylov_space

# Number of states of the comparison model, relative to the number of states of the reduced model.
# Example: a reduced model of 30 states computes the stroke of a kicked chip with 0.1 % damping.
# A stroke computed with 30 states differs by 1.9 % (rms) from the stroke computed with 60 states,
# and by 1.7 % from the strokes computed with 120 and with 300 states.
STATE_RATIO = 2
MIN_ADDED_STATES = 60  # smallest number of additional states of the comparison model
# Upper band limit of the comparison model, relative to the requested upper band limit.
# Only comparison models with expansion points at frequencies above zero get a wider band.
BAND_RATIO = 2.0
TARGET_ERROR = 1e-6  # requested error of the comparison model over the wider band
MAX_ERROR = 1e-3  # largest accepted error of the comparison model over the wider band
# Largest product of the numbers of time points and modes in one slice.
# A complex array with MAX_STORED_VALUES entries needs 64 MB.
MAX_STORED_VALUES = 4_000_000
# condition number of the eigenvectors above which sums of modes lose significant digits
MAX_CONDITION = 1e8
# largest variation that counts as constant, relative to the largest value of the load or response
CONSTANT_VARIATION = 1e-9


class ReductionsByOrder:
    """Reductions of a full-order model by order, with larger models for comparison.

    For a model with definite matrices, all orders use one Krylov subspace. The basis of a larger
    order contains the basis of a smaller order.
    """

    def __init__(self, model: LinearModel) -> None:
        self.model = model

    @cached_property
    def _pencil(self) -> Pencil:
        """Pencil of the full-order model without algebraic unknowns."""
        return eliminate_algebraic_unknowns(self.model.pencil)

    @cached_property
    def _krylov_space(self) -> BlockArnoldi | None:
        """Krylov subspace of the pencil, or None if the pencil is not definite."""
        definite = is_definite(self._pencil, undamped_too=True)
        return make_krylov_space(self._pencil) if definite else None

    def reduce(self, order: int, band: tuple[float, float], norm: Norm) -> LinearModel:
        """Return the reduced model of the given order, suited to bodies with contacts."""
        target = ReductionTarget(
            None, order, band, norm, contact=True, method=None, space=self._krylov_space
        )
        return reduce_to_target(self.model, target)

    def make_enriched_model(self, order: int, band: tuple[float, float]) -> LinearModel:
        """Return a model with many more than ``order`` states, for a comparison.

        Raises
        ------
        SimulationError, UsageError : the model cannot be reduced with sufficient accuracy.
        """
        pencil, ports = self._pencil, self.model.ports
        states = max(STATE_RATIO * order, order + MIN_ADDED_STATES)
        if pencil.size <= states:
            return make_linear_model(pencil.make_dense(), ports)
        if self._krylov_space is not None:
            return make_linear_model(pencil.project(self._krylov_space.vectors(states)), ports)
        wide = band[0], BAND_RATIO * band[1]
        return make_linear_model(
            build_intermediate_model(pencil, wide, TARGET_ERROR, MAX_ERROR).pencil, ports
        )


def compute_time_response(model: LinearModel, t: np.ndarray, load: np.ndarray) -> np.ndarray | None:
    """Compute the outputs of a model at the times ``t`` (n,) under a ``load``.

    Return an array of shape (n, outputs). Between the times ``t``, the load is linear. At the first
    time, the model is in equilibrium with ``load[0]``. The result is None if the response cannot be
    computed as a sum of modes: the model has rigid-body modes, or nearly dependent eigenvectors.
    """
    modal, result = compute_resonators(model), load @ model.D.T
    if modal is not None:
        parts = (_select_modes(modal, rows) for rows in _split_modes(modal.order, t.size))
        return np.asarray(result + sum(simulate_resonators(part, t, load)[0] for part in parts))
    try:
        A, B, C, direct = model.state_space()
        poles, T = eig(A)
        gains = np.linalg.solve(T, B.astype(complex))
        result = load @ direct.T
    except (UsageError, SimulationError, LinAlgError):
        return None
    if np.linalg.cond(T) > MAX_CONDITION or not poles.all():
        return None
    for rows in _split_modes(poles.size, t.size):
        result += (
            integrate_modal_states(poles[rows], t, load @ gains[rows].T) @ (C @ T[:, rows]).T
        ).real
    return result if np.isfinite(result).all() else None


def _split_modes(modes: int, points: int) -> Iterator[slice]:
    """Yield slices of modes whose responses at all time points fit into memory."""
    count = max(1, MAX_STORED_VALUES // points)
    return (slice(first, first + count) for first in range(0, modes, count))


def _select_modes(modal: Resonators, rows: slice) -> Resonators:
    """Return resonators with only the modes ``rows``, and without a direct term."""
    massless = int(np.count_nonzero(modal.inertia[rows] == 0))
    return replace(
        modal,
        omega=modal.omega[rows],
        damp=modal.damp[rows],
        gain=modal.gain[rows],
        D=np.zeros_like(modal.D),
        massless=massless,
    )


def find_last_change(load: np.ndarray) -> int:
    """Return the index of the last time point at which any load changes."""
    step = np.abs(np.diff(load, axis=0)) > CONSTANT_VARIATION * np.abs(load).max(axis=0)
    changes = np.flatnonzero(step.any(axis=1))
    return int(changes[-1]) + 1 if changes.size else 0


def compute_time_errors(
    small: LinearModel,
    rich: LinearModel,
    t: np.ndarray,
    load: np.ndarray,
    groups: Sequence[np.ndarray],
) -> Mapping[str, float] | None:
    """Compute relative rms errors of a reduced model over time, keyed by output.

    The errors are the differences from the responses of ``rich``, a model with more states. Both
    models respond to the ``load`` (n, inputs) at the times ``t`` (n,). The error of an output is
    the rms difference between the two models, divided by the largest rms deviation of the output
    from its first value. The rms deviation of each output is computed for all loads together, for
    each group of inputs alone, and for the direct term D of each input alone. ``groups`` contains a
    mask of inputs for each group. If the effects of two groups of loads cancel, the error is
    divided by the larger of the two effects, not by the small total effect. For example, effects of
    loads may cancel in the voltage across an open electrode. Return None if the response of a model
    cannot be computed.
    """
    ours = compute_time_response(small, t, load)
    alone = [compute_time_response(rich, t, load * group) for group in groups]
    known = [item for item in alone if item is not None]
    if ours is None or len(known) < len(groups):
        return None
    exact = np.sum(known, axis=0)
    direct = load[:, None, :] * rich.D
    rows = [exact, *known, *np.moveaxis(direct, 2, 0)]
    scale = np.max([_compute_rms(t, row - row[0]) for row in rows], axis=0)
    scale = np.maximum(scale, CONSTANT_VARIATION * np.abs(exact).max(axis=0))
    difference = _compute_rms(t, (ours - ours[0]) - (exact - exact[0]))
    errors = np.divide(difference, scale, out=np.zeros_like(scale), where=scale > 0)
    return dict(zip(small.outputs, errors.tolist(), strict=True))


def _compute_rms(t: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Compute the rms values (outputs,) over time of ``values`` (n, outputs)."""
    return np.asarray(np.sqrt(np.trapezoid(values**2, t, axis=0) / (t[-1] - t[0])))
