"""What the probes of a scene look at, over the whole run."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel, time_axis
from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.model import Probe

WIDE = 20.0  # a range of frequencies beyond this ratio has a logarithmic axis


def probe_figures(
    probes: Mapping[str, Probe], waves: Waveforms, units: Mapping[str, str]
) -> Iterator[Figure]:
    """One figure with a panel for each unit; responses by their magnitude.

    A mark stands where a probe takes its largest value, a level where it waits for a crossing.
    """
    scale = next(iter(waves.data))
    x = waves[scale].real
    if not probes or x.size < 2:
        return
    label, factor, log = scale, 1.0, False
    if scale == "time":
        label, factor = time_axis(x)
    elif scale == "frequency":
        label, factor = ("frequency in kHz", 1e-3) if x[-1] > 5e3 else ("frequency in Hz", 1.0)
        log = bool(x[0] > 0 and x[-1] / x[0] > WIDE)
    panels = []
    for unit in dict.fromkeys(units.get(probe.of, "") for probe in probes.values()):
        own = {n: p for n, p in probes.items() if units.get(p.of, "") == unit and p.of in waves}
        shown = {p.of: waves[p.of] for p in own.values()}
        complex_ = any(np.iscomplexobj(v) for v in shown.values())
        curves = tuple(
            Curve(of, factor * x, np.abs(v) if complex_ else v) for of, v in shown.items()
        )
        size = "magnitude" if complex_ else "value"
        panels.append(
            Panel(
                label,
                f"{size} in {unit}" if unit else size,
                curves,
                levels=tuple((p.level, n) for n, p in own.items() if p.level is not None),
                marks=tuple(
                    (factor * _place(p, x, shown[p.of]), n)
                    for n, p in own.items()
                    if p.take in ("argmax", "value")
                ),
                log_x=log,
                log_y=complex_ and all((v != 0).all() for v in shown.values()),
            )
        )
    if panels:
        caption = "What the scene's probes look at, over the whole run."
        yield Figure("probes", "Probed results", caption, tuple(panels))


def _place(probe: Probe, x: np.ndarray, values: np.ndarray) -> float:
    size = np.abs(values) if np.iscomplexobj(values) else values
    return float(x[size.argmax()] if probe.at is None else probe.at)
