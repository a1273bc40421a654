"""Passive oscillators that represent modes with structural damping.

A mode of stiffness k, unit mass and loss h has the dynamic stiffness ``k + j h + s^2`` at
``s = j w``. The passive oscillator

    d(s) = c_0 + v s + sum_l c_l s / (s + r_l) + m s^2,    all coefficients >= 0,

approximates this dynamic stiffness by a spring, a dashpot, springs in series with dampers, and a
mass. Without relaxations, a dashpot ``v = h / w_j`` is exact at the resonance ``w_j``, but the loss
of a dashpot increases with frequency. Therefore, the response near the resonance has an error of
``eta / 4``, relative to the peak, with the loss factor ``eta = h / k``. With one relaxation of rate
``w_j``, the loss is constant near the resonance. By causality, the stiffness of a relaxation
increases with frequency. A slightly larger mass, ``m > 1``, compensates near the resonance for the
stiffness that the relaxation adds. The value and the slope of the dynamic stiffness are exact at
the resonance for the coefficients

    c_1 = 2 eta k,    c_0 = (1 - eta / 2) k,    m = 1 + eta / 2,

and the remaining error near the resonance is about ``eta^2``. The coefficients are computed by
non-negative least squares with the weights of Lawson's minimax fit. Far below all resonances, an
error of about ``eta`` remains, because no real model has a complex response at zero frequency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

WEIGHT_UPDATES = 10  # number of updates of Lawson's weights
# Each update multiplies a weight by sqrt(error / largest error + MIN_WEIGHT_FACTOR).
MIN_WEIGHT_FACTOR = 0.02
MIN_AMPLITUDE = 1e-12  # smallest amplitude of a relaxation, relative to the stiffness ``c_0``


@dataclass(frozen=True, eq=False)
class Oscillator:
    """Passive oscillator: spring, dashpot and mass, with relaxations of the stiffness.

    The module docstring defines the dynamic stiffness ``d(s)``.

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
    """Make an oscillator with a dashpot of prescribed loss stiffness at resonance.

    The loss stiffness ``loss`` is the imaginary part of the dynamic stiffness at the resonance.

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
    """Fit a dynamic stiffness by an oscillator whose stiffness relaxes at given rates.

    The fit minimises the largest weighted difference between the fitted and the given dynamic
    stiffness.

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
        except RuntimeError:  # the active-set method of nnls may not converge
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
    """Assemble the symmetric matrices K, E and M of oscillators.

    The matrix ``damping`` (modes, modes) is added to E.

    For each relaxation, the displacement between spring and damper is an additional unknown without
    mass. The unknowns of the relaxations follow the unknowns of the modes.
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
