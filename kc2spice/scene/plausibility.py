"""Checks that key values and voltages are plausible.

A value outside of its plausible range probably has a wrong unit.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import BaseModel

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import (
    PLAUSIBLE_MASS,
    USUAL_Q_FACTOR,
    USUAL_RESULTS,
    USUAL_SOLID_DENSITY,
    PlausibleRange,
    UsualRange,
)
from kc2spice.core.schemas import get_plausible_range, get_usual_range
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.checks import Check

if TYPE_CHECKING:
    from kc2spice.scene.scene_classes import BuiltScene, Scene


class ImplausibleValueError(UsageError):
    """Error about a possible but implausible value, often due to a wrong unit."""


class UnusualValueError(ImplausibleValueError):
    """Error, printed as a warning, about a value outside of its usual range."""


MAX_LAYER_ASPECT = 10.0  # largest plausible thickness of a layer, relative to its width
# largest plausible diameter of a ceramic layer, relative to the plate; wider ceramics break
MAX_OVERHANG = 1.02
# Ratio of voltage to rated voltage above which the check fails. Above a ratio of 1, the check
# warns.
BREAKDOWN_RATIO = 10.0
# A value of less than MISTAKEN_UNIT_RATIO times its upper limit probably has the right unit.
# A wrong SI prefix, such as M instead of k, would change the value by a factor of 1000.
MISTAKEN_UNIT_RATIO = 2.0
LOWEST_DRIVE_RATIO = 1e-4  # ratio of voltage to rated voltage below which the check warns
_MICRO_UNITS = ("F", "H")  # units in which the prefix mega is rare
_ALTERNATIVE_UNITS = {
    "m": {"mm": 1e-3, "um": 1e-6},
    "kg": {"g": 1e-3, "mg": 1e-6, "ug": 1e-9},
    "kg/m3": {"g/cm3": 1e3},
}
# usual units of values that were probably typed without a unit
_USUAL_UNITS = _ALTERNATIVE_UNITS | {
    "m2": {"cm2": 1e-4, "mm2": 1e-6},
    "m3": {"l": 1e-3, "cm3": 1e-6},
    "m/N": {"mm/N": 1e-3, "um/N": 1e-6},
    "m/s2": {"mm/s2": 1e-3},
    "F": {"nF": 1e-9, "pF": 1e-12},
    "H": {"mH": 1e-3, "uH": 1e-6},
}


def check_range(
    where: str, value: float, unit: str, low: float, high: float, why: str
) -> Iterator[UsageError]:
    """Yield an error if a value is outside of its plausible range.

    The limits of the range are ``low`` and ``high``. ``why`` states why a value outside of the
    limits is not plausible.
    """
    if not low <= value <= high:
        units = _ALTERNATIVE_UNITS.get(unit, {}).items()
        fitting = next((name for name, size in units if low < value * size <= high), None)
        if high < value < MISTAKEN_UNIT_RATIO * high:
            fitting = None  # a value that is only slightly too large has the right unit
        proposal = format_quantity(value * dict(units).get(fitting or "", 1.0), unit).replace(
            "µ", "u"
        )
        limit = high if value > high else low
        micro = format_quantity(1e-12 * value, unit).replace("µ", "u")
        # the user probably typed M (mega) instead of u (micro)
        if unit in _MICRO_UNITS and 1e6 <= value < 1e9:
            fitting = None
            advice = f'write  "{micro}"  if you mean micro, not mega'
        else:
            verb = "lower" if value > high else "raise"
            advice = f"{verb} the value to {format_quantity(limit, unit)}"
        yield ImplausibleValueError(
            f"this value is {'larger' if value > high else 'smaller'} than plausible: {why}",
            where=where,
            got=format_quantity(value, unit),
            expected=f"{format_quantity(low, unit)} to {format_quantity(high, unit)}",
            hint=f'did you mean "{proposal}"?' if fitting else advice,
        )


def check_usual_range(
    where: str, value: float, usual: UsualRange, hint: str | None = None
) -> Iterator[UsageError]:
    """Yield a warning if a value is outside of its usual range.

    The yielded exception is printed as a warning. ``hint`` is the proposed action; by default,
    another unit is proposed.
    """
    if not value or usual.low <= value < usual.high:
        return
    units = _USUAL_UNITS.get(usual.unit, {}).items()
    fitting = next((name for name, size in units if usual.low < value * size < usual.high), None)
    if hint is None and fitting:
        hint = f'a number without a unit is in {usual.unit}: did you mean "{value:g} {fitting}"?'
    yield UnusualValueError(
        f"{'smaller' if value < usual.low else 'larger'} than usual: {usual.why}",
        where=where,
        got=format_quantity(value, usual.unit),
        hint=hint,
    )


def check_plausible_values(where: str, keys: BaseModel) -> Iterator[UsageError]:
    """Yield an error for each key outside of its plausible or usual range.

    Values in lists and in inner tables are also checked.
    """
    for name, field in type(keys).model_fields.items():
        ranges = get_plausible_range(field), get_usual_range(field)
        yield from _check_value(f"{where}.{name}".lstrip("."), *ranges, getattr(keys, name))


# usual ranges of constants in the table of a material
_USUAL_CONSTANTS = {"density": USUAL_SOLID_DENSITY, "quality": USUAL_Q_FACTOR}


def _check_value(
    where: str, plausible: PlausibleRange | None, usual: UsualRange | None, value: Any
) -> Iterator[UsageError]:
    """Yield an error for each implausible or unusual number in the value of one key.

    The value is a number, a list or a table.
    """
    if isinstance(value, BaseModel):
        yield from check_plausible_values(where, value)
    elif isinstance(value, Mapping):  # table of material constants, as typed
        for name, item in value.items():
            inner = _USUAL_CONSTANTS.get(name)
            number = float(item) if isinstance(item, int) else item
            yield from _check_value(f"{where}.{name}", None, inner, number)
    elif isinstance(value, tuple):
        for k, item in enumerate(value):
            yield from _check_value(f"{where}.{k}", plausible, usual, item)
    elif isinstance(value, float) and value:
        errors: list[UsageError] = []
        if plausible is not None:
            low, high, why = plausible.low, plausible.high, plausible.why
            errors += check_range(where, value, plausible.unit, low, high, why)
        if usual is not None and not errors:
            errors += check_usual_range(where, value, usual)
        yield from errors


def check_layers(
    where: str, entries: Iterable[tuple[float, float, bool, float | None]], *, plate: bool
) -> Iterator[UsageError]:
    """Yield an error for each layer with an implausible shape.

    Each of the ``entries`` contains the width [m] and the thickness [m] of a layer, whether the
    layer is a ceramic, and the diameter [m] of its electrodes if stated. A layer is implausible if
    it is more than ``MAX_LAYER_ASPECT`` times as thick as wide. If ``plate`` is true, a ceramic
    layer must not be wider than its metal plate.
    """
    rows = list(entries)
    metal = max((width for width, _, ceramic, _ in rows if not ceramic), default=0.0)
    wide = "ceramic that is wider than its plate breaks off"
    for k, (width, thickness, ceramic, electrodes) in enumerate(rows):
        thick = (
            f"no layer is more than {MAX_LAYER_ASPECT:g} times as thick as it is wide, "
            f"{format_quantity(width, 'm')}"
        )
        yield from check_range(
            f"{where}.{k}.thickness", thickness, "m", 0.0, MAX_LAYER_ASPECT * width, thick
        )
        if plate and ceramic and metal:
            limit = MAX_OVERHANG * metal
            for error in check_range(f"{where}.{k}.diameter", width, "m", 0.0, limit, wide):
                if electrodes is not None and electrodes > limit:
                    error.hint = (
                        f"{error.hint}, and lower the key `electrodes` to at most this value"
                    )
                yield error


def check_drive_levels(scene: Scene) -> Iterator[UsageError]:
    """Yield an error for each source with a voltage far above an electrode's rating.

    A voltage from 1 to ``BREAKDOWN_RATIO`` times the rated voltage causes a warning. A voltage
    below ``LOWEST_DRIVE_RATIO`` times the rated voltage also causes a warning.
    """
    rated = {name: pin.rated for (name, _), pin in scene.terminals.items() if pin.rated}
    for body, limit in rated.items():
        for name, peak in _list_peak_voltages(body, scene):
            state = f"{peak:.4g} V at {body}, whose ceramic withstands {limit:.4g} V"
            # suggest the same number in V or in mV, if the rating permits this voltage
            units = {f"{1e3 * peak:g} V": 1e3 * peak, f"{peak:g} mV": 1e-3 * peak}
            fits = (text for text, v in units.items() if LOWEST_DRIVE_RATIO * limit <= v <= limit)
            fitting = next(fits, None)
            hint = fitting and f"did you mean {fitting}?"
            if peak > BREAKDOWN_RATIO * limit:
                yield UsageError(
                    "this voltage depolarises the ceramic or causes a breakdown",
                    where=name,
                    got=state,
                    expected=f"at most {limit:.4g} V",
                    hint=hint,
                )
            elif peak > limit:
                warn_user(f"{name}: {state}: the ceramic may depolarise")
            elif 0.0 < peak < LOWEST_DRIVE_RATIO * limit:
                warn_user(f"{name}: {state}: {hint or 'is the unit right?'}")


def _list_peak_voltages(body: str, scene: Scene) -> Iterator[tuple[str, float]]:
    """Yield the name and the peak voltage [V] of each source that drives a body.

    The result contains only ideal sources between ground and an electrode of ``body``.
    """
    nets = {scene.get_net(body, pin.name) for pin in scene.pins(body) if pin.unit == "V"}
    for source in scene.list_parts("source"):
        wave = source.type.voltage(source, scene)
        if wave is None or scene.nets[source.name, "ret"] != "0":
            continue
        if scene.nets[source.name, "out"] in nets:
            corners = np.concatenate(
                [[0.0], wave.find_corner_times(scene.stop_time), [scene.stop_time]]
            )
            peak = np.abs(wave(corners)).max() if wave.is_piecewise_linear else abs(wave.amplitude)
            yield source.name, float(peak)


def check_model_masses(build: BuiltScene) -> Iterator[UsageError]:
    """Yield an error for each part whose model has an implausible mass."""
    for part in build.scene.parts.values():
        mass = build.get_model_values(part).get("mass_kg")
        if mass is not None:
            yield from check_range(
                part.name,
                mass,
                PLAUSIBLE_MASS.unit,
                PLAUSIBLE_MASS.low,
                PLAUSIBLE_MASS.high,
                PLAUSIBLE_MASS.why,
            )


def check_usual_results(waves: Waveforms, build: BuiltScene) -> Iterator[Check]:
    """Yield a violated check for each SI unit with a result out of its usual range.

    The check reports the result that exceeds the range most. The linear responses of an ``ac`` or
    ``noise`` analysis are not checked, because their amplitudes may be arbitrary.
    """
    scene = build.scene
    if scene.analysis.is_small_signal or scene.checks.plausible == "off":
        return
    for usual in USUAL_RESULTS:
        extremes: list[tuple[float, float, float, str]] = []
        for name, unit in build.results.units.items():
            values = waves.data.get(name)
            if unit != usual.unit or values is None or not values.size:
                continue
            ends = ((usual.low, float(values.real.min())), (usual.high, float(values.real.max())))
            extremes += [(value / limit, value, limit, name) for limit, value in ends]
        ratio, value, limit, name = max(extremes, default=(0.0, 0.0, 0.0, ""))
        if ratio > 1:
            advice = f"{usual.why}: check the values and units of the scene"
            label = f"usual range of {name}"
            yield Check(label, abs(value), abs(limit), usual.unit, advice, "warn")


def apply_check_action(errors: Iterable[UsageError], action: str) -> Iterator[UsageError]:
    """Yield errors, print them as warnings, or ignore them, depending on ``action``.

    The ``action`` ``"fail"`` yields the errors, ``"warn"`` prints the errors, and ``"off"`` ignores
    the errors. An :class:`UnusualValueError` is never yielded, but printed as a warning.
    """
    if action == "off":
        return
    for item in errors:
        if isinstance(item, UnusualValueError):
            hint = item.hint or "is the unit right?"
            warn_user(f"{item.where}: {item.got} is {item.message}; {hint}")
            continue
        if action == "warn":
            warn_user(f"{item.where}: {item.got}: {item.message}")
            continue
        hint = item.hint or "is the unit right?"
        item.hint = f"{hint} (to run the scene with this value, set checks.plausible = 'warn')"
        yield item
