"""The table of a sweep: a database that takes rows in any order, then one sorted file."""

from __future__ import annotations

import csv
import heapq
import io
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import MissingToolError, UsageError

OK = "ok"
FAILED = "failed: "
FORMATS = ("csv", "parquet")
MISSING, GOOD, BAD, INTERRUPTED = -1, 0, 1, 2  # states of a point

_OPEN = """
pragma trusted_schema = off;
pragma locking_mode = exclusive;  -- another process that writes here is refused at once
pragma journal_mode = delete;
pragma synchronous = off;         -- a row survives the end of this process, which is enough
begin exclusive;
create table if not exists row (point integer primary key, state integer, line text);
commit;
"""

Kinds = Mapping[str, type]  # of the columns: float, int, bool or str


class RowStore:
    """Rows by point in an SQLite file; each is complete or not there at all.

    ``state`` (points,) is ``MISSING``, ``GOOD``, ``BAD`` (failed by itself) or ``INTERRUPTED``
    (failed for what happened to the machine: worth another try).

    Raises
    ------
    UsageError : another process writes to it, or it holds something else than our rows.
    """

    def __init__(self, path: Path, points: int) -> None:
        self.path = path
        self.state = np.full(points, MISSING, dtype=np.int8)
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and not path.is_file():
            raise UsageError("is no file", where=str(path), hint="remove it")
        self._rows = sqlite3.connect(path, timeout=0.0, isolation_level=None)
        try:
            self._rows.executescript(_OPEN)
            for point, state, line in self._rows.execute("select point, state, line from row"):
                self.state[_checked(point, points)] = _agreed(state, line)
        except (sqlite3.Error, ValueError) as error:
            self._rows.close()
            if "locked" in str(error):
                raise UsageError(
                    "another sweep writes here now", where=str(path),
                    hint="wait for it, or choose another --out",
                ) from None  # fmt: skip
            raise UsageError(
                "is damaged: not the rows of this sweep", where=str(path), got=str(error)[:200],
                hint="remove it: what it held is run again",
            ) from None  # fmt: skip

    @property
    def failed(self) -> int:
        """How many recorded points have failed."""
        return int((self.state > GOOD).sum())

    def record(
        self, point: int, cells: Iterable[Any], failure: str | None, *, interrupted: bool = False
    ) -> None:
        """Write one row in place of an earlier one of the same point."""
        status = OK if failure is None else FAILED + " ".join(failure.split())
        state = GOOD if failure is None else INTERRUPTED if interrupted else BAD
        row = (point, state, _line([*map(_cell, cells), status]))
        self._rows.execute("insert or replace into row values (?, ?, ?)", row)
        self.state[point] = state

    def forget(self, *states: int) -> None:
        """Make the points in these states missing again; their rows stay until they are run."""
        self.state[np.isin(self.state, states)] = MISSING

    def rows(self) -> Iterator[list[str]]:
        """Cells of all rows in the order of their points, the status last."""
        lines = self._rows.execute("select line from row order by point")
        return csv.reader(line for (line,) in lines)

    def close(self) -> None:
        """Let go of the file."""
        self._rows.close()


def _checked(point: Any, points: int) -> int:
    if not isinstance(point, int) or not 0 <= point < points:
        raise ValueError(f"point {str(point)[:80]!r}")
    return point


def _agreed(state: Any, line: Any) -> int:
    """The state of a row whose line says the same."""
    if not isinstance(line, str) or state not in (GOOD, BAD, INTERRUPTED):
        raise ValueError(f"row {str(line)[:80]!r}")
    cells = next(csv.reader([line]), None) or [""]
    if (cells[-1] == OK) is not (state == GOOD) or not cells[-1].startswith((OK, FAILED)):
        raise ValueError(f"status {cells[-1][:80]!r}")
    return int(state)


def _line(cells: Sequence[Any]) -> str:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerow(cells)
    return buffer.getvalue()


def _cell(value: Any) -> str:
    """Floats with all their digits, ``true`` and ``false``, nothing for None."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def publish(stores: Sequence[Path], path: Path, header: Sequence[str], kinds: Kinds) -> None:
    """Write all rows, sorted by point, under ``header`` to ``path``; it appears whole.

    Raises
    ------
    MissingToolError : a Parquet file is asked for and pyarrow is not installed.
    """
    partial, last = path.with_name(path.name + ".part"), MISSING
    with partial.open("w", encoding="utf-8", newline="") as out:
        out.write(_line(header))
        for point, line in heapq.merge(*map(_sorted_lines, stores)):
            if point != last:
                out.write(line)
            last = point
    if path.suffix == ".parquet":
        _to_parquet(partial, kinds)
    os.replace(partial, path)


def _sorted_lines(store: Path) -> Iterator[tuple[int, str]]:
    with closing(sqlite3.connect(store)) as rows:
        yield from rows.execute("select point, line from row order by point")


def need_parquet() -> Any:
    """The modules ``pyarrow.csv`` and ``pyarrow.parquet``.

    Raises
    ------
    MissingToolError : they are not installed.
    """
    try:
        from pyarrow import csv as arrow_csv
        from pyarrow import parquet
    except ImportError:
        hint = "pip install pyarrow, or --format csv"
        raise MissingToolError("pyarrow is not installed", where="--format", hint=hint) from None
    return arrow_csv, parquet


def _to_parquet(path: Path, kinds: Kinds) -> None:
    """Replace the CSV file ``path`` by the same table in Parquet, block by block."""
    arrow_csv, parquet = need_parquet()
    names = {float: "float64", int: "int64", bool: "bool", str: "string"}
    convert = arrow_csv.ConvertOptions(
        column_types={name: names[kind] for name, kind in kinds.items()}, null_values=[""],
        true_values=["true"], false_values=["false"],
    )  # fmt: skip
    partial = path.with_name(path.name + ".parquet")
    with (
        arrow_csv.open_csv(path, convert_options=convert) as reader,
        parquet.ParquetWriter(partial, reader.schema) as writer,
    ):
        for batch in reader:
            writer.write_batch(batch)
    os.replace(partial, path)


def columns(path: Path, kinds: Kinds) -> dict[str, np.ndarray]:
    """Columns of a finished table: floats with nan for empty cells, words as they are."""
    if path.suffix == ".parquet":
        _, parquet = need_parquet()
        table = parquet.read_table(path)
        found = {name: table[name].to_pylist() for name in kinds}
        return {name: _array(kind, found[name]) for name, kind in kinds.items()}
    cells: dict[str, list[Any]] = {name: [] for name in kinds}
    with path.open(encoding="utf-8", newline="") as file:
        for row in csv.DictReader(file):
            for name, kind in kinds.items():
                cells[name].append(row[name] if kind is str else _parsed(row[name]))
    return {name: _array(kind, cells[name]) for name, kind in kinds.items()}


def _parsed(text: str) -> float | None:
    words = {"": None, "true": 1.0, "false": 0.0}
    return words[text] if text in words else float(text)


def _array(kind: type, values: list[Any]) -> np.ndarray:
    return np.array(values, dtype=str if kind is str else float)
