"""Balanced truncation: coordinates in the order in which states are reached and seen.

Over all frequencies by the Gramians of a stable model, or over a band by samples of its states and
of those of its dual, weighted by the norm that the reduction is certified in: what is small in the
response counts little relative to its peak, and as much as anything else pointwise.

Sources: square root method, Laub, Heath, Paige and Ward, IEEE Trans. Autom. Control 32 (1987) 115;
balancing by quadrature, Gosea, Gugercin and Beattie, SIAM J. Sci. Comput. 44 (2022) A408.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import lapack, qr, schur

from kc2spice.rom.linear import Norm
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.response import FLOOR, Response
from kc2spice.rom.statespace import state_space

STRICT = 1e-9  # damping of the slowest pole, per rad at the band's end
RANK = 1e-13  # singular values below this are rounding


def standard(pencil: Pencil, top: float) -> Pencil:
    """``x' = A x + B u`` with rates per rad at ``top`` [Hz] and A in real Schur form, with which
    Gramians and eigenvectors begin."""
    omega = 2 * np.pi * top
    A, B, C, D = state_space(pencil, top)
    T, Z = schur(A / omega, output="real")
    return Pencil((-T, np.eye(len(T))), Z.T @ B / omega, C @ Z, D)


def in_hertz(pencil: Pencil, top: float) -> Pencil:
    """The inverse of what :func:`standard` does to time."""
    omega = 2 * np.pi * top
    rest, one = pencil.coefficients
    return Pencil((omega * rest, one), omega * pencil.B, pencil.C, pencil.D, free=pencil.free)


def by_gramians(model: Pencil, rows: np.ndarray, columns: np.ndarray) -> Pencil | None:
    """The :func:`standard` model balanced over all frequencies, outputs over ``rows`` and inputs
    over ``columns``; None where it is not strictly stable."""
    T = -model.coefficients[0]
    if np.linalg.eigvals(T).real.max() > -STRICT:
        return None
    loads = (model.B / columns, "N", "T"), ((model.C / rows[:, None]).T, "T", "N")
    reached, seen = (_root(_lyapunov(T, Q, *ways)) for Q, *ways in loads)
    return _balanced(model, reached, seen)


def _lyapunov(T: np.ndarray, Q: np.ndarray, way: str, other: str) -> np.ndarray:
    """X of ``T X + X T' = -Q Q'``, or with T transposed."""
    X, scale, _ = lapack.dtrsyl(T, T, -Q @ Q.T, trana=way, tranb=other)
    return np.asarray(X / scale)


def by_samples(model: Response, s: np.ndarray, inputs: np.ndarray, outputs: np.ndarray) -> Pencil:
    """The standard model balanced over samples at ``s``, with weights (len(s), inputs) and
    (len(s), outputs) on its answers and on those of its dual."""
    reached = _columns(model.states(s) * inputs[:, None, :])
    seen = _columns(model.dual.states(s) * outputs[:, None, :])
    return _balanced(model.pencil, reached, seen)


def weights(
    frequency: np.ndarray, H: np.ndarray, peak: np.ndarray, norm: Norm
) -> tuple[np.ndarray, np.ndarray]:
    """Of inputs and outputs at each frequency for an integral over the band, in the norm."""
    step = np.sqrt(np.gradient(frequency) if len(frequency) > 1 else np.ones(1))
    size = peak[None] if norm == "peak" else np.maximum(np.abs(H), FLOOR * peak)
    rows, columns = scales(size)
    return step[:, None] / columns, step[:, None] / rows


def scales(size: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Factors of rows and columns whose products are next to ``size`` (..., rows, columns)."""
    log = np.log(np.where(size > 0, size, size.max(initial=0.0) or 1.0))
    half = 0.5 * log.mean(axis=(-2, -1))[..., None]
    return np.exp(log.mean(axis=-1) - half), np.exp(log.mean(axis=-2) - half)


def _balanced(model: Pencil, reached: np.ndarray, seen: np.ndarray) -> Pencil:
    U, size, Vt = np.linalg.svd(seen.T @ reached)
    kept = int((size > RANK * size[0]).sum())
    T = reached @ Vt[:kept].T / np.sqrt(size[:kept])
    W = seen @ U[:, :kept] / np.sqrt(size[:kept])
    return Pencil(
        (W.T @ model.coefficients[0] @ T, np.eye(kept)), W.T @ model.B, model.C @ T, model.D
    )


def _root(gramian: np.ndarray) -> np.ndarray:
    """R with ``R R' = gramian``, which rounding may leave slightly indefinite."""
    values, vectors = np.linalg.eigh(0.5 * (gramian + gramian.T))
    return vectors * np.sqrt(np.maximum(values, 0.0))


def _columns(x: np.ndarray) -> np.ndarray:
    """A square root of the sum of ``x x*`` over all samples, real."""
    columns = np.moveaxis(x, 0, 1).reshape(x.shape[1], -1)
    both = np.hstack([columns.real, columns.imag])
    return np.asarray(qr(both.T, mode="r", overwrite_a=True, check_finite=False)[0][: len(both)].T)
