"""Larger orders for reduced bodies whose error in a transient is too large.

Under the recorded loads, a run compares each reduced body with a model with more states (see
:mod:`kc2spice.rom.time_domain_errors`). The errors of larger orders are computed for the same
loads, without further runs. The scene runs again with the smallest order whose error is within the
limit. If no order is accurate enough, the scene runs again with the order that has the smallest
error. The error of the new run is computed under the loads of the new run. The search ends if the
error is within the limit, if more states are not allowed or do not reduce the error, or after
:data:`MAX_RERUNS` runs.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from shutil import copytree
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.progress import StageTimer
from kc2spice.core.user_warnings import collect_warnings, warn_user
from kc2spice.parts.bodies._body_checks import STATE_FACTOR
from kc2spice.parts.bodies._body_model import get_reduction_settings
from kc2spice.parts.bodies._linear_body import LinearBody
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.modal_models import compute_resonators
from kc2spice.scene.checks import Check
from kc2spice.scene.load import load_scene
from kc2spice.scene.scene_classes import Part, Scene
from kc2spice.sim.ngspice import RetriesFailedError
from kc2spice.synthesis.ringing_time import estimate_time_per_point
from kc2spice.workflow.decks import prepare_deck
from kc2spice.workflow.simulation import Run, simulate_deck

# Pairs of factors for the order and for the highest frequency of the band.
# The pairs of factors are tried in turn until the error is within its limit.
# The last two pairs of ORDER_FACTORS double the highest frequency of the band, because a reduced
# model may neglect the inertia of modes above its band (docs/explanation/contact.md).
# At a damping ratio of 0.01 %, massless modes cause an error of 1.8 % for any order.
# If the highest frequency of the band is doubled, the error due to massless modes decreases from
# 1.8 % to 0.7 % at a damping ratio of 0.01 %.
ORDER_FACTORS = ((2, 1.0), (4, 1.0), (4, 2.0), (8, 2.0))
MAX_VECTORS = 400  # largest order of a model; each basis vector needs a solution of the full model
# Largest number of states of a model, because each state lengthens every step of the simulator.
MAX_STATES = 200
MAX_RERUNS = 3  # largest number of further runs, each of which at least doubles the order
MAX_SECONDS = 300.0  # largest expected CPU time [s] of the simulator for a further run
# largest expected error, relative to the present error, for which a further run is made
IMPROVEMENT_RATIO = 0.7


@dataclass(frozen=True)
class LargerOrder:
    """Larger order of a body's reduced model, with the scene keys that set the order.

    ``states`` and ``error`` (under the loads of the run) are pairs of values for the present and
    the larger model. ``seconds`` is the expected CPU time of the simulator for a run with the
    larger model.
    """

    part: str
    keys: dict[str, Any]
    states: tuple[int, int]
    error: tuple[float, float]
    limit: float
    seconds: float

    def __str__(self) -> str:
        (before, after), (error, smaller) = self.states, self.error
        keys = ", ".join(f"{key} = {value}" for key, value in self.keys.items())
        return (
            f"reduction of {self.part}: under the loads of this run, a model with {before} states "
            f"has an error of {error:.2%}, above the limit of {self.limit:.2%}, and a model with "
            f"{after} states has an error of {smaller:.2%}; the run is repeated with {keys}, which "
            f"takes about {self.seconds:.2g} s of CPU time"
        )


def rerun_with_larger_orders(run: Run, work: Path, clock: StageTimer) -> Run:
    """Rerun a scene with larger orders of reduced models until their errors are small.

    The errors of the reduced models are computed under the loads of the run. The result is the run
    whose reduced bodies have the smallest error. The directory ``work`` contains the files of the
    returned run. Warnings state the orders and their errors, and the reason for the end of the
    search if the error is still too large.
    """
    for _ in range(MAX_RERUNS):
        scene, chosen, ends = _search_larger_orders(run, clock)
        if not chosen:
            for end in ends:
                warn_user(end)
            return run
        better = _rerun_with_orders(run, scene, chosen, work, clock)
        if better is None:
            return run
        run = better
    for name in (check.name for check in _find_violated_checks(run).values()):
        warn_user(f"{name}: the error still exceeds its limit after {MAX_RERUNS} further runs")
    return run


def suggest_keys(error: RetriesFailedError, automatic: Mapping[str, Any]) -> Mapping[str, Any]:
    """Suggest scene keys with which a failed run may succeed; empty if none exist.

    The checks of the run suggest the keys. If ``automatic`` already contains a raised order of a
    body, and this order is still too small, the order is doubled again.
    """
    if error.suggested:
        return error.suggested
    checks = [check for check in error.violated if not check.coarse]
    names = [f"{check.name.removeprefix('reduction of ')}.rom.order" for check in checks]
    raised = all(check.loaded for check in checks) and all(name in automatic for name in names)
    orders = {name: STATE_FACTOR * automatic[name] for name in names} if raised else {}
    return orders if max(orders.values(), default=0) <= MAX_VECTORS else {}


def _rerun_with_orders(
    run: Run, scene: Scene, chosen: Sequence[LargerOrder], work: Path, clock: StageTimer
) -> Run | None:
    """Run the scene with larger model orders; return None if the error is not smaller.

    ``chosen`` contains the larger orders of the reduced models of bodies.
    """
    build = run.build
    for item in chosen:
        warn_user(str(item))
    options: dict[str, Any] = {"trust": build.trust, "functions": build.functions}
    with TemporaryDirectory() as folder:
        try:
            again, deck = prepare_deck(scene, clock, **options)
            with clock.time_stage("simulate", "with more states") as share:
                result = simulate_deck(again, deck, Path(folder), progress=share)
        except (SimulationError, UsageError) as error:
            message = f"the run with more states failed: {error.message}; "
            message += "the result of the previous run is kept"
            warn_user(message)
            return None
        names = [item.part for item in chosen]
        before, after = (
            _find_largest_body_error(run, names),
            _find_largest_body_error(result, names),
        )
        if after >= before:
            message = f"the run with more states has an error of {after:.2%}, not less than "
            message += f"{before:.2%}; the result of the previous run is kept"
            warn_user(message)
            return None
        copytree(folder, work, dirs_exist_ok=True)
    return result


class _OrderSearch(NamedTuple):
    """State of the search for larger orders of the bodies' reduced models."""

    scene: Scene
    chosen: tuple[LargerOrder, ...] = ()
    ends: tuple[str, ...] = ()


def _find_violated_checks(run: Run) -> dict[str, Check]:
    """Return the violated check of each body whose model error under load is too large."""
    checks = {check.name: check for check in run.verdict.checks if check.loaded}
    bodies = {
        part.name: checks.get(f"reduction of {part.name}") for part in _list_bodies_with_order(run)
    }
    return {name: check for name, check in bodies.items() if check and not check.passed}


def _list_bodies_with_order(run: Run) -> Iterator[Part]:
    """Yield the bodies that have an order; bodies with parameter ranges have no order."""
    return (part for part in run.build.scene.parts.values() if not part.parameter_ranges)


def _search_larger_orders(run: Run, clock: StageTimer) -> _OrderSearch:
    """Find a larger order for each body whose error under its loads is too large."""
    result = _OrderSearch(run.build.scene)
    for name, check in _find_violated_checks(run).items():
        result = _search_larger_order(run, result, name, check, clock)
    return result


def _search_larger_order(
    run: Run, earlier: _OrderSearch, name: str, check: Check, clock: StageTimer
) -> _OrderSearch:
    """Search for a larger order of a body's model whose error is within the limit.

    If no tried order has an error within the limit, the result is the tried order with the smallest
    error. ``earlier`` is the result of the searches for other bodies. The scene of ``earlier``
    already contains the larger orders that were found for other bodies.
    """
    build, part = run.build, run.build.scene.parts[name]
    kind = part.type
    assert isinstance(kind, LinearBody)
    model, target = build.model(part, LinearModel), get_reduction_settings(part, build.scene)
    assert model.certificate is not None
    order, key = target.order or model.order, f"{part.name}.rom"
    low, high = model.certificate.band_hz
    norm = {} if target.norm is None else {f"{key}.norm": target.norm}
    least, result, best = IMPROVEMENT_RATIO * check.value, None, earlier.scene
    estimate_error = partial(kind.estimate_error_under_load, part, build, run.waves)
    end = f"more states reduce its error by less than {1 - IMPROVEMENT_RATIO:.0%}"
    for multiple, wider in ORDER_FACTORS:
        keys = {f"{key}.order": multiple * order, f"{key}.band": [low, wider * high], **norm}
        if multiple * order > MAX_VECTORS:
            end = f"an order above {MAX_VECTORS} is not tried"
            break
        try:
            with collect_warnings():  # the order replaces a tolerance of the scene
                scene = load_scene(earlier.scene, keys)
            larger = kind.build(scene.parts[part.name], scene, clock)
        except (SimulationError, UsageError) as error:
            end = f"there is no larger model ({error.message})"
            break
        if larger is None or larger.order <= model.order:
            end = "the body has no more states"
            break
        if larger.order > MAX_STATES:
            end = f"a model of {larger.order} states, more than {MAX_STATES}, is not tried"
            break
        seconds = run.cpu_s * _estimate_time_ratio(model, larger)
        if seconds > MAX_SECONDS:
            end = f"a run with {larger.order} states takes about {seconds:.2g} s of CPU time, more "
            end += f"than {MAX_SECONDS:g} s, and is not tried"
            break
        estimate = estimate_error(larger)
        if estimate is None:
            end = "there is no model with more states to estimate the error of larger models"
            break
        if estimate[0] < least:
            least, states = estimate[0], (model.order, larger.order)
            errors = check.value, least
            result = LargerOrder(part.name, keys, states, errors, check.limit, seconds)
            best = scene
        if least <= check.limit and result is not None:
            break
    chosen = () if result is None else (result,)
    return _OrderSearch(best, (*earlier.chosen, *chosen), (*earlier.ends, f"{check.name}: {end}"))


def _estimate_time_ratio(model: LinearModel, larger: LinearModel) -> float:
    """Estimate the factor by which a larger model increases the CPU time of a run.

    The CPU time is proportional to the time per point and to the highest natural frequency of modes
    with inertia, which the time steps resolve.
    """
    points = list(map(_find_highest_mode_frequency, (model, larger)))
    more = points[1] / points[0] if all(points) else 1.0
    return more * estimate_time_per_point(larger.order) / estimate_time_per_point(model.order)


def _find_highest_mode_frequency(model: LinearModel) -> float:
    """Return the highest natural frequency [rad/s] of modes with inertia, or 0."""
    modal = compute_resonators(model)
    return 0.0 if modal is None else float(modal.omega[modal.inertia > 0].max(initial=0.0))


def _find_largest_body_error(run: Run, names: Sequence[str]) -> float:
    """Find the largest error of the reduced bodies under the loads recorded in a run."""
    result = 0.0
    for name in names:
        part = run.build.scene.parts[name]
        assert isinstance(part.type, LinearBody)
        model = run.build.model(part, LinearModel)
        errors = part.type.estimate_error_under_load(part, run.build, run.waves, model)
        result = max(result, math.inf if errors is None else errors[0])
    return result
