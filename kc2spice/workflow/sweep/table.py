"""The rows of a sweep: a database that takes them in any order, then one sorted table."""

from __future__ import annotations

import csv
import json
import sqlite3
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from kc2spice.core.errors import UsageError, needed, unknown
from kc2spice.scene.load import toml
from kc2spice.workflow.sweep.plan import Plan
from kc2spice.workflow.sweep.point import Outcome

OK = "ok"
_OPEN = """
pragma trusted_schema = off;
pragma locking_mode = exclusive;  -- another process that writes here is refused at once
pragma journal_mode = delete;
pragma synchronous = off;         -- a row survives the end of this process, which is enough
begin exclusive;
create table if not exists sweep (digest text);
create table if not exists row (point integer primary key, outcome text);
commit;
"""
_OUTCOME = TypeAdapter(Outcome)


class RowStore:
    """``outcomes`` by point, and an SQLite file where each is complete or not there at all.

    ``digest`` is that of the sweep; ``failed`` are the points that have no numbers.

    Raises
    ------
    UsageError : another process writes to it, it holds another sweep or something else than rows.
    """

    def __init__(self, path: Path, points: int, digest: str) -> None:
        self.path, self.outcomes, self.failed = path, dict[int, Outcome](), set[int]()
        if path.is_symlink() or (path.exists() and not path.is_file()):
            raise UsageError("is no file of a sweep", where=str(path), hint="remove it")
        try:
            self._rows = sqlite3.connect(path, timeout=0.0, isolation_level=None)
            self._rows.executescript(_OPEN)
            (held,) = self._rows.execute("select digest from sweep").fetchone() or (None,)
            if held is None:
                self._rows.execute("insert into sweep values (?)", (digest,))
            for point, text in self._rows.execute("select * from row") if held == digest else ():
                if point not in range(points):
                    raise ValueError(f"point {str(point)[:80]!r}")
                self._keep(point, _OUTCOME.validate_json(text, strict=True))
        except (sqlite3.Error, ValueError) as error:
            hint = "remove it: what it held is run again"
            message = "is damaged or cannot be written: not the rows of this sweep"
            if "locked" in str(error):
                message, hint = "another sweep writes here now", "wait for it, or choose another"
            got = str(error).splitlines()[0][:200]
            raise UsageError(message, where=str(path), got=got, hint=hint) from None
        if held not in (None, digest):
            raise UsageError(
                "holds another sweep",
                where=str(path.parent),
                got=f"plan {held}"[:80],
                expected=f"plan {digest}",
                hint="choose another --out, or remove the old one",
            )

    def record(self, point: int, outcome: Outcome) -> None:
        """Write one row in place of an earlier one of the same point.

        Raises
        ------
        UsageError : the disk is full, or the file cannot be written.
        """
        row = (point, json.dumps(asdict(outcome)))
        try:
            self._rows.execute("insert or replace into row values (?, ?)", row)
        except sqlite3.Error as error:
            hint = "the rows so far are kept: make room and give the same command again"
            message = f"cannot be written: {error}"
            raise UsageError(message, where=str(self.path), hint=hint) from None
        self._keep(point, outcome)

    def _keep(self, point: int, outcome: Outcome) -> None:
        self.outcomes[point] = outcome
        (self.failed.discard if outcome.failure is None else self.failed.add)(point)

    def close(self) -> None:
        """Let go of the file."""
        self._rows.close()


def require_columns(outcome: Outcome, wanted: Sequence[str], scene: str) -> None:
    """Raise UsageError if a run of ``scene`` has no such numbers, or none at all to tabulate."""
    known = {**outcome.metrics, **outcome.facts}
    for name in wanted:
        if name not in known:
            raise unknown("the result has no such number", name, known, "--metric")
    if not wanted and not outcome.metrics:
        raise UsageError(
            "nothing to tabulate: every metric is a curve",
            where=scene,
            expected="a scene with metrics that are numbers, or with [probes]",
            hint="'kc2spice run' writes the curve of one point; --set works there too",
        )


def columns(
    outcomes: Mapping[int, Outcome], plan: Plan, wanted: Sequence[str] = ()
) -> dict[str, list[Any]]:
    """The table: swept keys, ``wanted`` numbers (or every metric that a run has), ``status``.

    A point without a number has None there.
    """
    rows = sorted(outcomes.items())
    names = wanted or dict.fromkeys(name for _, each in rows for name in each.metrics)
    table: dict[str, list[Any]] = {name: [] for name in (*plan.keys, *names, "status")}
    for point, outcome in rows:
        numbers = {**outcome.facts, **outcome.metrics}
        found = {name: numbers.get(name) for name in names} | plan.values(point)
        why = outcome.failure
        found["status"] = OK if why is None else f"failed: {' '.join(why.split())}"
        for name, value in found.items():
            table[name].append(value)
    return table


def write_csv(table: Mapping[str, Sequence[Any]], path: Path) -> None:
    """Floats with all their digits, ``true`` and ``false``, nothing for None."""
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(table)
        for row in zip(*table.values(), strict=True):
            writer.writerow([v if v is None or isinstance(v, str) else toml(v) for v in row])


def write_parquet(table: Mapping[str, Sequence[Any]], path: Path) -> None:
    """The same table, numbers as such."""
    parquet = needed("pyarrow.parquet", "pyarrow", "--format", "parquet")
    import pyarrow as arrow

    empty = {name for name, column in table.items() if all(value is None for value in column)}
    kinds = {name: arrow.float64() if name in empty else None for name in table}
    arrays = {name: arrow.array(column, kinds[name]) for name, column in table.items()}
    parquet.write_table(arrow.table(arrays), path)


WRITERS = {"csv": write_csv, "parquet": write_parquet}
