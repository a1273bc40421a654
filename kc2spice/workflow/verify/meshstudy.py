"""How far the default mesh is from the converged answer: static force, resonances, rebound.

Each mesh is reduced to a model whose own error (about 1e-5 in an impact) is far below what meshes
differ by, so one factorisation per mesh serves all figures.

Only rings that shrink with the cells converge. A force on a circle of fixed radius is a line load,
the centre's a point load: their compliance grows without bound as cells shrink under them. The
variants with finer cells or elements below the same rings show this, not a better answer.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from kc2spice.bodies.piezo_stack import from_sector
from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.fem.piezo.contact import ContactSurface, contact_surface
from kc2spice.fem.piezo.statics import imprint
from kc2spice.fem.piezo.system import PiezoSystem
from kc2spice.fem.piezo.transient import Ball, transient
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduce import reduce
from kc2spice.scene.schema import Contact, Impact, Kick, Sphere

BLOCKS = 6
STOP = 15e-6  # of the impact, paper Fig. 9
BAND = (0.0, 500e3)

# Ring spacing at equal contact area (the 250 um of the default), then finer cells and elements
# under the same rings.
VARIANTS: dict[str, dict[str, float | int]] = {
    "rings 100 um": {"ring_spacing": 100e-6, "rings": 3, "outer_rings": 8},
    "rings 50 um (default)": {},
    "rings 25 um": {"ring_spacing": 25e-6, "rings": 10, "outer_rings": 16},
    "rings 25 um, sectors doubled": {
        "ring_spacing": 25e-6,
        "rings": 10,
        "outer_rings": 22,
        "sectors": 20,
    },
    "cells halved under 50 um rings": {"refine": 2},
    "quadratic under 50 um rings": {"order": 2},
}


@dataclass(frozen=True)
class MeshPoint:
    """Figures of one mesh; forces of the modelled sector, anode open, resonances of the chip."""

    label: str
    unknowns: int
    imprint_force_n: float
    resonance_short_hz: float
    resonance_open_hz: float
    min_position_m: float
    rebound_velocity_m_s: float
    wall_s: float


def mesh_study(
    kick: Kick,
    contact: Contact,
    sphere: Sphere,
    impact: Impact,
    depth: float,
    *,
    step: float = 50e-9,
    variants: dict[str, dict[str, float | int]] = VARIANTS,
    progress: Callable[[str], None] | None = None,
) -> list[MeshPoint]:
    """One :class:`MeshPoint` per variant of ``kick.mesh``; ``depth`` [m] is that of the imprint.

    ``step`` [s] of the impact is the paper's by default, worth 4e-5 of the travel.
    """
    points = []
    for label, change in variants.items():
        if progress:
            progress(label)
        mesh = kick.mesh.model_copy(update=change)
        changed = kick.model_copy(update={"mesh": mesh})
        points.append(_mesh_point(label, changed, contact, sphere, impact, depth, step))
    return points


def _mesh_point(
    label: str,
    kick: Kick,
    contact: Contact,
    sphere: Sphere,
    impact: Impact,
    depth: float,
    step: float,
) -> MeshPoint:
    start = time.perf_counter()
    sector = assemble_kick(kick)
    model = from_sector(sector)
    rom = reduce(model, order=BLOCKS * len(model.inputs), band=BAND)
    system = as_system(rom, sector)
    surface = on_reduced(contact_surface(kick, contact, sphere), rom)
    pushed = imprint(system, surface, np.array([depth]))
    ball = Ball(sphere.mass / sector.sectors, impact.gap, impact.velocity)
    bounced = transient(system, surface, ball, step=step, stop=STOP, voltage=None)
    facts = model.facts
    return MeshPoint(
        label=label,
        unknowns=sector.unknowns,
        imprint_force_n=float(pushed.force[0]),
        resonance_short_hz=facts["resonance_short_hz"],
        resonance_open_hz=facts["resonance_open_hz"],
        min_position_m=float(bounced.height.min()),
        rebound_velocity_m_s=float(bounced.velocity[-1]),
        wall_s=time.perf_counter() - start,
    )


def as_system(rom: LinearModel, full: PiezoSystem) -> PiezoSystem:
    """The reduced device as one sector in the form that the full-model solvers take: states for
    displacements. The other way round than :func:`kc2spice.bodies.piezo_stack.from_sector`."""
    n = full.sectors
    return replace(
        full,
        M=sparse.csc_array(rom.M / n),
        K_uu=sparse.csc_array(rom.K / n),
        K_up=sparse.csc_array((rom.order, 0)),
        K_pp=sparse.csc_array((0, 0)),
        k_uV=-rom.B[:, -1] / n,
        k_pV=np.zeros(0),
        c_VV=float(rom.D[-1, -1]) / n,
        B=rom.B[:, :-1],
    )


def on_reduced(surface: ContactSurface, rom: LinearModel) -> ContactSurface:
    """A surface with one spring per ring, as the reduced model's ring ports see it."""
    return replace(surface, shapes=rom.B[:, :-1])
