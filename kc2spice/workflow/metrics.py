"""Results of a run: metrics, checks and energy balances of the parts and probes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from typing import Any, NamedTuple

import numpy as np

from kc2spice.core.errors import UsageError, unknown
from kc2spice.core.sound_level import GAS_REFERENCE, SoundLevel, compute_level
from kc2spice.core.waveforms import SCALES, Waveforms, interpolate
from kc2spice.report.html import flatten_mapping
from kc2spice.scene.checks import Balance, Check, Gate, Metric, Verdict
from kc2spice.scene.model import Build, Scene
from kc2spice.scene.results import NOISE_WAVE
from kc2spice.scene.settings import Probe
from kc2spice.workflow import noise_analysis
from kc2spice.workflow.time_step import list_step_checks

# largest relative correction of a maximum between points: 3 % at a distance of half a half-width
MAX_CORRECTION = 0.05
SCALE_ROUNDING = 1e-9  # relative rounding error of the ends of the scale in the simulator
# relative change of the height of a flight for a relative change of the velocity
HEIGHT_PER_VELOCITY = 2.0
# share of error_budget that an energy balance may miss, a tenth of the share of time steps
BALANCE_SHARE = 0.03


def list_checks(waves: Waveforms, build: Build) -> Verdict:
    """Return the checks of the parts of a scene, except checks that the scene turns off.

    A larger error_budget raises the limits of all energy balances by the same factor.
    """
    scene = build.scene
    checks: list[Check] = []
    balances: dict[str, Balance] = {}
    gates: list[tuple[str, Gate]] = []
    for name, part in scene.parts.items():
        for row in part.type.checks(part, build, waves) if name not in build.unjudged else ():
            if isinstance(row, Check):
                checks.append(row)
            elif isinstance(row, Balance):
                balances[name] = row
            else:
                gates.append((name, row))
    checks += (
        noise_analysis.noise_checks(waves)
        if build.has_noise
        else list_step_checks(build, waves, balances)
    )
    if scene.checks.energy == "off":
        balances = {}
    slack = max(1.0, BALANCE_SHARE * (scene.error_budget or 0.0) / 1e-4)
    checks += [
        Check(
            f"energy of {name}",
            result.share,
            slack * result.limit,
            "of the energy exchanged",
            result.advice,
            scene.checks.energy,
            coarse=True,
        )
        for name, result in balances.items()
    ]
    active = tuple(check for check in with_undecided(checks) if check.action != "off")
    return Verdict(active, tuple(balances.items()), tuple(gates))


def with_undecided(checks: Sequence[Check]) -> Iterator[Check]:
    """Yield all checks, and a warning for each check that errors of reduced bodies may decide.

    A relative error e of the launch velocity v changes the height of a flight, v^2 / 2 g, by the
    relative amount 2 e. An outcome is undecided if the distance of the motion from its limit is
    smaller than this.
    """
    error = max((check.value for check in checks if check.loaded), default=0.0)
    for check in checks:
        change = HEIGHT_PER_VELOCITY * error * check.travel
        if check.distance >= change:
            yield check
            continue
        side = "within" if check.passed else "beyond"
        advice = (
            f"the motion ends {check.distance:.3g} {check.unit} {side} its limit, nearer than the "
            f"estimated error of reduced bodies ({error:.2%}) moves it: the outcome is not decided"
        )
        if check.passed:
            yield check
            name = f"{check.name} undecided"
            yield Check(name, change, check.distance, check.unit, advice, "warn")
        else:
            yield replace(check, advice=f"{check.advice}; {advice}")


class Metrics(NamedTuple):
    """Metrics, and SI units of the metrics with a unit, keyed by dotted name."""

    values: dict[str, Any]
    units: dict[str, str]


def compute_metrics(waves: Waveforms, build: Build, *, partial: bool = False) -> Metrics:
    """Return the metrics of probes and parts; for ``partial`` waves, those that exist.

    A name that several parts have gets the part's name in front: ``left.kick_stroke_m``.
    """
    rows = _metrics(waves, build, partial=partial)
    units = {name: item.unit for name, item in flatten_mapping(rows) if isinstance(item, Metric)}
    return Metrics(_metric_values(rows), {name: unit for name, unit in units.items() if unit})


def _metric_values(rows: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values of metrics, in the same tables."""
    result: dict[str, Any] = {}
    for name, item in rows.items():
        value = item.value if isinstance(item, Metric) else item
        result[name] = _metric_values(value) if isinstance(value, Mapping) else value
    return result


def _metrics(waves: Waveforms, build: Build, *, partial: bool) -> dict[str, Any]:
    """Return records of metrics by name."""
    scene, result = build.scene, dict[str, Mapping[str, Any]]()
    for part in scene.parts.values():
        with suppress(*([KeyError] if partial else [])):
            result[part.name] = part.type.metrics(part, build, waves)
    count = Counter(chain.from_iterable(result.values()))
    records: dict[str, Any] = {}
    for part_name, item in result.items():
        for name, value in item.items():
            records[name if count[name] == 1 else f"{part_name}.{name}"] = value
    records |= noise_analysis.noise_metrics(waves, build) if NOISE_WAVE in waves else {}
    probed: dict[str, Any] = {}
    for name, probe in scene.probes.items():
        window = window_of(probe, scene)
        if not partial or _covers_probe(probe, waves, window):
            unit = _probe_unit(probe, build, waves)
            probed[name] = Metric(
                evaluate_probe(probe, waves, name, window, _level_reference(probe, build)), unit
            )
    return {**probed, **{name: value for name, value in records.items() if name not in probed}}


def _covers_probe(probe: Probe, waves: Waveforms, window: tuple[float, float] | None) -> bool:
    """Return whether the waves of an early end contain everything that a probe reads."""
    low, high = waves.scale.real.min(), waves.scale.real.max()
    places = [*probe.places.values(), *(filter(math.isfinite, window or ()))]
    return probe.of in waves and all(low <= place <= high for place in places)


def _probe_unit(probe: Probe, build: Build, waves: Waveforms) -> str:
    """Return the SI unit of what a probe reads from a wave."""
    scale = SCALES.get(next(iter(waves)), "")
    if build.dc_sweep is not None:
        scale = build.dc_sweep.unit
    along = {"argmax": scale, "crossing": scale, "frequency": "Hz", "spl": "dB"}
    return along.get(probe.take, build.results.units.get(probe.of, SCALES.get(probe.of, "")))


def _level_reference(probe: Probe, build: Build) -> float:
    """Return the rms pressure [Pa] at 0 dB of the result of a probe."""
    result = build.results.vectors.get(probe.of)
    return (result.level_reference if result else None) or GAS_REFERENCE


def read_levels(build: Build, metrics: Mapping[str, Any]) -> dict[str, SoundLevel]:
    """Return the sound pressure levels of probes among the ``metrics`` of a run."""
    result = {}
    for name, probe in build.scene.probes.items():
        if probe.take == "spl":
            result[name] = SoundLevel(_level_reference(probe, build), metrics.get(name))
    return result


def window_of(probe: Probe, scene: Scene) -> tuple[float, float] | None:
    """Return the first and the last place on the scale that a probe reads.

    The result is None if the probe reads the whole scale.
    """
    if probe.periods is not None:
        return scene.stop - probe.periods * (scene.period or 0.0), scene.stop
    if probe.from_ is None and probe.to is None:
        return None
    first = -math.inf if probe.from_ is None else probe.from_
    return first, math.inf if probe.to is None else probe.to


def _clip_to_window(
    scale: np.ndarray, values: np.ndarray, window: tuple[float, float], name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return the points within a window, with its ends on the straight lines between them.

    Raises
    ------
    UsageError : an end of the window is not on the scale.
    """
    direction = -1 if scale[0] > scale[-1] else 1
    scale, values = scale[::direction], values[::direction]
    for key, end in zip(("from", "to"), window, strict=True):
        if math.isfinite(end) and not _is_on_scale(scale, end):
            raise _make_outside_error(name, key, end, scale)
    low, high = max(window[0], scale[0]), min(window[1], scale[-1])
    inside = (scale > low) & (scale < high)
    at = np.concatenate([[low], scale[inside], [high]])
    ends = np.interp([low, high], scale, values)
    read = np.concatenate([ends[:1], values[inside], ends[1:]])
    return at[::direction], read[::direction]


def evaluate_probe(
    probe: Probe,
    waves: Waveforms,
    name: str,
    window: tuple[float, float] | None = None,
    reference: float = GAS_REFERENCE,
) -> float | None:
    """Return the value of a probe; None if there is no crossing or cycle.

    With a ``window``, values outside of it are ignored. Sound pressure levels refer to the rms
    pressure ``reference`` [Pa].

    Raises
    ------
    UsageError : the run does not contain the vector.
    """
    if probe.of in waves:
        scale, values = waves.scale.real, waves[probe.of]
        if probe.take != "spl":
            return _evaluate_wave(probe, scale, values, name, window)
        rms = _evaluate_wave(_rms_probe(probe, values), scale, values, name, window)
        # the amplitude of a sine is the square root of two times its rms value
        share = math.sqrt(0.5) if np.iscomplexobj(values) else 1.0
        return float(compute_level(np.asarray(share * (rms or 0.0)), reference))
    known = list(waves.data)[1:]
    raise unknown("the run has no such result", probe.of, known, f"key probes.{name}.of")


def _rms_probe(probe: Probe, values: np.ndarray) -> Probe:
    """Return the probe of the amplitude or of the rms value whose level a probe computes."""
    if not np.iscomplexobj(values):
        return probe.model_copy(update={"take": "rms"})
    return probe.model_copy(update={"take": "max" if probe.at is None else "value"})


def _evaluate_wave(
    probe: Probe,
    scale: np.ndarray,
    values: np.ndarray,
    name: str,
    window: tuple[float, float] | None,
) -> float | None:
    """Return the value of a probe at its place on the scale, or in its window."""
    if probe.at is None:
        if window is not None:
            scale, values = _clip_to_window(scale, values, window, name)
        return _evaluate_range(probe, scale, values)
    return _interpolate_value(scale, values, probe.at, name)


def _evaluate_range(probe: Probe, scale: np.ndarray, values: np.ndarray) -> float | None:
    """Return the value of a probe over all points of a wave."""
    if np.iscomplexobj(values) and probe.take in ("max", "argmax"):
        place, largest = response_maximum(scale.real, np.abs(values))
        return largest if probe.take == "max" else place
    if np.iscomplexobj(values) and probe.take == "min":
        return response_minimum(scale.real, np.abs(values))
    sizes = np.abs(values) if np.iscomplexobj(values) else values
    result = _PROBE_FUNCTIONS[probe.take](scale, sizes, float(probe.level or 0.0))
    return None if result is None else float(result)


def response_maximum(frequency: np.ndarray, size: np.ndarray) -> tuple[float, float]:
    """Return place and value of the largest magnitude of a response, also between points.

    Near the pole ``a + j w0`` a response is ``R / (j w - a - j w0)``. Then ``1 / |y|^2`` is a
    parabola in ``w``, which three points determine:

        1 / |y|^2 = ((w - w0)^2 + a^2) / |R|^2

    The largest point itself is returned at the ends of the range, and where the parabola exceeds it
    by more than :data:`MAX_CORRECTION`: the points are then too far apart.

    >>> w = np.array([9.0, 10.1, 11.2])
    >>> place, value = response_maximum(w, np.abs(1 / (1j * (w - 10) + 1)))
    >>> print(f"{place:.6f} {value:.6f}")
    10.000000 1.000000
    """
    k = int(size.argmax())
    place, largest = float(frequency[k]), float(size[k])
    if not 0 < k < size.size - 1 or not size[k - 1 : k + 2].all():
        return place, largest
    # 1/|y|^2 = (1 + linear x + square x^2) / largest^2 at the distance x from the largest point
    x = frequency[[k - 1, k + 1]] - place
    slopes = ((largest / size[[k - 1, k + 1]]) ** 2 - 1) / x
    square = (slopes[1] - slopes[0]) / (x[1] - x[0])
    linear = slopes[1] - square * x[1]
    least = 1 - linear**2 / (4 * square) if square > 0 else 0.0
    if least < 1 / (1 + MAX_CORRECTION) ** 2:
        return place, largest
    return float(place - linear / (2 * square)), float(largest / math.sqrt(least))


def response_minimum(frequency: np.ndarray, size: np.ndarray) -> float:
    """Return the smallest magnitude of a frequency response, also between its points.

    Near a zero the reciprocal of a response has a pole.
    """
    return 1 / response_maximum(frequency, 1 / size)[1] if size.all() else 0.0


def mean_frequency(scale: np.ndarray, values: np.ndarray) -> float | None:
    """Return the mean rate at which ``values`` rise through their mean in the last half.

    None with fewer than two crossings.
    """
    late = np.abs(scale - scale[0]) >= np.ptp(scale) / 2
    x, y = scale[late], values[late]
    y = y - _time_average(x, y)
    k = np.flatnonzero((y[:-1] < 0) & (y[1:] >= 0))
    if k.size < 2:
        return None
    places = x[k] - y[k] * (x[k + 1] - x[k]) / (y[k + 1] - y[k])
    return float((k.size - 1) / abs(places[-1] - places[0]))


def first_crossing(scale: np.ndarray, values: np.ndarray, level: float) -> float | None:
    """Return the first place on the scale where the values cross ``level``, interpolated."""
    above = values >= level
    changes = np.flatnonzero(above[1:] != above[:-1])
    if changes.size == 0:
        return None
    k = int(changes[0])
    share = (level - values[k]) / (values[k + 1] - values[k])
    return float(scale[k] + share * (scale[k + 1] - scale[k]))


def _time_average(scale: np.ndarray, values: np.ndarray) -> float:
    span = scale[-1] - scale[0]  # negative if the scale falls, as is the integral below
    return float(
        np.trapezoid(values, scale) / span if span else values[0]
    )  # the mean of a single point is its value


# Functions of probes of the scale (n,), the values (n,) and a level, keyed by name.
_PROBE_FUNCTIONS: dict[str, Callable[[np.ndarray, np.ndarray, float], float | None]] = {
    "argmax": lambda scale, values, _: scale[values.argmax()],
    "max": lambda scale, values, _: values.max(),
    "min": lambda scale, values, _: values.min(),
    "final": lambda scale, values, _: values[-1],
    "peak_to_peak": lambda scale, values, _: np.ptp(values),
    "mean": lambda scale, values, _: _time_average(scale, values),
    "rms": lambda scale, values, _: math.sqrt(_time_average(scale, values**2)),
    "frequency": lambda scale, values, _: mean_frequency(scale, values),
    "crossing": first_crossing,
}


def _is_on_scale(scale: np.ndarray, place: float) -> bool:
    """Return whether a position is on the scale, within rounding."""
    slack = SCALE_ROUNDING * float(np.ptp(scale))
    return bool(scale.min() - slack <= place <= scale.max() + slack)


def _make_outside_error(name: str, key: str, place: float, scale: np.ndarray) -> UsageError:
    """Return the error of a position outside of the scale."""
    expected = f"{scale.min():g} … {scale.max():g}"
    return UsageError("this place is outside of the range of the analysis", where=
        f"probes.{name}.{key}", got=f"{place:g}",
                      expected=expected)  # fmt: skip


def _interpolate_value(scale: np.ndarray, values: np.ndarray, place: float, name: str) -> float:
    """Return the interpolated value at ``place``; the magnitude of a complex value."""
    if not _is_on_scale(scale, place):
        raise _make_outside_error(name, "at", place, scale)
    result = interpolate(place, scale, values)
    return float(np.abs(result)) if np.iscomplexobj(result) else float(result)
