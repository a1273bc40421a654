"""Results of noise analyses: contributions of parts, metrics, checks and figures."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel, get_axis_label_and_factor
from kc2spice.core.waveforms import Waveforms, integrate_cumulatively
from kc2spice.scene.checks import Check, Metric
from kc2spice.scene.part_records import DENSITY_UNIT
from kc2spice.scene.results import NOISE_WAVE
from kc2spice.scene.scene_classes import BuiltScene

# Largest accepted relative change of the rms value if every second frequency is omitted.
MAX_RMS_CHANGE = 0.02


def compute_noise_by_part(waves: Waveforms) -> dict[str, np.ndarray]:
    """Return the spectral density of the output noise from each part, keyed by part.

    The densities are keyed by part. Each density is an array with one value for each frequency.
    """
    power: dict[str, np.ndarray] = {}
    for name, density in waves.data.items():
        word, _, rest = name.partition(".")
        if word == NOISE_WAVE and rest:
            part = rest.partition(".")[0]
            power[part] = power.get(part, 0.0) + np.abs(density) ** 2
    return {part: np.sqrt(result) for part, result in power.items()}


def compute_noise_metrics(waves: Waveforms, build: BuiltScene) -> dict[str, Any]:
    """Return the rms output noise, in total and from each part, as metrics.

    The rms values are integrals over the frequency range of the analysis.
    """
    f, parts = waves["frequency"].real, compute_noise_by_part(waves)
    unit = build.results.units[NOISE_WAVE].removesuffix(DENSITY_UNIT)
    added = {part: Metric(_compute_rms_value(f, result), unit) for part, result in parts.items()}
    rms: dict[str, Any] = {NOISE_WAVE: Metric(_compute_rms_value(f, waves[NOISE_WAVE]), unit)}
    return rms | ({"noise_by_part": added} if len(added) > 1 else {})


def _compute_rms_value(f: np.ndarray, density: np.ndarray) -> float:
    """Return the rms value of a noise density over the frequencies ``f`` [Hz]."""
    return float(np.sqrt(np.trapezoid(np.abs(density) ** 2, f)))


def check_noise(waves: Waveforms) -> Iterator[Check]:
    """Check that the rms noise hardly changes if every second frequency is omitted.

    A large change of the rms noise shows that the frequency steps do not resolve a resonance.
    """
    if (f := waves["frequency"].real).size > 4:
        even = f.size - (f.size + 1) % 2
        f, density = f[:even], waves[NOISE_WAVE][:even]
        off = abs(
            _compute_rms_value(f[::2], density[::2]) / (_compute_rms_value(f, density) or 1.0) - 1.0
        )
        advice = (
            "a resonance lies between the frequencies: raise analysis.points, or narrow the band"
        )
        yield Check(
            "change of the rms noise without every second frequency",
            off,
            MAX_RMS_CHANGE,
            "of the rms noise",
            advice,
            "warn",
        )


def plot_noise(waves: Waveforms, unit: str) -> Iterator[Figure]:
    """Plot the spectral density of the output noise, and the cumulative rms noise."""
    f, density = waves["frequency"].real, np.abs(waves[NOISE_WAVE])
    label, factor = get_axis_label_and_factor("frequency", f)
    log = bool(f[0] > 0 and f[-1] / f[0] > 20)
    rising = np.sqrt(integrate_cumulatively(density**2, f))
    rows = (
        (f"density in {unit}", density),
        (f"cumulative rms in {unit.removesuffix(DENSITY_UNIT)}", rising),
    )
    parts = compute_noise_by_part(waves)
    added = [Curve(f"of {part}", factor * f, result, "--") for part, result in parts.items()]
    panels = [
        Panel(
            label,
            words,
            (Curve("noise", factor * f, y), *(added if y is density and len(parts) > 1 else ())),
            log_x=log,
            log_y=y is density,
        )
        for words, y in rows
    ]
    yield Figure("noise", "Noise", "Of the scene's output, at 27 °C.", tuple(panels))
