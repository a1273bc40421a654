"""``.meas`` cards, with which the simulator computes probes and main metrics.

A ``.meas`` card computes a quantity from one simulator vector. The deck contains cards only for
quantities that ngspice and kc2spice define in the same way. The cards compute extremes with their
positions, differences of extremes, means, values at a position, level crossings, and last values.
In ``ac``, a card returns the largest or smallest value at a computed point, but the metric
interpolates between computed points. An ``op`` has no cards: its deck prints the vectors.

ngspice has no card for values that are fitted to an impedance (antiresonance, Q factor,
capacitance), frequencies of counted cycles, and windows that end between time points.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import NamedTuple

from kc2spice.netlist.deck import MeasureCard
from kc2spice.netlist.expression import parse_vector as parsed
from kc2spice.netlist.number_and_name_spelling import format_number
from kc2spice.scene.part_records import LargestRealPartFrequency, PartResult
from kc2spice.scene.scene_classes import BuiltScene, Scene
from kc2spice.scene.settings import ProbeKeys

_FUNCTIONS = {"max": "MAX", "min": "MIN", "peak_to_peak": "PP", "mean": "AVG", "rms": "RMS"}
_OPPOSITE_EXTREMES = {"MAX": "MIN", "MIN": "MAX", "MAX_AT": "MIN_AT"}
# Functions of a probe that a card can apply to the magnitude of a complex vector.
# For these functions, the card and kc2spice compute the same value.
_MAGNITUDE_FUNCTIONS = ("max", "argmax", "crossing")
_VALID_NAME = re.compile(r"[A-Za-z]\w*")
ANALYSIS_KINDS = {"transient": "tran", "dc": "dc", "ac": "ac", "op": "op"}


class _MeasuredVector(NamedTuple):
    """Simulator vector that a ``.meas`` card reads.

    ``kind`` is the ngspice name of the analysis. ``factor`` is the SI value of the vector's unit.
    ``per_unit`` is the voltage or current of the swept source, divided by the value of the swept
    key in SI units. ``last`` is the end of a transient [s].
    """

    kind: str
    text: str
    factor: float
    per_unit: float
    last: float


def list_measure_cards(build: BuiltScene, sweep_scale: float) -> tuple[MeasureCard, ...]:
    """Return the ``.meas`` cards of a scene, for main metrics of parts and for probes.

    ``sweep_scale`` is the voltage or current of a dc sweep for one SI unit of the swept key.
    """
    count, probes = Counter[str](), dict[str, ProbeKeys | LargestRealPartFrequency]()
    for name, part in build.scene.parts.items():
        if name not in build.scene.movers:
            metrics = part.type.main_metrics(part, build)
            count.update(metrics.keys())
            probes |= metrics
    for name in count:
        if count[name] > 1:  # no card is written if several parts have a metric with the same name
            del probes[name]
    return tuple(_list_measures(build, {**probes, **build.scene.probes}, sweep_scale))


def _list_measures(
    build: BuiltScene,
    probes: Mapping[str, ProbeKeys | LargestRealPartFrequency],
    sweep_scale: float,
) -> Iterator[MeasureCard]:
    """Yield a ``.meas`` card for each probe that a card can compute."""
    for name, probe in probes.items():
        wave = _find_measured_vector(build.scene, build.results.vectors.get(probe.of), sweep_scale)
        if wave is None or not _VALID_NAME.fullmatch(name):
            continue
        if isinstance(probe, LargestRealPartFrequency):
            yield MeasureCard(
                name, wave.kind, (_choose_extreme_function("MAX_AT", wave.factor), wave.text)
            )
        elif not {"from_", "to", "periods"} & probe.model_fields_set:
            yield from _list_probe_measures(name, probe, wave)


def _find_measured_vector(
    scene: Scene, result: PartResult | None, sweep_scale: float
) -> _MeasuredVector | None:
    """Return the simulator vector that contains a result, for a ``.meas`` card.

    The vector is None if no card can read the result.

    No card can read a sum of vectors, a sweep that returns to its first value, or a result that a
    part corrects after the run.
    """
    kind = ANALYSIS_KINDS.get(scene.analysis.type)
    if kind is None or result is None or len(result.terms) != 1 or result.corrected:
        return None
    if kind == "dc" and scene.analysis.back:
        return None
    ((sign, text),) = result.terms
    return _MeasuredVector(kind, text, sign * result.factor, sweep_scale, scene.stop_time)


def _list_probe_measures(
    name: str, probe: ProbeKeys, wave: _MeasuredVector
) -> Iterator[MeasureCard]:
    """Yield the ``.meas`` card of a probe, if a card can compute this probe.

    In ``ac``, the card measures the magnitude of a voltage.
    """
    kind, text, factor, take = wave.kind, wave.text, wave.factor, probe.take
    if kind == "op":
        yield MeasureCard(name, kind, (text,), factor)
        return
    if kind == "ac":
        vector = parsed(text)
        if vector is None or vector.quantity != "v" or take not in _MAGNITUDE_FUNCTIONS:
            return
        text, factor = f"vm({text[2:]}", abs(factor)
    if take == "argmax":
        yield MeasureCard(
            name, kind, (_choose_extreme_function("MAX_AT", factor), text), 1 / wave.per_unit
        )
    elif take == "crossing" and probe.level is not None:
        words = "WHEN", f"{text}={format_number(probe.level / factor)}", "CROSS=1"
        yield MeasureCard(name, kind, words, 1 / wave.per_unit)
    elif take == "value" and probe.at is not None:
        yield MeasureCard(
            name, kind, ("FIND", text, f"AT={format_number(probe.at * wave.per_unit)}"), factor
        )
    elif take == "final" and kind == "tran":
        yield MeasureCard(name, kind, ("FIND", text, f"AT={format_number(wave.last)}"), factor)
    elif word := _FUNCTIONS.get(take):
        size = abs(factor) if word in ("PP", "RMS") else factor
        yield MeasureCard(name, kind, (_choose_extreme_function(word, factor), text), size)


def _choose_extreme_function(word: str, factor: float) -> str:
    """Choose the ``.meas`` function; a negative factor swaps the extremes MIN and MAX.

    For a negative factor, ``MIN`` replaces ``MAX``, ``MAX`` replaces ``MIN``, and ``MIN_AT``
    replaces ``MAX_AT``. All other functions are returned unchanged.
    """
    return _OPPOSITE_EXTREMES.get(word, word) if factor < 0 else word
