"""Differences between two solutions of a scene, and checks against error limits."""

from __future__ import annotations

import fnmatch
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import starmap
from typing import Any

import numpy as np

from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.power_waveforms import add_powers
from kc2spice.scene.checks import Check, Gate
from kc2spice.scene.metrics import compute_metrics
from kc2spice.scene.results import collect_powers
from kc2spice.scene.scene_classes import BuiltScene
from kc2spice.workflow.simulation import correct_waves

# Relative errors are computed only for values above this fraction of the largest value.
MIN_REFERENCE_SHARE = 1e-6
# largest motion at rest due to rounding errors, as a fraction of the body's size
REST_MOTION = 1e-9
ZERO_CURRENT = 1e-150  # smaller currents count as zero, because their squares underflow
# If a waveform of ngspice is exactly zero, such as the displacement of a clamped pin, smaller
# values in SI units count as rounding errors of the other solution.
ROUNDED_ZERO = 1e-18
# The error of a metric is divided by at least MIN_METRIC_SHARE times the largest waveform value in
# the unit of the metric.
MIN_METRIC_SHARE = 1e-3


@dataclass(frozen=True)
class Solution:
    """Solution of a scene: waveforms, metrics and units."""

    waves: Waveforms
    metrics: Mapping[str, Any]
    units: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class OutputDeviation:
    """Relative difference of one waveform between two solutions.

    ``largest`` is the largest difference, relative to the largest magnitude of the waveform.
    ``rms`` is the rms difference, relative to the rms value of the waveform.
    """

    pair: str
    output: str
    largest: float
    rms: float


def complete_solution(waves: Waveforms, build: BuiltScene) -> Solution:
    """Return a solution with the powers and metrics that follow from its waveforms."""
    waves, known = correct_waves(waves, build), {}
    for name, terms in collect_powers(build, waves.data).items():
        if all(term.result_names <= set(waves) for term in terms):
            known[name] = terms
    waves = add_powers(waves, known)
    found = compute_metrics(waves, build, partial=True)
    return Solution(waves, found.values, found.units)


def list_gate_checks(
    gates: Iterable[tuple[str, Gate]], pair: str, ours: Solution, exact: Solution
) -> tuple[list[Check], float | None]:
    """Compare two solutions; return a check for each error limit in ``gates``.

    The second result is the largest difference among all gates with ``is_main = True``. A
    verification records this difference as the error of the pair of solutions.

    ``gates`` contains pairs of a part's name and a gate, which is the error limit of one result. If
    several parts have the same metric, each gate applies to the metric of its part.
    """
    limits, leading = [], []
    words = pair.replace("rom", "ROM").replace("fom", "full model").replace("_vs_", " versus ")
    solutions = words.replace("ROM", "reduced model")
    for part, item in gates:
        wave = f"{part}.{item.result}"
        gate = replace(item, result=wave) if wave in exact.metrics else item
        value = compute_gate_difference(gate, ours, exact)
        if value is None:
            continue
        if pair in gate.limits:
            limits.append(
                Check(
                    f"{gate.description}, {words}",
                    value,
                    gate.limits[pair],
                    gate.unit if gate.measure == "absolute" else "relative",
                    label=f"{_describe_measure(gate)} of {gate.description}, {solutions}",
                )
            )
        if gate.is_main and not math.isnan(value):
            leading.append(value)
    return limits, max(leading, default=None)


def _describe_measure(gate: Gate) -> str:
    """Return ``relative error`` or ``error``, depending on the measure of a gate.

    The measures *travel* and *largest* return ``error``, because the description of the gate states
    the reference value.
    """
    return "relative error" if gate.measure in ("relative", "spectral") else "error"


def compute_gate_difference(gate: Gate, ours: Solution, exact: Solution) -> float | None:
    """Compute how much two solutions differ in the result named by a ``verify`` gate.

    ``gate.result`` is the name of the compared metric or waveform.

    A solution can lack the value, such as the launch velocity of a body that is not launched. If
    both solutions lack the value, the result is None. If one solution lacks the value, the result
    is nan.
    """
    if gate.result in exact.metrics:
        a, b = ours.metrics.get(gate.result), exact.metrics[gate.result]
        if a is None or b is None:
            return None if a is b else math.nan
        return abs(a - b) if gate.measure == "absolute" else abs(a / b - 1.0)
    names = sorted(fnmatch.filter(set(ours.waves) & set(exact.waves), gate.result))
    if not names:
        return None
    return _compute_wave_difference(gate, ours.waves, exact.waves, names)


def _compute_wave_difference(
    gate: Gate, waves: Waveforms, exact: Waveforms, names: Sequence[str]
) -> float:
    """Return the largest waveform difference of two solutions, absolute or relative.

    ``gate`` is the error limit. ``names`` are the names of the compared waveforms. ``gate.measure``
    states whether the difference is absolute or relative. ``gate.measure`` also determines the
    divisor of a relative difference (:class:`kc2spice.scene.checks.Gate`).
    """
    early = exact.scale <= gate.share * exact.scale[-1] if gate.share < 1.0 else slice(None)
    pairs = []
    for name in names:
        _, a, b = sample_wave_at_common_times(waves, exact, name)
        pairs.append((a[early], b[early]))
    if gate.measure == "relative":
        return max(starmap(_find_largest_relative_change, pairs))
    # arrays of shape (points, waves)
    ours, true = (np.stack(wave, axis=1) for wave in zip(*pairs, strict=True))
    if gate.measure == "spectral":
        # imported here, because scipy loads slowly and every run imports this module
        from kc2spice.rom.error_estimate import compute_relative_error

        return compute_relative_error(ours, true)
    largest = float(np.abs(ours - true).max())
    if gate.measure == "absolute":
        return largest
    size = float(np.abs(true).max())
    if gate.measure == "travel":
        size = max(REST_MOTION * size, float(np.ptp(true, axis=0).max()))
    # relative to a reference of zero, any difference is infinite
    return largest / size if size else math.inf if largest else 0.0


def _find_largest_relative_change(a: np.ndarray, b: np.ndarray) -> float:
    """Return the largest relative difference between the values of two waveforms.

    The difference is relative to the magnitudes in ``b``.
    """
    size = np.abs(b)
    loaded = size > MIN_REFERENCE_SHARE * size.max()
    return float((np.abs(a - b)[loaded] / size[loaded]).max(initial=0.0))


def sample_wave_at_common_times(
    waves: Waveforms, exact: Waveforms, name: str
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sample one waveform of two solutions at common time points.

    Return the time points and the samples of both solutions. The function uses the time points of
    the coarser solution, within the time range that both solutions contain. Solutions without times
    are not interpolated: the function then returns the indices of the points, and both waveforms.
    """
    if "time" not in waves:
        return np.arange(float(waves[name].size)), waves[name], exact[name]
    t, s = np.unique(waves["time"]), np.unique(exact["time"])
    times = t if t.size <= s.size else s
    times = times[(times >= max(t[0], s[0])) & (times <= min(t[-1], s[-1]))]
    return times, _interpolate_wave(times, waves, name), _interpolate_wave(times, exact, name)


def _interpolate_wave(times: np.ndarray, waves: Waveforms, name: str) -> np.ndarray:
    """Interpolate a waveform at other time points.

    A displacement with a known velocity is interpolated by cubic polynomials, and any other wave
    linearly.
    """
    t, unique = np.unique(waves["time"], return_index=True)
    stem, _, last = name.rpartition(".")
    if last in ("y", "x") and f"{stem}.v" in waves and t.size > 1:
        from scipy.interpolate import CubicHermiteSpline

        spline = CubicHermiteSpline(t, waves[name][unique], waves[f"{stem}.v"][unique])
        return np.asarray(spline(times))
    return np.interp(times, t, waves[name][unique])


def compute_output_errors(pair: str, waves: Waveforms, exact: Waveforms) -> list[OutputDeviation]:
    """Return the error of every waveform that both solutions contain.

    Waves that are zero within rounding errors are left out. The rms error is an integral over time,
    because a mean over points would overweight the closely spaced points at a contact.
    """
    result = []
    scale = next(iter(exact.data))
    for name in exact.data:
        if name == scale or name not in waves:
            continue
        points, a, b = sample_wave_at_common_times(waves, exact, name)
        size = float(np.abs(b).max(initial=0.0))
        if size <= max(_estimate_rounding_speed(name, exact), ZERO_CURRENT):
            continue
        if not a.any() and size <= ROUNDED_ZERO:
            continue
        error = np.abs(a - b)
        ratio = np.divide(_integrate_square(error, points), _integrate_square(b, points))
        result.append(
            OutputDeviation(pair, name, float(error.max()) / size, math.sqrt(float(ratio)))
        )
    return result


def _integrate_square(values: np.ndarray, points: np.ndarray) -> float:
    """Integrate the squared magnitude of a waveform.

    For a single point, the result is the squared magnitude.
    """
    if points.size > 1:
        return float(np.trapezoid(np.abs(values) ** 2, points))
    return float(np.abs(values).max() ** 2)


def _estimate_rounding_speed(name: str, waves: Waveforms) -> float:
    """Return the speed [m/s] that rounding errors cause in a body at rest.

    The result is 0 for waves that are not velocities.
    """
    stem, _, last = name.rpartition(".")
    position = next(filter(waves.data.__contains__, (f"{stem}.y", f"{stem}.x")), None)
    if last != "v" or position is None or "time" not in waves:
        return 0.0
    return REST_MOTION * float(np.abs(waves[position]).max()) / float(np.ptp(waves["time"]))


def list_metric_errors(
    ours: Solution, exact: Solution, units: Mapping[str, str]
) -> Iterator[tuple[str, float | None]]:
    """Yield the relative error of each metric that both solutions contain.

    The error of a metric is divided by the magnitude of the exact metric, but at least by 0.1 % of
    the largest waveform value in the unit of the metric. ``MIN_METRIC_SHARE`` contains the share
    of 0.1 %. If the divisor is zero, the function yields the absolute difference of both metrics.
    """
    for name, b in exact.metrics.items():
        if name not in ours.metrics or isinstance(b, bool):
            continue
        a = ours.metrics[name]
        if a is None or b is None:
            if a is not b:
                yield name, None
            continue
        try:
            x, y = np.asarray(a, dtype=float), np.asarray(b, dtype=float)
        except (TypeError, ValueError):
            continue
        if x.shape != y.shape or x.size == 0:
            continue
        largest = _find_largest_with_unit(exact.units.get(name, ""), exact.waves, units)
        base = max(float(np.abs(y).max()), MIN_METRIC_SHARE * largest)
        yield name, float(np.abs(x - y).max()) / (base or 1.0)


def _find_largest_with_unit(unit: str, waves: Waveforms, units: Mapping[str, str]) -> float:
    """Return the largest value of all waveforms that have a given unit.

    For the unit ``"s"``, the result is the duration of the simulated time range. If ``unit`` is
    empty, as for a coupling factor, the result is 0, because no waveform is comparable with a
    number without a unit.
    """
    if not unit:
        return 0.0
    if unit == "s" and "time" in waves:
        return float(np.ptp(waves["time"]))
    largest = 0.0
    for name, values in waves.data.items():
        if units.get(name) == unit:
            largest = max(largest, float(np.abs(values).max()))
    return largest
