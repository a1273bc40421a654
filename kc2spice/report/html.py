"""One self-contained HTML page: sections with a table, a note and pictures each."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined

from kc2spice import __version__
from kc2spice.core.figure import Curve, Figure
from kc2spice.report.plots import Picture
from kc2spice.spice.render import template_directory

SHOWN = 4000  # points of a curve in a page


@dataclass(frozen=True)
class Section:
    """A heading with, in this order and where given, a drawing (SVG), a table, links to files, a
    note and pictures."""

    title: str
    rows: Sequence[Sequence[str]] = ()
    head: Sequence[str] = ()
    note: str = ""
    pictures: Sequence[Picture] = ()
    drawing: str = ""
    links: Sequence[str] = ()


def write_page(path: Path, title: str, lead: str, sections: Sequence[Section]) -> Path:
    """Render ``sections`` to ``path``; images are embedded, nothing is loaded from elsewhere."""
    environment = Environment(
        loader=FileSystemLoader(template_directory()),
        undefined=StrictUndefined,
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {"embed": _embed, "curves": _curves}
    text = environment.get_template("report.html.j2").render(
        title=title, lead=lead, sections=sections, footer=f"kc2spice {__version__}",
        interactive=any(picture.figure for s in sections for picture in s.pictures),
    )  # fmt: skip
    path.write_text(text, encoding="utf-8")
    return path


def _embed(picture: Picture) -> str:
    data = base64.b64encode(picture.path.read_bytes()).decode("ascii")
    return f"data:image/png;base64,{data}"


def _curves(figure: Figure) -> dict[str, Any]:
    """What the page's script draws: panels with their curves as little-endian float32."""
    return {
        "panels": [
            {
                "x": p.x, "y": p.y, "log_x": bool(p.log_x), "log_y": bool(p.log_y),
                "equal": p.equal, "span": p.span and [float(v) for v in p.span],
                "levels": [(float(v), label) for v, label in p.levels],
                "bands": [(float(low), float(high), label) for low, high, label in p.bands],
                "marks": [(float(v), label) for v, label in p.marks],
                "curves": [_thinned(curve) for curve in p.curves],
            }
            for p in figure.panels
        ]
    }  # fmt: skip


def _thinned(curve: Curve) -> dict[str, str]:
    """At most ``SHOWN`` points: of each stretch its extremes, and both sides of the largest jumps,
    so that neither peaks nor corners are lost."""
    x, y = (np.asarray(v, dtype=float) for v in (curve.x, curve.y))
    if x.size > SHOWN and np.isfinite(y).all():
        jumps = np.argpartition(np.abs(np.diff(y)), -SHOWN // 4)[-SHOWN // 4 :]
        ends = np.linspace(0, x.size, SHOWN // 5).astype(int)
        rising = np.lexsort((y, np.repeat(np.arange(ends.size - 1), np.diff(ends))))
        extremes = rising[ends[:-1]], rising[ends[1:] - 1]
        chosen = np.unique(np.concatenate(([0, x.size - 1], jumps, jumps + 1, *extremes)))
        x, y = x[chosen], y[chosen]
    code = [base64.b64encode(v.astype("<f4").tobytes()).decode("ascii") for v in (x, y)]
    return {"label": curve.label, "style": curve.style, "x": code[0], "y": code[1]}
