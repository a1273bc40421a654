"""Scripts by which ngspice plots the results of a deck."""

from __future__ import annotations

from kc2spice.netlist.deck import Deck
from kc2spice.netlist.expression import terms

CURVES = 6  # curves of one window
_PREFIX = {1e-6: "u", 1e-3: "m", 1.0: ""}
_AXIS = {"tran": "", "ac": " xlog", "dc": "", "noise": " loglog"}


def plot_script(deck: Deck) -> dict[str, str]:
    """Return ``{"NAME_plot.sp": text}`` with one window for each unit of the results.

    The script is empty if there are no curves. ngspice runs a file whose first line is
    ``*ng_script`` as commands.
    """
    axis = _AXIS.get(deck.command.kind)
    windows: dict[str, list[str]] = {}
    for name, (expression, factor) in deck.vectors.items():
        if len(terms(expression)) == 1 and abs(factor) in _PREFIX:
            unit = _PREFIX[abs(factor)] + deck.units.get(name, "1")
            windows.setdefault(unit, []).append(expression)
    if axis is None or not windows:
        return {}
    wrap = "db({})" if deck.command.kind == "ac" else "{}"
    lines = [
        f"plot {' '.join(map(wrap.format, list(dict.fromkeys(vectors))[:CURVES]))}{axis} "
        f"ylabel '{'dB of ' if deck.command.kind == 'ac' else ''}{unit}' title '{deck.name}'"
        for unit, vectors in windows.items()
    ]
    head = ["*ng_script", f"* Run it with:  ngspice {deck.name}_plot.sp", f"source {deck.main}"]
    run = ("run", "setplot noise1") if deck.command.kind == "noise" else ("run",)
    return {f"{deck.name}_plot.sp": "\n".join([*head, *run, *lines]) + "\n"}
