"""Binding of libngspice (ngspice manual, chapter "Ngspice as shared library") by ctypes.

Each :class:`Library` is a private copy of the library: other users of libngspice in the process
(PySpice, InSpice) keep theirs, in either order, and a copy that ngspice has given up after a fatal
error is replaced. Neither the user's start-up file nor code models are read.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from ctypes import CFUNCTYPE, POINTER, byref, c_bool, c_char_p, c_double, c_int, c_short, c_void_p
from pathlib import Path

import numpy as np

from kc2spice.core.errors import MissingToolError

Sampler = Callable[[float, Callable[[], dict[str, float]]], None]
Source = Callable[[float, str], float]
Limit = Callable[[float, float], float]

_HINT = "Debian or Ubuntu: apt-get install libngspice0"


class _Complex(ctypes.Structure):
    _fields_ = (("real", c_double), ("imag", c_double))


class _Vector(ctypes.Structure):  # vector_info
    _fields_ = (
        ("name", c_char_p),
        ("type", c_int),
        ("flags", c_short),
        ("real", POINTER(c_double)),
        ("complex", POINTER(_Complex)),
        ("length", c_int),
    )


class _Value(ctypes.Structure):  # vecvalues
    _fields_ = (
        ("name", c_char_p),
        ("real", c_double),
        ("imag", c_double),
        ("is_scale", c_bool),
        ("is_complex", c_bool),
    )


class _Values(ctypes.Structure):  # vecvaluesall
    _fields_ = (("count", c_int), ("index", c_int), ("vectors", POINTER(POINTER(_Value))))


class _Place(ctypes.Structure):  # Dl_info
    _fields_ = (("file", c_char_p), ("base", c_void_p), ("symbol", c_char_p), ("at", c_void_p))


_SEND_CHAR = CFUNCTYPE(c_int, c_char_p, c_int, c_void_p)
_EXIT = CFUNCTYPE(c_int, c_int, c_bool, c_bool, c_int, c_void_p)
_SEND_DATA = CFUNCTYPE(c_int, POINTER(_Values), c_int, c_int, c_void_p)
_SEND_INIT = CFUNCTYPE(c_int, c_void_p, c_int, c_void_p)
_SOURCE = CFUNCTYPE(c_int, POINTER(c_double), c_double, c_char_p, c_int, c_void_p)
_SYNC = CFUNCTYPE(c_int, c_double, POINTER(c_double), c_double, c_int, c_int, c_int, c_void_p)


class Library:
    """One copy of libngspice with one circuit at a time.

    ``said`` is what ngspice has printed since :meth:`load`, standard output and error in order;
    ``dead`` tells that ngspice has asked to be unloaded; ``broken`` is the first exception of a
    callback, which cannot pass through C.

    Raises
    ------
    MissingToolError : libngspice is not on this machine, or cannot be loaded.
    """

    def __init__(self) -> None:
        self._lines: list[str] = []
        self._sampler: Sampler | None = None
        self._source: Source | None = None
        self._limit: Limit | None = None
        self.broken: Exception | None = None
        self.dead = False
        self._library = _private_copy()
        self._library.ngSpice_AllVecs.restype = POINTER(c_char_p)
        self._library.ngSpice_CurPlot.restype = c_char_p
        self._library.ngGet_Vec_Info.restype = POINTER(_Vector)
        # ngspice keeps these pointers: they live as long as this object does.
        self._kept = (
            _SEND_CHAR(self._on_text),
            _EXIT(self._on_exit),
            _SEND_DATA(self._on_point),
            _SEND_INIT(lambda *_: 0),
            _SOURCE(self._on_source),
            _SYNC(self._on_step),
        )
        text, leave, point, begin, source, step = self._kept
        with _no_start_up_files(self._library):
            self._library.ngSpice_Init(text, None, leave, point, begin, None, None)
        self._library.ngSpice_Init_Sync(source, None, step, byref(c_int(0)), None)

    @property
    def said(self) -> str:
        """Lines of standard output and error."""
        return "\n".join(self._lines) + "\n"

    def load(self, circuit: str) -> bool:
        """Read ``circuit``, a deck without includes; False if ngspice refuses it."""
        self._lines.clear()
        self._forget()
        lines = [line.encode() for line in circuit.splitlines()] + [None]
        return self._library.ngSpice_Circ((c_char_p * len(lines))(*lines)) == 0

    def run(
        self,
        sampler: Sampler | None = None,
        source: Source | None = None,
        limit: Limit | None = None,
    ) -> bool:
        """Run the analyses of the circuit; False if ngspice reports a failure.

        Parameters
        ----------
        sampler : called at each accepted time point with the time [s] and a function that gives
            the saved vectors there, ``{name: value}``, in ngspice's lower-case names.
        source : volts of a source of kind ``EXTERNAL`` at a time [s], from its lower-case name.
        limit : the step [s] to take from a time [s], given the step that ngspice would take.
        """
        self._sampler, self._source, self._limit = sampler, source, limit
        return self.command("run")

    def command(self, text: str) -> bool:
        """One command of ngspice's interactive language; False if it failed."""
        return not self.dead and self._library.ngSpice_Command(text.encode()) == 0

    def vectors(self) -> dict[str, np.ndarray]:
        """Results of the last analysis by lower-case name, real or complex, as copies."""
        plot = self._library.ngSpice_CurPlot()
        found: dict[str, np.ndarray] = {}
        names = self._library.ngSpice_AllVecs(plot)
        listed: list[bytes] = []
        while names and names[len(listed)]:  # the list is ngspice's own and changes: read it first
            listed.append(names[len(listed)])
        for name in listed:
            info = self._library.ngGet_Vec_Info(plot + b"." + name)
            if info and info.contents.length > 0:
                found[name.decode().lower()] = _copied(info.contents)
        return found

    def clear(self) -> None:
        """Remove circuit and results."""
        for text in ("destroy all", "remcirc"):
            self.command(text)
        self._forget()

    # -- what ngspice calls ------------------------------------------------------------------

    def _forget(self) -> None:
        self._sampler = self._source = self._limit = self.broken = None

    def _on_text(self, text: bytes, ident: int, user: object) -> int:
        line = text.decode(errors="replace")
        self._lines.append(line.removeprefix("stdout ").removeprefix("stderr "))
        return 0

    def _on_exit(self, status: int, immediate: bool, quit_: bool, ident: int, user: object) -> int:
        self.dead = True
        return 0

    def _on_point(self, data: object, count: int, ident: int, user: object) -> int:
        if self._sampler is None or self.broken is not None:
            return 0
        vectors, last = data.contents.vectors, data.contents.count  # type: ignore[attr-defined]

        def values() -> dict[str, float]:
            points = (vectors[k].contents for k in range(last))
            return {p.name.decode().lower(): p.real for p in points}

        try:
            scale = next((v for k in range(last) if (v := vectors[k].contents).is_scale), None)
            self._sampler(0.0 if scale is None else scale.real, values)
        except Exception as error:
            self.broken = error
        return 0

    def _on_source(self, value: object, time: float, name: bytes, ident: int, user: object) -> int:
        try:
            if self._source is not None and self.broken is None:
                value[0] = self._source(time, name.decode().lower())  # type: ignore[index]
        except Exception as error:
            self.broken = error
        return 0

    def _on_step(
        self, time: float, step: object, old: float, redo: int, ident: int, loc: int, user: object
    ) -> int:
        try:
            if self._limit is not None and self.broken is None:
                step[0] = min(step[0], self._limit(time, step[0]))  # type: ignore[index]
        except Exception as error:
            self.broken = error
        return 0


def _copied(vector: _Vector) -> np.ndarray:
    if vector.real:
        return np.ctypeslib.as_array(vector.real, (vector.length,)).copy()
    flat = ctypes.cast(vector.complex, POINTER(c_double))
    return np.ctypeslib.as_array(flat, (2 * vector.length,)).copy().view(complex)


def _private_copy() -> ctypes.CDLL:
    """libngspice from a copy of its file, so that its globals are nobody else's."""
    found = ctypes.util.find_library("ngspice")
    if found is None:
        raise MissingToolError(
            "libngspice is not on this machine",
            where="shared library path",
            expected="libngspice.so.0, version 39 or later",
            hint=_HINT,
        )
    try:
        plain = ctypes.CDLL(found)
        path = _file_of(plain)
        if path is None:  # no dladdr: the system's one copy has to do
            return plain
        with tempfile.TemporaryDirectory(prefix="kc2spice-") as folder:
            copy = Path(shutil.copy(path, folder))
            mode = os.RTLD_LOCAL | os.RTLD_NOW | getattr(os, "RTLD_DEEPBIND", 0)
            return ctypes.CDLL(str(copy), mode=mode)  # mapped: the file may go
    except OSError as error:
        raise MissingToolError(
            "libngspice cannot be loaded", where=found, got=str(error), hint=_HINT
        ) from None


def _file_of(library: ctypes.CDLL) -> Path | None:
    finder = getattr(ctypes.CDLL(None), "dladdr", None) if os.name == "posix" else None
    place = _Place()
    symbol = ctypes.cast(library.ngSpice_Init, c_void_p)
    return Path(os.fsdecode(place.file)) if finder and finder(symbol, byref(place)) else None


@contextmanager
def _no_start_up_files(library: ctypes.CDLL) -> Iterator[None]:
    """ngspice finds empty start-up files first, so it reads neither the user's nor code models."""
    if hasattr(library, "ngSpice_nospiceinit"):
        library.ngSpice_nospiceinit()
    before, variables = Path.cwd(), ("HOME", "SPICE_SCRIPTS", "SPICE_USERINIT_DIR")
    kept = {name: os.environ.get(name) for name in variables}
    with tempfile.TemporaryDirectory(prefix="kc2spice-") as folder:
        for name in ("spinit", ".spiceinit"):
            (Path(folder) / name).write_text("* empty\n", encoding="ascii")
        try:
            os.environ |= dict.fromkeys(variables, folder)
            os.chdir(folder)
            yield
        finally:
            os.chdir(before)
            for name, value in kept.items():
                os.environ.pop(name, None)
                if value is not None:
                    os.environ[name] = value
