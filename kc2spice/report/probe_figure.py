"""Figure of the results that the probes of a scene read.

The inputs are the probes of a scene, and the waveforms of a run with the unit of each waveform. The
output is one figure with a panel for each unit. A sound pressure versus frequency is drawn as a
sound pressure level. A sound pressure versus time is drawn as a waveform.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel, format_axis_label, get_axis_label_and_factor
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.sound_level import LEVEL_UNIT, SoundLevel, compute_level
from kc2spice.core.waveforms import Waveforms
from kc2spice.report.html import label_key
from kc2spice.scene.settings import ProbeKeys

# the frequency axis is logarithmic if (highest / lowest frequency) exceeds this ratio
WIDE_RANGE = 20.0
PROBES_CAPTION = "Results, over the whole run, from which the probes of the scene compute metrics."


def plot_probes(
    probes: Mapping[str, ProbeKeys],
    waves: Waveforms,
    units: Mapping[str, str],
    levels: Mapping[str, SoundLevel] | None = None,
) -> Iterator[Figure]:
    """Plot the results that the probes of a scene read, in one panel for each unit.

    Complex responses are drawn as magnitudes. ``levels`` contains the sound pressure levels, keyed
    by the names of the probes that read the levels.
    """
    scale = next(iter(waves.data))
    if not probes or waves[scale].size < 2:
        return
    sounds = levels or {}
    by_unit: dict[str, dict[str, ProbeKeys]] = {}
    for name, probe in probes.items():
        unit = units.get(probe.of, "")
        if name in sounds and _is_response(probe, waves):
            unit = sounds[name].unit
        group = by_unit.setdefault(unit, {})
        if probe.of in waves:
            group[name] = probe
    panels = tuple(
        _plot_results_with_unit(unit, group, waves, sounds) for unit, group in by_unit.items()
    )
    title, caption = "Probed results", PROBES_CAPTION
    if texts := list(map(_describe_level, sounds, sounds.values())):
        references = " or ".join(dict.fromkeys(level.reference_text for level in sounds.values()))
        title += f": {', '.join(texts)}"
        caption += f" Levels are those of the rms pressure, {references}."
    yield Figure("probes", title, caption, panels, main=True)


def _is_response(probe: ProbeKeys, waves: Waveforms) -> bool:
    """Return whether a probe reads a complex small-signal response."""
    return probe.of in waves and np.iscomplexobj(waves[probe.of])


def _describe_level(name: str, level: SoundLevel) -> str:
    """Return a label with the name of a probe and the sound pressure level."""
    label = label_key(name, LEVEL_UNIT)
    if level.decibels is None:
        return label
    return f"{label} {format_quantity(level.decibels, LEVEL_UNIT)}"


def _plot_results_with_unit(
    unit: str, probes: Mapping[str, ProbeKeys], waves: Waveforms, sounds: Mapping[str, SoundLevel]
) -> Panel:
    """Plot the probed results that have the same unit, as one panel.

    Vertical lines mark the times or frequencies at which probes read a value. Horizontal lines mark
    the thresholds of probes that detect crossings.
    """
    scale = next(iter(waves.data))
    x = waves[scale].real
    label, factor = get_axis_label_and_factor(scale, x)
    log_x = scale == "frequency" and bool(x[0] > 0 and x[-1] / x[0] > WIDE_RANGE)
    complex_ = any(_is_response(probe, waves) for probe in probes.values())
    decibels = unit.startswith(LEVEL_UNIT)
    curves: dict[str, Curve] = {}
    levels, marks = [], []
    for name, probe in probes.items():
        values = np.abs(waves[probe.of]) if complex_ else waves[probe.of]
        values = _convert_to_level(values, sounds[name].reference) if decibels else values
        curves[probe.of] = Curve(probe.of, factor * x, values)
        if probe.level is not None:
            levels.append((probe.level, name))
        if probe.take in ("argmax", "value") or (decibels and probe.at is not None):
            place = float(x[values.argmax()] if probe.at is None else probe.at)
            marks.append((factor * place, name))
    quantity = "magnitude" if complex_ else "value"
    return Panel(
        label,
        format_axis_label("level" if decibels else quantity, unit),
        tuple(curves.values()),
        levels=tuple(levels),
        marks=tuple(marks),
        log_x=log_x,
        log_y=complex_ and not decibels and all(curve.y.all() for curve in curves.values()),
    )


def _convert_to_level(amplitudes: np.ndarray, reference: float) -> np.ndarray:
    """Return the sound pressure levels [dB] of pressure amplitudes [Pa].

    The level of a zero amplitude is NaN, which is a gap in the curve.
    """
    level = compute_level(np.sqrt(0.5) * amplitudes, reference)
    return np.where(amplitudes > 0, level, np.nan)
