"""The rows of a sweep and what is made of them: whole or not there, sorted, exact, drawn."""

import contextlib
import csv
import sqlite3

import numpy as np
import pytest
from support import (
    PointResult,
    RowStore,
    UsageError,
    _plot_histogram,
    collect_columns,
    compute_yields,
    make_plan,
    write_csv,
)

PLAN = make_plan({"a": tuple(0.1 * k for k in range(6))})


def outcome(index):
    if index == 2:
        return PointResult(failure='stopped, at "x"\n2')
    metrics = {"t": index / 7.0, "caught": index % 2 == 0, "never": None}
    return PointResult(metrics, {"rom.order": float(index)})


@contextlib.contextmanager
def opened(path, points=6, digest="d"):
    store = RowStore(path, points, digest)
    try:
        yield store
    finally:
        store.close()


def filled(path, order=range(6)):
    with opened(path) as store:
        for index in order:
            store.write_row(index, outcome(index))
        return collect_columns(store.outcomes, PLAN)


def test_rows_are_sorted_and_exact(tmp_path):
    table = filled(tmp_path / "rows", (4, 0, 2, 5, 1, 3))
    write_csv(table, tmp_path / "t.csv")
    rows = list(csv.DictReader((tmp_path / "t.csv").open(encoding="utf-8", newline="")))
    assert list(rows[0]) == ["a", "t", "caught", "never", "status"]
    assert [float(row["a"]) for row in rows] == [0.1 * index for index in range(6)]
    assert [row["t"] for row in rows if row["t"]] == [repr(i / 7.0) for i in (0, 1, 3, 4, 5)]
    assert [row["caught"] for row in rows] == ["true", "false", "", "false", "true", "false"]
    assert [row["status"] for row in rows] == ["ok"] * 2 + ['failed: stopped, at "x" 2'] + [
        "ok"
    ] * 3


def test_rows_are_there_again_and_the_last_of_a_point_counts(tmp_path):
    with opened(tmp_path / "rows", 3) as store:
        store.write_row(0, PointResult({"x": 1.0}))
        store.write_row(2, PointResult(failure="killed", interrupted=True))
    with opened(tmp_path / "rows", 3) as store:
        assert store.outcomes[0].metrics == {"x": 1.0}
        assert store.outcomes[2].interrupted
        assert store.failed == {2}
        store.write_row(2, PointResult({"x": 5.0}))
        assert not store.failed
    with opened(tmp_path / "rows", 3) as store:
        assert store.outcomes[2].metrics == {"x": 5.0}


def test_two_sweeps_do_not_write_one_table(tmp_path):
    with opened(tmp_path / "rows"), pytest.raises(UsageError, match="another sweep"):
        RowStore(tmp_path / "rows", 6, "d")
    with opened(tmp_path / "rows"):
        pass
    # The caught error keeps the rejected store alive; its lock must be gone all the same.
    with pytest.raises(UsageError, match="results of another sweep") as caught:
        RowStore(tmp_path / "rows", 6, "other")
    with opened(tmp_path / "rows"):
        pass
    assert caught.value.exit_code == 2


GOOD = '{"metrics": {"x": 1.0}, "facts": {}, "failure": null, "interrupted": false}'


@pytest.mark.parametrize(
    "row",
    [
        (-1, GOOD), (99, GOOD), (0, ""), (0, None), (0, "3"), (0, b"\xff"), (0, GOOD[:-1]),
        (0, GOOD.replace("1.0", '"1.0"')), (0, GOOD.replace("1.0", "[1.0]")),
        (0, GOOD.replace("null", "3")),
        (0, "[" * 100_000),
    ],
)  # fmt: skip
def test_damaged_rows_are_named(row, tmp_path):
    path = tmp_path / "rows.sqlite"
    RowStore(path, 2, "d").close()
    with contextlib.closing(sqlite3.connect(path)) as rows, rows:
        rows.execute("insert into row values (?, ?)", row)
    with pytest.raises(UsageError, match=r"rows\.sqlite") as caught:
        RowStore(path, 2, "d")
    assert caught.value.exit_code == 2
    assert "damaged, or is not the results file" in caught.value.message
    if row[0]:
        expected = f"the row belongs to point '{row[0]}', but the points of the sweep are numbered "
        assert caught.value.got == expected + "0 to 1"


@pytest.mark.parametrize(
    "cause",
    ["attempt to write a readonly database", "unable to open database file", "disk I/O error"],
)
def test_a_file_that_cannot_be_written_is_not_called_damaged(cause, tmp_path, monkeypatch):
    def refuse(*args, **kwargs):
        raise sqlite3.OperationalError(cause)

    monkeypatch.setattr(sqlite3, "connect", refuse)
    with pytest.raises(UsageError, match="this file cannot be written") as caught:
        RowStore(tmp_path / "rows", 2, "d")
    assert caught.value.got == cause


def test_yield_has_the_exact_binomial_interval():
    # Clopper-Pearson for 8 of 10 at 95 %: 0.4439 … 0.9748 (tabulated, e.g. Altman 1991).
    table = {"k": [1.0] * 10, "caught": [True] * 8 + [False, None], "flag": [None] * 10}
    found = compute_yields(table, ["k"])
    assert list(found) == ["caught"]
    assert found["caught"]["share"] == 0.8
    assert found["caught"]["low"] == pytest.approx(0.4439, abs=5e-5)
    assert found["caught"]["high"] == pytest.approx(0.9748, abs=5e-5)


@pytest.mark.parametrize("text", ["=1+1", "+1", "-1+1", "@SUM(A1)", "\t=1"])
def test_no_cell_of_a_table_is_a_formula(text, tmp_path):
    """Names of probes and causes of failures are text that somebody else may have chosen."""
    write_csv({text: [1.5], "status": [text]}, tmp_path / "t.csv")
    with (tmp_path / "t.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.reader(file))
    assert rows == [[f"'{text}", "status"], ["1.5", f"'{text}"]]


def test_values_that_differ_by_rounding_have_one_bar():
    """Numpy refuses more bins than there are numbers between the least and the largest value."""
    values = 6300.0 + np.spacing(6300.0) * np.array([0.0, 1.0, 0.0, 1.0, 2.0])
    (bars,) = _plot_histogram(("resonance [Hz]", values)).curves
    assert bars.y.tolist() == [5.0]
