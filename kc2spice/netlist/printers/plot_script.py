"""Script with which ngspice plots the results of a deck."""

from __future__ import annotations

from kc2spice.netlist.deck import Deck
from kc2spice.netlist.expression import split_terms

MAX_CURVES = 6  # largest number of curves in one window
_PLOT_PREFIXES = {1e-6: "u", 1e-3: "m", 1.0: ""}
_PLOT_AXES = {"tran": "", "ac": " xlog", "dc": "", "noise": " loglog"}


def format_plot_script(deck: Deck) -> dict[str, str]:
    """Return the plot script of a deck as ``{"NAME_plot.sp": text}``.

    The script opens one window for each unit of the results. The result is empty if the deck has no
    curves. ngspice runs a file as commands if its first line is ``*ng_script``.
    """
    axis = _PLOT_AXES.get(deck.command.kind)
    windows: dict[str, list[str]] = {}
    for name, (expression, factor) in deck.vectors.items():
        if len(split_terms(expression)) == 1 and abs(factor) in _PLOT_PREFIXES:
            unit = _PLOT_PREFIXES[abs(factor)] + deck.units.get(name, "1")
            windows.setdefault(unit, []).append(expression)
    if axis is None or not windows:
        return {}
    wrap = "db({})" if deck.command.kind == "ac" else "{}"
    lines = [
        f"plot {' '.join(map(wrap.format, list(dict.fromkeys(vectors))[:MAX_CURVES]))}{axis} "
        f"ylabel '{'dB of ' if deck.command.kind == 'ac' else ''}{unit}' title '{deck.name}'"
        for unit, vectors in windows.items()
    ]
    head = [
        "*ng_script",
        f"* Run it with:  ngspice {deck.name}_plot.sp",
        f"source {deck.main_file_name}",
    ]
    run = ("run", "setplot noise1") if deck.command.kind == "noise" else ("run",)
    return {f"{deck.name}_plot.sp": "\n".join([*head, *run, *lines]) + "\n"}
