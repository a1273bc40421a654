"""Balanced truncation, over all frequencies or over a band.

Balanced coordinates are in the order in which states are reached and seen: over all frequencies by
the Gramians of a stable model, or over a band by samples of its states and of those of its dual,
weighted by the norm of the reduction: what is small in the response counts little relative to its
peak, and as much as anything else pointwise.

Sources: square root method, Laub, Heath, Paige and Ward, IEEE Trans. Autom. Control 32 (1987) 115;
balancing by quadrature, Gosea, Gugercin and Beattie, SIAM J. Sci. Comput. 44 (2022) A408.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.linalg import lapack, qr

from kc2spice.rom.pencil import Pencil, explicit
from kc2spice.rom.reduced_basis import Reduction
from kc2spice.rom.response import Response
from kc2spice.rom.state_space import in_hertz, standard

STRICT = 1e-9  # damping of the slowest pole, per rad at the band's end
RANK = 1e-13  # singular values below this are rounding


def by_gramians(model: Pencil, rows: np.ndarray, columns: np.ndarray) -> Pencil | None:
    """The :func:`standard` model balanced over all frequencies, outputs over ``rows`` and inputs
    over ``columns``; None where it is not strictly stable."""
    T = -model.coefficients[0]
    if np.linalg.eigvals(T).real.max() > -STRICT:
        return None
    reached = _gramian_root(T, model.B / columns, "N", "T")
    return _balanced(model, reached, _gramian_root(T, (model.C / rows[:, None]).T, "T", "N"))


def by_samples(model: Response, s: np.ndarray, inputs: np.ndarray, outputs: np.ndarray) -> Pencil:
    """The standard model balanced over samples at ``s``, with weights (len(s), inputs) and
    (len(s), outputs) on its answers and on those of its dual."""
    reached = _columns(model.states(s) * inputs[:, None, :])
    seen = _columns(model.dual.states(s) * outputs[:, None, :])
    return _balanced(model.pencil, reached, seen)


def weights(frequency: np.ndarray, base: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of inputs and outputs at each frequency.

    They weight an integral over the band of errors relative to ``base`` (len(frequency), outputs,
    inputs).
    """
    step = np.sqrt(np.gradient(frequency) if len(frequency) > 1 else np.ones(1))
    rows, columns = scales(base)
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
    return explicit(-W.T @ model.coefficients[0] @ T, W.T @ model.B, model.C @ T, model.D)


def _gramian_root(T: np.ndarray, Q: np.ndarray, way: str, other: str) -> np.ndarray:
    """R with ``X = R R'``, ``T X + X T' = -Q Q'``, or with T transposed; rounding may leave X
    slightly indefinite."""
    X, scale, _ = lapack.dtrsyl(T, T, -Q @ Q.T, trana=way, tranb=other)
    values, vectors = np.linalg.eigh(0.5 / scale * (X + X.T))
    return vectors * np.sqrt(np.maximum(values, 0.0))


def _columns(x: np.ndarray) -> np.ndarray:
    """A square root of the sum of ``x x*`` over all samples, real."""
    columns = np.moveaxis(x, 0, 1).reshape(x.shape[1], -1)
    both = np.hstack([columns.real, columns.imag])
    return np.asarray(qr(both.T, mode="r", overwrite_a=True, check_finite=False)[0][: len(both)].T)


BALANCED = 2000  # first-order states at most
UNSCALED = 500  # states up to which balancing without scaled outputs is tried too
SAMPLED = 900  # states up to which samples take no more time than Gramians
ALL = "balanced truncation"
THINNED = 4  # every so many samples are enough where no notches count


def balanced(like: Reduction, states: int, tolerance: float) -> tuple[Reduction, int] | None:
    """The same subspace model in first order and balanced coordinates, over all frequencies or over
    the band, if that has fewer than so many ``states``; None where it has not, or the model is free
    to move or too large."""
    judge, free = like.judge, like.judge.exact.pencil.free
    core, top = judge.exact.core, judge.band[1]
    if not like.space.static or core.free or like.states(judge.exact.pencil.size) > BALANCED:
        return None
    model = Response(standard(core, top))
    H, entries = judge.reference
    peak = entries.peak
    factors = scales(peak)
    ways = {ALL: lambda: by_gramians(model.pencil, *factors)}
    if model.pencil.size <= UNSCALED and peak.size > 1:
        one = [np.ones(len(item)) for item in factors]
        ways[f"{ALL} of outputs as they are"] = lambda: by_gramians(model.pencil, *one)
    if model.pencil.size <= SAMPLED and model.diagonal:
        step = 1 if judge.norm == "pointwise" else THINNED
        f = judge.frequency[::step]
        factors_over_band = weights(f, entries.base(H[::step], judge.share))
        over = {f"{ALL} over the band": lambda: by_samples(model, 1j * f / top, *factors_over_band)}
        ways = over | ways if judge.norm == "pointwise" else ways | over
    best = None
    for name, way in ways.items():
        small = way()
        if small is None:
            continue
        if free:
            small = small.joined(standard(judge.exact.pencil.leading(free), top))
        pencil = in_hertz(small, top)
        other = replace(like, pencil=pencil, first=pencil.free, origin=name, balanced=True)
        fewer = other.fewest(tolerance, states)
        if fewer is not None:
            best, states = (other, fewer), fewer
            if judge.norm == "pointwise":
                break  # Gramians know nothing of notches
    return best
