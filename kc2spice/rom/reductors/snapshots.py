"""Snapshots of a frequency response for reductions: frequencies and weights.

A contact also excites a body above the band, where a basis that is fitted only to the band has
large errors. Therefore, a model with mechanical ports has additional snapshots with small weights
above the band (the *tail*).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kc2spice.rom.error_estimate import ErrorEstimator
from kc2spice.rom.linear_model import LinearModel, Norm
from kc2spice.rom.response import Response, make_frequency_grid, sample_resonances
from kc2spice.rom.transfer_function_error_scales import get_min_relative_divisor

# Number of points in the linear grid and in the logarithmic grid over the band.
# The grids sample the response between resonances. Each resonance has additional snapshots.
GRID_POINTS = 101
# settings of the snapshots above the band, found by trials
TAIL_REACH = 8.0  # highest frequency of the snapshots, relative to the end of the band
TAIL_POINTS = 150
# The weight of a snapshot above the band is proportional to frequency^-TAIL_DECAY.
# The spectrum of a contact force, a smooth function of time, decreases in a similar way.
TAIL_DECAY = 4
# Smallest and largest weight of the snapshots just above the band.
# With TAIL_WEIGHTS, reduced models with 20 to 31 states simulated launches of a chip with errors of
# at most 3e-4.
# A largest weight of 1e-2 instead of 5e-2 increased the errors in simulated launches of a chip.
TAIL_WEIGHTS = 4e-3, 5e-2
# Ratio of the weight just above the band to the square root of the tolerance.
# The square root is used because the fit minimises squared errors.
TAIL_PER_ROOT = 120.0


class SnapshotFrequencies(NamedTuple):
    """Frequencies [Hz] of snapshots in the band and above the band.

    ``above_weight`` contains the weights of the snapshots above the band.
    """

    inside: np.ndarray
    above: np.ndarray
    above_weight: np.ndarray

    @property
    def s(self) -> np.ndarray:
        """Values of the Laplace variable s [1/s] at all snapshots."""
        return np.asarray(2j * np.pi * np.r_[self.inside, self.above])

    def weights(self, inside: np.ndarray | float = 1.0, above: float = 1.0) -> np.ndarray:
        """Return the weights of all snapshots: first in the band, then above the band.

        ``inside`` contains the weights of the snapshots in the band. The weights above the band are
        multiplied by ``above``.
        """
        weight = np.broadcast_to(inside, self.inside.shape)
        return np.asarray(np.r_[weight, above * self.above_weight])


def choose_tail_weight(model: LinearModel, tolerance: float | None) -> float | None:
    """Return the weight of snapshots just above the band (the tail), or None.

    The result is None for a model without mechanical ports, which needs no snapshots above the
    band.
    """
    if not any(port.has_position for port in model.ports):
        return None
    return float(np.clip(TAIL_PER_ROOT * np.sqrt(tolerance or 0.0), *TAIL_WEIGHTS))


def choose_snapshots(
    estimator: ErrorEstimator, response: Response, tail: float | None = None
) -> SnapshotFrequencies:
    """Choose snapshot frequencies in the band, at its resonances and above the band.

    ``tail`` is the weight of the snapshots just above the end of the band. If ``tail`` is None,
    there are no snapshots above the band.
    """
    low, high = estimator.band
    at, ratio = response.select_band_resonances(estimator.band)
    frequency = make_frequency_grid((low, high), GRID_POINTS, estimator.static)
    frequency = np.union1d(frequency, sample_resonances(at, ratio, np.array([0.0, 1.0])))
    if tail is None:
        return SnapshotFrequencies(frequency, np.empty(0), np.empty(0))
    above = np.linspace(high, TAIL_REACH * high, TAIL_POINTS)
    weight = tail * (high / above) ** TAIL_DECAY * np.sqrt(GRID_POINTS / TAIL_POINTS)
    return SnapshotFrequencies(frequency, above, weight)


def weight_states(
    response: Response, s: np.ndarray, weight: np.ndarray, complete: np.ndarray, norm: Norm
) -> np.ndarray:
    """Weight the states of a response, so that weak responses also become accurate.

    If the model is symmetric and collocated, the square of a state is an energy. In such a model,
    the state vector for the input at a port is divided by the square root of the port's response.
    In all other models, each state vector is divided by its norm. In the norm *peak*, the largest
    divisor in the band replaces all divisors. ``complete`` is the response of the model with
    rigid-body modes. The result has the shape (n, 2 * frequencies * inputs), with the real parts
    before the imaginary parts.
    """
    x = response.states(s)
    pencil = response.pencil
    H = pencil.C @ x + pencil.D
    if pencil.is_symmetric and pencil.is_collocated:
        least = get_min_relative_divisor(norm) * np.abs(np.einsum("fii->fi", H)).max(axis=0)
        size = np.sqrt(np.maximum(np.abs(np.einsum("fii->fi", complete)), least))
    else:
        size = _compute_state_norms(x, H, complete, norm)
    x = x * (weight[:, None] / (size + np.finfo(float).tiny))[:, None, :]
    columns = np.moveaxis(x, 0, 1).reshape(x.shape[1], -1)
    return np.hstack([columns.real, columns.imag])


def _compute_state_norms(
    x: np.ndarray, H: np.ndarray, complete: np.ndarray, norm: Norm
) -> np.ndarray:
    """Return the norms that scale the states ``x``, as array (frequencies, inputs).

    H is the response without rigid-body modes, and ``complete`` is the response with rigid-body
    modes. The norms are multiplied by the factor by which rigid-body modes increase the response.
    """
    size = np.linalg.norm(x, axis=1)
    if norm == "peak":
        size = np.maximum(size, size.max(axis=0))
    part = np.linalg.norm(H, axis=1)
    ratio = np.divide(
        np.linalg.norm(complete, axis=1), part, out=np.ones_like(part), where=part > 0
    )
    return np.asarray(size * np.maximum(ratio, 1.0))
