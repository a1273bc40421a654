"""Boundary layers of ducts and cavities as sums of relaxations.

A relaxation ``w / (p + q)`` with the weight w and the corner p is a function of the normalised
frequency ``q = j omega a^2 / nu``. In a circuit, each relaxation is a branch with two positive
elements. The length ``a`` is the radius of a circular duct, or the ratio of volume to surface area
of a cavity. The symbol nu denotes the kinematic viscosity in ``flow``, and the thermal diffusivity
in ``heat`` and ``layer``. The function ``flow(q) = F(q) / q`` represents the viscous losses of a
duct. The function ``heat(q) = 1 - F(q)`` represents the thermal losses of a duct. The function
``layer(q) = tanh(z) / z`` with ``z = sqrt(q)`` represents the thermal losses of a cavity. The
functions ``flow`` and ``heat`` use ``F(q) = 1 - 2 I1(z) / (z I0(z))`` with ``z = sqrt(q)`` and the
modified Bessel functions I0 and I1. Each of the functions ``flow``, ``heat`` and ``layer`` is a sum
of relaxations with positive weights.

Sources: C. Zwikker and C. W. Kosten, Sound Absorbing Materials, 1949, chapter 2; I. B. Crandall,
Theory of Vibrating Systems and Sound, 1926, appendix A. The corners p are chosen first;
non-negative least squares then fits the weights over a frequency band. Because no weight is
negative, every network is positive real.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import numpy as np

BoundaryLayer = Literal["flow", "heat", "layer"]
# Lowest corner p of the relaxations ``w / (p + q)`` in each boundary-layer function.
# For ``flow`` and ``heat``, the lowest corner is the square of 2.4048, the first zero of the Bessel
# function J0.
LOWEST_CORNERS = {
    "flow": 2.404825557695773**2,
    "heat": 2.404825557695773**2,
    "layer": math.pi**2 / 4,
}
# Values of the boundary-layer functions at q = 0, and slopes with reversed sign.
# For ``flow``, the value is the sum of 4 / j^4 over the zeros j of J0. The slope with reversed
# sign is the sum of 4 / j^6.
STATIC_VALUES = {"flow": 1 / 8, "heat": 1.0, "layer": 1.0}
STATIC_SLOPES = {"flow": 1 / 48, "heat": 1 / 8, "layer": 1 / 3}
LAYER_START = 1e6  # |z| above which the Bessel functions I1(z) and I0(z) differ by less than 1e-6
SERIES_END = 1e-4  # |q| below which two terms of the power series have an error below 1e-9
SAMPLES_PER_DECADE = 12  # number of frequencies per decade in the fit
# Factors by which the range of the corners extends below and above the band.
RATIO_BELOW_BAND, RATIO_ABOVE_BAND = 6.0, 6.0
STATIC_WEIGHT = 0.1  # weight of the value and the slope at q = 0 in the fit


@dataclass(frozen=True)
class RelaxationSum:
    """Sum of relaxation terms that approximates a boundary-layer function.

    Each term is ``w / (p + q)`` at the normalised complex frequency q. ``terms`` contains a pair
    for each term: the normalised corner frequency p and the weight w. ``value_error`` and
    ``loss_error`` are the largest relative errors of the function and of its dissipation in the
    band.
    """

    terms: tuple[tuple[float, float], ...]
    value_error: float
    loss_error: float


def evaluate_layer(layer: BoundaryLayer, q: np.ndarray) -> np.ndarray:
    """Return the exact boundary-layer function at normalised frequencies ``q``."""
    from scipy.special import ive  # loads slowly

    z = np.sqrt(q)
    if layer == "layer":
        result = np.tanh(z) / z
    else:
        thick = np.where(np.abs(z) < LAYER_START, z, LAYER_START)
        ratio = np.where(np.abs(z) < LAYER_START, ive(1, thick) / ive(0, thick), 1.0)
        heat = 2 * ratio / z
        result = heat if layer == "heat" else (1 - heat) / q
    # For small arguments, rounding errors dominate the difference 1 - heat, so the function is
    # computed from two terms of its power series.
    slow = STATIC_VALUES[layer] - STATIC_SLOPES[layer] * q
    return np.asarray(np.where(np.abs(q) < SERIES_END, slow, result))


@lru_cache(maxsize=64)
def fit_boundary_layer(
    layer: BoundaryLayer, low: float, high: float, per_decade: int
) -> RelaxationSum:
    """Fit a sum of relaxation terms to a boundary-layer function in a frequency band.

    The text at the top of this module defines the three boundary-layer functions.

    Parameters
    ----------
    layer : {"flow", "heat", "layer"}
        Function to be fitted: viscous losses of a duct, thermal losses of a duct, or thermal losses
        of a cavity.
    low, high : float
        Lowest and highest normalised frequency omega a^2 / nu of the band.
    per_decade : int
        Number of relaxation corners in each decade of the normalised frequency.

    Returns
    -------
    RelaxationSum
        Corners and positive weights of the relaxations, and their errors in the band.

    Examples
    --------
    >>> result = fit_boundary_layer("flow", 1.0, 1e3, 3)
    >>> result.loss_error < 0.01, all(weight > 0 for _, weight in result.terms)
    (True, True)
    """
    from scipy.optimize import nnls  # loads slowly

    samples = max(8, math.ceil(SAMPLES_PER_DECADE * math.log10(high / low)))
    q = 1j * np.geomspace(low, high, samples)
    exact, corners = evaluate_layer(layer, q), _choose_corners(layer, low, high, per_decade)
    terms = 1 / (corners + q[:, None])
    loss, size = _compute_dissipation(layer, q, exact), np.abs(exact)
    rows = np.vstack([
        _compute_dissipation(layer, q[:, None], terms) / loss[:, None],
        _compute_reactive_part(layer, terms) / size[:, None],
        STATIC_WEIGHT / (corners * STATIC_VALUES[layer])[None],
        STATIC_WEIGHT / (corners**2 * STATIC_SLOPES[layer])[None],
    ])  # fmt: skip
    target = np.concatenate(
        [np.ones(q.size), _compute_reactive_part(layer, exact) / size, [STATIC_WEIGHT] * 2]
    )
    weights, _ = nnls(rows, target)
    fitted = terms @ weights
    positive = weights > 0
    return RelaxationSum(
        tuple(zip(corners[positive].tolist(), weights[positive].tolist(), strict=True)),
        float(np.abs(fitted / exact - 1).max()),
        float(
            np.abs(
                _compute_dissipated_power(layer, q, fitted)
                / _compute_dissipated_power(layer, q, exact)
                - 1
            ).max()
        ),
    )


def _choose_corners(layer: BoundaryLayer, low: float, high: float, per_decade: int) -> np.ndarray:
    """Choose the normalised corner frequencies of the relaxation terms.

    The corner frequencies are closely spaced in the band and widely spaced below the band.
    """
    first, top = LOWEST_CORNERS[layer], RATIO_ABOVE_BAND * high
    dense = max(first, low / RATIO_BELOW_BAND)
    top = max(top, 10 * dense)
    count = math.ceil(per_decade * math.log10(top / dense)) + 1
    sparse = np.geomspace(first, dense, math.ceil(math.log10(dense / first)) + 1)
    return np.union1d(sparse, np.geomspace(dense, top, count))


def _compute_dissipation(layer: BoundaryLayer, q: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Compute the dissipative part of a boundary-layer function.

    The dissipative part is a linear function of the weights.

    The dissipative part is the real part of an admittance. For viscous losses of a duct, the
    admittance is the boundary-layer function ``flow(q)``. For thermal losses, the admittance of a
    duct is ``q * heat(q)``, and the admittance of a cavity is ``q * layer(q)``.
    """
    return np.asarray(value.real if layer == "flow" else (q * value).real)


def _compute_reactive_part(layer: BoundaryLayer, value: np.ndarray) -> np.ndarray:
    """Compute the reactive part of a boundary-layer function."""
    return np.asarray(value.imag if layer == "flow" else value.real)


def _compute_dissipated_power(layer: BoundaryLayer, q: np.ndarray, value: np.ndarray) -> np.ndarray:
    """Compute the normalised power loss at fixed volume velocity or fixed pressure."""
    return np.asarray((1 / value).real if layer == "flow" else (q * value).real)
