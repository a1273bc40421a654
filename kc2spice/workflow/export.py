"""``export``: netlists and symbols of a scene in any dialect."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from kc2spice.core.errors import unknown
from kc2spice.core.files import stage_directory
from kc2spice.core.progress import Progress, StageTimer, ignore_progress
from kc2spice.linalg.solver import require_solver, use_solver
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.deck_translation import write_dialect_files, write_symbol_files
from kc2spice.netlist.printers.dialect_registry import (
    list_deck_dialects,
    list_dialect_names,
    make_unknown_dialect_error,
)
from kc2spice.netlist.printers.plot_script import format_plot_script
from kc2spice.netlist.transforms import make_array_deck
from kc2spice.parts.bodies._body_model import get_reduction_settings
from kc2spice.parts.bodies._linear_body import LinearBody
from kc2spice.rom.linear_model import LinearModel
from kc2spice.scene.part_method_calls import resolve
from kc2spice.scene.scene_classes import BuiltScene, Scene
from kc2spice.sim.ngspice import write_files
from kc2spice.synthesis.circuit_error import require_circuit_tolerance
from kc2spice.workflow.decks import prepare_deck, protect_other_decks


def export_scene(
    scene: Scene,
    out: Path,
    dialect: str = "ngspice",
    progress: Progress = ignore_progress,
    *,
    trust: bool = False,
    count: int | None = None,
    solver: str | None = None,
) -> list[Path]:
    """Write netlists and symbols of a scene into a directory, without a simulation.

    ``out`` is the directory, and ``scene`` the scene. Bodies from files have all ports that their
    files declare, including ports that the scene does not connect. Returns the paths of the files.
    With ``trust``, included netlists may execute programs and open files. With ``count``, the deck
    has ``count`` copies of the scene, and no symbols are written. ``solver`` names the direct
    solver for model reductions.

    Raises
    ------
    UsageError : the dialect or the solver is unknown, the dialect cannot represent the scene, or
        the export would replace a library that another deck includes
        (:func:`kc2spice.workflow.decks.protect_other_decks`).
    GateMissedError : the circuit of a body misses the tolerance of its reduction.
    """
    known = list_dialect_names() if count is None else list_deck_dialects()
    if dialect not in known:
        if count is None or dialect not in list_dialect_names():
            raise make_unknown_dialect_error(dialect, known)
        raise unknown(
            "this dialect does not support an array of copies",
            dialect,
            known,
            "--dialect",
            advice="leave out --count",
        )
    clock, selected = StageTimer(progress), require_solver(solver, "--solver")
    with stage_directory(out, with_hashes=True) as work, use_solver(selected):
        build, deck = prepare_deck(resolve(replace(scene, ports="declared")), clock, trust=trust)
        _require_accurate_circuits(build, deck)
        with clock.time_stage("export", "netlists and symbols"):
            if count is not None:
                deck = make_array_deck(deck, count)
            files = write_dialect_files(deck, dialect)
            files |= format_plot_script(deck) if dialect == "ngspice" else {}
            files |= write_symbol_files(deck, dialect) if count is None else {}
            protect_other_decks(Path(out), files)
            write_files(files, work)
    return [Path(out) / name for name in sorted(files)]


def _require_accurate_circuits(build: BuiltScene, deck: Deck) -> None:
    """Raise an error if the circuit of a body misses the tolerance of its reduction.

    Raises
    ------
    GateMissedError : a circuit misses the tolerance.
    """
    circuits = {part.name.lower(): part for part in deck.parts if part.reduction is not None}
    for part in build.scene.parts.values():
        circuit = circuits.get(build.libraries[part.name].lower())
        if circuit is None or not isinstance(part.type, LinearBody):
            continue
        tolerance = get_reduction_settings(part, build.scene).tolerance
        if tolerance is not None:
            require_circuit_tolerance(circuit, build.model(part, LinearModel), tolerance)
