"""Which models the points of a sweep share, and how many of each there are to build."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import groupby

from kc2spice.workflow.models import model_keys
from kc2spice.workflow.sweep.plan import Plan, deck_keys
from kc2spice.workflow.sweep.point import Job, Task
from kc2spice.workflow.sweep.ranges import Value, overrides, parameters


@dataclass(frozen=True)
class Stages:
    """Swept keys that reach each model, and the runs that follow from them."""

    chip: tuple[str, ...]
    reduction: tuple[str, ...]
    field: tuple[str, ...]
    runs: dict[str, int]


def task(plan: Plan, index: int) -> Task:
    """Point ``index`` as it goes to a worker."""
    values = plan.values(index)
    return Task(index, overrides(plan.keys, values), parameters(plan.keys, values))


def stages(plan: Plan, job: Job) -> Stages:
    """Try every key at a second value and see which models then differ.

    ``runs`` counts ``chip_fe``, ``catch_fe``, ``rom``, ``netlists`` and ``ngspice``.

    Raises
    ------
    UsageError : the scene is wrong at the first point, or at an end of one of the ranges.
    """
    first = list(plan.values(0))
    base = model_keys(job.scene.load((*job.fixed, *overrides(plan.keys, first))))
    reached: dict[str, list[str]] = {model: [] for model in base}
    for key in deck_keys(plan.keys):
        for other in _extremes(plan, key):
            values = list(first)
            values[plan.keys.index(key)] = other
            found = model_keys(job.scene.load((*job.fixed, *overrides(plan.keys, values))))
            for model in base:
                if found.get(model) != base[model] and key not in reached[model]:
                    reached[model].append(key)
    chip, reduction, field = (
        tuple(reached.get(model, ())) for model in ("chip", "reduction", "field")
    )
    runs = {
        "chip_fe": plan.distinct(chip) if "chip" in base else 0,
        "catch_fe": plan.distinct(field) if "field" in base else 0,
        "rom": plan.distinct(reduction) if "reduction" in base else 0,
        "netlists": plan.distinct(deck_keys(plan.keys)),
        "ngspice": plan.size,
    }
    return Stages(chip, reduction, field, runs)


def slow_blocks(plan: Plan, found: Stages) -> list[int]:
    """Blocks to vary slowest: first those that change the chip, then reduction, then field."""
    ranked = dict.fromkeys((*found.chip, *found.reduction, *found.field))
    return list(dict.fromkeys(_block(plan, key) for key in ranked))


def shared_models(plan: Plan, found: Stages) -> Iterator[tuple[str, list[tuple[str, ...]]]]:
    """Part and points for :func:`prepare`: each model that several points share, once."""
    if 0 < found.runs["rom"] < plan.size or found.runs["rom"] == 1:
        blocks = [_block(plan, key) for key in dict.fromkeys((*found.chip, *found.reduction))]
        points = _representatives(plan, blocks, found.reduction)
        columns = [plan.keys.index(key) for key in found.chip]
        for _, group in groupby(points, key=lambda i: [plan.values(i)[c] for c in columns]):
            yield "kick", [task(plan, index).overrides for index in group]
    if 0 < found.runs["catch_fe"] < plan.size or found.runs["catch_fe"] == 1:
        blocks = [_block(plan, key) for key in found.field]
        for index in _representatives(plan, blocks, found.field):
            yield "catch", [task(plan, index).overrides]


def _block(plan: Plan, key: str) -> int:
    position = plan.keys.index(key)
    return next(i for i, members in enumerate(plan.members) if position in members)


def _representatives(plan: Plan, blocks: list[int], keys: tuple[str, ...]) -> Iterator[int]:
    """One point for each combination of values of ``keys``, the blocks varying in that order."""
    columns = [plan.keys.index(key) for key in keys]
    seen = set()
    stop = 1
    for block in dict.fromkeys(blocks):
        stop *= plan.lengths[block]
    step = plan.size // stop
    for number, index in enumerate(plan.order(list(dict.fromkeys(blocks)))):
        if number % step:
            continue
        values = plan.values(index)
        wanted = tuple(values[c] for c in columns)
        if wanted not in seen:
            seen.add(wanted)
            yield index


def _extremes(plan: Plan, key: str) -> list[Value]:
    """Smallest and largest value of a number, the second one of words."""
    position = plan.keys.index(key)
    block = _block(plan, key)
    column = plan.blocks[block][plan.members[block].index(position)]
    if isinstance(column[0], str):
        return list(dict.fromkeys(column))
    ends = (min(column), max(column))
    return list(dict.fromkeys(ends))
