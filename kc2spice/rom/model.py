"""Reduced models: dense second-order form with its certificate, and decoupled resonators."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from kc2spice.fem.piezo.system import Port

if TYPE_CHECKING:
    from scipy.signal import StateSpace


@dataclass(frozen=True)
class Certificate:
    """What is known about a reduced model's error.

    ``error_estimate`` is the largest relative error of any transfer function over ``band_hz``,
    estimated without the full model's response; ``method`` names the estimator.
    """

    band_hz: tuple[float, float]
    error_estimate: float
    method: str
    stable: bool
    passive: bool


class _Convertible:
    """The same model in the words of other libraries."""

    def to_statespace(self: ReducedModel | FirstOrderModel) -> StateSpace:  # type: ignore[misc]
        """First-order form without E; see :func:`kc2spice.rom.convert.to_statespace`."""
        from kc2spice.rom.convert import to_statespace

        return to_statespace(self)

    def to_pymor(self: ReducedModel | FirstOrderModel) -> Any:  # type: ignore[misc]
        """pyMOR's second-order or LTI model; see :func:`kc2spice.rom.convert.to_pymor`."""
        from kc2spice.rom.convert import to_pymor

        return to_pymor(self)


@dataclass(frozen=True)
class ReducedModel(_Convertible):
    """``M x'' + E x' + K x = B u``, ``y = C x + D u`` of order q (paper eq. 7), dense.

    ``ports`` are those of the columns of B and rows of C at once; a model with signal ports lists
    its inputs, then its outputs.
    """

    M: np.ndarray
    E: np.ndarray
    K: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    ports: tuple[Port, ...]
    certificate: Certificate

    @property
    def order(self) -> int:
        """Number of second-order states."""
        return self.M.shape[0]


@dataclass(frozen=True)
class FirstOrderModel(_Convertible):
    """``E x' = A x + B u``, ``y = C x + D u`` of order q, dense; ports as in ReducedModel."""

    E: np.ndarray
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    ports: tuple[Port, ...]
    certificate: Certificate

    @property
    def order(self) -> int:
        """Number of first-order states."""
        return self.A.shape[0]


@dataclass(frozen=True)
class ResonatorModel:
    """Decoupled form: ``z_j'' + damp_j z_j' + omega_j^2 z_j = sum_k gain_jk u_k``,
    ``y_k = sum_j gain_jk z_j + sum_l D_kl u_l``.

    ``omega`` (q,) in rad/s, ``damp`` (q,) in 1/s, ``gain`` (q, p), ``D`` (p, p). Reciprocal by
    form, stable for ``damp >= 0`` and passive for ``D`` positive semi-definite.
    For an electrical port u is the voltage and y the charge.
    """

    omega: np.ndarray
    damp: np.ndarray
    gain: np.ndarray
    D: np.ndarray
    ports: tuple[Port, ...]
    certificate: Certificate

    @property
    def order(self) -> int:
        """Number of second-order states."""
        return self.omega.size
