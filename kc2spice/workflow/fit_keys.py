"""Keys that a fit varies, their ranges, and resonances of admittance curves."""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np
from scipy.signal import find_peaks

from kc2spice.core.errors import UsageError
from kc2spice.core.unit_spelling import find_range_ends
from kc2spice.parts.bodies._varied_keys import (
    VariedKey,
    find_value,
    make_varied_key,
    read_number_key,
    split_key,
)
from kc2spice.rom.parametric_models import MAX_PARAMETERS
from kc2spice.scene.scene_classes import Scene
from kc2spice.workflow.sweep.grid import parse_value, require_equal_unit_use

# Default ends of a range, relative to the value: ceramics vary by 30 %, losses by a factor of ten.
VALUE_RANGE = 1.3
LOSS_RANGE = 10.0
_LOSS_KEY = re.compile(r"damping|quality|ratio|loss")
# smallest height of a peak, divided by the largest conductance
MIN_PROMINENCE = 0.005
# smallest height of a peak, divided by the noise of the conductance
MIN_NOISE_RATIO = 8.0
# Half-width of a netlist's parameter range in standard errors, and smallest relative half-width.
RANGE_ERRORS = 2.0
MIN_HALF_WIDTH = 1.1e-3


def require_key_list(vary: object) -> None:
    """Raise an error if the argument ``vary`` of a fit is not a collection of strings."""
    is_list = isinstance(vary, Collection) and not isinstance(vary, (str, bytes))
    if is_list and all(isinstance(key, str) for key in vary):  # type: ignore[attr-defined]
        return
    raise UsageError(
        "vary is not a list of keys",
        where="vary",
        got=repr(vary)[:120],
        expected='a list such as ["damping.quality"], or a mapping of keys to ranges',
        hint=f"write vary=[{vary!r}]"
        if isinstance(vary, str)
        else 'for example vary=["damping.quality"]',
    )


def read_varied_keys(
    scene: Scene, part: str, vary: Sequence[str] | Mapping[str, tuple[float, float] | None]
) -> list[VariedKey]:
    """Return the keys that the fit varies, with their ranges."""
    ends = dict(vary) if isinstance(vary, Mapping) else dict.fromkeys(vary)
    for key, span in ends.items():
        if span is not None and not _is_pair_of_numbers(span):
            raise UsageError(
                "this value is not a range",
                where=key,
                got=repr(span)[:120],
                expected="two finite numbers in SI units, or None for the default range",
                hint=_suggest_pair(key, span),
            )
    result = []
    for text, span in ends.items():
        key, _, limits = text.partition("=")
        value, unit = read_number_key(scene.get_part(part, where=part), key, key)
        factor = LOSS_RANGE if _LOSS_KEY.search(key) else VALUE_RANGE
        if limits:
            low, high = _parse_range(key, limits, unit)
        elif span is not None:
            low, high = span
        else:
            low, high = value / factor, value * factor
        example = f"{key}={{:g}}:{{:g}}"
        result.append(make_varied_key(key, unit, value, (low, high), example=example))
    for name, count in Counter(map(attrgetter("key"), result)).items():
        if count > 1:
            raise UsageError(
                "the same key is varied twice",
                where=part,
                got=name,
                expected="each key once",
                hint=f"delete one of the options --vary {name}",
            )
    return result


def _is_pair_of_numbers(span: object) -> bool:
    """Return whether an object is a tuple or a list of two finite real numbers."""
    if not isinstance(span, (tuple, list)) or len(span) != 2:
        return False
    types = (int, float, np.integer, np.floating)
    return all(
        isinstance(end, types) and not isinstance(end, bool) and math.isfinite(end) for end in span
    )


def _suggest_pair(key: str, span: object) -> str:
    """Return the advice to write the range of a key as two numbers."""
    ends = find_range_ends(span) if isinstance(span, str) else None
    try:
        low, high = map(float, ends or span)  # type: ignore[call-overload]
    except (TypeError, ValueError):
        low, high = math.nan, math.nan
    if math.isfinite(low) and math.isfinite(high):
        return f'write {{"{key}": ({low:g}, {high:g})}}'
    return f'write {{"{key}": (LOW, HIGH)}} with two numbers, or {{"{key}": None}}'


def _parse_range(key: str, text: str, unit: str) -> tuple[float, float]:
    """Parse the range of a key from text such as ``LOW:HIGH``, in an SI unit."""
    ends = text.split(":")
    if len(ends) != 2:
        dotted = find_range_ends(text)
        raise UsageError(
            "this text is not a range",
            where=key,
            got=text,
            expected="LOW:HIGH; numbers without a unit are in SI units",
            hint=f"write {key}={':'.join(dotted)}"
            if dotted
            else f"write {key}=LOW:HIGH, two numbers with a colon between them",
        )
    require_equal_unit_use(ends, text, key, unit)
    low, high = (parse_value(end, unit, key) for end in ends)
    return low, high


def name_scene_keys(scene: Scene, part: str, values: Mapping[str, float]) -> dict[str, float]:
    """Rename keys of a part to their dotted names in the scene; keep the values.

    If the scene contains a single number in place of a list, such as ``fs = "6 kHz"`` for
    ``fs[0]``, the name has no index.
    """
    result = {}
    for key, value in values.items():
        plain = key.removesuffix("[0]")
        entry = find_value(scene.tables.get(part), split_key(plain))
        result[f"{part}.{key if isinstance(entry, (list, tuple)) else plain}"] = value
    return result


def compute_log_widths(keys: Sequence[VariedKey]) -> list[float]:
    """Return the width of each key's range: the logarithm of high over low."""
    return [abs(float(np.log(item.high / item.low))) for item in keys]


def choose_netlist_parameters(parameters: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Choose the fitted keys that can together become parameters of a netlist.

    A netlist has at most :data:`MAX_PARAMETERS` parameters. If more keys were fitted, the keys with
    the largest relative standard errors are chosen, because their values are the least certain.
    """

    def compute_uncertainty(key: str) -> float:
        """Return the relative standard error of a fitted value."""
        return float(parameters[key]["sigma"] / abs(parameters[key]["value"]))

    chosen = sorted(parameters, key=compute_uncertainty, reverse=True)[:MAX_PARAMETERS]
    return [key for key in parameters if key in chosen]


def format_calibrated_ranges(part: str, parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the key ``rom.parameters`` of a part, with ranges around fitted values.

    The ranges belong to the keys of :func:`choose_netlist_parameters`. Each range extends
    :data:`RANGE_ERRORS` standard errors on both sides of the value, and is limited to the range of
    the fit.
    """
    result = []
    for key in choose_netlist_parameters(parameters):
        item = parameters[key]
        half = max(RANGE_ERRORS * item["sigma"], MIN_HALF_WIDTH * abs(item["value"]))
        low, high = sorted((item["low"], item["high"]))
        ends = max(low, item["value"] - half), min(high, item["value"] + half)
        result.append(f'"{key}" = [{ends[0]!r}, {ends[1]!r}]')
    return f'"{part}.rom.parameters" = {{ {", ".join(result)} }}\n'


def is_at_bound(item: VariedKey, value: float) -> bool:
    """Return whether a value is at an end of its key's range."""
    nearest = min(abs(np.log(value / item.low)), abs(np.log(value / item.high)))
    return bool(nearest < 1e-4 * abs(np.log(item.high / item.low)))


def find_resonances(f: np.ndarray, Y: np.ndarray, noise: float) -> list[float]:
    """Return the frequencies [Hz] of prominent peaks of the conductance.

    Peaks that the ``noise`` can explain are omitted.
    """
    least = np.maximum(MIN_PROMINENCE * float(Y.real.max()), MIN_NOISE_RATIO * noise * np.abs(Y))
    result, _ = find_peaks(Y.real, prominence=least)
    frequencies: list[float] = f[result].tolist()
    return frequencies
