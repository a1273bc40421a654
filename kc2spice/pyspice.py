"""PySpice: parts as PySpice subcircuits, and libngspice with Python functions in the loop.

The shared library runs a whole deck inside this process: it reports every time point, and voltage
sources of the kind ``EXTERNAL`` get their value from a Python function. One process has one
library with one circuit at a time.
"""

from __future__ import annotations

import contextlib
import ctypes.util
import logging
import os
import re
import tempfile
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import MissingToolError, SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.bench import Sampled
from kc2spice.scene.schema import Control
from kc2spice.sim.log import classify, statistics
from kc2spice.spice.circuit import Deck, Subcircuit

Values = Mapping[str, float]
Function = Callable[[float, Values], Values]


@dataclass(frozen=True)
class Loop:
    """``function(time, values) -> {source: volts}``, called every ``sampled.period``.

    ``values`` are the deck's saved vectors in ngspice's names and units (``v(y)`` in um), the
    answer names ``EXTERNAL`` sources in lower case and holds from ``sampled.delay`` later on.
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


def subcircuit(part: Subcircuit) -> Any:
    """``part`` for ``circuit.subcircuit(...)`` and ``circuit.X(name, part.name, *nodes)``.

    Raises
    ------
    MissingToolError : PySpice is not installed.
    """
    parent = _pyspice("PySpice.Spice.Netlist").SubCircuit

    class Part(parent):  # type: ignore[misc,valid-type]
        """A part of kc2spice, written out as it stands in its library file."""

        def __str__(self) -> str:
            return part.text.rstrip("\n") + "\n"

    return Part(
        part.name, *(pin.name for pin in part.pins), **{p.name: p.default for p in part.params}
    )


def run_shared(
    deck: Deck, loop: Loop | None = None, progress: Callable[[float], None] | None = None
) -> Waveforms:
    """Run the transient ``deck`` in libngspice; results and names as from the batch engine.

    Raises
    ------
    MissingToolError : PySpice or libngspice is not on this machine.
    SimulationError : ngspice failed or stopped early, or the function in the loop did.
    """
    engine = _engine()
    engine.begin(deck, loop, progress)
    said = ""
    try:
        try:
            engine.load_circuit(flattened(deck))
            said += _output(engine)  # the next command clears it, the cause of an error with it
            engine.exec_command("run")
        except (NameError, *engine.failures) as error:
            said += f"\n{error}"  # judged by what was printed: PySpice raises at notes, too
        said += _output(engine)
        if engine.broken is not None:
            raise SimulationError(
                "the function in the loop failed", where=deck.name, got=repr(engine.broken)
            ) from engine.broken
        vectors = engine.vectors()
    finally:
        engine.end()
    _judge(deck, said, vectors)
    data = {"time": vectors["time"]}
    for name, (expression, factor) in deck.vectors.items():
        data[name] = factor * np.sum([vectors[_plain(v)] for v in expression.split("+")], axis=0)
    counted = {"accepted": float(vectors["time"].size)}
    return Waveforms(data, counted | statistics(said))


def flattened(deck: Deck) -> str:
    """The deck as one text, its includes in their places."""

    def lines(file: str) -> list[str]:
        found: list[str] = []
        for line in deck.files[file].splitlines():
            word, _, target = line.partition(" ")
            # what a trusted circuit includes from elsewhere is not among the deck's files
            inner = target.strip().strip("\"'") if word.lower() in (".include", ".inc") else ""
            found += lines(inner) if inner in deck.files else [line]
        return found

    return "\n".join(lines(deck.main))


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
        got=f"last time point {times[-1]:g} s" if times.size else " | ".join(said.split("\n")[-3:]),
        expected=None if deck.stop is None else f"{deck.stop:g} s",
    )


def _output(engine: Any) -> str:
    return f"{engine.stdout}\n{engine.stderr}\n"


def _pyspice(module: str) -> Any:
    logging.getLogger("PySpice").setLevel(logging.CRITICAL)  # what it says is in its output, too
    try:
        import sys

        import PySpice.Spice.Netlist
        import PySpice.Spice.NgSpice.Shared  # noqa: F401
    except ImportError as error:
        raise MissingToolError(
            "PySpice is not installed", got=str(error), hint="pip install PySpice"
        ) from None
    return sys.modules[module]


@contextlib.contextmanager
def _without_startup_files() -> Iterator[None]:
    """Let the library start where the only ``.spiceinit`` is ours, and empty.

    It runs the commands of the first one that it finds, in the working directory, then at home;
    version 39 has no switch for it.
    """
    spice = {key: text for key, text in os.environ.items() if key.startswith("SPICE_")}
    here = os.getcwd()
    with tempfile.TemporaryDirectory(prefix="kc2spice-start-") as place:
        Path(place, ".spiceinit").write_text("* nothing\n", encoding="utf-8")
        try:
            for key in spice:
                del os.environ[key]
            os.chdir(place)
            yield
        finally:
            os.chdir(here)
            os.environ.update(spice)


@cache
def _engine() -> Any:
    """The one engine of this process."""
    shared = _pyspice("PySpice.Spice.NgSpice.Shared")
    library = ctypes.util.find_library("ngspice")
    if library is None:
        raise MissingToolError(
            "libngspice is not on this machine",
            where="shared library path",
            expected="libngspice.so.0, version 39 or later",
            hint="Debian or Ubuntu: apt-get install libngspice0",
        )

    class Engine(shared.NgSpiceShared):  # type: ignore[name-defined]
        """Callbacks of the library: time points out, source voltages in."""

        LIBRARY_PATH = library
        failures = (shared.NgSpiceCommandError, shared.NgSpiceCircuitError)

        def begin(self, deck: Deck, loop: Loop | None, progress: Any) -> None:
            self.deck, self.loop, self.progress = deck, loop, progress
            self.broken: Exception | None = None
            self.held: dict[str, float] = {}
            self.answer: tuple[float, Values] | None = None
            self.samples = 0
            self.names: list[str] = []
            self.points: dict[str, list[float]] = {}

        def end(self) -> None:
            for command in ("destroy all", "remcirc"):
                try:
                    self.exec_command(command)
                except (NameError, *self.failures):
                    pass  # there was nothing to remove

        def vectors(self) -> dict[str, np.ndarray]:
            return {name: np.array(values) for name, values in self.points.items()}

        @staticmethod
        def _send_data(data: Any, count: int, ngspice_id: int, handle: Any) -> int:
            """One accepted time point. The parent decodes every name again at each."""
            self = shared.ffi.from_handle(handle)
            try:
                vectors = data.vecsa
                if len(self.names) != count:
                    names = (shared.ffi_string_utf8(vectors[k].name) for k in range(count))
                    self.names = [_plain(name.lower()) for name in names]
                self._point({n: vectors[k].creal for k, n in enumerate(self.names)})
            except Exception as error:  # an exception must not pass through C
                self.broken = self.broken or error
            return 0

        def _point(self, values: Values) -> None:
            time, stop = values["time"], self.deck.stop or 1.0
            for name, value in values.items():
                self.points.setdefault(name, []).append(value)
            if self.progress is not None:
                self.progress(min(1.0, time / stop))
            if self.loop is None or self.broken is not None:
                return
            due = self.samples * self.loop.sampled.period
            if time >= due * (1 - 1e-12):
                self.samples += 1
                answer = dict(self.loop.function(due, values))
                self.answer = (due + self.loop.sampled.delay, answer)

        def get_vsrc_data(self, voltage: Any, time: float, node: str, ngspice_id: int) -> int:
            # Nothing changes before the step that ends at the breakpoint is over.
            if self.answer is not None and time > self.answer[0] * (1 + 1e-12):
                self.held.update(self.answer[1])
                self.answer = None
            voltage[0] = self.held.get(node.lower(), 0.0)
            return 0

    try:
        with _without_startup_files():
            return Engine(send_data=True)
    except OSError as error:
        raise MissingToolError(
            "libngspice cannot be loaded", where=library, got=str(error),
            hint="Debian or Ubuntu: apt-get install libngspice0",
        ) from None  # fmt: skip
