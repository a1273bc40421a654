"""Checks of a finished transient against physics that the simulator was not told."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import trapezoid

from kc2spice.errors import SimulationError
from kc2spice.fem.emtable import EMTable, force
from kc2spice.scene.schema import Scene
from kc2spice.sim.waveforms import Waveforms

WORK = 1e-4  # share of the work that may be unexplained; then the launch is wrong by about 1e-3


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


def truth_checks(waves: Waveforms, scene: Scene, table: EMTable | None) -> tuple[TruthCheck, ...]:
    """All checks that apply to the parts of ``scene``.

    *table_left*: the sphere stays where the force is known. *outer_ring*: the contact patch does
    not reach the last modelled ring, beyond which there is no more contact. *work*: the
    change of the sphere's kinetic energy equals the work of all forces on it.
    """
    if scene.sphere is None:
        return ()
    checks = []
    if table is not None:
        checks.append(_table_left(waves, table))
    rings = sorted(name for name in waves.data if name.startswith("contact.force.R"))
    if rings:
        checks.append(
            TruthCheck(
                "outer_ring", float(waves[rings[-1]].max()), 0.0, "N",
                "the contact outgrows the modelled rings: more rings or a wider ring_spacing",
            )
        )  # fmt: skip
    if table is None or checks[0].passed:  # the force is unknown outside the table
        checks.append(_work(waves, scene, table))
    return tuple(checks)


def require_truth(waves: Waveforms, scene: Scene, table: EMTable | None) -> tuple[TruthCheck, ...]:
    """:func:`truth_checks`, all passed.

    Raises
    ------
    SimulationError : the first check that is violated.
    """
    checks = truth_checks(waves, scene, table)
    for check in checks:
        if not check.passed:
            raise SimulationError(
                f"the result contradicts physics: {check.name}",
                where=scene.name,
                got=f"{check.value:g} {check.unit}",
                expected=f"at most {check.limit:g} {check.unit}",
                hint=check.advice,
            )
    return checks


def _table_left(waves: Waveforms, table: EMTable) -> TruthCheck:
    y = waves["sphere.y"]
    beyond = max(0.0, float(table.y[0] - y.min()), float(y.max() - table.y[-1]))
    return TruthCheck(
        "table_left", beyond, 0.0, "m",
        "the sphere left the field table: widen catch.y_min and y_max, or kick it less",
    )  # fmt: skip


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
    return TruthCheck(
        "work", missing / turnover if turnover else missing, WORK, "of the work",
        "the steps are too coarse for the contact: lower solver.reltol or max_step",
    )  # fmt: skip
