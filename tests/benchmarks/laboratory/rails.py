"""The catch range of real coils over their supply rails, with the closed form that bounds it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.integrate import cumulative_simpson

from kc2spice.fem.magnetics.table import EMTable, force
from kc2spice.report.plots import BLACK, BLUE, RED, legend_above, name_axes, sheet
from kc2spice.scene.model import Scene
from laboratory.setup import keys_of


@dataclass(frozen=True)
class Launch:
    """One run: rail [V], launch velocity [m/s], highest point [m], and how it ended."""

    rail: float
    speed: float
    peak: float
    caught: bool


def largest_speed(rail: float, scene: Scene, table: EMTable, resistance: float) -> float:
    """Launch velocity [m/s] beyond which no controller can stop the sphere.

    It takes all the braking force that the rail can drive through ``resistance`` [Ohm], at once
    and everywhere, whichever sign of the current gives it; the sphere must climb the largest work
    along its path: ``m v^2 / 2 = max_y integral(m g - min F(y, -i, i)) dy`` from its rest height.
    """
    sphere, control = keys_of(scene, "sphere"), keys_of(scene, "pid")
    most = min(rail / resistance, control.current_limit)
    y = np.linspace(sphere.radius, float(table.y[-1]), 2001)
    pull = np.minimum(force(table, y, -most, most), force(table, y, most, -most))
    work = cumulative_simpson(sphere.mass * scene.gravity - pull, x=y, initial=0.0)
    return float(np.sqrt(2 * work.max() / sphere.mass))


def rails_figure(
    path: Path, launches: Sequence[Launch], scene: Scene, table: EMTable, sense: float = 100.0
) -> None:
    """Caught and lost launches over the rail; the line is :func:`largest_speed`.

    ``sense`` [Ohm] is the resistor that the coils' current flows through besides their own.
    """
    resistance = float(table.resistance.sum()) + sense
    with sheet(path, size=(7.0, 4.2)) as axes:
        for caught, colour, mark, label in (
            (True, BLUE, "o", "caught"), (False, RED, "x", "lost"),
        ):  # fmt: skip
            chosen = [p for p in launches if p.caught == caught]
            axes.plot([p.rail for p in chosen], [p.speed for p in chosen], mark, color=colour,
                      ms=6, label=label)  # fmt: skip
        rails = np.geomspace(0.9 * min(p.rail for p in launches),
                             1.1 * max(p.rail for p in launches), 60)  # fmt: skip
        bound = [largest_speed(rail, scene, table, resistance) for rail in rails]
        axes.plot(rails, bound, color=BLACK, lw=1.2, label="full braking everywhere")
        ticks = sorted({p.rail for p in launches})
        axes.set_xscale("log")
        axes.set_xticks(ticks, [f"±{tick:g}" for tick in ticks])
        axes.minorticks_off()
        axes.set_ylim(0.0, 1.05 * max(p.speed for p in launches))
        name_axes(axes, "supply rails in V", "launch velocity in m/s")
        legend_above(axes, 3)
