"""Poles and responses of matrices by scipy and numpy alone: what certificates are judged by."""

import numpy as np
from scipy.linalg import eigvals

FLOOR = 1e-6  # of an entry's peak; below it errors count against this part of the peak
ROUNDING = 1e-9  # of either solution
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


def system_of(rom):
    """The same of a reduced model."""
    found = {k: getattr(rom, k) for k in ("AEB" if rom.first_order else "MEKB")}
    return polynomial(found), rom.B, rom.C, rom.D


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


def direct(model, frequency):
    """(frequencies, outputs, inputs), one solution after the other."""
    P, B, C, D = model
    fine, columns, found = [np.asarray(each, np.longdouble) for each in P], B.shape[1], []
    for s in 2j * np.pi * np.asarray(frequency):
        whole = sum(s**k * each for k, each in enumerate(P))
        x = np.linalg.solve(whole, B.astype(complex))
        # refined: the slow motion of a free body is the small difference of large forces
        parts = (each @ np.hstack([x.real, x.imag]).astype(np.longdouble) for each in fine)
        parts = (each[:, :columns] + 1j * each[:, columns:] for each in parts)
        rest = B - sum(np.clongdouble(s) ** k * each for k, each in enumerate(parts))
        found.append(C @ (x + np.linalg.solve(whole, rest.astype(complex))) + D)
    return np.array(found)


def fine(model, band, found):
    """On and beside every pole near the band and in between, then into the notches, where relative
    errors are largest."""
    found = found[found.imag > 1e-7 * 2 * np.pi * band[1]] / (2 * np.pi)
    found = found[found.imag < 1.1 * band[1]]
    width = np.abs(found.real)
    sharp = width < 3e-7 * found.imag
    width = np.where(sharp, FLANK * found.imag, width)
    offsets = np.r_[0.3, 0.7, 1.0, 1.7, 3.0, 10.0, 40.0]
    near = found.imag[:, None] + width[:, None] * np.r_[-offsets, 0.0, offsets]
    between = np.r_[np.linspace(*band, 150), np.geomspace(1e-4, 1, 60) * band[1]]

    def kept(points):
        points = np.unique(points[(points >= band[0]) & (points <= band[1]) & (points > 0)])
        clear = np.abs(points[:, None] - found.imag[sharp]) >= 0.99 * FLANK * found.imag[sharp]
        return points[clear.all(axis=1)]

    every = kept(np.r_[near.ravel(), between])
    for _ in range(3):
        size = np.abs(direct(model, every)).reshape(len(every), -1)
        lowest = (size[1:-1] < size[:-2]) & (size[1:-1] <= size[2:])
        every = kept(zoomed(every, np.flatnonzero(lowest.any(axis=1))))
    return every


def zoomed(frequency, at):
    """``frequency`` with more points in the gaps beside the inner point of each ``at``."""
    return np.unique(np.r_[frequency, *(np.linspace(*frequency[[k, k + 2]], 7) for k in at)])


def largest_error(model, reduced, band, free=None, share=FLOOR):
    """Of all entries over the band, at the points of :func:`fine`, relative to each entry or to a
    ``share`` of its peak.

    The motion ``free`` (n, motions) of a body that nothing holds grows without bound: the peak that
    notches count against is that of the response without it.
    """
    frequency = fine(model, band, poles(model[0]))
    exact = direct(model, frequency)
    whole = 0.0
    if free is not None:
        P, B, C, D = model
        whole = direct(([free.T @ each @ free for each in P], free.T @ B, C @ free, D), frequency)
    base = np.maximum(np.abs(exact), share * np.abs(exact - whole).max(axis=0))
    return float((np.abs(direct(reduced, frequency) - exact) / base).max())
