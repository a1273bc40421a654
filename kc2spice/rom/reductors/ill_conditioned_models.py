"""Oblique projection of ill-conditioned models on iteratively refined solutions.

In some dense models, rounding errors of large matrix entries exceed the small matrix entries that
determine slow motions. Eigenvectors and projections of such models are inaccurate. Solutions are
accurate if they are refined with residuals in extended precision. The solutions ``X = P(s)^-1 B``
and ``Y = P(s)^-T C'`` at a few frequencies span two bases. A projection of the model on both bases
needs the product ``A X``, which is computed as ``s E X - B``, without the inaccurate matrix A.

Source: balancing by samples, Gosea, Gugercin and Beattie, SIAM J. Sci. Comput. 44 (2022),
arXiv:2104.01006.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kc2spice.linalg.extended_precision import RefinedSolver
from kc2spice.rom.error_estimate import compute_relative_errors, make_inaccuracy_error
from kc2spice.rom.intermediate_model import IntermediateModel
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.response import (
    FLANK_DISTANCE,
    MIN_DAMPING_RATIO,
    Response,
    make_frequency_grid,
    sample_band,
)
from kc2spice.rom.rounding import describe_uncertainty, estimate_rounding_uncertainty
from kc2spice.rom.transfer_function_error_scales import EntryScales

# the following numbers of frequencies were found by trials
FIRST_SAMPLES = 12  # number of samples before the error is first estimated
MAX_SAMPLES = 90  # largest number of samples
CANDIDATE_FREQUENCIES = 151  # number of candidate frequencies for the next sample
# Candidates for the relative singular value below which singular vectors are omitted as noise. The
# candidate with the smallest error at the samples is used.
NOISE_LIMITS = 10.0 ** -np.arange(13, 6, -1)


def split_real_parts(x: np.ndarray) -> list[np.ndarray]:
    """Split complex vectors into real parts and, if nonzero, imaginary parts."""
    return [x.real, x.imag] if np.iscomplexobj(x) and x.imag.any() else [x.real]


class ExactSamples:
    """Exact solutions of a full model at sample frequencies, as projection basis."""

    def __init__(self, pencil: Pencil) -> None:
        self.pencil = pencil
        self.frequency = np.empty(0)
        self.H = np.empty((0, *pencil.D.shape), dtype=complex)
        n = pencil.size
        self._E = pencil.coefficients[1]
        self._solver = RefinedSolver(*pencil.coefficients)
        self._right, self._images = np.empty((n, 0)), np.empty((n, 0))
        self._left = np.empty((n, 0))

    def add_sample(self, frequency: float) -> None:
        """Solve the full model at ``frequency`` [Hz], and add the solutions as samples.

        Raises
        ------
        SimulationError : the frequency is a pole.
        """
        P, s = self.pencil, 2j * np.pi * frequency
        x, y = self._solver.solve_two_sided(s, P.B, P.C)
        self.frequency = np.r_[self.frequency, frequency]
        self.H = np.concatenate([self.H, (P.C @ x + P.D)[None]])
        image = s * (self._E @ x) - P.B
        size = np.linalg.norm(x, axis=0)
        self._right = np.hstack([self._right, *split_real_parts(x / size)])
        self._images = np.hstack([self._images, *split_real_parts(image / size)])
        self._left = np.hstack([self._left, *split_real_parts(y / np.linalg.norm(y, axis=0))])

    def find_best_projection(self) -> tuple[Pencil, float]:
        """Return the most accurate oblique projection, and its error at the samples.

        The error is the largest relative error at the samples.
        """
        W, P = self._left, self.pencil
        U, size, Vt = np.linalg.svd(W.T @ (self._E @ self._right))
        inner = W.T @ self._images
        B, C = W.T @ P.B, P.C @ self._right
        models = []
        for order in sorted(
            {int((size > cut * size[0]).sum()) for cut in NOISE_LIMITS}, reverse=True
        ):
            root = np.sqrt(size[:order])
            left, right = U[:, :order] / root, Vt[:order].T / root
            small = Pencil((-(left.T @ inner @ right), np.eye(order)), left.T @ B, C @ right, P.D)
            small = _remove_growing_poles(small)
            response = Response(small).transfer(2j * np.pi * self.frequency)
            error = self.compute_relative_errors(response - self.H, self.H).max(initial=0.0)
            models.append((error, order, small))
        error, _, best = min(models, key=lambda found: found[:2])
        return best, float(error)

    def compute_relative_errors(self, difference: np.ndarray, H: np.ndarray) -> np.ndarray:
        """Return the relative errors of a response ``difference``, compared with ``H``.

        The divisor of an entry is its magnitude in ``H``, but at least a share of its peak in all
        samples.
        """
        return compute_relative_errors(difference, H, EntryScales.from_response(self.H))


def reduce_by_samples(
    full: Pencil, band: tuple[float, float], target: float, limit: float
) -> IntermediateModel:
    """Reduce an ill-conditioned model by exact solutions at sample frequencies.

    The model must be of first order.

    Raises
    ------
    SimulationError : the error exceeds ``limit``, or the model has rigid-body modes.
    """
    known = ExactSamples(full)
    every = make_frequency_grid(band, CANDIDATE_FREQUENCIES, True)
    for k in np.unique(np.linspace(0, len(every) - 2, FIRST_SAMPLES).astype(int)):
        known.add_sample(float(every[k]))
    last = Response(known.find_best_projection()[0])
    known.add_sample(float(band[1]))
    model, _ = known.find_best_projection()
    recent = [np.inf]
    while len(known.frequency) < MAX_SAMPLES:
        before = Response(model)
        points = sample_band(before, band, CANDIDATE_FREQUENCIES, True)
        points = points[~np.isclose(points[:, None], known.frequency, rtol=1e-7).any(axis=1)]
        if not points.size:
            break
        H = before.transfer(2j * np.pi * points)
        change = known.compute_relative_errors(last.transfer(2j * np.pi * points) - H, H).max(
            axis=(1, 2)
        )
        worst = int(np.argmax(change))
        known.add_sample(float(points[worst]))
        error = float(known.compute_relative_errors(H[worst] - known.H[-1], known.H[-1]).max())
        last = before
        model, fit = known.find_best_projection()
        recent = [*recent[-1:], max(error, fit)]
        if max(recent) <= target or (
            len(known.frequency) > MAX_SAMPLES // 2 and max(recent) <= limit
        ):
            break
    if not max(recent) <= limit:
        raise make_inaccuracy_error(
            "rounding errors prevent an accurate reduction of this ill-conditioned model",
            f"relative error {max(recent):.1e} with {model.size} states",
            limit,
            "increase the tolerance or narrow the band",
        )
    proof = f"compared with refined solutions of the full model at {len(known.frequency)} "
    response = Response(model)
    at, ratio = response.select_band_resonances(band)
    at = at * (1 + FLANK_DISTANCE * (ratio < MIN_DAMPING_RATIO)) if at.size else np.array(band)
    proof += "frequencies" + describe_uncertainty(
        at, estimate_rounding_uncertainty(full, at), 2 * limit
    )
    return IntermediateModel(response, max(recent), True, proof)


def _remove_growing_poles(small: Pencil) -> Pencil:
    """Remove growing poles that rounding errors cause in a reduced stable model.

    The result consists of decoupled real blocks, one for each real pole or pair of complex poles.
    """
    from kc2spice.rom.decoupled_blocks import decouple_states

    blocks, X, inverse = decouple_states(-small.coefficients[0])
    A = np.zeros_like(X)
    keep, start = [], 0
    for block in blocks:
        rows = np.arange(start, start + len(block))
        start += len(block)
        A[np.ix_(rows, rows)] = block
        if np.linalg.eigvals(block).real.max() < 0:
            keep += rows.tolist()
    B, C = inverse @ small.B, small.C @ X
    part = A[np.ix_(keep, keep)]
    return replace(small, coefficients=(-part, np.eye(len(keep))), B=B[keep], C=C[:, keep])
