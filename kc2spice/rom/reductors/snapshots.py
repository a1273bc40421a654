"""Snapshots of a frequency response: frequencies and weights.

A body in contact with other bodies is also excited above the band. A basis fitted to the band alone
has large errors above the band, so mechanical ports add snapshots at higher frequencies with a
small weight: the *tail*.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from kc2spice.rom.error_estimate import ErrorEstimator
from kc2spice.rom.linear_model import LinearModel, Norm
from kc2spice.rom.response import Response, grid, sample_resonances

# Points of each grid, linear and logarithmic. Every resonance adds snapshots, so the grid covers
# the response between resonances.
GRID_POINTS = 101
# Snapshots above the band; chosen by trial.
TAIL_REACH = 8.0  # end of the frequencies above the band, relative to the end of the band
TAIL_POINTS = 150
TAIL_DECAY = 4  # exponent with which the weight decreases above the band: contact forces are smooth
# Smallest and largest weight at the end of the band. Chosen by trial: launches of the paper's chip
# by reduced models of 20 to 31 states had errors of at most 3e-4, and larger errors with weights
# up to 1e-2.
TAIL_WEIGHTS = 4e-3, 5e-2
# weight relative to the root of the tolerance, because squares of errors are minimised
TAIL_PER_ROOT = 120.0
# Smallest reference of an entry, relative to its peak: the floor of the pointwise norm.
MIN_REFERENCE_SHARE = {"pointwise": 1e-6, "peak": 1.0}


class Snapshots(NamedTuple):
    """Frequencies [Hz] in the band, frequencies above it, and their weights.

    The weights apply to frequencies above the band.
    """

    inside: np.ndarray
    above: np.ndarray
    above_weight: np.ndarray

    @property
    def s(self) -> np.ndarray:
        """Laplace variable of all snapshots [1/s]."""
        return np.asarray(2j * np.pi * np.r_[self.inside, self.above])

    def weights(self, inside: np.ndarray | float = 1.0, above: float = 1.0) -> np.ndarray:
        """Return the weights of all snapshots.

        ``inside`` are the weights in the band; weights above the band are multiplied by ``above``.
        """
        weight = np.broadcast_to(inside, self.inside.shape)
        return np.asarray(np.r_[weight, above * self.above_weight])


def tail_weight(model: LinearModel, tolerance: float | None) -> float | None:
    """Return the weight of snapshots above the band; None without mechanical ports."""
    if not any(port.moving for port in model.ports):
        return None
    return float(np.clip(TAIL_PER_ROOT * np.sqrt(tolerance or 0.0), *TAIL_WEIGHTS))


def snapshots(
    estimator: ErrorEstimator, response: Response, tail: float | None = None
) -> Snapshots:
    """Return frequencies of the band, of its resonances, and of a ``tail`` above it."""
    low, high = estimator.band
    at, ratio = response.within(estimator.band)
    frequency = grid((low, high), GRID_POINTS, estimator.static)
    frequency = np.union1d(frequency, sample_resonances(at, ratio, np.array([0.0, 1.0])))
    if tail is None:
        return Snapshots(frequency, np.empty(0), np.empty(0))
    above = np.linspace(high, TAIL_REACH * high, TAIL_POINTS)
    weight = tail * (high / above) ** TAIL_DECAY * np.sqrt(GRID_POINTS / TAIL_POINTS)
    return Snapshots(frequency, above, weight)


def weighted_states(
    response: Response, s: np.ndarray, weight: np.ndarray, complete: np.ndarray, norm: Norm
) -> np.ndarray:
    """Return weighted real and imaginary parts of the states.

    With these weights, least squares minimise the relative error.

    If ports exchange energy, the square of a state is an energy, and each state is divided by the
    square root of the response of its port. Other states are divided by their length. The response
    of the ``complete`` model includes rigid-body modes. In the peak norm, states are divided by
    peaks.
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
    """Lengths (frequencies, inputs) of states x in the units of a response.

    The response H of the states is a part of ``complete``.
    """
    size = np.linalg.norm(x, axis=1)
    if norm == "peak":
        size = np.maximum(size, size.max(axis=0))
    part = np.linalg.norm(H, axis=1)
    ratio = np.divide(
        np.linalg.norm(complete, axis=1), part, out=np.ones_like(part), where=part > 0
    )
    return np.asarray(size * np.maximum(ratio, 1.0))
