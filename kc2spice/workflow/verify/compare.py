"""How far two solutions of a scene are apart: by the gates of its parts, in metrics and waves."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kc2spice.core.waveforms import Waveforms
from kc2spice.report.words import unit_of
from kc2spice.scene.judge import Check, Gate
from kc2spice.scene.parttype import Build
from kc2spice.workflow.judge import metrics

LOADED = 1e-6  # of the largest value: below, a relative error says nothing
STILL = 1e-9  # of its size: what rests moves less, by rounding alone
NOTHING = 1e-150  # its square is zero: what rounding leaves of no current
SMALL = 1e-3  # of the largest wave of its unit: smaller metrics are judged by that


@dataclass(frozen=True)
class Solution:
    """Waves of one solution path with their metrics."""

    waves: Waveforms
    metrics: Mapping[str, Any]


@dataclass(frozen=True)
class OutputError:
    """Largest and rms error of one wave of one pair of solutions, relative to its largest and its
    rms value."""

    pair: str
    output: str
    largest: float
    rms: float


def solution(waves: Waveforms, build: Build) -> Solution:
    """A solution with those metrics of the scene's parts and probes that its waves tell."""
    return Solution(waves, metrics(waves, build, partial=True))


def gate_limits(
    gates: Iterable[tuple[str, Gate]], pair: str, ours: Solution, exact: Solution
) -> tuple[list[Check], float | None]:
    """Every gate of this pair, and the largest value of those that stand for the scene.

    ``gates`` are by the part that has them: of a metric that several parts have each judges its
    own.
    """
    limits, leading = [], []
    words = pair.replace("rom", "ROM").replace("fom", "full model").replace("_vs_", " to ")
    for part, each in gates:
        own = f"{part}.{each.of}"
        gate = replace(each, of=own) if own in exact.metrics else each
        value = measured(gate, ours, exact)
        if value is _ABSENT:
            continue
        if pair in gate.limits:
            name = f"{gate.words}, {words}"
            reached = math.nan if value is None else value
            limits.append(Check(name, reached, gate.limits[pair], gate.unit))
        if gate.leads and value is not None:
            leading.append(value)
    return limits, max(leading, default=None)


_ABSENT: Any = object()


def measured(gate: Gate, ours: Solution, exact: Solution) -> float | None:
    """The difference that a gate asks for; None where one of both has not reached it."""
    if gate.of in exact.metrics:
        a, b = ours.metrics.get(gate.of), exact.metrics[gate.of]
        if a is None and b is None:  # neither has it, such as the launch of what never leaves
            return _ABSENT
        if a is None or b is None:
            return None
        return abs(a - b) if gate.measure == "absolute" else abs(a / b - 1.0)
    names = sorted(fnmatch.filter(set(ours.waves) & set(exact.waves), gate.of))
    if not names:
        return _ABSENT
    pairs = [_aligned(ours.waves, exact.waves, name)[1:] for name in names]
    if gate.share < 1.0:
        scale = next(iter(exact.waves.data.values()))
        low = scale <= gate.share * scale[-1]
        pairs = [(a[low], b[low]) for a, b in pairs]
    if gate.measure == "spectral":
        from kc2spice.rom.response import relative_error  # which loads scipy; every run is here

        return relative_error(*(np.stack(each, axis=1) for each in zip(*pairs, strict=True)))
    if gate.measure == "relative":
        return max(_each(a, b) for a, b in pairs)
    apart = max(float(np.abs(a - b).max()) for a, b in pairs)
    if gate.measure == "absolute":
        return apart
    size = max(float(np.abs(b).max()) for _, b in pairs)
    if gate.measure == "travel":
        size = max(STILL * size, *(float(np.ptp(b)) for _, b in pairs))
    # of what is zero throughout, nothing is no share and all else has none
    return apart / size if size else math.inf if apart else 0.0


def _each(a: np.ndarray, b: np.ndarray) -> float:
    """Largest difference of a value by its own size."""
    size = np.abs(b)
    loaded = size > LOADED * size.max()
    return float((np.abs(a - b)[loaded] / size[loaded]).max(initial=0.0))


def _aligned(
    waves: Waveforms, exact: Waveforms, name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The points that both cover, those of the coarser one, and a wave of both there."""
    if "time" not in waves:
        return np.arange(float(waves[name].size)), waves[name], exact[name]
    t, s = (np.unique(each["time"]) for each in (waves, exact))
    at = t if t.size <= s.size else s
    at = at[(at >= max(t[0], s[0])) & (at <= min(t[-1], s[-1]))]
    return at, _at(at, waves, name), _at(at, exact, name)


def _at(at: np.ndarray, waves: Waveforms, name: str) -> np.ndarray:
    """A wave at times ``at``: a height with its velocity by cubics, others by straight lines."""
    t, kept = np.unique(waves["time"], return_index=True)
    stem, _, last = name.rpartition(".")
    if last in ("y", "x") and f"{stem}.v" in waves and t.size > 1:
        from scipy.interpolate import CubicHermiteSpline

        return np.asarray(CubicHermiteSpline(t, waves[name][kept], waves[f"{stem}.v"][kept])(at))
    return np.interp(at, t, waves[name][kept])


def output_errors(pair: str, waves: Waveforms, exact: Waveforms) -> list[OutputError]:
    """Every wave that both have; those that never move are left out.

    The rms is one over time: points that a solver crowds into a contact weigh what they last.
    """
    found = []
    scale = next(iter(exact.data))
    for name in exact.data:
        if name == scale or name not in waves:
            continue
        at, a, b = _aligned(waves, exact, name)
        size = float(np.abs(b).max(initial=0.0))
        if size <= max(_resting(name, exact), NOTHING):
            continue
        error = np.abs(a - b)
        power = (
            np.trapezoid(np.abs(x) ** 2, at) if at.size > 1 else np.abs(x).max() ** 2
            for x in (error, b)
        )
        rms = math.sqrt(float(np.divide(*power)))
        found.append(OutputError(pair, name, float(error.max()) / size, rms))
    return found


def _resting(name: str, waves: Waveforms) -> float:
    """Speed [m/s] below which a velocity is what rounding makes of a position at rest; else 0."""
    stem, _, last = name.rpartition(".")
    place = next((waves[n] for n in (f"{stem}.y", f"{stem}.x") if n in waves), None)
    if last != "v" or place is None or "time" not in waves:
        return 0.0
    return STILL * float(np.abs(place).max()) / float(np.ptp(waves["time"]))


def metric_errors(
    ours: Solution, exact: Solution, units: Mapping[str, str]
) -> Iterator[tuple[str, float | None]]:
    """Each number that both have, by its size or by ``SMALL`` of the largest wave of its unit; a
    difference to zero without such a wave as it stands."""
    for name, b in exact.metrics.items():
        if name not in ours.metrics or isinstance(b, bool):
            continue
        a = ours.metrics[name]
        if b is None and a is None:
            continue
        if a is None or b is None:
            yield name, None
            continue
        try:
            x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
        except (TypeError, ValueError):
            continue
        if x.shape != y.shape or x.size == 0:
            continue
        base = max(float(np.abs(y).max()), SMALL * _largest(name, exact.waves, units))
        yield name, float(np.abs(x - y).max()) / (base or 1.0)


def _largest(name: str, waves: Waveforms, units: Mapping[str, str]) -> float:
    """The largest wave of the unit that a metric's name ends with; for times their span.

    A metric without a unit, such as a coupling, has no such wave: a frequency would excuse any.
    """
    unit = unit_of(name).replace("Ω", "Ohm")
    if not unit:
        return 0.0
    if unit == "s" and "time" in waves:
        return float(np.ptp(waves["time"]))
    sizes = [float(np.abs(v).max()) for k, v in waves.data.items() if units.get(k) == unit]
    return max(sizes, default=0.0)
