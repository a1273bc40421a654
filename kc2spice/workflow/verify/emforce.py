"""Electromagnetic force: coefficients against brute force, ngspice's lookup against FE (Fig. 6)."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np

from kc2spice.core.progress import Clock
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.magnetics.field import brute_force, catch_table
from kc2spice.fem.magnetics.table import em_cases, force
from kc2spice.report.metrics import metrics
from kc2spice.report.verdict import Check, Findings, Road
from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene
from kc2spice.workflow.models import Models
from kc2spice.workflow.verify.roads import ngspice_road

FINER = 4  # FE positions per table interval that the lookup is compared with


def verify_em_force(scene: Scene, models: Models, clock: Clock, work: Path, full: bool) -> Findings:
    """Nine current pairs over the sphere's travel (paper 3.1).

    The lookup is compared with a finite-element sweep ``FINER`` times as dense, whose spline
    interpolates ``FINER**4`` times better than the table's.
    """
    table, gates = need(models.table, "catch"), scene.gates
    catch, sphere = need(scene.catch, "catch"), need(scene.sphere, "sphere")
    currents = np.array(need(scene.em_force, "em_force").currents)
    cases = np.array([(lower, upper) for lower in currents for upper in currents])
    largest = float(np.abs(em_cases(table, cases)).max())
    with clock.stage("superposition", "four fields per height") as share:
        start = time.perf_counter()
        catch_table(catch, sphere, lambda done, total: share(done / total))
        superposed = time.perf_counter() - start
    with clock.stage("brute force", f"{cases.shape[0] * table.y.size} cases") as share:
        start = time.perf_counter()
        brute = brute_force(catch, sphere, cases, lambda done, total: share(done / total))
        brute_time = time.perf_counter() - start
    superposition = float(np.abs(em_cases(table, cases) - brute).max() / largest)
    dense_catch = catch.model_copy(update={"positions": FINER * (catch.positions - 1) + 1})
    with clock.stage("dense sweep", f"{dense_catch.positions} heights") as share:
        dense = catch_table(dense_catch, sphere, lambda done, total: share(done / total))
    waves, deck_time = ngspice_road(scene, models, clock, work)
    y = np.clip(waves["sphere.y"], dense.y[0], dense.y[-1])
    exact = np.array([force(dense, y, lower, upper) for lower, upper in cases])
    lookup = np.array([waves[f"catch.force.{k}"] for k in range(len(cases))])
    spline = np.array([force(table, y, lower, upper) for lower, upper in cases])
    at_lookup = float(np.abs(lookup - exact).max() / largest)
    curves = {"sphere.y": y} | {f"catch.force.{k}": f for k, f in enumerate(exact)}
    return Findings(
        checks=(
            Check("coefficients to brute force", superposition, gates.superposition),
            Check("ngspice lookup to FE", at_lookup, gates.lookup),
            Check("largest jump of the lookup's slope", _slope_jump(y, lookup), gates.lookup_slope),
        ),
        errors={
            "rom_vs_fom": float(np.abs(spline - exact).max() / largest),
            "ngspice_vs_rom": float(np.abs(lookup - spline).max() / largest),
            "ngspice_vs_fom": at_lookup,
        },
        speedup={"refactor": brute_time / superposed},
        roads=(
            Road("FE, case by case", brute_time),
            Road("FE, superposition", superposed, "case by case", {"error": superposition}),
            Road("netlist, ngspice", deck_time, "dense FE", {"error": at_lookup}),
        ),
        metrics=metrics(waves, scene),
        notes=("errors are relative to the largest force of all cases",),
        curves={"dense FE": Waveforms(curves, {}), "netlist, ngspice": waves},
    )


def _slope_jump(y: np.ndarray, force: np.ndarray) -> float:
    """Largest change of slope from one segment of the lookup to the next, over the largest slope.

    The heights are finer than the lookup, so that a jump shows at full size.
    """
    slope = np.diff(force, axis=1) / np.diff(y)
    return float(np.abs(np.diff(slope, axis=1)).max() / np.abs(slope).max())
