"""Plausible ranges of keys; a value outside of its range more likely has a wrong unit."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import MASSES, Plausible, role_of

if TYPE_CHECKING:
    from kc2spice.scene.model import Build, Scene


class ImplausibleError(UsageError):
    """A value that can be computed but hardly exists; often a wrong unit."""


FLAT = 10.0  # times its width: thicker than that is no layer
OVERHANG = 1.02  # largest ratio of diameters, ceramic to plate; wider ceramic breaks off
BREAKDOWN = 10.0  # ratio to the rated voltage; above it an error, from 1 up to it a warning
WHISPER = 1e-4  # ratio to the rated voltage; a lower drive is a warning, it may be intended
_SLIPS = {"m": {"mm": 1e-3, "um": 1e-6}, "kg": {"g": 1e-3, "mg": 1e-6, "ug": 1e-9}}


def within(
    where: str, value: float, unit: str, low: float, high: float, why: str
) -> Iterator[UsageError]:
    """The error for a value outside ``low`` to ``high``, with the physical reason; else nothing."""
    if not low <= value <= high:
        slips = _SLIPS.get(unit, {}).items()
        fits = (name for name, size in slips if low <= value * size <= high)
        yield ImplausibleError(
            f"hardly exists: {why}",
            where=where,
            got=f"{value:.4g} {unit}",
            expected=f"{low:g} to {high:g} {unit}",
            hint=next((f'did you mean "{value:g} {name}"?' for name in fits), None),
        )


def dimensions(where: str, keys: BaseModel) -> Iterator[UsageError]:
    """Implausible values of all keys by their roles, including lists and inner tables."""
    for name, field in type(keys).model_fields.items():
        yield from _entry(f"{where}.{name}", role_of(field), getattr(keys, name))


def _entry(where: str, role: Plausible | None, value: Any) -> Iterator[UsageError]:
    if isinstance(value, BaseModel):
        yield from dimensions(where, value)
    elif isinstance(value, tuple):
        for k, item in enumerate(value):
            yield from _entry(f"{where}.{k}", role, item)
    elif isinstance(value, float) and value and role is not None:
        yield from within(where, value, role.unit, role.low, role.high, role.why)


def layers(
    where: str, entries: Iterable[tuple[float, float, bool]], *, plate: bool
) -> Iterator[UsageError]:
    """Implausible stacks of layers ``(width, thickness, ceramic)``.

    Layers must be flat, and ceramic must not be wider than its ``plate``.
    """
    rows = list(entries)
    metal = max((width for width, _, ceramic in rows if not ceramic), default=0.0)
    thick = f"no layer is more than {FLAT:g} times as thick as it is wide"
    wide = "ceramic that is wider than its plate breaks off"
    for k, (width, thickness, ceramic) in enumerate(rows):
        yield from within(f"{where}.{k}.thickness", thickness, "m", 0.0, FLAT * width, thick)
        if plate and ceramic and metal:
            yield from within(f"{where}.{k}.diameter", width, "m", 0.0, OVERHANG * metal, wide)


def drive_levels(scene: Scene) -> Iterator[UsageError]:
    """Source voltages at electrodes with a known rating; needs the nets.

    A voltage slightly above the rating, or far below it, is a warning.
    """
    rated = {name: pin.rated for (name, _), pin in scene.terminals.items() if pin.rated}
    for body, limit in rated.items():
        for name, peak in _voltages(body, scene):
            state = f"{peak:.4g} V at {body}, whose ceramic stands {limit:.4g} V"
            # The same number in kilovolts, volts or millivolts, where that would fit the rating.
            units = {f"{1e3 * peak:g} V": 1e3 * peak, f"{peak:g} mV": 1e-3 * peak}
            fits = (text for text, volts in units.items() if WHISPER * limit <= volts <= limit)
            hint = next((f"did you mean {text}?" for text in fits), None)
            if peak > BREAKDOWN * limit:
                yield UsageError(
                    "the ceramic depolarises or breaks down",
                    where=name,
                    got=state,
                    expected=f"at most {limit:.4g} V",
                    hint=hint,
                )
            elif peak > limit:
                warnings.warn(f"{name}: {state}: it may depolarise", stacklevel=2)
            elif 0.0 < peak < WHISPER * limit:
                warnings.warn(f"{name}: {state}: {hint or 'is the unit right?'}", stacklevel=2)


def _voltages(body: str, scene: Scene) -> Iterator[tuple[str, float]]:
    """Ideal sources between an electrode and ground, and the largest of their voltages."""
    volts = (key for key, pin in scene.terminals.items() if pin.unit == "V")
    nets = {scene.nets[key] for key in volts if key[0] == body}
    for source in scene.of("source"):
        wave = source.type.voltage(source, scene)
        if wave is None or scene.nets[source.name, "ret"] != "0":
            continue
        if scene.nets[source.name, "out"] in nets:
            corners = np.concatenate([[0.0], wave.corners(scene.stop), [scene.stop]])
            peak = np.abs(wave(corners)).max() if wave.straight else abs(wave.amplitude)
            yield source.name, float(peak)


def built(build: Build) -> Iterator[UsageError]:
    """Implausible facts of built models, such as the mass of a mesh."""
    for part in build.scene.parts.values():
        mass = build.facts(part).get("mass_kg")
        if mass is not None:
            yield from within(part.name, mass, MASSES.unit, MASSES.low, MASSES.high, MASSES.why)


def judged(errors: Iterable[UsageError], action: str) -> Iterator[UsageError]:
    """Errors that remain under ``checks.plausible``; the others become warnings or are dropped."""
    if action == "off":
        return
    for item in errors:
        if action == "warn":
            warnings.warn(f"{item.where}: {item.got}: {item.message}", stacklevel=2)
            continue
        item.hint = f"{item.hint or 'is the unit right?'} (checks.plausible = 'warn' runs it)"
        yield item
