"""Noise analysis of a deck: its input, the shares of parts, its metrics, checks and figures."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kc2spice.core.figure import Curve, Figure, Panel, scale_axis
from kc2spice.core.waveforms import Waveforms, running_integral
from kc2spice.netlist.circuit import Element, Item
from kc2spice.netlist.deck import Command, Deck, noise
from kc2spice.netlist.elements import add_title
from kc2spice.netlist.scope import Scope
from kc2spice.scene.checks import Check, Metric
from kc2spice.scene.model import Build, Names
from kc2spice.scene.results import NOISE_WAVE
from kc2spice.scene.rows import DENSITY_UNIT, Vector

RESOLVED = 0.02  # largest relative change of the rms value with every second frequency


def add_noise_sources(deck: Deck, build: Build) -> Deck:
    """``deck`` with what each resistor that has noise adds, as ``noise.PART.NAME``."""
    result = dict(_noisy_resistors(deck.scope, ""))
    parts = sorted(build.scene.parts, key=len, reverse=True)
    _, factor = deck.vectors[NOISE_WAVE]
    vectors = {}
    for name, path in result.items():
        device = path.partition(".")[0][1:]
        part = next((p for p in parts if device.startswith(p.lower())), None)
        if part is not None:
            vectors[f"{NOISE_WAVE}.{part}.{path.rpartition('.')[2]}"] = (f"onoise_{name}", factor)
    units = dict.fromkeys(vectors, deck.units[NOISE_WAVE])
    return replace(deck, vectors={**deck.vectors, **vectors}, units={**deck.units, **units})


def _noisy_resistors(scope: Scope, path: str) -> Iterator[tuple[str, str]]:
    """Simulator names of noisy resistors, and their instance paths."""
    for item in scope.elements:
        if item.kind == "x" and (inner := scope.find(item.model)) is not None:
            yield from _noisy_resistors(inner, f"{path}{item.key}.")
        elif item.kind == "r" and item.settings.get("noisy") != "0":
            yield f"r.{path}{item.key}" if path else item.key, f"{path}{item.key}"


def noise_by_part(waves: Waveforms) -> dict[str, np.ndarray]:
    """Density (nf,) of what each part adds, where the run tells it."""
    power: dict[str, np.ndarray] = {}
    for name, density in waves.data.items():
        word, _, rest = name.partition(".")
        if word == NOISE_WAVE and rest:
            part = rest.partition(".")[0]
            power[part] = power.get(part, 0.0) + np.abs(density) ** 2
    return {part: np.sqrt(result) for part, result in power.items()}


def noise_metrics(waves: Waveforms, build: Build) -> dict[str, Any]:
    """rms values over the band: of the output, and what each part adds to it."""
    f, parts, unit = waves["frequency"].real, noise_by_part(waves), _noise_output(build).unit
    added = {part: Metric(_rms(f, result), unit) for part, result in parts.items()}
    rms: dict[str, Any] = {NOISE_WAVE: Metric(_rms(f, waves[NOISE_WAVE]), unit)}
    return rms | ({"noise_by_part": added} if len(added) > 1 else {})


@dataclass(frozen=True)
class NoiseCards:
    """Cards of a noise analysis: its command, and the input source that the command names."""

    command: Command
    items: tuple[Item, ...]


def noise_cards(build: Build) -> NoiseCards:
    """Write the command of the noise analysis and its input source, which drives nothing."""
    selected, ends = build.scene.analysis, _noise_output(build).voltage
    node = Names((*build.scene.parts, *build.scene.nets.values())).name(NOISE_WAVE, "noise_input")
    drive = Element.of(f"V{node}", node, "0", "DC", "0", "AC", "1")
    load = Element.of(f"R{node}", node, "0", "1", noisy="0")
    first, last = selected.start, float(selected.stop or 0.0)
    command = noise(str(ends), drive.name, first, last, selected.points, selected.scale)
    title = "drives nothing: what the analysis could refer the noise to"
    return NoiseCards(command, add_title(title, (drive, load)))


def _noise_output(build: Build) -> Vector:
    """Return the output of a noise analysis."""
    result = build.results.noise_output
    assert result is not None, f"{build.scene.name} has no noise analysis"
    return result


def _rms(f: np.ndarray, density: np.ndarray) -> float:
    return float(np.sqrt(np.trapezoid(np.abs(density) ** 2, f)))


def checks(waves: Waveforms) -> Iterator[Check]:
    """Check that the noise changes little if every second frequency is left out."""
    if (f := waves["frequency"].real).size > 4:
        even = f.size - (f.size + 1) % 2
        f, density = f[:even], waves[NOISE_WAVE][:even]
        off = abs(_rms(f[::2], density[::2]) / (_rms(f, density) or 1.0) - 1.0)
        advice = (
            "a resonance lies between the frequencies: raise analysis.points, or narrow the band"
        )
        yield Check(
            "noise against every second frequency", off, RESOLVED, "of its rms", advice, "warn"
        )


def noise_figures(waves: Waveforms, unit: str) -> Iterator[Figure]:
    """The spectral density, and what it adds up to from the lowest frequency on."""
    f, density = waves["frequency"].real, np.abs(waves[NOISE_WAVE])
    label, factor = scale_axis("frequency", f)
    log = bool(f[0] > 0 and f[-1] / f[0] > 20)
    rising = np.sqrt(running_integral(density**2, f))
    rows = (
        (f"density in {unit}", density),
        (f"rms from the lowest on in {unit.removesuffix(DENSITY_UNIT)}", rising),
    )
    parts = noise_by_part(waves)
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
