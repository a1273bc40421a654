"""A solid with supports, electrodes and ports becomes a :class:`LinearModel`.

Constraints are prolongations: ``u = P z`` from the free displacements and the six motions of each
rigid face, ``phi = Q p + R V`` from the free potentials (floating electrodes are one each) and
the voltages of the driven electrodes. What is left is exact and symmetric,

    [M 0; 0 0] x'' + [P'K_uu P, P'K_up Q; ., -Q'K_pp Q] x = [P'S, -P'K_up R; 0, Q'K_pp R] [f; V]
    [y; charge] = B' x + [0 0; 0 R'K_pp R] [f; V],       x = [z; p / scale],

where S are the shapes of the forces. Potentials have no mass and a negative stiffness block; they
are scaled so that all unknowns are of one magnitude.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, eigsh
from skfem import Basis, BoundaryFacetBasis

from kc2spice.core.errors import UsageError
from kc2spice.fem.solid import Operators, Solid, assemble, element
from kc2spice.linalg.factor import Factor, Inverse, factorise
from kc2spice.rom.linear import LinearModel, Port

MODES = (8, 40)
# A mode is excited by a port if it has more than this part of the static answer (mass norm).
COUPLED = 0.03
# Shift [rad/s] of a body that is free to move, in units of its slowest sound over its size.
FREE_SHIFT = 1e-3
REFINEMENTS = 3


@dataclass(frozen=True)
class Shape:
    """A port of forces: ``weights`` (d nodes,) spread a unit of force over the solid."""

    port: Port
    weights: np.ndarray


@dataclass(frozen=True)
class RigidFace:
    """Nodes that move as one; ``ports`` maps each to its motion (ux, uy, uz, rx, ry, rz).

    Rotations are about ``centre``, the mean of the nodes.
    """

    nodes: np.ndarray
    ports: Sequence[tuple[Port, np.ndarray]]


@dataclass(frozen=True)
class Setup:
    """What is done to a solid: supports, electrodes, ports, masses added to nodes.

    Attributes
    ----------
    fixed : mask (d nodes,) of the displacements that are zero.
    electrodes : pin to its nodes; ``reference`` is the pin that all voltages are counted from.
    floating : nodes of each electrode without pin: one potential, no charge.
    shapes, faces : ports of forces and moments.
    base : ports of base acceleration and their direction (3,).
    lumped : masses [kg] (nodes,) on top of those of the solid.
    rayleigh : alpha [1/s] and beta [s] of ``E = alpha M + beta P'K_uu P``.
    """

    fixed: np.ndarray
    electrodes: Mapping[str, np.ndarray] = field(default_factory=dict)
    reference: str = ""
    floating: Sequence[np.ndarray] = ()
    shapes: Sequence[Shape] = ()
    faces: Sequence[RigidFace] = ()
    base: Sequence[tuple[Port, np.ndarray]] = ()
    lumped: np.ndarray | None = None
    rayleigh: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Device:
    """A solid's linear model and how its unknowns x and voltages V give the fields at the nodes.

    ``u = displacement @ x`` (d nodes,), ``phi = potential @ x + drive @ V`` (nodes,).
    ``massless`` unknowns, the potentials, stand last.
    """

    model: LinearModel
    solid: Solid
    displacement: sparse.csc_array
    potential: sparse.csc_array
    drive: sparse.csc_array
    massless: int


def make_device(solid: Solid, setup: Setup, operators: Operators | None = None) -> Device:
    """Constrain, attach ports and state the facts; see the module.

    Raises
    ------
    UsageError : electrodes or rigid faces touch each other, or an electrode touches nothing
        piezoelectric.
    """
    full = assemble(solid) if operators is None else operators
    P, motions = _moving(solid, setup)
    Q, R, pins = _potentials(full.K_pp, setup)
    mass = full.M
    if setup.lumped is not None:
        mass = mass + sparse.diags_array(np.repeat(setup.lumped, solid.components), format="csc")
    K_zz, K_zp, K_pp = P.T @ full.K_uu @ P, P.T @ full.K_up @ Q, Q.T @ full.K_pp @ Q
    scale = 1.0
    if Q.shape[1]:
        scale = float(np.sqrt(np.median(K_zz.diagonal()) / np.median(K_pp.diagonal())))
    K = sparse.block_array(
        [[K_zz, scale * K_zp], [scale * K_zp.T, -(scale**2) * K_pp]], format="csc"
    )
    none = sparse.csc_array((Q.shape[1],) * 2)
    M_zz = P.T @ mass @ P
    alpha, beta = setup.rayleigh
    E = sparse.block_diag([alpha * M_zz + beta * K_zz, none], format="csc")
    M = sparse.block_diag([M_zz, none], format="csc")
    columns: list[tuple[Port, np.ndarray]] = [(s.port, P.T @ s.weights) for s in setup.shapes]
    columns += motions
    columns += [(port, -(P.T @ (mass @ _translation(solid, a)))) for port, a in setup.base]
    mechanical = np.array([c for _, c in columns]).reshape(len(columns), P.shape[1]).T
    electrical = [-(P.T @ full.K_up @ R).toarray(), scale * (Q.T @ full.K_pp @ R).toarray()]
    B = np.zeros((K.shape[0], len(columns) + len(pins)))
    B[: P.shape[1], : len(columns)] = mechanical
    B[:, len(columns) :] = np.vstack(electrical)
    D = np.zeros((B.shape[1],) * 2)
    D[len(columns) :, len(columns) :] = (R.T @ full.K_pp @ R).toarray()
    ports = (*(port for port, _ in columns), *pins)
    model = LinearModel(B=B, C=B.T.copy(), D=D, ports=ports, M=M, E=E, K=K)
    nothing_u, nothing_p = (sparse.csc_array((a.shape[0], b.shape[1])) for a, b in ((P, Q), (Q, P)))
    device = Device(
        model, solid, sparse.hstack([P, nothing_u], format="csc"),
        sparse.hstack([nothing_p, scale * Q], format="csc"), R, Q.shape[1],
    )  # fmt: skip
    return replace(device, model=replace(model, facts=_facts(device, setup, mass)))


def mean(solid: Solid, axis: np.ndarray, *, facets: np.ndarray | None = None,
         elements: np.ndarray | None = None) -> np.ndarray:  # fmt: skip
    """Weights (d nodes,) of the mean displacement along ``axis`` over facets or elements."""
    return spread(node_shares(solid, facets=facets, elements=elements), axis, solid)


def node_shares(solid: Solid, *, facets: np.ndarray | None = None,
                elements: np.ndarray | None = None) -> np.ndarray:  # fmt: skip
    """``int N / int 1`` (nodes,) over facets or elements, of the full turn if axisymmetric."""
    if facets is not None:
        basis = BoundaryFacetBasis(solid.mesh, element(solid.mesh), facets=facets, intorder=4)
    else:
        basis = Basis(solid.mesh, element(solid.mesh), elements=elements, intorder=4)
    weights = basis.dx
    if solid.axisymmetric:
        weights = weights * basis.global_coordinates().value[0]
    shares = np.zeros(basis.N)
    for nodes, function in zip(basis.element_dofs, basis.basis, strict=True):
        np.add.at(shares, nodes, (function[0].value * weights).sum(axis=1))
    return np.asarray(shares / weights.sum())


def spread(shares: np.ndarray, axis: np.ndarray, solid: Solid) -> np.ndarray:
    """Nodal shares (nodes,) times a unit direction: weights (d nodes,)."""
    axis = axis if solid.components == 3 else axis[[0, 2]]
    return np.outer(shares, axis).ravel()


def _translation(solid: Solid, axis: np.ndarray) -> np.ndarray:
    return spread(np.ones(int(solid.basis(1).N)), np.asarray(axis, float), solid)


def rigid_motions(solid: Solid, centre: np.ndarray) -> np.ndarray:
    """Columns (d nodes, 6): three translations and three rotations about ``centre`` (3-D), or the
    one translation along the axis (axisymmetric, (d nodes, 1)).
    """
    if solid.axisymmetric:
        return _translation(solid, np.array([0.0, 0.0, 1.0]))[:, None]
    arm = solid.basis(1).doflocs.T - centre
    turns = np.cross(np.eye(3)[:, None], arm[None])  # (axis, nodes, component)
    moves = np.broadcast_to(np.eye(3)[:, None], turns.shape)
    return np.concatenate([moves, turns]).reshape(6, -1).T


def _moving(
    solid: Solid, setup: Setup
) -> tuple[sparse.csc_array, list[tuple[Port, np.ndarray]]]:
    """``P`` of ``u = P z``, and the columns of the rigid faces' ports."""
    d, kept = solid.components, ~setup.fixed
    where = solid.basis(1).doflocs.T
    blocks = []
    for face in setup.faces:
        rows = (d * face.nodes[:, None] + np.arange(d)).ravel()
        if not kept[rows].all():
            raise UsageError(
                "a rigid face touches a support or another rigid face",
                where=", ".join(port.name for port, _ in face.ports), hint="give it free nodes",
            )  # fmt: skip
        kept[rows] = False
        motion = np.zeros((len(kept), 6))
        motion[rows] = rigid_motions(solid, where[face.nodes].mean(axis=0))[rows]
        blocks.append(sparse.csc_array(motion))
    identity = sparse.eye_array(len(kept), format="csc")[:, np.flatnonzero(kept)]
    P = sparse.hstack([identity, *blocks], format="csc")
    columns = []
    for number, face in enumerate(setup.faces):
        for port, motion in face.ports:
            z = np.zeros(P.shape[1])
            z[kept.sum() + 6 * number + np.arange(6)] = motion
            columns.append((port, z))
    return P, columns


def _potentials(
    K_pp: sparse.csc_array, setup: Setup
) -> tuple[sparse.csc_array, sparse.csc_array, list[Port]]:
    """``Q`` and ``R`` of ``phi = Q p + R V``, and the electrical ports."""
    live = K_pp.diagonal() > 0
    taken = np.zeros(len(live), int)
    for pin, nodes in [*setup.electrodes.items(), *((None, n) for n in setup.floating)]:
        where = "floating electrode" if pin is None else f"electrodes.{pin}"
        if not live[nodes].any():
            raise UsageError(
                "electrode on a material that is not piezoelectric", where=where,
                expected="a face of a piezoelectric group",
            )  # fmt: skip
        taken[nodes] += 1
    if taken.max(initial=0) > 1:
        raise UsageError(
            "electrodes touch each other", where="electrodes",
            got=f"{np.sum(taken > 1)} common nodes", expected="a gap between any two of them",
            hint="one pin may have several groups: PIN = [GROUP, GROUP]",
        )  # fmt: skip
    free = np.flatnonzero(live & (taken == 0))
    identity = sparse.eye_array(len(live), format="csc")
    Q = sparse.hstack([identity[:, free], *(_indicator(n, live) for n in setup.floating)], "csc")
    driven = {pin: n for pin, n in setup.electrodes.items() if pin != setup.reference}
    none = sparse.csc_array((len(live), 0))
    R = sparse.hstack([none, *(_indicator(n, live) for n in driven.values())], "csc")
    ports = [Port(p, "electrical", "V", "A", (p, setup.reference)) for p in driven]
    return Q, R, ports


def _indicator(nodes: np.ndarray, live: np.ndarray) -> sparse.csc_array:
    column = np.zeros((len(live), 1))
    column[nodes[live[nodes]]] = 1.0
    return sparse.csc_array(column)


def _facts(device: Device, setup: Setup, mass: sparse.csc_array) -> dict[str, float]:
    """Mass, size, capacitances (of the first electrical port, others shorted), static stroke per
    volt and the lowest resonances that a port can excite, all ports shorted or all open.
    """
    model, solid = device.model, device.solid
    facts = {"unknowns": model.B.shape[0], "mass_kg": float(mass.sum()) / solid.components}
    shift = _shift(solid, setup)
    factor = factorise(model.K + shift * model.M, definite=False)
    kinds = [port.kind for port in model.ports]
    e = [k for k, kind in enumerate(kinds) if kind == "electrical"]
    forces = [k for k, kind in enumerate(kinds) if kind in ("mechanical", "rotational")]
    response = _at_rest(factor, model, shift, e)
    if e:
        free = model.D[np.ix_(e, e)] + model.B[:, e].T @ response
        potentials = slice(model.B.shape[0] - device.massless, None)
        inner, b = -model.K[potentials, potentials], model.B[potentials, e[0]]
        drop = b @ factorise(inner, definite=False).solve(b) if device.massless else 0.0
        facts["capacitance_free_f"] = float(free[0, 0])
        facts["capacitance_clamped_f"] = float(model.D[e[0], e[0]] - drop)
        if forces:
            facts["free_stroke_m_per_v"] = float(model.B[:, forces[0]] @ response[:, 0])
    resonances = {"resonance_short_hz": _resonance(device, factor.solve, shift)}
    if e:
        shifted = factor.solve(model.B[:, e])
        weight = np.linalg.inv(model.D[np.ix_(e, e)] + model.B[:, e].T @ shifted)

        def opened(force: np.ndarray) -> np.ndarray:
            x = factor.solve(force)
            return np.asarray(x - shifted @ (weight @ (model.B[:, e].T @ x)))

        resonances["resonance_open_hz"] = _resonance(device, opened, shift)
    return facts | {name: value for name, value in resonances.items() if value is not None}


def _shift(solid: Solid, setup: Setup) -> float:
    """0 [rad^2/s^2] of a supported body, else a small shift that makes ``K + shift M`` regular."""
    motions = rigid_motions(solid, solid.mesh.p.mean(axis=1))
    motions = motions / np.abs(motions).max(axis=0)
    if np.linalg.matrix_rank(motions[setup.fixed], tol=1e-6) == motions.shape[1]:
        return 0.0
    slowest = min(np.sqrt(np.linalg.eigvalsh(m.C)[0] / m.density) for m in solid.materials)
    size = np.linalg.norm(np.ptp(solid.mesh.p, axis=1))
    return float((FREE_SHIFT * slowest / size) ** 2)


def _at_rest(factor: Factor, model: LinearModel, shift: float, ports: list[int]) -> np.ndarray:
    """``K^-1 B`` of loads in equilibrium, refined against the shift of a free body."""
    load = model.B[:, ports]
    x = factor.solve(load) if ports else load
    for _ in range(REFINEMENTS if shift and ports else 0):
        x = factor.solve(load + shift * (model.M @ x))
    return x


def _resonance(device: Device, solve: Inverse, shift: float) -> float | None:
    """Lowest frequency [Hz] above rigid motion that the electrical ports excite (of a body without
    any: the others), None if it is not among the lowest modes.

    Lanczos starts from the static answers of the ports, so it stays with the modes that they
    excite.
    """
    model = device.model
    n = model.B.shape[0] - device.massless
    rest = np.zeros(device.massless)

    def invert(force: np.ndarray) -> np.ndarray:
        return solve(np.concatenate([force.ravel(), rest]))[:n]

    inverse = LinearOperator((n, n), matvec=invert, dtype=float)
    M = model.M[:n, :n]
    electrical = [k for k, port in enumerate(model.ports) if port.kind == "electrical"]
    ports = electrical or range(len(model.ports))
    static = np.array([solve(model.B[:, k])[:n] for k in ports])
    start = (static / np.linalg.norm(static, axis=1, keepdims=True)).sum(axis=0)
    for count in MODES:
        values, modes = eigsh(inverse, min(count, n - 1), M=M, sigma=-shift, OPinv=inverse, v0=start)
        share = np.abs(static @ (M @ modes)) / np.sqrt(np.sum(static * (M @ static.T).T, axis=1))[:, None]
        excited = share.max(axis=0) > COUPLED
        found = values[excited & (values > 10 * shift)]
        if found.size:
            return float(np.sqrt(found.min()) / (2 * np.pi))
    return None
