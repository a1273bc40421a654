"""``reduce`` from the command line: names, and models that are refused before they are reduced."""

import json
import re

import numpy as np
import pytest
from scipy import sparse
from support import LinearModel, app, explain_instability
from support import reduce_files as workflow
from typer.testing import CliRunner


def chain(n):
    K = 1e6 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    return {"M": 1e-2 * np.eye(n), "K": K, "E": 1e-6 * K, "B": np.eye(n)[:, [0]]}


def run(*words):
    return CliRunner().invoke(app, ["reduce", *map(str, words)])


def test_a_name_finds_the_only_file_with_its_matrices(tmp_path):
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


def save_sparse(path, **matrices):
    """An archive of the parts of sparse matrices and of arrays."""
    parts = {}
    for letter, P in matrices.items():
        if isinstance(P, np.ndarray):
            parts[letter] = P
            continue
        rows = sparse.coo_array(P)
        parts |= {
            f"{letter}.data": rows.data, f"{letter}.row": rows.row, f"{letter}.col": rows.col,
            f"{letter}.shape": np.array(P.shape), f"{letter}.format": np.array("coo"),
        }  # fmt: skip
    np.savez(path, **parts)


def membrane(side):
    """Stiffness of a square net of springs whose edge is held."""
    row = 2 * np.eye(side) - np.eye(side, k=1) - np.eye(side, k=-1)
    one = sparse.eye_array(side)
    return sparse.csc_array(1e6 * (sparse.kron(row, one) + sparse.kron(one, row)))


def large(kind, side=30):
    """Matrices of 1800 first-order states, stable or with one fault."""
    K, n = membrane(side), side**2
    at = sparse.csc_array(([1.0], ([400], [400])), shape=(n, n))
    E, B = 1e-5 * K, np.eye(n)[:, [5]]
    skew = sparse.csc_array(([1.0, -1.0], ([7, 9], [9, 7])), shape=(n, n))
    E = E + 1e-3 * skew
    mass = 1e-2 * sparse.eye_array(n, format="csc")
    if kind == "first order":  # x and x' over 1e4/s, one rate with the wrong sign
        speed = 1e4 * sparse.eye_array(n)
        A = sparse.block_array([[None, speed], [-1e-2 * K, -1e-3 * K + 4e4 * at]], format="csc")
        return {"A": A, "B": np.vstack([0 * B, B]), "C": np.hstack([0 * B.T, B.T])}
    if kind == "none":  # circulatory forces that damping holds
        K = K + 1e3 * skew
    if kind == "stiffness":
        K = K - 9e6 * at
    if kind == "damping":
        E = E - 2e3 * at
    return {"M": mass, "E": E if kind != "stiffness" else 1e-5 * K, "K": K, "B": B}


def rightmost(parts):
    """Largest real part of all poles [1/s], from numpy."""
    if "A" in parts:
        return np.linalg.eigvals(parts["A"].toarray()).real.max()
    M, E, K = (parts[letter].toarray() for letter in "MEK")
    n, over = len(M), np.linalg.inv(M)
    return np.linalg.eigvals(np.block([[np.zeros((n, n)), np.eye(n)],
                                       [-over @ K, -over @ E]])).real.max()  # fmt: skip


@pytest.mark.parametrize("kind", ["stiffness", "damping", "first order"])
def test_a_large_unstable_model_ends_before_its_reduction(tmp_path, monkeypatch, kind):
    parts = large(kind)
    assert rightmost(large(kind, 21)) > 1  # the same fault in a smaller net
    save_sparse(tmp_path / "net.npz", **parts)

    def late(*_, **__):
        raise AssertionError("reduced first")

    monkeypatch.setattr(workflow, "reduce_model", late)
    done = run(tmp_path / "net.npz", "--band", 0, 300, "--out", tmp_path / "out")
    assert done.exit_code == 4, done.output
    assert "unstable" in done.output
    assert ("negative" in done.output) is (kind == "stiffness")
    assert not (tmp_path / "out").exists()


def test_a_large_stable_model_is_not_taken_for_unstable():
    parts = large("none")
    assert rightmost(large("none", 21)) < 0
    assert explain_instability(LinearModel(**parts).pencil, (0.0, 300.0)) is None


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
    save_sparse(tmp_path / "net.npz", A=A, E=E, B=np.ones((n + m, 1)), C=np.ones((1, n + m)))

    def late(*_, **__):
        raise AssertionError("reduced first")

    monkeypatch.setattr(workflow, "reduce_model", late)
    done = run(tmp_path / "net.npz", "--band", 0, 1e4, "--out", tmp_path / "out")
    assert done.exit_code == 4, done.output
    assert "unstable" in done.output
    assert not (tmp_path / "out").exists()


def test_the_table_states_the_order_of_the_given_equations_and_of_the_states(tmp_path):
    np.savez(tmp_path / "rod.npz", **chain(10))
    options = "--band", 0, 500, "--norm", "peak", "--tolerance", 1e-2, "--out", tmp_path / "out"
    method = "--method", "balanced truncation"
    done = run(tmp_path / "rod", *options, *method)
    assert done.exit_code == 0, done.output
    assert re.search(r"equations +10, second order", done.output)
    assert re.search(r"states +\d+, first order", done.output)
    done = run(tmp_path / "rod", *options, *method, "--json")
    record = json.loads(done.output)
    assert (record["full_form"], record["form"]) == ("second order", "first order")


def test_an_unknown_method_lists_five_methods(tmp_path):
    np.savez(tmp_path / "rod.npz", **chain(10))
    done = run(tmp_path / "rod", "--method", "truncation of modes", "--out", tmp_path / "out")
    assert done.exit_code == 2
    text = " ".join(done.output.split())
    assert "--method: this reduction method does not exist" in text
    assert "balanced truncation" in text
    assert "in all: kc2spice reduce MODEL --method compare)" in text
    done = run(tmp_path / "rod", "--method", "modal truncation", "--out", tmp_path / "out")
    text = " ".join(done.output.split())
    assert "did you mean 'balanced truncation'? For your own method, install its package" in text
