"""Numbers as people read them: keys of result.json and their values in words, with SI prefixes."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from typing import Any

_PREFIXES = {-15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}
# Words of keys that are none.
_WORDS = {"bvd": "equivalent circuit", "c0": "C0", "rm": "Rm", "lm": "Lm", "cm": "Cm"}
# Whole keys: of a resonance it takes the electrical condition, and whether it was measured.
_NAMES = {
    "resonance_short_hz": "resonance of the model, electrodes shorted, undamped",
    "resonance_open_hz": "resonance of the model, electrodes open, undamped",
    "resonance_hz": "resonance read off the impedance (series, as if shorted)",
    "antiresonance_hz": "resonance read off the impedance (parallel, as if open)",
}
# Longest suffix first: the key's name says its unit, as in result.json.
_SUFFIXES = (
    ("_m_per_100v", "m per 100 V"), ("_m_per_v", "m/V"), ("_m_s", "m/s"), ("_v_m", "V/m"),
    ("_pa", "Pa"), ("_mm", "mm"),
    ("_hz", "Hz"), ("_kg", "kg"), ("_ohm", "Ω"), ("_m", "m"), ("_s", "s"), ("_a", "A"),
    ("_n", "N"), ("_f", "F"), ("_h", "H"), ("_v", "V"), ("_c", "C"), ("_j", "J"),
)  # fmt: skip


def quantity(value: float | None, unit: str, digits: int = 5) -> str:
    """A number with an SI prefix: ``quantity(5.0573e-4, "s")`` is ``505.73 µs``."""
    if value is None:
        return "—"
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g} {unit}".strip()
    if not unit or (" " in unit and " per " not in unit):  # words take no prefix
        return f"{value:.{digits}g} {unit}".strip()
    if unit == "kg":  # its prefix is part of the unit: write grams
        return quantity(1e3 * value, "g", digits)
    power = 3 * math.floor(math.log10(abs(value)) / 3)
    power = power if power in _PREFIXES else 0
    sign = "−" if value < 0.0 else ""
    return f"{sign}{abs(value) / 10.0**power:.{digits}g} {_PREFIXES[power]}{unit}"


def unit_of(key: str) -> str:
    """Unit that a key of result.json names by its suffix, empty where it names none."""
    return _suffix(key)[1]


def _suffix(key: str) -> tuple[str, str]:
    return next(((s, u) for s, u in _SUFFIXES if key.endswith(s)), ("", ""))


def leaves(value: Any, joint: str = ".", path: str = "") -> Iterator[tuple[str, Any]]:
    """What stands below mappings in mappings, by its names joined to one."""
    if isinstance(value, Mapping):
        for name, each in value.items():
            yield from leaves(each, joint, f"{path}{joint}{name}" if path else str(name))
    else:
        yield path, value


def fact(key: str, value: Any, digits: int = 5, unit: str = "") -> tuple[str, str]:
    """A key of result.json and its value as words: the suffix of the key is the unit, but for a
    key of a user's own choice, whose ``unit`` is told."""
    suffix, named = _suffix(key)
    if unit and unit != named:
        suffix = ""
    unit = unit or named
    words = (_WORDS.get(word, word) for word in key.removesuffix(suffix).split("_"))
    name = _NAMES.get(key) or " ".join(words)
    if isinstance(value, (list, tuple)) and len(value) > 8:
        return name, f"{len(value)} values, in result.json"
    values = value if isinstance(value, (list, tuple)) else [value]
    return name, ", ".join(worded(v, unit, digits) for v in values)


def worded(value: Any, unit: str = "", digits: int = 5) -> str:
    """A number with its unit, yes or no, or the word for what was not reached."""
    if value is None:
        return "not reached"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int) and not unit:
        return f"{value:,}".replace(",", " ")
    return quantity(value, unit, digits) if isinstance(value, (int, float)) else str(value)
