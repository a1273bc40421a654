"""Engine that runs a deck in ngspice, as a separate process or as a library."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory

from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.deck import AnalysisCommand, Deck
from kc2spice.scene.part_records import SampledSource
from kc2spice.sim.ngspice import ProgressCallback, run_deck
from kc2spice.sim.output import join_analyses


@dataclass(frozen=True)
class Engine:
    """Engine that runs the decks of a scene in ngspice, as a process or as a library.

    ``directory`` contains the files of a run. If Python functions set the ``sampled`` sources,
    ngspice runs as a library. ``refinements`` are additional small-signal analyses: at closely
    spaced frequencies near resonances, and at the single frequencies set in the table ``[probes]``.
    If ``from_rest`` is true, ngspice runs separately for each of the additional analyses
    ``refinements``. In a single run, ngspice would begin each search for an operating point at the
    previous solution, and might find another operating point. ``timeout`` is the largest wall-clock
    time [s] of a run.
    """

    directory: Path
    progress: ProgressCallback = None
    timeout: float | None = None
    sampled: Sequence[SampledSource] = ()
    refinements: tuple[AnalysisCommand, ...] = ()
    from_rest: bool = False

    def run(self, deck: Deck) -> Waveforms:
        """Run a deck and its additional analyses; return the merged waveforms in SI units.

        :func:`kc2spice.sim.ngspice.run_deck` and :func:`kc2spice.sim.libngspice.run_in_libngspice`
        list the possible errors.
        """
        if self.sampled:
            # imported here, because few scenes need libngspice
            from kc2spice.sim.libngspice import run_in_libngspice

            functions = [item.copy_in_initial_state for item in self.sampled]
            return run_in_libngspice(deck, functions, self.progress)
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
