"""Figures of harmonic response, imprint and impact (paper Figs 7, 8, 9, A1): roads and errors.

A *road* is one way to a result. Each function takes roads by name, the reference first; the others
are drawn over it, and their errors are against it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.waveforms import Waveforms
from kc2spice.report.distance import trajectory_difference
from kc2spice.report.plots import (
    BLACK,
    BLUE,
    GREY,
    ORANGE,
    PALETTE,
    RED,
    Picture,
    legend_above,
    name_axes,
    sheet,
)
from kc2spice.report.verdict import StepPoint

Roads = Mapping[str, Waveforms]

# Reference wide and pale, the others thin over it, so that coinciding curves all stay visible.
_LOOKS: tuple[dict[str, Any], ...] = (
    {"color": GREY, "lw": 3.6, "alpha": 0.6},
    {"color": BLUE, "lw": 1.4},
    {"color": BLACK, "lw": 1.5, "ls": (0, (1, 3))},
)
_ERRORS = (BLUE, ORANGE, RED)
_WIDE = (10.0, 3.8)
_FLOOR = 1e-17  # a difference of nothing, on a logarithmic axis


def _looks(roads: Roads) -> list[tuple[str, Waveforms, dict[str, Any]]]:
    looks = _LOOKS if len(roads) > 1 else _LOOKS[1:]
    return [(*road, look) for road, look in zip(roads.items(), looks, strict=False)]


def _against(roads: Roads) -> tuple[str, Waveforms, list[tuple[str, Waveforms]]]:
    (first, reference), *others = roads.items()
    return first, reference, others


@contextmanager
def _beside(path: Path, others: list[tuple[str, Waveforms]]) -> Iterator[tuple[Any, Any]]:
    """Axes for the result and, where there is something to compare, for the errors."""
    if others:
        with sheet(path, 1, 2, size=_WIDE) as (left, right):
            yield left, right
    else:
        with sheet(path) as left:
            yield left, None


def pair_error(waves: Waveforms, reference: Waveforms, pair: str) -> np.ndarray:
    """``|H - H_ref| / |H_ref|`` of one ``INPUT>OUTPUT`` at every frequency."""
    return np.abs(waves[pair] - reference[pair]) / np.abs(reference[pair])


def ports(waves: Waveforms) -> list[str]:
    """Names of the inputs of a harmonic result, in order."""
    return list(dict.fromkeys(name.partition(">")[0] for name in waves.data if ">" in name))


def harmonic_figures(directory: Path, roads: Roads) -> list[Picture]:
    """Response of the first port to itself with its error (Fig. 7), and all inputs (Fig. A1)."""
    first, reference, others = _against(roads)
    port = ports(reference)[0]
    path = directory / "harmonic_response.png"
    with _beside(path, others) as (left, right):
        for name, waves, look in _looks(roads):
            amplitude = 1e6 * np.abs(waves[f"{port}>{port}"])
            left.semilogy(1e-3 * waves["frequency"], amplitude, label=name, **look)
        name_axes(left, "frequency in kHz", f"amplitude at {port} in µm/N")
        legend_above(left)
        for (name, waves), colour in zip(others, _ERRORS, strict=False):
            worst = np.max([pair_error(waves, reference, f"{port}>{k}") for k in ports(waves)], 0)
            f = 1e-3 * waves["frequency"]
            right.semilogy(f, np.maximum(worst, _FLOOR), color=colour, label=f"{name} − {first}")
        if right:
            name_axes(right, "frequency in kHz", "relative error of the worst output")
            legend_above(right, 2)
    caption = f"Unit load at {port}: response there, and largest error of all outputs."
    pictures = [Picture(path, "Harmonic response", caption)]
    for name, waves in others:
        file = directory / f"harmonic_error_{_slug(name)}.png"
        pictures.append(harmonic_errors(file, waves, reference, f"{name} − {first}"))
    return pictures


def harmonic_errors(path: Path, waves: Waveforms, reference: Waveforms, title: str) -> Picture:
    """Relative errors of every output, one panel per input (Figs 7b and A1)."""
    names = ports(reference)
    columns = 4
    rows = -(-(len(names) + 1) // columns)
    f = 1e-3 * reference["frequency"]
    with sheet(path, rows, columns, size=(11.0, 2.7 * rows), sharex=True, sharey=True,
               squeeze=False) as axes:  # fmt: skip
        for source, panel in zip(names, axes.flat, strict=False):
            for sink, colour in zip(names, _colours(len(names)), strict=True):
                error = pair_error(waves, reference, f"{source}>{sink}")
                panel.semilogy(f, np.maximum(error, _FLOOR), color=colour, lw=1.1, label=sink)
            panel.set_title(f"input {source}")
        for panel in axes.flat[len(names) :]:
            panel.set_axis_off()
        handles, labels = axes.flat[0].get_legend_handles_labels()
        axes.flat[len(names)].legend(handles, labels, title="output", loc="center left", ncols=2)
        for panel in axes[:, 0]:
            panel.set_ylabel("relative error")
        for panel in axes.flat[max(len(names) - columns, 0) : len(names)]:
            panel.set_xlabel("frequency in kHz")
            panel.tick_params(labelbottom=True)
    return Picture(path, title, f"{title}: relative error of all outputs for each input (Fig. A1).")


def _colours(count: int) -> list[str]:
    return [PALETTE[k % len(PALETTE)] for k in range(count)]


def imprint_figures(directory: Path, roads: Roads, sectors: int = 4) -> list[Picture]:
    """Force of one sector against imprint depth, and errors; lines where rings close."""
    first, reference, others = _against(roads)
    path = directory / "imprint.png"
    with _beside(path, others) as (left, right):
        for name, waves, look in _looks(roads):
            load = waves["contact.force"] / sectors
            left.plot(1e6 * waves["imprint.depth"], load, label=name, **look)
        name_axes(left, "imprint in µm", "force of the quarter model in N")
        legend_above(left)
        force = reference["contact.force"]
        loaded = force > 0.0
        depth = 1e6 * reference["imprint.depth"][loaded]
        for (name, waves), colour in zip(others, _ERRORS, strict=False):
            error = np.abs(waves["contact.force"] - force)[loaded] / force[loaded]
            right.semilogy(depth, np.maximum(error, _FLOOR), color=colour, lw=1.2,
                           label=f"{name} − {first}")  # fmt: skip
        for start in _activations(reference):
            (right or left).axvline(1e6 * start, color=GREY, lw=0.8, ls=":")
        if right:
            name_axes(right, "imprint in µm", "relative error of the force")
            legend_above(right, 2)
    caption = "Static contact force of one quarter; dotted lines: another ring closes."
    return [Picture(path, "Imprint", caption)]


def _activations(waves: Waveforms) -> list[float]:
    rings = [load for name, load in waves.data.items() if name.startswith("contact.force.R")]
    return [waves["imprint.depth"][np.argmax(load > 0.0)] for load in rings[1:] if load.any()]


def impact_figures(directory: Path, roads: Roads, radius: float) -> list[Picture]:
    """Underside of the sphere during the impact, and errors relative to its travel."""
    first, reference, others = _against(roads)
    path = directory / "impact.png"
    travel = float(np.ptp(reference["sphere.y"]))
    loaded = 1e6 * reference["time"][reference["contact.force"] > 0.0]
    with _beside(path, others) as (left, right):
        for name, waves, look in _looks(roads):
            y = 1e6 * (waves["sphere.y"] - radius)
            left.plot(1e6 * waves["time"], y, label=name, **look)
        name_axes(left, "time in µs", "underside of the sphere in µm")
        legend_above(left)
        for (name, waves), colour in zip(others, _ERRORS, strict=False):
            t, difference = trajectory_difference(waves, reference)
            error = np.maximum(np.abs(difference) / travel, _FLOOR)
            right.semilogy(1e6 * t, error, color=colour, lw=1.2, label=f"{name} − {first}")
        for axes in filter(None, (left, right)):
            if loaded.size:
                axes.axvspan(loaded[0], loaded[-1], color=GREY, alpha=0.12, lw=0)
        if right:
            name_axes(right, "time in µs", "position error / travel")
            legend_above(right, 2)
    caption = "Impact of the free sphere, in contact where shaded."
    return [Picture(path, "Impact", caption)]


def steps_figure(path: Path, points: Sequence[StepPoint], chosen: tuple[float, float]) -> Picture:
    """Position error over accepted points, a line per step ceiling; ``chosen`` = (reltol, step)."""
    with sheet(path, size=(6.4, 4.0)) as axes:
        for ceiling, colour in zip(sorted({p.max_step_s for p in points}), _ERRORS, strict=False):
            line = [p for p in points if p.max_step_s == ceiling and p.position is not None]
            counts, errors = [p.accepted for p in line], [p.position for p in line]
            axes.loglog(counts, errors, "o-", color=colour, ms=4,
                        label=f"steps up to {ceiling * 1e9:g} ns")  # fmt: skip
            for p in line:
                axes.annotate(f"{p.reltol:g}", (p.accepted, p.position), fontsize=8,
                              textcoords="offset points", xytext=(5, 4))  # fmt: skip
                if (p.reltol, p.max_step_s) == chosen:
                    axes.plot(p.accepted, p.position, "o", ms=12, mfc="none", color=BLACK)
        name_axes(axes, "accepted time points", "largest position error / travel")
        legend_above(axes, 2)
    caption = "What steps buy in the impact; numbers are reltol, the ring is the emitted setting."
    return Picture(path, "Error against steps", caption)


def _slug(name: str) -> str:
    return "".join(c if c.isalnum() else "_" for c in name.lower())
