"""Keys that a fit varies, their ranges, and resonances of admittance curves."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence
from operator import attrgetter
from typing import Any

import numpy as np
from scipy.signal import find_peaks

from kc2spice.core.errors import UsageError
from kc2spice.parts.bodies._varied_keys import VariedKey, make_varied_key, read_number_key
from kc2spice.scene.model import Scene
from kc2spice.workflow.sweep.grid import parse_value

# Default ends of a range, relative to the value: ceramics vary by 30 %, losses by a factor of ten.
VALUE_RANGE = 1.3
LOSS_RANGE = 10.0
_LOSS_KEY = re.compile(r"damping|quality|ratio|loss")
# Smallest height of a peak, relative to the largest conductance, and relative to the noise.
MIN_PROMINENCE = 0.005
MIN_NOISE_RATIO = 8.0
# Half-width of a netlist's parameter range in standard errors, and smallest relative half-width.
RANGE_ERRORS = 2.0
MIN_HALF_WIDTH = 1.1e-3


def read_varied_keys(
    scene: Scene, part: str, vary: Sequence[str] | Mapping[str, tuple[float, float] | None]
) -> list[VariedKey]:
    """Return the keys that the fit varies, with their ranges."""
    ends = dict(vary) if isinstance(vary, Mapping) else dict.fromkeys(vary)
    for key, span in ends.items():
        if span is not None and not (isinstance(span, (tuple, list)) and len(span) == 2):
            raise UsageError(
                "this text is not a range",
                where=key,
                got=repr(span),
                expected="two numbers in SI units, or None for the default range",
                hint=f'write {{"{key}": (LOW, HIGH)}}',
            )
    result = []
    for text, span in ends.items():
        key, _, limits = text.partition("=")
        value, unit = read_number_key(scene.get_part(part, where=part), key, key)
        factor = LOSS_RANGE if _LOSS_KEY.search(key) else VALUE_RANGE
        span = (_parse_range(key, limits) if limits else span) or (value / factor, value * factor)
        result.append(make_varied_key(key, unit, value, span))
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


def _parse_range(key: str, text: str) -> tuple[float, float]:
    """Parse the range of a key from text such as ``LOW:HIGH``."""
    ends = text.split(":")
    if len(ends) != 2:
        raise UsageError(
            "this text is not a range",
            where=key,
            got=text,
            expected="LOW:HIGH in SI units",
            hint=f"write {key}=LOW:HIGH, two numbers with a colon between them",
        )
    low, high = (parse_value(end, "", key) for end in ends)
    return low, high


def compute_log_widths(keys: Sequence[VariedKey]) -> list[float]:
    """Return the width of each key's range: the logarithm of high over low."""
    return [abs(float(np.log(item.high / item.low))) for item in keys]


def format_calibrated_ranges(part: str, parameters: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the key ``rom.parameters`` of a part, with ranges around fitted values.

    Each range extends :data:`RANGE_ERRORS` standard errors on both sides of the value, and is
    limited to the range of the fit.
    """
    result = []
    for key, item in parameters.items():
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
