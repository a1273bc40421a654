"""Frequency responses of dense pencils: at which frequencies to look, and how far two differ."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError
from kc2spice.rom.entries import FLOOR, Entries, share_of
from kc2spice.rom.linear import Norm, Port
from kc2spice.rom.pencil import INFINITE, Pencil, first_order, largest
from kc2spice.rom.rigid_body import free_part

# A response this far below the sum of its terms is what their cancellation leaves: a zero.
CANCELLED = 1e-13
# Off-diagonal modal damping below this is rounding of damping that decouples.
COUPLING = 1e-9
# A resonance sharper than this cannot be hit by a frequency that is not exact to rounding; errors
# are then measured on its flanks, at this relative distance.
SHARPEST = 1e-7
FLANK = 1e-4
VISIBLE = 1e-10  # least term of a visible pole, relative to the entry
VISIBLE_GRID = 50  # frequencies that give the peaks of entries
ABOVE = np.array([2.0, 4.0])  # times the band's end: where contact still excites a body
CLUSTER = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 5.0, 15.0, 60.0])  # half widths around a resonance
GRID = 200
NOTCHES = 60  # deepest minima that are refined in each round
ZOOM = 9  # frequencies in an interval that is refined
ROUNDS = 20  # rounds of refinement of notches
SAME = 1e-12  # relative difference of two equal frequencies, by rounding errors
STEEP = 1.5  # times a minimum: what is larger beside it, or smaller between, shows a deeper one
PEAKS = 40  # largest errors that are refined in each round
PEAK_ROUNDS = 3  # rounds of refinement of the largest errors
SPREAD = 6  # frequencies at which a model is looked at first, and those at which others failed
FEW = 12  # unknowns above which eigenvectors pay
MANY = 2000  # states up to which eigenvectors pay
REPRODUCED = 1e-10  # relative difference to direct solutions
SOFT = 1e8  # ratio of squared frequencies of neighbours: the lower is a motion without force
DEFECTIVE = 1e10  # condition of eigenvectors: a free body moves on in a Jordan block
Modes: TypeAlias = tuple[np.ndarray, np.ndarray, tuple[np.ndarray, ...]]


class Response:
    """A dense pencil with coordinates in which it is diagonal, where it has well-conditioned ones.

    ``modes`` is None, or ``(T, L, diagonals)``: ``x = T diag(1 / sum_k s^k diagonals_k) L B``.
    ``decoupled`` says that T is a real congruence (``L = T'``). A free motion that is detached is
    solved apart, and all this is that of the ``core``, the others; else that is the whole pencil.
    ``zero`` (outputs, inputs) are entries known to be zero by symmetry.
    """

    def __init__(
        self, pencil: Pencil, modes: Modes | None = None, zero: np.ndarray | bool = False
    ) -> None:
        self.pencil, self.zero = pencil, zero
        self.core = pencil.held if pencil.detached else pencil
        self._free = pencil.leading(pencil.free) if pencil.detached else None
        self._given = modes

    @cached_property
    def decoupled(self) -> bool:
        """See above."""
        return self._given is None and self._known is not None

    @cached_property
    def _known(self) -> Modes | None:
        return self._given or _decoupled(self.core)

    @cached_property
    def modes(self) -> Modes | None:
        """See above; eigenvectors are computed when they are asked for."""
        pays = FEW < self.core.size <= MANY / self.core.degree
        return self._known or (_eigenvectors(self.core) if pays else None)

    @cached_property
    def dual(self) -> Response:
        """Response of the transposed pencil, in the same coordinates."""
        if self.modes is None or self._free:
            return Response(self.pencil.transposed())
        T, L, diagonals = self.modes
        return Response(self.pencil.transposed(), (L.T, T.T, diagonals))

    @property
    def diagonal(self) -> bool:
        """Whether there are such coordinates, or so few unknowns that none are needed."""
        return self.modes is not None or self.core.size <= FEW

    def states(self, s: np.ndarray) -> np.ndarray:
        """``P(s)^-1 B`` (len(s), n, m) in the pencil's own coordinates."""
        if self.modes is None:
            x = self.core.states(s)
        else:
            T, L, _ = self.modes
            parts = self._gains(s).T[:, :, None] * (L @ self.core.B)[:, None, :]
            result = T @ parts.reshape(len(parts), -1)  # one product: many small ones take longer
            x = result.reshape(-1, *parts.shape[1:]).swapaxes(0, 1)
        return np.concatenate([self._free.states(s), x], axis=1) if self._free else x

    def transfer(self, s: np.ndarray) -> np.ndarray:
        """``C P(s)^-1 B + D`` (len(s), outputs, inputs)."""
        if self.modes is None:
            H = self.core.transfer(s)
        else:
            T, L, _ = self.modes
            residues = (self.core.C @ T).T[:, :, None] * (L @ self.core.B)[:, None, :]
            result = self._gains(s) @ residues.reshape(len(residues), -1)
            H = result.reshape(-1, *self.core.D.shape) + self.core.D
        return H + self._free.C @ self._free.states(s) if self._free else H

    def cancelled(self, s: np.ndarray) -> np.ndarray:
        """(outputs, inputs) whether an entry is zero at all ``s`` but for rounding of its terms."""
        s = s[:: max(1, len(s) // 100)]
        x = self.states(s)
        terms = np.abs(self.pencil.C) @ np.abs(x).max(axis=0) + np.abs(self.pencil.D)
        size = np.abs(self.pencil.C @ x + self.pencil.D).max(axis=0)
        return np.asarray(size <= CANCELLED * terms)

    def peaks(self, frequency: np.ndarray, H: np.ndarray) -> np.ndarray:
        """Largest size (outputs, inputs) of the response H at ``frequency`` [Hz] without the free
        motion, which grows without bound towards zero and would hide everything else."""
        free = free_part(self.pencil, 2 * np.pi * frequency.max())
        if free is not None:
            H = H - (free.transfer(2j * np.pi * frequency) - free.D)
        return np.asarray(np.abs(H).max(axis=0))

    def entries(self, frequency: np.ndarray, H: np.ndarray | None = None) -> Entries:
        """Entries of the response over ``frequency`` [Hz], there H, by :meth:`peaks`."""
        H = self.transfer(2j * np.pi * frequency) if H is None else H
        return Entries.of(H, self.peaks(frequency, H), self.zero)

    def _gains(self, s: np.ndarray) -> np.ndarray:
        """``1 / sum_k s^k diagonals_k`` (len(s), n)."""
        s = np.asarray(s, dtype=complex)[:, None]
        assert self.modes is not None
        diagonals = self.modes[2]
        with np.errstate(divide="ignore", invalid="ignore"):  # refused where it is certified
            return np.asarray(1 / sum(s**k * d for k, d in enumerate(diagonals)))

    @cached_property
    def poles(self) -> np.ndarray:
        """Finite poles [1/s] of a model whose modes are coupled."""
        return np.r_[self._free.poles(), self._poles] if self._free else self._poles

    @cached_property
    def _poles(self) -> np.ndarray:
        return self.core.poles() if self.modes is None else _finite_poles(*self.modes[2])

    @cached_property
    def _resonant(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Frequency [Hz], damping ratio and mode of the oscillating poles; the modes are -1 where
        there are none."""
        if not self.decoupled or self.core.degree == 1:
            result = np.empty(0) if self.decoupled else self._poles
            mode = np.full(len(result), -1)
            if self.modes is not None and not self.decoupled:
                mode = np.flatnonzero(_finite(self.modes[2][0]))
            mode, result = mode[result.imag > 0], result[result.imag > 0]
            return result.imag / (2 * np.pi), np.abs(result.real) / np.abs(result), mode
        assert self.modes is not None
        k, e, m = self.modes[2]
        oscillating = (k > 0) & (e**2 < 4 * k * m)
        k, e, m = k[oscillating], e[oscillating], m[oscillating]
        omega, ratio = np.sqrt(k / m), np.abs(e) / (2 * np.sqrt(k * m))
        frequency = omega * np.sqrt(1 - ratio**2) / (2 * np.pi)
        return frequency, ratio, np.flatnonzero(oscillating)

    @property
    def resonances(self) -> tuple[np.ndarray, np.ndarray]:
        """Frequency [Hz] and damping ratio of the oscillating poles."""
        return self._resonant[:2]

    def within(self, band: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        """The resonances inside the band."""
        frequency, ratio = self.resonances
        inside = _inside(frequency, band)
        return frequency[inside], ratio[inside]

    def visible(self, band: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        """The resonances inside the band that show in the response. Zeros cancel all others in
        every entry: modes that no input excites or no output sees, and rigid-body modes that
        rounding gives a stiffness."""
        frequency, ratio, mode = self._resonant
        inside = _inside(frequency, band)
        frequency, ratio, mode = frequency[inside], ratio[inside], mode[inside]
        if not mode.size or mode.min() < 0:
            return frequency, ratio
        assert self.modes is not None
        T, L, _ = self.modes
        beside = frequency * (1 + FLANK * (ratio < SHARPEST))
        s = 2j * np.pi * beside
        gain = np.abs(self._gains(s)[np.arange(len(s)), mode])
        out, into = np.abs(self.core.C @ T[:, mode]).T, np.abs((L @ self.core.B)[mode])
        term = gain[:, None, None] * out[:, :, None] * into[:, None, :]
        base = self.entries(np.union1d(beside, grid(band, VISIBLE_GRID, False))).base(
            self.transfer(s)
        )
        seen = (term > VISIBLE * base).any(axis=(1, 2))
        return frequency[seen], ratio[seen]


def _eigenvectors(pencil: Pencil) -> Modes | None:
    """Eigenvectors of ``(P(shift))^-1`` times the inertia, both in first order, which unknowns
    without inertia have too, if they reproduce direct solutions to rounding."""
    sizes = largest(pencil.coefficients[0]), largest(pencil.coefficients[-1])
    if not all(sizes):
        return None
    shift = float((sizes[0] / sizes[1]) ** (1 / pencil.degree))
    n, none = pencil.size, np.zeros((0, pencil.size))
    whole = first_order(replace(pencil, B=np.eye(n), C=none, D=none), shift)
    rest, inertia = whole.coefficients
    try:
        inner = np.linalg.solve(rest + shift * inertia, np.hstack([inertia, whole.B]))
        values, X = np.linalg.eig(shift * inner[:, : whole.size])
        inverse = np.linalg.inv(X)
        if np.linalg.norm(X) * np.linalg.norm(inverse) > DEFECTIVE:
            return None
    except (np.linalg.LinAlgError, ValueError):
        return None
    result = X[:n], inverse @ inner[:, whole.size :], (1 - values, values / shift)
    s = 1j * np.array([0.03, 0.3, 1.0, 3.0])
    s *= float(np.median(np.abs(_finite_poles(*result[2])))) or 1.0
    try:
        exact = pencil.states(s)
    except SimulationError:
        return None
    with np.errstate(all="ignore"):  # on a pole
        apart = np.abs(Response(pencil, result).states(s) - exact).max(axis=1)
    return result if (apart < REPRODUCED * np.abs(exact).max(axis=1)).all() else None


def _finite_poles(rest: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Finite poles of the diagonals of :func:`_eigenvectors`."""
    finite = _finite(rest)
    return -rest[finite] / inertia[finite]


def _finite(rest: np.ndarray) -> np.ndarray:
    """Which of the diagonals of :func:`_eigenvectors` have a finite pole."""
    return np.asarray(np.abs(1 - rest) * INFINITE > 1)


def _inside(frequency: np.ndarray, band: tuple[float, float]) -> np.ndarray:
    """Which frequencies [Hz] are inside the band, and not zero but for rounding."""
    return np.asarray((frequency > max(band[0], 1e-6 * band[1])) & (frequency < band[1]))


def _decoupled(pencil: Pencil) -> Modes | None:
    """Solved as ``M phi = mu K phi`` where K is definite: the better conditioned of the two."""
    if not pencil.symmetric or not pencil.size:
        return None
    rest, inertia = pencil.coefficients[0], pencil.coefficients[-1]
    try:
        mu, T = scipy.linalg.eigh(inertia, rest)
        if (mu[1:] > SOFT * np.abs(mu[:-1])).any():  # a stiffness that is a rounding error
            raise scipy.linalg.LinAlgError
        ends = np.ones(pencil.size), mu
    except scipy.linalg.LinAlgError:
        try:
            k, T = scipy.linalg.eigh(rest, inertia)
        except scipy.linalg.LinAlgError:
            return None
        ends = k, np.ones(pencil.size)
    if pencil.degree == 1:
        return T, T.T, ends
    damping = T.T @ pencil.coefficients[1] @ T
    diagonal = np.diag(damping).copy()
    # Relative to the damping of both modes. Any coupling to an undamped mode is above this limit,
    # and the equations are then solved without decoupling.
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


def clear_of_poles(points: np.ndarray, frequency: np.ndarray, ratio: np.ndarray) -> np.ndarray:
    """``points`` without those that come closer than ``FLANK`` to an all but undamped resonance."""
    sharp = frequency[ratio < SHARPEST]
    if not sharp.size:
        return points
    nearest = np.abs(points[:, None] - sharp).min(axis=1)
    gap = sharp[np.abs(points[:, None] - sharp).argmin(axis=1)] * FLANK
    return points[nearest >= 0.98 * gap]


def samples(
    response: Response,
    band: tuple[float, float],
    count: int,
    static: bool,
    widths: np.ndarray | tuple[float, ...] = (0.0,),
) -> np.ndarray:
    """Frequencies [Hz] of a grid and on every resonance, at multiples of its half width, inside the
    band and clear of poles without damping."""
    at, ratio = response.within(band)
    points = np.union1d(grid(band, count, static), around(at, ratio, np.asarray(widths)))
    points = points[(points >= band[0]) & (points <= band[1])]
    return clear_of_poles(points, at, ratio)


def adaptive_frequencies(
    response: Response, band: tuple[float, float], static: bool, norm: Norm = "pointwise"
) -> np.ndarray:
    """Frequencies [Hz] at which relative errors show: a grid, every resonance with its flanks, and
    *pointwise* every deep notch of any entry, found by zooming in."""
    near = 0.9 * band[0], 1.1 * band[1]
    at, ratio = response.within(near)
    frequency = np.union1d(grid(band, GRID, static), around(at, ratio))
    if norm == "pointwise":
        # each three times as far as the last: the zero beside a weak, narrow resonance lies between
        # two of them and shows as a minimum
        width = np.where(ratio < SHARPEST, FLANK, ratio) * at
        away = CLUSTER[-1] * width[:, None] * 3.0 ** np.arange(1, 16)
        both = [(at[:, None] + k * away)[away < band[1] / GRID] for k in (-1, 1)]
        frequency = np.unique(np.concatenate([frequency, *both]))
    frequency = frequency[(frequency >= band[0]) & (frequency <= band[1])]
    frequency = clear_of_poles(frequency, at, ratio)
    if norm == "peak":
        return frequency
    H = response.transfer(2j * np.pi * frequency)
    for _ in range(ROUNDS):
        peak = response.entries(frequency, H).peak + np.finfo(float).tiny
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
    """Judges models by the ``exact`` one, which has a ``static`` answer or none, over the band."""

    exact: Response
    band: tuple[float, float]
    static: bool
    norm: Norm = "pointwise"

    @cached_property
    def frequency(self) -> np.ndarray:
        """Frequencies [Hz] at which errors show, at which the exact model is solved once."""
        return adaptive_frequencies(self.exact, self.band, self.static, self.norm)

    @cached_property
    def reference(self) -> tuple[np.ndarray, Entries]:
        """The exact response, and what is known of its entries."""
        H = self.exact.transfer(2j * np.pi * self.frequency)
        return H, self.exact.entries(self.frequency, H)

    @property
    def share(self) -> float:
        """Part of its peak that an entry's errors count against at least, in the norm."""
        return share_of(self.norm)

    @cached_property
    def _counted(self) -> np.ndarray:
        """Which entries are not what cancellation of their terms leaves; those that are zero by
        symmetry count against their row and column."""
        return ~self.exact.cancelled(2j * np.pi * self.frequency) | self.reference[1].zero

    @cached_property
    def failed(self) -> dict[float, np.ndarray]:
        """Frequencies [Hz] at which models were furthest off, the last ones last, with the exact
        response: the next that is not good enough shows there first. A few over the band to begin
        with."""
        few = slice(None, None, max(1, len(self.frequency) // SPREAD))
        return dict(zip(self.frequency[few].tolist(), self.reference[0][few], strict=True))

    def sizes(self, difference: np.ndarray, H: np.ndarray) -> np.ndarray:
        """Largest error (..., frequencies) of any entry, for differences to the response H."""
        base = self.reference[1].base(H, self.share) + np.finfo(float).tiny
        return np.asarray((np.abs(difference) / base * self._counted).max(axis=(-2, -1)))

    def error(self, found: Response, limit: float = np.inf) -> float:
        """:func:`relative_error` over the band, in the ``norm``: at ``frequency``, then closer and
        closer around where it is largest. Above ``limit`` any error that shows it is enough."""
        for last, H in reversed(self.failed.items()):
            try:  # other coordinates are faster only for many frequencies
                ours = found.pencil.transfer(np.array([2j * np.pi * last]))[0]
                worst = float(self.sizes(ours - H, H))
            except SimulationError:
                worst = np.inf
            if not worst <= limit:
                self.failed[last] = self.failed.pop(last)
                return worst
        at, ratio = self.exact.within((0.9 * self.band[0], 1.1 * self.band[1]))
        points, H = self.frequency, self.reference[0]
        error = self.sizes(found.transfer(2j * np.pi * points) - H, H)
        for _ in range(PEAK_ROUNDS):
            inner = np.r_[True, error[1:] >= error[:-1]] & np.r_[error[:-1] >= error[1:], True]
            top = np.argsort(np.where(inner, error, -1.0))[-PEAKS:]
            low, high = np.maximum(top - 1, 0), np.minimum(top + 1, len(error) - 1)
            new = clear_of_poles(_zoomed(points, low, high), at, ratio)
            if not new.size:
                break
            H = self.exact.transfer(2j * np.pi * new)
            error = np.r_[error, self.sizes(found.transfer(2j * np.pi * new) - H, H)]
            points = np.r_[points, new]
            order = np.argsort(points)
            points, error = points[order], error[order]
        if not (worst := float(error.max())) <= limit:
            last = float(points[int(np.nan_to_num(error, nan=np.inf).argmax())])
            self.failed[last] = self.exact.transfer(np.array([2j * np.pi * last]))[0]
        return worst


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
    H, ours = (item.transfer(2j * np.pi * points)[:, *own] for item in (exact, found))
    size = np.abs(ours - H) / (np.abs(H) + np.finfo(float).tiny)
    return tuple(zip(points.tolist(), size.max(axis=1).tolist(), strict=True))


def relative_error(response: np.ndarray, reference: np.ndarray) -> float:
    """Largest error of all entries and frequencies relative to the entry, or to ``FLOOR`` of its
    peak; see :class:`kc2spice.rom.entries.Entries` for entries that are zero.

    Arrays are (frequencies, outputs, inputs), or (frequencies,) and (frequencies, entries) of
    entries that are independent of each other.
    """
    difference = response - reference
    if reference.ndim == 3:
        return float(relative_size(difference, reference).max(initial=0.0))
    pairs = zip(*(x.reshape(len(x), -1).T for x in (difference, reference)), strict=True)
    sizes = (relative_size(d[:, None, None], r[:, None, None]) for d, r in pairs)
    return max((float(size.max(initial=0.0)) for size in sizes), default=0.0)


def relative_size(
    difference: np.ndarray, reference: np.ndarray, entries: Entries | None = None
) -> np.ndarray:
    """Errors (..., outputs, inputs) by :meth:`kc2spice.rom.entries.Entries.relative`, whose
    ``entries`` are those of the reference itself by default."""
    entries = entries or Entries.of(reference)
    return entries.relative(difference, reference)


def inexact(message: str, got: str, limit: float, hint: str) -> SimulationError:
    """Error of a reduction whose error estimate stays above the limit."""
    expected = f"at most {limit:.1e}"
    return SimulationError(message, where="reduction", got=got, expected=expected, hint=hint)
