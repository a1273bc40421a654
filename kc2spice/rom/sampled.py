"""Ill-conditioned dense models by what they answer: exact samples make the subspace model.

Where rounding of the large entries of a matrix exceeds its slow motions, neither its eigenvectors
nor its projections keep digits. Solutions do, refined with residuals in extended precision. The
states ``X = P(s)^-1 B`` and ``Y = P(s)^-T C'`` at a few frequencies span two bases, and ``A X = s E
X - B`` projects the model on them without a product with the large matrix.

Sources: rational interpolation by oblique projection, Grimme 1997; balancing by samples, Gosea,
Gugercin and Beattie, SIAM J. Sci. Comput. 44 (2022) A408.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from kc2spice.linalg.exact import Solver
from kc2spice.rom.krylov import real_parts
from kc2spice.rom.pencil import Pencil, first_order
from kc2spice.rom.response import FLOOR, Response, grid, inexact, relative_size, samples

FIRST, MOST = 12, 90  # frequencies before the error is judged, and at all
CANDIDATES = 151
CUTS = 10.0 ** -np.arange(13, 6, -1)  # of the largest singular value: directions that are noise


class Samples:
    """Exact answers of a first-order pencil and the models that they make."""

    def __init__(self, pencil: Pencil, band: tuple[float, float]) -> None:
        self.pencil, self.band = pencil, band
        self.frequency = np.empty(0)
        self.H = np.empty((0, *pencil.D.shape), dtype=complex)
        n = pencil.size
        self._E = pencil.coefficients[1]
        self._solver = Solver(*pencil.coefficients)
        self._right, self._images = np.empty((n, 0)), np.empty((n, 0))
        self._left = np.empty((n, 0))

    def add(self, frequency: float) -> None:
        """Solve the full model at ``frequency`` [Hz].

        Raises
        ------
        SimulationError : that is a pole.
        """
        P, s = self.pencil, 2j * np.pi * frequency
        x, y = self._solver.at(s, P.B, P.C)
        self.frequency = np.r_[self.frequency, frequency]
        self.H = np.concatenate([self.H, (P.C @ x + P.D)[None]])
        image = s * (self._E @ x) - P.B
        size = np.linalg.norm(x, axis=0)
        self._right = np.hstack([self._right, *real_parts(x / size)])
        self._images = np.hstack([self._images, *real_parts(image / size)])
        self._left = np.hstack([self._left, *real_parts(y / np.linalg.norm(y, axis=0))])

    def model(self) -> tuple[Pencil, float]:
        """The oblique projection that reproduces the samples best, and its largest error there."""
        W, P = self._left, self.pencil
        U, size, Vt = np.linalg.svd(W.T @ (self._E @ self._right))
        inner = W.T @ self._images
        B, C = W.T @ P.B, P.C @ self._right
        models = []
        for order in sorted({int((size > cut * size[0]).sum()) for cut in CUTS}, reverse=True):
            root = np.sqrt(size[:order])
            left, right = U[:, :order] / root, Vt[:order].T / root
            small = Pencil((-(left.T @ inner @ right), np.eye(order)), left.T @ B, C @ right, P.D)
            small = _decaying(small)
            found = Response(small).transfer(2j * np.pi * self.frequency)
            error = self.relative(found - self.H, self.H).max(initial=0.0)
            models.append((error, order, small))
        error, _, best = min(models, key=lambda found: found[:2])
        return best, float(error)

    def relative(self, difference: np.ndarray, H: np.ndarray) -> np.ndarray:
        """Sizes relative to ``H`` or to the floor of the samples' peak."""
        return relative_size(difference, H, np.abs(self.H).max(axis=0))


def sampled(
    pencil: Pencil, band: tuple[float, float], target: float, limit: float
) -> tuple[Pencil, float, int]:
    """A first-order model within ``target`` of the full one, or within ``limit``; its error, and at
    how many frequencies that was checked.

    Raises
    ------
    SimulationError : not even ``limit`` is met; a model free to move at zero frequency.
    """
    known = Samples(first_order(pencil, 2 * np.pi * band[1]), band)
    every = grid(band, CANDIDATES, True)
    for k in np.unique(np.linspace(0, len(every) - 2, FIRST).astype(int)):
        known.add(float(every[k]))
    last = Response(known.model()[0])
    known.add(float(band[1]))
    model, _ = known.model()
    recent = [np.inf]
    while len(known.frequency) < MOST:
        before = Response(model)
        points = samples(before, band, CANDIDATES, True)
        points = points[~np.isclose(points[:, None], known.frequency, rtol=1e-7).any(axis=1)]
        if not points.size:
            break
        H = before.transfer(2j * np.pi * points)
        change = known.relative(last.transfer(2j * np.pi * points) - H, H).max(axis=(1, 2))
        worst = int(np.argmax(change))
        known.add(float(points[worst]))
        error = float(known.relative(H[worst] - known.H[-1], known.H[-1]).max())
        last = before
        model, fit = known.model()
        recent = [*recent[-1:], max(error, fit)]
        if max(recent) <= target or (len(known.frequency) > MOST // 2 and max(recent) <= limit):
            break
    if not max(recent) <= limit:
        raise inexact(
            "the model cannot be told from rounding",
            f"relative error {max(recent):.1e} with {model.size} states",
            limit,
            "ask for a looser tolerance or a narrower band",
        )
    return model, max(recent), len(known.frequency)


def uncertainty(
    pencil: Pencil,
    frequency: np.ndarray,
    states: np.ndarray | None = None,
    dual: np.ndarray | None = None,
) -> np.ndarray:
    """How far the last digits of a dense model's entries move its response (relative) at each
    ``frequency`` [Hz]: ``eps |y_i P_ij x_j|``, root of the sum of squares.

    ``states`` x (frequencies, n, inputs), and those of the ``dual``, may be known better than from
    solutions here."""
    s = 2j * np.pi * frequency
    x = pencil.states(s) if states is None else states
    y = x if pencil.symmetric and pencil.collocated else dual
    y = pencil.transposed().states(s) if y is None else y
    found = []
    for each, right, left in zip(s, np.abs(x) ** 2, np.abs(y) ** 2, strict=True):
        squares = sum(np.abs(each**k * P) ** 2 for k, P in enumerate(pencil.coefficients))
        found.append(np.sqrt(left.T @ squares @ right))
    H = np.abs(pencil.C @ x + pencil.D)
    size = np.array(found) / np.maximum(H, FLOOR * H.max(axis=(1, 2), keepdims=True))
    return np.asarray(np.finfo(float).eps * size.max(axis=(1, 2)))


def _decaying(small: Pencil) -> Pencil:
    """In real blocks of its poles, without those that grow: of a stable model they are noise."""
    from kc2spice.rom.blocks import decoupled

    blocks, X, inverse = decoupled(-small.coefficients[0])
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
