"""Rows of a sweep: storage in a database, and output as a CSV or Parquet table."""

from __future__ import annotations

import csv
import json
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict
from itertools import chain
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from kc2spice.core.errors import UsageError, unknown
from kc2spice.core.files import create_parent_folders
from kc2spice.core.optional_libraries import import_optional
from kc2spice.core.toml_text import format_toml
from kc2spice.core.waveforms import quote_csv_cell
from kc2spice.workflow.sweep.grid import SweepPoints
from kc2spice.workflow.sweep.point import PointResult

OK_STATUS = "ok"
_OPEN_STATEMENTS = """
pragma trusted_schema = off;
pragma locking_mode = exclusive;  -- another process that writes here is refused at once
pragma journal_mode = delete;
pragma synchronous = off;         -- a row survives the end of this process, which is enough
begin exclusive;
create table if not exists sweep (digest text);
create table if not exists row (point integer primary key, outcome text);
commit;
"""
# words in the messages of SQLite about a file that cannot be written
_WRITE_FAILURES = ("readonly", "unable to open", "is full", "I/O error")
_OUTCOME_ADAPTER = TypeAdapter(PointResult)
# Suffixes of table formats that kc2spice does not write. Tables with the suffix .parquet are
# written as Parquet. Tables with any suffix that is not listed here are written as CSV.
_OTHER_TABLE_FORMATS = (
    ".xlsx", ".xls", ".xlsm", ".ods", ".json", ".html", ".tsv", ".h5", ".hdf5", ".feather", ".pkl",
    ".npy", ".npz", ".mat",
)  # fmt: skip


class RowStore:
    """Store of the results of sweep points in an SQLite file.

    Each row is complete or missing. ``digest`` is the hash of all inputs of the sweep. ``failed``
    are the points whose run failed.

    Raises
    ------
    UsageError : another process writes to the database, or the database contains another sweep or
        other data.
    """

    def __init__(self, path: Path, points: int, digest: str) -> None:
        self.path, self.outcomes, self.failed = path, dict[int, PointResult](), set[int]()
        self._new_folder = not path.exists() and not any(path.parent.iterdir())
        if path.is_symlink() or (path.exists() and not path.is_file()):
            raise UsageError(
                "this file is not a results file of a sweep",
                where=str(path),
                hint="choose another --out",
            )
        try:
            self._rows = sqlite3.connect(path, timeout=0.0, isolation_level=None)
        except sqlite3.Error as error:
            raise self._make_unusable_file_error(error) from None
        try:
            self._lock_and_read_rows(points, digest)
        except (sqlite3.Error, ValueError) as error:
            self.close()
            raise self._make_unusable_file_error(error) from None
        except BaseException:
            self.close()  # an open connection would lock the file against the next sweep
            raise

    def _lock_and_read_rows(self, points: int, digest: str) -> None:
        """Lock the file, and read its rows if they belong to the sweep with this ``digest``."""
        self._rows.executescript(_OPEN_STATEMENTS)
        (stored,) = self._rows.execute("select digest from sweep").fetchone() or (None,)
        if stored is None:
            self._rows.execute("insert into sweep values (?)", (digest,))
        elif stored != digest:
            raise UsageError(
                "this directory contains the results of another sweep",
                where=str(self.path.parent),
                got="results of another scene, or of other keys, values or options",
                expected="a new directory, or the directory of the same sweep",
                hint="choose another --out, or delete this directory",
            )
        for point, text in self._rows.execute("select * from row"):
            if point not in range(points):
                raise ValueError(
                    f"the row belongs to point {str(point)[:80]!r}, "
                    f"but the points of the sweep are numbered 0 to {points - 1}"
                )
            self._store_outcome(point, _OUTCOME_ADAPTER.validate_json(text, strict=True))

    def _make_unusable_file_error(self, error: sqlite3.Error | ValueError) -> UsageError:
        """Return the error for an unusable file, which SQLite or the row reader rejects."""
        message = "this file is damaged, or is not the results file of this sweep"
        hint = "delete this file; the sweep then computes its points again"
        if "locked" in str(error):
            message = "another sweep is writing to this directory"
            hint = "wait until the other sweep ends, or choose another --out"
        elif any(cause in str(error) for cause in _WRITE_FAILURES):
            message = "this file cannot be written"
            hint = "check the permissions and the free space of the directory"
        got = str(error).splitlines()[0][:200]
        return UsageError(message, where=str(self.path), got=got, hint=hint)

    def write_row(self, point: int, outcome: PointResult) -> None:
        """Write the result of one point, in place of an earlier result of the point.

        Raises
        ------
        UsageError : the disk is full, or the file cannot be written.
        """
        row = (point, json.dumps(asdict(outcome)))
        try:
            self._rows.execute("insert or replace into row values (?, ?)", row)
        except sqlite3.Error as error:
            raise UsageError(
                f"this file cannot be written: {error}",
                where=str(self.path),
                hint="free disk space, then repeat the command; the rows written before are kept",
            ) from None
        self._store_outcome(point, outcome)

    def _store_outcome(self, point: int, outcome: PointResult) -> None:
        """Store the result of a point in memory, and update the set of failed points."""
        self.outcomes[point] = outcome
        (self.failed.discard if outcome.failure is None else self.failed.add)(point)

    def close(self) -> None:
        """Close the SQLite file of the store."""
        self._rows.close()

    @contextmanager
    def remove_empty_file_on_error(self) -> Iterator[None]:
        """After an error, remove a file without rows, and a new folder that contains it."""
        try:
            yield
        except BaseException:
            if not self.outcomes:
                self.close()
                with suppress(OSError):
                    self.path.unlink()
                    if self._new_folder:
                        self.path.parent.rmdir()
            raise


def require_columns(outcome: PointResult, names: Sequence[str], scene: str) -> None:
    """Raise an error if a run lacks the numbers for the columns of a sweep table.

    Each of the metrics ``names`` must exist; without ``names``, at least one metric must exist.
    """
    known = {**outcome.metrics, **outcome.facts}
    for name in names:
        if name not in known:
            raise unknown("the result has no number with this name", name, known, "--metric")
    if not names and not outcome.metrics:
        raise UsageError(
            "this scene has no metric that is a number, so the table of the sweep is empty",
            where=scene,
            expected="a scene with metrics that are numbers, or with [probes]",
            hint="use kc2spice run with --set to compute the curves at one point of the sweep",
        )


def collect_columns(
    outcomes: Mapping[int, PointResult], plan: SweepPoints, metrics: Sequence[str] = ()
) -> dict[str, list[Any]]:
    """Return the columns of a sweep table: swept keys, metrics and status.

    By default, the table contains all metrics of the runs. A missing number is None.
    """
    rows = sorted(outcomes.items())
    names = metrics or dict.fromkeys(chain.from_iterable(item.metrics for _, item in rows))
    table: dict[str, list[Any]] = {name: [] for name in (*plan.keys, *names, "status")}
    for point, outcome in rows:
        numbers = {**outcome.facts, **outcome.metrics}
        result = {name: numbers.get(name) for name in names} | plan.values(point)
        why = outcome.failure
        result["status"] = OK_STATUS if why is None else f"failed: {' '.join(why.split())}"
        for name, value in result.items():
            table[name].append(value)
    return table


def write_csv(table: Mapping[str, Sequence[Any]], path: Path) -> None:
    """Write a table as CSV, with all digits of floats.

    Booleans become ``true`` and ``false``, and None becomes an empty cell. An apostrophe is added
    before text that a spreadsheet would evaluate as a formula.
    """
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(map(quote_csv_cell, table))
        for row in zip(*table.values(), strict=True):
            writer.writerow(map(_format_csv_cell, row))


def _format_csv_cell(value: Any) -> str | None:
    """Return a value as the text of a CSV cell."""
    if isinstance(value, str):
        return quote_csv_cell(value)
    return None if value is None else format_toml(value)


def save_table(table: Mapping[str, Sequence[Any]], path: str | Path) -> Path:
    """Write a table as Parquet if the path ends in ``.parquet``, otherwise as CSV.

    Raises
    ------
    UsageError : the suffix of the path is the suffix of another table format, or the file cannot be
        written.
    MissingToolError : the format is Parquet, and pyarrow is not installed.
    """
    with create_parent_folders(path) as file:
        suffix = file.suffix.lower()
        if suffix in _OTHER_TABLE_FORMATS:
            raise UsageError(
                f"a table cannot be saved in the format {suffix}",
                where="path",
                got=repr(str(path)),
                expected="a name that ends in .csv or .parquet",
                hint=f'write "{file.with_suffix(".csv")}", which spreadsheet programs open',
            )
        if suffix == ".parquet":
            write_parquet(table, file, "save")
        else:
            write_csv(table, file)
    return file


def write_parquet(table: Mapping[str, Sequence[Any]], path: Path, where: str = "--format") -> None:
    """Write a table as Parquet, which keeps the types of the numbers.

    ``where`` is the option or method that needs pyarrow, for the error if it is not installed.
    """
    arrow = import_optional("pyarrow", where)
    parquet = import_optional("pyarrow.parquet", where)

    empty = {name for name, column in table.items() if all(value is None for value in column)}
    kinds = {name: arrow.float64() if name in empty else None for name in table}
    arrays = {name: arrow.array(column, kinds[name]) for name, column in table.items()}
    parquet.write_table(arrow.table(arrays), path)
