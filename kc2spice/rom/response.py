"""Frequency responses of dense pencils, and choice of sample frequencies."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import TypeAlias

import numpy as np
import scipy

from kc2spice.core.errors import SimulationError
from kc2spice.rom.pencil import (
    INFINITE_POLE_RATIO,
    Pencil,
    convert_to_first_order,
    find_largest_entry,
)
from kc2spice.rom.rigid_body import select_rigid_body_pencil
from kc2spice.rom.transfer_function_error_scales import EntryScales

# largest rounding error of a sum of terms that cancel, relative to the sum of their absolute values
CANCELLATION_ROUNDING = 1e-13
# Largest relative coupling of modes by damping that counts as a rounding error.
COUPLING_ROUNDING = 1e-9
# Smallest damping ratio of a resonance whose peak can be sampled.
# Below this damping ratio, no floating-point frequency is close enough to the peak.
# At resonances with damping ratios below MIN_DAMPING_RATIO, errors are computed beside the peak, at
# the relative distance FLANK_DISTANCE from the peak.
MIN_DAMPING_RATIO = 1e-7
FLANK_DISTANCE = 1e-4
# smallest contribution of a visible pole to an entry of the response, relative to the entry
MIN_VISIBLE_TERM = 1e-10
# number of grid frequencies at which the largest magnitude of each response entry is determined
VISIBLE_GRID = 50
# distances of sample frequencies from a resonance, in half-widths of the resonance
RESONANCE_OFFSETS = np.array([0.0, 0.25, 0.5, 1.0, 2.0, 5.0, 15.0, 60.0])
# number of frequencies in the linear grid and in the logarithmic grid of a band; found by trials
GRID_FREQUENCIES = 200
# limits of the size of models whose eigenvectors are computed, found by trials
MIN_UNKNOWNS = 12  # up to this number of unknowns, direct solutions are faster than modal solutions
MAX_STATES = 2000  # largest number of first-order states for which eigenvectors are computed
DECOUPLING_TOLERANCE = 1e-10  # largest relative difference between decoupled and direct solutions
# ratio of successive squared frequencies above which the lower mode is a rigid-body mode
RIGID_MODE_RATIO = 1e8
# Largest condition number of the eigenvectors with which a model is decoupled.
# An unsupported body has fewer independent eigenvectors than states.
# The computed eigenvectors of an unsupported body have a condition number above MAX_CONDITION.
MAX_CONDITION = 1e10
Modes: TypeAlias = tuple[np.ndarray, np.ndarray, tuple[np.ndarray, ...]]


class Response:
    """Frequency response of a dense pencil, in decoupled coordinates if possible.

    In decoupled coordinates, the matrices of the pencil are diagonal. Decoupled coordinates are
    used only if they are well-conditioned. ``modes = (T, L, diagonals)`` contains matrices T and L
    for which all products ``L P_k T`` are diagonal, where ``P_k`` is the pencil's coefficient of
    ``s^k``. The diagonal of ``L P_k T`` is ``diagonals_k``, and the unknowns are ``x = T diag(1 /
    sum_k s^k diagonals_k) L B``. ``modes`` is None if there are no decoupled coordinates. If
    :attr:`has_decoupling_congruence` is true, T is a real congruence (``L = T'``). If rigid-body
    modes are not coupled to other unknowns, they are solved separately. The pencil ``core`` then
    contains only the other unknowns. If rigid-body modes are coupled or absent, ``core`` is the
    whole pencil. ``zero`` (outputs, inputs) is a mask of the entries that are known to be zero by
    symmetry.
    """

    def __init__(
        self, pencil: Pencil, modes: Modes | None = None, zero: np.ndarray | bool = False
    ) -> None:
        self.pencil, self.zero = pencil, zero
        self.core = pencil.without_rigid_body_modes if pencil.has_uncoupled_rigid_modes else pencil
        self._free = (
            pencil.truncate_to_order(pencil.free) if pencil.has_uncoupled_rigid_modes else None
        )
        self._prescribed_modes = modes

    @cached_property
    def has_decoupling_congruence(self) -> bool:
        """Whether a real congruence decouples the pencil."""
        return self._prescribed_modes is None and self._decoupling is not None

    @cached_property
    def _decoupling(self) -> Modes | None:
        """Modes that diagonalise the matrices of the pencil; None if no congruence does.

        If the constructor has received modes, these modes are returned without a computation.
        """
        return self._prescribed_modes or _diagonalise_pencil(self.core)

    @cached_property
    def modes(self) -> Modes | None:
        """Modes that decouple the equations, or None if the model cannot be decoupled."""
        use_eigenvectors = MIN_UNKNOWNS < self.core.size <= MAX_STATES / self.core.degree
        return self._decoupling or (_compute_eigenvectors(self.core) if use_eigenvectors else None)

    @cached_property
    def dual_response(self) -> Response:
        """Response of the transposed pencil, computed in the same decoupled coordinates."""
        if self.modes is None or self._free:
            return Response(self.pencil.make_dual())
        T, L, diagonals = self.modes
        return Response(self.pencil.make_dual(), (L.T, T.T, diagonals))

    @property
    def is_decoupled(self) -> bool:
        """Whether the unknowns are decoupled, or so few that they need no decoupling."""
        return self.modes is not None or self.core.size <= MIN_UNKNOWNS

    def states(self, s: np.ndarray) -> np.ndarray:
        """Compute the unknowns ``P(s)^-1 B`` for unit inputs at all values ``s``.

        The result has the shape (len(s), n, m): values, unknowns and inputs.
        """
        if self.modes is None:
            x = self.core.states(s)
        else:
            T, L, _ = self.modes
            parts = self._compute_mode_responses(s).T[:, :, None] * (L @ self.core.B)[:, None, :]
            # one large matrix product is faster than many small products
            result = T @ parts.reshape(len(parts), -1)
            x = result.reshape(-1, *parts.shape[1:]).swapaxes(0, 1)
        return np.concatenate([self._free.states(s), x], axis=1) if self._free else x

    def transfer(self, s: np.ndarray) -> np.ndarray:
        """Compute the transfer matrix ``C P(s)^-1 B + D`` at all values ``s``.

        The result has the shape (len(s), outputs, inputs).
        """
        if self.modes is None:
            H = self.core.transfer(s)
        else:
            T, L, _ = self.modes
            residues = (self.core.C @ T).T[:, :, None] * (L @ self.core.B)[:, None, :]
            result = self._compute_mode_responses(s) @ residues.reshape(len(residues), -1)
            H = result.reshape(-1, *self.core.D.shape) + self.core.D
        return H + self._free.C @ self._free.states(s) if self._free else H

    def mask_cancelled_entries(self, s: np.ndarray) -> np.ndarray:
        """Return a mask (outputs, inputs) of entries that cancel to rounding errors.

        The terms of a cancelled entry add up to zero at all ``s``.
        """
        s = s[:: max(1, len(s) // 100)]
        x = self.states(s)
        terms = np.abs(self.pencil.C) @ np.abs(x).max(axis=0) + np.abs(self.pencil.D)
        size = np.abs(self.pencil.C @ x + self.pencil.D).max(axis=0)
        return np.asarray(size <= CANCELLATION_ROUNDING * terms)

    def find_entry_peaks(self, frequency: np.ndarray, H: np.ndarray) -> np.ndarray:
        """Return the peak of each entry of the response H over ``frequency`` [Hz].

        The result has the shape (outputs, inputs). The rigid-body motion is omitted, because its
        response grows without bound as the frequency approaches zero.
        """
        free = select_rigid_body_pencil(self.pencil, 2 * np.pi * frequency.max())
        if free is not None:
            H = H - (free.transfer(2j * np.pi * frequency) - free.D)
        return np.asarray(np.abs(H).max(axis=0))

    def compute_error_scales(
        self, frequency: np.ndarray, H: np.ndarray | None = None
    ) -> EntryScales:
        """Return the scales for relative errors of the response H over ``frequency`` [Hz]."""
        H = self.transfer(2j * np.pi * frequency) if H is None else H
        return EntryScales.from_response(H, self.find_entry_peaks(frequency, H), self.zero)

    def _compute_mode_responses(self, s: np.ndarray) -> np.ndarray:
        """Compute the response of each decoupled mode at all values ``s``.

        The result has the shape (len(s), n).
        """
        s = np.asarray(s, dtype=complex)[:, None]
        assert self.modes is not None
        diagonals = self.modes[2]
        # infinite and undefined values cause an error later, in the certification
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.asarray(1 / sum(s**k * d for k, d in enumerate(diagonals)))

    @cached_property
    def poles(self) -> np.ndarray:
        """Finite poles [1/s] of the pencil, including rigid-body modes."""
        return np.r_[self._free.poles(), self._poles] if self._free else self._poles

    @cached_property
    def _poles(self) -> np.ndarray:
        """Finite poles [1/s] of the pencil without uncoupled rigid-body modes."""
        return self.core.poles() if self.modes is None else _compute_finite_poles(*self.modes[2])

    @cached_property
    def _oscillating_poles(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Frequency [Hz], damping ratio and mode index of each oscillating pole.

        The mode index is -1 if no mode is known for the pole.
        """
        if not self.has_decoupling_congruence or self.core.degree == 1:
            result = np.empty(0) if self.has_decoupling_congruence else self._poles
            mode = np.full(len(result), -1)
            if self.modes is not None and not self.has_decoupling_congruence:
                mode = np.flatnonzero(_mask_finite_poles(self.modes[2][0]))
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
        return self._oscillating_poles[:2]

    def select_band_resonances(self, band: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        """Return frequencies [Hz] and damping ratios of the resonances in the band."""
        frequency, ratio = self.resonances
        inside = _mask_inside_band(frequency, band)
        return frequency[inside], ratio[inside]

    def select_visible_resonances(self, band: tuple[float, float]) -> tuple[np.ndarray, np.ndarray]:
        """Return frequencies [Hz] and damping ratios of visible resonances in the band.

        A resonance is visible if its mode contributes significantly to at least one entry of the
        response. The mode of an invisible resonance is not excited by any input, or not measured by
        any output. The mode may also be a rigid-body mode whose stiffness is a rounding error.
        """
        frequency, ratio, mode = self._oscillating_poles
        inside = _mask_inside_band(frequency, band)
        frequency, ratio, mode = frequency[inside], ratio[inside], mode[inside]
        if not mode.size or mode.min() < 0:
            return frequency, ratio
        assert self.modes is not None
        T, L, _ = self.modes
        flanks = frequency * (1 + FLANK_DISTANCE * (ratio < MIN_DAMPING_RATIO))
        s = 2j * np.pi * flanks
        gain = np.abs(self._compute_mode_responses(s)[np.arange(len(s)), mode])
        out, into = np.abs(self.core.C @ T[:, mode]).T, np.abs((L @ self.core.B)[mode])
        term = gain[:, None, None] * out[:, :, None] * into[:, None, :]
        base = self.compute_error_scales(
            np.union1d(flanks, make_frequency_grid(band, VISIBLE_GRID, False))
        ).compute_error_divisors(self.transfer(s))
        visible = (term > MIN_VISIBLE_TERM * base).any(axis=(1, 2))
        return frequency[visible], ratio[visible]


class DirectResponse(Response):
    """Frequency response of a dense pencil, computed directly at each frequency.

    If conductances differ by many orders of magnitude, the matrix is almost singular. For almost
    singular matrices, direct solutions have smaller rounding errors than solutions by modes.
    """

    modes = None

    @cached_property
    def _decoupling(self) -> Modes | None:
        """None, because direct solutions at each frequency need no decoupling modes."""
        return None


def _compute_eigenvectors(pencil: Pencil) -> Modes | None:
    """Compute eigenvectors of the first-order form, which decouple the unknowns.

    The eigenvectors of ``P(shift)^-1`` times the inertia matrix are used, which also exist for
    unknowns without inertia. The result is None if the responses in decoupled coordinates differ
    from direct solutions by more than rounding errors.
    """
    sizes = find_largest_entry(pencil.coefficients[0]), find_largest_entry(pencil.coefficients[-1])
    if not all(sizes):
        return None
    shift = float((sizes[0] / sizes[1]) ** (1 / pencil.degree))
    n, none = pencil.size, np.zeros((0, pencil.size))
    extended = convert_to_first_order(replace(pencil, B=np.eye(n), C=none, D=none), shift)
    rest, inertia = extended.coefficients
    try:
        inner = np.linalg.solve(rest + shift * inertia, np.hstack([inertia, extended.B]))
        values, X = np.linalg.eig(shift * inner[:, : extended.size])
        inverse = np.linalg.inv(X)
        with np.errstate(over="ignore"):  # dependent eigenvectors cause overflow
            condition = np.linalg.norm(X) * np.linalg.norm(inverse)
        if not condition <= MAX_CONDITION:
            return None
    except (np.linalg.LinAlgError, ValueError):
        return None
    result = X[:n], inverse @ inner[:, extended.size :], (1 - values, values / shift)
    s = 1j * np.array([0.03, 0.3, 1.0, 3.0])
    s *= float(np.median(np.abs(_compute_finite_poles(*result[2])))) or 1.0
    try:
        exact = pencil.states(s)
    except SimulationError:
        return None
    with np.errstate(all="ignore"):  # a sample frequency may be a pole
        apart = np.abs(Response(pencil, result).states(s) - exact).max(axis=1)
    return result if (apart < DECOUPLING_TOLERANCE * np.abs(exact).max(axis=1)).all() else None


def _compute_finite_poles(rest: np.ndarray, inertia: np.ndarray) -> np.ndarray:
    """Return the finite poles of first-order equations in decoupled coordinates.

    The arguments are the diagonals that :func:`_compute_eigenvectors` returns.
    """
    finite = _mask_finite_poles(rest)
    return np.asarray(-rest[finite] / inertia[finite])


def _mask_finite_poles(rest: np.ndarray) -> np.ndarray:
    """Return a mask of the decoupled equations that have a finite pole.

    The decoupled equation ``(rest + s inertia) x = b`` has the pole ``s = -rest / inertia``.
    """
    return np.asarray(np.abs(1 - rest) * INFINITE_POLE_RATIO > 1)


def _mask_inside_band(frequency: np.ndarray, band: tuple[float, float]) -> np.ndarray:
    """Return a mask of the frequencies [Hz] inside the band and clearly above zero."""
    return np.asarray((frequency > max(band[0], 1e-6 * band[1])) & (frequency < band[1]))


def _diagonalise_pencil(pencil: Pencil) -> Modes | None:
    """Diagonalise a symmetric pencil by a real congruence, or return None.

    The congruence consists of the eigenvectors of ``M phi = mu K phi`` with a definite K. The
    problem ``M phi = mu K phi`` is better conditioned than the problem with the inverse of M.
    """
    if not pencil.is_symmetric or not pencil.size:
        return None
    rest, inertia = pencil.coefficients[0], pencil.coefficients[-1]
    try:
        mu, T = scipy.linalg.eigh(inertia, rest)
        # the stiffness of a rigid-body mode is only a rounding error
        if (mu[1:] > RIGID_MODE_RATIO * np.abs(mu[:-1])).any():
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
    # The largest accepted coupling of two modes is relative to the damping of both modes. If
    # damping couples an undamped mode to another mode, the pencil is not decoupled.
    limit = COUPLING_ROUNDING * np.sqrt(np.abs(np.outer(diagonal, diagonal)))
    if (np.abs(damping - np.diag(diagonal)) > limit).any():
        return None
    return T, T.T, (ends[0], diagonal, ends[1])


def make_frequency_grid(band: tuple[float, float], count: int, static: bool) -> np.ndarray:
    """Return a grid of frequencies [Hz] over the band: half linear, half logarithmic.

    The grid covers at most four decades. If the band begins at zero and the ``static`` response
    exists, the grid also contains zero.
    """
    low, high = band
    start = max(low, 1e-4 * high)
    frequency = np.r_[np.linspace(start, high, count), np.geomspace(start, high, count)]
    if low == 0 and static:
        frequency = np.r_[0.0, frequency]
    return np.unique(frequency)


def sample_resonances(
    frequency: np.ndarray, ratio: np.ndarray, widths: np.ndarray = RESONANCE_OFFSETS
) -> np.ndarray:
    """Return sample frequencies [Hz] at resonances and on both sides of resonances.

    ``frequency`` and ``ratio`` are the resonance frequencies [Hz] and damping ratios. ``widths``
    contains the distances of the samples from a resonance, in half-widths of the resonance.
    """
    sharp = ratio < MIN_DAMPING_RATIO
    width = np.where(sharp, FLANK_DISTANCE, ratio)[:, None] * frequency[:, None]
    both = np.concatenate([-widths[::-1], widths])
    points = frequency[:, None] + width * both
    points[sharp] = np.where(
        np.abs(points[sharp] - frequency[sharp, None]) < 0.99 * width[sharp],
        frequency[sharp, None] + np.where(both < 0, -1, 1) * width[sharp],
        points[sharp],
    )
    return np.unique(points)


def drop_points_near_poles(
    points: np.ndarray, frequency: np.ndarray, ratio: np.ndarray
) -> np.ndarray:
    """Omit frequencies that are too close to nearly undamped resonances.

    The smallest permitted relative distance is :data:`FLANK_DISTANCE`.
    """
    sharp = frequency[ratio < MIN_DAMPING_RATIO]
    if not sharp.size:
        return points
    nearest = np.abs(points[:, None] - sharp).min(axis=1)
    gap = sharp[np.abs(points[:, None] - sharp).argmin(axis=1)] * FLANK_DISTANCE
    return np.asarray(points[nearest >= 0.98 * gap])


def sample_band(
    response: Response,
    band: tuple[float, float],
    count: int,
    static: bool,
    widths: np.ndarray | tuple[float, ...] = (0.0,),
) -> np.ndarray:
    """Choose sample frequencies [Hz]: a grid over the band, and resonances.

    On both sides of each resonance, there are samples at distances of ``widths`` half-widths.
    Samples too close to undamped poles are omitted.
    """
    at, ratio = response.select_band_resonances(band)
    points = np.union1d(
        make_frequency_grid(band, count, static), sample_resonances(at, ratio, np.asarray(widths))
    )
    points = points[(points >= band[0]) & (points <= band[1])]
    return drop_points_near_poles(points, at, ratio)
