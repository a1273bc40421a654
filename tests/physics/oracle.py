"""Poles and responses of matrices by scipy and numpy alone: what certificates are judged by."""

import signal
from contextlib import contextmanager

import numpy as np
from scipy.linalg import eigvals, lu_factor, lu_solve

FLOOR = 1e-6  # of an entry's peak; below it errors count against this part of the peak
SHARES = {"pointwise": FLOOR, "peak": 1.0}  # of an entry's peak that its errors count against
SECONDS = 60  # that any reduction may take
ROUNDING = 1e-9  # of either solution
SHARP = 3e-7  # damping ratio, nearly, of a pole that counts as undamped
FLANK = 1e-4  # relative distance from an undamped pole, which no frequency hits exactly


def polynomial(matrices):
    """``(P0, P1[, P2])`` with ``P(s) = sum s^k Pk``, by the definitions alone."""
    if "M" in matrices:
        K = matrices["K"]
        return K, matrices.get("E", 0 * K), matrices["M"]
    if "A" in matrices:
        A = matrices["A"]
        return -A, matrices.get("E", np.eye(len(A)))
    return matrices["K"], matrices["E"]


def system(matrices):
    """``(P, B, C, D)``; C is B' and D zero where they are not given."""
    C = matrices["C"] if "C" in matrices else matrices["B"].T
    D = np.zeros((len(C), matrices["B"].shape[1]))
    return polynomial(matrices), matrices["B"], C, D


def system_of(model):
    """The same of a model of the product, full or reduced."""
    given = {k: getattr(model, k) for k in ("AE" if model.first_order else "MEK")}
    dense = {k: v.toarray() if hasattr(v, "toarray") else v for k, v in given.items()}
    if model.rayleigh is not None:
        dense["E"] = model.rayleigh[0] * dense["M"] + model.rayleigh[1] * dense["K"]
    return polynomial(dense), model.B, model.C, model.D


def poles(P):
    """Finite eigenvalues [rad/s] of the pencil, infinite ones left out."""
    zero, one = np.zeros_like(P[0]), np.eye(len(P[0]))
    scale = 1.0
    if len(P) == 3:
        scale = np.sqrt(np.abs(P[0]).max() / np.abs(P[2]).max())
        left = np.block([[zero, one], [-P[0], -scale * P[1]]])
        right = np.block([[one, zero], [zero, scale**2 * P[2]]])
    else:
        left, right = -P[0], P[1]
    found = eigvals(left, right)
    found = found[np.isfinite(found)] * scale
    return found[np.abs(found) < 1e9 * np.median(np.abs(found) + 1e-30)]  # infinite ones, rounded


def direct(model, frequency, refined=True):
    """(frequencies, outputs, inputs), one solution after the other, refined unless told."""
    P, B, C, D = model
    exact, columns, found = [np.asarray(each, np.longdouble) for each in P], B.shape[1], []
    for s in 2j * np.pi * np.asarray(frequency):
        factors = lu_factor(sum(s**k * each for k, each in enumerate(P)), check_finite=False)
        x = lu_solve(factors, B.astype(complex), check_finite=False)
        if refined:  # the slow motion of a free body is the small difference of large forces
            parts = (each @ np.hstack([x.real, x.imag]).astype(np.longdouble) for each in exact)
            parts = (each[:, :columns] + 1j * each[:, columns:] for each in parts)
            rest = B - sum(np.clongdouble(s) ** k * each for k, each in enumerate(parts))
            x = x + lu_solve(factors, rest.astype(complex), check_finite=False)
        found.append(C @ x + D)
    return np.array(found)


def fine(model, band, found):
    """On and beside every pole near the band and in between, then into the notches, where relative
    errors are largest."""
    near = found[(found.imag > 1e-7 * 2 * np.pi * band[1]) & (found.imag < 2.2 * np.pi * band[1])]
    at, width = near.imag / (2 * np.pi), np.abs(near.real) / (2 * np.pi)
    width = np.where(width < SHARP * at, FLANK * at, width)
    offsets = np.r_[0.3, 0.7, 1.0, 1.7, 3.0, 10.0, 40.0]
    beside = at[:, None] + width[:, None] * np.r_[-offsets, 0.0, offsets]
    between = np.r_[np.linspace(*band, 150), np.geomspace(1e-4, 1, 60) * band[1]]
    every, known = clear(np.r_[beside.ravel(), between], band, found), {}
    for _ in range(3):
        new = [f for f in every if f not in known]
        known |= {f: np.abs(H).ravel() for f, H in zip(new, direct(model, new, False), strict=True)}
        size = np.pad([known[f] for f in every], ((1, 1), (0, 0)), constant_values=np.inf)
        lowest = (size[1:-1] < size[:-2]) & (size[1:-1] <= size[2:])
        every = clear(zoomed(every, np.flatnonzero(lowest.any(axis=1))), band, found)
    return every


def clear(points, band, found):
    """Select nonzero ``points`` in the band that are not close to an undamped pole."""
    at = found.imag[np.abs(found.real) < SHARP * found.imag] / (2 * np.pi)
    points = np.unique(points[(points >= band[0]) & (points <= band[1]) & (points > 0)])
    return points[(np.abs(points[:, None] - at) >= 0.99 * FLANK * at).all(axis=1)]


def zoomed(frequency, at):
    """``frequency`` with more points on both sides of each ``at``."""
    ends = np.maximum(at - 1, 0), np.minimum(at + 1, len(frequency) - 1)
    return np.unique(np.r_[frequency, *np.linspace(*frequency[np.array(ends)], 7, axis=1)])


def largest_error(model, reduced, band, free=None, share=FLOOR):
    """Of all entries over the band, at the points of :func:`fine` and closer and closer around the
    largest, relative to each entry or to a ``share`` of its peak.

    The motion ``free`` (n, motions) of a body that nothing holds grows without bound: the peak that
    notches count against is that of the response without it.
    """
    found = poles(model[0])
    frequency = fine(model, band, found)
    exact = direct(model, frequency)
    whole = 0.0
    if free is not None:
        P, B, C, D = model
        whole = direct(([free.T @ each @ free for each in P], free.T @ B, C @ free, D), frequency)
    peak = share * np.abs(exact - whole).max(axis=0)

    def errors(frequency, exact):
        difference = np.abs(direct(reduced, frequency) - exact)
        return (difference / np.maximum(np.abs(exact), peak)).max(axis=(1, 2))

    error = errors(frequency, exact)
    for _ in range(4):
        beside = np.pad(error, 1, constant_values=-1.0)
        top = np.flatnonzero((error >= beside[:-2]) & (error >= beside[2:]))
        top = top[np.argsort(error[top])[-8:]]
        new = np.setdiff1d(clear(zoomed(frequency, top), band, found), frequency)
        if not new.size:
            break
        both = np.r_[frequency, new]
        order = np.argsort(both)
        frequency, error = both[order], np.r_[error, errors(new, direct(model, new))][order]
    return float(error.max())


@contextmanager
def bounded(seconds=SECONDS):
    """Of processor time: a machine that others use too takes longer by the clock."""

    def late(*_):
        raise AssertionError(f"no end after {seconds} s")

    before = signal.signal(signal.SIGPROF, late)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)
