"""One self-contained HTML page: sections with a table, a note and pictures each."""

from __future__ import annotations

import base64
import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from kc2spice import __version__
from kc2spice.report.plots import Picture
from kc2spice.spice.render import template_directory

_PREFIXES = {-15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


@dataclass(frozen=True)
class Section:
    """A heading with, in this order and where given, a table, a note and pictures."""

    title: str
    rows: Sequence[Sequence[str]] = ()
    head: Sequence[str] = ()
    note: str = ""
    pictures: Sequence[Picture] = ()


def write_page(path: Path, title: str, lead: str, sections: Sequence[Section]) -> Path:
    """Render ``sections`` to ``path``; images are embedded, nothing is loaded from elsewhere."""
    environment = Environment(
        loader=FileSystemLoader(template_directory()),
        undefined=StrictUndefined,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["embed"] = _embed
    text = environment.get_template("report.html.j2").render(
        title=title, lead=lead, sections=sections, footer=f"kc2spice {__version__}"
    )
    path.write_text(text, encoding="utf-8")
    return path


def _embed(picture: Picture) -> str:
    data = base64.b64encode(picture.path.read_bytes()).decode("ascii")
    return f"data:image/png;base64,{data}"


def quantity(value: float | None, unit: str, digits: int = 5) -> str:
    """A number with an SI prefix: ``quantity(5.0573e-4, "s")`` is ``505.73 µs``."""
    if value is None:
        return "—"
    if value == 0.0 or not math.isfinite(value):
        return f"{value:g} {unit}".strip()
    if not unit:
        return f"{value:.{digits}g}"
    power = min(max(3 * math.floor(math.log10(abs(value)) / 3), -15), 9)
    if unit == "kg":  # its prefix is part of the unit: write grams
        return quantity(1e3 * value, "g", digits)
    sign = "−" if value < 0.0 else ""
    return f"{sign}{abs(value) / 10.0**power:.{digits}g} {_PREFIXES[power]}{unit}"
