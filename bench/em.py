"""Plane ``em``: the table of the magnets' force, by number of heights, and case by case."""

from functools import partial

import numpy as np

from bench.points import Outcome, Plane, Point, speed_up, timed
from bench.setup import keys_of
from kc2spice.core.magnets import compute_test_forces
from kc2spice.fem.magnet_field import (
    assemble_field_equations,
    compute_magnetostatic_table,
    get_ring_direction,
    list_sphere_heights,
)

HEIGHTS, QUICK_HEIGHTS, FINE_HEIGHTS = (41, 21, 81), (5, 9), 161


def em(setup):
    """Error of the spline between heights, and the time of superposition against brute force."""
    scene = setup.scene("em_force")
    catch, radius = keys_of(scene, "ring_magnet_coils"), keys_of(scene, "sphere").radius
    currents = np.array(keys_of(scene, "current_cases").currents)
    cases = np.array([(lower, upper) for lower in currents for upper in currents])

    def table(heights):
        return compute_magnetostatic_table(catch.model_copy(update={"positions": heights}), radius)

    dense = table(17 if setup.quick else FINE_HEIGHTS)
    exact, largest = (
        compute_test_forces(dense, cases),
        float(np.abs(compute_test_forces(dense, cases)).max()),
    )
    points, tables = [], {}
    for heights in QUICK_HEIGHTS if setup.quick else HEIGHTS:
        tables[heights], time = timed(partial(table, heights), setup.repeats)
        between = np.array([tables[heights].coenergy.force(dense.y, *case) for case in cases])
        error = float(np.abs(between - exact).max() / largest)
        facts = {"unknowns": float(tables[heights].unknowns)}
        label = f"{heights} heights"
        points.append(Point("superposition", label, error, time, {"force": error}, facts))
    chosen, superposed = next(iter(tables)), points[0]
    own = catch.model_copy(update={"positions": chosen})
    count = cases.shape[0] * chosen
    brute, brute_time = timed(lambda: brute_force(own, radius, cases), 1)
    equal = float(np.abs(compute_test_forces(tables[chosen], cases) - brute).max() / largest)
    errors = {"force": superposed.error, "to superposition": equal}
    label = f"brute force, {count} solves"
    points.append(Point("brute force", label, superposed.error, brute_time, errors))
    plane = Plane(
        "em", f"Table of the magnetic force, {cases.shape[0]} pairs of coil currents",
        "force error divided by the largest force", "CPU time [s]", tuple(points),
        ("The force error is the difference between the spline through the table and "
         f"finite-element solutions at {dense.y.size} heights",),
    )  # fmt: skip
    what = (
        f"time of {count} single solutions divided by time of superposition; error: difference "
        "between both"
    )
    ratio = speed_up("em_superposition", brute_time, superposed, 8.0, what, error=equal)
    return Outcome((plane,), (ratio,))


def brute_force(catch, radius, currents):
    """Force (m, n) [N] of the m pairs ``currents`` (m, 2) at n heights, case by case.

    The paper's code and the baseline of :func:`compute_magnetostatic_table`: on the same meshes,
    each case assembles, factorises and solves for the sum of its sources and takes that one field's
    force.
    """
    y = list_sphere_heights(catch)
    amplitudes = [np.array([get_ring_direction(catch), 1.0, i1, i2]) for i1, i2 in currents]
    result = np.empty((len(amplitudes), y.size))
    for index, system in assemble_field_equations(catch, radius):
        for case, amplitude in enumerate(amplitudes):
            field = system.solve(system.loads @ amplitude[:, None])
            result[case, index] = system.compute_force_matrix(field)[0, 0]
    return result
