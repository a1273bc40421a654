"""``.meas`` cards of a deck: the probes and main metrics of a scene, taken by the simulator itself.

A card exists for what ngspice computes from one vector as the program does: extremes, their
difference, means and the last value. In ``ac`` these are the largest of the computed points; the
metric interpolates between them.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping

from kc2spice.netlist.deck import Measure
from kc2spice.netlist.expression import terms
from kc2spice.netlist.expression import vector as parsed
from kc2spice.netlist.spelling import number
from kc2spice.scene.model import Build
from kc2spice.scene.rows import Vector
from kc2spice.scene.settings import Probe

_TAKEN = {"max": "MAX", "min": "MIN", "peak_to_peak": "PP", "mean": "AVG", "rms": "RMS"}
_OPPOSITE = {"MAX": "MIN", "MIN": "MAX"}
_NAME = re.compile(r"[A-Za-z]\w*")
KINDS = {"transient": "tran", "dc": "dc", "ac": "ac"}


def measures(build: Build, results: Mapping[str, Vector]) -> tuple[Measure, ...]:
    """Return the measures of a scene whose results are these vectors, probes first."""
    parts = [p for name, p in build.scene.parts.items() if name not in build.scene.movers]
    rows = [row for part in parts for row in part.type.main_metrics(part, build).items()]
    count = Counter(name for name, _ in rows)  # a name of two parts is none of a card
    single = {name: probe for name, probe in rows if count[name] == 1}
    return tuple(_measures(build, {**single, **build.scene.probes}, results))


def _measures(
    build: Build, probes: Mapping[str, Probe], results: Mapping[str, Vector]
) -> Iterator[Measure]:
    scene = build.scene
    kind = KINDS.get(scene.analysis.type)
    for name, probe in probes.items():
        windowed = {"from_", "to", "periods"} & probe.model_fields_set
        result = results.get(probe.of)
        if kind is None or result is None or windowed or not _NAME.fullmatch(name):
            continue
        read = terms(result.expression)
        if len(read) == 1 and not (kind == "dc" and scene.analysis.back):
            ((sign, text),) = read
            yield from _measure(name, kind, probe.take, text, sign * result.factor, scene.stop)


def _measure(
    name: str, kind: str, take: str, text: str, factor: float, stop: float
) -> Iterator[Measure]:
    """Yield the measure of one vector, which counts in units of ``factor``; none if there is none.

    In ``ac`` it is the magnitude of a voltage.
    """
    if kind == "ac":
        vector = parsed(text)
        if vector is None or vector.quantity != "v" or take not in ("max", "argmax"):
            return
        text, factor = f"vm({text[2:]}", abs(factor)
    word = _TAKEN.get(take, "")
    if take == "argmax" and factor > 0:
        yield Measure(name, kind, ("MAX_AT", text))
    elif take == "final" and kind == "tran":
        yield Measure(name, kind, ("FIND", text, f"AT={number(stop)}"), factor)
    elif word:
        word = _OPPOSITE.get(word, word) if factor < 0 else word
        size = abs(factor) if word in ("PP", "RMS") else factor
        yield Measure(name, kind, (word, text), size)
