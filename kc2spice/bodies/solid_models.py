"""Finite-element models of solids with supports, electrodes and ports.

Supports, rigid faces and electrodes are represented by a choice of independent unknowns. The
displacements are ``u = P z``, where z contains the free displacements and the six motions of each
rigid face. The potentials are ``phi = Q p + R V``, where p contains the free potentials, and V the
voltages of driven electrodes. Each floating electrode has one free potential. The loads f of the
ports are distributed over the nodes by the matrix S. M is the mass matrix, and K_uu, K_up and K_pp
are the blocks of the stiffness matrix. The equations are

    P'MP z'' + P'K_uu P z + P'K_up Q p + P'K_up R V = P'S f
                     Q'K_up'P z - Q'K_pp Q p - Q'K_pp R V = 0
        charge = R'K_pp R V + R'K_pp Q p - R'K_up'P z,        y = S'P z,

where y are the outputs of the ports. :func:`kc2spice.rom.linear_model.make_piezoelectric_model`
eliminates p exactly from these equations.

:class:`BondedBlocks` are blocks that are bonded where they touch: layers, rings, beams. The edges
of blocks are parallel to the axes; in a body of revolution, blocks are rectangles in the plane
(radius, height). All blocks are meshed by one grid of quadratic quadrilaterals or hexahedra. Every
edge of a block, an electrode, a support or a port is a line of the grid. Only piezoelectric blocks
have a potential. Conductors and electrodes are equipotentials. The model neglects the electric
field in insulators that are not piezoelectric (:mod:`kc2spice.fem.solid`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain, pairwise
from operator import attrgetter, itemgetter
from typing import TypeAlias

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from skfem.mesh import MeshHex, MeshQuad

from kc2spice.bodies.mesh_error_estimate import estimate_mesh_errors
from kc2spice.bodies.undamped_models import FiniteElementModel, compute_undamped_responses
from kc2spice.core.domains import ACCELERATION, ACOUSTIC, BASE, ELECTRICAL, TRANSLATION
from kc2spice.core.errors import UsageError, name_part_in_errors, wrong
from kc2spice.core.mesh_error_descriptions import MESH_LIMIT_NAME
from kc2spice.core.progress import StepTimer
from kc2spice.fem.body_keys import DampingKeys
from kc2spice.fem.materials import Material
from kc2spice.fem.solid import (
    Solid,
    assemble_solid,
    compute_area,
    compute_node_shares,
    compute_volume_gradient,
    find_mesh_frequency_limit,
)
from kc2spice.linalg.factor import require_memory_for_factors
from kc2spice.rom.linear_model import LinearModel, Port, make_piezoelectric_model
from kc2spice.rom.pencil import SchurComplement

# sqrt(shift) of an unsupported body, relative to its slowest wave speed divided by its size
FREE_SHIFT_RATIO = 1e-3
UP = np.array([0.0, 0.0, 1.0])
# Steps of the computation for supported and for unsupported bodies, and their relative times.
# The computation times were measured for piezoelectric blocks with 10 000 and 29 000 unknowns.
SUPPORTED_STEPS = ("assembly", 1.0), ("static responses and resonances", 2.6), ("mesh error", 3.8)
FREE_STEPS = ("assembly", 1.0), ("static responses and resonances", 11.0), ("mesh error", 6.6)


@dataclass(frozen=True, eq=False)
class PortLoad:
    """Unit load of a force or pressure port: the port and the nodal forces.

    ``weights`` (d * nodes,) contains the nodal forces of a unit load, with d components per node.
    ``facets`` are the facets on which a pressure acts.
    """

    port: Port
    weights: np.ndarray
    facets: np.ndarray | None = None


def make_pressure_load(port: Port, solid: Solid, facets: np.ndarray) -> PortLoad:
    """Return a pressure port with the nodal forces of a unit pressure on the facets.

    The pressure p acts against the outward normal n: the nodal forces are ``-p int N n dS`` with
    the shape functions N. The output of the port is the displaced volume ``-int u n dS``.
    """
    return PortLoad(port, -compute_volume_gradient(solid, facets), facets)


def get_area_key(port: str) -> str:
    """Return the key of an acoustic port's area [m^2] in the ``facts`` of a model."""
    return f"area_{port}_m2"


@dataclass(frozen=True, eq=False)
class RigidFace:
    """Face that moves as a rigid body, with ports for its motions.

    ``ports`` contains pairs of a port and the motion that the port represents. The motions of a
    rigid face are three translations (ux, uy, uz) and three rotations (rx, ry, rz). The rotations
    are about the mean position of the face's nodes.
    """

    nodes: np.ndarray
    ports: Sequence[tuple[Port, np.ndarray]]


@dataclass(frozen=True, eq=False)
class BoundaryConditions:
    """Boundary conditions of a solid: supports, electrodes, ports and added masses.

    Attributes
    ----------
    fixed : mask (d * nodes,) of the displacements that are zero, with d components per node.
    electrodes : nodes of each electrode, keyed by its pin; all voltages are relative to the pin
        ``reference``.
    floating : nodes of each floating electrode; such an electrode has one potential, no net charge
        and no pin.
    shapes : ports of forces and pressures, with their nodal loads.
    faces : rigid faces with ports of forces and moments.
    base : ports of base acceleration, and the direction (3,) of each port.
    graded : nodes whose potential is a fraction of the voltage at the first pin, and the fraction
        of each node. Nodes have fractions of the voltage if planes of electrodes lie inside
        elements.
    lumped : additional mass [kg] at each node, an array of shape (nodes,).
    springs : additional stiffness matrix [N/m] of shape (d * nodes, d * nodes), with d
        displacements per node.
    sectors : number of equal solids that move identically. Only one of the equal solids is meshed,
        and the model represents all of the equal solids.
    damping : damping of the solid.
    """

    fixed: np.ndarray
    electrodes: Mapping[str, np.ndarray] = field(default_factory=dict)
    reference: str = ""
    floating: Sequence[np.ndarray] = ()
    shapes: Sequence[PortLoad] = ()
    faces: Sequence[RigidFace] = ()
    base: Sequence[tuple[Port, np.ndarray]] = ()
    graded: tuple[np.ndarray, np.ndarray] | None = None
    lumped: np.ndarray | None = None
    springs: sparse.csc_array | None = None
    sectors: int = 1
    damping: DampingKeys = field(default_factory=DampingKeys)

    @property
    def driven_electrodes(self) -> dict[str, np.ndarray]:
        """Nodes of each electrode with an independent voltage, keyed by pin."""
        return {pin: n for pin, n in self.electrodes.items() if pin != self.reference}


def make_damped_model(solid: Solid, setup: BoundaryConditions) -> FiniteElementModel:
    """Make the damped model of a solid, and compute its modes and static responses.

    The model has the supports and ports of the boundary conditions.

    Raises
    ------
    UsageError : electrodes or rigid faces touch each other, a material lacks the Q factor that
        damping per material needs, or the mesh needs more memory than is free.
    """
    timer = StepTimer()
    bare, volts = make_undamped_model(solid, setup), _estimate_depoling_voltage(solid, setup)
    steps = FREE_STEPS if bare.shift else SUPPORTED_STEPS
    timer.begin_step(1, steps)
    unknowns = bare.displacement.shape[1] + bare.potential.shape[1]
    facts = {"unknowns": unknowns, "mass_kg": bare.mass}
    facts[MESH_LIMIT_NAME] = find_mesh_frequency_limit(solid)
    facts |= {} if volts is None else {"depoling_voltage_v": volts}
    facts |= _compute_loss_tangents(bare, setup)
    facts |= {
        get_area_key(port): compute_area(solid, facets) for port, facets in bare.faces.items()
    }
    pencil = bare.model.pencil
    definite = pencil.is_large or not (bare.shift or isinstance(bare.model.K, SchurComplement))
    require_memory_for_factors(
        pencil.assemble_bordered_matrix(1.0, 0.0, 0.0), definite=definite, where="mesh"
    )
    answers = compute_undamped_responses(bare.model, bare.shift)
    timer.begin_step(2, steps)
    facts |= answers.facts | estimate_mesh_errors(bare, answers, setup.sectors)
    model = bare.model.copy_with(facts=facts)
    return replace(bare, model=_add_damping(model, solid, bare.displacement, setup))


def make_undamped_model(solid: Solid, setup: BoundaryConditions) -> FiniteElementModel:
    """Make the undamped model of a solid with its constraints and ports.

    Modes, static responses and mesh errors of the solid are not computed.
    """
    full = assemble_solid(solid)
    P, motions = _constrain_displacements(solid, setup)
    Q, R, pins = _constrain_potentials(full.K_pp, setup)
    mass, K_uu = full.M, full.K_uu
    if setup.lumped is not None:
        mass = mass + sparse.diags_array(
            np.repeat(setup.lumped, solid.component_count), format="csc"
        )
    if setup.springs is not None:
        K_uu = K_uu + setup.springs
    n = float(setup.sectors)
    mass, K_uu, K_up, K_pp = n * mass, n * K_uu, n * full.K_up, n * full.K_pp
    columns: list[tuple[Port, np.ndarray]] = [(s.port, P.T @ s.weights) for s in setup.shapes]
    columns += motions
    columns += [
        (port, -(P.T @ (mass @ compute_rigid_translation(solid, a)))) for port, a in setup.base
    ]
    model = make_piezoelectric_model(
        M=sparse.csc_array(P.T @ mass @ P),
        K_uu=sparse.csc_array(P.T @ K_uu @ P),
        K_up=P.T @ K_up @ Q,
        K_pp=Q.T @ K_pp @ Q,
        k_uV=(P.T @ K_up @ R).toarray(),
        k_pV=(Q.T @ K_pp @ R).toarray(),
        c_VV=(R.T @ K_pp @ R).toarray(),
        B=np.array([*map(itemgetter(1), columns)]).reshape(len(columns), P.shape[1]).T,
        ports=[*map(itemgetter(0), columns), *pins],
    )
    return FiniteElementModel(
        model,
        solid,
        P,
        sparse.csc_array(Q),
        sparse.csc_array(R),
        -(Q.T @ K_pp @ R).toarray(),
        _choose_shift(solid, setup),
        float(mass.sum()) / solid.component_count,
        {s.port.name: s.facets for s in setup.shapes if s.facets is not None},
    )


def _estimate_depoling_voltage(solid: Solid, setup: BoundaryConditions) -> float | None:
    """Estimate the voltage [V] that depolarises a ceramic of the solid.

    At the returned voltage, the mean electric field along the shortest line from a driven electrode
    to the reference electrode equals the lowest depoling field of the materials. At the edge of an
    electrode, a lower voltage may depolarise the ceramic. Return None if the depoling field of a
    material is unknown.
    """
    limits = [m.depoling_field for m in solid.materials if m.is_piezoelectric]
    if not setup.driven_electrodes or not limits or None in limits:
        return None
    places = solid.node_positions.T
    from scipy.spatial import cKDTree  # scipy.spatial is imported here, because few bodies need it

    near = cKDTree(places[setup.electrodes[setup.reference]])
    distances, _ = near.query(places[np.concatenate([*setup.driven_electrodes.values()])])
    return float(np.array(limits, dtype=float).min() * distances.min())


def get_loss_tangent_key(port: str) -> str:
    """Return the key of an electrode's dielectric loss tangent in the ``facts`` of a model."""
    return f"{port}_loss_tangent"


def _compute_loss_tangents(bare: FiniteElementModel, setup: BoundaryConditions) -> dict[str, float]:
    """Compute the loss tangent of each electrode from the loss tangents of the materials.

    The loss tangent of an electrode is the mean of the loss tangents of the materials, weighted by
    the energy of their electric fields while the body is clamped. The electrode has a voltage, and
    all other electrodes are shorted. A material without a loss tangent counts as lossless. The
    result is empty if the keys of the body do not select losses per material, or if they state the
    loss tangent of the whole body.
    """
    solid, ports = bare.solid, [*setup.driven_electrodes]
    if not setup.damping.uses_material_tangents or not ports:
        return {}
    tangents = {
        number: material.loss_tangent or 0.0
        for number, material in enumerate(solid.materials)
        if material.is_piezoelectric or material.dielectric
    }
    if not any(tangents.values()):
        return {}
    if len({*tangents.values()}) == 1:
        return dict.fromkeys(map(get_loss_tangent_key, ports), max(tangents.values()))
    count = len(ports)
    _, phi = bare.compute_nodal_values(np.zeros((bare.model.order, count)), np.eye(count))
    matrices = {number: assemble_solid(solid, only=number).K_pp for number in tangents}
    energies = {number: np.sum(phi * (K_pp @ phi), axis=0) for number, K_pp in matrices.items()}
    losses = np.sum([tangents[number] * energy for number, energy in energies.items()], axis=0)
    means = losses / np.sum([*energies.values()], axis=0)
    return {get_loss_tangent_key(port): float(x) for port, x in zip(ports, means, strict=True)}


def add_rayleigh_damping(model: LinearModel, damping: DampingKeys) -> LinearModel:
    """Add Rayleigh damping to a model, with the same factors for all materials.

    Raises
    ------
    UsageError : the damping ratio applies at the first resonance, but the model has no resonance.
    """
    first = _find_damping_frequency(model, damping)
    rayleigh = damping.compute_rayleigh_factors(first) if first else (damping.alpha, 0.0)
    return model.copy_with(E=None, rayleigh=rayleigh)


def _find_damping_frequency(model: LinearModel, damping: DampingKeys) -> float | None:
    """Return the frequency [Hz] at which the given damping ratio or Q factor applies."""
    facts = model.facts
    first = damping.find_ratio_frequency(facts.get("resonance_short_hz", facts.get("resonance_hz")))
    if first is None and (damping.zeta or damping.per_material):
        raise UsageError(
            "the body has no resonance, so its damping needs a frequency",
            where="damping.at",
            expected="the frequency at which the damping ratio or the Q factor applies",
            hint='add  at = "10 kHz"  to the damping of this body',
        )
    return first


def _add_damping(
    model: LinearModel, solid: Solid, P: sparse.csc_array, setup: BoundaryConditions
) -> LinearModel:
    """Add Rayleigh damping to a model, or damping by the Q factor of each material."""
    damping = setup.damping
    if not damping.per_material:
        return add_rayleigh_damping(model, damping)
    first = _find_damping_frequency(model, damping)
    assert first is not None
    loss = []
    for material in solid.materials:
        if material.quality is None:
            raise wrong(
                "damping.per_material",
                "this material has no Q factor",
                got=material.name,
                expected="a Q factor for every material",
                hint="add  quality = VALUE  to the table of this material",
            )
        loss.append(1 / (material.quality * 2 * np.pi * first))

    def assemble_damping_term(beta: float, material: int | None = None) -> sparse.csc_array:
        """Return the damping matrix of one ``material``, or of all materials if None.

        The damping matrix is ``beta`` [s] times the stiffness matrix.
        """
        K_uu = assemble_solid(solid, only=material).K_uu
        return beta * (P.T @ (setup.sectors * K_uu) @ P)

    # The first damping term damps the whole body with the smallest factor beta of all materials.
    # A further damping term for each material adds the excess of its beta over the smallest beta.
    # With this choice of the first term, E and K have the same rounding errors in the first mode.
    least = min(loss)
    E = damping.alpha * model.M + assemble_damping_term(least)
    for number, beta in enumerate(loss):
        if beta > least:
            E = E + assemble_damping_term(beta - least, number)
    return model.copy_with(E=sparse.csc_array(E), rayleigh=None)


def spread_force(shares: np.ndarray, axis: np.ndarray, solid: Solid) -> np.ndarray:
    """Spread a unit force along ``axis`` over nodes; ``shares`` are their fractions.

    The returned array has the shape (d * nodes,), with d force components per node. ``shares`` is
    the share of the force at each node, an array of shape (nodes,).
    """
    return np.outer(shares, axis[solid.axis_indices]).ravel()


def compute_rigid_translation(solid: Solid, axis: np.ndarray) -> np.ndarray:
    """Return the nodal displacements of a rigid translation by the vector ``axis``.

    The returned array has the shape (d * nodes,), with d displacements per node.
    """
    return spread_force(np.ones(solid.node_positions.shape[1]), np.asarray(axis, float), solid)


def compute_rigid_body_modes(solid: Solid, centre: np.ndarray) -> np.ndarray:
    """Return the nodal displacements of three translations and three rotations.

    The rotations are about ``centre``. The returned array has the shape (d * nodes, 6), with d
    displacements per node. For a body of revolution, the array has only one column, for the
    translation along the axis.
    """
    if solid.axisymmetric:
        return compute_rigid_translation(solid, UP)[:, None]
    arm = solid.node_positions.T - centre
    turns = np.cross(np.eye(3)[:, None], arm[None])  # shape: (axes of rotation, nodes, components)
    moves = np.broadcast_to(np.eye(3)[:, None], turns.shape)
    return np.concatenate([moves, turns]).reshape(6, -1).T


def _constrain_displacements(
    solid: Solid, setup: BoundaryConditions
) -> tuple[sparse.csc_array, list[tuple[Port, np.ndarray]]]:
    """Return the map from unknowns to displacements, and the loads of rigid faces.

    The map is the matrix ``P`` of ``u = P z``. Each load is a pair: a port of a rigid face, and the
    load vector of this port. A load vector has the shape (unknowns,).
    """
    d, free = solid.component_count, ~setup.fixed
    where = solid.node_positions.T
    blocks = []
    for face in setup.faces:
        rows = (d * face.nodes[:, None] + np.arange(d)).ravel()
        if not free[rows].all():
            raise wrong(
                ", ".join(port.name for port, _ in face.ports),
                "a rigid face touches a support or another rigid face",
                hint="choose a face whose nodes are neither clamped nor on another rigid face",
            )
        free[rows] = False
        motion = np.zeros((len(free), 6))
        motion[rows] = compute_rigid_body_modes(solid, where[face.nodes].mean(axis=0))[rows]
        blocks.append(sparse.csc_array(motion))
    identity = sparse.eye_array(len(free), format="csc")[:, np.flatnonzero(free)]
    P = sparse.hstack([identity, *blocks], format="csc")
    columns = []
    for number, face in enumerate(setup.faces):
        for port, motion in face.ports:
            z = np.zeros(P.shape[1])
            z[free.sum() + 6 * number + np.arange(6)] = motion
            columns.append((port, z))
    return P, columns


def _constrain_potentials(
    K_pp: sparse.csc_array, setup: BoundaryConditions
) -> tuple[sparse.csc_array, sparse.csc_array, list[Port]]:
    """Return the matrices that constrain all potentials, and the electrical ports.

    The matrices ``Q`` and ``R`` map unknowns p and voltages V to potentials, ``phi = Q p + R V``.
    """
    live = K_pp.diagonal() > 0
    times_driven = np.zeros(len(live), int)
    for nodes in (*setup.electrodes.values(), *setup.floating):
        times_driven[nodes[live[nodes]]] += 1
    if times_driven.max(initial=0) > 1:
        common = np.flatnonzero(times_driven > 1)
        pins = [pin for pin, nodes in setup.electrodes.items() if np.isin(common, nodes).any()]
        raise wrong(
            "electrodes",
            "two electrodes have common nodes",
            got=f"{len(common)} common nodes of {', '.join(pins)}",
            expected="a gap between any two electrodes",
            hint=(
                "choose groups of faces without common nodes, or one pin for all: PIN = "
                "[GROUP, GROUP]"
            ),
        )
    if setup.graded is not None:
        times_driven[setup.graded[0]] += 1
    _, piece = connected_components(K_pp, directed=False)
    if np.setdiff1d(piece[live], piece[times_driven > 0]).size:
        raise wrong(
            "electrodes",
            "a piezoelectric solid touches no electrode, so its potential is undetermined",
            hint="add an electrode on a face of each piezoelectric solid",
        )

    def make_nodal_column(nodes: np.ndarray, values: float | np.ndarray = 1.0) -> sparse.csc_array:
        """Return a column vector with ``values`` at the ``nodes`` and zeros elsewhere."""
        column = np.zeros(len(live))
        column[nodes] = values
        return sparse.csc_array((column * live)[:, None])

    free = np.flatnonzero(live & (times_driven == 0))
    identity = sparse.eye_array(len(live), format="csc")
    Q = sparse.hstack([identity[:, free], *map(make_nodal_column, setup.floating)], "csc")
    none = sparse.csc_array((len(live), 0))
    columns = [*map(make_nodal_column, setup.driven_electrodes.values())]
    if setup.graded is not None:
        columns[0] = columns[0] + make_nodal_column(*setup.graded)
    R = sparse.hstack([none, *columns], "csc")
    ports = [Port(p, ELECTRICAL.port, pins=(p, setup.reference)) for p in setup.driven_electrodes]
    return Q, R, ports


def _choose_shift(solid: Solid, setup: BoundaryConditions) -> float:
    """Choose a shift [rad^2/s^2] that makes ``K + shift M`` regular.

    The shift is 0 for a supported body.
    """
    constrained = (
        setup.fixed if setup.springs is None else setup.fixed | (setup.springs.diagonal() > 0)
    )
    if _is_supported(solid, constrained, _find_pieces(solid, setup)):
        return 0.0
    slowest = min(material.slowest_wave_speed for material in solid.materials)
    size = np.linalg.norm(np.ptp(solid.mesh.p, axis=1))
    return float((FREE_SHIFT_RATIO * slowest / size) ** 2)


def _find_pieces(solid: Solid, setup: BoundaryConditions) -> list[np.ndarray]:
    """Find the nodes of each piece that can move independently of the other pieces.

    A piece is a rigid face, or a set of elements that are joined through common faces. Elements
    that share only an edge belong to different pieces, because they can rotate about the edge.
    """
    first, second = solid.mesh.f2t[:, solid.mesh.f2t[1] >= 0]
    n = solid.mesh.nelements
    links = sparse.coo_array((np.ones(first.size), (first, second)), shape=(n, n))
    count, label = connected_components(links, directed=False)
    nodes = solid.basis(1).element_dofs
    pieces = [np.unique(nodes[:, label == piece]) for piece in range(count)]
    return [*pieces, *map(attrgetter("nodes"), setup.faces)]


def _is_supported(solid: Solid, fixed: np.ndarray, pieces: Sequence[np.ndarray]) -> bool:
    """Return whether the ``fixed`` displacements prevent all rigid-body modes.

    ``fixed`` is a mask of shape (d * nodes,), with d displacements per node. ``pieces`` contains
    the nodes of each piece. A supported piece also supports other pieces at their common nodes.
    """
    constrained, waiting = fixed.copy(), list(pieces)
    while waiting:
        free = []
        for nodes in waiting:
            rows = (
                solid.component_count * nodes[:, None] + np.arange(solid.component_count)
            ).ravel()
            motions = compute_rigid_body_modes(solid, solid.node_positions[:, nodes].mean(axis=1))[
                rows
            ]
            motions = motions / np.maximum(np.abs(motions).max(axis=0), 1e-300)
            if np.linalg.matrix_rank(motions[constrained[rows]], tol=1e-6) < motions.shape[1]:
                free.append(nodes)
            else:
                constrained[rows] = True
        if len(free) == len(waiting):
            return False
        waiting = free
    return True


# names of the ports of the pressure above and below a body
FRONT_FACE, BACK_FACE = "front_face", "back_face"
# Lower and upper end [m] of a box along each axis.
# A box with equal ends along one, two or all axes is a face, an edge or a point.
Box: TypeAlias = tuple[tuple[float, float], ...]


@dataclass(frozen=True)
class RadiatingFace:
    """Face of a body that radiates sound, either upwards or downwards.

    The radiating face consists of the elements' outer faces in ``box``. The outward normals of
    these outer faces point up if ``upward`` is true, otherwise down.
    """

    box: Box
    upward: bool


@dataclass(frozen=True)
class Block:
    """Box that consists of one poled material.

    Reports treat materials of the same name as one material.
    """

    box: Box
    material: Material

    @property
    def thickness(self) -> float:
        """Size of the block along the last axis [m]."""
        low, high = self.box[-1]
        return high - low


@dataclass(frozen=True, eq=False)
class BondedBlocks:
    """Body of blocks bonded where they touch, with electrodes, ports and supports.

    Attributes
    ----------
    blocks : blocks of material; a later block replaces an earlier block where they overlap.
    electrodes : faces that form the electrode of each pin; voltages are relative to the pin
        ``cathode``.
    floating : faces that form each floating electrode; such an electrode has no pin and no net
        charge.
    ports : face or point of each mechanical port. The force of the port is uniform over the face,
        and the output is the mean upward displacement.
    fixed : axes along which displacements are fixed, such as ``"xz"``, and the box in which they
        are fixed; in a body of revolution, x is the radius.
    masses : masses [kg], and the face over which each mass is distributed.
    faces : parts of the surface on which the pressure of each acoustic port acts.
    moved : whether the model has the port ``base``, the upward acceleration of the support.
    grid : positions [m] of the grid lines along each axis; by default, the grid follows from
        ``size`` and ``refine``.
    size : largest size [m] of a cell before ``refine`` is applied.
    refine : number of parts into which each cell is divided along each axis.
    like : body of the same blocks with other sizes; its mesh is reused with displaced nodes.
    damping : damping of the body.
    where : name of the part for error messages.
    """

    blocks: Sequence[Block]
    electrodes: Mapping[str, Sequence[Box]] = field(default_factory=dict)
    floating: Sequence[Sequence[Box]] = ()
    ports: Mapping[str, Box] = field(default_factory=dict)
    fixed: Sequence[tuple[str, Box]] = ()
    masses: Sequence[tuple[float, Box]] = ()
    faces: Mapping[str, RadiatingFace] = field(default_factory=dict)
    moved: bool = False
    grid: Sequence[np.ndarray] = ()
    size: float = np.inf
    refine: int = 1
    like: BondedBlocks | None = None
    damping: DampingKeys = field(default_factory=DampingKeys)
    where: str = "body"

    @property
    def all_ports(self) -> tuple[Port, ...]:
        """Ports of the model, electrical ports first."""
        ports = []
        for pin in self.electrodes:
            if pin != "cathode":
                ports.append(Port(pin, ELECTRICAL.port, pins=(pin, "cathode")))
        for name in self.ports:
            ports.append(Port(name, TRANSLATION.port))
        if self.moved:
            ports.append(Port(BASE, ACCELERATION.port))
        for name in self.faces:
            ports.append(Port(name, ACOUSTIC.port))
        return tuple(ports)

    @property
    def depoling_voltage(self) -> float | None:
        """Voltage [V] at which a ceramic reaches its depoling field; None if unknown.

        If there are floating electrodes between the ceramics, all ceramics have the same electric
        field.
        """
        limits, thicknesses = [], []
        for block in self.blocks:
            if block.material.is_piezoelectric:
                limits.append(block.material.depoling_field)
                thicknesses.append(block.thickness)
        if not limits or None in limits:
            return None
        fields, thick = np.array(limits, dtype=float), np.array(thicknesses)
        return float(fields.min() * thick.sum() if self.floating else (fields * thick).min())

    def build_fe_model(self) -> FiniteElementModel:
        """Make the mesh and the finite-element model of the bonded blocks.

        Raises
        ------
        UsageError : electrodes touch each other, a material of a body of revolution is not
            isotropic about the axis, or the order of the blocks' edges along an axis differs from
            that of the body :attr:`like`.
        """
        grid = self.grid or self._divide_axes()
        near = 1e-3 * float(np.concatenate([*map(np.diff, grid)]).min())
        with name_part_in_errors(self.where):
            solid = self._mesh_blocks(grid, near)
            return make_damped_model(solid, self._make_boundary_conditions(solid, near))

    def _divide_axes(self) -> list[np.ndarray]:
        """Return the positions [m] of the grid lines along each axis.

        Each axis is divided at all edges of the body, and into equal cells between these edges.
        """
        model = self if self.like is None else self.like
        result = []
        for edges, model_edges in zip(self._list_edges(), model._list_edges(), strict=True):
            points, place = _merge_edges(edges)
            counted, alike = _merge_edges(model_edges)
            if not np.array_equal(place, alike):
                raise wrong(
                    self.where,
                    (
                        "within the ranges of the parameters, an edge of a layer, electrode or "
                        "support moves past another edge"
                    ),
                    expected="ranges within which no edge moves past another edge",
                    hint="narrow the ranges of the parameters",
                )
            counts = np.ceil(np.diff(counted) / model.size - 1e-9).astype(int)
            cut = [
                np.linspace(*pair, self.refine * max(1, count) + 1)[:-1]
                for pair, count in zip(pairwise(points), counts, strict=True)
            ]
            result.append(np.concatenate([*cut, points[-1:]]))
        return result

    def _list_edges(self) -> np.ndarray:
        """List coordinates [m] of the edges of all blocks, electrodes, supports and ports.

        The returned array has the shape (axes, edges), with one row of coordinates for each axis.
        """
        boxes = [*map(attrgetter("box"), self.blocks), *self.ports.values()]
        boxes += map(itemgetter(1), self.fixed)
        boxes += chain(*self.electrodes.values(), *self.floating)
        spans = np.array(boxes, dtype=float).swapaxes(0, 1)
        return spans.reshape(len(spans), -1)

    def _mesh_blocks(self, grid: Sequence[np.ndarray], near: float) -> Solid:
        """Make a mesh of the grid cells inside the blocks, each with its block's material."""
        mesh = (MeshQuad if len(grid) == 2 else MeshHex).init_tensor(*grid)
        middle = mesh.p[:, mesh.t].mean(axis=1)
        materials = {block.material.name: block.material for block in self.blocks}
        owner = np.full(mesh.nelements, -1)
        for block in self.blocks:
            owner[_mask_inside_box(block.box, middle, near)] = list(materials).index(
                block.material.name
            )
        occupied = np.flatnonzero(owner >= 0)
        result = tuple(materials.values())
        return Solid(mesh.restrict(occupied), result, owner[occupied], axisymmetric=len(grid) == 2)

    def _make_boundary_conditions(self, solid: Solid, near: float) -> BoundaryConditions:
        """Make the boundary conditions of the blocks on the mesh ``solid``."""
        places, letters = solid.node_positions, "xz" if solid.axisymmetric else "xyz"

        def mask_inside(box: Box) -> np.ndarray:
            """Return a mask of the nodes that are inside ``box`` or on its boundary."""
            return _mask_inside_box(box, places, near)

        fixed = np.zeros((places.shape[1], len(letters)), bool)
        if solid.axisymmetric:
            fixed[places[0] < near, 0] = True
        for axes, box in self.fixed:
            for axis in axes:
                fixed[mask_inside(box), letters.index(axis)] = True

        def find_nodes(faces: Sequence[Box]) -> np.ndarray:
            """Return the numbers of the nodes inside any of the boxes."""
            return np.flatnonzero(np.any([*map(mask_inside, faces)], axis=0))

        def compute_load_shares(box: Box) -> np.ndarray:
            """Return the share of each node in a force that is uniform over ``box``."""
            if np.equal(*np.transpose(box)).all():  # the box is a single point
                result = mask_inside(box)
                return np.asarray(result / result.sum())
            face = solid.mesh.facets_satisfying(lambda x: _mask_inside_box(box, x, near))
            return compute_node_shares(solid, facets=face)

        lumped = [mass * compute_load_shares(box) for mass, box in self.masses]
        shapes = [
            PortLoad(
                Port(name, TRANSLATION.port), spread_force(compute_load_shares(box), UP, solid)
            )
            for name, box in self.ports.items()
        ]
        for name, face in self.faces.items():
            facets = select_face(solid, face, near)
            shapes.append(make_pressure_load(Port(name, ACOUSTIC.port), solid, facets))
        return BoundaryConditions(
            fixed=fixed.ravel(),
            electrodes={pin: find_nodes(faces) for pin, faces in self.electrodes.items()},
            reference="cathode",
            floating=list(map(find_nodes, self.floating)),
            shapes=shapes,
            base=[(Port(BASE, ACCELERATION.port), UP)] if self.moved else [],
            lumped=np.sum(lumped, axis=0) if lumped else None,
            damping=self.damping,
        )


def list_outer_faces(box: Box) -> dict[str, RadiatingFace]:
    """Return the radiating faces on the upper and the lower side of a plate.

    The plate fills the ``box``. The returned mapping is keyed by the names of the acoustic ports.
    """
    return {
        FRONT_FACE: RadiatingFace(box, upward=True),
        BACK_FACE: RadiatingFace(box, upward=False),
    }


def select_face(solid: Solid, face: RadiatingFace, near: float) -> np.ndarray:
    """Return the numbers of the facets that form a radiating face."""
    inside = solid.mesh.facets_satisfying(
        lambda x: _mask_inside_box(face.box, x, near), boundaries_only=True
    )
    up = solid.make_facet_basis(inside, 1).normals[-1].mean(axis=-1)
    return np.asarray(inside[up > 0.5 if face.upward else up < -0.5])


def _merge_edges(edges: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Sort the positions of edges; merge positions that differ by rounding errors.

    Return the sorted positions, and for each edge the index of its position in the sorted array.
    """
    points = np.unique(edges)
    points = points[np.r_[True, np.diff(points) > 1e-9 * np.ptp(points)]]
    return points, np.searchsorted(points, edges + 1e-9 * np.ptp(points), side="right") - 1


def _mask_inside_box(box: Box, places: np.ndarray, near: float) -> np.ndarray:
    """Return a mask of the points that are inside a box or on its boundary.

    ``places`` are points of shape (d, …). Points at a distance of less than ``near`` [m] from the
    boundary count as points on the boundary.
    """
    low, high = np.array(box, dtype=float).T.reshape(2, -1, *[1] * (places.ndim - 1))
    return np.asarray(((places > low - near) & (places < high + near)).all(axis=0))
