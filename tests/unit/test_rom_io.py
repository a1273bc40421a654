"""Models from files: three formats give one model, bad ones one clear error, ROMs come back."""

import json
import zipfile

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy import io, sparse
from typer.testing import CliRunner

from kc2spice.bodies.readers import read_model
from kc2spice.cli.main import app
from kc2spice.core.errors import UsageError
from kc2spice.rom.io import read_rom, write_rom
from kc2spice.rom.linear import Certificate, LinearModel, Port
from kc2spice.rom.matrix_market import read_market
from kc2spice.rom.reduce import reduce as reduce_model
from kc2spice.workflow.reduce import export_rom, reduce

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
        'band = [0, 1.5]\n[[port]]\nname = "q1"\ndirection = "in"\nunit = "mW"\nscale = 1e-3\n'
        '[[port]]\nname = "q2"\ndirection = "in"\n'
        '[[port]]\nname = "T"\ndirection = "out"\nunit = "K"\n'
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


BAD_MODELS = {
    "NaN": (lambda: edited("K", with_value(np.nan)), "NaN"),
    "infinite": (lambda: edited("M", with_value(np.inf)), "NaN or infinity"),
    "complex": (lambda: edited("E", with_value(1j)), "complex"),
    "shape": (lambda: edited("M", lambda m: m[:5, :5]), "12 x 12|5 x 5"),
    "wide": (lambda: edited("B", lambda b: b.T), "does not fit"),
    "no mass": (lambda: {k: v for k, v in chain().items() if k in "KB"}, "complete"),
    "no input": (lambda: {k: v for k, v in chain().items() if k != "B"}, "complete"),
    "both orders": (lambda: {**chain(), "A": np.eye(N)}, "complete"),
    "no effect": (lambda: edited("B", lambda b: 0 * b), "no effective"),
}


@pytest.mark.parametrize("case", BAD_MODELS)
@pytest.mark.parametrize("writer", ["market", "csc"])
def test_bad_matrices_are_refused_by_name(tmp_path, case, writer):
    make, words = BAD_MODELS[case]
    path = WRITERS[writer](tmp_path, make())
    with pytest.raises(UsageError, match=words) as caught:
        read_model(path)
    assert str(tmp_path / "model") in str(caught.value)


def test_sizes_are_judged_before_memory_is_taken(tmp_path):
    write_family(tmp_path, chain())
    bomb = "%%MatrixMarket matrix array real general\n900000000 900000000\n1.0\n"
    (tmp_path / "model.K").write_text(bomb)
    with pytest.raises(UsageError, match="rows and columns"):
        read_model(tmp_path / "model")
    liar = "%%MatrixMarket matrix coordinate real general\n12 12 150000000\n1 1 1.0\n"
    (tmp_path / "model.K").write_text(liar)
    with pytest.raises(UsageError, match="cut off"):
        read_model(tmp_path / "model")


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


@pytest.mark.parametrize("writer", ["market", "csc"])
@settings(
    max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(data=st.data())
def test_damaged_files_give_one_clear_error(tmp_path, writer, data):
    path = WRITERS[writer](tmp_path, chain())
    victim = tmp_path / "model.K" if writer == "market" else path
    content = bytearray(victim.read_bytes())
    if data.draw(st.booleans()):
        content = content[: data.draw(st.integers(0, len(content) - 1))]
    else:
        for _ in range(data.draw(st.integers(1, 8))):
            content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    victim.write_bytes(content)
    try:
        model = read_model(path)  # some damage is a valid model, of other numbers
    except UsageError as error:
        assert str(victim) in str(error) or str(path) in str(error)
    else:
        assert all(np.isfinite(P.data).all() for P in (model.M, model.E, model.K))


@pytest.mark.parametrize(("place", "value"), [(300, None), (0, None), (128, 255), (165, 9)])
def test_damaged_matlab_files_do_not_crash_the_program(tmp_path, place, value):
    path = write_mat(tmp_path, chain())
    content = bytearray(path.read_bytes())
    if value is None:
        content = content[:place]
    else:
        content[place] = value
    path.write_bytes(content)
    with pytest.raises(UsageError, match=r"model\.mat"):
        read_model(path)


BAD_TABLES = {
    "not TOML": "port = [",
    "unknown key": "colour = 1",
    "no name": '[[port]]\ndirection = "in"',
    "bad direction": '[[port]]\nname = "a"\ndirection = "up"',
    "too few": '[[port]]\nname = "a"\ndirection = "in"',
    "twice": '[[port]]\nname = "a"\ndirection = "in"\n[[port]]\nname = "A"\ndirection = "out"',
    "bad scale": '[[port]]\nname = "a"\ndirection = "in"\nscale = -1.0',
    "card in unit": '[[port]]\nname = "a"\ndirection = "in"\nunit = "V\\n.control"',
    "bad band": "band = [5, 1]",
    "port is text": 'port = "a"',
}


@pytest.mark.parametrize("case", BAD_TABLES)
def test_bad_port_tables_are_refused(tmp_path, case):
    base = write_family(tmp_path, chain())
    (tmp_path / "model.toml").write_text(BAD_TABLES[case])
    with pytest.raises(UsageError, match=r"model\.toml"):
        read_model(base)


def test_damaged_reduced_models_are_refused(tmp_path):
    model = read_model(write_family(tmp_path, chain()))
    write_rom(reduce_model(model, band=(0.0, 0.1), order=4), tmp_path, "r")
    whole = (tmp_path / "r.npz").read_bytes()
    for size in (0, 10, len(whole) // 2, len(whole) - 1):
        (tmp_path / "cut.npz").write_bytes(whole[:size])
        with pytest.raises(UsageError, match=r"cut\.npz"):
            read_rom(tmp_path / "cut.npz")
    with pytest.raises(UsageError, match="not a reduced model"):
        read_rom(write_npz(tmp_path, chain()))
    with zipfile.ZipFile(tmp_path / "r.npz") as archive:
        assert "record.npy" in archive.namelist()


def test_command_line_reduces_and_exports(tmp_path):
    base = write_family(tmp_path, chain())
    out = tmp_path / "out"
    ran = CliRunner().invoke(app, ["reduce", str(base), "-o", str(out), "--tolerance", "1e-5",
                                   "--band", "0", "0.1", "--json"])  # fmt: skip
    assert ran.exit_code == 0, ran.output
    found = json.loads(ran.stdout)
    assert found["error_estimate"] <= 1e-5
    assert found["stable"]
    assert found["passive"]
    ran = CliRunner().invoke(app, ["export", "--rom", found["rom"], "-o", str(out), "--json"])
    assert ran.exit_code == 0, ran.output
    for dialect in ("xyce", "ltspice", "verilog-a"):
        other = ["export", "--rom", found["rom"], "-o", str(tmp_path / dialect), "--json"]
        ran = CliRunner().invoke(app, [*other, "--dialect", dialect])
        assert ran.exit_code == 0, ran.output
        written = json.loads(ran.stdout)["files"]
        assert ("model_rom.va" if dialect == "verilog-a" else "model_rom.lib") in written
    text = (out / "model_rom.lib").read_text()
    assert "* @pin 1 u1 unit=- flow=-\n" in text
    assert f"order={found['order']}" in text


def test_conservative_ports_become_conservative_pins(tmp_path):
    base = write_family(tmp_path, chain())
    port = '[[port]]\nname = "{}"\ndirection = "both"\nkind = "mechanical"\n'
    (tmp_path / "model.toml").write_text("band = [0, 0.1]\n" + port.format("a") + port.format("b"))
    found = reduce(base, tmp_path / "out")
    export_rom(found["rom"], tmp_path / "out")
    text = (tmp_path / "out" / "model_rom.lib").read_text()
    assert "* @pin 1 a unit=um flow=N\n* @pin 2 b unit=um flow=N\n" in text
    (tmp_path / "other.toml").write_text((tmp_path / "model.toml").read_text())
    other = write_family(tmp_path, rod(), "other")
    with pytest.raises(UsageError, match="conservative"):
        reduce(other, tmp_path / "no")


def test_head_and_table_show_what_contact_sees_above_the_band(tmp_path):
    """The compliances of both models above the band, anew from their matrices."""
    base = write_family(tmp_path, chain())
    port = '[[port]]\nname = "{}"\ndirection = "both"\nkind = "mechanical"\n'
    (tmp_path / "model.toml").write_text("band = [0, 0.1]\n" + port.format("a") + port.format("b"))
    ran = CliRunner().invoke(app, ["reduce", str(base), "-o", str(tmp_path / "out")])
    found = reduce(base, tmp_path / "json")
    export_rom(found["rom"], tmp_path / "out")
    head = (tmp_path / "out" / "model_rom.lib").read_text().partition(".subckt")[0]
    assert len(found["above_band_hz"]) >= 2
    full, rom = read_model(base), read_rom(found["rom"])
    for f, said in zip(found["above_band_hz"], found["above_band_compliance_error"], strict=True):
        exact, ours = (np.diagonal(m.transfer(np.array([f]))[0]) for m in (full, rom))
        assert said == pytest.approx(np.abs(ours / exact - 1).max(), rel=1e-6)
        assert f"{said:.2g} at {f:g} Hz" in head
        assert f"compliance at {f:g} Hz" in ran.stdout
        assert f"{said:.2g} off, above the band" in ran.stdout


def test_command_line_writes_nothing_on_bad_input(tmp_path):
    base = write_family(tmp_path, edited("K", with_value(np.nan)))
    before = sorted(tmp_path.iterdir())
    ran = CliRunner().invoke(app, ["reduce", str(base), "-o", str(tmp_path / "out")])
    assert ran.exit_code == 2
    assert "model.K" in ran.stderr
    assert sorted(tmp_path.iterdir()) == before
    for options in (["--tolerance", "1e-3", "--order", "3"], ["--band", "2", "1"],
                    ["--tolerance", "0"], ["--order", "0"]):  # fmt: skip
        good = write_family(tmp_path, chain(), "good")
        ran = CliRunner().invoke(app, ["reduce", str(good), "-o", str(tmp_path / "out"), *options])
        assert ran.exit_code == 2, ran.output
        assert not (tmp_path / "out").exists()


def huge():
    """A model that is too large to read at all: the size is refused before memory is taken."""
    rows = 6_000_000
    lone = sparse.coo_array(([1.0], ([rows - 1], [rows - 1])), shape=(rows, rows)).tocsc()
    return {**chain(), "K": lone}


def truncated(path):
    path.write_bytes(path.read_bytes()[: path.stat().st_size * 2 // 3])


def corrupt(path):
    content = bytearray(path.read_bytes())
    content[len(content) // 3 : len(content) // 3 + 200] = b"\x00\xff%&" * 50
    path.write_bytes(content)


BAD_FILES = {
    "corrupt": (chain, corrupt),
    "truncated": (chain, truncated),
    "complex": (BAD_MODELS["complex"][0], None),
    "NaN": (BAD_MODELS["NaN"][0], None),
    "mismatched": (BAD_MODELS["shape"][0], None),
    "huge": (huge, None),
}


@pytest.mark.parametrize("case", BAD_FILES)
@pytest.mark.parametrize("writer", ["market", "mat", "csc", "coo"])
def test_every_kind_of_file_is_refused_with_one_message(tmp_path, writer, case):
    """Exit code 2, the file's name, no traceback, nothing written."""
    make, damage = BAD_FILES[case]
    path = WRITERS[writer](tmp_path, make())
    if damage is not None:
        damage(tmp_path / "model.K" if writer == "market" else path)
    before = sorted(tmp_path.iterdir())
    ran = CliRunner().invoke(app, ["reduce", str(path), "-o", str(tmp_path / "out"), "--json"])
    assert ran.exit_code == 2, ran.output
    assert str(tmp_path / "model") in ran.stderr.replace("\n", "")
    assert ran.stderr.count("expected:") <= 1
    assert "Traceback" not in ran.stderr
    assert ran.stdout == ""
    assert sorted(tmp_path.iterdir()) == before


@pytest.mark.parametrize("case", ["corrupt", "truncated", "NaN", "complex", "mismatched"])
@pytest.mark.parametrize("kind", ["npz", "json"])
def test_every_kind_of_reduced_model_is_refused_with_one_message(tmp_path, kind, case):
    model = read_model(write_family(tmp_path, chain()))
    rom = reduce_model(model, band=(0.0, 0.1), order=4)
    changes = {"NaN": np.nan * rom.K, "complex": rom.K + 1j, "mismatched": rom.K[:2, :2]}
    if case in changes:
        object.__setattr__(rom, "K", changes[case])
    write_rom(rom, tmp_path, "r")
    if case not in changes:
        {"corrupt": corrupt, "truncated": truncated}[case](
            tmp_path / ("r.npz" if kind == "npz" else "r.K")
        )
    command = ["export", "--rom", str(tmp_path / f"r.{kind}"), "-o", str(tmp_path / "out")]
    ran = CliRunner().invoke(app, command)
    assert ran.exit_code == 2, ran.output
    assert "Traceback" not in ran.stderr
    assert not (tmp_path / "out").exists()


def market(text, head="coordinate real general"):
    """A matrix of a Matrix Market file's content, and what its size was asked as."""
    asked = []
    found = read_market(
        f"%%MatrixMarket matrix {head}\n{text}".encode(), lambda *a: asked.append(a)
    )
    return (found.toarray() if sparse.issparse(found) else found).tolist(), asked


@pytest.mark.parametrize(
    ("head", "text", "matrix", "entries"),
    [
        ("coordinate real general", "% a\n\n2 3 2\n1 3 5.0\n2 1 -1d1\n",
         [[0, 0, 5], [-10, 0, 0]], 2),
        ("coordinate integer symmetric", "2 2 2\n1 1 4\n2 1 3\n", [[4, 3], [3, 0]], 2),
        ("coordinate real general", "2 2 1\n1 1 1.5D+3\n", [[1500, 0], [0, 0]], 1),
        ("coordinate real skew-symmetric", "2 2 1\n2 1 3\n", [[0, -3], [3, 0]], 1),
        ("array real general", "2 3\n1\n2\n3\n4\n5\n6", [[1, 3, 5], [2, 4, 6]], 6),
        ("array double symmetric", "2 2\n1\n2\n3\n", [[1, 2], [2, 3]], 3),
        ("array real skew-symmetric", "3 3\n1\n2\n3\n", [[0, -1, -2], [1, 0, -3], [2, 3, 0]], 3),
        ("coordinate real general", "2 2 0\n", [[0, 0], [0, 0]], 0),
        ("coordinate real general", "2 2 0", [[0, 0], [0, 0]], 0),
    ],
)  # fmt: skip
def test_market_files_hold_what_they_declare(head, text, matrix, entries):
    found, asked = market(text, head)
    assert found == matrix
    assert asked == [((len(matrix), len(matrix[0])), entries)]


BAD_RECORDS = {
    "kind": lambda r: r["ports"][0].update(kind="magic"),
    "name of two words": lambda r: r["ports"][0].update(name="a b"),
    "long name": lambda r: r["ports"][0].update(name="a" * 65),
    "line break": lambda r: r["ports"][0].update(across="V\n.control"),
    "name that is none": lambda r: r["ports"][0].update(name=5),
    "empty unit": lambda r: r["ports"][0].update(flow=""),
    "band": lambda r: r["certificate"].update(band_hz=[2.0, 1.0]),
    "negative band": lambda r: r["certificate"].update(band_hz=[-1.0, 1.0]),
    "endless band": lambda r: r["certificate"].update(band_hz=[0.0, float("inf")]),
    "estimate": lambda r: r["certificate"].update(error_estimate=float("nan")),
    "long method": lambda r: r["certificate"].update(method="a" * 1001),
    "above": lambda r: r["certificate"].update(above=[[1.0, float("inf")]]),
}


@pytest.mark.parametrize("case", [None, *BAD_RECORDS])
def test_records_of_reduced_models_are_judged(tmp_path, case):
    known = Certificate((0.0, 0.1), 1e-3, "m" * 1000, True, False, ((0.2, 1e-2),))
    ports = (Port("a" * 64, "mechanical"),)
    rom = LinearModel(M=np.eye(2), K=np.eye(2), B=np.ones((2, 1)), ports=ports, certificate=known)
    assert write_rom(rom, tmp_path, "r") == ["r.npz", "r.json", *(f"r.{k}" for k in "MEKBCD")]
    record = json.loads((tmp_path / "r.json").read_text())
    if case is None:
        assert read_rom(tmp_path / "r.json").certificate == known
        return
    BAD_RECORDS[case](record)
    (tmp_path / "r.json").write_text(json.dumps(record))
    with pytest.raises(UsageError, match="not a reduced model"):
        read_rom(tmp_path / "r.json")
