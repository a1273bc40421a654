"""The table of a sweep: a journal that takes rows in any order, then one sorted file."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import MissingToolError, UsageError

OK = "ok"
FAILED = "failed: "
FORMATS = ("csv", "parquet")


class Journal:
    """Rows ``point, cells...`` appended as they come; each is complete or not there at all.

    ``done`` (points,) tells which rows are recorded, ``failed`` how many of them failed.

    Raises
    ------
    UsageError : another process writes to it, or a row in it is none of ours.
    """

    def __init__(self, path: Path, points: int) -> None:
        self.path = path
        self.done = np.zeros(points, dtype=bool)
        self.failed = 0
        path.parent.mkdir(parents=True, exist_ok=True)
        if path.exists() and not path.is_file():
            raise UsageError("is no file", where=str(path), hint="remove it")
        self._file = path.open("a+b")
        _lock(self._file, path)
        self._drop_torn_row()
        try:
            for index, failed in _entries(path, points):
                self.failed += failed and not self.done[index]
                self.done[index] = True
        except UsageError:
            self.close()
            raise

    def record(self, index: int, cells: Iterable[Any], failure: str | None) -> None:
        """Append one row; it survives the end of this process."""
        status = OK if failure is None else FAILED + " ".join(failure.split())
        self._file.write(_line([index, *map(_cell, cells), status]))
        self._file.flush()
        self.done[index] = True
        self.failed += failure is not None

    def close(self) -> None:
        """Let go of the file."""
        self._file.close()

    def _drop_torn_row(self) -> None:
        """A process that was killed while it wrote left a row without its end."""
        size = end = self._file.seek(0, os.SEEK_END)
        while end > 0:
            start = max(0, end - 4096)
            self._file.seek(start)
            found = self._file.read(end - start).rfind(b"\n")
            if found >= 0:
                end = start + found + 1
                break
            end = start
        if end < size:
            self._file.truncate(end)
        self._file.seek(0, os.SEEK_END)


def _lock(file: Any, path: Path) -> None:
    try:
        import fcntl
    except ImportError:
        return
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        file.close()
        hint = "wait for it, or choose another --out"
        raise UsageError("another sweep writes here now", where=str(path), hint=hint) from None


def _line(cells: Sequence[Any]) -> bytes:
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerow(cells)
    return buffer.getvalue().encode()


def _cell(value: Any) -> str:
    """Floats with all their digits, ``true`` and ``false``, nothing for None."""
    if value is None:
        return ""
    if isinstance(value, bool):
        return "true" if value else "false"
    return repr(value) if isinstance(value, float) else str(value)


def _entries(path: Path, points: int) -> Iterator[tuple[int, bool]]:
    with path.open(encoding="utf-8", newline="") as file:
        try:
            for row in csv.reader(file):
                if not row or not row[0].isdecimal() or not 0 <= int(row[0]) < points:
                    raise ValueError(f"row {','.join(row)[:80]!r}")
                if row[-1] != OK and not row[-1].startswith(FAILED):
                    raise ValueError(f"status {row[-1][:80]!r}")
                yield int(row[0]), row[-1] != OK
        except (ValueError, csv.Error) as error:
            raise UsageError(
                "is damaged: not the rows of this sweep", where=str(path), got=str(error),
                hint="remove it: what it held is run again",
            ) from None  # fmt: skip


def publish(journals: Sequence[Path], path: Path, header: Sequence[str], kinds: Kinds) -> None:
    """Write all rows, sorted by point, under ``header`` to ``path``; it appears whole.

    Raises
    ------
    MissingToolError : a Parquet file is asked for and pyarrow is not installed.
    """
    place = np.array(list(_places(journals)), dtype=np.int64).reshape(-1, 3)
    order = np.argsort(place[:, 0], kind="stable")
    partial = path.with_name(path.name + ".part")
    files = [journal.open("rb") for journal in journals]
    try:
        with partial.open("wb") as out:
            out.write(_line(header))
            last = -1
            for point, source, offset in place[order]:
                if point != last:
                    files[source].seek(offset)
                    out.write(files[source].readline().partition(b",")[2])
                last = point
    finally:
        for file in files:
            file.close()
    if path.suffix == ".parquet":
        _to_parquet(partial, kinds)
    os.replace(partial, path)


Kinds = Mapping[str, type]  # of the columns: float, int, bool or str


def _places(journals: Sequence[Path]) -> Iterator[tuple[int, int, int]]:
    """Point, journal and offset of every row."""
    for source, journal in enumerate(journals):
        offset = 0
        with journal.open("rb") as file:
            for line in file:
                yield int(line.partition(b",")[0]), source, offset
                offset += len(line)


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
