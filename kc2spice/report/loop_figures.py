"""Figures of the kick-and-catch loop (paper Figs 6 and 10) and of the catch's force map."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.magnetics.table import EMTable, force
from kc2spice.report.driver_figures import driver_figures
from kc2spice.report.metrics import SETTLING_BAND, separation, trajectory_difference
from kc2spice.report.plots import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PALETTE,
    RED,
    Picture,
    legend_above,
    legend_beside,
    name_axes,
    sheet,
)
from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene


def loop_figures(
    directory: Path,
    waves: Waveforms,
    scene: Scene,
    table: EMTable | None = None,
    reference: Waveforms | None = None,
) -> list[Picture]:
    """Draw what the run has: path, kick, contact, coil currents, force map, error to scipy."""
    pictures = []
    if scene.sphere:
        pictures.append(trajectory(directory / "trajectory.png", waves, scene, reference))
    if scene.contact:
        pictures.append(kick(directory / "kick_stroke.png", waves, scene, reference))
        pictures.append(contact(directory / "contact_force.png", waves, scene))
    if "coil.upper.current" in waves:
        pictures.append(currents(directory / "coil_currents.png", waves, scene))
    pictures += driver_figures(directory, waves, scene)
    if reference is not None:
        pictures.append(error(directory / "reference_error.png", waves, reference))
    if table is not None:
        pictures.append(force_map(directory / "em_force.png", table, scene))
    return pictures


def trajectory(
    path: Path, waves: Waveforms, scene: Scene, reference: Waveforms | None = None
) -> Picture:
    """Height of the sphere over the whole run, with set point and settling band (Fig. 10a)."""
    t, y = 1e3 * waves["time"], 1e3 * waves["sphere.y"]
    with sheet(path) as axes:
        if scene.control is not None:
            goal = 1e3 * scene.control.setpoint
            band = SETTLING_BAND * abs(goal - 1e3 * need(scene.sphere, "sphere").radius)
            axes.axhspan(goal - band, goal + band, color=GREEN, alpha=0.15, lw=0,
                         label="±5 % of the step")  # fmt: skip
            axes.axhline(goal, color=GREEN, lw=1.0, label="set point")
        axes.plot(t, y, color=BLUE, label="sphere, ngspice")
        if reference is not None:
            axes.plot(1e3 * reference["time"], 1e3 * reference["sphere.y"], color=BLACK,
                      ls=(0, (1, 3)), lw=1.4, label="sphere, scipy")  # fmt: skip
        axes.set_xlim(t[0], t[-1])
        name_axes(axes, "time in ms", "height of the sphere's centre in mm")
        legend_above(axes)
    return Picture(path, "Sphere", "Vertical position of the sphere (compare paper Fig. 10a).")


def _window(scene: Scene) -> tuple[float, float]:
    """Around the kick, as the paper shows it: 50 us before the pulse to 75 us after it."""
    drive = need(scene.kick, "kick").drive
    return drive.start - 50e-6, drive.start + drive.width + 75e-6


def _cut(waves: Waveforms, first: float, last: float) -> np.ndarray:
    t = waves["time"]
    low, high = np.searchsorted(t, (first, last))
    inside = np.zeros(t.size, dtype=bool)
    inside[max(low - 1, 0) : high + 1] = True
    return inside


def kick(path: Path, waves: Waveforms, scene: Scene, reference: Waveforms | None = None) -> Picture:
    """Centre node and underside of the sphere around the kick, over the pulse (Fig. 10b)."""
    first, last = _window(scene)
    radius = need(scene.sphere, "sphere").radius
    inside = _cut(waves, first, last)
    t = 1e6 * waves["time"][inside]
    with sheet(path, 2, 1, size=(7.0, 5.2), sharex=True, gridspec_kw={"height_ratios": (3, 1)}) as (
        top,
        low,
    ):
        stroke = 1e6 * waves["kick.u.R0"][inside]
        under = 1e6 * (waves["sphere.y"][inside] - radius)
        top.plot(t, under, color=ORANGE, label="underside of the sphere")
        top.plot(t, stroke, color=BLUE, label="centre node R0, ngspice")
        if reference is not None:
            near = _cut(reference, first, last)
            stroke_ref = 1e6 * reference["kick.u.R0"][near]
            top.plot(1e6 * reference["time"][near], stroke_ref, color=BLACK, ls=(0, (1, 3)),
                     lw=1.4, label="centre node R0, scipy")  # fmt: skip
        span = np.ptp(stroke)
        top.set_ylim(stroke.min() - 0.15 * span, stroke.max() + 0.35 * span)
        name_axes(top, "", "displacement in µm")
        legend_above(top, 3)
        low.plot(t, waves["kick.voltage"][inside], color=RED)
        name_axes(low, "time in µs", "anode in V")
        low.set_xlim(1e6 * first, 1e6 * last)
    return Picture(path, "Kick", "Centre node of the chip around the kick (paper Fig. 10b).")


def contact(path: Path, waves: Waveforms, scene: Scene) -> Picture:
    """Force of every ring that ever closes, during the kick."""
    start = need(scene.kick, "kick").drive.start
    leave = separation(waves)
    last = start + 1.5 * (leave.time - start) if leave else _window(scene)[1]
    inside = _cut(waves, start, last)
    t = 1e6 * (waves["time"][inside] - start)
    rings = sorted(k for k in waves.data if k.startswith("contact.force.R"))
    with sheet(path) as axes:
        for ring, colour in zip(rings, PALETTE, strict=False):
            load = waves[ring][inside]
            if load.max(initial=0.0) > 0.0:
                axes.plot(t, load, color=colour, label=ring.rpartition(".")[2])
        axes.plot(t, waves["contact.force"][inside], color=GREY, lw=1.0, ls="--", label="sum")
        if leave:
            axes.axvline(1e6 * (leave.time - start), color=GREEN, lw=1.0, label="launch")
        axes.set_xlim(0.0, 1e6 * (last - start))
        axes.set_ylim(bottom=0.0)
        name_axes(axes, "time after the start of the pulse in µs", "contact force in N")
        legend_beside(axes)
    caption = "Force between chip and sphere, whole device, for each ring that closes."
    return Picture(path, "Contact", caption)


def currents(path: Path, waves: Waveforms, scene: Scene) -> Picture:
    """Both coil currents with the clamp."""
    t = 1e3 * waves["time"]
    with sheet(path) as axes:
        axes.plot(t, 1e3 * waves["coil.upper.current"], color=BLUE, label="upper coil")
        axes.plot(t, 1e3 * waves["coil.lower.current"], color=ORANGE, label="lower coil")
        if scene.control is not None:
            limit = 1e3 * scene.control.current_limit
            for level, label in ((limit, "limit"), (-limit, "")):
                axes.axhline(level, color=GREY, lw=0.9, ls=":", label=label)
            axes.set_ylim(-1.12 * limit, 1.12 * limit)
        axes.set_xlim(t[0], t[-1])
        name_axes(axes, "time in ms", "coil current in mA")
        legend_above(axes)
    return Picture(path, "Coils", "Currents in the coils; the lower one is the upper one negated.")


def error(path: Path, waves: Waveforms, reference: Waveforms) -> Picture:
    """Distance of the simulated path from the scipy reference."""
    t, difference = trajectory_difference(waves, reference)
    size = np.maximum(1e6 * np.abs(difference), 1e-9)
    with sheet(path, size=(7.0, 3.2)) as axes:
        axes.semilogy(1e3 * t, size, color=RED, lw=1.0)
        axes.set_xlim(1e3 * t[0], 1e3 * t[-1])
        name_axes(axes, "time in ms", "|ngspice − scipy| in µm")
    caption = "Difference of the sphere's position to the independent integration in scipy."
    return Picture(path, "Error", caption)


def force_map(path: Path, table: EMTable, scene: Scene) -> Picture:
    """Force over position for pairs of coil currents (Fig. 6): lowest, nearest to 0, highest."""
    steps = _shown_currents(scene)
    pairs = [(lower, upper) for lower in steps for upper in steps]
    fine = np.linspace(table.y[0], table.y[-1], 401)
    with sheet(path, size=(7.6, 4.4)) as axes:
        curves = 1e3 * np.array([force(table, fine, *pair) for pair in pairs])
        styles = {-1: ":", 0: "-", 1: "--"}
        colours = {-1: BLUE, 0: BLACK, 1: ORANGE}
        for (lower, upper), curve in zip(pairs, curves, strict=True):
            colour, style = colours[int(np.sign(lower))], styles[int(np.sign(upper))]
            label = " / ".join(f"{1e3 * i:+.3g}" if i else "0" for i in (lower, upper))
            label = label.replace("-", "−")
            axes.plot(1e3 * fine, curve, color=colour, ls=style, lw=1.4, label=label)
        axes.set_xlim(1e3 * fine[0], 1e3 * fine[-1])
        name_axes(axes, "height of the sphere's centre in mm", "force on the sphere in mN")
        legend_beside(axes, "lower / upper coil in mA")
    caption = "Vertical electromagnetic force on the sphere by coil currents (paper Fig. 6)."
    return Picture(path, "Force map", caption)


def _shown_currents(scene: Scene) -> list[float]:
    if scene.em_force is not None:
        every = scene.em_force.currents
        return sorted({min(every), min(every, key=abs), max(every)})
    limit = 0.1 if scene.control is None else scene.control.current_limit
    return [-limit, 0.0, limit]
