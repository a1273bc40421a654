"""Reads ngspice's binary raw files and distrusts them."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np

from kc2spice.core.errors import SimulationError

_BINARY = b"Binary:\n"
_HEAD = 1 << 20  # bytes in which the header must end


class _Header(NamedTuple):
    """Vectors in order, type of the numbers, points as promised, offset [bytes] of the data."""

    names: tuple[str, ...]
    kind: np.dtype
    points: int
    offset: int

    def held(self, path: Path) -> tuple[int, int]:
        """Complete points in the file, and bytes left over."""
        return divmod(path.stat().st_size - self.offset, self.kind.itemsize * len(self.names))


def read_raw(path: Path) -> dict[str, np.ndarray]:
    """Vectors of the one plot in ``path``, lower-case names, the scale (always real) first.

    Raises
    ------
    SimulationError : missing, empty, truncated, with more data than promised, or not finite.
    """
    if not path.is_file():
        raise SimulationError("the simulator wrote no raw file", where=str(path))
    header = _header(path)
    if header is None:
        raise _corrupt(path, "its header is cut off")
    held, left = header.held(path)
    if held < 1 or (held, left) != (header.points, 0):
        raise _corrupt(
            path, f"it promises {header.points} points and holds {held} and {left} bytes"
        )
    table = _table(path, header, held)
    if not _finite(table).all():
        raise _corrupt(path, "it holds values that are not finite")
    return _columns(header, table)


def read_partial(path: Path) -> dict[str, np.ndarray] | None:
    """What an aborted run wrote: its complete points up to the first that is not finite.

    None where there are fewer than two.
    """
    try:
        header = _header(path)
    except (OSError, SimulationError):
        return None
    if header is None:
        return None
    table = _table(path, header, header.held(path)[0])
    good = int(np.argmin(np.append(_finite(table), False)))
    return _columns(header, table[:good]) if good > 1 else None


def last_scale_value(path: Path) -> float | None:
    """Scale (time) of the last complete point while ngspice still writes; None before the first."""
    header = _header(path) if path.is_file() else None
    held = header.held(path)[0] if header else 0
    if header is None or held < 1:
        return None
    offset = header.offset + (held - 1) * header.kind.itemsize * len(header.names)
    return float(np.fromfile(path, np.float64, 1, offset=offset)[0])


def _header(path: Path) -> _Header | None:
    """Header of the first plot in ``path``; None as long as it is not complete.

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
        count, points = int(fields["No. Variables"]), int(fields["No. Points"])
        start = next(i for i, line in enumerate(lines) if line.startswith("Variables:"))
        names = tuple(line.split()[1].lower() for line in lines[start + 1 : start + 1 + count])
    except (KeyError, ValueError, IndexError, StopIteration):
        raise _corrupt(path, "its header is not that of a binary raw file") from None
    if len(names) != count or count < 1:
        raise _corrupt(path, f"its header promises {count} vectors and names {len(names)}")
    kind = np.dtype(np.complex128 if "complex" in fields.get("Flags", "") else np.float64)
    return _Header(names, kind, points, end + len(_BINARY))


def _table(path: Path, header: _Header, points: int) -> np.ndarray:
    """One row a point."""
    count = points * len(header.names)
    return np.fromfile(path, header.kind, count, offset=header.offset).reshape(points, -1)


def _finite(table: np.ndarray) -> np.ndarray:
    """Which rows are finite; of the scale, the first column, only the real part counts."""
    # ngspice leaves the imaginary part of an .ac run's frequency to what its stack holds.
    return np.isfinite(table[:, 0].real) & np.isfinite(table[:, 1:]).all(axis=1)


def _columns(header: _Header, table: np.ndarray) -> dict[str, np.ndarray]:
    columns = (table[:, 0].real, *table[:, 1:].T)
    return {name: column.copy() for name, column in zip(header.names, columns, strict=True)}


def _corrupt(path: Path, what: str) -> SimulationError:
    return SimulationError(f"the raw file is not complete: {what}", where=str(path))
