"""Figures of a verification as data: solutions over each other, and their differences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel
from kc2spice.core.waveforms import Waveforms

MOST = 4  # panels of one figure
FLOOR = 1e-17  # a difference of nothing, on a logarithmic axis
_SCALES = {"time": ("time in ms", 1e3), "frequency": ("frequency in kHz", 1e-3)}

Solutions = Mapping[str, Waveforms]


def comparison(
    name: str, title: str, solutions: Solutions, units: Mapping[str, str]
) -> Iterator[Figure]:
    """The waves that all solutions have, the first one as the reference, with their differences.

    One panel for each of the largest waves of a unit, one for the differences of all of these.
    """
    (first, exact), *others = solutions.items()
    scale = next(iter(exact.data))
    label, factor = _SCALES.get(scale, (scale, 1.0))
    common = [n for n in exact.data if n != scale and all(n in w for _, w in others)]
    chosen = _chosen(common, exact, units)
    if not chosen or np.ptp(exact[scale]) == 0:
        return
    panels = []
    for wave in chosen:
        curves = [_curve(first, exact, scale, wave, factor, "reference")]
        curves += [_curve(n, w, scale, wave, factor, "-") for n, w in others]
        unit = units.get(wave, "")
        panels.append(Panel(label, f"{wave} in {unit}" if unit else wave, tuple(curves)))
    yield Figure(
        f"{name}_solutions",
        f"{title}: solutions over each other",
        f"Reference (dotted): {first}.",
        tuple(panels),
    )
    errors = [
        Curve(f"{n}, {wave}", factor * x, np.maximum(y, FLOOR))
        for n, w in others
        for wave in chosen
        for x, y in [_difference(w, exact, scale, wave)]
    ]
    panel = Panel(label, f"difference to {first} / largest value", tuple(errors), log_y=True)
    yield Figure(
        f"{name}_differences",
        f"{title}: differences",
        f"Differences to {first}, each over the wave's largest value.",
        (panel,),
    )


def responses(name: str, curves: Solutions) -> Iterator[Figure]:
    """Responses of one body port by port to itself, every solution of it."""
    if not curves:
        return
    last = list(curves.values())[-1]
    pairs = [n for n in last.data if ">" in n and len({*n.split(">")}) == 1][:MOST]
    panels = []
    for pair in pairs:
        lines = [
            Curve(
                label,
                waves["frequency"].real / 1e3,
                np.abs(waves[pair]),
                "o" if waves["frequency"].size < 60 and len(curves) > 1 else "-",
            )
            for label, waves in curves.items()
            if pair in waves
        ]
        panels.append(
            Panel(
                "frequency in kHz",
                f"|{pair}|",
                tuple(lines),
                log_y=True,
                span=(0.0, float(last["frequency"].real[-1]) / 1e3),
            )
        )
    if panels:
        yield Figure(
            f"{name}_response",
            f"{name}: response of the emitted subcircuit",
            "Each port's answer to a unit load on itself; points are direct solutions of the full "
            "model.",
            tuple(panels),
        )


def _chosen(names: list[str], waves: Waveforms, units: Mapping[str, str]) -> list[str]:
    """The largest wave of each unit, in order."""
    best: dict[str, str] = {}
    for name in names:
        unit = units.get(name, "")
        size = np.abs(waves[name]).max(initial=0.0)
        if size > 0 and (unit not in best or size > np.abs(waves[best[unit]]).max()):
            best[unit] = name
    return list(best.values())[:MOST]


def _curve(label: str, waves: Waveforms, scale: str, name: str, factor: float, style: str) -> Curve:
    values = waves[name]
    y = np.abs(values) if np.iscomplexobj(values) else values
    return Curve(label, factor * waves[scale].real, y, style)


def _difference(
    waves: Waveforms, exact: Waveforms, scale: str, name: str
) -> tuple[np.ndarray, np.ndarray]:
    x, y = exact[scale].real, exact[name]
    ours = waves[name]
    if ours.shape != y.shape or scale == "time":
        t, unique = np.unique(waves[scale].real, return_index=True)
        ours = np.interp(x, t, ours[unique])
    return x, np.abs(ours - y) / np.abs(y).max()
