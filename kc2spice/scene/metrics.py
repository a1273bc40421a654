"""Computation of the metrics of a run from the parts and probes of its scene.

The inputs are the waveforms of a run, and the scene of the run with its built models. A probe reads
one waveform; the module :mod:`kc2spice.core.probe_values` computes the value of the probe.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from contextlib import suppress
from itertools import chain
from typing import Any, NamedTuple

from kc2spice.core.domains import HEAT
from kc2spice.core.errors import unknown
from kc2spice.core.probe_values import compute_probe_value
from kc2spice.core.sound_level import GAS_REFERENCE, SoundLevel
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import SCALES, Waveforms
from kc2spice.scene import noise_analysis
from kc2spice.scene.checks import Metric
from kc2spice.scene.results import NOISE_WAVE
from kc2spice.scene.scene_classes import BuiltScene, Scene
from kc2spice.scene.settings import ProbeKeys


class Metrics(NamedTuple):
    """Values of the metrics of a run, and their units, warnings, resolutions and scopes.

    All fields except for ``values`` contain dotted names. ``units`` contains only metrics with a
    unit, ``warnings`` only metrics with a warning, and ``resolutions`` only metrics with a
    resolution. ``curves`` are the names of metrics that are arrays over the frequency. ``scopes``
    contains the part's name for each metric that is a property of this part alone.
    """

    values: dict[str, Any]
    units: dict[str, str]
    warnings: dict[str, str]
    resolutions: dict[str, float]
    curves: set[str]
    scopes: dict[str, str]


def compute_metrics(waves: Waveforms, build: BuiltScene, *, partial: bool = False) -> Metrics:
    """Return the metrics of all probes and parts of a run.

    If ``partial`` is true, the waves are from an interrupted run, and metrics whose waves are
    missing are omitted. If several parts have a metric of the same name, the name of the part
    precedes the name of the metric: ``left.kick_stroke_m``.
    """
    return _split_metrics(_list_metrics(waves, build, partial=partial))


def _split_metrics(rows: Mapping[str, Any], path: str = "") -> Metrics:
    """Separate the values of nested metrics from their units, warnings and other data.

    The tables of values remain nested; the other data are keyed by dotted name.
    """
    result = Metrics({}, {}, {}, {}, set(), {})
    for name, item in rows.items():
        metric = item if isinstance(item, Metric) else Metric(item)
        value, key = metric.value, f"{path}{name}"
        if metric.unit:
            result.units[key] = metric.unit
        if metric.warning:
            result.warnings[key] = metric.warning
        if metric.resolution:
            result.resolutions[key] = metric.resolution
        if metric.curve:
            result.curves.add(key)
        if metric.scope:
            result.scopes[key] = metric.scope
        if isinstance(value, Mapping):
            inner = _split_metrics(value, f"{key}.")
            value = inner.values
            result.units.update(inner.units)
            result.warnings.update(inner.warnings)
            result.resolutions.update(inner.resolutions)
            result.curves.update(inner.curves)
            result.scopes.update(inner.scopes)
        result.values[name] = value
    return result


def _list_metrics(waves: Waveforms, build: BuiltScene, *, partial: bool) -> dict[str, Any]:
    """Return the metrics of probes and parts with their units, keyed by name."""
    scene, result = build.scene, dict[str, Mapping[str, Any]]()
    for part in scene.parts.values():
        with suppress(*([KeyError] if partial else [])):
            result[part.name] = part.type.metrics(part, build, waves)
    count = Counter(chain.from_iterable(result.values()))
    records: dict[str, Any] = {}
    for part_name, item in result.items():
        for name, value in item.items():
            records[name if count[name] == 1 else f"{part_name}.{name}"] = value
    records |= noise_analysis.compute_noise_metrics(waves, build) if NOISE_WAVE in waves else {}
    probed: dict[str, Any] = {}
    for name, probe in scene.probes.items():
        window = find_probe_window(probe, scene)
        if not partial or _covers_probe(probe, waves, window):
            probed[name] = _evaluate_probe(name, probe, build, waves)
    return {**probed, **{name: value for name, value in records.items() if name not in probed}}


def _covers_probe(probe: ProbeKeys, waves: Waveforms, window: tuple[float, float] | None) -> bool:
    """Return whether an interrupted run recorded all values that a probe reads."""
    low, high = waves.scale.real.min(), waves.scale.real.max()
    places = [*probe.positions_by_key.values(), *(filter(math.isfinite, window or ()))]
    return probe.of in waves and all(low <= place <= high for place in places)


def _find_probe_unit(probe: ProbeKeys, build: BuiltScene, waves: Waveforms) -> str:
    """Return the SI unit of the value that a probe computes from a waveform."""
    scale = SCALES.get(next(iter(waves)), "")
    if build.dc_sweep is not None:
        scale = build.dc_sweep.unit
    along = {"argmax": scale, "crossing": scale, "frequency": "Hz", "spl": "dB"}
    return along.get(probe.take, build.results.units.get(probe.of, SCALES.get(probe.of, "")))


def _find_reference_pressure(probe: ProbeKeys, build: BuiltScene) -> float:
    """Return the rms pressure [Pa] that corresponds to 0 dB in the result of a probe."""
    result = build.results.vectors.get(probe.of)
    return (result.level_reference if result else None) or GAS_REFERENCE


def select_sound_levels(build: BuiltScene, metrics: Mapping[str, Any]) -> dict[str, SoundLevel]:
    """Return the metrics that probes compute as sound pressure levels [dB]."""
    result = {}
    for name, probe in build.scene.probes.items():
        if probe.take == "spl":
            result[name] = SoundLevel(_find_reference_pressure(probe, build), metrics.get(name))
    return result


def _evaluate_probe(name: str, probe: ProbeKeys, build: BuiltScene, waves: Waveforms) -> Metric:
    """Compute the value of a probe, with its unit.

    Raises
    ------
    UsageError : the run does not contain the probed wave, or the probe reads a point outside of the
        range of the run.
    """
    unit, reference = _find_probe_unit(probe, build, waves), _find_reference_pressure(probe, build)
    window, where = find_probe_window(probe, build.scene), f"probes.{name}"
    if probe.of not in waves:
        known = list(waves.data)[1:]
        raise unknown("the run has no such result", probe.of, known, f"key {where}.of")
    if build.scene.analysis.type == "ac" and not waves[probe.of].any():
        if unit == "K" or probe.of.endswith(".heat_flow"):
            warning = (
                f"{where}: {probe.of} is not computed, because no thermal source with the key `ac` "
                "drives it, and an `ac` analysis does not include the heat generated by "
                "losses"
            )
            warn_user(f"{warning}: {_suggest_heat_source(probe.of, build.scene)}")
            return Metric(None, unit, warning)
        warn_user(
            f"{where}: {probe.of} is zero at all frequencies, because no source with the key `ac` "
            "drives it"
        )
    value = compute_probe_value(
        probe.take,
        waves.scale.real,
        waves[probe.of],
        where,
        at=probe.at,
        level=probe.level or 0.0,
        window=window,
        reference=reference,
    )
    return Metric(value, unit)


def _suggest_heat_source(result: str, scene: Scene) -> str:
    """Suggest a source of the heat generated by losses, for an ac analysis.

    An ac analysis does not include the heat generated by losses.
    """
    part = result.partition(".")[0]
    heated = [name for name in scene.parts if scene.nets.get((name, HEAT), "0") != "0"]
    source = part if part in heated or not heated else heated[0]
    return (
        f"read the mean power from a probe of {source}.power, and use this power as `dc` of a "
        "source of the kind `heat_flow` in an analysis of the type `op`"
    )


def find_probe_window(probe: ProbeKeys, scene: Scene) -> tuple[float, float] | None:
    """Return the first and the last time, frequency or swept value that a probe reads.

    The result is None if the probe reads the whole wave.
    """
    if probe.periods is not None:
        return scene.stop_time - probe.periods * (scene.period or 0.0), scene.stop_time
    if probe.from_ is None and probe.to is None:
        return None
    first = -math.inf if probe.from_ is None else probe.from_
    return first, math.inf if probe.to is None else probe.to
