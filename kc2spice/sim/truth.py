"""Checks of a finished transient against physics that the simulator was not told."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.integrate import trapezoid

from kc2spice.errors import SimulationError
from kc2spice.fem.emtable import EMTable, force
from kc2spice.rom.model import ResonatorModel
from kc2spice.scene.need import need
from kc2spice.scene.rings import mesh_rings, ring_gaps
from kc2spice.scene.schema import Scene
from kc2spice.sim.waveforms import Waveforms

WORK = 1e-4  # share of the work that may be unexplained; then the launch is wrong by about 1e-3
WORK_SHARE = 0.03  # ... or of a larger error_budget, a tenth of what its time stepping gets
OPEN = 0.95  # of its gap that the bound of a ring that was left out may reach


@dataclass(frozen=True)
class TruthCheck:
    """One check: ``value`` must not exceed ``limit``; ``advice`` is for the case that it does."""

    name: str
    value: float
    limit: float
    unit: str
    advice: str

    @property
    def passed(self) -> bool:
        """False also for a value that is not a number."""
        return self.value <= self.limit


def truth_checks(
    waves: Waveforms, scene: Scene, table: EMTable | None, chip: ResonatorModel | None
) -> tuple[TruthCheck, ...]:
    """All checks that apply to the parts of ``scene``; ``chip`` is the whole device.

    *table_left*: the sphere stays where the force is known. *outer_ring*: the contact patch does
    not reach the last ring of the mesh, beyond which there is no more contact (an imprint may: its
    depth is the user's). *ring_left_out*: nor does it reach a ring that was left out. *work*: the
    change of the sphere's kinetic energy equals the work of all forces on it.
    """
    if scene.sphere is None or scene.experiment not in ("loop", "impact", "imprint"):
        return ()
    checks = []
    if table is not None:
        checks.append(_table_left(waves, table))
    if scene.kick is not None and scene.contact is not None:
        checks += ring_checks(waves, scene, need(chip, "kick"))
    if scene.experiment == "imprint":
        return tuple(checks)
    if table is None or checks[0].passed:  # the force is unknown outside the table
        checks.append(_work(waves, scene, table))
    return tuple(checks)


def require(checks: Sequence[TruthCheck], scene: Scene) -> None:
    """Nothing, if all ``checks`` are passed.

    Raises
    ------
    SimulationError : the first check that is violated.
    """
    for check in checks:
        if not check.passed:
            raise SimulationError(
                f"the result contradicts physics: {check.name}",
                where=scene.name,
                got=f"{check.value:g} {check.unit}",
                expected=f"at most {check.limit:g} {check.unit}",
                hint=check.advice,
            )


def _table_left(waves: Waveforms, table: EMTable) -> TruthCheck:
    y = waves["sphere.y"]
    beyond = max(0.0, float(table.y[0] - y.min()), float(y.max() - table.y[-1]))
    return TruthCheck(
        "table_left", beyond, 0.0, "m",
        "the sphere left the field table: widen catch.y_min and y_max, or kick it less",
    )  # fmt: skip


def ring_checks(waves: Waveforms, scene: Scene, chip: ResonatorModel) -> list[TruthCheck]:
    """*outer_ring* or *ring_left_out*: the first ring without a spring stays open.

    Nothing records that ring. Without contact it would rise with the outermost kept ring and the
    dents that the recorded forces press into that one, ``u_K + sum_j S_Kj F_j``, and its own dent
    only takes it farther from the sphere. S is the static compliance: over one ring's spacing the
    chip answers at once. Against models with all rings this lies 10 to 100 % above what the next
    ring does at worst, and never more than 5 % of its gap below.
    """
    kick, sphere = need(scene.kick, "kick"), need(scene.sphere, "sphere")
    rings = [k for k, port in enumerate(chip.ports) if port.kind == "mechanical"]
    names = [chip.ports[k].name for k in rings]
    force = np.array([waves[f"contact.force.{name}"] for name in names])
    radii = mesh_rings(kick)
    if len(rings) < len(radii):
        static = (chip.gain[:, rings] / chip.omega[:, None] ** 2).T @ chip.gain[:, rings[-1]]
        rise = waves[f"kick.u.{names[-1]}"] + static @ force - _lowest_point(waves, sphere.radius)
        gap = float(ring_gaps(radii[len(rings)], sphere.radius))
        advice = f"set contact.rings to more than {len(rings)}, or to 'all'"
        return [TruthCheck("ring_left_out", float(rise.max()), OPEN * gap, "m", advice)]
    if scene.experiment == "imprint":
        return []
    advice = "the contact outgrows the modelled rings: more rings or a wider ring_spacing"
    return [TruthCheck("outer_ring", float(force[-1].max()), 0.0, "N", advice)]


def _lowest_point(waves: Waveforms, radius: float) -> np.ndarray:
    """Height of the sphere's tip over the chip at rest [m]."""
    if "imprint.depth" in waves:
        return -waves["imprint.depth"]
    return waves["sphere.y"] - radius


def _work(waves: Waveforms, scene: Scene, table: EMTable | None) -> TruthCheck:
    """Unexplained share of the work, by the trapezoidal rule over the accepted points.

    ngspice's own trapezoidal rule conserves momentum whatever the step; work it does not, by
    ``h dF dv / 4`` a step, so this sees the steps that were too coarse.
    """
    assert scene.sphere is not None
    t, v, mass = waves["time"], waves["sphere.v"], scene.sphere.mass
    forces = [np.full_like(t, -mass * scene.gravity)]
    if "contact.force" in waves:
        forces.append(waves["contact.force"])
    if table is not None:
        zero = np.zeros_like(t)
        lower = waves.data.get("coil.lower.current", zero)
        upper = waves.data.get("coil.upper.current", zero)
        forces.append(force(table, waves["sphere.y"], lower, upper))
    turnover = sum(float(trapezoid(np.abs(f * v), t)) for f in forces)
    work = sum(float(trapezoid(f * v, t)) for f in forces)
    missing = abs(mass * float(v[-1] ** 2 - v[0] ** 2) / 2 - work)
    limit = max(WORK, WORK_SHARE * scene.error_budget) if scene.error_budget else WORK
    return TruthCheck(
        "work", missing / turnover if turnover else missing, limit, "of the work",
        "the steps are too coarse for the contact: lower solver.reltol or max_step",
    )  # fmt: skip
