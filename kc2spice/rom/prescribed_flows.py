"""Computation of heat flows into ports with prescribed temperatures.

The module also compares the heat flows of reduced models with the heat flows of the full model.

:mod:`kc2spice.rom.interface_reduction` divides the unknowns into the prescribed temperatures
``T_i`` and all other temperatures ``T_e``. The vector Q contains the heat flows into the ports with
prescribed temperatures. The vector T_q contains the temperatures of the ports with prescribed heat
flows q::

    Q = G T_i - S' q + s (M T_i + c' x),    T_q = S T_i + B_e' x,
    (K_ee + s E_ee) x = B_e q - s c T_i,

The unknowns x are the differences between ``T_e`` and the static temperatures ``Psi T_i``. The
matrix ``G`` contains the static heat flows, and the matrix ``S`` the static temperatures. The other
matrices are ``c = E_ei + E_ee Psi`` and ``M = E_ii + 2 E_ie Psi + Psi' E_ee Psi``. At high
frequencies, the terms of Q nearly cancel. For example, at high frequencies the heat flow through a
film into a body approaches ``K_ii T_i``, because the temperature of the body hardly changes.
Therefore, the errors of Q and T_q may be much larger than the error of x. In the original
equations, the terms of the heat flows Q nearly cancel at low frequencies, but not at high
frequencies::

    (K_ee + s E_ee) T_e = B_e q - (K_ei + s E_ei) T_i,
    Q = (K_ii + s E_ii) T_i + (K_ie + s E_ie) T_e - B_i' q,    T_q = B_i' T_i + B_e' T_e.

The heat flows Q depend on ``T_e`` only by the outputs ``K_ie T_e`` and ``E_ie T_e``. Therefore, Q
is accurate if the model of ``T_e`` is reduced with the corresponding input matrices ``K_ei`` and
``E_ei``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from kc2spice.core.domains import THERMAL
from kc2spice.rom.intermediate_reduction import build_intermediate_model
from kc2spice.rom.linear_model import LinearModel, Norm, Port
from kc2spice.rom.prescribed_temperature_split import DENSE, ROUNDING, SplitHeatModel
from kc2spice.rom.transfer_function_error_scales import EntryScales, get_min_relative_divisor

FREQUENCIES = 40  # number of frequencies at which smooth responses of heat flows are compared
DECADES = 4.0  # number of decades below the end of the band in which responses are compared
# requested error and largest permitted error of the reference response, relative to the tolerance
REFERENCE_SHARE = 0.01, 0.3


def make_driven_model(
    model: LinearModel, parts: SplitHeatModel, *, stored: bool = True
) -> LinearModel:
    """Make a heat model whose inputs are the prescribed heat flows and temperatures.

    The model of ``T_e`` has the inputs ``B_e`` and ``-K_ei``. If ``stored`` is true, the model also
    has the inputs ``E_ei``. Each column of an input matrix is a port.
    """
    K, E = map(sparse.csc_array, model.pencil.coefficients)
    at, others, count = parts.at, parts.others, len(parts.shares)
    K_ei, E_ei = K[others][:, at].toarray(), E[others][:, at].toarray()
    B = np.hstack([parts.inner.B[:, :count], -K_ei, stored * E_ei])
    names = [port.name for port in parts.inner.ports[:count]]
    names += [f"{kind}{k}" for kind in ("conducted", "stored") for k in range(len(at))]
    live = np.flatnonzero(np.abs(B).max(axis=0) > 0)
    ports = tuple(Port(names[k], THERMAL.port) for k in live)
    K_ee, E_ee = parts.inner.pencil.coefficients
    return LinearModel(E=E_ee, K=K_ee, B=B[:, live], ports=ports, name=model.name)


@dataclass(frozen=True, eq=False)
class FlowReference:
    """Reference for heat flows: response of a full model at prescribed temperatures.

    Attributes
    ----------
    frequency : (n,) frequencies [Hz] at which reduced models are compared with the full model.
    response : (n, ports, ports) response of the outputs Q and T_q (rows) to T_i and q (columns).
    uncertainty : relative error of the response.
    rounding : (ports, ports) rounding errors of the response.
    share : smallest divisor of the errors of a response entry, relative to the largest magnitude of
        this entry over all frequencies. Otherwise, an error is divided by the magnitude of the
        entry at the frequency of the error.
    """

    frequency: np.ndarray
    response: np.ndarray
    uncertainty: float
    rounding: np.ndarray
    share: float

    @classmethod
    def from_full_model(
        cls,
        model: LinearModel,
        parts: SplitHeatModel,
        band: tuple[float, float],
        norm: Norm,
        tolerance: float,
    ) -> FlowReference:
        """Compute the heat-flow reference from a full model at prescribed temperatures."""
        low, high = max(band[0], band[1] / 10**DECADES), band[1]
        frequency = np.r_[[0.0] * (band[0] == 0.0), np.geomspace(low, high, FREQUENCIES)]
        uncertainty = 0.0
        if parts.inner.order > DENSE:
            model, parts, uncertainty = _project_on_responses(model, parts, band, tolerance)
        response = _compute_response(model, parts, frequency)
        rounding = np.full(response.shape[1:], ROUNDING)
        n = len(parts.at)
        rounding[:n, :n] *= np.abs(model.pencil.coefficients[0]).diagonal()[parts.at].max()
        rounding[n:, n:] = 0.0
        return cls(frequency, response, uncertainty, rounding, get_min_relative_divisor(norm))

    def compute_error(self, model: LinearModel, parts: SplitHeatModel) -> float:
        """Return the largest relative error of a reduced model's flows and temperatures.

        ``parts`` describes the division of the unknowns of the reduced model. The error includes
        the uncertainty of the reference.
        """
        response = _compute_response(model, parts, self.frequency)
        base = EntryScales.from_response(self.response).compute_error_divisors(
            self.response, self.share
        )
        difference = np.maximum(np.abs(response - self.response) - self.rounding, 0.0)
        relative = difference / (base + np.finfo(float).tiny)
        return float(relative.max(initial=0.0)) + self.uncertainty


def _project_on_responses(
    model: LinearModel, parts: SplitHeatModel, band: tuple[float, float], tolerance: float
) -> tuple[LinearModel, SplitHeatModel, float]:
    """Replace a large model by its projection on responses in the ``band`` [Hz].

    Return the smaller model, the division of its unknowns into prescribed and free temperatures,
    and its error. The error is far below the ``tolerance``.
    """
    limits = (share * tolerance for share in REFERENCE_SHARE)
    space = build_intermediate_model(make_driven_model(model, parts).pencil, band, *limits)
    # The intermediate model of a model with more than DENSE unknowns always has a basis.
    assert space.basis is not None
    n, at, others = len(parts.at), parts.at, parts.others
    W, _ = np.linalg.qr(np.hstack([space.basis, parts.psi]))
    V = np.zeros((model.order, n + W.shape[1]))
    V[at, :n], V[others, n:] = np.eye(n), W
    K, E = (V.T @ (matrix @ V) for matrix in model.pencil.coefficients)
    small = LinearModel(E=E, K=K, B=V.T @ model.B, ports=model.ports)
    inner = parts.inner
    K, E = (W.T @ (matrix @ W) for matrix in inner.pencil.coefficients)
    inside = LinearModel(E=E, K=K, B=W.T @ inner.B, ports=inner.ports)
    first, other_indices = np.arange(n), np.arange(n, V.shape[1])
    divided = replace(parts, at=first, others=other_indices, psi=W.T @ parts.psi, inner=inside)
    return small, divided, space.error


def _compute_response(
    model: LinearModel, parts: SplitHeatModel, frequency: np.ndarray
) -> np.ndarray:
    """Compute the frequency response: heat flows and temperatures at all ports.

    Like :attr:`FlowReference.response`, the result has the shape (n, ports, ports), with outputs as
    rows and inputs as columns. The module docstring contains two equivalent forms of the equations.
    At each frequency, the form with the smaller terms is used, because smaller terms have smaller
    rounding errors.
    """
    K, E = map(sparse.csc_array, model.pencil.coefficients)
    at, others, count = parts.at, parts.others, len(parts.shares)
    K_ii, E_ii = K[at][:, at].toarray(), E[at][:, at].toarray()
    K_ei, E_ei = K[others][:, at].toarray(), E[others][:, at].toarray()
    K_ee, E_ee = parts.inner.pencil.coefficients
    b, c = np.split(parts.inner.B, [count], axis=1)
    direct = parts.shares - b.T @ parts.psi  # the matrix B_i' of the equations
    result = []
    for s in 2j * np.pi * frequency:
        coupling = K_ei + s * E_ei
        X = _solve_linear_system(K_ee + s * E_ee, np.hstack([-coupling, b, -s * c]))
        dynamic_response, by_flow, deviation = np.split(X, [len(at), len(at) + count], axis=1)
        inner = b.T @ by_flow
        flows, temperatures = (
            K_ii + s * E_ii + coupling.T @ dynamic_response,
            direct + b.T @ dynamic_response,
        )
        if np.abs(s * parts.stored).max(initial=0.0) < np.abs(K_ii).max(initial=0.0):
            flows = parts.conductance + s * (parts.stored + c.T @ deviation)
            temperatures = parts.shares + b.T @ deviation
        result.append(np.block([[flows, -temperatures.T], [temperatures, inner]]))
    return np.array(result)


def _solve_linear_system(matrix: sparse.csc_array | np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a dense or a sparse linear system."""
    if isinstance(matrix, np.ndarray):
        return np.asarray(np.linalg.solve(matrix, right))
    return np.asarray(splu(sparse.csc_array(matrix)).solve(right.astype(complex)))
