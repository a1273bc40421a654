"""Multilayer piezoelectric stack with ring-shaped contact ports on its top.

One quarter of the stack is meshed, because all four quarters move in the same way. The nodes are on
concentric circles, so that a force on a ring is exactly a sum of nodal forces. A *level* is a layer
of elements of the mesh. A level of elements represents either one ceramic layer, or up to
``layers_per_element`` ceramic layers as a homogeneous medium. The electrodes determine the electric
field in each ceramic layer. Therefore, m parallel layers at the same voltage are equivalent to one
layer with m times the thickness, the coupling ``m e`` and the permittivity ``m^2 eps``.

Electrode planes with even numbers are the grounded cathode, and planes with odd numbers are the
anode. The poling of the layers alternates: the poling is along -z above a cathode, so that a
positive voltage at the anode lengthens every layer. Source: section 2.2.2 and appendix A.2 of the
paper (Schütz, Maeter and Bechtold, Actuators 10 (2021) 279).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse
from skfem import BilinearForm, LinearForm, MeshHex1, MeshHex2

from kc2spice.bodies.solid_models import (
    UP,
    BoundaryConditions,
    PortLoad,
    make_damped_model,
    spread_force,
)
from kc2spice.bodies.stack_keys import PATCH_PORT, SECTORS, Cap, StackKeys
from kc2spice.bodies.undamped_models import FiniteElementModel
from kc2spice.core.domains import TRANSLATION
from kc2spice.core.errors import name_part_in_errors
from kc2spice.fem.materials import Material, find_material
from kc2spice.fem.solid import Solid
from kc2spice.linalg.factor import require_memory
from kc2spice.rom.linear_model import Port

# Largest thickness of a layer of elements, divided by the layer's depth below the top of the stack.
LEVEL_GROWTH = 0.25
# Memory [bytes] of the sparse factors of a solid with n unknowns, divided by n^(4/3).
# The sparse factors of a solid with 152 000 unknowns took 5.8 GB.
SPARSE_BYTES = 700.0
# largest distance between nodes that are regarded as one position, relative to the stack's size
_POSITION_TOLERANCE = 1e-9
# Order of the quadrature over a cell.
# The order of the quadrature is high, because the slope of a pressure may jump inside the cell.
_PRESSURE_QUADRATURE = 8

Profile = tuple[np.ndarray, np.ndarray]


def make_stack(
    kick: StackKeys, breakdown: float | None = None, pressure: Profile | None = None
) -> FiniteElementModel:
    """Make the damped model of a stack with ports for all contact rings and the anode.

    The symmetry conditions are u_x = 0 on x = 0 and u_y = 0 on y = 0. A stack poled along x moves
    antisymmetrically in x, so that u_y = u_z = 0 on x = 0. The support of the bottom face z = 0
    depends on ``kick.mounting``:

    * ``roller``: u_z = 0 (no friction),
    * ``glued``: u = 0,
    * ``free``: no support,
    * a number: springs along all three axes with this stiffness [N/m per m^2].

    Free potentials exist only if a plane of nodes lies inside an active layer. The unknowns
    describe one quarter of the stack. A force on a whole ring is divided among the four quarters.
    Each quarter has the displacement of the whole ring. ``breakdown`` [V/m] is the breakdown field
    of a layer. If a ``pressure`` is given, the model has one mechanical port for this pressure
    instead of the ring ports. ``pressure`` contains radii [m], and the pressure at each radius. The
    pressure is linear between neighbouring radii, and zero beyond the last radius.

    Raises
    ------
    UsageError : rings are larger than the chip, the number of sectors is odd, the material is
        invalid, or the model needs too much memory.
    """
    solid, setup = make_stack_setup(kick, breakdown, pressure)
    device = make_damped_model(solid, setup)
    facts = dict(device.model.facts)
    facts.pop("depoling_voltage_v", None)  # the key `rated_field` limits the electric field
    facts["unknowns"] += 1  # Schütz et al. (2021) count the anode as one unknown
    for name in [name for name in facts if name.endswith("_m_per_v")]:
        # data sheets of stacks state the stroke per 100 V
        facts[name.replace("_m_per_v", "_m_per_100v")] = 100 * facts.pop(name)
    return replace(device, model=device.model.copy_with(facts=facts, name="piezo_stack"))


def make_stack_setup(
    kick: StackKeys, breakdown: float | None = None, pressure: Profile | None = None
) -> tuple[Solid, BoundaryConditions]:
    """Make mesh, materials and boundary conditions of one quarter of a stack.

    The quarter has ``x >= 0`` and ``y >= 0``. The bottom face of the quarter, including the bottom
    cap, is at ``z = 0`` (Fig. 3b of Schütz et al. 2021). Nodes are numbered plane by plane. In each
    plane of nodes, the centre is first, followed by the nodes of each ring from the x axis to the y
    axis. Elements are numbered from the bottom to the top.
    """
    steps = kick.mesh.refine * kick.mesh.order
    (spans, heights), lattice = _divide_height(kick, steps), _place_nodes(kick, steps)
    plane = 1 + (lattice.shape[0] - 1) * lattice.shape[1]
    nodes, inner = plane * len(heights), plane * int((spans == 1).sum()) * (steps - 1)
    sparse_bytes = SPARSE_BYTES * (3.0 * nodes + inner) ** (4 / 3)
    require_memory(  # the factorised matrix is banded if there are no free potentials
        sparse_bytes if inner else min(sparse_bytes, 8.0 * 3 * nodes * 3 * plane),
        "the factorised stiffness",
        where="kick.mesh",
        hint="lower kick.mesh.refine, kick.mesh.order or the number of rings and sectors",
    )
    mesh, numbers = _make_hexahedra(lattice, heights, kick.mesh.order)
    materials, owner = make_layer_materials(kick, spans, breakdown)
    level = np.arange(mesh.nelements) * len(spans) // mesh.nelements
    with name_part_in_errors("kick"):
        solid = Solid(mesh, materials, owner[level], order=kick.mesh.order, numbers=numbers)
    electrodes, graded = _find_electrode_nodes_and_potentials(spans, heights[::steps], solid)
    return solid, BoundaryConditions(
        _mask_fixed_displacements(kick, solid),
        electrodes,
        "cathode",
        shapes=_make_ring_forces(kick, solid)
        if pressure is None
        else [_make_patch_force(solid, pressure)],
        graded=graded,
        springs=make_springs(solid, kick),
        sectors=SECTORS,
        damping=kick.damping,
    )


def _divide_height(kick: StackKeys, steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Divide the height of a stack into levels of finite elements.

    Return the number of active layers in each level, and the heights [m] of all node planes.
    """
    spans, caps = choose_level_spans(kick), (kick.bottom_cap, kick.top_cap)
    counts = [choose_cap_level_count(kick, cap) for cap in caps]
    below, above = (
        np.linspace(0, cap.thickness if cap else 0.0, steps * count + 1)
        for cap, count in zip(caps, counts, strict=True)
    )
    edges = kick.height / kick.layers * np.r_[0, np.cumsum(spans)]
    active = np.interp(np.arange(steps * len(spans) + 1) / steps, np.arange(len(edges)), edges)
    heights = np.r_[below[:-1], below[-1] + active[:-1], below[-1] + active[-1] + above]
    return np.pad(spans, counts), heights


def _make_hexahedra(
    lattice: np.ndarray, heights: np.ndarray, order: int
) -> tuple[MeshHex1, np.ndarray]:
    """Make the hexahedral mesh of a stack, and the node numbers of each hexahedron.

    A box with the coordinates (ring, spoke, plane) is divided into regular hexahedra. The nodes of
    the box are then moved to their positions in the stack. In each plane, all nodes with ``ring =
    0`` become one node, so that the hexahedra around the centre become exact wedges.
    """
    counts = (lattice.shape[0] - 1, lattice.shape[1] - 1, len(heights) - 1)
    box = MeshHex1.init_tensor(*(np.arange(n // order + 1) * 1.0 for n in counts))
    if order == 2:
        box = MeshHex2.from_mesh(box)
    i, j, k = np.rint(box.doflocs * order).astype(int)
    spokes, per_plane = lattice.shape[1], 1 + counts[0] * lattice.shape[1]
    number = np.where(i == 0, 0, 1 + (i - 1) * spokes + j) + k * per_plane
    places = np.array([*lattice[i, j].T, heights[k]])
    return type(box)(places, box.t), number[box.dofs.element_dofs]


def choose_level_spans(kick: StackKeys) -> np.ndarray:
    """Choose how many ceramic layers each level of finite elements spans in a stack.

    The levels are in the order from the bottom to the top. The number of ceramic layers in a level
    is at most ``layers_per_element``. A level that contains several layers is at most
    :data:`LEVEL_GROWTH` times as thick as its depth below the top of the stack.
    """
    spans: list[int] = []
    while (left := kick.layers - sum(spans)) > 0:
        grown = max(1, int(LEVEL_GROWTH * sum(spans)))
        spans.append(min(kick.mesh.layers_per_element, grown, left))
    return np.array(spans[::-1])


def choose_cap_level_count(kick: StackKeys, cap: Cap | None) -> int:
    """Choose the number of levels of finite elements in a cap at the end of a stack.

    A cap has two to sixteen levels of elements. Each level of elements in the cap is about as thick
    as an active ceramic layer. The returned number of levels is 0 if there is no cap.
    """
    if cap is None:
        return 0
    return int(np.clip(np.ceil(cap.thickness * kick.layers / kick.height - 1e-9), 2, 16))


def _place_nodes(kick: StackKeys, steps: int) -> np.ndarray:
    """Compute the x and y positions of the nodes in one horizontal plane of a stack.

    The returned array has the shape (rings + 1, spokes + 1, 2). All nodes in row 0 of the array are
    at the centre. Nodes divide arcs and straight edges into equal parts. Beyond the last contact
    ring, the nodes of each spoke are on a straight line.
    """
    mesh, half = kick.mesh, kick.half_widths
    along = np.linspace(0.0, 1.0, mesh.sectors * steps + 1)
    circle = np.column_stack([np.cos(np.pi / 2 * along), np.sin(np.pi / 2 * along)])
    inner = mesh.ring_spacing * np.arange(mesh.rings * steps + 1)[:, None, None] / steps * circle
    if kick.diameter is None:
        sides = np.interp(along, [0.5, 1.0], [1.0, 0.0]), np.interp(along, [0.0, 0.5], [0.0, 1.0])
        edge = np.column_stack(sides) * half
    else:  # the chords of linear elements enclose the same area as the circle
        angle = np.pi / (2 * mesh.sectors * steps)
        edge = half[0] * (np.sqrt(angle / np.sin(angle)) if mesh.order == 1 else 1.0) * circle
    left = min(half) - mesh.rings * mesh.ring_spacing
    growth, count, ratio = 1.0, mesh.outer_rings, left / mesh.ring_spacing
    # The growth factor g solves: spacing (1 + g + ... + g^(count-1)) = remaining length.
    # Each outer ring after the first is g times as wide as the next ring inwards.
    # The first outer ring is as wide as a contact ring.
    if ratio > count > 1:
        from scipy.optimize import brentq  # brentq is imported here, because most meshes are cached

        growth = brentq(lambda g: (g ** np.arange(count)).sum() - ratio, 1.0, ratio, xtol=1e-15)
    sizes = np.cumsum(growth ** (np.arange(count * steps) / steps))
    share = (sizes / sizes[-1])[:, None, None]
    return np.concatenate([inner, (1 - share) * inner[-1] + share * edge])


def make_layer_materials(
    kick: StackKeys, spans: np.ndarray, breakdown: float | None = None
) -> tuple[tuple[Material, ...], np.ndarray]:
    """Make the materials of a stack, and the material index of each level of elements.

    ``spans`` contains the number of ceramic layers in each level from the bottom to the top; the
    number is 0 in a cap.
    """
    plain = replace(kick.ceramic, breakdown_field=breakdown)
    poled, active = (
        plain.rotate_z_axis((0, 0, 1) if kick.poling == "z" else (1, 0, 0)),
        np.flatnonzero(spans),
    )
    owner = np.zeros(len(spans), int)
    signed = np.where(np.arange(len(active)) % 2, spans[active], -spans[active])
    kinds, owner[active] = np.unique(signed, return_inverse=True)
    materials = [
        replace(
            poled,
            e=n * poled.e,
            eps_S=n**2 * poled.eps_S,
            axis=np.sign(n) * poled.axis,
            dielectric=True,
        )
        for n in kinds
    ]
    below, above = slice(active[0]), slice(active[-1] + 1, None)
    for levels, name, cap in (
        (below, "bottom_cap", kick.bottom_cap),
        (above, "top_cap", kick.top_cap),
    ):
        if cap is not None:
            where = f"kick.{name}.material"
            made_of = plain if cap.material is None else find_material(cap.material, where)
            owner[levels] = len(materials)
            materials.append(replace(made_of, name=name, e=np.zeros((3, 6))))
    return tuple(materials), owner


def _mask_fixed_displacements(kick: StackKeys, solid: Solid) -> np.ndarray:
    """Return a mask of displacements that are zero due to symmetry or the mounting.

    Entry ``3 * node + axis`` of the mask is for the displacement of a node along an axis.
    """
    fixed = np.zeros(solid.node_positions.T.shape, dtype=bool)
    near = _POSITION_TOLERANCE * solid.node_positions.max()
    mounting = {"roller": "z", "glued": "xyz"}.get(str(kick.mounting), "")
    sides = ("x" if kick.poling == "z" else "yz", "y", mounting)
    for axes, height in zip(sides, solid.node_positions, strict=True):
        for axis in axes:
            fixed[height < near, "xyz".index(axis)] = True
    return fixed.ravel()


def _find_electrode_nodes_and_potentials(
    spans: np.ndarray, faces: np.ndarray, solid: Solid
) -> tuple[dict[str, np.ndarray], Profile | None]:
    """Find the electrode nodes, and the potentials of the nodes between electrodes.

    ``spans`` contains the number of ceramic layers in each level; the number is 0 in a cap.
    ``faces`` [m] contains the heights of the lower and upper faces of the levels. A level of
    several ceramic layers also contains inner electrodes, which the mesh does not represent. The
    first returned value maps ``anode`` and ``cathode`` to their nodes. The second returned value
    contains the nodes between the lower and the upper face of a level that represents several
    ceramic layers. The second returned value also contains the potential of each node between the
    faces, as a fraction of the anode's voltage. If no node lies between the two faces of a level of
    several ceramic layers, the second returned value is None.
    """
    active, z = np.flatnonzero(spans), solid.node_positions[2]
    planes = faces[np.r_[active, active[-1] + 1]]
    on = np.abs(z[:, None] - planes) < _POSITION_TOLERANCE * planes[-1]
    pins = {"anode": on[:, 1::2], "cathode": on[:, ::2]}
    several = np.r_[False, spans[active] > 1, False][np.searchsorted(planes, z)]
    within = np.flatnonzero(several & ~on.any(axis=1))
    part = np.interp(z[within], planes, np.arange(planes.size) % 2)
    return (
        {pin: np.flatnonzero(item.any(axis=1)) for pin, item in pins.items()},
        (within, part) if within.size else None,
    )


def _make_ring_forces(kick: StackKeys, solid: Solid) -> list[PortLoad]:
    """Make a force port on each ring of nodes, with the nodal forces of a unit force.

    Only a quarter of the stack is meshed, so half of the force at a node on a symmetry plane
    belongs to the mirrored part. The weights of the nodes of a ring add up to one. Therefore, the
    output of a ring's port is the mean displacement of the ring (eq. 8 of Schütz et al. 2021).
    """
    shapes, (x, y, z), axis = [], solid.node_positions, np.eye(3)["xyz".index(kick.poling)]
    near = _POSITION_TOLERANCE * solid.node_positions.max()
    for number in range(kick.mesh.rings + 1):
        away = np.abs(np.hypot(x, y) - number * kick.mesh.ring_spacing)
        ring = (away < near) & (z > z.max() - near)
        share = np.where((x < near) | (y < near), 0.5, 1.0) * ring
        weights = spread_force(share / share.sum(), axis, solid)
        shapes.append(PortLoad(Port(f"ring{number}", TRANSLATION.port), weights))
    return shapes


def _make_patch_force(solid: Solid, pressure: Profile) -> PortLoad:
    """Make a force port whose unit force has a pressure profile on the top of a stack.

    The force acts on the top of the stack.
    """

    def pressure_load(v, w):  # type: ignore[no-untyped-def]
        """Return the pressure times a test function, the integrand of the load vector."""
        return np.interp(np.hypot(w.x[0], w.x[1]), *pressure, right=0.0) * v

    share = LinearForm(pressure_load).assemble(
        solid.make_facet_basis(
            _find_facets(solid, solid.node_positions[2].max()), _PRESSURE_QUADRATURE
        )
    )
    return PortLoad(
        Port(PATCH_PORT, TRANSLATION.port), spread_force(share / share.sum(), UP, solid)
    )


def make_springs(solid: Solid, kick: StackKeys) -> sparse.csc_array | None:
    """Assemble the stiffness matrix of the springs on the bottom and top faces.

    The stiffness matrix [N/m] is for one quarter of the stack. Return None if the stack has no
    springs.
    """

    def integrate_face_products(height: float) -> sparse.csc_array:
        """Assemble the integrals of products of shape functions over a horizontal face."""
        basis = solid.make_facet_basis(_find_facets(solid, height), solid.quadrature_degree + 1)
        local = sparse.csc_array(BilinearForm(lambda u, v, _: u * v).assemble(basis))
        return (local + local.T) / 2

    result = []
    if isinstance(kick.mounting, float):
        result.append(sparse.kron(integrate_face_products(0.0), kick.mounting * np.eye(3)))
    if kick.preload_spring is not None:
        top = integrate_face_products(solid.node_positions[2].max())
        share = kick.preload_spring / SECTORS / top.sum() * top
        result.append(sparse.kron(share, np.diag(UP)))
    return sparse.csc_array(sum(result)) if result else None


def _find_facets(solid: Solid, height: float) -> np.ndarray:
    """Return the facets of the horizontal face at the given height [m]."""
    near = _POSITION_TOLERANCE * solid.node_positions.max()
    return np.asarray(solid.mesh.facets_satisfying(lambda x: np.abs(x[2] - height) < near))
