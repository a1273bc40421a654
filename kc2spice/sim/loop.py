"""Decks in libngspice inside this process, with Python functions in the loop."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.pid import Control
from kc2spice.sim.log import classify, statistics
from kc2spice.sim.shared import Library
from kc2spice.spice.deck import Deck, terms

Values = Mapping[str, float]
Function = Callable[[float, Values], Values]

_library: Library | None = None


@dataclass(frozen=True)
class Sampled:
    """A controller outside of ngspice that sees the loop every ``period`` [s], first at zero.

    Its answer is held from ``delay`` [s] later on. ngspice gets a time point at both instants.
    """

    period: float
    delay: float


@dataclass(frozen=True)
class Loop:
    """``function(time, values) -> {source: volts}``, called every ``sampled.period``.

    ``values`` are the deck's saved vectors in ngspice's names and units (``y`` in um), the answer
    names ``EXTERNAL`` sources in lower case and holds from ``sampled.delay`` later on. ngspice
    gets a time point at both instants, also in a deck that has no source with breakpoints there.
    """

    function: Function
    sampled: Sampled


class DigitalPid:
    """The controller of the sphere's height as a program: samples, differences, a clamp.

    The same law as the analogue one, ``i = clamp(KP e + KI sum(e) T + KD (e - e_before) / T)``,
    with its integrator held while the output is saturated and everything at zero until enabled.
    """

    def __init__(self, control: Control, period: float) -> None:
        self.control, self.period = control, period
        self.integral = 0.0
        self.before: float | None = None

    def __call__(self, time: float, values: Values) -> Values:
        """100 V per ampere for ``vexternal``, from the height ``y`` in um."""
        law, error = self.control, self.control.setpoint - values["y"] * 1e-6
        if time < law.enable_at:
            return {"vexternal": 0.0}
        slope = 0.0 if self.before is None else (error - self.before) / self.period
        self.before = error
        integral = self.integral + error * self.period
        wanted = law.kp * error + law.ki * integral + law.kd * slope
        current = float(np.clip(wanted, -law.current_limit, law.current_limit))
        if current == wanted:
            self.integral = integral
        return {"vexternal": 100.0 * current}


class _Sampler:
    """Calls the function of a loop at its instants and holds its answers."""

    def __init__(self, loop: Loop | None, stop: float, progress: Callable[[float], None] | None):
        self.loop, self.stop, self.progress = loop, stop, progress
        self.samples, self.shown = 0, 0.0
        self.held: dict[str, float] = {}
        self.answer: tuple[float, Values] | None = None

    def point(self, time: float, values: Callable[[], dict[str, float]]) -> None:
        """An accepted time point."""
        share = min(1.0, time / self.stop)
        if self.progress is not None and (share - self.shown >= 1e-3 or share > 1 - 1e-9):
            self.shown = share
            self.progress(share)
        if self.loop is None:
            return
        due = self.samples * self.loop.sampled.period
        if time >= due * (1 - 1e-12):
            self.samples += 1
            answer = dict(self.loop.function(due, values()))
            self.answer = (due + self.loop.sampled.delay, answer)

    def source(self, time: float, name: str) -> float:
        """Volts; nothing changes before the step that ends at the instant is over."""
        if self.answer is not None and time > self.answer[0] * (1 + 1e-12):
            self.held.update(self.answer[1])
            self.answer = None
        return self.held.get(name, 0.0)

    def limit(self, time: float, step: float) -> float:
        """A step that ends at the next instant at the latest."""
        assert self.loop is not None
        period, delay = self.loop.sampled.period, self.loop.sampled.delay
        ahead = min(
            (math.floor((time - shift) / period + 1 + 1e-9) * period + shift) - time
            for shift in (0.0, delay)
        )
        return ahead if ahead > 0 else step


def run_shared(
    deck: Deck, loop: Loop | None = None, progress: Callable[[float], None] | None = None
) -> Waveforms:
    """Run the transient ``deck`` in libngspice; results and names as from the batch engine.

    Raises
    ------
    MissingToolError : libngspice is not on this machine.
    SimulationError : ngspice failed or stopped early, or the function in the loop did.
    """
    library = _fresh()
    sampler = _Sampler(loop, deck.stop or 1.0, progress)
    try:
        ran = library.load(flattened(deck)) and library.run(
            sampler.point if loop or progress else None,
            sampler.source if loop else None,
            sampler.limit if loop else None,
        )
        if library.broken is not None:
            raise SimulationError(
                "the function in the loop failed", where=deck.name, got=repr(library.broken)
            ) from library.broken
        vectors = library.vectors() if ran else {}
        said = library.said
    finally:
        library.clear()
    _judge(deck, said, vectors)
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


def _judge(deck: Deck, said: str, vectors: Mapping[str, np.ndarray]) -> None:
    report = classify(said)
    times = vectors.get("time", np.zeros(0))
    reached = times.size > 0 and abs(times[-1] - (deck.stop or 0.0)) <= 1e-9 * (deck.stop or 0.0)
    if reached and not report.errors:
        return
    raise SimulationError(
        f"ngspice failed: {report.cause or 'it stopped before the end of the transient'}",
        where=deck.name,
        got=f"last time point {times[-1]:g} s" if times.size else " | ".join(said.split("\n")[-4:]),
        expected=None if deck.stop is None else f"{deck.stop:g} s",
    )
