"""Models from files: three formats give one model, bad ones one clear error, ROMs come back."""

import json

import numpy as np
import pytest
from scipy import io, sparse
from support import (
    LinearModel,
    UsageError,
    list_dialect_names,
    read_model,
    read_rom,
    reduce_model,
    write_rom,
)

N = 12


def chain():
    K = 2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
    return {"M": np.eye(N), "E": 0.05 * K, "K": K, "B": np.eye(N)[:, [0, 5]]}


def rod():
    parts = chain()
    return {"A": -parts["K"], "B": parts["B"], "C": np.eye(N)[[3]], "E": 2.0 * parts["M"]}


def saved(folder, matrices, form="dense"):
    """Path of a file that holds square matrices in this form."""
    path = folder / ("model.mat" if form == "mat" else "model.npz")
    if form == "dense":
        np.savez(path, **matrices)
        return path
    squares = {k: sparse.csc_array(matrices[k]) for k in "AEKM" if k in matrices}
    if form == "mat":
        io.savemat(path, {**matrices, **squares})
        return path
    parts = {k: matrices[k] for k in "BC" if k in matrices}
    inner = ("row", "col") if form == "coo" else ("indices", "indptr")
    for letter, matrix in squares.items():
        matrix = matrix.asformat(form)
        parts |= {f"{letter}.{part}": getattr(matrix, part) for part in ("shape", "data", *inner)}
        parts[f"{letter}.format"] = np.array(form)
    np.savez(path, **parts)
    return path


@pytest.mark.parametrize("form", ["mat", "csc", "csr", "coo", "dense"])
@pytest.mark.parametrize("matrices", [chain, rod])
def test_formats_give_the_same_model(tmp_path, form, matrices):
    expected = matrices()
    model = read_model(saved(tmp_path, expected, form))
    for name in ("A", "E") if "A" in expected else ("K", "E", "M"):
        assert np.array_equal(getattr(model, name).toarray(), expected[name])
    assert np.array_equal(model.B, expected["B"])
    assert np.array_equal(model.C, expected.get("C", expected["B"].T))
    assert model.name == "model"


@pytest.mark.parametrize("make", [chain, rod])
@pytest.mark.parametrize("kind", ["npz", "json"])
def test_reduced_models_come_back_to_the_bit(tmp_path, make, kind):
    model = read_model(saved(tmp_path, make()))
    reduced = reduce_model(model, band=(0.0, 0.1), tolerance=1e-5)
    write_rom(reduced, tmp_path, "back")
    found = read_rom(tmp_path / f"back.{kind}")
    assert isinstance(found, LinearModel)
    assert (found.ports, found.certificate) == (reduced.ports, reduced.certificate)
    for letter in ("E", "B", "C", "D", "A" if make is rod else "M"):
        assert np.array_equal(getattr(found, letter), getattr(reduced, letter))


def test_objects_are_never_unpickled(tmp_path):
    class Trap:
        def __reduce__(self):
            return (pytest.fail, ("the file's code was run",))

    np.savez(tmp_path / "model.npz", **chain() | {"K": np.array([[Trap()]], dtype=object)})
    with pytest.raises(UsageError, match="cannot be read"):
        read_model(tmp_path / "model.npz")
    io.savemat(tmp_path / "model.mat", {**chain(), "K": {"a": 1}})
    with pytest.raises(UsageError, match="struct"):
        read_model(tmp_path / "model.mat")


def test_models_beyond_memory_are_refused_before_work(tmp_path, monkeypatch):
    model = read_model(saved(tmp_path, chain()))
    monkeypatch.setattr("kc2spice.linalg.factor.find_available_bytes", lambda: 1000.0)
    with pytest.raises(UsageError, match="needs more memory"):
        reduce_model(model, band=(0.0, 0.1), tolerance=1e-3)


def test_command_line_reduces_and_exports(tmp_path, cli):
    base = saved(tmp_path, chain())
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
    for dialect in list_dialect_names()[1:]:
        other = ["export", "--rom", found["rom"], "-o", str(tmp_path / dialect), "--json"]
        ran = cli(*other, "--dialect", dialect)
        assert ran.exit_code == 0, ran.output
        written = json.loads(ran.stdout)["files"]
        assert ("model_rom.va" if dialect == "verilog-a" else "model_rom.lib") in written
    text = (out / "model_rom.lib").read_text()
    assert "* @pin 1 u1 unit=- flow=-\n" in text
    assert f"order={found['order']}" in text


def test_reduction_is_printed_with_one_fact_per_row(tmp_path, cli):
    """Errors are ratios as in ``--tolerance``, and each fact about the method has its own row."""
    base = saved(tmp_path, chain())
    ran = cli("reduce", str(base), "-o", "out", "--tolerance", "1e-5", "--band", "0", "0.1")
    assert ran.exit_code == 0, ran.output
    lines = [" ".join(line.split()) for line in ran.stdout.splitlines()]
    assert lines[0] == "Reduced model"
    assert "band 0 Hz to 100 mHz" in lines
    (estimate,) = (line for line in lines if line.startswith("error estimate "))
    ratio, words = estimate.removeprefix("error estimate ").split(" of ", 1)
    assert float(ratio) <= 1e-5
    assert words == "the largest response in the band"
    assert "%" not in ran.stdout
    assert any(line.startswith("method ") for line in lines)
    begin = next(
        k for k, line in enumerate(lines) if line.startswith("error check difference from")
    )
    assert any(line.startswith("stability from") for line in lines[begin + 1 :])


def test_directory_of_a_reduced_model_leads_to_its_file(tmp_path, cli):
    base = saved(tmp_path, chain())
    assert cli("reduce", str(base), "-o", "out", "--band", "0", "0.1", "--quiet").exit_code == 0
    ran = cli("export", "--rom", "out")
    assert ran.exit_code == 2
    advice = ran.stderr.partition("next:")[2].split()
    assert advice[0] == "write"
    assert cli("export", "--rom", advice[1], "--quiet").exit_code == 0


def test_command_line_writes_nothing_on_bad_input(tmp_path, cli):
    base = saved(tmp_path, chain() | {"K": np.full((N, N), np.nan)})
    before = sorted(tmp_path.iterdir())
    ran = cli("reduce", str(base), "-o", str(tmp_path / "out"))
    assert ran.exit_code == 2
    assert "model.npz" in ran.stderr
    assert sorted(tmp_path.iterdir()) == before
    for options in (["--tolerance", "1e-3", "--order", "3"], ["--band", "2", "1"],
                    ["--tolerance", "0"], ["--order", "0"]):  # fmt: skip
        saved(tmp_path, chain())
        ran = cli("reduce", str(base), "-o", str(tmp_path / "out"), *options)
        assert ran.exit_code == 2, ran.output
        assert not (tmp_path / "out").exists()
