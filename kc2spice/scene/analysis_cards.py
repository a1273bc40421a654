"""SPICE command of the analysis of a scene, and the cards that the command needs."""

from __future__ import annotations

from dataclasses import dataclass

from kc2spice.netlist.circuit import Element, Item
from kc2spice.netlist.deck import (
    AnalysisCommand,
    make_ac_command,
    make_dc_command,
    make_noise_command,
    make_transient_command,
)
from kc2spice.netlist.shared_cards import add_title
from kc2spice.scene.results import NOISE_WAVE
from kc2spice.scene.scene_classes import BuiltScene, NameAllocator


@dataclass(frozen=True)
class AnalysisCards:
    """SPICE analysis command, and the extra cards that a noise analysis needs."""

    command: AnalysisCommand
    items: tuple[Item, ...] = ()


def make_analysis_cards(build: BuiltScene) -> AnalysisCards:
    """Return the SPICE command of the analysis of a scene, with any extra cards.

    Raises
    ------
    UsageError : the steps of a dc sweep are too small for ngspice.
    """
    scene, sweep, output = build.scene, build.dc_sweep, build.noise_output
    selected = scene.analysis
    if output is not None:
        return _make_noise_cards(build, str(output.voltage))
    if selected.type == "transient":
        assert build.largest_step is not None
        step = build.largest_step.step
        return AnalysisCards(
            make_transient_command(scene.stop_time, step, uic=bool(scene.initial_states))
        )
    if selected.type == "ac":
        # ngspice would compute only the first point of a linear scale with two points
        points = 3 if (selected.points, selected.scale) == (2, "linear") else selected.points
        command = make_ac_command(
            selected.start, float(selected.stop or 0.0), points, selected.scale
        )
        return AnalysisCards(command)
    if sweep is not None:
        first, last = sweep.scale * sweep.values[0], sweep.scale * sweep.values[-1]
        return AnalysisCards(make_dc_command(sweep.source, first, last, sweep.values.size))
    return AnalysisCards(AnalysisCommand("op", ()))


def _make_noise_cards(build: BuiltScene, voltage: str) -> AnalysisCards:
    """Return the command of a noise analysis, and the cards of its input source."""
    selected = build.scene.analysis
    node = NameAllocator((*build.scene.parts, *build.scene.nets.values())).allocate_name(
        NOISE_WAVE, "noise_input"
    )
    drive = Element.from_words(f"V{node}", node, "0", "DC", "0", "AC", "1")
    load = Element.from_words(f"R{node}", node, "0", "1", noisy="0")
    first, last = selected.start, float(selected.stop or 0.0)
    command = make_noise_command(voltage, drive.name, first, last, selected.points, selected.scale)
    title = "source that the command .noise requires; it is not connected to any part"
    return AnalysisCards(command, add_title(title, (drive, load)))
