"""Error estimates of reduced-order models for all reduction methods.

The estimate is the largest relative difference between the responses of the reduced model and of a
more accurate model. The search adds frequencies where the relative difference is largest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from kc2spice.core.error_norms import PEAK_SHARE
from kc2spice.core.errors import SimulationError
from kc2spice.rom.linear_model import LinearModel, Norm, Port
from kc2spice.rom.response import (
    FLANK_DISTANCE,
    GRID_FREQUENCIES,
    MIN_DAMPING_RATIO,
    RESONANCE_OFFSETS,
    Response,
    drop_points_near_poles,
    make_frequency_grid,
    sample_resonances,
)
from kc2spice.rom.transfer_function_error_scales import EntryScales, get_min_relative_divisor

# Frequencies above the band at which errors are computed, as multiples of the upper band limit.
# Errors above the band are computed because contacts also excite a body above the band.
MULTIPLES_ABOVE_BAND = np.array([2.0, 4.0])
# The following settings of the search for the largest error were found by trials.
# tests/physics/test_certificates.py compares the result of the search with errors on fine grids.
# Each round of the search adds frequencies near the REFINED_NOTCHES deepest response minima.
REFINED_NOTCHES = 60
ZOOM_FREQUENCIES = 9  # number of frequencies in a refined interval
NOTCH_ROUNDS = 20  # largest number of rounds that add frequencies near notches
EQUAL_FREQUENCY = 1e-12  # relative difference below which frequencies count as equal
# A neighbouring sample that exceeds a sampled minimum by this factor indicates a deeper minimum.
# An interpolated value below (sampled minimum / MIN_STEEPNESS) also indicates a deeper minimum.
MIN_STEEPNESS = 1.5
# Each round of the search adds frequencies near the REFINED_PEAKS largest errors.
REFINED_PEAKS = 40
PEAK_ROUNDS = 3  # largest number of rounds that add frequencies near the largest errors
# Each model is first tested at the frequencies at which earlier models were inaccurate.
# Each model is tested at about FIRST_FREQUENCIES samples of the band before all other samples.
FIRST_FREQUENCIES = 6


def choose_adaptive_frequencies(
    response: Response, band: tuple[float, float], static: bool, norm: Norm = "pointwise"
) -> np.ndarray:
    """Choose frequencies [Hz] at which relative errors are large.

    The frequencies are a grid, all resonances, and frequencies beside each resonance. In the norm
    *pointwise*, the frequencies also include every deep notch of any entry. Refinement finds the
    notches.
    """
    near = 0.9 * band[0], 1.1 * band[1]
    at, ratio = response.select_band_resonances(near)
    frequency = np.union1d(
        make_frequency_grid(band, GRID_FREQUENCIES, static), sample_resonances(at, ratio)
    )
    if norm == "pointwise":
        # Each distance from a pole is three times the previous distance.
        # A zero near a weak, narrow resonance is then visible as a minimum between two frequencies.
        width = np.where(ratio < MIN_DAMPING_RATIO, FLANK_DISTANCE, ratio) * at
        away = RESONANCE_OFFSETS[-1] * width[:, None] * 3.0 ** np.arange(1, 16)
        both = [(at[:, None] + k * away)[away < band[1] / GRID_FREQUENCIES] for k in (-1, 1)]
        frequency = np.unique(np.concatenate([frequency, *both]))
    frequency = frequency[(frequency >= band[0]) & (frequency <= band[1])]
    frequency = drop_points_near_poles(frequency, at, ratio)
    if norm == "peak":
        return frequency
    H = response.transfer(2j * np.pi * frequency)
    for _ in range(NOTCH_ROUNDS):
        peak = response.compute_error_scales(frequency, H).peak + np.finfo(float).tiny
        lowest = _find_minima_near_zeros(H / peak).reshape(len(H) - 2, -1).min(axis=1)
        deepest = np.argsort(lowest)[: min(REFINED_NOTCHES, int(np.isfinite(lowest).sum()))]
        if not deepest.size:
            break
        new = drop_points_near_poles(_refine_intervals(frequency, deepest, deepest + 2), at, ratio)
        if not new.size:
            break
        H = np.concatenate([H, response.transfer(2j * np.pi * new)])
        frequency = np.concatenate([frequency, new])
        order = np.argsort(frequency)
        frequency, H = frequency[order], H[order]
    return frequency


def _find_minima_near_zeros(H: np.ndarray) -> np.ndarray:
    """Find the sampled minima of ``abs(H)`` that may be near a zero of H.

    H is scaled to a peak of 1. Return the magnitudes of the minima, and infinity for all other
    samples. Two signs indicate a deeper minimum: a neighbouring sample is much larger, or the
    straight line to a neighbouring sample in the complex plane passes much nearer to zero. Minima
    below :data:`PEAK_SHARE` are ignored.
    """
    size = np.abs(H)
    step = np.diff(H, axis=0)
    share = -(np.conj(step) * H[:-1]).real / (np.abs(step) ** 2 + np.finfo(float).tiny)
    line = np.abs(H[:-1] + np.clip(share, 0.0, 1.0) * step)
    inner = (size[1:-1] < size[:-2]) & (size[1:-1] <= size[2:]) & (size[1:-1] > PEAK_SHARE)
    steep = np.maximum(size[:-2], size[2:]) > MIN_STEEPNESS * size[1:-1]
    inner &= steep | (MIN_STEEPNESS * np.minimum(line[:-1], line[1:]) < size[1:-1])
    return np.where(inner, size[1:-1], np.inf)


def _refine_intervals(known: np.ndarray, low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Return frequencies that subdivide given intervals between known frequencies.

    Each interval from ``known[low]`` to ``known[high]`` contains ``ZOOM_FREQUENCIES`` frequencies.
    The result contains no repeated frequency and no frequency of ``known``, because equal
    frequencies with different rounding errors could hide a maximum.
    """
    points = np.unique(np.linspace(known[low], known[high], ZOOM_FREQUENCIES))
    points = points[np.r_[True, np.diff(points) > EQUAL_FREQUENCY * points[1:]]]
    at = np.searchsorted(known, points)
    below, above = known[np.maximum(at - 1, 0)], known[np.minimum(at, len(known) - 1)]
    return np.asarray(
        points[
            np.minimum(np.abs(points - below), np.abs(points - above)) > EQUAL_FREQUENCY * points
        ]
    )


@dataclass(frozen=True)
class ErrorEstimator:
    """Estimator of the errors of reduced models over a band.

    Reduced models are compared with an accurate model, which is called the exact model.

    ``static`` states whether the exact model has a static response.
    """

    exact: Response
    band: tuple[float, float]
    static: bool
    norm: Norm = "pointwise"

    @cached_property
    def frequency(self) -> np.ndarray:
        """Frequency samples [Hz] in the band, chosen where large errors are likely."""
        return choose_adaptive_frequencies(self.exact, self.band, self.static, self.norm)

    @cached_property
    def exact_response_and_scales(self) -> tuple[np.ndarray, EntryScales]:
        """Exact response at :attr:`frequency`, and the scales for relative errors."""
        H = self.exact.transfer(2j * np.pi * self.frequency)
        return H, self.exact.compute_error_scales(self.frequency, H)

    @property
    def min_relative_divisor(self) -> float:
        """Minimum divisor of absolute errors, relative to the peak of the response.

        For a relative error, the absolute error is divided by the magnitude of the response. If the
        magnitude is below the lower limit, the absolute error is divided by the lower limit.
        """
        return get_min_relative_divisor(self.norm)

    @cached_property
    def _significant_entry_mask(self) -> np.ndarray:
        """Mask of the response entries (outputs, inputs) that exceed rounding errors.

        The mask is also true for entries that are zero by symmetry, because their errors are
        relative to the largest entries in the same row and column. The rounding errors of zero
        entries are therefore negligible.
        """
        return np.asarray(
            ~self.exact.mask_cancelled_entries(2j * np.pi * self.frequency)
            | self.exact_response_and_scales[1].zero
        )

    @cached_property
    def responses_to_check_first(self) -> dict[float, np.ndarray]:
        """Exact responses at the frequencies to check first, keyed by frequency.

        The first keys of the dictionary are the frequencies of a coarse grid over the band. The
        last keys of the dictionary are checked first: at these frequencies, earlier models had the
        largest errors.
        """
        sample = slice(None, None, max(1, len(self.frequency) // FIRST_FREQUENCIES))
        return dict(
            zip(
                self.frequency[sample].tolist(),
                self.exact_response_and_scales[0][sample],
                strict=True,
            )
        )

    def compute_largest_errors(self, difference: np.ndarray, H: np.ndarray) -> np.ndarray:
        """Return the largest relative error among all entries at each frequency.

        ``difference`` is the difference between a response and the exact response H. Both arrays
        have the shape (..., outputs, inputs), and the returned array has the shape (...).
        """
        base = (
            self.exact_response_and_scales[1].compute_error_divisors(H, self.min_relative_divisor)
            + np.finfo(float).tiny
        )
        return np.asarray(
            (np.abs(difference) / base * self._significant_entry_mask).max(axis=(-2, -1))
        )

    @cached_property
    def _pointwise_estimator(self) -> ErrorEstimator:
        """Estimator of errors in the norm *pointwise*, for the same model and band."""
        return replace(self, norm="pointwise")

    def find_largest_pointwise_error(self, reduced: Response) -> tuple[float, float]:
        """Find the largest error relative to the response at the same frequency.

        Return the frequency [Hz] and the error. The frequencies are those of an estimator in the
        norm *pointwise*, which include the notches of the response.
        """
        estimator = self._pointwise_estimator
        H = estimator.exact_response_and_scales[0]
        s = 2j * np.pi * estimator.frequency
        error = estimator.compute_largest_errors(reduced.transfer(s) - H, H)
        worst = int(np.nan_to_num(error, nan=np.inf).argmax())
        return float(estimator.frequency[worst]), float(error[worst])

    def estimate_model_error(self, reduced: Response, limit: float = np.inf) -> float:
        """Estimate the largest relative error of a reduced model over the band.

        The error is computed at the frequencies ``frequency``, and then at more frequencies around
        the largest errors. The search ends at the first error above ``limit``. See
        :func:`compute_relative_error`.
        """
        for last, H in reversed(self.responses_to_check_first.items()):
            try:
                # A direct solution is used, because it is faster at one frequency than a
                # transformation to decoupled coordinates.
                ours = reduced.pencil.transfer(np.array([2j * np.pi * last]))[0]
                worst = float(self.compute_largest_errors(ours - H, H))
            except SimulationError:
                worst = np.inf
            if not worst <= limit:
                self.responses_to_check_first[last] = self.responses_to_check_first.pop(last)
                return worst
        at, ratio = self.exact.select_band_resonances((0.9 * self.band[0], 1.1 * self.band[1]))
        points, H = self.frequency, self.exact_response_and_scales[0]
        error = self.compute_largest_errors(reduced.transfer(2j * np.pi * points) - H, H)
        for _ in range(PEAK_ROUNDS):
            inner = np.r_[True, error[1:] >= error[:-1]] & np.r_[error[:-1] >= error[1:], True]
            top = np.argsort(np.where(inner, error, -1.0))[-REFINED_PEAKS:]
            low, high = np.maximum(top - 1, 0), np.minimum(top + 1, len(error) - 1)
            new = drop_points_near_poles(_refine_intervals(points, low, high), at, ratio)
            if not new.size:
                break
            H = self.exact.transfer(2j * np.pi * new)
            error = np.r_[
                error, self.compute_largest_errors(reduced.transfer(2j * np.pi * new) - H, H)
            ]
            points = np.r_[points, new]
            order = np.argsort(points)
            points, error = points[order], error[order]
        if not (worst := float(error.max())) <= limit:
            last = float(points[int(np.nan_to_num(error, nan=np.inf).argmax())])
            self.responses_to_check_first[last] = self.exact.transfer(
                np.array([2j * np.pi * last])
            )[0]
        return worst


def estimate_errors_above_band(
    ports: Sequence[Port], exact: Response, reduced: Response, band: tuple[float, float]
) -> tuple[tuple[float, float], ...]:
    """Estimate errors of a reduced model at frequencies above the band.

    Return pairs of a frequency [Hz] and an error. The frequencies are ``MULTIPLES_ABOVE_BAND``
    times the upper band limit. Each error is the largest relative error of the driving-point
    responses of all mechanical ports. For a model without mechanical ports, the result is empty.
    """
    columns = [port for port in ports if port.kind != "output"]
    rows = [port for port in ports if port.kind != "input"]
    moved = [port for port in ports if port.has_position]
    if not moved:
        return ()
    points = drop_points_near_poles(MULTIPLES_ABOVE_BAND * band[1], *exact.resonances)
    diagonal = list(map(rows.index, moved)), list(map(columns.index, moved))
    H, ours = (item.transfer(2j * np.pi * points)[:, *diagonal] for item in (exact, reduced))
    size = np.abs(ours - H) / (np.abs(H) + np.finfo(float).tiny)
    return tuple(zip(points.tolist(), size.max(axis=1).tolist(), strict=True))


def compute_relative_error(response: np.ndarray, reference: np.ndarray) -> float:
    """Return the largest relative error of a response, over entries and frequencies.

    The error of an entry is divided by the magnitude of the entry, but at least by ``PEAK_SHARE``
    times the entry's peak. The class
    :class:`kc2spice.rom.transfer_function_error_scales.EntryScales` describes entries that are
    zero.

    Both arrays have the shape (frequencies, outputs, inputs). Arrays may also have the shape
    (frequencies,) or (frequencies, entries). For the shape (frequencies, entries), the error of
    each entry is computed separately.
    """
    difference = response - reference
    if reference.ndim == 3:
        return float(compute_relative_errors(difference, reference).max(initial=0.0))
    pairs = zip(*(x.reshape(len(x), -1).T for x in (difference, reference)), strict=True)
    sizes = (compute_relative_errors(d[:, None, None], r[:, None, None]) for d, r in pairs)
    return max((float(size.max(initial=0.0)) for size in sizes), default=0.0)


def compute_relative_errors(
    difference: np.ndarray, reference: np.ndarray, entries: EntryScales | None = None
) -> np.ndarray:
    """Compute relative errors of a response from its difference to a reference.

    ``difference`` is a response minus the ``reference`` response. Both arrays have the shape (...,
    outputs, inputs).

    By default, the scales ``entries`` are computed from ``reference``. See
    :meth:`kc2spice.rom.transfer_function_error_scales.EntryScales.compute_relative_errors`.
    """
    entries = entries or EntryScales.from_response(reference)
    return entries.compute_relative_errors(difference, reference)


def make_inaccuracy_error(message: str, got: str, limit: float, hint: str) -> SimulationError:
    """Make the exception for an error estimate that remains above the limit."""
    return SimulationError(
        message, where="reduction", got=got, expected=f"at most {limit:.1e}", hint=hint
    )


def choose_default_norm(model: LinearModel) -> Norm:
    """Choose the error norm: *peak* if all ports are signals, otherwise *pointwise*."""
    return "pointwise" if any(port.conservative for port in model.ports) else "peak"
