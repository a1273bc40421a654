"""Figure of the displacements of surfaces that radiate sound.

The figure shows displacements [m] versus time, or their amplitudes versus frequency. The mean
displacement of a surface with the area S and the volume velocity U is ``int U dt / S``.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel, format_axis_label, get_axis_label_and_factor
from kc2spice.core.si_prefix_format import PREFIXES, format_quantity, get_prefix_exponent
from kc2spice.core.waveforms import SCALES, Waveforms

# If the highest frequency exceeds the lowest one by this factor, the frequency axis is logarithmic.
WIDE_RANGE = 20.0
PLACE_DIGITS = 4  # number of significant digits of a frequency in a title


def integrate_flow(waves: Waveforms, flow: np.ndarray) -> np.ndarray:
    """Integrate a volume velocity over time to the displaced volume [m^3].

    A complex volume velocity versus frequency is divided by ``j omega``. A waveform versus time is
    integrated from its first point by the trapezoidal rule.
    """
    scale = waves.scale.real
    if not np.iscomplexobj(flow):
        steps = np.diff(scale) * (flow[1:] + flow[:-1]) / 2
        return np.concatenate([[0.0], np.cumsum(steps)])
    omega = 2 * np.pi * np.where(scale > 0, scale, np.nan)
    return np.asarray(flow / (1j * omega))


def plot_displacements(
    name: str,
    waves: Waveforms,
    displacements: Mapping[str, np.ndarray],
    caption: str,
    quantity: str = "displacement",
) -> Iterator[Figure]:
    """Plot displacements [m] of the part ``name`` versus time or frequency.

    The keys of ``displacements`` are the labels of the surfaces. For complex displacements versus
    frequency, the figure shows their amplitudes. The SI prefix of the axis unit suits the largest
    displacement.
    """
    scale, x = next(iter(waves)), waves.scale.real
    if scale not in SCALES or x.size < 2:
        return
    axis, factor = get_axis_label_and_factor(scale, x)
    response = scale == "frequency"
    sizes = {label: np.abs(values) for label, values in displacements.items()}
    largest = max(float(np.nanmax(size, initial=0.0)) for size in sizes.values())
    power = get_prefix_exponent(largest)
    curves = []
    for label, values in displacements.items():
        y = sizes[label] if response else values
        curves.append(Curve(label, factor * x, y / 10.0**power))
    wide = bool(response and x[0] > 0 and x[-1] / x[0] > WIDE_RANGE)
    label = format_axis_label("amplitude" if response else "displacement", f"{PREFIXES[power]}m")
    panel = Panel(axis, label, tuple(curves), log_x=wide, log_y=response)
    title = f"{quantity.capitalize()} of {name}: at most {format_quantity(largest, 'm', 3)}"
    if response:
        title += f", at {format_quantity(_find_peak(x, sizes), 'Hz')}"
    yield Figure(f"{name}_displacement", title, caption, (panel,))


def _find_peak(x: np.ndarray, sizes: Mapping[str, np.ndarray]) -> float:
    """Return where (time or frequency) the largest displacement occurs, rounded."""
    largest = np.nanmax(list(sizes.values()), axis=0)
    return float(f"{x[int(np.nanargmax(largest))]:.{PLACE_DIGITS}g}")
