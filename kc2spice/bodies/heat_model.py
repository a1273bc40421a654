"""Finite-element models of heat in solids, with pins for heat and temperatures.

The unknowns z are temperature rises above the ambient temperature. One unknown belongs to each free
node and to each isothermal face. If a film has a pin, the temperature of the fluid outside of the
film is also an unknown. The nodal temperature rises are ``T = P z``. Film f has the heat transfer
coefficient h_f. The matrix H_f contains the integrals of shape-function products over the faces of
film f. For interface i, r_i [m^2 K/W] is the product of thermal resistance and area, and J_i is the
matrix of temperature jumps. The matrices are assembled in :mod:`kc2spice.fem.heat_conduction`. The
equations of the model are::

    E z' + K z = B q,   y = B' z,
    E = P'E_solid P,    K = P'(K_solid + sum_f h_f H_f + sum_i J_i / r_i) P.

For each film with a pin, E and K also have a row and a column for the temperature of the fluid.

A heat source distributes its heat flow q evenly over a group of elements or facets. The temperature
at the pin of the source is the mean temperature of this group of elements or facets. E and K are
symmetric and positive semi-definite, so the model is passive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from kc2spice.core.errors import wrong
from kc2spice.core.mesh_error_descriptions import MESH_ERROR_PREFIX, MESH_LIMIT_NAME
from kc2spice.fem.heat_conduction import (
    HeatSolid,
    assemble_faces,
    assemble_heat,
    assemble_interface,
    list_local_functions,
)
from kc2spice.fem.solid import sum_matrices
from kc2spice.rom.linear_model import LinearModel, Port

HEAT_CAPACITY_NAME = "heat_capacity_j_per_k"  # name of the total heat capacity in `facts`
# Ratio of estimated error (from recovered heat flows) to true error of a thermal resistance.
# Comparison with much finer meshes yields the ratio 0.32 for uniform heat flow into a disc, and
# 0.42 for an isothermal disc.
RECOVERED_SHARE = 0.35
# the key of a port's thermal resistance is RESISTANCE_PREFIX + PORT + "_k_per_w"
RESISTANCE_PREFIX = "thermal_resistance_"
MIN_STATED_ERROR = 1e-6  # smallest relative mesh error that a model states


@dataclass(frozen=True, eq=False)
class HeatFilm:
    """Heat film: faces of a solid that transfer heat to a fluid.

    The heat flow per area is the ``coefficient`` [W/(m^2 K)] times the temperature difference
    between face and fluid. The fluid has the temperature of the ``port``, or the ambient
    temperature if there is no port.
    """

    facets: np.ndarray
    coefficient: float
    port: Port | None = None


@dataclass(frozen=True, eq=False)
class HeatBoundaryConditions:
    """Thermal boundary conditions and ports of a solid.

    Attributes
    ----------
    fixed : nodes at the ambient temperature.
    isothermal : port and nodes of each isothermal face.
    sources : port of each heat source, and the share (nodes,) of its heat flow at each node.
    films : faces that transfer heat to a fluid.
    interfaces : inner faces and their thermal resistance times area [m^2 K/W].
    points : names of the heat sources at a single point. The thermal resistance of a point source
        grows without bound as the mesh is refined.
    """

    fixed: np.ndarray = field(default_factory=lambda: np.empty(0, int))
    isothermal: Sequence[tuple[Port, np.ndarray]] = ()
    sources: Sequence[tuple[Port, np.ndarray]] = ()
    films: Sequence[HeatFilm] = ()
    interfaces: Sequence[tuple[np.ndarray, float]] = ()
    points: frozenset[str] = frozenset()


@dataclass(frozen=True, eq=False)
class HeatModel:
    """Linear finite-element model of heat conduction in a solid.

    The temperature rises at the nodes are ``temperature @ z`` for the unknowns z of the model.
    """

    model: LinearModel
    solid: HeatSolid
    temperature: sparse.csc_array


def make_heat_model(solid: HeatSolid, setup: HeatBoundaryConditions) -> HeatModel:
    """Make the thermal model of a solid, and compute its thermal resistances.

    The characteristic value ``thermal_resistance_PORT_k_per_w`` is the temperature rise of a port
    while 1 W flows into this port and no heat flows into other ports.

    Raises
    ------
    UsageError : an isothermal face has nodes in common with another isothermal face, or with a face
        at the ambient temperature.
    """
    E, K = assemble_heat(solid)
    capacity = float(E.sum())
    for film in setup.films:
        K = K + film.coefficient * assemble_faces(solid, film.facets)
    for facets, resistance in setup.interfaces:
        K = K + assemble_interface(solid, facets) / resistance
    P = _constrain_temperatures(solid, setup)
    E, K = (sparse.csc_array(P.T @ matrix @ P) for matrix in (E, K))
    ports = [port for port, _ in setup.isothermal]
    columns = list(np.eye(P.shape[1])[P.shape[1] - len(ports) :])
    for port, shares in setup.sources:
        ports.append(port)
        columns.append(P.T @ shares)
    B = np.array(columns).reshape(len(ports), P.shape[1]).T
    for film in setup.films:
        if film.port is not None:
            E, K, B = _add_film_pin(E, K, B, P, solid, film)
            P = sparse.hstack([P, sparse.csc_array((P.shape[0], 1))], format="csc")
            ports.append(film.port)
    temperature = sparse.csc_array(P)
    facts = {"unknowns": float(P.shape[1]), HEAT_CAPACITY_NAME: capacity}
    facts[MESH_LIMIT_NAME] = _find_highest_frequency(solid)
    if _has_thermal_path(setup):
        answers = splu(K).solve(B)
        resistances = np.einsum("np,np->p", B, answers)
        spread = np.array([port.name not in setup.points for port in ports], dtype=bool)
        for port, resistance in zip(ports, resistances, strict=True):
            if port.name not in setup.points:
                facts[_get_resistance_key(port)] = float(resistance)
        energies = estimate_energy_errors(solid, temperature @ answers[:, spread])
        errors = energies / resistances[spread] / RECOVERED_SHARE
        facts[f"{MESH_ERROR_PREFIX}resistance"] = float(
            max(errors.max(initial=0.0), MIN_STATED_ERROR)
        )
    model = LinearModel(E=E, K=K, B=B, ports=tuple(ports), facts=facts)
    return HeatModel(model, solid, temperature)


def _get_resistance_key(port: Port) -> str:
    """Return the key of a port's thermal resistance in the ``facts`` of a model."""
    return f"{RESISTANCE_PREFIX}{port.name}_k_per_w"


def compute_static_resistances(model: LinearModel) -> dict[str, float]:
    """Return the static thermal resistance [K/W] of each heat port.

    The thermal resistance is the temperature rise of the port for a heat flow of 1 W into this
    port. The returned mapping is keyed by the names ``thermal_resistance_PORT_k_per_w``.
    """
    response = model.transfer(np.zeros(1))[0].real
    pairs = zip(model.ports, np.diag(response), strict=True)
    return {_get_resistance_key(port): float(value) for port, value in pairs}


def _find_highest_frequency(solid: HeatSolid) -> float:
    """Return the highest frequency [Hz] of heat flows that the mesh resolves.

    A temperature that varies like ``sin(pi x / h)`` in an element of the size h decays at the rate
    ``k pi^2 / (rho c h^2)``. The highest resolved frequency is the decay rate in the smallest
    element, divided by ``2 pi``.
    """
    mesh, result = solid.geometry.mesh, 0.0
    basis = solid.geometry.basis(1)
    sizes = np.asarray(basis.dx).sum(axis=1) ** (1 / mesh.dim())
    for number, material in enumerate(solid.materials):
        element_sizes = sizes[solid.geometry.owner == number]
        if element_sizes.size:
            diffusivity = material.conductivity.max() / material.capacity
            result = max(result, float(np.pi * diffusivity / (2 * element_sizes.min() ** 2)))
    return result


def _constrain_temperatures(solid: HeatSolid, setup: HeatBoundaryConditions) -> sparse.csc_array:
    """Return the matrix ``P`` that maps free unknowns z to temperatures ``T = P z``.

    The unknowns of the model are z. The matrix ``P`` has one row for each node. The first columns
    of ``P`` are for the free nodes, and the last columns for the isothermal faces.
    """
    constraint_count = np.zeros(solid.node_count, int)
    constraint_count[setup.fixed] = 1
    for port, nodes in setup.isothermal:
        if constraint_count[nodes].any():
            raise wrong(
                f"isothermal.{port.name}",
                "this face has common nodes with another face of prescribed temperature",
                hint="choose groups of faces without common nodes",
            )
        constraint_count[nodes] = 1
    blocks = [
        sparse.eye_array(solid.node_count, format="csc")[:, np.flatnonzero(constraint_count == 0)]
    ]
    for _, nodes in setup.isothermal:
        column = np.zeros((solid.node_count, 1))
        column[nodes] = 1.0
        blocks.append(sparse.csc_array(column))
    return sparse.csc_array(sparse.hstack(blocks, format="csc"))


def _add_film_pin(
    E: sparse.csc_array,
    K: sparse.csc_array,
    B: np.ndarray,
    P: sparse.csc_array,
    solid: HeatSolid,
    film: HeatFilm,
) -> tuple[sparse.csc_array, sparse.csc_array, np.ndarray]:
    """Add the fluid temperature outside a heat film as an unknown with a pin.

    The heat flow through the film is ``h int (T - a) dA`` with the fluid temperature a. Return the
    matrices E, K and B with the new unknown.
    """
    H = film.coefficient * assemble_faces(solid, film.facets)
    load = np.zeros(len(B))
    nodal = P.T @ H.sum(axis=1)
    load[: nodal.size] = nodal
    column = sparse.csc_array(-load[:, None])
    K = sparse.block_array([[K, column], [column.T, np.array([[H.sum()]])]], format="csc")
    E = sparse.block_diag([E, np.zeros((1, 1))], format="csc")
    B = np.block([[B, np.zeros((len(B), 1))], [np.zeros((1, B.shape[1])), np.ones((1, 1))]])
    return sparse.csc_array(E), sparse.csc_array(K), B


def _has_thermal_path(setup: HeatBoundaryConditions) -> bool:
    """Return whether the body has a thermal path to the ambient temperature."""
    return bool(setup.fixed.size) or any(film.port is None for film in setup.films)


def estimate_energy_errors(solid: HeatSolid, temperatures: np.ndarray) -> np.ndarray:
    """Estimate mesh errors of ``T'K T`` (nodal temperatures T, conductance matrix K).

    ``temperatures`` have the shape (nodes, columns); the estimates have the shape (columns,). The
    heat flow density ``q = -k grad T`` jumps between elements. ``q*`` is the projection of q on
    functions that are continuous in each material. The integral ``int (q* - q) . k^-1 (q* - q)``
    estimates the error of ``T'K T``, and therefore the error of a thermal resistance. Source: O. C.
    Zienkiewicz, J. Z. Zhu, Int. J. Numer. Methods Eng. 24 (1987) 337.
    """
    result = np.zeros(temperatures.shape[1])
    for number, material in enumerate(solid.materials):
        cells = np.flatnonzero(solid.geometry.owner == number)
        if not cells.size:
            continue
        basis = solid.geometry.basis(elements=cells)
        nodes, weights = basis.element_dofs.T, solid.compute_weights(basis, cells)
        active, local = np.unique(nodes, return_inverse=True)
        local = local.reshape(nodes.shape)
        axes = solid.geometry.axis_indices
        k = material.conductivity[axes][None, :, None]
        points = list(list_local_functions(basis))
        mass = np.zeros(())
        loads = np.zeros((active.size, len(axes), temperatures.shape[1]))
        fluxes = [-k * (G @ temperatures[nodes]) for _, G in points]
        for (N, _), q, w in zip(points, fluxes, weights.T, strict=True):
            mass = mass + w[:, None, None] * N[:, :, None] * N[:, None]
            np.add.at(loads, local, (w[:, None] * N)[:, :, None, None] * q[:, None])
        factor = splu(sum_matrices([(mass, local, local)], (active.size, active.size)))
        smooth = factor.solve(loads.reshape(active.size, -1)).reshape(loads.shape)
        for (N, _), q, w in zip(points, fluxes, weights.T, strict=True):
            jump = np.einsum("el,eldc->edc", N, smooth[local]) - q
            result += np.einsum("e,edc->c", w, jump**2 / k)
    return result
