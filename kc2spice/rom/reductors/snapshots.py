"""Snapshots of a frequency response: frequencies and weights.

A contact also excites a body above the band. A basis that is fitted only to the band has large
errors above the band. Therefore, if a model has mechanical ports, there are additional snapshots at
higher frequencies with a small weight (the *tail*).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kc2spice.rom.error_estimate import ErrorEstimator
from kc2spice.rom.linear_model import LinearModel, Norm
from kc2spice.rom.response import Response, grid, sample_resonances

# Number of points of each grid, a linear and a logarithmic one. There are additional snapshots at
# every resonance, so the grid represents the response between resonances.
GRID_POINTS = 101
# settings of the snapshots above the band, found by trials
TAIL_REACH = 8.0  # highest frequency of the snapshots, relative to the end of the band
TAIL_POINTS = 150
# Exponent with which the weight decreases above the band. The spectrum of contact forces decreases,
# because they are smooth functions of time.
TAIL_DECAY = 4
# Smallest and largest weight at the end of the band. With these weights, launches of the paper's
# chip by reduced models of 20 to 31 states had errors of at most 3e-4. With weights of only up to
# 1e-2, the errors were larger.
TAIL_WEIGHTS = 4e-3, 5e-2
# weight relative to the square root of the tolerance, because squared errors are minimised
TAIL_PER_ROOT = 120.0
# smallest reference of the error of an entry, relative to the entry's peak, keyed by norm
MIN_REFERENCE_SHARE = {"pointwise": 1e-6, "peak": 1.0}


class Snapshots(NamedTuple):
    """Frequencies [Hz] of snapshots in the band and above the band.

    ``above_weight`` are the weights of the frequencies above the band.
    """

    inside: np.ndarray
    above: np.ndarray
    above_weight: np.ndarray

    @property
    def s(self) -> np.ndarray:
        """Laplace variables of all snapshots [1/s]."""
        return np.asarray(2j * np.pi * np.r_[self.inside, self.above])

    def weights(self, inside: np.ndarray | float = 1.0, above: float = 1.0) -> np.ndarray:
        """Return the weights of all snapshots.

        ``inside`` are the weights in the band. The weights above the band are multiplied by
        ``above``.
        """
        weight = np.broadcast_to(inside, self.inside.shape)
        return np.asarray(np.r_[weight, above * self.above_weight])


def choose_tail_weight(model: LinearModel, tolerance: float | None) -> float | None:
    """Return the weight of snapshots above the band; None without mechanical ports."""
    if not any(port.moving for port in model.ports):
        return None
    return float(np.clip(TAIL_PER_ROOT * np.sqrt(tolerance or 0.0), *TAIL_WEIGHTS))


def snapshots(
    estimator: ErrorEstimator, response: Response, tail: float | None = None
) -> Snapshots:
    """Return frequencies over the band, at its resonances, and above the band.

    ``tail`` is the weight at the end of the band; None omits frequencies above the band.
    """
    low, high = estimator.band
    at, ratio = response.within(estimator.band)
    frequency = grid((low, high), GRID_POINTS, estimator.static)
    frequency = np.union1d(frequency, sample_resonances(at, ratio, np.array([0.0, 1.0])))
    if tail is None:
        return Snapshots(frequency, np.empty(0), np.empty(0))
    above = np.linspace(high, TAIL_REACH * high, TAIL_POINTS)
    weight = tail * (high / above) ** TAIL_DECAY * np.sqrt(GRID_POINTS / TAIL_POINTS)
    return Snapshots(frequency, above, weight)


def weight_states(
    response: Response, s: np.ndarray, weight: np.ndarray, complete: np.ndarray, norm: Norm
) -> np.ndarray:
    """Return the real and imaginary parts of the states with weights for a relative error.

    If ports exchange energy, the square of a state is an energy, and each state is divided by the
    square root of the response of its port. Otherwise, each state is divided by its length. The
    response of the ``complete`` model includes rigid-body modes. In the norm *peak*, states are
    divided by peaks.
    """
    x = response.states(s)
    pencil = response.pencil
    H = pencil.C @ x + pencil.D
    if pencil.symmetric and pencil.collocated:
        least = MIN_REFERENCE_SHARE[norm] * np.abs(np.einsum("fii->fi", H)).max(axis=0)
        size = np.sqrt(np.maximum(np.abs(np.einsum("fii->fi", complete)), least))
    else:
        size = _lengths(x, H, complete, norm)
    x = x * (weight[:, None] / (size + np.finfo(float).tiny))[:, None, :]
    columns = np.moveaxis(x, 0, 1).reshape(x.shape[1], -1)
    return np.hstack([columns.real, columns.imag])


def _lengths(x: np.ndarray, H: np.ndarray, complete: np.ndarray, norm: Norm) -> np.ndarray:
    """Return lengths (frequencies, inputs) of the states x, in the unit of a response.

    H is the response of the states, without the rigid-body modes that ``complete`` includes.
    """
    size = np.linalg.norm(x, axis=1)
    if norm == "peak":
        size = np.maximum(size, size.max(axis=0))
    part = np.linalg.norm(H, axis=1)
    ratio = np.divide(
        np.linalg.norm(complete, axis=1), part, out=np.ones_like(part), where=part > 0
    )
    return np.asarray(size * np.maximum(ratio, 1.0))
