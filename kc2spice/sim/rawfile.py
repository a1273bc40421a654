"""Reads ngspice's binary raw files and distrusts them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from kc2spice.core.errors import SimulationError

_BINARY = b"Binary:\n"
_HEAD = 1 << 20  # bytes in which the header must end


@dataclass(frozen=True)
class RawHeader:
    """What stands before the numbers: vectors in order, points as written, offset of the data."""

    plot: str
    is_complex: bool
    names: tuple[str, ...]
    points: int
    offset: int

    @property
    def record(self) -> int:
        """Bytes of one point."""
        return len(self.names) * (16 if self.is_complex else 8)


def read_header(path: Path) -> RawHeader | None:
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
    is_complex = "complex" in fields.get("Flags", "")
    return RawHeader(
        fields.get("Plotname", "").strip(), is_complex, names, points, end + len(_BINARY)
    )


def read_raw(path: Path) -> dict[str, np.ndarray]:
    """Vectors of the one plot in ``path``, lower-case names, the scale (always real) first.

    Raises
    ------
    SimulationError : missing, empty, truncated, with more data than promised, or not finite.
    """
    if not path.is_file():
        raise SimulationError("the simulator wrote no raw file", where=str(path))
    header = read_header(path)
    if header is None:
        raise _corrupt(path, "its header is cut off")
    body = _body(path, header)
    expected = header.points * header.record
    if header.points < 1 or len(body) != expected:
        raise _corrupt(
            path, f"it promises {header.points} points ({expected} bytes) and holds {len(body)}"
        )
    table = _table(header, body)
    if not _finite(table).all():
        raise _corrupt(path, "it holds values that are not finite")
    return _columns(header, table)


def read_partial(path: Path) -> dict[str, np.ndarray] | None:
    """What an aborted run wrote: its complete points up to the first that is not finite.

    None where there are fewer than two.
    """
    try:
        header = read_header(path)
    except (OSError, SimulationError):
        return None
    if header is None:
        return None
    body = _body(path, header)
    table = _table(header, body[: len(body) // header.record * header.record])
    good = int(np.argmin(np.append(_finite(table), False)))
    return _columns(header, table[:good]) if good > 1 else None


def _body(path: Path, header: RawHeader) -> bytes:
    with path.open("rb") as stream:
        stream.seek(header.offset)
        return stream.read()


def _table(header: RawHeader, body: bytes) -> np.ndarray:
    """One row a point."""
    kind = np.complex128 if header.is_complex else np.float64
    return np.frombuffer(body, dtype=kind).reshape(-1, len(header.names))


def _finite(table: np.ndarray) -> np.ndarray:
    """Which rows are finite; of the scale, the first column, only the real part counts."""
    # ngspice leaves the imaginary part of an .ac run's frequency to what its stack holds.
    return np.isfinite(table[:, 0].real) & np.isfinite(table[:, 1:]).all(axis=1)


def _columns(header: RawHeader, table: np.ndarray) -> dict[str, np.ndarray]:
    columns = (table[:, 0].real, *table[:, 1:].T)
    return {name: column.copy() for name, column in zip(header.names, columns, strict=True)}


def last_scale_value(path: Path) -> float | None:
    """Scale (time) of the last complete point while ngspice still writes; None before the first."""
    if not path.is_file():
        return None
    header = read_header(path)
    if header is None:
        return None
    points = (path.stat().st_size - header.offset) // header.record
    if points < 1:
        return None
    with path.open("rb") as stream:
        stream.seek(header.offset + (points - 1) * header.record)
        return float(np.frombuffer(stream.read(8), dtype=np.float64)[0])


def _corrupt(path: Path, what: str) -> SimulationError:
    return SimulationError(f"the raw file is not complete: {what}", where=str(path))
