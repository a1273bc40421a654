"""Reduction of heat models whose ports have given temperatures.

The unknowns of a model ``E T' + K T = B q`` are divided into temperatures ``T_i`` of ports that are
given, such as those of isothermal faces, and all others ``T_e``. With the static answers ``Psi`` to
the given temperatures,

    T_e = Psi T_i + x,    Psi = -K_ee^-1 K_ei,
    E_ee x' + K_ee x = B_e q - (E_ei + E_ee Psi) T_i'.

The second equation is a model of its own, with the ports q and T_i'. It is reduced by a congruence,
and its basis together with ``Psi`` is that of the whole model: E and K stay symmetric and positive
semi-definite, so that the model is passive, and the static answers to given temperatures are exact.
(R. R. Craig, M. C. C. Bampton, AIAA Journal 6 (1968) 1313, for structures.)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy
from scipy import sparse
from scipy.sparse.linalg import splu

from kc2spice.core.domains import THERMAL
from kc2spice.core.errors import UsageError, wrong
from kc2spice.core.naming import names_of
from kc2spice.rom.linear_model import LinearModel, Port
from kc2spice.rom.reduce import reduce_model

DENSE = 1500  # unknowns up to which the modes of a model are computed
ROUNDING = 1e-12  # sum of a row of conductances without a path to the ambient, relative


def reduce_with_interfaces(
    model: LinearModel,
    given: Sequence[str],
    parts: GivenTemperatures | None = None,
    **aims: Any,
) -> LinearModel:
    """Reduce a heat model whose ports ``given`` have given temperatures.

    Parameters
    ----------
    model : heat model with E and K; the column of B of each port that is given contains one 1.
    given : names of these ports.
    parts : the result of :func:`split_given` if it is known.
    aims : arguments of :func:`kc2spice.rom.reduce.reduce_model`.

    Returns
    -------
    LinearModel
        Model with the ports of ``model`` in their order. Its certificate is that of the second
        equation above.

    Raises
    ------
    UsageError : no congruence reduces the inner model.
    """
    if not given:
        return _reduce_definite(model, aims)
    parts = parts or split_given(model, given)
    small = _reduce_definite(select_live_ports(parts.inner), aims)
    if small.basis is None:
        raise no_congruence_error(model)
    n, at, others = len(parts.at), parts.at, parts.others
    V = np.zeros((model.order, n + small.order))
    V[others, :n], V[at, :n] = parts.psi, np.eye(n)
    V[others, n:] = small.basis
    K_small = np.zeros((V.shape[1],) * 2)
    K_small[:n, :n] = _symmetrise(parts.conductance)
    K, E = map(sparse.csc_array, model.pencil.coefficients)
    if keeps_all_heat(K):
        # one temperature everywhere moves no heat
        K_small[range(n), range(n)] -= K_small[:n, :n].sum(axis=1)
    K_small[n:, n:] = _symmetrise(small.basis.T @ (K[others][:, others] @ small.basis))
    E_small = _symmetrise(V.T @ (E @ V))
    return replace(
        LinearModel(E=E_small, K=K_small, B=V.T @ model.B, ports=model.ports),
        certificate=small.certificate,
        facts=model.facts,
        name=model.name,
        band=model.band,
        basis=V,
    )


def no_congruence_error(model: LinearModel) -> UsageError:
    """Return the error of a model of heat that no congruence reduces."""
    return wrong(
        model.name, "this heat model cannot be reduced to a tolerance", hint="set rom.order"
    )


def keeps_all_heat(K: sparse.csc_array) -> bool:
    """Whether one temperature of all unknowns moves no heat."""
    return bool(np.abs(K @ np.ones(K.shape[0])).max() < ROUNDING * np.abs(K.diagonal()).max())


@dataclass(frozen=True, eq=False)
class GivenTemperatures:
    """A heat model divided by its ports of given temperature.

    Attributes
    ----------
    at, others : unknowns that are given, and all others.
    psi : (others, at) static answers to the given temperatures.
    shares : (sources, at) static temperatures of the ports q for given temperatures.
    conductance : (at, at) [W/K] static heat flows into the ports of given temperature.
    inner : model of the second equation above, with the ports q and then T_i'.
    """

    at: np.ndarray
    others: np.ndarray
    psi: np.ndarray
    shares: np.ndarray
    conductance: np.ndarray
    inner: LinearModel


def split_given(model: LinearModel, given: Sequence[str]) -> GivenTemperatures:
    """Divide a heat model by its ports whose temperatures are ``given``."""
    K, E = map(sparse.csc_array, model.pencil.coefficients)
    names = names_of(model.ports)
    of_ports = [names.index(name) for name in given]
    at = model.B[:, of_ports].argmax(axis=0)
    others = np.setdiff1d(np.arange(model.order), at)
    sources = np.setdiff1d(np.arange(len(names)), of_ports)
    K_ee, E_ee = K[others][:, others], E[others][:, others]
    psi = np.zeros((len(others), 0))
    if len(at):
        psi = -splu(sparse.csc_array(K_ee)).solve(K[others][:, at].toarray())
    coupling = E[others][:, at].toarray() + E_ee @ psi
    ports = [model.ports[k] for k in sources]
    ports += [Port(f"{name}_rate", THERMAL.port) for name in given]
    B = np.hstack([model.B[np.ix_(others, sources)], coupling])
    inner = LinearModel(E=E_ee, K=K_ee, B=B, ports=tuple(ports))
    shares = model.B[np.ix_(at, sources)].T + model.B[np.ix_(others, sources)].T @ psi
    conductance = np.asarray(K[at][:, at].toarray() + K[at][:, others] @ psi)
    return GivenTemperatures(at, others, psi, shares, conductance, inner)


def select_live_ports(model: LinearModel) -> LinearModel:
    """Return the model without ports that act on no unknown."""
    live = np.flatnonzero(np.abs(model.B).max(axis=0) > 0)
    return model.select([model.ports[k].name for k in live])


def _reduce_definite(model: LinearModel, aims: Mapping[str, Any]) -> LinearModel:
    """Reduce a model whose K is positive definite.

    The rates of a small model may differ by 12 orders of magnitude. In the coordinates of its modes
    K is one, so that slow modes are not taken for heat that nothing leads away.
    """
    if model.order > DENSE:
        return reduce_model(model, **aims)
    modal, shapes = modal_coordinates(model)
    small = reduce_model(modal, **aims)
    return small if small.basis is None else replace(small, basis=shapes @ small.basis)


def modal_coordinates(model: LinearModel) -> tuple[LinearModel, np.ndarray]:
    """Return a heat model in the coordinates of its modes, in which K is one, and their shapes."""
    K, E = model.pencil.dense().coefficients
    times, shapes = scipy.linalg.eigh(_symmetrise(E), _symmetrise(K))
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


def _symmetrise(matrix: np.ndarray) -> np.ndarray:
    return np.asarray(0.5 * (matrix + matrix.T))
