"""``verify``: each scene by its experiment, one record and one page for all."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, cast

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.files import staged
from kc2spice.core.progress import Clock, Progress, silent
from kc2spice.report.figures import verify_figures
from kc2spice.report.plots import Picture
from kc2spice.report.verdict import Check, Findings
from kc2spice.report.verify_figures import poles_figure, steps_figure
from kc2spice.report.verify_page import write_verify
from kc2spice.rom.naive import naive_poles
from kc2spice.scene.schema import Scene
from kc2spice.sim.ngspice import find_ngspice
from kc2spice.workflow.models import Models, build_models
from kc2spice.workflow.results import plain, write_record
from kc2spice.workflow.verify.emforce import verify_em_force
from kc2spice.workflow.verify.fullmodel import full_system
from kc2spice.workflow.verify.linear import verify_harmonic, verify_imprint
from kc2spice.workflow.verify.meshes import compare_meshes, mesh_records, mesh_section
from kc2spice.workflow.verify.meshstudy import MeshPoint
from kc2spice.workflow.verify.steps import step_records, step_section
from kc2spice.workflow.verify.transients import verify_impact, verify_loop

Verifier = Callable[[Scene, Models, Clock, Path, bool], Findings]

_BY_EXPERIMENT: dict[str, Verifier] = {
    "loop": verify_loop,
    "impact": verify_impact,
    "imprint": verify_imprint,
    "harmonic": verify_harmonic,
    "em_force": verify_em_force,
}


def verify(
    scenes: Sequence[Scene],
    out: Path,
    *,
    full: bool = False,
    meshes: bool = False,
    progress: Progress = silent,
) -> dict[str, dict[str, Any]]:
    """Verify ``scenes``, write ``verify.json``, ``verify.html`` and plots into ``out``.

    ``full`` takes every baseline in full instead of a timed sample of it, ``meshes`` adds the mesh
    study of the first scene with contact. Returns the contract's
    record of each scene by name; a missed gate is in its ``passed``, not an exception.

    Raises
    ------
    UsageError : a scene that is not :func:`verifiable`.
    MissingToolError : no ngspice; noticed before any FE is computed.
    SimulationError : a road ended without a result.
    """
    for scene in scenes:
        if not verifiable(scene):
            raise UsageError(
                "has a driver circuit, which no independent road models",
                where=f"verify {scene.name}",
                hint="verify the scene without its driver sections; 'run' checks energy and range",
            )
    find_ngspice()
    found: dict[str, Findings] = {}
    pictures: dict[str, list[Picture]] = {}
    studied: dict[str, list[MeshPoint]] = {}
    with staged(out) as work:
        for scene in scenes:
            folder = work / scene.name
            folder.mkdir()
            clock = Clock(progress)
            models = build_models(scene, clock)
            with TemporaryDirectory() as scratch:
                found[scene.name] = _BY_EXPERIMENT[scene.experiment](
                    scene, models, clock, Path(scratch), full
                )
            if meshes and scene.contact is not None and not studied:
                studied[scene.name] = compare_meshes(scene, clock, full)
            pictures[scene.name] = _draw(scene, models, found[scene.name], folder, clock)
        drawn = {name: replace(f, pictures=tuple(pictures[name])) for name, f in found.items()}
        more = [step_section(name, f.steps) for name, f in found.items() if f.steps]
        more += [mesh_section(points) for points in studied.values()]
        write_verify(work / "verify.html", drawn, more)
        records = {name: _record(findings) for name, findings in found.items()}
        for name, points in studied.items():
            records[name]["meshes"] = mesh_records(points)
        write_record({"passed": _all_passed(records), "scenes": records}, work, "verify.json")
    return cast(dict[str, dict[str, Any]], plain(records))


def verifiable(scene: Scene) -> bool:
    """Whether the full model and scipy know everything that the scene's netlist has."""
    parts = (scene.kick, scene.catch)
    return not any(part is not None and part.driver is not None for part in parts)


def _all_passed(records: Mapping[str, Mapping[str, Any]]) -> bool:
    return all(record["passed"] for record in records.values())


def _draw(
    scene: Scene, models: Models, found: Findings, folder: Path, clock: Clock
) -> list[Picture]:
    with clock.stage("report", "plots"):
        drawn = verify_figures(folder, scene, found.curves, models.table)
        if found.steps:
            chosen = (scene.solver.reltol, scene.solver.max_step)
            drawn.append(steps_figure(folder / "steps.png", found.steps, chosen))
        if scene.experiment == "harmonic" and models.kick is not None:
            modal = models.kick.resonators
            root = np.sqrt((modal.damp / 2) ** 2 - modal.omega**2 + 0j)
            ours = np.concatenate([-modal.damp / 2 + root, -modal.damp / 2 - root])
            naive = naive_poles(full_system(scene), modal.order)
            roads = {"projected as one": naive, "potentials eliminated first": ours}
            drawn.append(poles_figure(folder / "poles.png", roads))
    return drawn


def _record(found: Findings) -> dict[str, Any]:
    return {
        "passed": found.passed,
        "checks": [_check(check) for check in found.checks],
        "errors": found.errors,
        "speedup": found.speedup,
        "metrics": found.metrics,
        "outputs": [asdict(output) for output in found.outputs],
        "steps": step_records(found.steps),
        "roads": [asdict(road) for road in found.roads],
        "notes": list(found.notes),
    }


def _check(check: Check) -> dict[str, Any]:
    return {**asdict(check), "passed": check.passed}
