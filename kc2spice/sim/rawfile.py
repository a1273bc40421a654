"""Reads ngspice's binary raw files and distrusts them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from kc2spice.core.errors import SimulationError

_BINARY = b"Binary:\n"
_NEXT = b"Title:"
_HEAD = 1 << 20  # bytes in which the header must end


class _Plot(NamedTuple):
    """Names of the vectors, points as promised, the complete ones of the file as rows of a map of
    it, and bytes left over."""

    names: tuple[str, ...]
    promised: int
    table: np.ndarray
    left: int

    @property
    def finite(self) -> np.ndarray:
        """Which rows are; of the scale, the first column, only the real part counts: ngspice leaves
        the imaginary part of a frequency to what its stack holds."""
        return np.isfinite(self.table[:, 0].real) & np.isfinite(self.table[:, 1:]).all(axis=1)

    def columns(self, points: int) -> dict[str, np.ndarray]:
        """Vectors of the first ``points``, the scale real."""
        rows = self.table[:points]
        columns = (rows[:, 0].real, *rows[:, 1:].T)
        return {n: np.array(column) for n, column in zip(self.names, columns, strict=True)}


def read_raw(path: Path) -> dict[str, np.ndarray]:
    """Vectors of the one plot in ``path``, lower-case names, the scale (always real) first.

    Raises
    ------
    SimulationError : missing, empty, truncated, with more data than promised, or not finite.
    """
    if not path.is_file():
        raise SimulationError("the simulator wrote no raw file", where=str(path))
    plot = _plot(path)
    if plot is None:
        raise _corrupt(path, "its header is cut off")
    held = len(plot.table)
    if held < 1 or (held, plot.left) != (plot.promised, 0):
        what = f"it promises {plot.promised} points and holds {held} and {plot.left} bytes"
        raise _corrupt(path, what)
    if not plot.finite.all():
        raise _corrupt(path, "it holds values that are not finite")
    return plot.columns(held)


def read_partial(path: Path) -> dict[str, np.ndarray] | None:
    """What an aborted run wrote: its complete points up to the first that is not finite.

    None where there are fewer than two.
    """
    try:
        plot = _plot(path)
    except (OSError, SimulationError):
        return None
    good = int(np.argmin(np.append(plot.finite, False))) if plot else 0
    return plot.columns(good) if plot and good > 1 else None


def last_scale_value(path: Path) -> float | None:
    """Scale (time) of the last complete point while ngspice still writes; None before the first."""
    plot = _plot(path) if path.is_file() else None
    return float(plot.table[-1, 0].real) if plot and len(plot.table) else None


def _plot(path: Path) -> _Plot | None:
    """The first plot in ``path``; None as long as its header is not complete.

    Raises
    ------
    SimulationError : the text is not the header of a binary raw file.
    """
    with path.open("rb") as stream:
        head = stream.read(_HEAD)
    end = head.find(_BINARY)
    if end < 0:
        return None
    lines = head[:end].decode("utf-8", "replace").splitlines()
    fields = dict(line.split(":", 1) for line in lines if ":" in line and not line[:1].isspace())
    try:
        count, promised = int(fields["No. Variables"]), int(fields["No. Points"])
        start = next(i for i, line in enumerate(lines) if line.startswith("Variables:"))
        names = tuple(line.split()[1].lower() for line in lines[start + 1 : start + 1 + count])
    except (KeyError, ValueError, IndexError, StopIteration):
        raise _corrupt(path, "its header is not that of a binary raw file") from None
    if len(names) != count or count < 1:
        raise _corrupt(path, f"its header promises {count} vectors and names {len(names)}")
    kind = np.dtype(np.complex128 if "complex" in fields.get("Flags", "") else np.float64)
    offset = end + len(_BINARY)
    held, left = divmod(path.stat().st_size - offset, kind.itemsize * count)
    if held >= promised > 0 and _follows(path, offset + promised * kind.itemsize * count):
        held, left = promised, 0
    table = np.memmap(path, kind, "r", offset, (held, count)) if held else np.empty((0, count))
    return _Plot(names, promised, table, left)


def _follows(path: Path, offset: int) -> bool:
    """Whether another plot begins there, as that of totals does behind a noise spectrum."""
    with path.open("rb") as stream:
        stream.seek(offset)
        return stream.read(len(_NEXT)) == _NEXT


def _corrupt(path: Path, what: str) -> SimulationError:
    return SimulationError(f"the raw file is not complete: {what}", where=str(path))
