"""The error budget: one relative error, divided over the stages, and the keys that follow.

Of all settings whose errors add up to the budget at most, the cheapest are taken. Errors of
transients are those of the launch or rebound velocity and of the position over the travel,
whichever is larger; of the other experiments the largest relative error of the result.

The relations below were measured on the paper's chip: the reduction in scipy against 84 states
with all rings (events located, rtol 1e-9) for kicks of 40 to 105 V and for the impact, the time
stepping in ngspice (trap, trtol 1) against scipy on the same reduced model, the lookup against the
spline that it samples.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from typing import Any

from kc2spice.core.errors import UsageError
from kc2spice.core.units import quantity
from kc2spice.scene.parttype import PartType

BUDGET_KEYS = (
    "rom.order", "rom.tolerance", "rom.band", "solver.reltol", "solver.chgtol",
)  # fmt: skip


@dataclass(frozen=True)
class Setting:
    """Values of keys, the error that they are good for, and what they cost beside other rows."""

    error: float
    keys: dict[str, Any]
    cost: float = 1.0


# Contact excites the chip far beyond the band of a harmonic sweep, so that the band matters more
# than the tolerance. Found over all kicks: at most 1.1e-3, 4.2e-4 and 7.9e-5. Fewer states than
# these give contact forces so ragged that it cannot be told which rings close; more do not help:
# two contact phases make the launch so sensitive that 48 or 60 Krylov states do no better.
REDUCTION = (
    Setting(2e-3, {"rom.tolerance": 1e-6, "rom.band": (0.0, 500e3)}, cost=10),  # states
    Setting(6e-4, {"rom.tolerance": 1e-3, "rom.band": (0.0, 1e6)}, cost=17),
    Setting(8e-5, {"rom.tolerance": 1e-2, "rom.band": (0.0, 2e6)}, cost=39),
)
# Found over kicks of 40 to 105 V, the worse of launch and position: 7.9e-4, 2.9e-4, 1.4e-4, 9.1e-5,
# 6.1e-5, 3.0e-5, 1.4e-5 and 6.8e-6. A reltol of 3e-2 gives 5.4e-3, but its contact makes or loses
# 4 % of the energy.
STEPPING = (
    Setting(1.2e-3, {"solver.reltol": 1e-2, "solver.chgtol": 1e-9}, cost=2.0e3),  # time points
    Setting(6e-4, {"solver.reltol": 3e-3, "solver.chgtol": 1e-9}, cost=3.0e3),
    Setting(2.5e-4, {"solver.reltol": 1e-3, "solver.chgtol": 1e-9}, cost=4.4e3),
    Setting(1.5e-4, {"solver.reltol": 1e-4, "solver.chgtol": 1e-8}, cost=5.9e3),
    Setting(1e-4, {"solver.reltol": 3e-4, "solver.chgtol": 1e-9}, cost=6.6e3),
    Setting(5e-5, {"solver.reltol": 1e-4, "solver.chgtol": 1e-9}, cost=9.4e3),
    Setting(2.2e-5, {"solver.reltol": 3e-5, "solver.chgtol": 1e-9}, cost=13.9e3),
    Setting(1e-5, {"solver.reltol": 1e-5, "solver.chgtol": 1e-10}, cost=27.9e3),
)
# Error of the smooth lookup over its points: 1.3e-3 at 31, 2.9e-5 at 101, 3.3e-6 at 201, 5e-8 at
# 801, thus by the third power of the spacing. A force that is off by e of the largest all the way
# moves the flight by F e T^2 / 2 m, at most twice e of the travel. Points cost text, not time.
LOOKUP_ERROR, LOOKUP_CELLS = 4.5e-6, 200
FLIGHT = 2.0
FEWEST_CELLS, MOST_CELLS = 20, 2000
LOOKUP_SHARE = 0.05  # of the budget is left to the lookup at least


@dataclass(frozen=True)
class Stages:
    """What a scene has that costs accuracy: a transient, a reduced body, a lookup.

    ``lookup`` is the dotted key of the lookup's points, None where there is none. A lookup's error
    grows over a ``flight``.
    """

    transient: bool
    reduced: bool
    lookup: str | None
    flight: bool


def divide(stages: Stages, budget: float) -> dict[str, Setting]:
    """The cheapest setting of each stage that a scene has.

    Their errors add up to at most ``budget``, unless that is below :func:`smallest`.
    """
    if not stages.transient:  # one stage, and its tolerance is that of the result itself
        if stages.reduced:
            return {"reduction": Setting(budget, {"rom.tolerance": budget})}
        return {} if stages.lookup is None else {"lookup": _lookup(stages, budget)}
    rows = _rows(stages)
    left = budget * (1 - LOOKUP_SHARE * (stages.lookup is not None))
    choices = list(product(*rows.values()))
    affordable = [choice for choice in choices if _sum(choice) <= left]
    best = min(affordable, key=_cost) if affordable else min(choices, key=_sum)
    found = dict(zip(rows, best, strict=True))
    if stages.lookup is not None:
        found["lookup"] = _lookup(stages, max(budget - _sum(best), LOOKUP_SHARE * budget))
    return found


def smallest(stages: Stages) -> float:
    """The smallest budget that :func:`divide` keeps."""
    if not stages.transient:
        if stages.reduced or stages.lookup is None:
            return 0.0
        return lookup_error(stages, MOST_CELLS + 1)
    tightest = sum(min(row.error for row in rows) for rows in _rows(stages).values())
    return tightest / (1 - LOOKUP_SHARE * (stages.lookup is not None))


def lookup_error(stages: Stages, points: int) -> float:
    """Estimated error of a result whose force is looked up between ``points`` heights."""
    gain = FLIGHT if stages.flight else 1.0
    return gain * LOOKUP_ERROR * (LOOKUP_CELLS / (points - 1)) ** 3


def _lookup(stages: Stages, share: float) -> Setting:
    cells = LOOKUP_CELLS * (lookup_error(stages, LOOKUP_CELLS + 1) / share) ** (1 / 3)
    points = 1 + min(MOST_CELLS, max(FEWEST_CELLS, math.ceil(cells)))
    return Setting(lookup_error(stages, points), {str(stages.lookup): points})


def _rows(stages: Stages) -> dict[str, tuple[Setting, ...]]:
    rows: dict[str, tuple[Setting, ...]] = {"reduction": REDUCTION, "time stepping": STEPPING}
    return rows if stages.reduced else {"time stepping": STEPPING}


def _sum(choice: tuple[Setting, ...]) -> float:
    return sum(row.error for row in choice)


def _cost(choice: tuple[Setting, ...]) -> float:
    """ngspice's time grows with states times points."""
    return math.prod(row.cost for row in choice)


def known_error(rows: tuple[Setting, ...], values: Mapping[str, Any]) -> float | None:
    """Error of the best row that ``values`` meet in every key, None if they meet none."""
    found = [row.error for row in rows if all(_meets(values[k], v) for k, v in row.keys.items())]
    return min(found, default=None)


def _meets(value: Any, limit: Any) -> bool:
    if isinstance(limit, tuple):  # a band is met by a wider one
        return bool(value[0] <= limit[0] and value[1] >= limit[1])
    return value is not None and value <= limit


def stages_of(data: Mapping[str, Any], types: Mapping[str, PartType]) -> Stages:
    """Stages of a scene, from its raw tables and the types of its parts."""
    asked = [kind.analysis_type for kind in types.values() if kind.analysis_type]
    table = data.get("analysis")
    own = table.get("type", "transient") if isinstance(table, Mapping) else None
    lookups = [f"{name}.{kind.lookup_key}" for name, kind in types.items() if kind.lookup_key]
    transient = (own or (asked[0] if asked else "transient")) == "transient"
    return Stages(
        transient=transient,
        reduced=any(kind.reduced for kind in types.values()),
        lookup=lookups[0] if len(lookups) == 1 else None,
        flight=transient,
    )


def fill(
    data: Mapping[str, Any], types: Mapping[str, PartType]
) -> tuple[dict[str, Any], frozenset[str]]:
    """A scene's raw ``data`` with the keys that its error_budget sets, and their names.

    What the scene says itself stays; order and tolerance of the reduction stand for each other.
    """
    filled = dict(data)
    if data.get("error_budget") is None:
        return filled, frozenset()
    try:
        budget = quantity(data["error_budget"], "")
    except UsageError:
        return filled, frozenset()  # left for the schema to complain about
    if not budget > 0:
        return filled, frozenset()
    names: list[str] = []
    for setting in divide(stages_of(data, types), budget).values():
        for name, value in setting.keys.items():
            section, key = name.split(".")
            table = filled.get(section, {})
            taken = {"tolerance": ("order", "tolerance")}.get(key, (key,))
            if isinstance(table, Mapping) and not any(each in table for each in taken):
                filled[section] = {**table, key: value}
                names.append(name)
    return filled, frozenset(names)
