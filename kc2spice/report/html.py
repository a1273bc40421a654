"""One self-contained HTML page: sections with a table, a note and figures each.

The browser draws the figures: a page has their curves as data, the library uPlot, and one script,
``plots.js``.
Numbers stand there as people read them: with SI prefixes, under the names of what they are.
"""

from __future__ import annotations

import math
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from kc2spice.core import __version__
from kc2spice.core.figure import Figure
from kc2spice.core.prefix import PREFIXES, prefix_power
from kc2spice.netlist.spelling import templates
from kc2spice.report.charts import render_figure

# Units that carry a prefix already: the one that takes another prefix, and how many of it.
_PREFIXED = {"kg": ("g", 1e3), "mm": ("m", 1e-3), "um": ("m", 1e-6)}
# Words of keys that are none.
_WORDS = {
    "bvd": "equivalent circuit",
    "quality": "Q factor",
    "c0": "C0",
    "rm": "Rm",
    "lm": "Lm",
    "cm": "Cm",
}
# Whole keys: of a resonance it takes the electrical condition, and whether it was measured.
_NAMES = {
    "resonance_short_hz": "natural frequency, electrodes shorted",
    "resonance_open_hz": "natural frequency, electrodes open",
    "resonance_hz": "series resonance of the impedance",
    "antiresonance_hz": "parallel resonance of the impedance",
}
# Suffix of a key of result.json, by the unit in its record.
_SUFFIXES = {
    "m per 100 V": "_m_per_100v", "m/V": "_m_per_v", "m/s": "_m_s", "V/m": "_v_m", "N/m": "_n_m",
    "N s/m": "_n_s_m", "Ohm": "_ohm",
}  # fmt: skip
_SHOWN_UNITS = {"Ohm": "Ω"}
NOISE = 1e-12  # limit of rounding errors, relative to the scale of a number


def format_quantity(value: float | None, unit: str, digits: int = 4) -> str:
    """A number with an SI prefix: ``quantity(5.0573e-4, "s")`` is ``505.7 µs``."""
    if value is None:
        return "—"
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g} {unit}".strip()
    if _is_words(unit):
        return f"{value:.{digits}g} {unit}".strip()
    if unit in _PREFIXED:
        plain, factor = _PREFIXED[unit]
        return format_quantity(factor * value, plain, digits)
    return _with_prefix(value, unit, digits, prefix_power(value))


def _is_words(unit: str) -> bool:
    """Whether a unit takes no prefix: it is empty or a phrase such as ``of the peak``."""
    return not unit or (" " in unit and " per " not in unit)


def _with_prefix(value: float, unit: str, digits: int, power: int) -> str:
    sign = "−" if value < 0.0 else ""
    digits_text = f"{abs(value) / 10.0**power:.{digits}g}"
    return f"{sign}{digits_text} {PREFIXES[power]}{_SHOWN_UNITS.get(unit, unit)}"


def value_and_limit(value: float, limit: float, unit: str) -> tuple[str, str]:
    """Both with the same prefix: ``value_and_limit(4.06e5, 5e5, "Hz")`` is 406 kHz, 500 kHz.

    A limit of another order of magnitude has its own prefix. Rounding errors, relative to the
    limit, or to 1 for ratios, are printed as 0.
    """
    words = _is_words(unit)
    if abs(value) < NOISE * max(abs(limit), 1.0 if words else 0.0):
        value = 0.0
    near = value and limit and 1e-3 < abs(limit / value) < 1e4
    if words or unit in _PREFIXED or not near or not math.isfinite(value + limit):
        return format_quantity(value, unit, 3), format_quantity(limit, unit, 3)
    power = prefix_power(value)
    digits_text = f"{abs(limit) / 10.0**power:.10g}"
    digits = max(3, len(digits_text.partition(".")[0]))
    return _with_prefix(value, unit, 3, power), _with_prefix(limit, unit, digits, power)


def leaves(value: Any, joint: str = ".", path: str = "") -> Iterator[tuple[str, Any]]:
    """Values of nested mappings, by their names joined to one."""
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from leaves(item, joint, f"{path}{joint}{name}" if path else str(name))
    else:
        yield path, value


def fact(key: str, value: Any, unit: str = "") -> tuple[str, str]:
    """A key of result.json and its value as words, in the ``unit`` of its record.

    The key's end is left out where it spells that unit.
    """
    suffix = _SUFFIXES.get(unit, f"_{unit.lower()}" if unit else "")
    words = (_WORDS.get(word, word) for word in key.removesuffix(suffix).split("_"))
    name = _NAMES.get(key) or " ".join(words)
    if isinstance(value, (list, tuple)) and len(value) > 8:
        return name, f"{len(value)} values, in result.json"
    values = value if isinstance(value, (list, tuple)) else [value]
    return name, ", ".join(format_value(v, unit) for v in values)


def format_value(value: Any, unit: str = "") -> str:
    """A number with its unit, yes or no, or the word for what was not reached."""
    if value is None:
        return "not reached"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int) and not unit:
        return f"{value:,}".replace(",", " ")
    return format_quantity(value, unit) if isinstance(value, (int, float)) else str(value)


@dataclass(frozen=True)
class PageSection:
    """A heading with, in this order and where given, a drawing (HTML that needs no escaping), a
    table, links to files, a note and figures."""

    title: str
    rows: Sequence[Sequence[str]] = ()
    head: Sequence[str] = ()
    note: str = ""
    figures: Sequence[Figure] = ()
    drawing: str = ""
    links: Sequence[str] = ()


def write_page(
    path: Path,
    title: str,
    lead: str,
    sections: Sequence[PageSection],
    *,
    origin: Sequence[str] = (),
) -> Path:
    """Render ``sections`` that have more than a note to ``path``; nothing is loaded from elsewhere.

    ``lead`` stands below the title. The foot states version, date, command and ``origin``.
    """
    text = render_page(
        "report.html.j2",
        title=title,
        lead=lead,
        sections=[s for s in sections if s.rows or s.figures or s.drawing or s.links],
        footer=", ".join([f"kc2spice {__version__}", f"{date.today()}", *_command(), *origin]),
        plots=any(section.figures for section in sections),
    )
    path.write_text(text, encoding="utf-8")
    return path


def _command() -> list[str]:
    """The command line that makes the page, where it is one of ours."""
    name, *words = sys.argv or [""]
    return [shlex.join(["kc2spice", *words])] if Path(name).stem == "kc2spice" else []


def render_page(template: str, **values: object) -> str:
    """A page or a drawing; whatever text it is given stays text in it."""
    pages = templates(autoescape=True)
    pages.filters.update(figure=render_figure, px="{:.1f}".format)
    return str(pages.get_template(template).render(**values))
