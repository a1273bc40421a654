"""Models from files: three formats give one model, bad ones one clear error, ROMs come back."""

import json

import numpy as np
import pytest
from scipy import io, sparse

from kc2spice.bodies.readers import read_model
from kc2spice.core.errors import UsageError
from kc2spice.rom.io import read_rom, write_rom
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduce import reduce as reduce_model

N = 12


def chain():
    K = sparse.diags_array([np.full(N, 2.0), np.full(N - 1, -1.0), np.full(N - 1, -1.0)],
                           offsets=[0, 1, -1], format="csc")  # fmt: skip
    B = np.zeros((N, 2))
    B[0, 0] = B[5, 1] = 1.0
    return {"M": sparse.eye_array(N, format="csc"), "E": 0.05 * K, "K": K, "B": B}


def rod():
    parts = chain()
    return {"A": -parts["K"], "B": parts["B"], "C": np.eye(N)[[3]], "E": 2.0 * parts["M"]}


def write_family(directory, matrices, name="model"):
    for letter, matrix in matrices.items():
        with (directory / f"{name}.{letter}").open("wb") as stream:
            io.mmwrite(stream, matrix, precision=17)
    return directory / name


def write_mat(directory, matrices):
    path = directory / "model.mat"
    io.savemat(path, {k: sparse.csc_matrix(v) if sparse.issparse(v) else v
                      for k, v in matrices.items()})  # fmt: skip
    return path


def write_npz(directory, matrices, form="csc"):
    path, parts = directory / "model.npz", {}
    for letter, matrix in matrices.items():
        if not sparse.issparse(matrix):
            parts[letter] = matrix
            continue
        matrix = matrix.asformat(form)
        inner = ("row", "col") if form == "coo" else ("indices", "indptr")
        parts |= {f"{letter}.{part}": getattr(matrix, part) for part in ("shape", "data", *inner)}
        parts[f"{letter}.format"] = np.array(form)
    np.savez(path, **parts)
    return path


WRITERS = {
    "market": write_family,
    "mat": write_mat,
    "csc": write_npz,
    "csr": lambda d, m: write_npz(d, m, "csr"),
    "coo": lambda d, m: write_npz(d, m, "coo"),
    "dense": lambda d, m: write_npz(
        d, {k: v.toarray() if sparse.issparse(v) else v for k, v in m.items()}
    ),
}


@pytest.mark.parametrize("writer", WRITERS)
@pytest.mark.parametrize("matrices", [chain, rod])
def test_formats_give_the_same_model(tmp_path, writer, matrices):
    expected = matrices()
    model = read_model(WRITERS[writer](tmp_path, expected))
    first = "A" in expected
    for name in ("A", "E") if first else ("K", "E", "M"):
        assert np.array_equal(getattr(model, name).toarray(), expected[name].toarray())
    assert np.array_equal(model.B, expected["B"])
    assert np.array_equal(model.C, expected.get("C", expected["B"].T))
    assert model.name == "model"


def test_ports_have_the_names_units_and_scale_of_the_table(tmp_path):
    base = write_family(tmp_path, rod())
    (tmp_path / "model.toml").write_text(
        'band = [0, 1.5]\n[[ports]]\nname = "q1"\nkind = "input"\ncolumn = 1\nunit = "mW"\n'
        'scale = 1e-3\n[[ports]]\nname = "q2"\nkind = "input"\ncolumn = 2\n'
        '[[ports]]\nname = "T"\nkind = "output"\nrow = 1\nunit = "K"\n'
    )
    model = read_model(base)
    assert [(p.name, p.across, p.flow) for p in model.ports] == [
        ("q1", "mW", "-"), ("q2", "-", "-"), ("T", "K", "-"),
    ]  # fmt: skip
    assert model.B[0, 0] == 1e-3
    assert model.band == (0.0, 1.5)


@pytest.mark.parametrize("make", [chain, rod])
@pytest.mark.parametrize("kind", ["npz", "json"])
def test_reduced_models_come_back_to_the_bit(tmp_path, make, kind):
    model = read_model(write_family(tmp_path, make()))
    reduced = reduce_model(model, band=(0.0, 0.1), tolerance=1e-5)
    write_rom(reduced, tmp_path, "back")
    found = read_rom(tmp_path / f"back.{kind}")
    assert isinstance(found, LinearModel)
    assert (found.ports, found.certificate) == (reduced.ports, reduced.certificate)
    for letter in ("E", "B", "C", "D", "A" if make is rod else "M"):
        assert np.array_equal(getattr(found, letter), getattr(reduced, letter))


def edited(letter, change):
    matrices = chain()
    matrices[letter] = change(matrices[letter])
    return matrices


def with_value(value):
    def change(matrix):
        matrix = matrix.astype(type(value)).tolil()
        matrix[2, 2] = value
        return matrix.tocsc()

    return change


def test_objects_are_never_unpickled(tmp_path):
    class Trap:
        def __reduce__(self):
            return (pytest.fail, ("the file's code was run",))

    arrays = {k: v.toarray() if sparse.issparse(v) else v for k, v in chain().items()}
    arrays["K"] = np.array([[Trap()]], dtype=object)
    np.savez(tmp_path / "model.npz", **arrays)
    with pytest.raises(UsageError, match="cannot be read"):
        read_model(tmp_path / "model.npz")
    io.savemat(tmp_path / "model.mat", {**chain(), "K": {"a": 1}})
    with pytest.raises(UsageError, match="struct"):
        read_model(tmp_path / "model.mat")


def test_models_beyond_memory_are_refused_before_work(tmp_path, monkeypatch):
    model = read_model(write_family(tmp_path, chain()))
    monkeypatch.setattr("kc2spice.linalg.factor.available_bytes", lambda: 1000.0)
    with pytest.raises(UsageError, match="too large"):
        reduce_model(model, band=(0.0, 0.1), tolerance=1e-3)


def test_command_line_reduces_and_exports(tmp_path, cli):
    base = write_family(tmp_path, chain())
    out = tmp_path / "out"
    ran = cli(
        "reduce", str(base), "-o", str(out), "--tolerance", "1e-5", "--band", "0", "0.1", "--json"
    )
    assert ran.exit_code == 0, ran.output
    found = json.loads(ran.stdout)
    assert found["error_estimate"] <= 1e-5
    assert found["stable"]
    assert found["passive"]
    ran = cli("export", "--rom", found["rom"], "-o", str(out), "--json")
    assert ran.exit_code == 0, ran.output
    for dialect in ("xyce", "ltspice", "verilog-a"):
        other = ["export", "--rom", found["rom"], "-o", str(tmp_path / dialect), "--json"]
        ran = cli(*other, "--dialect", dialect)
        assert ran.exit_code == 0, ran.output
        written = json.loads(ran.stdout)["files"]
        assert ("model_rom.va" if dialect == "verilog-a" else "model_rom.lib") in written
    text = (out / "model_rom.lib").read_text()
    assert "* @pin 1 u1 unit=- flow=-\n" in text
    assert f"order={found['order']}" in text


def test_command_line_writes_nothing_on_bad_input(tmp_path, cli):
    base = write_family(tmp_path, edited("K", with_value(np.nan)))
    before = sorted(tmp_path.iterdir())
    ran = cli("reduce", str(base), "-o", str(tmp_path / "out"))
    assert ran.exit_code == 2
    assert "model.K" in ran.stderr
    assert sorted(tmp_path.iterdir()) == before
    for options in (["--tolerance", "1e-3", "--order", "3"], ["--band", "2", "1"],
                    ["--tolerance", "0"], ["--order", "0"]):  # fmt: skip
        good = write_family(tmp_path, chain(), "good")
        ran = cli("reduce", str(good), "-o", str(tmp_path / "out"), *options)
        assert ran.exit_code == 2, ran.output
        assert not (tmp_path / "out").exists()
