"""The settings that a scene can be run with: values along its axes, from coarse to fine."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from kc2spice.scene.axes import Axis

Values = Mapping[str, Any]  # scene keys with their values
Place = tuple[int, ...]  # of a setting: the position on each axis

OWN: Values = {}  # the scene as it is
NOTCHES = (-2.0, -1.0, -0.5, 0.0, 0.5, 1.0)  # that are tried
CHECK, REFERENCE = 1.5, 2.0  # of the run that checks the reference, and of the reference


@dataclass(frozen=True)
class Line:
    """``values`` along an axis from coarse to fine with the scene's own at ``own``; ``finest`` is
    the reference's value and ``finer`` the one that the reference is checked by.
    """

    name: str
    values: tuple[Values, ...]
    own: int
    finest: Values
    finer: Values


def lines(found: Sequence[Axis]) -> tuple[Line, ...]:
    """One line for each axis that costs time of the simulator: a mesh costs none."""
    return tuple(_line(axis) for axis in found if not axis.model)


def _line(axis: Axis) -> Line:
    coarser = _distinct(axis.at(n) for n in NOTCHES if n < 0)
    finer = _distinct(axis.at(n) for n in NOTCHES if n > 0)
    values = (*coarser, OWN, *finer)
    return Line(axis.name, values, len(coarser), axis.at(REFERENCE), axis.at(CHECK))


def _distinct(values: Iterator[Values]) -> list[Values]:
    return list({str(each): each for each in values if each}.values())


def own_place(found: Sequence[Line]) -> Place:
    """Where the scene itself is."""
    return tuple(line.own for line in found)


def star(found: Sequence[Line]) -> Iterator[Place]:
    """The scene as it is, with one key changed at a time, and with all of them finer."""
    own = own_place(found)
    yield own
    for k, line in enumerate(found):
        for value in range(len(line.values)):
            if value != line.own:
                yield (*own[:k], value, *own[k + 1 :])
    for step in range(1, max(len(line.values) - line.own for line in found)):
        yield tuple(min(line.own + step, len(line.values) - 1) for line in found)


def neighbours(found: Sequence[Line], place: Place, step: int) -> Iterator[Place]:
    """Places one value coarser (``step`` -1) or finer (+1) along each axis."""
    for k, line in enumerate(found):
        if 0 <= place[k] + step < len(line.values):
            yield (*place[:k], place[k] + step, *place[k + 1 :])


def settings(found: Sequence[Line], place: Place) -> dict[str, Any]:
    """Keys that ``place`` changes, with their values."""
    return _merged(line.values[k] for line, k in zip(found, place, strict=True))


def reference_settings(found: Sequence[Line]) -> tuple[dict[str, Any], dict[str, Any]]:
    """All keys at their finest, and those of the run that tells how well these have converged."""
    return _merged(line.finest for line in found), _merged(line.finer for line in found)


def _merged(parts: Iterator[Values]) -> dict[str, Any]:
    return {key: value for part in parts for key, value in part.items()}


def overrides(values: Values) -> list[str]:
    """``KEY=VALUE`` of each, as ``--set`` takes them."""
    return [f"{k}={v if isinstance(v, str) else repr(v)}" for k, v in values.items()]


def label(values: Values) -> str:
    """What is changed, in words."""
    return ", ".join(f"{key} {_short(value)}" for key, value in values.items()) or "as it is"


def _short(value: Any) -> str:
    if isinstance(value, list):
        return "…".join(f"{each:g}" for each in value)
    return value if isinstance(value, str) else f"{value:g}"
