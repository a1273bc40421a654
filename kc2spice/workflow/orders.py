"""A larger order of a reduced body, where a transient shows that its error is too large.

A run compares each reduced body with a model of more states under the loads that it recorded (see
:mod:`kc2spice.rom.enriched`). Those loads also judge larger orders, each by a reduction alone. The
scene runs once more with the order that has the smallest error, and the better run is the result.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from shutil import copytree
from tempfile import TemporaryDirectory
from typing import Any

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.progress import Clock
from kc2spice.parts._box import varied
from kc2spice.parts._linear_body import LinearBody, reduction_target
from kc2spice.rom.linear_model import LinearModel
from kc2spice.scene.checks import Check
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Part
from kc2spice.workflow.decks import prepared
from kc2spice.workflow.simulate import Run, simulate_deck

MULTIPLES = (2, 4)  # factors of the order of the scene, tried until the error is within its limit
MOST_STATES = 200  # states of a larger model; every state adds time to each simulator step
SMALLER = 0.7  # largest ratio of errors, new to present, that is worth another run


@dataclass(frozen=True)
class Larger:
    """A larger order of a body: the ``keys`` of the scene that set it, and its ``states`` and
    ``error`` under the loads of the run, beside those of the present model."""

    part: str
    keys: dict[str, Any]
    states: tuple[int, int]
    error: tuple[float, float]
    limit: float

    def __str__(self) -> str:
        (before, after), (error, smaller) = self.states, self.error
        keys = ", ".join(f"{key} = {value}" for key, value in self.keys.items())
        return (
            f"reduction of {self.part}: under the loads of this run a model of {before} states has "
            f"an error of {error:.2%}, more than {self.limit:.2%}, and one of {after} states "
            f"{smaller:.2%}: run again with {keys}"
        )


def with_larger_orders(run: Run, work: Path, clock: Clock) -> Run:
    """Run the scene of ``run`` again with larger orders where its own loads ask for these.

    Returns the run whose reduced bodies have the smaller error. The files of that run are in the
    directory ``work``. Prints the orders and their errors as warnings.
    """
    build, chosen = run.build, list(_larger_orders(run, clock))
    if not chosen:
        return run
    for item in chosen:
        warnings.warn(str(item), stacklevel=3)
    scene = load_scene(build.scene, {k: v for item in chosen for k, v in item.keys.items()})
    with TemporaryDirectory() as folder:
        try:
            again, deck = prepared(scene, clock, trust=build.trust, functions=build.functions)
            with clock.stage("simulate", "with more states") as share:
                result = simulate_deck(again, deck, Path(folder), progress=share)
        except (SimulationError, UsageError) as error:
            message = f"the run with more states failed: {error.message}; "
            message += "the result is that of the first run"
            warnings.warn(message, stacklevel=3)
            return run
        names = [item.part for item in chosen]
        before, after = _largest_error(run, names), _largest_error(result, names)
        if after >= before:
            message = f"the run with more states has an error of {after:.2%} under its own loads, "
            message += f"not less than {before:.2%}; the result is that of the first run"
            warnings.warn(message, stacklevel=3)
            return run
        copytree(folder, work, dirs_exist_ok=True)
    return result


def _larger_orders(run: Run, clock: Clock) -> Iterator[Larger]:
    """The order to take for each body whose error under the recorded loads is too large."""
    checks = {check.name: check for check in run.verdict.checks if check.loaded}
    for part in run.build.scene.parts.values():
        check = checks.get(f"reduction of {part.name}")
        if check is None or check.passed or varied(part):  # a box of parameters has no order
            continue
        found = _larger_order(run, part, check, clock)
        if found is not None:
            yield found


def _larger_order(run: Run, part: Part, check: Check, clock: Clock) -> Larger | None:
    """The smallest multiple of its order that is within the limit of ``check``, or the one with the
    least error; None where none is better than the present order."""
    build, kind = run.build, part.type
    assert isinstance(kind, LinearBody)
    model, target = build.model(part, LinearModel), reduction_target(part, build.scene)
    assert model.certificate is not None
    order, key = target.order or model.order, f"{part.name}.rom"
    common: dict[str, Any] = {f"{key}.band": list(model.certificate.band_hz)}
    if target.norm is not None:
        common[f"{key}.norm"] = target.norm
    least, result = SMALLER * check.value, None
    for multiple in MULTIPLES:
        keys = {f"{key}.order": multiple * order, **common}
        try:
            scene = load_scene(build.scene, keys)
            larger = kind.build(scene.parts[part.name], scene, clock)
        except (SimulationError, UsageError):
            break  # the body has no more states
        if larger is None or not model.order < larger.order <= MOST_STATES:
            break
        found = kind.error_under_load(part, build, run.waves, larger)
        if found is not None and found[0] < least:
            least, states = found[0], (model.order, larger.order)
            result = Larger(part.name, keys, states, (check.value, least), check.limit)
        if least <= check.limit:
            break
    return result


def _largest_error(run: Run, names: Sequence[str]) -> float:
    """Largest error of the reduced bodies ``names`` under the loads that ``run`` recorded."""
    result = 0.0
    for name in names:
        part = run.build.scene.parts[name]
        assert isinstance(part.type, LinearBody)
        model = run.build.model(part, LinearModel)
        found = part.type.error_under_load(part, run.build, run.waves, model)
        result = max(result, math.inf if found is None else found[0])
    return result
