"""One self-contained HTML page: sections with a table, a note and figures each.

The browser draws the figures: a page has their curves as data, and one script, ``plots.js``.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from jinja2.utils import htmlsafe_json_dumps

from kc2spice.core.figure import Curve, Figure, Map
from kc2spice.core.version import __version__
from kc2spice.netlist.cards import template_directory

SHOWN = 4000  # points of a curve in a page


@dataclass(frozen=True)
class Section:
    """A heading with, in this order and where given, a drawing (HTML that needs no escaping), a
    table, links to files, a note and figures."""

    title: str
    rows: Sequence[Sequence[str]] = ()
    head: Sequence[str] = ()
    note: str = ""
    figures: Sequence[Figure] = ()
    drawing: str = ""
    links: Sequence[str] = ()


def write_page(path: Path, title: str, lead: str, sections: Sequence[Section]) -> Path:
    """Render ``sections`` that have more than a note to ``path``; nothing is loaded from elsewhere.

    ``lead`` stands below the title.
    """
    text = rendered(
        "report.html.j2",
        title=title,
        lead=lead,
        sections=[s for s in sections if s.rows or s.figures or s.drawing or s.links],
        footer=f"kc2spice {__version__}",
        plots=any(section.figures for section in sections),
    )
    path.write_text(text, encoding="utf-8")
    return path


def rendered(template: str, **values: object) -> str:
    """A page or a drawing; whatever text it is given stays text in it."""
    environment = Environment(
        loader=FileSystemLoader(template_directory()),
        undefined=StrictUndefined,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(figure=figure_html, px="{:.1f}".format)
    return environment.get_template(template).render(**values)


def figure_html(figure: Figure) -> str:
    """The element ``<figure>`` from which the page's script draws: curves as JSON, a caption."""
    panels = [
        {**vars(p), "curves": [_curve(curve) for curve in p.curves], "map": p.map and _map(p.map)}
        for p in figure.panels
    ]
    data = htmlsafe_json_dumps(
        {"title": figure.title, "columns": figure.columns, "panels": panels},
        separators=(",", ":"),
        default=np.generic.item,
    )
    return (
        f'<figure data-plot><script type="application/json">{data}</script>'
        f"<figcaption>{escape(figure.caption)}</figcaption></figure>"
    )


def _curve(curve: Curve) -> dict[str, Any]:
    kept = _kept(np.asarray(curve.y, dtype=float))
    x, y = (_numbers(np.asarray(values)[kept]) for values in (curve.x, curve.y))
    names = [curve.names[k] for k in kept] if curve.names else []
    return {"label": curve.label, "style": curve.style, "x": x, "y": y, "names": names}


def _map(found: Map) -> dict[str, str]:
    return {"label": found.label, **{name: _numbers(getattr(found, name)) for name in "xyz"}}


def _numbers(values: np.ndarray) -> str:
    """Little-endian float32, row by row."""
    return base64.b64encode(np.asarray(values).astype("<f4").tobytes()).decode("ascii")


def _kept(y: np.ndarray) -> np.ndarray:
    """Indices of at most ``SHOWN`` points: of each stretch of points its extremes, and both sides
    of the largest jumps and of gaps, so that neither peaks nor corners are lost."""
    if y.size <= SHOWN:
        return np.arange(y.size)
    stretch = -(-y.size // (SHOWN // 5))
    padded = np.full(stretch * -(-y.size // stretch), np.nan)
    padded[: y.size] = y
    rows = padded.reshape(-1, stretch)
    known, first = np.isfinite(rows), stretch * np.arange(rows.shape[0])
    low = first + np.where(known, rows, np.inf).argmin(axis=1)
    high = first + np.where(known, rows, -np.inf).argmax(axis=1)
    steps = np.abs(np.diff(y))
    steps[~np.isfinite(steps)] = np.inf
    jumps = np.argpartition(steps, -SHOWN // 4)[-SHOWN // 4 :]
    kept = np.zeros(y.size, dtype=bool)
    for chosen in ([0, -1], low, high, jumps, jumps + 1):
        kept[chosen] = True
    return np.flatnonzero(kept)
