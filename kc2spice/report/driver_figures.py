"""Figures of the drivers in a loop: what the chip and the coils get from real electronics."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kc2spice.core.waveforms import Waveforms
from kc2spice.report.plots import (
    BLUE,
    GREY,
    ORANGE,
    RED,
    Picture,
    legend_above,
    name_axes,
    sheet,
)
from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene


def driver_figures(directory: Path, waves: Waveforms, scene: Scene) -> list[Picture]:
    """Voltage and current of the chip's driver, voltage and currents of the coils' driver."""
    pictures = []
    if scene.kick and (scene.kick.driver or not scene.sphere):
        pictures.append(kick_driver(directory / "kick_driver.png", waves, scene))
    if scene.catch and scene.catch.driver:
        pictures.append(coil_driver(directory / "coil_driver.png", waves))
    return pictures


def kick_driver(path: Path, waves: Waveforms, scene: Scene) -> Picture:
    """Voltage over the chip, and the current into it where our driver measures it."""
    drive = need(scene.kick, "kick").drive
    t = 1e6 * (waves["time"] - drive.start)
    inside = (t > -5.0) & (t < 1e6 * drive.width + 30.0)
    measured = "kick.current" in waves
    with sheet(path, 2 if measured else 1, 1, size=(7.0, 4.6), sharex=True, squeeze=False) as axes:
        (top,), *rest = axes
        top.plot(t[inside], waves["kick.voltage"][inside], color=RED)
        top.axhline(drive.voltage, color=GREY, lw=0.9, ls=":")
        name_axes(top, "" if measured else "time after the start of the pulse in µs", "chip in V")
        for (low,) in rest:
            low.plot(t[inside], waves["kick.current"][inside], color=BLUE)
            name_axes(low, "time after the start of the pulse in µs", "current in A")
    caption = "What the driver gives the chip, around the kick; dotted: the voltage asked for."
    return Picture(path, "Kick driver", caption)


def coil_driver(path: Path, waves: Waveforms) -> Picture:
    """Voltage over both coils, the current they carry and the one that the controller wants."""
    t = 1e3 * waves["time"]
    with sheet(path, 2, 1, size=(7.0, 5.0), sharex=True) as (top, low):
        top.plot(t, waves["coil.voltage"], color=RED, lw=0.7)
        name_axes(top, "", "both coils in V")
        actual = 1e3 * waves["coil.upper.current"]
        wanted = 1e3 * waves["coil.wanted"]
        low.plot(t, wanted, color=ORANGE, lw=1.0, label="wanted")
        low.plot(t, actual, color=BLUE, lw=1.2, label="upper coil")
        reach = 1.6 * np.abs(actual).max()
        low.set_ylim(-reach, reach)
        low.set_xlim(t[0], t[-1])
        name_axes(low, "time in ms", "current in mA")
        legend_above(low, 2)
    caption = (
        "What the driver gives the coils: rail, L/R and slew rate stand between both currents."
    )
    return Picture(path, "Coil driver", caption)
