"""Checks of the keys of a scene before its parts are joined."""

from __future__ import annotations

import math
from collections.abc import Iterator
from math import inf

from kc2spice.core.errors import UsageError, candidates
from kc2spice.core.quantities import quantity, unit_of
from kc2spice.scene.model import Scene
from kc2spice.scene.plausible import ImplausibleError, apply_action
from kc2spice.scene.resolve import PERIOD_TOLERANCE
from kc2spice.scene.settings import SCALE_OF, Analysis

MOST_POINTS = 1e7  # time points of a transient at its largest step
CLOSEST = 1e-12  # smallest step that a simulator resolves, relative to the last frequency


def problems(scene: Scene) -> Iterator[UsageError]:
    """Every violated condition, with the dotted key in ``where``."""
    if not scene.parts:
        yield UsageError(
            "a scene without parts",
            where="name",
            got=scene.name,
            expected="at least one table with part = TYPE",
            hint="kc2spice scenes lists scenes to start from",
        )
        return
    doubtful = []
    for item in (item for part in scene.parts.values() for item in part.type.problems(part, scene)):
        if isinstance(item, ImplausibleError):
            doubtful.append(item)
        else:
            yield item
    yield from apply_action(doubtful, scene.checks.plausible)
    selected, solver = scene.analysis, scene.solver
    if scene.include and not any(part.netlist for part in scene.parts.values()):
        yield UsageError(
            "nothing uses these netlists",
            where="include",
            got=", ".join(scene.include),
            expected="a part that names a subcircuit out of them",
        )
    if selected.type == "transient" and (solver.max_step or 0.0) > scene.stop:
        yield UsageError(
            "longer than the whole simulation",
            where="solver.max_step",
            got=f"{solver.max_step:g} s",
            expected=f"at most the end of the simulation, {scene.stop:g} s",
        )
    step = solver.max_step if selected.type == "transient" else None
    points = 0.0 if step is None else scene.stop / step
    if points > MOST_POINTS:
        yield UsageError(
            "more time points than a run may have",
            where="solver.max_step",
            got=f"{scene.stop:g} s in steps of {solver.max_step:g} s: {points:.2g} points",
            expected=f"at most {MOST_POINTS:g}",
            hint="raise solver.max_step, or end earlier (analysis.stop or solver.stop)",
        )
    yield from _without_effect(selected)
    if selected.type != "dc" and selected.sweep is not None:
        yield UsageError(
            "only dc sweeps a key",
            where="analysis.sweep",
            got=f"{selected.type} and a sweep",
            expected='type = "dc", or no sweep',
            hint="kc2spice sweep SCENE --set KEY=FROM:TO:POINTS runs an analysis at each value",
        )
    if selected.back:
        source = scene.parts.get((selected.sweep or "").removesuffix(".dc"))
        if selected.type != "dc" or source is None or source.type.name != "source":
            yield UsageError(
                "only the dc value of a source returns",
                where="analysis.back",
                got=f"{selected.type} of {selected.sweep}",
                expected='type = "dc" and sweep = "SOURCE.dc", or back = false',
            )
    stop = selected.stop or 0.0
    if selected.small and selected.stop is None:
        yield UsageError(
            f"analysis.stop is missing in {selected.type}",
            where="analysis",
            got=f'type = "{selected.type}" without stop',
            expected='the last frequency, such as stop = "100 kHz"',
            hint='add  stop = "100 kHz"  to [analysis]',
        )
    elif selected.small and not stop - selected.start > CLOSEST * selected.points * stop:
        yield UsageError(
            "empty frequency range",
            where="analysis.stop",
            got=f"{selected.start:g} … {stop:g} Hz",
            expected=f"a stop above the start, {selected.start:g} Hz, and points that differ by "
            f"more than {CLOSEST:g} of the stop",
            hint="raise analysis.stop, or lower analysis.start",
        )
    if selected.small and selected.scale == "log" and selected.start <= 0:
        yield UsageError(
            "a logarithmic range cannot begin at zero",
            where="analysis.start",
            got=f"{selected.start:g} Hz",
            expected='above 0, or scale = "linear"',
        )
    elif selected.small and selected.scale == "log" and math.isinf(stop / selected.start):
        yield UsageError(
            "a range of more decades than numbers have",
            where="analysis.start",
            got=f"{selected.start:g} … {stop:g} Hz",
            expected="at most 308 decades",
        )
    if (selected.type == "noise") != (selected.output is not None):
        yield UsageError(
            "a noise analysis needs an output"
            if selected.output is None
            else f"output has no effect in {selected.type}",
            where="analysis" if selected.output is None else "analysis.output",
            got=f'type = "{selected.type}"'
            + (" without output" if selected.output is None else f', output = "{selected.output}"'),
            expected='output = "PART.RESULT" or "PART.PIN" with type = "noise"',
            hint='add  output = "PART.RESULT"  to [analysis]'
            if selected.output is None
            else "delete the key output of [analysis]",
        )
    if selected.type == "dc":
        name, _, _ = (selected.sweep or "").partition(".")
        if name not in scene.parts:
            sources = [part.name for part in scene.of("source")] or list(scene.parts)
            yield UsageError(
                "analysis.sweep is missing in dc"
                if selected.sweep is None
                else f"this scene has no part {name!r}",
                where="analysis" if selected.sweep is None else "analysis.sweep",
                got='type = "dc" without sweep' if selected.sweep is None else repr(selected.sweep),
                expected=f"PART.dc of a source of the scene: {candidates(name, sources)}",
                hint=f'write  sweep = "{sources[0]}.dc"  in [analysis]',
            )
        unit = _scale_unit(scene)
        for key, value in (("from", selected.from_), ("to", selected.to)):
            if unit is not None and isinstance(value, str):
                quantity(value, unit, where=f"analysis.{key}")
    for name, probe in scene.probes.items():
        for key, place in probe.places.items():
            yield from _misplaced(f"probes.{name}.{key}", place, scene)


def _without_effect(selected: Analysis) -> Iterator[UsageError]:
    """Keys of the analysis that its type does not read; sweep, back and output have own errors."""
    readers = {
        "stop": ("transient", "ac", "noise"),
        "start": ("ac", "noise"),
        "scale": ("ac", "noise"),
        "points": ("ac", "noise", "dc"),
        "from_": ("dc",),
        "to": ("dc",),
    }
    for name, types in readers.items():
        value = getattr(selected, name)
        if selected.type in types or name not in selected.model_fields_set or value is None:
            continue
        key = name.rstrip("_")
        yield UsageError(
            f"{key} has no effect in {selected.type}",
            where=f"analysis.{key}",
            got=f"{key} with type = {selected.type}",
            expected=f"{key} with type = {' or '.join(types)}",
            hint=f"delete the key {key} of [analysis]",
        )


def check_periods(scene: Scene) -> Iterator[UsageError]:
    """Probes of the last periods of a run that has no such periods."""
    for name, probe in scene.probes.items():
        if probe.periods is not None:
            yield from _no_periods(f"probes.{name}.periods", probe.periods, scene)


def _no_periods(where: str, count: int, scene: Scene) -> Iterator[UsageError]:
    """Why a transient has no such window of its last periods."""
    if scene.analysis.type != "transient":
        got, expected = f"{scene.analysis.type} analysis", "a transient, or from and to"
        yield UsageError("only a transient has periods", where=where, got=got, expected=expected)
        return
    period, known = scene.period, sorted({row.period for row in scene.numerics} - {0.0})
    if period is None:
        periods = ", ".join(f"{each:.4g} s" for each in known)
        yield UsageError(
            "the sources of this scene have no common period",
            where=where,
            got=f"periods {periods}" if periods else "no source with a period",
            expected="sines and pulse trains whose periods divide the longest one",
            hint='give the window by from and to, such as from = "8 ms"',
        )
    elif count * period > scene.stop * (1 + PERIOD_TOLERANCE):
        got = f"{count} periods of {period:.4g} s"
        expected = f"at most {scene.stop:g} s, the end of the transient"
        yield UsageError("the window is longer than the run", where=where, got=got,
                         expected=expected)  # fmt: skip


def _misplaced(where: str, place: float, scene: Scene) -> Iterator[UsageError]:
    """Why a place is none on the scale of the scene's analysis."""
    selected, part_unit = scene.analysis, getattr(place, "unit", "")
    unit = _scale_unit(scene)
    if part_unit and unit is not None and part_unit != unit:
        examples = {"s": '"2 ms"', "Hz": '"46 Hz"', "": "a plain number"}
        expected = f"a value in {unit}, such as {examples.get(unit, repr(f'1 {unit}'))}"
        got = f"a value in {part_unit}"
        article = "an" if selected.type in ("ac", "op") else "a"
        words = f"not on the scale of {article} {selected.type} analysis"
        yield UsageError(words, where=where, got=got, expected=expected)
        return
    band = (selected.start, selected.stop or 0.0)
    ends = {"ac": band, "noise": band, "transient": (0.0, scene.stop)}
    first, last = ends.get(selected.type, (-inf, inf))
    if not first <= place <= last:
        expected = f"{first:g} … {last:g} {unit or ''}".rstrip()
        got = f"{place:g}"
        yield UsageError("outside the analysis", where=where, got=got, expected=expected)


def _scale_unit(scene: Scene) -> str | None:
    """Unit of the scale of the scene's analysis, None where that is not known."""
    selected = scene.analysis
    if selected.type != "dc":
        return SCALE_OF.get(selected.type)
    name, _, key = (selected.sweep or "").partition(".")
    part = scene.parts.get(name)
    if part is None:
        return None
    part_unit = getattr(part.keys, "unit", None)
    field = type(part.keys).model_fields.get(key)
    return part_unit if isinstance(part_unit, str) else None if field is None else unit_of(field)
