"""Ways to run the deck of a scene: in a separate process, or as a library with functions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.deck import Command, Deck
from kc2spice.scene.part_records import SampledSource
from kc2spice.sim.ngspice import Share, run_deck
from kc2spice.sim.output import join_analyses


@dataclass(frozen=True)
class Engine:
    """Way to run decks of a scene in ngspice, whose files are in ``directory``.

    Python functions set the ``sampled`` sources while ngspice runs as a library. ``refinements``
    are further analyses of small signals. ``from_rest`` states whether each of them needs a
    separate run: within one run, ngspice begins the search for the next operating point at the
    response of the last analysis. If several operating points exist, such a run may find another
    one. ``timeout`` is the largest wall-clock time [s] of a run.
    """

    directory: Path
    progress: Share = None
    timeout: float | None = None
    sampled: Sequence[SampledSource] = ()
    refinements: tuple[Command, ...] = ()
    from_rest: bool = False

    def run(self, deck: Deck) -> Waveforms:
        """Run ``deck`` with the refinements and return its waves in SI units.

        Raises as :func:`kc2spice.sim.ngspice.run_deck` and :func:`kc2spice.sim.shared.run_shared`
        do.
        """
        if self.sampled:
            # imported here, because few scenes need the library
            from kc2spice.sim.shared import run_shared

            functions = [item.reset_function for item in self.sampled]
            return run_shared(deck, functions, self.progress)
        within = () if self.from_rest else self.refinements
        first = run_deck(
            replace(deck, refinements=within), self.directory, self.progress, self.timeout
        )
        if not self.from_rest:
            return first
        parts = [first.data]
        for command in self.refinements:
            with TemporaryDirectory() as folder:
                separate = deck.with_command(command)
                parts.append(run_deck(separate, Path(folder), None, self.timeout).data)
        return replace(first, data=join_analyses(parts))
