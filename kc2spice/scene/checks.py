"""Conditions that tie several keys of a scene together; each names the key to change."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

from kc2spice.core.errors import UsageError
from kc2spice.scene.budget import smallest
from kc2spice.scene.division import stages
from kc2spice.scene.model import Scene


def problems(scene: Scene) -> Iterator[UsageError]:
    """Every violated condition, with the dotted key in ``where``."""
    if not scene.parts:
        yield UsageError(
            "a scene without parts", where="name", got=scene.name, expected="at least one table "
            "with part = TYPE", hint="kc2spice scenes lists scenes to start from",
        )  # fmt: skip
        return
    for part in scene.parts.values():
        yield from part.type.problems(part, scene)
    yield from _implausible(scene)
    yield from _settings(scene)
    yield from _analysis(scene)


def _implausible(scene: Scene) -> Iterator[UsageError]:
    action = scene.checks.plausible
    if action == "off":
        return
    for part in scene.parts.values():
        for found in part.type.implausible(part, scene):
            if action == "warn":
                warnings.warn(f"{found.where}: {found.got}: {found.message}", stacklevel=2)
                continue
            found.hint = f"{found.hint or 'is the unit right?'} (checks.plausible = 'warn' runs it)"
            yield found


def _settings(scene: Scene) -> Iterator[UsageError]:
    low, high = scene.rom.band
    if not 0 <= low < high:
        got = f"{low:g} … {high:g} Hz"
        yield UsageError("empty band", where="rom.band", got=got, expected="0 <= low < high")
    least = smallest(stages(scene))
    if scene.error_budget is not None and scene.error_budget < least:
        yield UsageError(
            "no settings are known that keep within it",
            where="error_budget",
            got=f"{scene.error_budget:g}",
            expected=f"at least {least:.2g}",
            hint="set rom.order or tolerance, solver.reltol and solver.chgtol yourself",
        )
    if scene.include and not any(part.type.uses_netlists(part) for part in scene.parts.values()):
        yield UsageError(
            "nothing uses these netlists", where="include", got=", ".join(scene.include),
            expected="a part that names a subcircuit out of them",
        )  # fmt: skip


def _analysis(scene: Scene) -> Iterator[UsageError]:
    chosen, solver = scene.analysis, scene.solver
    if chosen.type == "transient" and solver.max_step > scene.stop:
        yield UsageError(
            "longer than the whole simulation",
            where="solver.max_step",
            got=f"{solver.max_step:g} s",
            expected=f"at most the end of the simulation, {scene.stop:g} s",
        )
    if chosen.type == "ac" and not chosen.start < (chosen.stop or 0.0):
        yield UsageError(
            "empty frequency range",
            where="analysis.stop",
            got=f"{chosen.start:g} … {chosen.stop} Hz",
            expected="start < stop",
        )
    if chosen.type == "ac" and chosen.scale == "log" and chosen.start <= 0:
        yield UsageError(
            "a logarithmic range cannot begin at zero", where="analysis.start",
            got=f"{chosen.start:g} Hz", expected='above 0, or scale = "linear"',
        )  # fmt: skip
    if chosen.type == "dc":
        name, _, _ = (chosen.sweep or "").partition(".")
        if name not in scene.parts:
            yield UsageError(
                "dc sweeps a key of a part", where="analysis.sweep", got=repr(chosen.sweep),
                expected="PART.KEY with a part of the scene: " + ", ".join(scene.parts),
            )  # fmt: skip
    for name, probe in scene.probes.items():
        if (probe.take == "crossing") != (probe.level is not None):
            yield UsageError(
                "level goes with crossing", where=f"probes.{name}", got=f"take = {probe.take!r}",
                expected='take = "crossing" and a level, or neither',
            )  # fmt: skip
