"""The table: rows in any order, torn rows, sorted once, the same in CSV and Parquet."""

import csv

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.report.sweep_figures import sweep_figures
from kc2spice.report.sweep_page import yields
from kc2spice.workflow.sweep.table import Journal, columns, publish

KINDS = {"a": float, "word": str, "t": float, "caught": bool, "status": str}


def filled(path, order, size=6):
    journal = Journal(path, size)
    for index in order:
        failure = 'stopped, at "x"\n2' if index == 2 else None
        cells = (None, None) if failure else (index / 7.0, index % 2 == 0)
        journal.record(index, (index * 0.1, "parallel", *cells), failure)
    journal.close()
    return journal


def test_rows_are_sorted_and_exact(tmp_path):
    journal = filled(tmp_path / "j.csv", (4, 0, 2, 5, 1, 3))
    publish([journal.path], tmp_path / "t.csv", list(KINDS), KINDS)
    rows = list(csv.DictReader((tmp_path / "t.csv").open(encoding="utf-8", newline="")))
    assert list(rows[0]) == list(KINDS)
    assert [float(row["a"]) for row in rows] == [index * 0.1 for index in range(6)]
    assert [row["t"] for row in rows if row["t"]] == [repr(i / 7.0) for i in (0, 1, 3, 4, 5)]
    assert [row["caught"] for row in rows] == ["true", "false", "", "false", "true", "false"]
    assert [row["status"] == "ok" for row in rows] == [True, True, False, True, True, True]
    assert rows[2]["status"].startswith("failed: stopped")


def test_order_of_arrival_leaves_no_trace(tmp_path):
    for name, order in (("a", range(6)), ("b", (5, 3, 1, 4, 2, 0))):
        journal = filled(tmp_path / f"{name}.j", order)
        publish([journal.path], tmp_path / f"{name}.csv", list(KINDS), KINDS)
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


@pytest.mark.parametrize("keep", [0.5, 0.95])
def test_a_torn_row_is_run_again_and_no_other(tmp_path, keep):
    path = tmp_path / "j.csv"
    filled(path, range(6))
    whole = path.read_bytes()
    start = whole.rstrip(b"\n").rfind(b"\n") + 1
    path.write_bytes(whole[: start + int(keep * (len(whole) - start))])
    journal = Journal(path, 6)
    assert list(np.flatnonzero(~journal.done)) == [5]
    assert journal.failed == 1
    journal.record(5, (0.5, "parallel", 5 / 7.0, False), None)
    journal.close()
    assert path.read_bytes() == whole


def test_two_sweeps_do_not_write_one_table(tmp_path):
    journal = Journal(tmp_path / "j.csv", 3)
    with pytest.raises(UsageError, match="another sweep"):
        Journal(tmp_path / "j.csv", 3)
    journal.close()
    Journal(tmp_path / "j.csv", 3).close()


def test_rows_of_several_parts_make_one_table(tmp_path):
    whole = filled(tmp_path / "whole.j", range(6))
    parts = [filled(tmp_path / f"{k}.j", order) for k, order in enumerate(((5, 1), (0, 2, 3, 4)))]
    publish([whole.path], tmp_path / "a.csv", list(KINDS), KINDS)
    publish([part.path for part in parts], tmp_path / "b.csv", list(KINDS), KINDS)
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_parquet_holds_the_same_columns(tmp_path):
    pytest.importorskip("pyarrow")
    journal = filled(tmp_path / "j.csv", range(6))
    tables = [tmp_path / "t.csv", tmp_path / "t.parquet"]
    for path in tables:
        publish([journal.path], path, list(KINDS), KINDS)
    first, second = (columns(path, KINDS) for path in tables)
    for name in KINDS:
        np.testing.assert_array_equal(first[name], second[name])
    assert sorted(p.name for p in tmp_path.iterdir()) == ["j.csv", "t.csv", "t.parquet"]


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
