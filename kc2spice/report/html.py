"""Writer of self-contained HTML pages with tables, notes and figures.

The browser draws the figures, so a page contains the curves as data, the library uPlot, and the
script ``plots.js``. Tables contain numbers with SI prefixes, and labels in words instead of the
keys of ``result.json``.
"""

from __future__ import annotations

import shlex
import sys
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import Any

from kc2spice.core import __version__
from kc2spice.core.figure import Figure
from kc2spice.core.mesh_error_descriptions import MESH_ERROR_PREFIX
from kc2spice.core.si_prefix_format import format_percent, format_quantity
from kc2spice.netlist.number_and_name_spelling import get_template_environment
from kc2spice.report.charts import render_figure

# Words in labels that replace words in keys of `result.json`.
_LABEL_WORDS = {
    "bvd": "equivalent circuit",
    "quality": "Q factor",
    "c0": "C0",
    "rm": "Rm",
    "lm": "Lm",
    "cm": "Cm",
}
# Labels of values whose keys do not state the condition, the reference or the kind of value.
_LABELS = {
    "resonance_short_hz": "natural frequency, electrodes shorted",
    "resonance_open_hz": "natural frequency, electrodes open",
    "resonance_hz": "series resonance",
    "antiresonance_hz": "parallel resonance",
    "largest_impedance_hz": "frequency of the largest impedance",
    "capacitance_f": "low-frequency capacitance",
    "capacitance_free_f": "free capacitance, static",
    "capacitance_clamped_f": "clamped capacitance, static",
    "coupling": "effective coupling factor",
    "nodal_circle_m": "nodal circle, diameter",
    "level_error_db": "uncertainty of the level",
    "unknowns": "unknowns of the full model",
    "mesh_limit_hz": "mesh resolves waves up to",
    "force_max_n": "largest force",
    "coil_mutual_h": "mutual inductance of the coils",
    "coil_temperature_rise_k": "coil temperature rise, peak",
    "coil_resistance_ratio": "coil resistance ratio, peak",
    "coil_heat_j": "heat dissipated in the coils",
    "kick_stroke_m": "kick stroke, peak",
    "final_position_m": "final height",
    "final_error_m": "set point minus final height",
    "hold_current_a": "mean hold current at the end",
    "launch_time_s": "time of launch",
    "still_rising": "sphere still rising at the end",
    "order": "states",
    "mesh_error_resonance": "mesh error, first resonance",
    "mesh_error_modes": "mesh error, worst of the lowest modes",
    "massless": "residual modes without mass",
    "method": "error estimated as",
    "band_hz": "band",
    "norm": "error relative to",
}
# Beginnings of keys, with the words that replace them.
_LABEL_PREFIXES = {
    "area_": "area of ",
    "free_stroke_": "free stroke of ",
    MESH_ERROR_PREFIX: "mesh error, ",
}
# Beginnings of the keys of ratios that are printed in percent.
_PERCENT_KEYS = (MESH_ERROR_PREFIX, "error_estimate", "efficiency")
# Suffixes of keys in `result.json` that denote a unit, keyed by unit.
_UNIT_SUFFIXES = {
    "m per 100 V": "_m_per_100v", "m/V": "_m_per_v", "m/s": "_m_s", "V/m": "_v_m", "N/m": "_n_m",
    "N s/m": "_n_s_m", "Ohm": "_ohm",
}  # fmt: skip
# Names of physical quantities, keyed by unit, which distinguish otherwise equal labels.
_QUANTITIES = {
    "s": "time", "m": "position", "m/s": "velocity", "Hz": "frequency", "V": "voltage",
    "A": "current", "N": "force", "J": "energy",
}  # fmt: skip
# Explanations of metrics whose value is the half-width of an interval, keyed by metric.
_HALF_WIDTH_NOTES = {"level_error_db": "root sum of squares, without the baffle row"}
HALF_WIDTH_DIGITS = 2  # significant digits of the half-width of an interval
MAX_ROW_VALUES = 8  # a longer list is replaced by the number of values


def format_times(seconds: Mapping[str, float]) -> list[tuple[str, str]]:
    """Return table rows of the stages of a run with wall times."""
    return [(stage, format_quantity(float(time), "s", 3)) for stage, time in seconds.items()]


def flatten_mapping(value: Any, joint: str = ".", path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the name and the value of each innermost entry of nested mappings.

    The name consists of the keys on the path to the entry, joined by ``joint``.
    """
    if isinstance(value, Mapping):
        for name, item in value.items():
            yield from flatten_mapping(item, joint, f"{path}{joint}{name}" if path else str(name))
    else:
        yield path, value


def label_key(key: str, unit: str = "") -> str:
    """Return a readable label for a key of ``result.json``, without its unit.

    Examples
    --------
    >>> label_key("free_stroke_ring0_m_per_v", "m/V"), label_key("force_max_n", "N")
    ('free stroke of ring0', 'largest force')
    """
    if key in _LABELS:
        return _LABELS[key]
    name = key.removesuffix(_UNIT_SUFFIXES.get(unit, f"_{unit.lower()}" if unit else ""))
    prefix = ""
    for beginning, replacement in _LABEL_PREFIXES.items():
        if name.startswith(beginning):
            name, prefix = name.removeprefix(beginning), replacement
    return prefix + " ".join(_LABEL_WORDS.get(word, word) for word in name.split("_"))


def distinguish_labels(labels: Mapping[str, str], units: Mapping[str, str]) -> dict[str, str]:
    """Add the physical quantity to labels that are otherwise equal.

    ``labels`` and ``units`` are keyed by the keys of ``result.json``.

    Examples
    --------
    >>> keys = {"turn1_s": "turn1", "turn1_m": "turn1", "speed_m_s": "speed"}
    >>> distinguish_labels(keys, {"turn1_s": "s", "turn1_m": "m", "speed_m_s": "m/s"})
    {'turn1_s': 'turn1, time', 'turn1_m': 'turn1, position', 'speed_m_s': 'speed'}
    """
    counts = Counter(labels.values())
    result = dict(labels)
    for key, label in labels.items():
        if counts[label] > 1 and units.get(key):
            result[key] = f"{label}, {_QUANTITIES.get(units[key], units[key])}"
    return result


def format_metric(key: str, value: Any, unit: str = "") -> tuple[str, str]:
    """Return the label of a metric, and its value with unit, as two strings.

    The half-width of an interval has a sign, such as ±7.1 dB.
    """
    values = value if isinstance(value, (list, tuple)) else [value]
    if len(values) > MAX_ROW_VALUES:
        return label_key(key, unit), f"{len(values)} values, in result.json"
    if key in _HALF_WIDTH_NOTES and isinstance(value, float):
        text = f"±{format_quantity(value, unit, HALF_WIDTH_DIGITS)}"
        return label_key(key, unit), f"{text}, {_HALF_WIDTH_NOTES[key]}"
    if key.startswith(_PERCENT_KEYS) and not unit:
        return label_key(key), ", ".join(map(format_percent, values))
    return label_key(key, unit), ", ".join(format_value(item, unit) for item in values)


def format_value(value: Any, unit: str = "") -> str:
    """Format a value: a number with unit, ``yes``, ``no``, or ``not reached``."""
    if value is None:
        return "not reached"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, int) and not unit:
        return f"{value:,}".replace(",", " ")
    return format_quantity(value, unit) if isinstance(value, (int, float)) else str(value)


@dataclass(frozen=True)
class PageSection:
    """Section of a page: heading, drawing, table, links, note and figures.

    All parts except the heading ``title`` are optional. ``drawing`` is HTML markup that is inserted
    into the page without escaping.
    """

    title: str
    rows: Sequence[Sequence[str]] = ()
    head: Sequence[str] = ()
    note: str = ""
    figures: Sequence[Figure] = ()
    drawing: str = ""
    links: Sequence[str] = ()

    @property
    def has_content(self) -> bool:
        """Whether the section contains more than a note."""
        return bool(self.rows or self.figures or self.drawing or self.links)


def write_page(
    path: Path,
    title: str,
    lead: str,
    sections: Sequence[PageSection],
    *,
    origin: Sequence[str] = (),
) -> Path:
    """Write a self-contained HTML page to ``path``; return the path.

    Sections that contain only a note are omitted. ``lead`` is the text below the title. The footer
    contains the version of kc2spice, the date, the command and the strings in ``origin``.
    """
    text = render_page(
        "report.html.j2",
        title=title,
        lead=lead,
        sections=[section for section in sections if section.has_content],
        footer=", ".join(
            [f"kc2spice {__version__}", f"{date.today()}", *_get_command_line(), *origin]
        ),
        plots=any(section.figures for section in sections),
    )
    path.write_text(text, encoding="utf-8")
    return path


def _get_command_line() -> list[str]:
    """Return a list with the kc2spice command line; an empty list for other programs.

    The list is empty if the running program is not kc2spice.
    """
    name, *words = sys.argv or [""]
    return [shlex.join(["kc2spice", *words])] if Path(name).stem == "kc2spice" else []


def render_page(template: str, **values: object) -> str:
    """Return the text of a page or a drawing, rendered from a template.

    Markup in ``values`` is escaped.
    """
    pages = get_template_environment(autoescape=True)
    pages.filters.update(figure=render_figure, px="{:.1f}".format)
    return str(pages.get_template(template).render(**values))
