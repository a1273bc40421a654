"""Draws docs/figures/architecture.svg: from a scene to a result, and who checks what."""

from __future__ import annotations

from pathlib import Path

OUT = Path(__file__).parents[1] / "docs" / "figures" / "architecture.svg"
BLUE, GREY, GREEN, ORANGE = "#0072B2", "#666666", "#009E73", "#B86E00"
STEPS = (
    ("Scene", "parts, pins,", "analysis, probes"),
    ("Linear model", "full: M, E, K, B, C", "with typed ports"),
    ("Reduced model", "same class, with", "a certificate"),
    ("Subcircuit", ".lib: one .subckt,", "table of pins"),
    ("Deck", "instances, options,", "saved vectors"),
    ("Result", "waveforms, metrics,", "checks, energy"),
)
ARROWS = ("FE or files", "reduce", "realise", "wire", "ngspice")
SOURCES = (
    (1, "stack, disc, bimorph, mesh, matrices"),
    (3, "contact, magnets, drivers, your netlist"),
)
WIDTH, HEIGHT, STEP, TOP = 132, 74, 186, 62


def main() -> None:
    """Write the picture."""
    items = [_box(k, *step) for k, step in enumerate(STEPS)]
    items += [_arrow(k, text) for k, text in enumerate(ARROWS)]
    items += [_source(k, text) for k, text in SOURCES]
    items += [_bracket(1, 5, "verify: full model, reduced model and ngspice against each other")]
    total = STEP * (len(STEPS) - 1) + WIDTH + 20
    OUT.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {total} 210" '
        'font-family="DejaVu Sans, Arial, sans-serif" font-size="11">\n'
        '<rect width="100%" height="100%" fill="white"/>\n'
        '<defs><marker id="tip" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" '
        'markerHeight="7" orient="auto"><path d="M0 0L8 4L0 8z" fill="#666666"/></marker></defs>\n'
        + "\n".join(items)
        + "\n</svg>\n",
        encoding="utf-8",
    )


def _left(k: int) -> int:
    return 10 + STEP * k


def _text(x: float, y: float, text: str, colour: str = "#222222", extra: str = "") -> str:
    return f'<text x="{x}" y="{y}" text-anchor="middle" fill="{colour}" {extra}>{text}</text>'


def _box(k: int, title: str, *lines: str) -> str:
    x, middle = _left(k), _left(k) + WIDTH / 2
    box = (
        f'<rect x="{x}" y="{TOP}" width="{WIDTH}" height="{HEIGHT}" rx="7" fill="#EAF3FA" '
        f'stroke="{BLUE}" stroke-width="1.5"/>'
    )
    head = _text(middle, TOP + 23, title, BLUE, 'font-weight="bold" font-size="13"')
    return "\n".join(
        [box, head, *(_text(middle, TOP + 43 + 16 * i, s) for i, s in enumerate(lines))]
    )


def _arrow(k: int, text: str) -> str:
    x0, x1, y = _left(k) + WIDTH + 3, _left(k + 1) - 3, TOP + HEIGHT / 2
    line = f'<path d="M{x0} {y}H{x1}" stroke="{GREY}" stroke-width="1.5" marker-end="url(#tip)"/>'
    return line + "\n" + _text((x0 + x1) / 2, TOP - 8, text, GREY)


def _source(k: int, text: str) -> str:
    x = _left(k) + WIDTH / 2
    line = (
        f'<path d="M{x} 26V{TOP - 3}" stroke="{ORANGE}" stroke-width="1.2" stroke-dasharray="3 3" '
        'marker-end="url(#tip)"/>'
    )
    return line + "\n" + _text(x, 18, text, ORANGE)


def _bracket(first: int, last: int, text: str) -> str:
    x0, x1, y = _left(first) + WIDTH / 2, _left(last) + WIDTH / 2, TOP + HEIGHT + 6
    path = f'<path d="M{x0} {y}v14H{x1}v-14" fill="none" stroke="{GREEN}" stroke-width="1.5"/>'
    return path + "\n" + _text((x0 + x1) / 2, y + 32, text, GREEN)


if __name__ == "__main__":
    main()
