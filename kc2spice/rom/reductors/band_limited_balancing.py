"""Balanced truncation over a frequency band, by samples of the states."""

from __future__ import annotations

import numpy as np
import scipy

from kc2spice.rom.reduced_basis import ReducedBasis, ReductionTask
from kc2spice.rom.reductors.balanced_truncation import (
    balance_model,
    compute_balancing_factors,
    explain_no_gramians,
    explain_too_large,
)
from kc2spice.rom.reductors.base import Reductor

# largest number of first-order states for which the method is tried; found by trials
MAX_STATES = 900
# Every fourth sample is enough in the norm *peak*, which ignores notches; found by trials.
PEAK_NORM_STEP = 4


class BandLimitedBalancing(Reductor):
    """Balanced truncation with Gramians that are sums over samples in the band.

    The Gramians are sums of ``x x*`` and ``y y*`` over the frequencies of the error estimate, with
    the states ``x = (j w - A)^-1 B`` and ``y = (j w - A)^-* C'``. The terms of the sums for the
    Gramians are weighted according to the chosen error norm, *peak* or *pointwise*. In the norm
    *peak*, the weights make errors relative to the peak of the response. In the norm *pointwise*,
    the weights make errors relative to the response at the same frequency.

    Examples
    --------
    One relaxation is far above the band, but its static response needs a second state.

    >>> import numpy as np
    >>> import kc2spice as kc
    >>> A, B = np.diag([-1.0, -1e6]), np.array([[1.0], [1e3]])
    >>> model = kc.LinearModel(A=A, B=B, C=B.T)
    >>> aims = {"tolerance": 1e-3, "band": (0, 0.1), "norm": "peak"}
    >>> kc.reduce(model, **aims, method="frequency-limited balanced truncation").order
    2
    """

    name = "frequency-limited balanced truncation"
    reference = (
        "Gawronski and Juang, Int. J. Syst. Sci. 21 (1990) 349; by quadrature: Gosea, Gugercin and "
        "Beattie, SIAM J. Sci. Comput. 44 (2022), arXiv:2104.01006"
    )
    congruence = False

    def obstacle(self, task: ReductionTask) -> str:
        """Explain why the method does not apply to the model; return "" if it applies."""
        reason = explain_no_gramians(task) or explain_too_large(
            task.first_order_response.pencil.size, MAX_STATES
        )
        if reason or task.first_order_response.is_decoupled:
            return reason
        return "the eigenvectors of the model are nearly parallel, so that sampling would be slow"

    def basis(self, task: ReductionTask) -> ReducedBasis | None:
        """Return the basis that balances the model over the band, or None."""
        return task.get_shared_value(self.name, lambda: self._balance(task))

    def _balance(self, task: ReductionTask) -> ReducedBasis | None:
        """Compute the balanced basis from samples of the response."""
        estimator, response = task.estimator, task.first_order_response
        step = 1 if task.norm == "pointwise" else PEAK_NORM_STEP
        frequency, (H, entries) = estimator.frequency[::step], estimator.exact_response_and_scales
        inputs, outputs = _compute_weights(
            frequency, entries.compute_error_divisors(H[::step], estimator.min_relative_divisor)
        )
        s = 1j * frequency / task.band[1]
        controllable = _compute_sum_root(response.states(s) * inputs[:, None, :])
        observable = _compute_sum_root(response.dual_response.states(s) * outputs[:, None, :])
        return balance_model(task, response.pencil, controllable, observable)


def _compute_weights(frequency: np.ndarray, base: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the weights of inputs and outputs in the sums over frequencies.

    With these weights, a sum over the frequencies approximates an integral over the band. The
    integrand is an error relative to ``base``, an array of shape (frequencies, outputs, inputs).
    """
    step = np.sqrt(np.gradient(frequency) if len(frequency) > 1 else np.ones(1))
    rows, columns = compute_balancing_factors(base)
    return step[:, None] / columns, step[:, None] / rows


def _compute_sum_root(x: np.ndarray) -> np.ndarray:
    """Return a real square root R of the real part of ``sum x x*``."""
    columns = np.moveaxis(x, 0, 1).reshape(x.shape[1], -1)
    both = np.hstack([columns.real, columns.imag])
    return np.asarray(
        scipy.linalg.qr(both.T, mode="r", overwrite_a=True, check_finite=False)[0][: len(both)].T
    )
