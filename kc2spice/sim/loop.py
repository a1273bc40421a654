"""Decks in libngspice inside this process, with Python functions in the loop."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.vectors import terms
from kc2spice.scene.parttype import Sampled
from kc2spice.sim.log import classify, statistics
from kc2spice.sim.shared import Library

_library: Library | None = None


class _Sampler:
    """Calls the functions of a deck at their instants and holds their answers."""

    def __init__(
        self,
        sampled: Sequence[Sampled],
        stop: float,
        progress: Callable[[float], None] | None,
    ) -> None:
        self.sampled, self.stop, self.progress = tuple(sampled), stop, progress
        self.samples = [0] * len(self.sampled)
        self.shown = 0.0
        self.held: dict[str, float] = {}
        self.answers: dict[str, tuple[float, float]] = {}

    def point(self, time: float, values: Callable[[], dict[str, float]]) -> None:
        """An accepted time point."""
        share = min(1.0, time / self.stop)
        if self.progress is not None and (share - self.shown >= 1e-3 or share > 1 - 1e-9):
            self.shown = share
            self.progress(share)
        for k, each in enumerate(self.sampled):
            due = self.samples[k] * each.period
            if time >= due * (1 - 1e-12):
                self.samples[k] += 1
                self.answers[each.source] = (due + each.delay, each.call(due, values()))

    def source(self, time: float, name: str) -> float:
        """Volts; nothing changes before the step that ends at the instant is over."""
        if name in self.answers and time > self.answers[name][0] * (1 + 1e-12):
            self.held[name] = self.answers.pop(name)[1]
        return self.held.get(name, 0.0)

    def limit(self, time: float, step: float) -> float:
        """A step that ends at the next instant at the latest."""
        ahead = [
            (math.floor((time - shift) / each.period + 1 + 1e-9) * each.period + shift) - time
            for each in self.sampled
            for shift in (0.0, each.delay)
        ]
        return min((a for a in ahead if a > 0), default=step)


def run_shared(
    deck: Deck,
    sampled: Sequence[Sampled] = (),
    progress: Callable[[float], None] | None = None,
) -> Waveforms:
    """Run the transient ``deck`` in libngspice; results and names as from the batch engine.

    The ``sampled`` functions see the deck's saved node voltages in ngspice's names and set the
    ``EXTERNAL`` sources that they name. ngspice gets a time point at both instants of each, also in
    a deck that has no source with breakpoints there.

    Raises
    ------
    UsageError : the deck has no end of a transient.
    MissingToolError : libngspice is not on this machine.
    SimulationError : ngspice failed or stopped early, or a function did.
    """
    if deck.stop is None:
        raise UsageError("no transient", where=deck.name, expected="a deck with its last time")
    library = _fresh()
    sampler = _Sampler(sampled, deck.stop, progress)
    try:
        ran = library.load(flattened(deck)) and library.run(
            sampler.point if sampled or progress else None,
            sampler.source if sampled else None,
            sampler.limit if sampled else None,
        )
        if library.broken is not None:
            raise SimulationError(
                "the function in the loop failed", where=deck.name, got=repr(library.broken)
            ) from library.broken
        vectors = library.vectors() if ran else {}
        said = library.said
    finally:
        library.clear()
    _judge(deck.name, deck.stop, said, vectors)
    data = {"time": vectors["time"]}
    for name, (expression, factor) in deck.vectors.items():
        data[name] = factor * np.sum(
            [sign * vectors[_plain(v)] for sign, v in terms(expression)], axis=0
        )
    counted = {"accepted": float(vectors["time"].size)}
    return Waveforms(data, counted | statistics(said))


def flattened(deck: Deck) -> str:
    """The deck as one text, its includes in their places."""

    def lines(file: str) -> list[str]:
        found: list[str] = []
        for line in deck.files[file].splitlines():
            word, _, target = line.partition(" ")
            included = word.lower() in (".include", ".inc")
            found += lines(target.strip().strip("\"'")) if included else [line]
        return found

    return "\n".join(lines(deck.main))


def _fresh() -> Library:
    """The library of this process; a new copy where ngspice has given up the last one."""
    global _library
    if _library is None or _library.dead:
        _library = Library()
    return _library


def _plain(vector: str) -> str:
    """``v(y)`` to ``y`` and ``i(vkick)`` to ``vkick#branch``, the library's own names."""
    return re.sub(r"^i\((v.*)\)$", r"\1#branch", re.sub(r"^v\((.*)\)$", r"\1", vector))


def _judge(name: str, stop: float, said: str, vectors: Mapping[str, np.ndarray]) -> None:
    report = classify(said)
    times = vectors.get("time", np.zeros(0))
    reached = times.size > 0 and abs(times[-1] - stop) <= 1e-9 * stop
    if reached and not report.errors:
        return
    raise SimulationError(
        f"ngspice failed: {report.cause or 'it stopped before the end of the transient'}",
        where=name,
        got=f"last time point {times[-1]:g} s" if times.size else " | ".join(said.split("\n")[-4:]),
        expected=f"{stop:g} s",
    )
