"""Passive models with a nearly constant loss factor, made of springs and dampers.

Structural damping ``K (1 + j eta)`` loses the same share of energy at every frequency. No causal
model has exactly the stiffness ``K (1 + j eta)``. By the Kramers-Kronig relation, a constant loss
factor requires a stiffness that increases with frequency. The stiffness is K times the factor

    chi(s) = (s / w0)^m / cos phi,    phi = arctan eta,    m = 2 phi / pi.

The stiffness factor ``chi(s)`` equals ``1 + j eta`` at ``s = j w0``. Source: A. K. Jonscher, Nature
267 (1977) 673. A generalised Maxwell model of finite order approximates the stiffness factor
``chi(s)``. The generalised Maxwell model is a spring in parallel with branches of a spring and a
damper in series,

    chi(s) = c_0 + sum_k c_k s / (s + r_k),    all c_k >= 0.

A generalised Maxwell model is passive. The amplitudes ``c_k`` are fitted over the band by
non-negative least squares. For each term and each unknown, the model has one inner displacement
``q_k``: the displacement of the damper times ``sqrt(c_k)``. With inner displacements, a symmetric
model with constant matrices represents the stiffness ``K chi``:

    M x'' + E x' + (c_0 + sum c_k) K x - sum sqrt(c_k) K q_k = B u
    (1 / r_k) K q_k' + K (q_k - sqrt(c_k) x) = 0

:func:`add_structural_damping` adds the inner displacements to a model.
:mod:`kc2spice.rom.complex_material_constants` treats piezoelectric bodies with complex material
constants.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import UsageError
from kc2spice.rom.linear_model import LinearModel

BAND_EXTENSION = 6.0  # factor by which the relaxation rates extend beyond both ends of the band
# largest number of decades below the upper band limit over which a stiffness factor is fitted
DEFAULT_DECADES = 4.0
POINTS_PER_DECADE = 40  # number of frequencies per decade at which amplitudes are fitted
# The largest number of relaxations is MAX_PER_DECADE for each decade, plus ADDITIONAL_RELAXATIONS.
MAX_PER_DECADE = 6
ADDITIONAL_RELAXATIONS = 8


@dataclass(frozen=True, eq=False)
class RelaxingStiffness(EqualByContent):
    """Stiffness factor ``constant + sum_k amplitudes_k * s / (s + rates_k)``.

    Attributes
    ----------
    constant : float
        Factor at zero frequency, ``c_0 >= 0``.
    amplitudes, rates : (k,) arrays
        Amplitudes ``c_k > 0`` and rates ``r_k > 0`` [1/s] of the relaxations.
    error : float
        Largest relative error of the fitted stiffness factor at frequencies in the band.
    """

    constant: float
    amplitudes: np.ndarray
    rates: np.ndarray
    error: float

    def __call__(self, s: np.ndarray) -> np.ndarray:
        """Return the complex factor (n,) at the Laplace variable ``s`` (n,) [1/s]."""
        s = np.asarray(s)[..., None]
        return np.asarray(self.constant + (self.amplitudes * s / (s + self.rates)).sum(axis=-1))

    @property
    def instantaneous_factor(self) -> float:
        """Stiffness factor just after a sudden displacement, ``c_0 + sum_k c_k``."""
        return float(self.constant + self.amplitudes.sum())


def compute_causal_stiffness_factor(
    frequency: np.ndarray, loss_factor: float, at: float
) -> np.ndarray:
    """Compute the causal complex stiffness factor for a constant loss factor.

    Parameters
    ----------
    frequency : (n,) array
        Frequencies [Hz].
    loss_factor : float
        Loss factor ``eta``, the reciprocal of a constant Q factor.
    at : float
        Frequency [Hz] at which the factor of stiffness is ``1 + j eta``.

    Examples
    --------
    >>> complex(np.round(compute_causal_stiffness_factor(2e3, 0.05, 2e3), 12))
    (1+0.05j)
    """
    angle = math.atan(loss_factor)
    power = (1j * np.asarray(frequency) / at) ** (2 * angle / math.pi)
    return np.asarray(power / math.cos(angle))


def fit_relaxing_stiffness(
    loss_factor: float,
    at: float,
    band: tuple[float, float],
    error: float,
    *,
    sensitivity: Callable[[np.ndarray], np.ndarray] | None = None,
    noncausal: bool = False,
) -> RelaxingStiffness:
    """Fit a relaxing stiffness to a constant loss factor, with the fewest relaxations.

    Parameters
    ----------
    loss_factor : float
        Loss factor ``eta``, the reciprocal of the Q factor.
    at : float
        Frequency [Hz] at which the real part of the stiffness is K.
    band : pair of float
        Ends of the band [Hz]. If the band begins at zero, the loss factor is constant only at
        frequencies above 1e-4 times the upper end of the band.
    error : float
        Largest allowed relative error of the response in the band. The error of the response is the
        relative error of the stiffness, multiplied by ``sensitivity``.
    sensitivity : callable, optional
        Function of frequencies (n,) [Hz] that returns the ratio (n,) of the relative change of the
        response to the relative change of the stiffness. For example, the sensitivity at a
        resonance is the Q factor. The default is 1.
    noncausal : bool
        If true, the target of the fit is ``1 + j eta`` at all frequencies. Otherwise, the target is
        the result of :func:`compute_causal_stiffness_factor`. For the target ``1 + j eta`` in the
        band from f1 to f2, the error of a passive model is at least about
        ``(eta / pi) * log(f2 / f1)``.

    Returns
    -------
    RelaxingStiffness
        Fitted factor of stiffness. If no fit is within ``error``, the result is the fit with the
        smallest error.

    Raises
    ------
    UsageError : the loss factor is negative, or the frequency or band is invalid.
    """
    if not (loss_factor >= 0 and at > 0 and 0 <= band[0] < band[1]):
        raise UsageError(
            "the loss factor, its frequency or the band is not valid",
            got=f"loss factor {loss_factor:g}, at {at:g} Hz, band {band[0]:g} to {band[1]:g} Hz",
            expected="a loss factor of at least 0, a frequency above 0, and a band with the "
            "lower frequency first",
        )
    if loss_factor == 0:
        return RelaxingStiffness(1.0, np.empty(0), np.empty(0), 0.0)
    low, high = max(band[0], band[1] / 10**DEFAULT_DECADES), band[1]
    decades = math.log10(high / low)
    f = np.geomspace(low, high, int(POINTS_PER_DECADE * decades) + POINTS_PER_DECADE)
    target = np.full(f.size, 1 + 1j * loss_factor)
    if not noncausal:
        target = compute_causal_stiffness_factor(f, loss_factor, at)
    weight = np.ones(f.size) if sensitivity is None else sensitivity(f)
    best: tuple[float, RelaxingStiffness] | None = None
    for count in range(2, math.ceil(MAX_PER_DECADE * decades) + ADDITIONAL_RELAXATIONS):
        rates = 2 * np.pi * np.geomspace(low / BAND_EXTENSION, BAND_EXTENSION * high, count)
        result = _fit_amplitudes(f, target, weight, rates)
        weighted = float((weight * np.abs(result(2j * np.pi * f) / target - 1)).max())
        if best is None or weighted < best[0]:
            best = weighted, result
        if weighted <= error:
            break
    assert best is not None
    return best[1]


def _fit_amplitudes(
    f: np.ndarray, target: np.ndarray, weight: np.ndarray, rates: np.ndarray
) -> RelaxingStiffness:
    """Fit non-negative amplitudes of relaxations with given rates by least squares.

    The fit minimises the sum of the squares of weighted relative differences from ``target``.
    """
    s = 2j * np.pi * f[:, None]
    columns = np.column_stack([np.ones(f.size), s / (s + rates)])
    A = columns * (weight / target)[:, None]
    target_rows = np.concatenate([weight, np.zeros(f.size)])
    amplitudes = scipy.optimize.nnls(np.concatenate([A.real, A.imag]), target_rows)[0]
    nonzero = amplitudes[1:] > 0
    error = float(np.abs(columns @ amplitudes / target - 1).max())
    return RelaxingStiffness(float(amplitudes[0]), amplitudes[1:][nonzero], rates[nonzero], error)


def add_structural_damping(model: LinearModel, stiffness: RelaxingStiffness) -> LinearModel:
    """Add structural damping: give the stiffness a nearly constant loss factor.

    Parameters
    ----------
    model : LinearModel
        Small, symmetric second-order model. The result has dense matrices and retains the damping
        of ``model``.
    stiffness : RelaxingStiffness
        Frequency-dependent factor of the stiffness matrix K, with k relaxation terms.

    Returns
    -------
    LinearModel
        Symmetric model with ``(1 + k) n`` unknowns: n displacements with mass, and ``k n`` inner
        displacements. The result has the certificate of ``model``. The error estimate of the
        certificate does not include the error of the approximation ``stiffness``. Away from
        resonances, the caller must add ``stiffness.error`` to the error estimate. At a resonance,
        the caller must add ``stiffness.error`` times the Q factor to the error estimate.

    Raises
    ------
    UsageError : ``model`` is a first-order model.
    """
    if model.first_order:
        raise UsageError(
            "structural damping applies only to second-order models",
            where=model.name,
            got="a first-order model",
            expected="a model with M and K",
        )
    K, E, M = model.pencil.make_dense().coefficients
    inner = len(stiffness.rates)
    return replace(
        model,
        M=np.kron(_make_corner_matrix(inner), M),
        E=np.kron(_make_corner_matrix(inner), E) + np.kron(_make_damper_matrix(stiffness), K),
        K=np.kron(_make_spring_matrix(stiffness), K),
        B=np.vstack([model.B, np.zeros((inner * model.order, model.B.shape[1]))]),
        C=np.hstack([model.C, np.zeros((model.C.shape[0], inner * model.order))]),
        rayleigh=None,
    )


def _make_corner_matrix(inner: int) -> np.ndarray:
    """Return a matrix with a one in its top left corner and zeros elsewhere.

    The square matrix has one row for a displacement with mass, and ``inner`` rows for the inner
    displacements of its springs.
    """
    result = np.zeros((1 + inner, 1 + inner))
    result[0, 0] = 1.0
    return result


def _make_spring_matrix(stiffness: RelaxingStiffness) -> np.ndarray:
    """Return the spring matrix (1 + k, 1 + k) of k relaxations, for unit stiffness."""
    result = np.diag(np.r_[stiffness.instantaneous_factor, np.ones(stiffness.rates.size)])
    result[0, 1:] = result[1:, 0] = -np.sqrt(stiffness.amplitudes)
    return result


def _make_damper_matrix(stiffness: RelaxingStiffness) -> np.ndarray:
    """Return the damping matrix (1 + k, 1 + k) of k relaxations, for unit stiffness."""
    return np.diag(np.r_[0.0, 1 / stiffness.rates])
