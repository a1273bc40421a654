"""How far the default mesh is from the converged answer: static force, resonances, rebound.

Each mesh is reduced to a model whose own error (about 1e-5 in an impact) is far below what meshes
differ by, so one factorisation per mesh serves all figures.

Only rings that shrink with the cells converge. A force on a circle of fixed radius is a line load,
the centre's a point load: their compliance grows without bound as cells shrink under them. The
variants with finer cells or elements below the same rings show this, not a better answer. Under a
pressure hats and mesh are refined each by themselves.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace

import numpy as np
from scipy import sparse

from kc2spice.bodies.piezo_stack import from_sector
from kc2spice.bodies.pressure import (
    Hats,
    Pressed,
    dented,
    hats,
    pressed,
    with_hats,
    with_patch,
)
from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.fem.piezo.contact import ContactSurface, contact_surface, sphere_gap
from kc2spice.fem.piezo.keys import Chip
from kc2spice.fem.piezo.mesh import kick_mesh
from kc2spice.fem.piezo.statics import imprint
from kc2spice.fem.piezo.system import PiezoSystem
from kc2spice.fem.piezo.transient import Ball, transient
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduce import reduce
from kc2spice.scene.gates import Table

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
# Factor of the spacing of hats, and the mesh below them.
HATS: dict[str, tuple[float, dict[str, float | int]]] = {
    "hats twice as wide": (2.0, {}),
    "hats as given": (1.0, {}),
    "hats halved": (0.5, {}),
    "rings 100 um below the hats": (1.0, VARIANTS["rings 100 um"]),
    "rings 25 um below the hats": (1.0, VARIANTS["rings 25 um"]),
}
ORDER = 30  # of the model on a patch of pressure


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


# Free potentials make the factors of these two some twenty times more expensive.
COSTLY = ("cells halved under 50 um rings", "quadratic under 50 um rings")


@dataclass(frozen=True)
class Load:
    """What presses on the chip: a sphere of ``radius`` [m] and ``mass`` [kg], pushed ``depth`` [m]
    deep, or flying at ``velocity`` [m/s] from ``gap`` [m]; ``stiffness`` [N/m] of a sector's ring,
    or hats of pressure of this ``spacing`` [m].
    """

    radius: float
    mass: float
    stiffness: float = 1e8
    depth: float = 20e-6  # three rings carry
    velocity: float = -1.0
    gap: float = 1e-6
    spacing: float | None = None


def mesh_table(chip: Chip, load: Load, whole: bool, progress: Callable[[str], None]) -> Table:
    """The study as a table; meshes that take minutes only if ``whole``."""
    if load.spacing is None:
        variants = {k: v for k, v in VARIANTS.items() if whole or k not in COSTLY}
        points = mesh_study(chip, load, variants=variants, progress=progress)
    else:
        points = hat_study(chip, load, progress=progress)
    rows = tuple(
        (
            point.label, f"{point.unknowns}", f"{point.imprint_force_n:.5g} N",
            f"{point.resonance_short_hz / 1e3:.5g} kHz", f"{point.resonance_open_hz / 1e3:.5g} kHz",
            f"{point.min_position_m * 1e6:.5g} µm", f"{point.rebound_velocity_m_s:.5g} m/s",
            f"{point.wall_s:.3g} s",
        )
        for point in points
    )  # fmt: skip
    head = (
        "mesh", "unknowns", f"force at {1e6 * load.depth:g} µm, quarter", "resonance, short",
        "resonance, open", "lowest point of the impact", "rebound", "wall time",
    )  # fmt: skip
    note = (
        "Only rings that shrink with the cells converge: a force on a circle of fixed radius is a "
        "line load, under which finer cells or elements yield without bound."
    )
    if load.spacing:
        note = _moved(points)
    return Table("Meshes", head, rows, note, tuple(asdict(point) for point in points))


def mesh_study(
    chip: Chip,
    load: Load,
    *,
    step: float = 50e-9,
    variants: dict[str, dict[str, float | int]] = VARIANTS,
    progress: Callable[[str], None] | None = None,
) -> list[MeshPoint]:
    """One :class:`MeshPoint` per variant of ``chip.mesh``.

    ``step`` [s] of the impact is the paper's by default, worth 4e-5 of the travel.
    """
    points = []
    for label, change in variants.items():
        if progress:
            progress(label)
        mesh = chip.mesh.model_copy(update=change)
        changed = chip.model_copy(update={"mesh": mesh})
        points.append(_mesh_point(label, changed, load, step))
    return points


def hat_study(
    chip: Chip, load: Load, *, step: float = 50e-9, progress: Callable[[str], None] | None = None
) -> list[MeshPoint]:
    """One :class:`MeshPoint` for hats of pressure of several spacings and meshes below them."""
    points = []
    for label, (wider, change) in HATS.items():
        if progress:
            progress(label)
        changed = chip.model_copy(update={"mesh": chip.mesh.model_copy(update=change)})
        spread = replace(load, spacing=wider * (load.spacing or 0.0))
        points.append(_mesh_point(label, changed, spread, step))
    return points


def _moved(points: list[MeshPoint]) -> str:
    """What halving the hats, and the mesh, moves."""
    by = {point.label: point for point in points}
    now, said = by["hats as given"], []
    for label in ("hats halved", "rings 25 um below the hats"):
        moved = {
            "force": by[label].imprint_force_n / now.imprint_force_n - 1,
            "lowest point": by[label].min_position_m / now.min_position_m - 1,
            "rebound": by[label].rebound_velocity_m_s / now.rebound_velocity_m_s - 1,
        }
        said.append(f"{label}: " + ", ".join(f"{name} {by_:+.1e}" for name, by_ in moved.items()))
    return "Against the hats as given, " + "; ".join(said) + "."


def _pressed(chip: Chip, load: Load) -> tuple[PiezoSystem, Hats, Pressed]:
    """A sector whose one mechanical port is the patch of the hats."""
    mesh = kick_mesh(chip)
    shape = hats(load.spacing or 0.0, chip.mesh.ring_spacing * chip.mesh.rings)
    own = pressed(chip, shape)
    return with_patch(assemble_kick(chip, mesh), chip, mesh, shape, own), shape, own


def _under_pressure(rom: LinearModel, shape: Hats, own: Pressed, load: Load) -> float:
    """Static force [N] of the device, anode open, at the depth: the patch gives, then the law."""
    T = rom.transfer(np.zeros(1))[0].real
    give = T[0, 0] - T[0, 1] * T[1, 0] / T[1, 1]
    law = dented(shape, own.compliance + give, sphere_gap(load.radius, shape.distances))
    return float(law.force(np.array(load.depth)))


def _mesh_point(label: str, chip: Chip, load: Load, step: float) -> MeshPoint:
    start = time.perf_counter()
    if load.spacing is None:
        sector = assemble_kick(chip)
        model = from_sector(sector)
        rom = reduce(model, order=BLOCKS * len(model.inputs), band=BAND)
        system = as_system(rom, sector)
        surface = on_reduced(contact_surface(chip, load.stiffness, load.radius), rom)
        force = float(imprint(system, surface, np.array([load.depth])).force[0])
    else:
        sector, shape, own = _pressed(chip, load)
        model = from_sector(sector)
        rom = reduce(model, order=ORDER, band=BAND)
        gap = sphere_gap(load.radius, shape.distances)
        system, surface = with_hats(as_system(rom, sector), own, gap)
        force = _under_pressure(rom, shape, own, load) / sector.sectors
    ball = Ball(load.mass / sector.sectors, load.gap, load.velocity)
    bounced = transient(system, surface, ball, step=step, stop=STOP, voltage=None)
    facts = model.facts
    return MeshPoint(
        label=label,
        unknowns=sector.unknowns,
        imprint_force_n=force,
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
