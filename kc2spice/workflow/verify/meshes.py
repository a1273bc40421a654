"""How much of the error is the mesh's: the same figures from coarser and finer chips."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from kc2spice.core.progress import Clock
from kc2spice.report.html import Section, quantity
from kc2spice.scene.need import need
from kc2spice.scene.schema import Impact, Scene
from kc2spice.workflow.verify.meshstudy import VARIANTS, MeshPoint, mesh_study

DEPTH = 20e-6  # m, of the imprint: three rings carry
# Free potentials make the factors of these two some twenty times more expensive.
COSTLY = ("cells halved under 50 um rings", "quadratic under 50 um rings")


def compare_meshes(scene: Scene, clock: Clock, full: bool) -> list[MeshPoint]:
    """One point per mesh; those that take minutes only if ``full``."""
    variants = {k: v for k, v in VARIANTS.items() if full or k not in COSTLY}
    with clock.stage("mesh study", f"{len(variants)} meshes"):
        return mesh_study(
            need(scene.kick, "kick"),
            need(scene.contact, "contact"),
            need(scene.sphere, "sphere"),
            scene.impact or Impact(),
            DEPTH,
            variants=variants,
            progress=lambda label: clock.progress("mesh study", None, label),
        )


def mesh_records(points: list[MeshPoint]) -> list[dict[str, Any]]:
    """The points as plain dictionaries."""
    return [asdict(point) for point in points]


def mesh_section(points: list[MeshPoint]) -> Section:
    """The study as a table of the page."""
    rows = [
        (
            point.label,
            f"{point.unknowns}",
            quantity(point.imprint_force_n, "N"),
            quantity(point.resonance_short_hz, "Hz"),
            quantity(point.resonance_open_hz, "Hz"),
            quantity(point.min_position_m, "m"),
            quantity(point.rebound_velocity_m_s, "m/s"),
            quantity(point.wall_s, "s", 3),
        )
        for point in points
    ]
    head = (
        "mesh", "unknowns", f"force at {quantity(DEPTH, 'm')}, quarter", "resonance, short",
        "resonance, open", "lowest point of the impact", "rebound", "wall time",
    )  # fmt: skip
    note = (
        "Only rings that shrink with the cells converge: a force on a circle of fixed radius is a "
        "line load, under which finer cells or elements yield without bound."
    )
    return Section("Meshes", rows, head, note)
