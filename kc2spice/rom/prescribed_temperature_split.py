"""Division of the unknowns of heat models into prescribed temperatures and others.

The division is exact. :mod:`kc2spice.rom.interface_reduction` contains the equations.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy
from scipy import sparse
from scipy.sparse.linalg import splu

from kc2spice.core.domains import THERMAL
from kc2spice.core.naming import list_names
from kc2spice.rom.linear_model import LinearModel, Port

DENSE = 1500  # models with more unknowns are not transformed to modal coordinates
# A body has no thermal path to the ambient if the largest row sum of its conductance matrix K,
# divided by the largest diagonal entry of K, is below this ratio.
ROUNDING = 1e-12


def keeps_all_heat(K: sparse.csc_array) -> bool:
    """Return whether a body keeps all heat: the row sums of its matrix K are zero."""
    return bool(np.abs(K @ np.ones(K.shape[0])).max() < ROUNDING * np.abs(K.diagonal()).max())


@dataclass(frozen=True, eq=False)
class SplitHeatModel:
    """Heat model divided into prescribed temperatures and all other unknowns.

    Attributes
    ----------
    at, others : indices of the unknowns with prescribed temperatures, and of all other unknowns.
    psi : static responses of the other unknowns to prescribed temperatures, as an array of shape
        (others, prescribed).
    shares : static temperatures of the heat-flow ports, per kelvin of each prescribed temperature,
        as an array of shape (heat-flow ports, prescribed).
    conductance : array of shape (prescribed, prescribed). Entry (i, k) [W/K] is the static heat
        flow into port i per kelvin at port k. Both ports have prescribed temperatures.
    stored : heat [J/K] that the body stores in the static state, for prescribed temperatures of
        1 K, as an array of shape (prescribed, prescribed).
    inner : model of the unknowns x, which :mod:`kc2spice.rom.interface_reduction` defines. The
        inputs are the prescribed heat flows q and the rates T_i' of the prescribed temperatures.
    """

    at: np.ndarray
    others: np.ndarray
    psi: np.ndarray
    shares: np.ndarray
    conductance: np.ndarray
    stored: np.ndarray
    inner: LinearModel


def split_prescribed_ports(model: LinearModel, prescribed: Sequence[str]) -> SplitHeatModel:
    """Divide a heat model into prescribed temperatures and all other unknowns."""
    K, E = map(sparse.csc_array, model.pencil.coefficients)
    names = list_names(model.ports)
    of_ports = [names.index(name) for name in prescribed]
    at = model.B[:, of_ports].argmax(axis=0)
    others = np.setdiff1d(np.arange(model.order), at)
    sources = np.setdiff1d(np.arange(len(names)), of_ports)
    K_ee, E_ee = K[others][:, others], E[others][:, others]
    psi = np.zeros((len(others), 0))
    if len(at):
        psi = -splu(sparse.csc_array(K_ee)).solve(K[others][:, at].toarray())
    coupling = E[others][:, at].toarray() + E_ee @ psi
    ports = [model.ports[k] for k in sources]
    ports += [Port(f"{name}_rate", THERMAL.port) for name in prescribed]
    B = np.hstack([model.B[np.ix_(others, sources)], coupling])
    inner = LinearModel(E=E_ee, K=K_ee, B=B, ports=tuple(ports))
    shares = model.B[np.ix_(at, sources)].T + model.B[np.ix_(others, sources)].T @ psi
    conductance = get_symmetric_part(K[at][:, at].toarray() + K[at][:, others] @ psi)
    if keeps_all_heat(K):
        # a uniform temperature of an isolated body causes no heat flow
        conductance[range(len(at)), range(len(at))] -= conductance.sum(axis=1)
    stored = E[at][:, at].toarray() + E[at][:, others] @ psi + psi.T @ coupling
    return SplitHeatModel(at, others, psi, shares, conductance, get_symmetric_part(stored), inner)


def remove_inactive_ports(model: LinearModel) -> LinearModel:
    """Return the model without its inactive ports, whose columns of B are zero."""
    live = np.flatnonzero(np.abs(model.B).max(axis=0) > 0)
    return model.select([model.ports[k].name for k in live])


def transform_to_modal_coordinates(model: LinearModel) -> tuple[LinearModel, np.ndarray]:
    """Transform a heat model to modal coordinates, so that K is the unit matrix.

    Return the transformed model, and the matrix (n, n) of the modes.
    """
    K, E = model.pencil.make_dense().coefficients
    times, shapes = scipy.linalg.eigh(get_symmetric_part(E), get_symmetric_part(K))
    modal = LinearModel(
        E=np.diag(np.maximum(times, 0.0)),
        K=np.eye(model.order),
        B=shapes.T @ model.B,
        ports=model.ports,
        facts=model.facts,
        name=model.name,
        band=model.band,
    )
    return modal, shapes


def get_symmetric_part(matrix: np.ndarray) -> np.ndarray:
    """Return the symmetric part of a matrix."""
    return np.asarray(0.5 * (matrix + matrix.T))
