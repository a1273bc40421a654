"""The settings that a scene can be run with: one axis for each key that trades time for error."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from kc2spice.scene.model import Scene
from kc2spice.scene.settings import Rom

Values = Mapping[str, Any]  # scene keys with their values
Place = tuple[int, ...]  # of a setting: the position on each axis

OWN: Values = {}  # the scene as it is
# Factors on the scene's own value from coarse to fine, then those of the reference and of the run
# that checks it. 1 is the scene's own.
_FACTORS = {
    "solver.reltol": ((30.0, 10.0, 3.0, 1.0, 0.3, 0.1), 0.01, 0.03),
    "solver.chgtol": ((10.0, 1.0, 0.1), 0.01, 0.03),
    "solver.trtol": ((2.0, 1.0, 0.5), 0.25, 0.5),
    "solver.max_step": ((10.0, 3.0, 1.0, 0.3, 0.1), 0.1, 0.2),
    "catch.points": ((0.125, 0.25, 0.5, 1.0, 2.0), 4.0, 2.0),
}
_LIMITS = {
    "solver.reltol": (1e-7, 3e-2), "solver.chgtol": (1e-14, 1e-3), "solver.trtol": (1.0, 10.0),
    "solver.max_step": (0.0, float("inf")), "catch.points": (21, 2001),
}  # fmt: skip
_STATIC = ("solver.reltol", "catch.points")  # what acts without time steps


@dataclass(frozen=True)
class Axis:
    """``values`` from coarse to fine with the scene's own at ``own``; ``finest`` is the
    reference's value and ``finer`` the one that the reference is checked by.
    """

    name: str
    values: tuple[Values, ...]
    own: int
    finest: Values
    finer: Values


def axes(scene: Scene, *, transient: bool) -> tuple[Axis, ...]:
    """One axis for each key that ``scene`` has; steps in time count in a ``transient`` only."""
    found = []
    for key in _FACTORS:
        section, name = key.split(".")
        holder = (
            scene.parts[section].keys
            if section in scene.parts
            else getattr(scene.frame, section, None)
        )
        own = getattr(holder, name, None)
        if own is not None and (transient or key in _STATIC):
            found.append(_scaled(key, own))
    used = [part.type.reduction(part, scene) for part in scene.parts.values()]
    found += [_reduction(rom, transient) for rom in used if rom is not None][:1]
    return tuple(axis for axis in found if len(axis.values) > 1)


def _scaled(key: str, own: float) -> Axis:
    low, high = _LIMITS[key]
    factors, finest, finer = _FACTORS[key]

    def value(factor: float) -> Values:
        if isinstance(own, int):  # points: so many intervals
            return {key: int(min(max(1 + round(factor * (own - 1)), low), high))}
        return {key: _rounded(min(max(factor * own, low), high))}

    def best(factor: float) -> Values:
        found = value(factor)
        return OWN if found[key] == own else found

    before = [value(f) for f in factors[: factors.index(1.0)]]
    after = [value(f) for f in factors[factors.index(1.0) + 1 :]]
    coarser = _distinct(key, (v for v in before if _is_coarser(key, v[key], own)))
    finer_ = _distinct(key, (v for v in after if _is_coarser(key, own, v[key])))
    return Axis(key, (*coarser, OWN, *finer_), len(coarser), best(finest), best(finer))


def _rounded(value: float) -> float:
    return float(f"{value:.6g}")


def _is_coarser(key: str, one: float, other: float) -> bool:
    return one < other if key == "catch.points" else one > other


def _distinct(key: str, values: Iterator[Values]) -> list[Values]:
    return list({each[key]: each for each in values}.values())


def _reduction(rom: Rom, transient: bool) -> Axis:
    """Orders around the scene's own, or tolerances.

    Contact in a transient excites the device far above its band. There the order tells how wide a
    model is, and four times the default is within 4e-7 of any finer one; where a tolerance is what
    the scene asks for, its band grows as it falls.
    """
    if transient and rom.order is not None:
        order = rom.order
        below = [{"rom.order": n} for n in sorted({order // 2, 3 * order // 4}) if n > 0]
        above = [{"rom.order": n * order // 2} for n in (3, 4, 6)]
        return Axis("rom", (*below, OWN, *above), len(below), {"rom.order": 4 * order}, above[2])
    own, (low, high) = rom.tolerance or 1e-5, rom.band

    def value(factor: float, wider: float = 1.0) -> Values:
        band = [low, high * (wider if transient else 1.0)]
        return {"rom.tolerance": max(_rounded(factor * own), 1e-10), "rom.band": band}

    coarser = [value(factor) for factor in (100, 10) if factor * own < 0.5]
    finer = [value(0.1, 2.0), value(0.01, 4.0)]
    return Axis("rom", (*coarser, OWN, *finer), len(coarser), value(3e-3, 6.0), finer[1])


def next_to_own(found: Sequence[Axis]) -> tuple[Axis, ...]:
    """Axes cut down to the scene's own value, one coarser and one finer.

    The reference is then what checks that of the whole axes, where that is finer again, and is
    checked by all keys one finer.
    """
    kept = []
    for axis in found:
        first = max(axis.own - 1, 0)
        values = axis.values[first : axis.own + 2]
        finest = axis.finest if axis.finer == values[-1] else axis.finer
        kept.append(Axis(axis.name, values, axis.own - first, finest, values[-1]))
    return tuple(kept)


def own_place(found: Sequence[Axis]) -> Place:
    """Where the scene itself is."""
    return tuple(axis.own for axis in found)


def star(found: Sequence[Axis]) -> Iterator[Place]:
    """The scene as it is, with one key changed at a time, and with all of them finer."""
    own = own_place(found)
    yield own
    for k, axis in enumerate(found):
        for value in range(len(axis.values)):
            if value != axis.own:
                yield (*own[:k], value, *own[k + 1 :])
    for step in range(1, max(len(axis.values) - axis.own for axis in found)):
        yield tuple(min(axis.own + step, len(axis.values) - 1) for axis in found)


def neighbours(found: Sequence[Axis], place: Place, step: int) -> Iterator[Place]:
    """Places one value coarser (``step`` -1) or finer (+1) along each axis."""
    for k, axis in enumerate(found):
        if 0 <= place[k] + step < len(axis.values):
            yield (*place[:k], place[k] + step, *place[k + 1 :])


def settings(found: Sequence[Axis], place: Place) -> dict[str, Any]:
    """Keys that ``place`` changes, with their values."""
    return _merged(axis.values[k] for axis, k in zip(found, place, strict=True))


def reference_settings(found: Sequence[Axis]) -> tuple[dict[str, Any], dict[str, Any]]:
    """All keys at their finest, and those of the run that tells how well these have converged."""
    return _merged(axis.finest for axis in found), _merged(axis.finer for axis in found)


def _merged(parts: Iterator[Values]) -> dict[str, Any]:
    return {key: value for part in parts for key, value in part.items()}


def overrides(values: Values) -> list[str]:
    """``KEY=VALUE`` of each, as ``--set`` takes them."""
    return [f"{key}={value!r}" for key, value in values.items()]


def label(values: Values) -> str:
    """What is changed, in words."""
    return ", ".join(f"{key} {_short(value)}" for key, value in values.items()) or "as it is"


def _short(value: Any) -> str:
    if isinstance(value, list):
        return "…".join(f"{each:g}" for each in value)
    return f"{value:g}"
