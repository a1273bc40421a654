"""Passive oscillators that represent modes with structural damping.

A mode of stiffness k, unit mass and loss h has the dynamic stiffness ``k + j h + s^2`` at
``s = j w``. The passive oscillator

    d(s) = c_0 + v s + sum_l c_l s / (s + r_l) + m s^2,    all coefficients >= 0,

approximates this dynamic stiffness by a spring, a dashpot, springs in series with dampers, and a
mass. A dashpot ``v = h / w_j`` alone is exact at the resonance ``w_j``. The loss of a dashpot
increases with frequency. Beside the resonance, the response therefore has an error of a quarter of
the loss factor ``eta = h / k``, relative to the peak. With one relaxation of rate ``w_j``, the loss
is constant near the resonance. By causality, the stiffness then increases with frequency. A
slightly larger mass compensates the increase of the stiffness. At the resonance, the value and the
slope of the dynamic stiffness are exact with

    c_1 = 2 eta k,    c_0 = (1 - eta / 2) k,    m = 1 + eta / 2,

and the remaining error is about ``eta^2``. The coefficients are computed by non-negative least
squares with the weights of Lawson's minimax fit. Far below all resonances, an error of about
``eta`` remains, because no real model has a complex response at zero frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

WEIGHT_UPDATES = 10  # number of updates of Lawson's weights
MIN_WEIGHT_FACTOR = 0.02  # square of the smallest factor by which an update multiplies a weight
MIN_AMPLITUDE = 1e-12  # smallest amplitude of a relaxation, relative to the stiffness ``c_0``


@dataclass(frozen=True, eq=False)
class Oscillator:
    """Passive oscillator with the dynamic stiffness ``d(s)`` that the module docstring defines.

    Attributes
    ----------
    spring, dashpot, mass : float
        Coefficients ``c_0``, ``v`` and ``m`` of the dynamic stiffness.
    amplitudes, rates : (k,) arrays
        Amplitudes ``c_l > 0`` and rates ``r_l > 0`` [1/s] of the relaxations.
    """

    spring: float
    dashpot: float
    mass: float
    amplitudes: np.ndarray
    rates: np.ndarray

    def __call__(self, s: np.ndarray) -> np.ndarray:
        """Return the dynamic stiffness (n,) at the Laplace variable ``s`` (n,) [1/s]."""
        relaxed = (self.amplitudes * s[:, None] / (s[:, None] + self.rates)).sum(axis=1)
        return np.asarray(self.spring + self.dashpot * s + self.mass * s**2 + relaxed)


def make_viscous_oscillator(stiffness: float, loss: float) -> Oscillator:
    """Make the oscillator with a dashpot whose dynamic stiffness is exact at its resonance.

    Examples
    --------
    >>> mode = make_viscous_oscillator(4.0, 0.1)
    >>> complex(mode(np.array([2j]))[0])
    0.1j
    """
    none = np.empty(0)
    return Oscillator(stiffness, loss / np.sqrt(stiffness), 1.0, none, none)


def fit_relaxing_oscillator(
    s: np.ndarray, stiffness: np.ndarray, weight: np.ndarray, rates: np.ndarray
) -> Oscillator:
    """Fit an oscillator with given relaxation rates to a dynamic stiffness.

    The fit minimises the largest weighted difference between both dynamic stiffnesses.

    Parameters
    ----------
    s, stiffness : (n,) arrays
        Laplace variable [1/s], and the dynamic stiffness at each value.
    weight : (n,) array
        Weight of the difference at each frequency.
    rates : (k,) array
        Rates ``r_l`` [1/s]; the oscillator omits rates that the fit does not use.
    """
    columns = np.column_stack([np.ones(s.size), s, s**2, s[:, None] / (s[:, None] + rates)])
    scale = np.abs(columns * weight[:, None]).max(axis=0)
    lawson, best, least = np.ones(s.size), None, np.inf
    for _ in range(WEIGHT_UPDATES):
        A = columns * (lawson * weight)[:, None] / scale
        y = stiffness * lawson * weight
        try:
            coefficients = (
                scipy.optimize.nnls(np.r_[A.real, A.imag], np.r_[y.real, y.imag])[0] / scale
            )
        except RuntimeError:  # the active-set method may not terminate
            break
        size = weight * np.abs(columns @ coefficients - stiffness)
        if size.max() < least:
            best, least = coefficients, float(size.max())
        lawson = lawson * np.sqrt(size / (size.max() + np.finfo(float).tiny) + MIN_WEIGHT_FACTOR)
        lawson = lawson / lawson.max()
    if best is None:
        return make_viscous_oscillator(
            max(stiffness.real.max(), 0.0), max(stiffness.imag.max(), 0.0)
        )
    amplitudes = best[3:]
    used = amplitudes > MIN_AMPLITUDE * best[0]
    return Oscillator(best[0], best[1], best[2], amplitudes[used], rates[used])


def assemble_oscillators(
    modes: Sequence[Oscillator], damping: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Assemble symmetric K, E and M of oscillators; E includes ``damping`` (modes, modes).

    Each relaxation is an additional unknown without mass: the displacement between its spring and
    its damper. The unknowns of the relaxations are numbered after the modes.
    """
    springs = np.array([mode.spring + mode.amplitudes.sum() for mode in modes])
    owner = np.repeat(np.arange(len(modes)), [mode.rates.size for mode in modes])
    amplitude = np.concatenate([mode.amplitudes for mode in modes])
    rate = np.concatenate([mode.rates for mode in modes])
    n, inner = len(modes), np.arange(len(modes), len(modes) + owner.size)
    K = np.diag(np.r_[springs, amplitude])
    K[owner, inner] = K[inner, owner] = -amplitude
    dashpots = damping + np.diag([mode.dashpot for mode in modes])
    E = scipy.linalg.block_diag(dashpots, np.diag(amplitude / rate))
    M = np.diag(np.r_[[mode.mass for mode in modes], np.zeros(inner.size)])
    return K, E[: n + inner.size, : n + inner.size], M
