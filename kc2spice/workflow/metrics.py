"""Results of a run: metrics, checks and energy balances of the parts and probes."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from typing import Any, NamedTuple

from kc2spice.core.errors import unknown
from kc2spice.core.probe_values import compute_probe_value
from kc2spice.core.sound_level import GAS_REFERENCE, SoundLevel
from kc2spice.core.waveforms import SCALES, Waveforms
from kc2spice.scene.checks import Balance, Check, Gate, Metric, Verdict
from kc2spice.scene.model import Build, Scene
from kc2spice.scene.results import NOISE_WAVE
from kc2spice.scene.settings import Probe
from kc2spice.workflow import noise_analysis
from kc2spice.workflow.time_step import list_step_checks

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
    return _split_metrics(_metrics(waves, build, partial=partial))


def _split_metrics(rows: Mapping[str, Any], path: str = "") -> Metrics:
    """Return the values of metrics in the same tables, and their units by dotted name."""
    result = Metrics({}, {})
    for name, item in rows.items():
        value, unit = (item.value, item.unit) if isinstance(item, Metric) else (item, "")
        if unit:
            result.units[f"{path}{name}"] = unit
        if isinstance(value, Mapping):
            inner = _split_metrics(value, f"{path}{name}.")
            value = inner.values
            result.units.update(inner.units)
        result.values[name] = value
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
            probed[name] = _evaluate_probe(name, probe, build, waves)
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


def _evaluate_probe(name: str, probe: Probe, build: Build, waves: Waveforms) -> Metric:
    """Return the value of a probe with its unit.

    Raises
    ------
    UsageError : the run does not contain the vector, or a place is outside of its scale.
    """
    unit, reference = _probe_unit(probe, build, waves), _level_reference(probe, build)
    window, where = window_of(probe, build.scene), f"probes.{name}"
    if probe.of not in waves:
        known = list(waves.data)[1:]
        raise unknown("the run has no such result", probe.of, known, f"key {where}.of")
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
