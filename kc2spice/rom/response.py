"""Frequency responses of dense pencils: at which frequencies to look, and how far two differ."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import TypeAlias

import numpy as np
from scipy.linalg import LinAlgError, eigh, matrix_balance, null_space, schur

from kc2spice.core.errors import SimulationError
from kc2spice.rom.linear import Norm, Port
from kc2spice.rom.pencil import Pencil

# Errors of entries this far below their own peak are measured against this part of the peak.
FLOOR = 1e-6
# A response this far below the sum of its terms is what their cancellation leaves: a zero.
CANCELLED = 1e-13
# Off-diagonal modal damping below this is rounding of damping that decouples.
COUPLING = 1e-9
# A resonance sharper than this cannot be hit by a frequency that is not exact to rounding; errors
# are then measured on its flanks, at this relative distance.
SHARPEST = 1e-7
FLANK = 1e-4
ABOVE = np.array([2.0, 4.0])  # times the band's end: where contact still excites a body
CLUSTER = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 5.0, 15.0, 60.0])  # half widths around a resonance
GRID = 200
NOTCHES, ZOOM, ROUNDS = 60, 9, 20
SAME = 1e-12  # of a frequency, by which rounding alone sets two apart
STEEP = 1.5  # times a minimum: what is larger beside it, or smaller between, shows a deeper one
PEAKS, PEAK_ROUNDS = 40, 3
# Poles of a model that is free to move below this share of the band's end are its free motion:
# rigid bodies, with what slows them down, and integrators.
LOOSE = 1e-2
CONTOUR, APART = 128, 1.2  # points on a circle around those poles, ratio of radii that it parts

FEW, MANY = 12, 900  # unknowns, and states, between which eigenvectors pay
REPRODUCED, TOLERABLE = 1e-11, 1e-9  # by eigenvectors, by Schur vectors
BLOCK = 32  # rows that are substituted together
SOFT = 1e8  # ratio of squared frequencies of neighbours: the lower is a motion without force
DEFECTIVE = 1e10  # condition of eigenvectors: a free body moves on in a Jordan block
Modes: TypeAlias = tuple[np.ndarray, np.ndarray, tuple[np.ndarray, ...] | np.ndarray]


class Response:
    """A dense pencil with coordinates in which it is diagonal or triangular, where it has such.

    ``modes`` is None, or ``(T, L, diagonals)``: ``x = T diag(1 / sum_k s^k diagonals_k) L B``, or
    ``(T, L, R)`` with upper triangular R: ``x = T (s - R)^-1 L B``.
    ``decoupled`` says that T is a real congruence (``L = T'``).
    """

    def __init__(self, pencil: Pencil) -> None:
        self.pencil = pencil
        self.modes = _decoupled(pencil)
        self.decoupled = self.modes is not None
        if self.modes is None and FEW < pencil.size <= MANY / pencil.degree:
            self.modes = _eigenvectors(pencil)

    @property
    def sound(self) -> bool:
        """Whether well-conditioned modes diagonalise it, or it is too small to look for any."""
        return self.pencil.size <= FEW or (
            self.modes is not None and isinstance(self.modes[2], tuple)
        )

    @property
    def quick(self) -> bool:
        """Whether no sample needs a factorisation of many unknowns."""
        return self.modes is not None or self.pencil.size <= FEW

    def states(self, s: np.ndarray) -> np.ndarray:
        """``P(s)^-1 B`` (len(s), n, m) in the pencil's own coordinates."""
        if self.modes is None:
            return self.pencil.states(s)
        return np.asarray(self.modes[0] @ self._modal(s))

    def transfer(self, s: np.ndarray) -> np.ndarray:
        """``C P(s)^-1 B + D`` (len(s), outputs, inputs)."""
        if self.modes is None:
            return self.pencil.transfer(s)
        T, L, core = self.modes
        if not isinstance(core, tuple):
            return np.asarray((self.pencil.C @ T) @ self._modal(s) + self.pencil.D)
        residues = (self.pencil.C @ T).T[:, :, None] * (L @ self.pencil.B)[:, None, :]
        found = self._gains(s) @ residues.reshape(len(residues), -1)
        return np.asarray(found.reshape(-1, *self.pencil.D.shape) + self.pencil.D)

    def transposed(self) -> Response:
        """That of the dual model, whose coordinates are known."""
        return self._known(
            self.pencil.transposed(),
            lambda T, L, core: (
                (L.T, T.T, core)
                if isinstance(core, tuple)
                else (L.T[:, ::-1], T.T[::-1], core.T[::-1, ::-1])
            ),
        )

    def turned(self, V: np.ndarray) -> Response:
        """That of the congruence ``V'PV`` by a square V."""
        left = partial(np.linalg.solve, V)
        return self._known(self.pencil.project(V), lambda T, L, core: (left(T), left(L.T).T, core))

    def _known(self, pencil: Pencil, change: Callable[..., Modes]) -> Response:
        found = object.__new__(Response)
        found.pencil, found.decoupled, found.modes = pencil, self.decoupled, None
        if self.modes is not None:
            found.modes = change(*self.modes)
        return found

    def cancelled(self, s: np.ndarray) -> np.ndarray:
        """(outputs, inputs) whether an entry is zero at all ``s`` but for rounding of its terms."""
        s = s[:: max(1, len(s) // 100)]
        x = self.states(s)
        terms = np.abs(self.pencil.C) @ np.abs(x).max(axis=0) + np.abs(self.pencil.D)
        size = np.abs(self.pencil.C @ x + self.pencil.D).max(axis=0)
        return np.asarray(size <= CANCELLED * terms)

    def free_motion(self, s: np.ndarray, below: float) -> np.ndarray:
        """Part (len(s), outputs, inputs) of the transfer function that belongs to the poles of
        less than ``below`` [rad/s], at ``s`` outside of them.

        Symmetric second order: ``C X (s^2 X'MX + s X'EX + X'KX)^-1 X'B`` with the modes X of (K, M)
        in question. Others: the principal part at zero, by integrals on a circle around the poles.
        """
        pencil, s = self.pencil, np.asarray(s, dtype=complex)
        none = np.zeros((len(s), *pencil.D.shape), dtype=complex)
        if pencil.degree == 2 and pencil.symmetric:
            try:
                k, T = eigh(pencil.coefficients[0], pencil.coefficients[2])
            except LinAlgError:
                return none  # no definite mass
            few = pencil.project(T[:, np.abs(k) < below**2])
            return few.transfer(s) - few.D if few.size else none
        sizes = np.sort(np.abs(pencil.poles(below)))
        inside = int((sizes < below).sum())
        if not inside:
            return none
        ends = np.r_[np.maximum(sizes[:inside], 1e-3 * below), sizes[inside:], 1e3 * below]
        ratios = ends[1 : inside + 1] / ends[:inside]
        last = inside - int(np.argmax(ratios[::-1]))  # of several the one farthest out
        if ratios[last - 1] < APART:
            return none
        radius = np.sqrt(ends[last - 1] * ends[last])
        around = radius * np.exp(2j * np.pi * (np.arange(CONTOUR) + 0.5) / CONTOUR)
        H = self.transfer(around)
        powers = around[:, None] ** np.arange(1, last + 1)
        moments = np.einsum("sk,sij->kij", powers, H) / CONTOUR
        return np.asarray(
            np.einsum("sk,kij->sij", s[:, None] ** -np.arange(1.0, last + 1), moments)
        )

    def peaks(
        self, frequency: np.ndarray, H: np.ndarray, band: tuple[float, float], static: bool
    ) -> np.ndarray:
        """Largest size (outputs, inputs) of the response H at ``frequency`` [Hz]; of a model that
        is free to move without its free motion, which grows without bound towards zero and would
        hide everything else."""
        if not static:
            top = 2 * np.pi * band[1]
            H = H - self.free_motion(2j * np.pi * frequency, LOOSE * top)
        return np.asarray(np.abs(H).max(axis=0))

    def _modal(self, s: np.ndarray) -> np.ndarray:
        _, L, core = self.modes  # type: ignore[misc]
        b = L @ self.pencil.B
        if isinstance(core, tuple):
            return np.asarray(self._gains(s)[:, :, None] * b)
        return _substituted(core, np.asarray(s, dtype=complex), b)

    def _gains(self, s: np.ndarray) -> np.ndarray:
        """``1 / sum_k s^k diagonals_k`` (len(s), n)."""
        s = np.asarray(s, dtype=complex)[:, None]
        diagonals = self.modes[2]  # type: ignore[index]
        return np.asarray(1 / sum(s**k * d for k, d in enumerate(diagonals)))

    @cached_property
    def poles(self) -> np.ndarray:
        """Finite poles [1/s] of a model whose modes are coupled."""
        if self.modes is None:
            return self.pencil.poles()
        core = self.modes[2]
        return -core[0] if isinstance(core, tuple) else np.diag(core)

    @cached_property
    def resonances(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequency [Hz] and damping ratio of the oscillating poles."""
        if not self.decoupled or self.pencil.degree == 1:
            found = np.empty(0) if self.decoupled else self.poles
            found = found[found.imag > 0]
            return found.imag / (2 * np.pi), np.abs(found.real) / np.abs(found)
        k, e, m = self.modes[2]  # type: ignore[index]
        oscillating = (k > 0) & (e**2 < 4 * k * m)
        k, e, m = k[oscillating], e[oscillating], m[oscillating]
        omega, ratio = np.sqrt(k / m), np.abs(e) / (2 * np.sqrt(k * m))
        return omega * np.sqrt(1 - ratio**2) / (2 * np.pi), ratio

    def within(self, band: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        """The resonances inside the band."""
        frequency, ratio = self.resonances
        inside = (frequency > max(band[0], 1e-6 * band[1])) & (frequency < band[1])
        return frequency[inside], ratio[inside]


def _eigenvectors(pencil: Pencil) -> Modes | None:
    """Eigenvectors of the first-order form, else its Schur vectors, if they reproduce direct
    solutions to rounding."""
    n, inertia = pencil.size, pencil.coefficients[-1]
    try:
        inner = np.linalg.solve(inertia, np.hstack([*pencil.coefficients[:-1], np.eye(n)]))
        A, drive = -inner[:, :n], inner[:, n:]
        if pencil.degree == 2:
            A = np.block([[np.zeros((n, n)), np.eye(n)], [A, -inner[:, n : 2 * n]]])
            drive = np.vstack([np.zeros((n, n)), inner[:, 2 * n :]])
        values, X = np.linalg.eig(A)
        s = 1j * np.array([0.03, 0.3, 1.0, 3.0]) * (float(np.median(np.abs(values))) or 1.0)
        exact = pencil.states(s)
        if np.linalg.cond(X) <= DEFECTIVE:
            diagonal = X[:n], np.linalg.solve(X, drive), (-values, np.ones(values.size))
            if _apart(pencil, diagonal, s, exact)[0] < REPRODUCED:
                return diagonal
        balanced, (scale, _) = matrix_balance(A, permute=False, separate=True)
        R, Z = schur(balanced, output="complex")
    except (LinAlgError, np.linalg.LinAlgError, SimulationError, ValueError):
        return None
    triangular = scale[:n, None] * Z[:n], Z.conj().T @ (drive / scale[:, None]), R
    states, outputs = _apart(pencil, triangular, s, exact)
    return triangular if states < TOLERABLE and outputs < 0.1 * TOLERABLE else None


def _apart(pencil: Pencil, modes: Modes, s: np.ndarray, exact: np.ndarray) -> tuple[float, float]:
    """Largest differences to direct solutions, of the states and of each output's own size."""
    T, L, core = modes
    b = L @ pencil.B
    if isinstance(core, tuple):
        inner = b / (s[:, None] + core[0])[:, :, None]
    else:
        inner = _substituted(core, s, b)
    apart = T @ inner - exact
    H, dH = (np.abs(pencil.C @ x).max(axis=0) for x in (exact, apart))
    states = np.abs(apart).max(axis=1) / np.abs(exact).max(axis=1)
    return float(states.max()), float((dH / (H + np.finfo(float).tiny)).max())


def _substituted(R: np.ndarray, s: np.ndarray, b: np.ndarray) -> np.ndarray:
    """``(s - R)^-1 b`` (len(s), n, m) of an upper triangular R, all frequencies at once."""
    n, m = b.shape
    x = np.empty((n, len(s) * m), dtype=complex)
    for end in range(n, 0, -BLOCK):
        start = max(0, end - BLOCK)
        right = np.repeat(b[start:end, None, :], len(s), axis=1).reshape(end - start, -1)
        right = right + R[start:end, end:] @ x[end:]
        for k in range(end - 1, start - 1, -1):
            row = right[k - start] + R[k, k + 1 : end] @ x[k + 1 : end]
            x[k] = row / np.repeat(s - R[k, k], m)
    return np.asarray(np.moveaxis(x.reshape(n, len(s), m), 0, 1))


def graded(inertia: np.ndarray, rest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``M phi = mu K phi`` ascending, ``T'KT = 1``; modes that cost next to nothing (a free body's,
    where rounding makes K definite) apart from the others, which would drown in their rounding.

    Raises
    ------
    LinAlgError : K is not definite.
    """
    mu, T = eigh(inertia, rest)
    gaps = np.flatnonzero((mu[:-1] > 0) & (mu[1:] > SOFT * mu[:-1]))
    if not gaps.size:
        return mu, T
    soft = slice(gaps[-1] + 1, mu.size)
    others = null_space((inertia @ T[:, soft]).T)
    P, Q = (others.T @ X @ others for X in (inertia, rest))
    stiff, V = eigh(0.5 * (P + P.T), 0.5 * (Q + Q.T))
    return np.r_[stiff, mu[soft]], np.hstack([others @ V, T[:, soft]])


def _decoupled(pencil: Pencil) -> Modes | None:
    """Solved as ``M phi = mu K phi`` where K is definite: the better conditioned of the two."""
    if not pencil.symmetric or not pencil.size:
        return None
    rest, inertia = pencil.coefficients[0], pencil.coefficients[-1]
    try:
        mu, T = graded(inertia, rest)
        ends = np.ones(pencil.size), mu
    except LinAlgError:
        try:
            k, T = eigh(rest, inertia)
        except LinAlgError:
            return None
        ends = k, np.ones(pencil.size)
    if pencil.degree == 1:
        return T, T.T, ends
    damping = T.T @ pencil.coefficients[1] @ T
    diagonal = np.diag(damping).copy()
    # of both modes' own: one without damping is coupled by any, and solved as it stands
    limit = COUPLING * np.sqrt(np.abs(np.outer(diagonal, diagonal)))
    if (np.abs(damping - np.diag(diagonal)) > limit).any():
        return None
    return T, T.T, (ends[0], diagonal, ends[1])


def grid(band: tuple[float, float], count: int, static: bool) -> np.ndarray:
    """Frequencies [Hz] over the band, half linear, half logarithmic over four decades at most.

    Zero is one of them if the band starts there and the static answer exists.
    """
    low, high = band
    start = max(low, 1e-4 * high)
    frequency = np.r_[np.linspace(start, high, count), np.geomspace(start, high, count)]
    if low == 0 and static:
        frequency = np.r_[0.0, frequency]
    return np.unique(frequency)


def around(frequency: np.ndarray, ratio: np.ndarray, widths: np.ndarray = CLUSTER) -> np.ndarray:
    """Frequencies [Hz] on and beside resonances, at multiples of their half width."""
    sharp = ratio < SHARPEST
    width = np.where(sharp, FLANK, ratio)[:, None] * frequency[:, None]
    both = np.concatenate([-widths[::-1], widths])
    points = frequency[:, None] + width * both
    points[sharp] = np.where(
        np.abs(points[sharp] - frequency[sharp, None]) < 0.99 * width[sharp],
        frequency[sharp, None] + np.where(both < 0, -1, 1) * width[sharp],
        points[sharp],
    )
    return np.unique(points)


def beside(frequency: np.ndarray, ratio: np.ndarray, farthest: float) -> np.ndarray:
    """Frequencies [Hz] from the end of :func:`around` to ``farthest`` from a resonance, each three
    times as far as the last: the zero beside a weak, narrow resonance lies between two of them and
    shows as a minimum."""
    width = np.where(ratio < SHARPEST, FLANK, ratio) * frequency
    away = CLUSTER[-1] * width[:, None] * 3.0 ** np.arange(1, 16)
    near = away < farthest
    return np.unique(np.concatenate([(frequency[:, None] + k * away)[near] for k in (-1, 1)]))


def clear_of_poles(points: np.ndarray, frequency: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """``points`` without those that come closer than ``FLANK`` to an all but undamped resonance."""
    sharp = frequency[ratio < SHARPEST]
    if not sharp.size:
        return points
    nearest = np.abs(points[:, None] - sharp).min(axis=1)
    gap = sharp[np.abs(points[:, None] - sharp).argmin(axis=1)] * FLANK
    return points[nearest >= 0.98 * gap]


def telling(response: Response, band: tuple[float, float], static: bool) -> np.ndarray:
    """Frequencies [Hz] at which relative errors show: a grid, every resonance with its flanks, and
    every deep notch of any entry, found by zooming in."""
    near = 0.9 * band[0], 1.1 * band[1]
    at, ratio = response.within(near)
    frequency = np.union1d(grid(band, GRID, static), around(at, ratio))
    frequency = np.union1d(frequency, beside(at, ratio, band[1] / GRID))
    frequency = frequency[(frequency >= band[0]) & (frequency <= band[1])]
    frequency = clear_of_poles(frequency, at, ratio)
    H = response.transfer(2j * np.pi * frequency)
    for _ in range(ROUNDS):
        peak = response.peaks(frequency, H, band, static) + np.finfo(float).tiny
        lowest = _leading(H / peak).reshape(len(H) - 2, -1).min(axis=1)
        deepest = np.argsort(lowest)[: min(NOTCHES, int(np.isfinite(lowest).sum()))]
        if not deepest.size:
            break
        new = clear_of_poles(_zoomed(frequency, deepest, deepest + 2), at, ratio)
        if not new.size:
            break
        H = np.concatenate([H, response.transfer(2j * np.pi * new)])
        frequency = np.concatenate([frequency, new])
        order = np.argsort(frequency)
        frequency, H = frequency[order], H[order]
    return frequency


def _leading(H: np.ndarray) -> np.ndarray:
    """Sizes of the inner minima of responses ``H`` with a peak of 1 that may lead to a deeper one,
    infinite elsewhere: a neighbour is much larger, or the straight line to it passes much nearer
    to zero. Errors count against the floor where a notch is deeper: those are found."""
    size = np.abs(H)
    step = np.diff(H, axis=0)
    share = -(np.conj(step) * H[:-1]).real / (np.abs(step) ** 2 + np.finfo(float).tiny)
    line = np.abs(H[:-1] + np.clip(share, 0.0, 1.0) * step)
    inner = (size[1:-1] < size[:-2]) & (size[1:-1] <= size[2:]) & (size[1:-1] > FLOOR)
    steep = np.maximum(size[:-2], size[2:]) > STEEP * size[1:-1]
    inner &= steep | (STEEP * np.minimum(line[:-1], line[1:]) < size[1:-1])
    return np.where(inner, size[1:-1], np.inf)


def _zoomed(known: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """``ZOOM`` frequencies from each ``known[low]`` to ``known[high]`` that are not ``known``, each
    once: of two that rounding sets apart, one would hide a maximum that lies beside the other."""
    points = np.unique(np.linspace(known[low], known[high], ZOOM))
    points = points[np.r_[True, np.diff(points) > SAME * points[1:]]]
    at = np.searchsorted(known, points)
    below, above = known[np.maximum(at - 1, 0)], known[np.minimum(at, len(known) - 1)]
    return points[np.minimum(np.abs(points - below), np.abs(points - above)) > SAME * points]


@dataclass(frozen=True)
class Judge:
    """Judges models by the ``exact`` one at ``frequency`` [Hz], at which that is solved once;
    ``static`` says that this is not free to move."""

    exact: Response
    frequency: np.ndarray
    band: tuple[float, float]
    static: bool = True
    norm: Norm = "pointwise"

    @cached_property
    def _known(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The exact response, which entries are not zero but for rounding, their floors."""
        s = 2j * np.pi * self.frequency
        reference = self.exact.transfer(s)
        peak = self.exact.peaks(self.frequency, reference, self.band, self.static)
        share = FLOOR if self.norm == "pointwise" else 1.0
        return reference, ~self.exact.cancelled(s), share * peak

    def error(self, found: Response) -> float:
        """:func:`relative_error` over the band, in the ``norm``: at ``frequency``, then closer and
        closer around where it is largest."""
        reference, counted, floor = self._known
        frequency = self.frequency

        def sizes(points: np.ndarray, H: np.ndarray) -> np.ndarray:
            difference = np.abs(found.transfer(2j * np.pi * points) - H)
            base = np.maximum(np.abs(H), floor) + np.finfo(float).tiny
            return np.asarray((difference / base * counted).max(axis=(1, 2)))

        at, ratio = self.exact.within((0.9 * self.band[0], 1.1 * self.band[1]))
        error = sizes(frequency, reference)
        for _ in range(PEAK_ROUNDS):
            inner = np.r_[True, error[1:] >= error[:-1]] & np.r_[error[:-1] >= error[1:], True]
            top = np.argsort(np.where(inner, error, -1.0))[-PEAKS:]
            low, high = np.maximum(top - 1, 0), np.minimum(top + 1, len(error) - 1)
            new = clear_of_poles(_zoomed(frequency, low, high), at, ratio)
            if not new.size:
                break
            error = np.r_[error, sizes(new, self.exact.transfer(2j * np.pi * new))]
            frequency = np.r_[frequency, new]
            order = np.argsort(frequency)
            frequency, error = frequency[order], error[order]
        return float(error.max())


def above_band(
    ports: Sequence[Port], exact: Response, found: Response, band: tuple[float, float]
) -> tuple[tuple[float, float], ...]:
    """``above`` of a :class:`Certificate`: the largest relative difference of any mechanical port's
    own response, at ``ABOVE`` times the band's end; nothing where no port is mechanical."""
    columns = [port for port in ports if port.kind != "output"]
    rows = [port for port in ports if port.kind != "input"]
    moved = [port for port in ports if port.kind in ("mechanical", "rotational")]
    if not moved:
        return ()
    points = clear_of_poles(ABOVE * band[1], *exact.resonances)
    own = [rows.index(port) for port in moved], [columns.index(port) for port in moved]
    H, ours = (each.transfer(2j * np.pi * points)[:, *own] for each in (exact, found))
    size = np.abs(ours - H) / (np.abs(H) + np.finfo(float).tiny)
    return tuple(zip(points.tolist(), size.max(axis=1).tolist(), strict=True))


def relative_error(response: np.ndarray, reference: np.ndarray) -> float:
    """Largest ``|H - H_ref| / max(|H_ref|, FLOOR peak)`` of all pairs and frequencies."""
    return float(relative_size(response - reference, reference).max(initial=0.0))


def relative_size(
    difference: np.ndarray, reference: np.ndarray, peak: np.ndarray | None = None
) -> np.ndarray:
    """``|difference|`` over ``|reference|``, or over ``FLOOR`` of its peak where that is more."""
    size = np.abs(reference)
    base = np.maximum(size, FLOOR * (size.max(axis=0) if peak is None else peak))
    return np.divide(np.abs(difference), base, out=np.zeros_like(size), where=base > 0)
