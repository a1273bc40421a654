"""The error budget: one relative error, divided over the stages, and the keys that follow.

Of all settings whose errors add up to the budget at most, the cheapest are taken. Errors of
transients are those of the launch or rebound velocity and of the position over the travel,
whichever is larger; of the other experiments the largest relative error of the result.

The relations below were measured on the paper's chip: the reduction in scipy against 96 states
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
from kc2spice.scene.parttype import PartType, Setting
from kc2spice.scene.settings import Rom, Solver

STEP = "solver.max_step"  # set for launches only: elsewhere it belongs to the scene's own events
BUDGET_KEYS = (
    "rom.order", "rom.tolerance", "rom.band", "solver.reltol", "solver.chgtol",
)  # fmt: skip


# Contact excites the chip far beyond the band of a harmonic sweep, so that the band matters more
# than the tolerance. Found over all kicks: at most 1.7e-3, 8.8e-4 and 7.5e-5. Fewer states than
# these give contact forces so ragged that it cannot be told which rings close.
REDUCTION = (
    Setting(2e-3, {"rom.tolerance": 1e-6, "rom.band": (0.0, 500e3)}, cost=12),  # states
    Setting(1e-3, {"rom.tolerance": 1e-3, "rom.band": (0.0, 1e6)}, cost=17),
    Setting(8e-5, {"rom.tolerance": 1e-2, "rom.band": (0.0, 2e6)}, cost=40),
)
# Found over kicks of 40 to 105 V of that chip with 39 states, the worse of launch and position:
# 2.3e-4, 1.1e-4, 5.2e-5, 2.9e-5 and 1.2e-5; of the last row the launch alone, 5e-7. Errors in
# contact fall as (reltol chgtol)^0.55, time points grow with its cube root; those of free flight
# fall with the square of the longest step.
STEPPING = (  # costs are time points
    Setting(3e-4, {"solver.reltol": 1e-2, "solver.chgtol": 1e-8, STEP: 25e-6}, cost=0.9e3),
    Setting(1.2e-4, {"solver.reltol": 3e-3, "solver.chgtol": 1e-8, STEP: 25e-6}, cost=1.05e3),
    Setting(5.5e-5, {"solver.reltol": 8e-4, "solver.chgtol": 1e-8, STEP: 25e-6}, cost=1.35e3),
    Setting(3e-5, {"solver.reltol": 3e-4, "solver.chgtol": 1e-8, STEP: 20e-6}, cost=1.75e3),
    Setting(1.5e-5, {"solver.reltol": 8e-5, "solver.chgtol": 1e-8, STEP: 10e-6}, cost=2.65e3),
    Setting(5e-6, {"solver.reltol": 3e-6, "solver.chgtol": 1e-10, STEP: 5e-6}, cost=17e3),
)
# What only scenes whose result is a launch may do: forget how the body rings after it.
LAUNCH: dict[str, Any] = {"solver.ringing": "coarse"}
# Error of the smooth lookup over its points: 1.3e-3 at 31, 2.9e-5 at 101, 3.3e-6 at 201, 5e-8 at
# 801, thus by the third power of the spacing. A force that is off by e of the largest all the way
# moves the flight by F e T^2 / 2 m, at most twice e of the travel; but it changes its sign within
# each cell, which leaves 0.09 (41 points) to 0.02 (201) for kicks of 40 to 105 V.
LOOKUP_ERROR, LOOKUP_CELLS = 4.5e-6, 200
FLIGHT = 0.1
# Fewer change the energy of a sphere that barely flies by 1e-3 of what is turned over.
FEWEST_CELLS, MOST_CELLS = 100, 2000
LOOKUP_SHARE = 0.05  # of the budget is left to the lookup at least
RESPONSE_SHARE = 0.3  # of the budget that a reduced body without contact takes as its tolerance


_TARGETS = ("order", "tolerance")  # stand for each other


@dataclass(frozen=True)
class Stages:
    """What a scene has that costs accuracy: a transient, a reduced body, a lookup.

    ``lookup`` is the dotted key of the lookup's points, None where there is none. A lookup's error
    grows over a ``flight``. ``throws`` tells whether the result is a launch; ``reductions`` and
    ``steppings`` are the settings known for its bodies and its motion. ``contact`` tells whether
    something excites them beyond any band, ``band`` [Hz] is the scene's own, if it has one.
    """

    transient: bool
    reduced: bool
    lookup: str | None
    flight: bool
    throws: bool = False
    contact: bool = True
    band: tuple[float, float] | None = None
    reductions: tuple[Setting, ...] = REDUCTION
    steppings: tuple[Setting, ...] = STEPPING

    @classmethod
    def of(
        cls, types: Mapping[str, PartType], transient: bool,
        band: tuple[float, float] | None = None,
    ) -> Stages:  # fmt: skip
        """Stages of a scene with parts of these types."""
        lookups = [f"{name}.{kind.lookup_key}" for name, kind in types.items() if kind.lookup_key]
        bodies = [kind.reductions for kind in types.values() if kind.reduced]
        own = bodies[0] if bodies and all(each is bodies[0] for each in bodies) else ()
        steppings = next((kind.steppings for kind in types.values() if kind.steppings), STEPPING)
        throws = transient and any(kind.throws for kind in types.values())
        return cls(
            transient=transient,
            reduced=bool(bodies),
            lookup=lookups[0] if len(lookups) == 1 else None,
            flight=transient,
            throws=throws and steppings is STEPPING,
            contact=any(kind.throws for kind in types.values()),
            band=band,
            reductions=own or REDUCTION,
            steppings=steppings,
        )


def divide(stages: Stages, budget: float) -> dict[str, Setting]:
    """The cheapest setting of each stage that a scene has.

    Their errors add up to at most ``budget``, unless that is below :func:`smallest`.
    """
    if not stages.transient:  # one stage, and its tolerance is that of the result itself
        if stages.reduced:
            return {"reduction": Setting(budget, {"rom.tolerance": budget})}
        return {} if stages.lookup is None else {"lookup": _lookup(stages, budget)}
    rows = _rows(stages, budget)
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
    tightest = sum(min(row.error for row in rows) for rows in _rows(stages, 0.0).values())
    shares = LOOKUP_SHARE * (stages.lookup is not None)
    shares += RESPONSE_SHARE * (stages.reduced and not _known(stages))
    return tightest / (1 - shares)


def lookup_error(stages: Stages, points: int) -> float:
    """Estimated error of a result whose force is looked up between ``points`` heights."""
    gain = FLIGHT if stages.flight else 1.0
    return gain * LOOKUP_ERROR * (LOOKUP_CELLS / (points - 1)) ** 3


def _lookup(stages: Stages, share: float) -> Setting:
    cells = LOOKUP_CELLS * (lookup_error(stages, LOOKUP_CELLS + 1) / share) ** (1 / 3)
    points = 1 + min(MOST_CELLS, max(FEWEST_CELLS, math.ceil(cells)))
    return Setting(lookup_error(stages, points), {str(stages.lookup): points})


def _rows(stages: Stages, budget: float) -> dict[str, tuple[Setting, ...]]:
    rows = {"time stepping": stages.steppings}
    if not stages.reduced:
        return rows
    share = RESPONSE_SHARE * budget
    return {"reduction": _known(stages) or (Setting(share, {"rom.tolerance": share}),), **rows}


def _known(stages: Stages) -> tuple[Setting, ...]:
    """The reductions whose error was measured in contact. A body that nothing strikes is as good as
    its response over the band, and so is one whose own band is narrower than theirs."""
    own = stages.reductions
    if own is REDUCTION and not stages.contact:
        return ()
    return tuple(
        row for row in own
        if stages.band is None or "rom.order" in row.keys
        or _meets(stages.band, row.keys["rom.band"])
    )  # fmt: skip


def _sum(choice: tuple[Setting, ...]) -> float:
    return sum(row.error for row in choice)


def _cost(choice: tuple[Setting, ...]) -> float:
    """ngspice's time grows with states times points."""
    return math.prod(row.cost for row in choice)


def known_error(rows: tuple[Setting, ...], values: Mapping[str, Any]) -> float | None:
    """Error of the best row that ``values`` meet in every key they have, None if they meet none."""
    met = (r for r in rows if all(_meets(values[k], r.keys[k]) for k in r.keys if k in values))
    return min((row.error for row in met), default=None)


def _meets(value: Any, limit: Any) -> bool:
    if isinstance(limit, tuple):  # a band is met by a wider one
        return bool(value[0] <= limit[0] and value[1] >= limit[1])
    if isinstance(limit, int):  # an order is known for itself alone: the next may well be worse
        return bool(value == limit)
    return value is not None and value <= limit


def stages_of(data: Mapping[str, Any], types: Mapping[str, PartType]) -> Stages:
    """Stages of a scene, from its raw tables and the types of its parts."""
    asked = [kind.analysis_type for kind in types.values() if kind.analysis_type]
    table = data.get("analysis")
    own = table.get("type", "transient") if isinstance(table, Mapping) else None
    transient = (own or (asked[0] if asked else "transient")) == "transient"
    return Stages.of(types, transient, _own_band(data.get("rom")))


def _own_band(rom: Any) -> tuple[float, float] | None:
    try:
        low, high = (quantity(each, "Hz") for each in rom["band"])
    except (UsageError, KeyError, TypeError, ValueError):
        return None  # none, or one that the schema complains about
    return low, high


def budget_keys(data: Mapping[str, Any], types: Mapping[str, PartType]) -> tuple[str, ...]:
    """Dotted keys that an error budget sets; one on the command line replaces the file's, but for
    the band of a body that nothing strikes."""
    found = stages_of(data, types)
    keys = BUDGET_KEYS if found.contact else tuple(k for k in BUDGET_KEYS if k != "rom.band")
    return (*keys, *((*LAUNCH, STEP) if found.throws else ()))


def _resolved(solver: Any) -> tuple[float, float]:
    """Band that ten of the largest steps to a period resolve, as of any body without a budget."""
    try:
        step = quantity(solver.get("max_step", Solver().max_step), "s")
    except (UsageError, AttributeError):
        return Rom().band  # the schema complains about it
    return (0.0, 0.1 / step) if step > 0 else Rom().band


def _within(step: float, solver: Any) -> float:
    """``step`` [s], at most the simulated time."""
    try:
        return min(step, quantity(solver.get("stop", step), "s"))
    except (UsageError, AttributeError):
        return step  # the schema complains about it


def fill(
    data: Mapping[str, Any], types: Mapping[str, PartType]
) -> tuple[dict[str, Any], frozenset[str]]:
    """A scene's raw ``data`` with the keys that its error_budget sets, and their names.

    What the scene says itself stays.
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
    stages = stages_of(data, types)
    keys = [item for setting in divide(stages, budget).values() for item in setting.keys.items()]
    if stages.transient and stages.reduced and not _known(stages):
        keys += [("rom.band", _resolved(filled.get("solver", {})))]
    if stages.throws:
        keys = [(k, _within(v, filled.get("solver", {})) if k == STEP else v) for k, v in keys]
        keys += LAUNCH.items()
        keys += [(f"{n}.{k}", v) for n, kind in types.items() for k, v in kind.exact.items()]
    else:
        keys = [(k, v) for k, v in keys if k != STEP]
    names: list[str] = []
    for name, value in keys:
        section, key = name.split(".")
        table = filled.get(section, {})
        taken = {"tolerance": _TARGETS, "order": _TARGETS}.get(key, (key,))
        if isinstance(table, Mapping) and not any(each in table for each in taken):
            filled[section] = {**table, key: value}
            names.append(name)
    return filled, frozenset(names)
