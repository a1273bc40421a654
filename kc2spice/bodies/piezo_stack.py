"""The multilayer piezoelectric stack: ring-shaped contact ports on its top, one electrode pair."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse
from skfem.mesh import MeshHex

from kc2spice.bodies.coupled import electromechanical
from kc2spice.bodies.device import Device
from kc2spice.core.errors import UsageError
from kc2spice.fem.materials import Material, material
from kc2spice.fem.piezo.assembly import (
    electrodes,
    free_displacements,
    piezo_material,
    poled,
)
from kc2spice.fem.piezo.mesh import kick_mesh
from kc2spice.fem.solid import Solid
from kc2spice.rom.linear import LinearModel, with_potentials

if TYPE_CHECKING:
    from kc2spice.fem.piezo.keys import Chip
    from kc2spice.fem.piezo.mesh import KickMesh, Slab
    from kc2spice.fem.piezo.system import PiezoSystem

USUAL = "PZT-5H"  # whose limits a ceramic is assumed to have that states none of its own


def from_sector(system: PiezoSystem) -> LinearModel:
    """The device of which ``system`` is one of ``sectors`` that move alike, with its facts.

    The unknowns stay those of one sector. Inertia, stiffness and charge are ``sectors`` times the
    sector's; a force on a whole ring is shared by the sectors, which all answer with the
    displacement of one, so B is that of the sector and the electrical column ``sectors`` times it.
    """
    n = float(system.sectors)
    model = with_potentials(
        M=n * system.M, K_uu=n * system.K_uu, K_up=n * system.K_up, K_pp=n * system.K_pp,
        k_uV=n * system.k_uV, k_pV=n * system.k_pV, c_VV=n * system.c_VV, B=system.B,
        ports=system.ports,
        alpha=system.alpha, beta=system.beta, name="piezo_stack",
    )  # fmt: skip
    facts = {"unknowns": system.unknowns, "mass_kg": n * system.mass}
    facts |= electromechanical(model, system.shift)
    for name in [name for name in facts if name.endswith("_m_per_v")]:
        facts[name.replace("_m_per_v", "_m_per_100v")] = 100 * facts.pop(name)  # as data sheets do
    return model.with_facts(facts)


def sector_device(kick: Chip, system: PiezoSystem, breakdown: float | None = None) -> Device:
    """The device of :func:`from_sector` with the mesh of the quarter, for fields inside it.

    ``breakdown`` [V/m] is the field that a layer stands.

    Raises
    ------
    UsageError : a mesh of quadratic elements, or of several layers in one.
    """
    if kick.mesh.order != 1 or kick.mesh.layers_per_element != 1:
        raise UsageError(
            "fields need linear elements of one layer each", where="mesh",
            got=f"order {kick.mesh.order}, layers_per_element {kick.mesh.layers_per_element}",
            expected="order = 1, layers_per_element = 1",
        )  # fmt: skip
    mesh, n = kick_mesh(kick), float(system.sectors)
    solid = _quarter(kick, mesh, breakdown)
    anode, inner = electrodes(mesh)
    nodes, moved = solid.mesh.nvertices, free_displacements(mesh, kick)
    return Device(
        from_sector(system), solid,
        sparse.eye_array(3 * nodes, format="csc")[:, moved],
        sparse.eye_array(nodes, format="csc")[:, inner],
        sparse.csc_array(anode[:, None]), -n * system.k_pV[:, None], system.shift,
    )  # fmt: skip


def _quarter(kick: Chip, mesh: KickMesh, breakdown: float | None) -> Solid:
    """All levels and caps of the modelled quarter, layers poled by turns."""
    plain, keys = poled(piezo_material(kick.material), kick.poling), kick.material
    axis = np.array([0.0, 0.0, 1.0] if kick.poling == "z" else [1.0, 0.0, 0.0])
    usual = material(USUAL)
    layers = [
        Material(
            "ceramic", plain.density, plain.C, sign * plain.e, plain.eps, axis=sign * axis,
            tensile_strength=keys.tensile_strength or usual.tensile_strength,
            depoling_field=keys.depoling_field or usual.depoling_field, breakdown_field=breakdown,
        )
        for sign in (-1.0, 1.0)
    ]  # fmt: skip
    parts = [(slab, 0) for slab in mesh.active]
    for name, slab, cap in (
        ("bottom_cap", mesh.bottom, kick.bottom_cap), ("top_cap", mesh.top, kick.top_cap),
    ):  # fmt: skip
        if slab is None or cap is None:
            continue
        own = replace(layers[0], e=np.zeros((3, 6)))
        made_of = own if cap.material is None else material(cap.material, f"{name}.material")
        parts.append((slab, len(layers)))
        layers.append(replace(made_of, name=name, e=np.zeros((3, 6))))
    cells, owner = [], []
    for slab, number in parts:
        for level in range(slab.count):
            cells.append(_cells(mesh, slab, level))
            of = (slab.first - mesh.active[0].first) // mesh.steps + level
            owner.append(np.full(cells[-1].shape[1], number or of % 2))
    plane = np.tile(mesh.plane, (len(mesh.heights), 1))
    points = np.column_stack([plane, np.repeat(mesh.heights, len(mesh.plane))])
    whole = MeshHex(np.ascontiguousarray(points.T), np.ascontiguousarray(np.hstack(cells)))
    return Solid(whole, tuple(layers), np.concatenate(owner), order=1)


def _cells(mesh: KickMesh, slab: Slab, level: int) -> np.ndarray:
    """Corners (8, cells) of one level of a slab."""
    first = slab.first + level * mesh.steps
    return np.asarray(mesh.node[slab.layer.t] + first * len(mesh.plane))
