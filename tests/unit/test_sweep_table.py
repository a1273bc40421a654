"""The rows of a sweep and what is made of them: whole or not there, sorted, exact, drawn."""

import contextlib
import csv
import sqlite3
import threading
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from support import (
    MissingToolError,
    PointResult,
    RowStore,
    UsageError,
    _plot_histogram,
    collect_columns,
    compute_yields,
    make_plan,
    sweep_execution,
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


# --- a sweep that ends early ----------------------------------------------------------------------

LAMP = """
name = "lamp"
[drive]
part = "source"
dc = "12 V"
[lamp]
part = "resistor"
resistance = "6 Ohm"
pins = { a = "drive.out" }
[analysis]
type = "op"
[probes]
current_a = { of = "lamp.i" }
"""


def end_early(monkeypatch, folder, run_point, metrics=(), points=20):
    """Run a sweep on two threads until its error; return the error and the stored rows."""
    path = folder / "lamp.toml"
    path.write_text(LAMP)
    ranges = [f"lamp.resistance=1:{points}:{points}"]
    sweep = sweep_execution.load_named_sweep(str(path), ranges, metrics=metrics)
    monkeypatch.setattr(sweep_execution, "run_point", run_point)
    out = folder / "out"
    with ThreadPoolExecutor(2) as pool, pytest.raises((UsageError, MissingToolError)) as caught:
        sweep_execution.run_sweep(sweep, out, lambda: contextlib.nullcontext((pool, 2)))
    with opened(out / sweep_execution.ROWS_FILE, points, sweep.digest) as store:
        return caught.value, sorted(store.outcomes)


@pytest.mark.parametrize("cause", ["unknown metric", "missing tool"])
def test_points_that_run_at_an_error_are_stored(monkeypatch, tmp_path, cause):
    """The first point ends the sweep while the second point runs: the second point is kept."""
    begun, ended = threading.Event(), threading.Event()

    def run_point(job, values):
        if values["lamp.resistance"] == 1.0:
            assert begun.wait(30)
            ended.set()
            if cause == "missing tool":
                raise MissingToolError("ngspice is missing")
        else:
            begun.set()
            assert ended.wait(30)
            time.sleep(0.2)
        return PointResult({"current_a": 12.0 / values["lamp.resistance"]})

    metrics = ("currant_a",) if cause == "unknown metric" else ()
    error, stored = end_early(monkeypatch, tmp_path, run_point, metrics)
    assert isinstance(error, MissingToolError if cause == "missing tool" else UsageError)
    assert 1 in stored
    assert (0 in stored) == (cause == "unknown metric")
    assert len(stored) < 6  # no further point begins


def test_a_lost_point_states_the_cause_and_the_next_action():
    """A repeated sweep runs the point again, and fewer workers need less memory."""
    assert sweep_execution.LOST_POINT.interrupted
    assert "memory" in sweep_execution.LOST_POINT.failure
    assert "repeat the sweep with fewer workers" in sweep_execution.LOST_POINT.failure
