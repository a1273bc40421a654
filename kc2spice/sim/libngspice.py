"""Simulation by libngspice in this process, with sources set by Python functions.

The chapter "Ngspice as shared library" of the ngspice manual describes the interface.

Each :class:`NgspiceLibrary` loads a private copy of the library file. Other packages in this
process that use libngspice, such as PySpice or InSpice, have separate copies. After a fatal error,
a new copy is loaded. The library loads neither the user's start-up files nor code models.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import math
import os
import shutil
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import chdir, contextmanager
from ctypes import CFUNCTYPE, POINTER, byref, c_bool, c_char_p, c_double, c_int, c_void_p
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import MissingToolError, SimulationError, UsageError
from kc2spice.core.install_commands import make_install_command
from kc2spice.core.untrusted_files import split_lines
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.name_scopes import INCLUDES
from kc2spice.scene.part_records import SampledSource
from kc2spice.sim.ngspice import convert_to_waves, read_partial_waves
from kc2spice.sim.output import find_alteration_error, find_run_failure, read_raw, read_statistics


def _make_structure(**fields: Any) -> Any:
    """Return a ctypes class for a C structure with the given fields."""
    return type("Structure", (ctypes.Structure,), {"_fields_": tuple(fields.items())})


# The C structures vecvalues and vecvaluesall in sharedspice.h.
_Value = _make_structure(
    name=c_char_p, real=c_double, imag=c_double, is_scale=c_bool, is_complex=c_bool
)
_Values = _make_structure(count=c_int, index=c_int, vectors=POINTER(POINTER(_Value)))

_SEND_CHAR = CFUNCTYPE(c_int, c_char_p, c_int, c_void_p)
_EXIT = CFUNCTYPE(c_int, c_int, c_bool, c_bool, c_int, c_void_p)
_SEND_DATA = CFUNCTYPE(c_int, POINTER(_Values), c_int, c_int, c_void_p)
_SEND_INIT = CFUNCTYPE(c_int, c_void_p, c_int, c_void_p)
_SOURCE = CFUNCTYPE(c_int, POINTER(c_double), c_double, c_char_p, c_int, c_void_p)
_SYNC = CFUNCTYPE(c_int, c_double, POINTER(c_double), c_double, c_int, c_int, c_int, c_void_p)


_loaded_library: NgspiceLibrary | None = None


@dataclass
class _Sampler:
    """Callbacks that call Python functions at sampling instants, and set the sources.

    ``samples`` is the number of completed calls of each function. ``answers`` contains, for each
    source, the instant [s] at which its next value becomes effective, and this value. ``inputs``
    contains the present values of the sources.
    """

    sampled: Sequence[SampledSource]
    stop: float
    progress: Callable[[float], None] | None
    reported: float = 0.0
    samples: Counter[int] = field(default_factory=Counter)
    inputs: dict[str, float] = field(default_factory=dict)
    answers: dict[str, tuple[float, float]] = field(default_factory=dict)

    def call_due_functions(self, data: Any, *_: object) -> None:
        """Call the Python functions whose next sampling instant has been reached.

        ngspice calls :meth:`call_due_functions` at each accepted time point.
        """
        points = [data.contents.vectors[k].contents for k in range(data.contents.count)]
        time = next((point.real for point in points if point.is_scale), 0.0)
        share = min(1.0, time / self.stop)
        if self.progress is not None and (share - self.reported >= 1e-3 or share > 1 - 1e-9):
            self.reported = share
            self.progress(share)
        for k, item in enumerate(self.sampled):
            due = self.samples[k] * item.period
            if time >= due * (1 - 1e-12):
                self.samples[k] += 1
                values = {p.name.decode().lower(): p.real for p in points}
                self.answers[item.source] = (due + item.delay, item.call(due, values))

    def set_source(self, volts: Any, time: float, name: bytes, *_: object) -> None:
        """Set the voltage of a source.

        A new value becomes effective in the time step that begins at the instant of the change.
        """
        key = name.decode().lower()
        if key in self.answers and time > self.answers[key][0] * (1 + 1e-12):
            self.inputs[key] = self.answers.pop(key)[1]
        volts[0] = self.inputs.get(key, 0.0)

    def limit_step(self, time: float, step: Any, *_: object) -> None:
        """Limit a time step to the time until the next sampling or change of a source.

        The instants of a source are its sampling instants and the instants at which it changes.
        """
        for item in self.sampled:
            for shift in (0.0, item.delay):
                periods = math.floor((time - shift) / item.period + 1 + 1e-9)
                ahead = (periods * item.period + shift) - time
                if ahead > 0:
                    step[0] = min(step[0], ahead)


def run_in_libngspice(
    deck: Deck,
    sampled: Sequence[SampledSource] = (),
    progress: Callable[[float], None] | None = None,
) -> Waveforms:
    """Run the transient ``deck`` in libngspice, and return the waveforms in SI units.

    The arguments of the ``sampled`` functions are the time and the saved node voltages, keyed by
    their names in ngspice. Each function sets an ``EXTERNAL`` source. ngspice places time points at
    sampling instants and at changes of sources, even where the deck has no breakpoint.

    Raises
    ------
    UsageError : the deck contains no transient analysis with an end time.
    MissingToolError : libngspice is not installed on this machine.
    FailedRunError : ngspice failed, stopped early, or ignored or replaced a card in a deck that is
        not trusted. The error contains the waveforms up to the failure.
    SimulationError : a Python function raised an exception.
    """
    if deck.stop is None:
        raise UsageError(
            "the deck has no transient analysis",
            where=deck.name,
            expected="a deck with a .tran line",
        )
    global _loaded_library
    if _loaded_library is None or _loaded_library.dead:  # a library is dead after a fatal error
        _loaded_library = NgspiceLibrary()
    library = _loaded_library
    loop = _Sampler(sampled, deck.stop, progress) if sampled or progress else None
    try:
        ran = library.load_deck(_flatten_deck(deck, deck.main_file_name)) and library.run(loop)
        if library.broken is not None:
            raise SimulationError(
                "the Python function of the controller failed",
                where=deck.name,
                got=repr(library.broken),
            ) from library.broken
        log = library.log
        vectors = library.vectors()
    finally:
        library.clear()
    time = vectors.get("time", np.zeros(1))
    failed = find_run_failure(deck, deck.name, log, int(not ran), float(time[-1]))
    failed = failed or find_alteration_error(deck, deck.name, log)
    if failed is not None:
        failed.failure = replace(failed.failure, partial=read_partial_waves(deck, vectors, log))
        raise failed
    return Waveforms(
        convert_to_waves(deck, vectors), {"accepted": float(time.size)} | read_statistics(log)
    )


def _flatten_deck(deck: Deck, file: str) -> list[str]:
    """Return the lines of a deck and of included files, without ``.meas`` cards.

    libngspice would evaluate ``.meas`` cards with parameters before any time point exists.
    """
    result: list[str] = []
    measures = False
    for line in split_lines(deck.files[file]):
        word, _, target = line.partition(" ")
        measures = word.lower().startswith(".meas") or (measures and word.startswith("+"))
        if word.lower() in INCLUDES:
            result += _flatten_deck(deck, target.strip().strip("\"'"))
        elif not measures:
            result.append(line)
    return result


class NgspiceLibrary:
    """Private copy of libngspice, which simulates one circuit at a time.

    ``log`` contains the lines that ngspice has printed since :meth:`load_deck`. ``dead`` is true
    after ngspice has requested to be unloaded. ``broken`` is the first exception that a callback
    has raised. The exception is stored, because an exception cannot propagate through C code.

    Raises
    ------
    MissingToolError : libngspice is not installed on this machine, or cannot be loaded.
    """

    def __init__(self) -> None:
        self.log = ""
        self.dead = False
        self.broken: Exception | None = None
        self._loop: _Sampler | None = None
        self._loaded_library = _load_private_copy()
        # the callbacks must not be deleted, because ngspice stores pointers to them
        self._callbacks = (
            _SEND_CHAR(self._on_text),
            _EXIT(self._on_exit),
            _SEND_DATA(self._guard_callback("call_due_functions")),
            # without an initialisation callback, ngspice does not send time points
            _SEND_INIT(lambda *_: 0),
            _SOURCE(self._guard_callback("set_source")),
            _SYNC(self._guard_callback("limit_step")),
        )
        text, leave, point, begin, source, step = self._callbacks
        with _hide_start_up_files():
            self._loaded_library.ngSpice_Init(text, None, leave, point, begin, None, None)
        self._loaded_library.ngSpice_Init_Sync(source, None, step, byref(c_int(0)), None)

    def load_deck(self, circuit: Sequence[str]) -> bool:
        """Load the lines of a deck into ngspice; return False if ngspice rejects the deck."""
        self.log, self.broken = "", None
        lines = [*map(str.encode, circuit), None]
        return self._loaded_library.ngSpice_Circ((c_char_p * len(lines))(*lines)) == 0

    def run(self, loop: _Sampler | None) -> bool:
        """Run the analyses of the loaded deck; return False if ngspice reports a failure."""
        self._loop = loop
        return self._send_command("run")

    def vectors(self) -> dict[str, np.ndarray]:
        """Return the arrays of the last analysis, keyed by vector name as in batch mode."""
        with tempfile.TemporaryDirectory(prefix="kc2spice-") as folder:
            raw = Path(folder) / "out.raw"
            self._send_command("set filetype=binary")
            self._send_command(f"write '{raw}'")
            return read_raw(raw) if raw.is_file() else {}

    def clear(self) -> None:
        """Remove the loaded circuit and its results from ngspice."""
        for text in ("destroy all", "remcirc"):
            self._send_command(text)
        self._loop = self.broken = None

    def _send_command(self, text: str) -> bool:
        """Send a command to ngspice; return whether the command succeeded."""
        return not self.dead and self._loaded_library.ngSpice_Command(text.encode()) == 0

    # -- callbacks of ngspice ------------------------------------------------------------------

    def _guard_callback(self, name: str) -> Callable[..., int]:
        """Return a C callback that runs a method of the sampler and catches exceptions.

        ``name`` is the name of the method. The callback stores an exception in ``broken``, and has
        no effect after an exception.
        """

        def guarded_callback(*arguments: Any) -> int:
            """Call the Python function; store an exception instead of raising it into C."""
            try:
                if self._loop is not None and self.broken is None:
                    getattr(self._loop, name)(*arguments)
            except Exception as error:
                self.broken = error
            return 0

        return guarded_callback

    def _on_text(self, text: bytes, *_: object) -> int:
        """Append a line of ngspice output to the log."""
        line = text.decode(errors="replace")
        self.log += line.removeprefix("stdout ").removeprefix("stderr ") + "\n"
        return 0

    def _on_exit(self, *_: object) -> int:
        """Record that ngspice has requested to be unloaded."""
        self.dead = True
        return 0


def _load_private_copy() -> ctypes.CDLL:
    """Load libngspice from a private copy of its file, with separate global variables.

    If the path of the file is unknown, the library is loaded without a copy.
    """
    library_name = ctypes.util.find_library("ngspice")
    if library_name is None:
        raise MissingToolError(
            "libngspice is not on this machine",
            where="shared library path",
            expected="libngspice.so.0, version 39 or later",
            hint=make_install_command("libngspice0"),
        )
    try:
        plain = ctypes.CDLL(library_name)
        # On Linux, find_library returns a name; /proc/self/maps contains the path of the library.
        maps = Path("/proc/self/maps")
        loaded = maps.read_text("utf-8").split() if maps.is_file() else [library_name]
        candidates = (word for word in loaded if library_name in word)
        path = next(filter(os.path.isfile, candidates), None)
        if path is None:
            return plain
        with tempfile.TemporaryDirectory(prefix="kc2spice-") as folder:
            copy = Path(shutil.copy(path, folder))
            mode = os.RTLD_LOCAL | os.RTLD_NOW | getattr(os, "RTLD_DEEPBIND", 0)
            # the copy can be deleted after it is loaded into memory
            return ctypes.CDLL(str(copy), mode=mode)
    except OSError as error:
        raise MissingToolError(
            "libngspice cannot be loaded",
            where=library_name,
            got=str(error),
            hint=make_install_command("libngspice0"),
        ) from None


@contextmanager
def _hide_start_up_files() -> Iterator[None]:
    """Hide the user's start-up files behind empty files that ngspice finds first."""
    variables = ("HOME", "SPICE_SCRIPTS", "SPICE_USERINIT_DIR")
    previous = {name: os.environ[name] for name in variables if name in os.environ}
    with tempfile.TemporaryDirectory(prefix="kc2spice-") as folder, chdir(folder):
        for name in ("spinit", ".spiceinit"):
            Path(name).write_text("* empty\n", encoding="ascii")
        try:
            os.environ |= dict.fromkeys(variables, folder)
            yield
        finally:
            for name in variables:
                del os.environ[name]
            os.environ |= previous
