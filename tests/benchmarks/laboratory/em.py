"""Plane ``em``: the table of the magnets' force, by mesh and by number of heights."""

from __future__ import annotations

from functools import partial

import numpy as np

from kc2spice.fem.magnetics.field import catch_table
from kc2spice.fem.magnetics.keys import Catch
from kc2spice.fem.magnetics.table import EMTable, em_cases
from laboratory.points import Outcome, Plane, Point, Ratio, Timing, fastest, timed
from laboratory.setup import Setup, keys_of
from laboratory.usual.fields import brute_force

HEIGHTS, QUICK_HEIGHTS, MESHES = (41, 21, 81), (5, 9), (1, 2)
FINE_HEIGHTS, FINE_MESH, CHECKED = 161, 3, 11
LIMIT = 1e-4  # of the largest force


def em(setup: Setup) -> Outcome:
    """Error of the interpolated force at any height, from the mesh and from the heights."""
    scene = setup.scene("em_force")
    catch, radius = keys_of(scene, "ring_magnet_coils"), keys_of(scene, "sphere").radius
    currents = np.array(keys_of(scene, "current_cases").currents)
    cases = np.array([(lower, upper) for lower in currents for upper in currents])
    dense = _table(setup, catch, radius, 17 if setup.quick else FINE_HEIGHTS, 1)
    exact, largest = em_cases(dense, cases), float(np.abs(em_cases(dense, cases)).max())
    mesh = _mesh_errors(setup, catch, radius, cases, largest)
    all_heights = QUICK_HEIGHTS if setup.quick else HEIGHTS
    points, tables = [], {}
    for heights in all_heights:
        tables[heights], time = timed(
            partial(_table, setup, catch, radius, heights, 1), setup.repeats
        )
        between = np.array([tables[heights].coenergy.force(dense.y, *case) for case in cases])
        error = float(np.abs(between - exact).max() / largest)
        points.append(_point(f"{heights} heights", error, mesh.get(1), time, tables[heights]))
    chosen = all_heights[0]
    if not setup.quick:
        refined, time = timed(lambda: _table(setup, catch, radius, chosen, MESHES[1]), 1)
        error = points[0].errors["interpolation"] or 0.0
        points.append(
            _point(f"{chosen} heights, cells halved", error, mesh[MESHES[1]], time, refined)
        )
    table, superposed = tables[chosen], points[0].time
    own = catch.model_copy(update={"positions": chosen})
    count = cases.shape[0] * chosen
    with setup.clock.stage("em", f"brute force, {count} cases"):
        brute, brute_time = timed(lambda: brute_force(own, radius, cases), 1)
    equal = float(np.abs(em_cases(table, cases) - brute).max() / largest)
    points.append(
        Point("brute force", f"brute force, {count} solves", points[0].error, brute_time,
              {"force": points[0].error, "to superposition": equal})
    )  # fmt: skip
    plane = Plane(
        "em", f"Table of the magnets' force, {cases.shape[0]} current pairs",
        "force error over the largest force", "CPU time [s]", tuple(points),
        (f"error: of the spline between heights, against FE at {dense.y.size} heights, plus that "
         f"of the mesh, against cells of a third",),
    )  # fmt: skip
    exact_enough = fastest((p for p in points if p.family == "superposition"), {"force": LIMIT})
    return Outcome(
        (plane,),
        (
            Ratio("em_superposition", brute_time.median / superposed.median, equal, 8.0,
                  f"brute force over superposition, {count} cases; error: between the two"),
            Ratio("em_table_s", None if exact_enough is None else exact_enough.time.median,
                  None if exact_enough is None else exact_enough.error, 15.0,
                  "the table at force error 1e-4 of the largest", at_least=False, unit="s"),
        ),
    )  # fmt: skip


def _point(label: str, between: float, mesh: float | None, time: Timing, table: EMTable) -> Point:
    whole = between + (mesh or 0.0)
    errors = {"force": whole, "interpolation": between, "mesh": mesh}
    facts = {"unknowns": float(table.unknowns)}
    return Point("superposition", label, whole, time, errors, facts)


def _mesh_errors(
    setup: Setup, catch: Catch, radius: float, cases: np.ndarray, largest: float
) -> dict[int, float]:
    """Largest force error of each mesh at a few heights against a finer one; not in a quick run."""
    if setup.quick:
        return {}
    fine = em_cases(_table(setup, catch, radius, CHECKED, FINE_MESH), cases)
    errors = {}
    for refine in MESHES:
        coarse = em_cases(_table(setup, catch, radius, CHECKED, refine), cases)
        errors[refine] = float(np.abs(coarse - fine).max() / largest)
    return errors


def _table(setup: Setup, catch: Catch, radius: float, heights: int, refine: int) -> EMTable:
    finer = catch.model_copy(update={"positions": heights, "refine": catch.refine * refine})
    with setup.clock.stage("em", f"{heights} heights, cells over {refine}") as share:
        return catch_table(finer, radius, lambda done, total: share(done / total))
