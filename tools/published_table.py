"""Writes docs/published.md: numbers of data sheets beside those of the full models.

python tools/published_table.py
"""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

from kc2spice.bodies import disc
from kc2spice.bodies.convergence import mesh_error
from kc2spice.rom.linear import LinearModel

ROOT = Path(__file__).parents[1]
UNITS = {
    "resonance_hz": ("resonance", 1e3, "kHz"),
    "capacitance_f": ("capacitance", 1e-9, "nF"),
    "feedback_capacitance_f": ("feedback capacitance", 1e-9, "nF"),
}
HEAD = """# Devices with published numbers

Nothing is fitted: textbook PZT-5A and brass, the dimensions of the sheet, a free plate (sheets
measure at the node, which changes the resonance by a tenth of a percent). Numbers and sources:
`docs/published.toml`; written by `python tools/published_table.py`. *mesh* bounds the error of the
resonance that is due to the mesh.

| device | quantity | sheet | full model | difference | within | mesh |
|---|---|---|---|---|---|---|
"""


def predicted(model: LinearModel, quantity: str) -> float:
    """The model's value of a published quantity (SI)."""
    if quantity == "resonance_hz":
        return model.facts["resonance_short_hz"]
    if quantity == "capacitance_f":
        return model.facts["capacitance_free_f"]
    return model.facts[quantity]


def rows(name: str, entry: dict[str, Any]) -> list[str]:
    """One row a quantity."""
    scene = tomllib.loads((ROOT / "kc2spice" / "scenes" / f"{name}.toml").read_text("utf-8"))
    keys = {key: value for key, value in scene["disc"].items() if key not in ("part", "pins")}
    model = disc.build(keys)
    lines = []
    for quantity, (label, unit, text) in UNITS.items():
        if quantity not in entry:
            continue
        sheet, value = entry[quantity], predicted(model, quantity)
        difference = value / sheet["value"] - 1
        limit = f"{sheet['value'] / unit:.3g} {text} ± {100 * sheet['tolerance']:.0f} %"
        inside = "yes" if abs(difference) <= sheet["tolerance"] else "**no**"
        mesh = f"{100 * mesh_error(disc.build, keys):.1f} %" if quantity == "resonance_hz" else ""
        lines.append(
            f"| {entry['device']} | {label} | {limit} | {value / unit:.4g} {text} "
            f"| {100 * difference:+.1f} % | {inside} | {mesh} |"
        )
    return lines


def main() -> None:
    """Write the table and, below it, why some figures miss."""
    published = tomllib.loads((ROOT / "docs" / "published.toml").read_text("utf-8"))
    lines = [row for name, entry in published.items() for row in rows(name, entry)]
    reasons = [
        f"- {entry['device']}, {UNITS[quantity][0]}: {reason}."
        for entry in published.values()
        for quantity, reason in entry.get("misses", {}).items()
    ]
    sources = [f"- {entry['device']}: {entry['source']}." for entry in published.values()]
    text = HEAD + "\n".join(lines) + "\n\nWhat misses, and why:\n\n" + "\n".join(reasons)
    text += "\n\nSources:\n\n" + "\n".join(sources) + "\n"
    (ROOT / "docs" / "published.md").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
