"""The table: rows in any order, torn rows, sorted once, the same in CSV and Parquet."""

import csv
import subprocess
import sys

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.report.sweep_figures import sweep_figures
from kc2spice.report.sweep_page import yields
from kc2spice.workflow.sweep.table import BAD, INTERRUPTED, MISSING, RowStore, columns, publish

KINDS = {"a": float, "word": str, "t": float, "caught": bool, "status": str}


def filled(path, order, size=6):
    store = RowStore(path, size)
    for index in order:
        failure = 'stopped, at "x"\n2' if index == 2 else None
        cells = (None, None) if failure else (index / 7.0, index % 2 == 0)
        store.record(index, (index * 0.1, "parallel", *cells), failure)
    store.close()
    return store


def test_rows_are_sorted_and_exact(tmp_path):
    store = filled(tmp_path / "j.sqlite", (4, 0, 2, 5, 1, 3))
    publish([store.path], tmp_path / "t.csv", list(KINDS), KINDS)
    rows = list(csv.DictReader((tmp_path / "t.csv").open(encoding="utf-8", newline="")))
    assert list(rows[0]) == list(KINDS)
    assert [float(row["a"]) for row in rows] == [index * 0.1 for index in range(6)]
    assert [row["t"] for row in rows if row["t"]] == [repr(i / 7.0) for i in (0, 1, 3, 4, 5)]
    assert [row["caught"] for row in rows] == ["true", "false", "", "false", "true", "false"]
    assert [row["status"] == "ok" for row in rows] == [True, True, False, True, True, True]
    assert rows[2]["status"].startswith("failed: stopped")


def test_order_of_arrival_leaves_no_trace(tmp_path):
    for name, order in (("a", range(6)), ("b", (5, 3, 1, 4, 2, 0))):
        store = filled(tmp_path / f"{name}.j", order)
        publish([store.path], tmp_path / f"{name}.csv", list(KINDS), KINDS)
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_rows_survive_a_process_that_is_killed(tmp_path):
    """A writer that ends without closing anything leaves whole rows, all of them."""
    path = tmp_path / "j.sqlite"
    code = (
        "import os\nfrom pathlib import Path\n"
        "from kc2spice.workflow.sweep.table import RowStore\n"
        f"store = RowStore(Path({str(path)!r}), 6)\n"
        "for k in range(4): store.record(k, (0.1 * k, None), 'no' if k == 2 else None)\n"
        "os.kill(os.getpid(), 9)\n"
    )
    assert subprocess.run([sys.executable, "-c", code]).returncode == -9
    store = RowStore(path, 6)
    assert list(np.flatnonzero(store.state == MISSING)) == [4, 5]
    assert [row[-1] for row in store.rows()] == ["ok", "ok", "failed: no", "ok"]
    assert store.failed == 1
    store.close()


def test_interrupted_points_are_missing_again_and_failed_ones_if_asked(tmp_path):
    store = RowStore(tmp_path / "j.sqlite", 3)
    store.record(0, (1.0,), None)
    store.record(1, (None,), "did not converge")
    store.record(2, (None,), "killed", interrupted=True)
    store.close()
    store = RowStore(tmp_path / "j.sqlite", 3)
    store.forget(INTERRUPTED)
    assert list(np.flatnonzero(store.state == MISSING)) == [2]
    store.forget(BAD)
    assert list(np.flatnonzero(store.state == MISSING)) == [1, 2]
    store.record(2, (5.0,), None)
    assert list(store.rows())[2] == ["5.0", "ok"]
    store.close()


def test_two_sweeps_do_not_write_one_table(tmp_path):
    store = RowStore(tmp_path / "j.sqlite", 3)
    with pytest.raises(UsageError, match="another sweep"):
        RowStore(tmp_path / "j.sqlite", 3)
    store.close()
    RowStore(tmp_path / "j.sqlite", 3).close()


def test_rows_of_several_parts_make_one_table(tmp_path):
    whole = filled(tmp_path / "whole.j", range(6))
    parts = [filled(tmp_path / f"{k}.j", order) for k, order in enumerate(((5, 1), (0, 2, 3, 4)))]
    publish([whole.path], tmp_path / "a.csv", list(KINDS), KINDS)
    publish([part.path for part in parts], tmp_path / "b.csv", list(KINDS), KINDS)
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_parquet_holds_the_same_columns(tmp_path):
    pytest.importorskip("pyarrow")
    store = filled(tmp_path / "j.sqlite", range(6))
    tables = [tmp_path / "t.csv", tmp_path / "t.parquet"]
    for path in tables:
        publish([store.path], path, list(KINDS), KINDS)
    first, second = (columns(path, KINDS) for path in tables)
    for name in KINDS:
        np.testing.assert_array_equal(first[name], second[name])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["j.sqlite", "t.csv", "t.parquet"]


def test_yield_has_the_exact_binomial_interval():
    # Clopper-Pearson for 8 of 10 at 95 %: 0.4439 … 0.9748 (tabulated, e.g. Altman 1991).
    data = {"caught": np.array([1.0] * 8 + [0.0, np.nan])}
    found = yields(data, ["caught"])["caught"]
    assert found["share"] == 0.8
    assert found["low"] == pytest.approx(0.4439, abs=5e-5)
    assert found["high"] == pytest.approx(0.9748, abs=5e-5)


def grid(*axes):
    return [mesh.ravel() for mesh in np.meshgrid(*axes, indexing="ij")]


@pytest.mark.parametrize(
    ("keys", "random", "expected"),
    [
        (1, (), {"sweep_curves.png"}),
        (2, (), {"sweep_map_settling_time_s.png", "sweep_map_caught.png"}),
        (3, (), {"sweep_scatter.png"}),
        (2, ("k0", "k1"), {"sweep_histograms.png", "sweep_scatter.png"}),
    ],
)
def test_figures_are_chosen_by_what_was_swept(tmp_path, keys, random, expected):
    values = grid(*[np.linspace(1.0, 2.0, 4)] * keys)
    data = {f"k{i}": column for i, column in enumerate(values)}
    data |= {"settling_time_s": values[0] * 1e-3, "caught": np.ones(values[0].size)}
    data["settling_time_s"][0] = np.nan
    names = [name for name in data if name.startswith("k")]
    pictures = sweep_figures(tmp_path, data, names, ["settling_time_s", "caught"], random, {})
    assert {picture.path.name for picture in pictures} == expected
    assert all(picture.path.read_bytes()[:4] == b"\x89PNG" for picture in pictures)


def test_nothing_stays_beside_the_rows(tmp_path):
    filled(tmp_path / "j.sqlite", range(6))
    assert [path.name for path in tmp_path.iterdir()] == ["j.sqlite"]
