"""``reduce`` from the command line: names, and models that are refused before they are reduced."""

import json

import numpy as np
import pytest
from scipy import sparse
from typer.testing import CliRunner

from kc2spice.cli.main import app
from kc2spice.workflow import reduce as workflow


def chain(n):
    K = 1e6 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    return {"M": 1e-2 * np.eye(n), "K": K, "E": 1e-6 * K, "B": np.eye(n)[:, [0]]}


def run(*words):
    return CliRunner().invoke(app, ["reduce", *map(str, words)])


def test_a_name_stands_for_the_one_file_that_holds_its_matrices(tmp_path):
    np.savez(tmp_path / "rod.npz", **chain(10))
    (tmp_path / "rod.toml").write_text("band = [0, 500]\n")
    done = run(tmp_path / "rod", "--json", "--out", tmp_path / "out")
    assert done.exit_code == 0, done.output
    record = json.loads(done.stdout)
    assert record["unknowns"] == 10
    assert record["band_hz"] == [0.0, 500.0]
    (tmp_path / "rod.op4").write_text("")
    done = run(tmp_path / "rod", "--out", tmp_path / "out")
    assert done.exit_code == 2
    assert "rod.npz, rod.op4" in done.output


@pytest.mark.parametrize("name", ["q3", "sum1", "inner_a", "tick"])
def test_names_of_inner_nodes_are_refused_before_the_reduction(tmp_path, monkeypatch, name):
    np.savez(tmp_path / "rod.npz", **chain(10))
    (tmp_path / "rod.toml").write_text(
        f'[[ports]]\nname = "{name}"\nkind = "mechanical"\ncolumn = 1\n'
    )

    def late(*_, **__):
        raise AssertionError("reduced first")

    monkeypatch.setattr(workflow, "reduce_model", late)
    done = run(tmp_path / "rod.npz", "--out", tmp_path / "out")
    assert done.exit_code == 2, done.output
    assert name in done.output


def test_an_unstable_sparse_descriptor_ends_at_once(tmp_path, monkeypatch):
    """700 states, a tenth of them algebraic, one of which grows."""
    n, m = 630, 70
    rates = -np.geomspace(1e2, 1e6, n)
    rates[300] = 50.0
    link = sparse.random_array((n, m), density=0.01, rng=np.random.default_rng(1))
    A = sparse.block_array(
        [[sparse.diags_array(rates), link], [-link.T, -sparse.eye_array(m)]], format="csc"
    )
    E = sparse.diags_array(np.r_[np.ones(n), np.zeros(m)], format="csc")
    parts = {"B": np.ones((n + m, 1)), "C": np.ones((1, n + m))}
    for letter, P in (("A", A), ("E", E)):
        rows = sparse.coo_array(P)
        parts |= {
            f"{letter}.data": rows.data, f"{letter}.row": rows.row, f"{letter}.col": rows.col,
            f"{letter}.shape": np.array(P.shape), f"{letter}.format": np.array("coo"),
        }  # fmt: skip
    np.savez(tmp_path / "net.npz", **parts)

    def late(*_, **__):
        raise AssertionError("reduced first")

    monkeypatch.setattr(workflow, "reduce_model", late)
    done = run(tmp_path / "net.npz", "--band", 0, 1e4, "--out", tmp_path / "out")
    assert done.exit_code == 4, done.output
    assert "unstable" in done.output
    assert not (tmp_path / "out").exists()
