"""The multilayer piezoelectric stack: ring-shaped contact ports on its top, one electrode pair.

One quarter of it is meshed (:mod:`kc2spice.fem.piezo.mesh`); the four move alike. Even planes of
electrodes are the grounded cathode, odd ones the anode; layers are poled by turns, along -z above a
cathode, so that a positive anode voltage lengthens every one. Paper 2.2.2 and appendix A.2.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy import sparse
from skfem import BilinearForm, LinearForm

from kc2spice.bodies.device import Device, Setup, Shape, make_device, part_named, spread
from kc2spice.fem.materials import Material, material
from kc2spice.fem.piezo.keys import PATCH, SECTORS, Chip
from kc2spice.fem.piezo.mesh import KickMesh, kick_mesh
from kc2spice.fem.solid import Solid
from kc2spice.rom.linear import Port

UPWARDS = np.array([0.0, 0.0, 1.0])
_NEAR = 1e-9  # of the stack's size
_FINE = 8  # of a quadrature that meets the corners of a pressure anywhere in a cell

Profile = tuple[np.ndarray, np.ndarray]


def stack_device(
    kick: Chip, breakdown: float | None = None, pressure: Profile | None = None
) -> Device:
    """The stack with ring ports ring0, ring1, ... and the anode, voltage driven, and its facts.

    Boundary conditions: u_x = 0 on x = 0 and u_y = 0 on y = 0. On the bottom face z = 0, by
    ``kick.mounting``: u_z = 0 on a frictionless ``roller``, u = 0 where ``glued``, nothing where
    ``free``, or springs against all three axes, each ``mounting`` N/m per m^2. A stack poled along
    x moves antisymmetrically in x: u_y = u_z = 0 on x = 0 instead. Free potentials exist only where
    a plane of nodes lies inside an active layer.

    The unknowns are those of one quarter. A force on a whole ring is shared by the quarters, which
    all answer with the displacement of one. ``breakdown`` [V/m] is the field that a layer stands.
    ``pressure``, straight lines over radii [m] and nothing beyond them, is the one mechanical port
    in place of the rings.

    Raises
    ------
    UsageError : rings beyond the chip, odd sector count, impossible material, too many unknowns
        for the memory.
    """
    solid, setup = stack_setup(kick, breakdown, pressure)
    device = make_device(solid, setup)
    facts = dict(device.model.facts)
    facts.pop("depoling_voltage_v", None)  # its key rated_field says it
    facts["unknowns"] += 1  # as the paper counts them: with one anode
    for name in [name for name in facts if name.endswith("_m_per_v")]:
        facts[name.replace("_m_per_v", "_m_per_100v")] = 100 * facts.pop(name)  # as data sheets do
    return replace(device, model=replace(device.model, facts=facts, name="piezo_stack"))


def stack_setup(
    kick: Chip, breakdown: float | None = None, pressure: Profile | None = None
) -> tuple[Solid, Setup]:
    """Mesh and materials of the quarter, and what is done to it."""
    mesh = kick_mesh(kick)
    materials, owner = layer_materials(kick, mesh.spans, breakdown)
    with part_named("kick"):
        solid = Solid(
            mesh.mesh, materials, owner[mesh.level], order=kick.mesh.order, numbers=mesh.numbers
        )
    electrodes, graded = _electrodes(mesh, solid)
    return solid, Setup(
        _fixed(kick, solid),
        electrodes,
        "cathode",
        shapes=_rings(kick, solid) if pressure is None else [_patch(mesh, solid, pressure)],
        graded=graded,
        springs=springs(mesh, solid, kick),
        sectors=SECTORS,
        damping=kick.damping,
    )


def layer_materials(
    kick: Chip, spans: np.ndarray, breakdown: float | None = None
) -> tuple[tuple[Material, ...], np.ndarray]:
    """Materials, and the number of that of each level from the bottom up, of so many layers each
    (none in a cap)."""
    plain = replace(kick.ceramic, breakdown_field=breakdown)
    own, active = plain.poled((0, 0, 1) if kick.poling == "z" else (1, 0, 0)), np.flatnonzero(spans)
    owner = np.zeros(len(spans), int)
    signed = np.where(np.arange(len(active)) % 2, spans[active], -spans[active])
    kinds, owner[active] = np.unique(signed, return_inverse=True)
    materials = [
        replace(
            own, e=n * own.e, eps_S=n**2 * own.eps_S, axis=np.sign(n) * own.axis, dielectric=True
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
            made_of = plain if cap.material is None else material(cap.material, where)
            owner[levels] = len(materials)
            materials.append(replace(made_of, name=name, e=np.zeros((3, 6))))
    return tuple(materials), owner


def _fixed(kick: Chip, solid: Solid) -> np.ndarray:
    """Mask of the displacements ``3 node + axis`` that mirror planes and the mounting hold."""
    fixed = np.zeros(solid.places.T.shape, dtype=bool)
    near = _NEAR * solid.places.max()
    held = {"roller": "z", "glued": "xyz"}.get(str(kick.mounting), "")
    sides = ("x" if kick.poling == "z" else "yz", "y", held)
    for axes, height in zip(sides, solid.places, strict=True):
        for axis in axes:
            fixed[height < near, "xyz".index(axis)] = True
    return fixed.ravel()


def _electrodes(mesh: KickMesh, solid: Solid) -> tuple[dict[str, np.ndarray], Profile | None]:
    """Nodes on the electrodes, and the potentials of those between the ones within a level."""
    active, z = np.flatnonzero(mesh.spans), solid.places[2]
    planes = mesh.faces[np.r_[active, active[-1] + 1]]
    on = np.abs(z[:, None] - planes) < _NEAR * planes[-1]
    pins = {"anode": on[:, 1::2], "cathode": on[:, ::2]}
    several = np.r_[False, mesh.spans[active] > 1, False][np.searchsorted(planes, z)]
    within = np.flatnonzero(several & ~on.any(axis=1))
    part = np.interp(z[within], planes, np.arange(planes.size) % 2)
    return (
        {pin: np.flatnonzero(each.any(axis=1)) for pin, each in pins.items()},
        (within, part) if within.size else None,
    )


def _rings(kick: Chip, solid: Solid) -> list[Shape]:
    """Unit ring forces along z, or along x where that is the poling, equal along the circle.

    Nodes on a symmetry plane carry half (the other half acts on the mirror image). Weights sum to
    one, so the transpose averages the displacement (paper 2.2.2, eq. 8).
    """
    shapes, (x, y, z), axis = [], solid.places, np.eye(3)["xyz".index(kick.poling)]
    near = _NEAR * solid.places.max()
    for number in range(kick.mesh.rings + 1):
        away = np.abs(np.hypot(x, y) - number * kick.mesh.ring_spacing)
        ring = (away < near) & (z > z.max() - near)
        share = np.where((x < near) | (y < near), 0.5, 1.0) * ring
        weights = spread(share / share.sum(), axis, solid)
        shapes.append(Shape(Port(f"ring{number}", "mechanical"), weights))
    return shapes


def _patch(mesh: KickMesh, solid: Solid, pressure: Profile) -> Shape:
    """A unit axial force on the top, spread as the pressure is."""
    basis = solid.face(_facets(mesh, mesh.faces[-1]), _FINE)

    def load(v, w):  # type: ignore[no-untyped-def]
        return np.interp(np.hypot(w.x[0], w.x[1]), *pressure, right=0.0) * v

    share = LinearForm(load).assemble(basis)
    return Shape(Port(PATCH, "mechanical"), spread(share / share.sum(), UPWARDS, solid))


def springs(mesh: KickMesh, solid: Solid, kick: Chip) -> sparse.csc_array | None:
    """Springs of one quarter under the bottom face and on the top face, None without any."""
    found = []
    if isinstance(kick.mounting, float):
        found.append(sparse.kron(_face(mesh, solid, 0.0), kick.mounting * np.eye(3)))
    if kick.preload_spring is not None:
        face = _face(mesh, solid, mesh.faces[-1])
        share = kick.preload_spring / SECTORS / face.sum() * face
        found.append(sparse.kron(share, np.diag(UPWARDS)))
    return sparse.csc_array(sum(found)) if found else None


def _face(mesh: KickMesh, solid: Solid, height: float) -> sparse.csc_array:
    """``int N_i N_j dA`` over the face at a height."""
    basis = solid.face(_facets(mesh, height), solid.quadrature + 1)
    local = sparse.csc_array(BilinearForm(lambda u, v, _: u * v).assemble(basis))
    return (local + local.T) / 2


def _facets(mesh: KickMesh, height: float) -> np.ndarray:
    near = 1e-6 * mesh.faces[1]
    return np.asarray(mesh.mesh.facets_satisfying(lambda x: np.abs(x[2] - height) < near))
