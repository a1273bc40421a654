"""``export``: netlists and symbols of a scene, in any dialect, without a simulation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from kc2spice.core.errors import UsageError, unknown
from kc2spice.core.files import staged
from kc2spice.core.progress import Clock, Progress, silent
from kc2spice.netlist.printers.ngspice import plot_script
from kc2spice.netlist.read import statements
from kc2spice.netlist.transforms import array_deck
from kc2spice.netlist.translate import DECKS, DIALECTS, dialect_files, symbol_files
from kc2spice.scene.compose import composed
from kc2spice.scene.model import Scene
from kc2spice.sim.ngspice import write_files
from kc2spice.workflow.decks import prepared


def export(
    scene: Scene,
    out: Path,
    dialect: str = "ngspice",
    progress: Progress = silent,
    *,
    trust: bool = False,
    count: int | None = None,
) -> list[Path]:
    """Write netlists and symbols of ``scene`` into ``out`` without simulating.

    Bodies of the scene's author have all ports that they declare, those too that nothing joins.
    Returns the paths of the files. ``trust`` lets included netlists act on the machine. With
    ``count`` the deck has so many copies of the scene, and there are no symbols.

    Raises
    ------
    UsageError : an unknown dialect, or one that cannot say what the scene needs.
    """
    known = DIALECTS if count is None else DECKS
    if dialect not in known:
        message = "unknown dialect" if count is None else "no array of copies in this dialect"
        raise unknown(message, dialect, known, "--dialect")
    clock = Clock(progress)
    with staged(out) as work:
        _, deck = prepared(composed(replace(scene, ports="declared")), clock, trust=trust)
        with clock.stage("export", "netlists and symbols"):
            if count is not None:
                deck = array_deck(deck, count)
            files = dialect_files(deck, dialect)
            files |= plot_script(deck) if dialect == "ngspice" else {}
            files |= symbol_files(deck, dialect) if count is None else {}
            _spare_other_decks(Path(out), files)
            write_files(files, work)
    return [Path(out) / name for name in sorted(files)]


def _spare_other_decks(out: Path, files: Mapping[str, str]) -> None:
    """Refuse to change a library under another deck in ``out``: it would run another part."""

    def text(path: Path) -> str:
        return path.read_text(encoding="utf-8", errors="replace")

    decks = sorted(out.glob("*.cir")) if out.is_dir() else ()
    for deck in (item for item in decks if item.name not in files):
        for card in statements(text(deck), deck.name, title=True):
            name = card.words[-1].strip("\"'") if card.keyword == ".include" else ""
            if name not in files or not (out / name).is_file():
                continue
            old, new = (
                [item.written for item in statements(known, name) if item.written]
                for known in (text(out / name), files[name])
            )
            if old != new:  # what a simulator reads of them
                raise UsageError(
                    f"this deck there includes another {name}",
                    where=str(deck),
                    got=f"{name} with other cards",
                    hint="choose another --out",
                )
