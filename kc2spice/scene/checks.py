"""Conditions that tie several keys of a scene together; each names the key to change."""

from __future__ import annotations

from collections.abc import Iterator
from math import inf

from kc2spice.core.errors import UsageError
from kc2spice.scene.model import Scene
from kc2spice.scene.plausible import ImplausibleError, judged

MOST_POINTS = 1e7  # time points of a transient at its largest step


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
    for each in (each for part in scene.parts.values() for each in part.type.problems(part, scene)):
        if isinstance(each, ImplausibleError):
            doubtful.append(each)
        else:
            yield each
    yield from judged(doubtful, scene.checks.plausible)
    yield from _settings(scene)
    yield from _analysis(scene)


def _settings(scene: Scene) -> Iterator[UsageError]:
    low, high = scene.rom.band
    if not 0 <= low < high:
        got = f"{low:g} … {high:g} Hz"
        yield UsageError("empty band", where="rom.band", got=got, expected="0 <= low < high")
    if scene.include and not any(part.netlist for part in scene.parts.values()):
        yield UsageError(
            "nothing uses these netlists",
            where="include",
            got=", ".join(scene.include),
            expected="a part that names a subcircuit out of them",
        )


def _analysis(scene: Scene) -> Iterator[UsageError]:
    chosen, solver = scene.analysis, scene.solver
    if chosen.type == "transient" and (solver.max_step or 0.0) > scene.stop:
        yield UsageError(
            "longer than the whole simulation",
            where="solver.max_step",
            got=f"{solver.max_step:g} s",
            expected=f"at most the end of the simulation, {scene.stop:g} s",
        )
    step = solver.max_step if chosen.type == "transient" else None
    points = 0.0 if step is None else scene.stop / step
    if points > MOST_POINTS:
        yield UsageError(
            "more time points than a run may have",
            where="solver.max_step",
            got=f"{scene.stop:g} s in steps of {solver.max_step:g} s: {points:.2g} points",
            expected=f"at most {MOST_POINTS:g}",
            hint="raise solver.max_step, or end earlier (analysis.stop or solver.stop)",
        )
    if chosen.type != "dc" and chosen.sweep is not None:
        yield UsageError(
            "only dc sweeps a key",
            where="analysis.sweep",
            got=f"{chosen.type} and a sweep",
            expected='type = "dc", or no sweep',
            hint="kc2spice sweep SCENE --set KEY=FROM:TO:POINTS runs an analysis at each value",
        )
    if chosen.back:
        source = scene.parts.get((chosen.sweep or "").removesuffix(".dc"))
        if chosen.type != "dc" or source is None or source.type.name != "source":
            yield UsageError(
                "only the dc value of a source returns",
                where="analysis.back",
                got=f"{chosen.type} of {chosen.sweep}",
                expected='type = "dc" and sweep = "SOURCE.dc", or back = false',
            )
    if chosen.small and not chosen.start < (chosen.stop or 0.0):
        yield UsageError(
            "empty frequency range",
            where="analysis.stop",
            got=f"{chosen.start:g} … {chosen.stop} Hz",
            expected="start < stop",
        )
    if chosen.small and chosen.scale == "log" and chosen.start <= 0:
        yield UsageError(
            "a logarithmic range cannot begin at zero",
            where="analysis.start",
            got=f"{chosen.start:g} Hz",
            expected='above 0, or scale = "linear"',
        )
    if (chosen.type == "noise") != (chosen.output is not None):
        yield UsageError(
            "noise is that of an output",
            where="analysis.output",
            got=f"{chosen.type} of {chosen.output}",
            expected='type = "noise" with output = "PART.RESULT" or "PART.PIN", or neither',
        )
    if chosen.type == "dc":
        name, _, _ = (chosen.sweep or "").partition(".")
        if name not in scene.parts:
            yield UsageError(
                "dc sweeps a key of a part",
                where="analysis.sweep",
                got=repr(chosen.sweep),
                expected="PART.KEY with a part of the scene: " + ", ".join(scene.parts),
            )
    for name, probe in scene.probes.items():
        if (probe.take == "value") != (probe.at is not None):
            yield UsageError(
                "at goes with a value",
                where=f"probes.{name}",
                got=f"take = {probe.take!r}",
                expected='take = "value" and at, or neither',
            )
        band = (chosen.start, chosen.stop or 0.0)
        ends = {"ac": band, "noise": band, "transient": (0.0, scene.stop)}
        first, last = ends.get(chosen.type, (-inf, inf))
        if probe.at is not None and not first <= probe.at <= last:
            yield UsageError(
                "outside the analysis",
                where=f"probes.{name}.at",
                got=f"{probe.at:g}",
                expected=f"{first:g} … {last:g} {'Hz' if chosen.small else 's'}",
            )
        if (probe.take == "crossing") != (probe.level is not None):
            yield UsageError(
                "level goes with crossing",
                where=f"probes.{name}",
                got=f"take = {probe.take!r}",
                expected='take = "crossing" and a level, or neither',
            )
