"""Readers of other tools' matrices: every format, every port selection, every refusal."""

import re
import warnings
from pathlib import Path

import numpy as np
import pytest
from scipy import io as scipy_io
from scipy import sparse
from support import (
    LinearModel,
    MissingToolError,
    UsageError,
    import_optional,
    measure_mesh_extent,
    read_model,
    read_sidecar,
)

DATA = Path(__file__).parents[1] / "data" / "matrices"
N = 6
KINDS = (1, 2)  # three nodes with ux, uy
NODES = (7, 20, 300)
TIP = '[[ports]]\nname = "tip"\nkind = "mechanical"\nnode = 300\ndof = "uy"\n'


def chain():
    """Stiffness and mass of a small coupled chain, positive definite, every entry different."""
    rng = np.random.default_rng(4)
    half = rng.normal(size=(N, N))
    return half @ half.T + N * np.eye(N), np.diag(np.arange(1.0, N + 1)) + 0.1


K, M = chain()
ROWS = [(node, kind) for node in NODES for kind in KINDS]


def write_market(path, matrix):
    table = matrix if sparse.issparse(matrix) else np.atleast_2d(matrix)
    scipy_io.mmwrite(str(path), sparse.coo_array(table), symmetry="general")
    written = path if path.exists() else path.with_name(path.name + ".mtx")
    if written != path:
        written.rename(path)


def write_family(tmp_path, pattern="m.{}", **matrices):
    for letter, matrix in matrices.items():
        write_market(tmp_path / pattern.format(letter), matrix)
    return tmp_path / "m"


def write_boeing(path, matrix, title, kind="RSA", value="(d25.15)", width=25, per_line=1):
    """Harwell-Boeing as Ansys writes it: one number a line, D exponents, lower triangle."""
    stored = sparse.csc_array(np.tril(matrix) if kind == "RSA" else matrix)
    pointer, row, data = stored.indptr + 1, stored.indices + 1, stored.data
    numbers = [f"{x:{width}.15E}".replace("E", "D") for x in data]
    lines = ["".join(numbers[i : i + per_line]) for i in range(0, len(numbers), per_line)]
    n = len(matrix)
    head = [
        f"{title:<72}{'':8}",
        f"{len(pointer) + len(row) + len(lines) + n:14d}{len(pointer):14d}{len(row):14d}"
        f"{len(lines):14d}{n:14d}",
        f"{kind:<14}{n:14d}{n:14d}{len(row):14d}{0:14d}",
        f"{'(I14)':<16}{'(I14)':<16}{value:<20}{value:<20}",
        f"F{'':13}{1:14d}{n:14d}",
    ]
    body = [f"{k:14d}" for k in (*pointer, *row)] + lines + [f"{0.0:25.15E}"] * n
    path.write_text("\n".join(head + body) + "\n")


def write_mapping(path, rows):
    names = {1: "UX", 2: "UY"}
    lines = [f"{i:14d}{node:14d}    {names[kind]:<4}" for i, (node, kind) in enumerate(rows, 1)]
    path.write_text("\n".join(["    Matrix Eqn          Node    DOF     ", *lines]) + "\n")


def write_abaqus(path, matrix, rows=ROWS):
    """MATRIX INPUT: one triangle, columns outside, as Abaqus orders it."""
    lines = [
        f"{rows[i][0]},{rows[i][1]}, {rows[j][0]},{rows[j][1]}, {matrix[i, j]: .15e}"
        for j in range(len(matrix))
        for i in range(j, len(matrix))
        if matrix[i, j]
    ]
    path.write_text("\n".join(lines) + "\n")


def same(model, K=K, M=M):
    np.testing.assert_allclose(model.K.toarray(), K, rtol=1e-14, atol=1e-13)
    np.testing.assert_allclose(model.M.toarray(), M, rtol=1e-14, atol=1e-13)


def sidecar(tmp_path, text, name="m.toml"):
    (tmp_path / name).write_text(text)
    return tmp_path / name


def refused(path, *words, side=None, error=UsageError):
    with pytest.raises(error) as caught:
        read_model(path, side)
    message = str(caught.value)
    for word in words:
        assert word in message, message
    assert caught.value.where
    return caught.value


# ---------------------------------------------------------------------------- formats


@pytest.mark.parametrize("pattern", ["m.{}", "m.{}.mtx", "m_{}.mtx", "m.{}.txt"])
@pytest.mark.parametrize("opened", ["m", None, "m.K"])
def test_matrix_market_families(tmp_path, pattern, opened):
    """By its name, by one of its files, or by ``NAME.K`` for ``NAME.K.mtx``."""
    write_family(tmp_path, pattern, K=K, M=M, B=np.ones((N, 1)))
    if opened == "m.K" and "_" in pattern:
        opened = "m"
    model = read_model(tmp_path / (opened or pattern.format("K")))
    same(model)
    assert model.name == "m"
    assert [p.name for p in model.ports] == ["u1", "y1"]
    assert np.array_equal(model.C, model.B.T)


LOAD = np.arange(1.0, N + 1)[:, None]
# E u'' + D u' + K u = L: what COMSOL calls E is the mass, and D the damping.
COMSOL = {
    "second order": (
        {"K": 2 * K, "Kc": sparse.csc_array(K + 0j), "Ec": sparse.csc_array(M),
         "Dc": sparse.csc_array(0.1 * K), "Lc": LOAD, "N": np.ones((1, N))},
        {"K": K, "M": M, "E": 0.1 * K},
    ),
    "heat": (
        {"K": K, "D": sparse.csc_array(M), "E": sparse.csc_array((N, N)), "L": LOAD},
        {"A": -K, "E": M},
    ),
    "state space": (
        {"MA": -K, "MB": LOAD, "Mc": M, "C": np.eye(N)[:2], "D": np.zeros((2, 1))},
        {"A": -K, "E": M, "C": np.eye(N)[:2]},
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", COMSOL)
def test_comsol_structs(tmp_path, name):
    fields, expected = COMSOL[name]
    scipy_io.savemat(tmp_path / "m.mat", {"MA": fields})
    model = read_model(tmp_path / "m.mat")
    for letter, matrix in {**expected, "B": LOAD}.items():
        found = getattr(model, letter)
        found = found if isinstance(found, np.ndarray) else found.toarray()
        np.testing.assert_allclose(found, matrix, rtol=1e-14, atol=1e-13)


def test_comsol_constraints_that_are_not_eliminated_are_refused(tmp_path):
    fields = {"K": K, "E": M, "N": np.ones((1, N))}
    scipy_io.savemat(tmp_path / "m.mat", {"MA": fields})
    refused(tmp_path / "m.mat", "Kc")


@pytest.mark.parametrize("kind", ["RSA", "RUA"])
@pytest.mark.parametrize("per_line", [1, 3])
def test_harwell_boeing_with_mapping(tmp_path, kind, per_line):
    """Three touching fields of 25 on a line, one a line as Ansys does; half or whole."""
    value = f"({per_line if per_line > 1 else ''}d25.15)"
    order = [4, 0, 2, 5, 1, 3]  # a solver's numbering, not the nodes'
    for letter, matrix in {"K": K, "M": M}.items():
        shuffled = matrix[np.ix_(order, order)]
        write_boeing(tmp_path / f"m_{letter}.matrix", shuffled, "Stiffness", kind, value,
                     per_line=per_line)  # fmt: skip
    write_mapping(tmp_path / "m_K.mapping", [ROWS[i] for i in order])
    model = read_model(tmp_path / "m_K.matrix", sidecar(tmp_path, TIP))
    same(model, K[np.ix_(order, order)], M[np.ix_(order, order)])
    assert np.flatnonzero(model.B).tolist() == [order.index(5)]


def test_abaqus_matrix_input(tmp_path):
    for word, matrix in {"STIF": K, "MASS": M, "DMPV": 0.01 * K}.items():
        write_abaqus(tmp_path / f"job_{word}2.mtx", matrix)
    model = read_model(tmp_path / "job_MASS2.mtx", sidecar(tmp_path, TIP))
    same(model)
    np.testing.assert_allclose(model.E.toarray(), 0.01 * K, rtol=1e-14)


def test_calculix_rows_keep_node_numbers_as_text(tmp_path):
    """Node 12.3 is not a decimal number, and 2.10 would not be 2.1."""
    upper = [(i, j) for j in range(N) for i in range(j + 1)]
    for suffix, matrix in {"sti": K, "mas": M}.items():
        lines = [f"{i + 1} {j + 1}  {matrix[i, j]:.13e}" for i, j in upper]
        (tmp_path / f"m.{suffix}").write_text("\n".join(lines))
    (tmp_path / "m.dof").write_text("\n".join(f"{n}.{k}" for n, k in ROWS))
    model = read_model(tmp_path / "m.mas", sidecar(tmp_path, TIP))
    np.testing.assert_allclose(model.K.toarray(), K, rtol=1e-12)
    assert np.flatnonzero(model.B).tolist() == [5]


def test_dmig_agrees_with_another_reader(tmp_path):
    bulk = import_optional("pyyeti.nastran.bulk", "bulk data")
    frame = bulk.rddmig(str(DATA / "wing.pch"))["kaax"]
    model = read_model(
        DATA / "wing.pch", sidecar(tmp_path, TIP.replace("300", "5").replace("uy", "uz"))
    )
    np.testing.assert_array_equal(model.K.toarray(), frame.to_numpy())


# -------------------------------------------------------------------- structural damping

COMPLEX = K + 1j * np.diag(np.arange(1.0, N + 1))  # every imaginary part different


def dmig(name, matrix, kind=3, polar=0):
    """Large fields of one triangle, both numbers of a complex value in one entry."""
    lines = [f"DMIG    {name:<8}{0:8d}{6:8d}{kind:8d}{0:8d}{polar:8d}"]
    for j, (node, direction) in enumerate(ROWS):
        lines.append(f"DMIG*   {name:<16}{node:16d}{direction:16d}")
        for i in range(j, N):
            value = complex(matrix[i, j])
            two = (abs(value), np.degrees(np.angle(value))) if polar else (value.real, value.imag)
            pair = "".join(f"{x:16.9E}" for x in (two if kind > 2 else two[:1]))
            lines.append(f"*       {ROWS[i][0]:16d}{ROWS[i][1]:16d}{pair}")
    return "\n".join(lines) + "\n"


def as_market(folder, K):
    scipy_io.mmwrite(str(folder / "m.K.mtx"), sparse.coo_array(K), symmetry="symmetric")
    write_family(folder, M=M)
    return folder / "m"


def as_market_array(folder, K):
    scipy_io.mmwrite(str(folder / "m.K.mtx"), K, symmetry="symmetric")
    write_family(folder, M=M)
    return folder / "m"


def as_archive(folder, K):
    packed = sparse.csr_array(K)
    np.savez(folder / "m.npz", M=M, **{
        "K.data": packed.data, "K.indices": packed.indices, "K.indptr": packed.indptr,
        "K.shape": packed.shape, "K.format": b"csr",
    })  # fmt: skip
    return folder / "m.npz"


def as_matlab(folder, K):
    scipy_io.savemat(folder / "m.mat", {"M": sparse.csc_matrix(M), "K": sparse.csc_matrix(K)})
    return folder / "m.mat"


def as_boeing(folder, K):
    """Real and imaginary part of each value follow each other."""
    write_boeing(folder / "m_M.matrix", M, "Mass")
    rows = np.flatnonzero(np.tril(np.ones((N, N))))  # all entries of the triangle are stored
    path = folder / "m_K.matrix"
    write_boeing(path, K.real, "Stiffness")
    lines = path.read_text().splitlines()
    stored = sparse.csc_array(np.tril(K)).data
    both = [f"{x:25.15E}" for value in stored for x in (value.real, value.imag)]
    first = 5 + N + 1 + len(rows)
    counts = [int(word) for word in lines[1].split()]
    lines[1] = "".join(f"{x:14d}" for x in (*counts[:3], len(both), counts[4]))
    lines[2] = lines[2].replace("RSA", "CSA")
    path.write_text("\n".join(lines[:first] + both + lines[first + len(stored) :]) + "\n")
    return path


def as_dmig(folder, K):
    (folder / "m.pch").write_text(dmig("KAAX", K) + dmig("MAAX", M, 1))
    return folder / "m.pch"


def as_polar_dmig(folder, K):
    (folder / "m.pch").write_text(dmig("KAAX", K, 4, 1) + dmig("MAAX", M, 2))
    return folder / "m.pch"


def as_dmig_of_its_own(folder, K):
    parts = dmig("KAAX", K.real, 1) + dmig("K4AAX", K.imag, 1) + dmig("MAAX", M, 1)
    (folder / "m.pch").write_text(parts)
    return folder / "m.pch"


def as_op4(folder, K):
    op4 = import_optional("pyyeti.nastran.op4", "m.op4")
    op4.write(str(folder / "m.op4"), {"KAA": K, "MAA": M})
    return folder / "m.op4"


def as_op4_of_its_own(folder, K):
    op4 = import_optional("pyyeti.nastran.op4", "m.op4")
    op4.write(str(folder / "m.op4"), {"KAA": K.real, "K4AA": K.imag, "MAA": M})
    return folder / "m.op4"


def as_abaqus(folder, K):
    for word, matrix in {"STIF": K.real, "MASS": M, "DMPS": K.imag}.items():
        write_abaqus(folder / f"m_{word}1.mtx", matrix)
    return folder / "m_STIF1.mtx"


WRITERS = (as_market, as_market_array, as_archive, as_matlab, as_boeing, as_dmig, as_polar_dmig,
           as_dmig_of_its_own, as_op4, as_op4_of_its_own, as_abaqus)  # fmt: skip


@pytest.mark.slow
@pytest.mark.parametrize("write", WRITERS)
@pytest.mark.parametrize("stiffness", [COMPLEX, K * (1 + 0.03j)], ids=["several", "one"])
def test_structural_damping_of_every_format(tmp_path, write, stiffness):
    """The response of K + j H, which numpy solves."""
    path = write(tmp_path, stiffness)
    port = '[[ports]]\nname = "tip"\nkind = "mechanical"\n'
    rows = "".join(f"{node},{kind}\n" for node, kind in ROWS)
    (tmp_path / "rows.csv").write_text(rows)
    named = write.__name__.split("_")[1] in ("dmig", "polar", "abaqus")
    text = ("" if named else 'dofs = "rows.csv"\n') + port + 'node = 300\ndof = "uy"\n'
    model = read_model(path, sidecar(tmp_path, text))
    frequency = np.array([0.1, 0.4])
    load = np.eye(N)[:, [5]]
    exact = [load.T @ np.linalg.solve(stiffness - (2 * np.pi * f) ** 2 * M, load)
             for f in frequency]  # fmt: skip
    np.testing.assert_allclose(model.transfer(frequency), exact, rtol=1e-7)
    assert model.loss_factor == pytest.approx(0.0 if stiffness is COMPLEX else 0.03, rel=1e-7)


def test_a_loss_factor_in_the_sidecar(tmp_path):
    path = write_family(tmp_path, K=K, M=M, B=np.ones((N, 1)))
    side = sidecar(tmp_path, "damping = { loss_factor = 0.02, alpha = 0.1 }")
    model = read_model(path, side)
    assert (model.loss_factor, model.rayleigh) == (0.02, (0.1, 0.0))
    one, w = np.ones((N, 1)), 2 * np.pi * 0.3
    exact = one.T @ np.linalg.solve(K * (1 + 0.02j) + 0.1j * w * M - w**2 * M, one)
    np.testing.assert_allclose(model.transfer([0.3])[0], exact, rtol=1e-12)
    (tmp_path / "m.K").unlink()
    write_market(tmp_path / "m.K", COMPLEX)
    refused(path, "defined twice", side=side)
    side = sidecar(tmp_path, "damping = { loss_factor = -0.02 }")
    refused(path, "loss_factor", side=side)
    write_family(tmp_path, "h.{}", K=K, E=M, B=np.ones((N, 1)))
    side = sidecar(tmp_path, "damping = { loss_factor = 0.02 }", "h.toml")
    refused(tmp_path / "h", "second-order", side=side)


def test_complex_matrices_that_are_no_structural_damping(tmp_path):
    path = write_family(tmp_path, K=K, M=M * (1 + 0.1j), B=np.ones((N, 1)))
    refused(path, "matrix M is complex", "only a stiffness may be complex")
    for name, bad in (("gain", K - 0.1j * np.eye(N)), ("skew", K + 1j * np.eye(N, k=1))):
        path = write_family(tmp_path, name + ".{}.mtx", K=bad, M=M, B=np.ones((N, 1))).parent / name
        refused(path, "matrix K is not a valid structural damping", "positive semi-definite")
    path = tmp_path / "m.K"
    hermitian = "%%MatrixMarket matrix coordinate complex hermitian\n1 1 1\n1 1 2.0 0.0\n"
    path.write_text(hermitian)
    refused(tmp_path / "m", "'coordinate hermitian' is not supported")


def beside(folder, monkeypatch, module, text):
    """A package of this name that readers find before any that is installed."""
    *packages, name = module.split(".")
    home = folder / "packages"
    home.joinpath(*packages).mkdir(parents=True)
    for k in range(len(packages)):
        (home.joinpath(*packages[: k + 1]) / "__init__.py").touch()
    (home.joinpath(*packages) / f"{name}.py").write_text(text)
    monkeypatch.setenv("PYTHONPATH", str(home))


@pytest.mark.parametrize("package", ["pyyeti", "ansys-mapdl-reader"])
def test_missing_packages_name_the_command(tmp_path, monkeypatch, package):
    suffix, module, extra = {
        "pyyeti": (".op4", "pyyeti.nastran", "nastran"),
        "ansys-mapdl-reader": (".full", "ansys.mapdl.reader.full", "ansys"),
    }[package]
    beside(tmp_path, monkeypatch, module, "raise ImportError")
    (tmp_path / f"m{suffix}").write_bytes(b"x")
    error = refused(tmp_path / f"m{suffix}", package, f"kc2spice[{extra}]", error=MissingToolError)
    assert error.exit_code == 3


FULL = """
import numpy as np
import re
import warnings
from pathlib import Path
from scipy import sparse
class FullFile:
    def __init__(self, path):
        arrays = np.load(path)
        self.const = np.array([[7, 0]])
        self.found = arrays["place"], *(sparse.csc_array(arrays[k]) for k in "KM")
    def load_km(self):
        return self.found
"""


def test_ansys_full_drops_what_ansys_constrains(tmp_path, monkeypatch):
    """The package's own interface: upper triangles, freedoms from 0, a table of constraints."""
    beside(tmp_path, monkeypatch, "ansys.mapdl.reader.full", FULL)
    cut = np.where((np.arange(N) == 0) | (np.arange(N)[:, None] == 0), 0.0, 1.0)
    place = np.array([(n, k - 1) for n, k in ROWS])
    with (tmp_path / "m.full").open("wb") as file:
        np.savez(file, place=place, K=np.triu(K * cut), M=np.triu(M * cut))
    same(read_model(tmp_path / "m.full", sidecar(tmp_path, TIP)), K[1:, 1:], M[1:, 1:])


# ---------------------------------------------------------------------------- ports


@pytest.fixture
def labelled(tmp_path):
    """A model with named rows; returns a reader that takes the text of its sidecar."""
    nodes, dofs = np.array(ROWS).T
    np.savez(tmp_path / "m.npz", K=K, M=M, nodes=nodes, dofs=dofs)
    (tmp_path / "mesh.inp").write_text(
        "*NODE\n7, 0, 0, 0\n20, 10., 0, 0\n300, 20, 1.5, 0\n*NSET, NSET=Ends\n7, 300\n"
    )
    return lambda text: read_model(tmp_path / "m.npz", sidecar(tmp_path, text))


def test_reports_draw_the_size_of_the_mesh(labelled, tmp_path):
    labelled('mesh="mesh.inp"\nlength="mm"\n' + TIP)
    np.testing.assert_allclose(measure_mesh_extent(tmp_path / "m.npz", None), [20e-3, 1.5e-3, 0.0])


def test_port_over_a_node_set_is_the_mean_along_the_axis(labelled):
    model = labelled(
        'mesh="mesh.inp"\n[[ports]]\nname="p"\nkind="mechanical"\nnodeset="ENDS"\naxis=[3,4,0]\n'
        'pins=["a"]\n'
    )  # fmt: skip
    np.testing.assert_allclose(model.B[:, 0], [0.3, 0.4, 0, 0, 0.3, 0.4])
    assert np.array_equal(model.B, model.C.T)
    assert (model.ports[0].across, model.ports[0].flow, model.ports[0].pins) == ("um", "N", ("a",))


CDB = """/PREP7
NBLOCK,6,SOLID,     300,       3
(3i9,6e21.13e3)
        7        0        0 0.0000000000000E+000 0.0000000000000E+000 0.0000000000000E+000
       20        0        0 1.0000000000000E+001
      300        0        0 2.0000000000000E+001 1.5000000000000E+000 0.0000000000000E+000
N,R5.3,LOC,       -1,
CMBLOCK,ENDS    ,NODE,       3  ! users node component definition
(8i10)
         6        -7       300
"""
BULK = (
    "$ nodes\n"
    "GRID    7               0.      0.      0.\n"
    "GRID,20,,10.,0.,0.\n"
    f"{'GRID*':8}{300:16d}{'':16}{'2.000000000D+01':>16}{'1.500000000D+00':>16}\n"
    f"{'*':8}{'0.000000000D+00':>16}\n"
)


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("n.cdb", CDB),
        ("n.bdf", BULK),
        ("n.csv", "node,x,y,z\n7,0,0,0\n20,10,0,0\n300,20,1.5,0\n"),
        (
            "n.inp",
            "** c\n*Node\n7,0,0,0\n20,10.\n300,20,1.5,0\n*Nset,nset=ends,generate\n7,300,293\n",
        ),
    ],
)
def test_every_mesh_format_finds_the_nodes(labelled, tmp_path, name, text):
    (tmp_path / name).write_text(text)
    at = '[[ports]]\nname="p"\nkind="mechanical"\nat=[20, 1.5, 0]\ndof=1\n'
    model = labelled(f'mesh="{name}"\n' + at)
    assert np.flatnonzero(model.B).tolist() == [4]
    if name in ("n.cdb", "n.inp"):
        by_set = at.replace("at=[20, 1.5, 0]", 'nodeset="ENDS"')
        model = labelled(f'mesh="{name}"\n' + by_set)
        assert np.flatnonzero(model.B).tolist() == [0, 4]
        np.testing.assert_allclose(model.B.max(), 0.5)


def test_columns_and_rows_of_the_file_become_ports(tmp_path):
    rng = np.random.default_rng(2)
    B, C, D = rng.normal(size=(N, 2)), rng.normal(size=(2, N)), rng.normal(size=(2, 2))
    np.savez(tmp_path / "m.npz", K=K, M=M, B=B, C=C, D=D)
    port = '[[ports]]\nname = "{}"\nkind = "{}"\n{} = {}\nscale = {}\nunit = "mW"\n'
    given = [("a", "input", "column", 1, 2.0), ("b", "input", "column", 2, 1.0)]
    given += [("c", "output", "row", 1, 1.0), ("d", "output", "row", 2, 4.0)]
    model = read_model(
        tmp_path / "m.npz", sidecar(tmp_path, "".join(port.format(*each) for each in given))
    )
    into, out = np.array([2.0, 1.0]), np.array([[1.0], [4.0]])
    assert [(p.name, p.across, p.flow) for p in model.ports] == [(k, "mW", "-") for k in "abcd"]
    np.testing.assert_allclose(model.B, B * into)
    np.testing.assert_allclose(model.C, C / out)
    np.testing.assert_allclose(model.D, D * into / out)
    side = sidecar(tmp_path, '[[ports]]\nname = "x"\nkind = "mechanical"\ncolumn = 1\n')
    refused(tmp_path / "m.npz", "is not conservative", side=side)


def test_fixed_freedoms_leave_the_model(labelled):
    model = labelled('[[fixed]]\nnode=7\n[[fixed]]\nnodes=[20]\ndof="uy"\n' + TIP + 'unit="um"\n')
    keep = [2, 4, 5]
    same(model, K[np.ix_(keep, keep)], M[np.ix_(keep, keep)])


def test_base_acceleration_moves_the_frame(labelled):
    model = labelled(TIP + '[[ports]]\nname="base"\nkind="acceleration"\naxis="y"\n')
    along = np.tile([0.0, 1.0], 3)
    np.testing.assert_allclose(model.B[:, 1], -M @ along)
    assert model.ports[1].across == "m/s2"


def test_units_of_millimetres_are_converted(labelled):
    """K in N/mm is 1000 times as many N/m; t mm s: a mass of 1 t is 1000 kg."""
    model = labelled('length="mm"\n' + TIP)
    same(model, 1e3 * K, 1e3 * M)
    assert model.B.max() == 1


def test_electrode_at_nodes_gives_the_capacitance(tmp_path):
    """One spring-mass with coupling e and two potentials in series: by hand.

    k x + e p + 0 V = f;  e x - 2c p + c V = 0;  Q = c (V - p).
    """
    k, m, e, c = 4.0, 1.0, 0.3, 0.5
    stiffness = np.array([[k, e, 0.0], [e, -2 * c, c], [0.0, c, -c]])
    np.savez(tmp_path / "m.npz", K=stiffness, M=np.diag([m, 0, 0]), nodes=[1, 1, 2], dofs=[1, 9, 9])
    side = sidecar(
        tmp_path,
        'band = [0, 3]\n[[ports]]\nname="drive"\nkind="electrical"\nnode=2\n'
        '[[ports]]\nname="x"\nkind="mechanical"\nnode=1\ndof="ux"\n',
    )
    model = read_model(tmp_path / "m.npz", side)
    static = model.transfer(np.array([0.0]))[0].real
    inner = np.linalg.solve(stiffness[:2, :2], np.array([[0.0, 1.0], [-c, 0.0]]))
    x, p = inner[:, 0]
    np.testing.assert_allclose(
        static, [[c * (1 - p), -c * inner[1, 1]], [x, inner[0, 1]]], rtol=1e-12
    )
    assert static[0, 1] == pytest.approx(static[1, 0])
    assert model.band == (0.0, 3.0)


# ---------------------------------------------------------------------------- refusals


@pytest.mark.parametrize(
    ("matrices", "words"),
    [
        ({"K": 0 * K, "M": M}, ("matrix K is zero",)),
        ({"K": K, "M": 0 * M}, ("matrix M is zero", "leave M out")),
        ({"A": 0 * K}, ("matrix A is zero",)),
        ({"K": K}, ("the model has no matrix M", "add the matrix M")),
        ({"K": K, "M": M, "A": K}, ("the model lacks matrices",)),
        ({"K": K, "M": M[:3, :3]}, ("matrix M", "3 x 3", "6 x 6")),
        (
            {"K": np.pad(K, 1), "M": np.pad(M, 1), "B": np.ones((N + 2, 1))},
            ("zero in all matrices", "row 1"),
        ),
    ],
)
def test_files_that_are_not_models_are_rejected(tmp_path, matrices, words):
    refused(write_family(tmp_path, **{"B": np.ones((N, 1))} | matrices), *words)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x = [", ("m.toml, line 1", "add ] at the end of line 1")),
        ("colour = 1\n" + TIP, ("colour", "ports, ", "docs/reference/matrices.md")),
        (TIP + "colour = 1\n", ("ports[0]", "colour", "column", "docs/reference/matrices.md")),
        (TIP.replace('"tip"', "3"), ("ports[0].name",)),
        (TIP.replace('"tip"', '"a\\nb"'), ("ports[0].name",)),
        (TIP.replace("mechanical", "magic"), ("kind", "magic", "mechanical")),
        (TIP.replace("uy", "uq"), ("dof", "uq", "ux")),
        (TIP.replace("uy", "rz"), ("mechanical", "rz")),
        (TIP.replace("uy", "uz"), ("uz", "ux, uy")),
        (TIP.replace("300", "301"), ("node 301", "7 to 300")),
        (TIP + 'axis = "y"\n', ("both dof and axis",)),
        (TIP.replace('dof = "uy"', ""), ("no direction", 'axis = "z"')),
        (TIP + 'nodeset = "ENDS"\n', ("node, nodeset",)),
        (TIP.replace("node = 300", 'nodeset = "ENDS"'), ("keys `nodeset` and `at` need a mesh",)),
        ('mesh="mesh.inp"\n' + TIP.replace("node = 300", 'nodeset = "NONE"'), ("NONE", "ENDS")),
        ('mesh="mesh.inp"\n' + TIP.replace("node = 300", "at = [20, 1, 0]"), ("node 300", "0.5")),
        ('mesh="none.inp"\n' + TIP.replace("node = 300", "at = [0, 0, 0]"), ("none.inp",)),
        ('mesh="../mesh.inp"\n' + TIP, ("mesh", "relative")),
        ('mesh="/etc/passwd"\n' + TIP, ("mesh", "relative")),
        ("band = [3, 2]\n" + TIP, ("band",)),
        ('length = "ell"\n' + TIP, ("length", "mm")),
        ("symmetric = 1\n" + TIP, ("symmetric", "true or false")),
        ("damping = { ratio = 1 }\n" + TIP, ("damping", "at")),
        ("damping = { ratio = [0.01, 0.02], at = [1, 5] }\n" + TIP, ("damping.ratio", "alpha")),
        (TIP + TIP, ("the same name",)),
        (TIP + 'unit = "a b"\n', ("unit",)),
        ("[[fixed]]\nnode = 301\n" + TIP, ("fixed[0]", "301")),
        ("[[fixed]]\ndof = 1\n" + TIP, ("fixed[0]", "selects no nodes", "node = 1")),
        ("[[fixed]]\nnodes = [7, 20, 300]\n" + TIP, ("fixed",)),
        ('[[ports]]\nname="e"\nkind="electrical"\nnode=7\n', ("volt",)),
        ('[[ports]]\nname="a"\nkind="acceleration"\n', ("axis",)),
        ('[[ports]]\nname="i"\nkind="input"\nnode=7\ndof=1\n', ("output",)),
        ('[[ports]]\nname="i"\nkind="input"\ncolumn=3\n', ("column", "B")),
        ('dofs = "mesh.inp"\n' + TIP, ("mesh.inp", "node,dof")),
    ],
)
def test_sidecars_that_are_wrong(labelled, text, words):
    with pytest.raises(UsageError) as caught:
        labelled(text)
    for word in words:
        assert word in str(caught.value), str(caught.value)


def test_documented_sidecar_is_read(tmp_path):
    """The example in the docstring is one that the reader accepts, alternatives taken out."""
    from support import sidecar as module

    block = (module.__doc__ or "").split("::\n", 1)[1].split("A mechanical port at")[0]
    alternatives = ("damping = { ratio", "damping = { loss", "axis =", "within =", "scale =")
    lines = [line[4:] for line in block.splitlines()]
    text = "\n".join(line for line in lines if not line.startswith(alternatives))
    read = read_sidecar(sidecar(tmp_path, text))
    assert [port.name for port in read.ports] == ["tip", "force"]
    assert read.length == "mm"
    assert read.fixed[0].dof == (1, 2, 3)


def test_a_square_c_beside_m_and_k_is_damping_or_outputs_by_word_only(tmp_path):
    """Of a chain under a tip force: the static gain 2e-3 m/N, and damping ratios by hand."""
    n, k, m = 20, 1e4, 0.1
    stiff = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    stiff[-1, -1] = k
    mass, load = m * np.eye(n), np.eye(n)[:, [-1]]
    C = 0.2 * mass + 5e-4 * stiff
    np.savez(tmp_path / "m.npz", M=mass, C=C, K=stiff, B=load)
    for letter, matrix in {"M": mass, "C": C, "K": stiff, "B": load}.items():
        write_market(tmp_path / f"n.{letter}", matrix)
    for path in (tmp_path / "m.npz", tmp_path / "n.K"):
        refused(path, "whether matrix C is the damping matrix or the output", "damping_matrix")
    side = sidecar(tmp_path, 'damping_matrix = "C"\n')
    damped = read_model(tmp_path / "m.npz", side)
    assert damped.outputs == ("y1",)
    assert damped.transfer(np.zeros(1))[0, 0, 0] == pytest.approx(n / k)
    poles = damped.poles()
    omega = 2 * np.sqrt(k / m) * np.sin(np.pi / (2 * (2 * n + 1)))  # of the lowest mode
    ratio = 0.2 / (2 * omega) + 5e-4 * omega / 2
    lowest = poles[np.abs(poles).argmin()]
    assert abs(lowest) == pytest.approx(omega)
    assert -lowest.real / omega == pytest.approx(ratio)
    seen = read_model(tmp_path / "m.npz", sidecar(tmp_path, 'outputs = "C"\n'))
    assert len(seen.outputs) == n
    assert seen.pencil.is_undamped
    both = sidecar(tmp_path, 'outputs = "C"\ndamping_matrix = "C"\n', "both.toml")
    refused(tmp_path / "m.npz", "outputs and damping_matrix are both C", side=both)
    side = sidecar(tmp_path, 'damping_matrix = "C"\n')
    np.savez(tmp_path / "e.npz", M=mass, C=C, E=C, K=stiff, B=load)
    refused(tmp_path / "e.npz", "does not fit the matrices of the model", side=side)
    with pytest.raises(UsageError, match="whether matrix C is the damping matrix"):
        LinearModel(M=mass, C=C, K=stiff, B=load)
    assert LinearModel(M=mass, C=C, K=stiff, B=load, rayleigh=(0, 0)).pencil.is_undamped
    assert LinearModel(M=mass, C=np.eye(n), K=stiff, B=load).pencil.is_undamped


def test_a_square_d_beside_m_and_k_is_damping_or_feedthrough_by_word_only(tmp_path):
    """Of a chain with a force at every mass: static gains, and the lowest damping ratio by hand."""
    n, k, m, loss = 4, 2e3, 1e-3, 0.01
    stiff = k * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    matrices = {"M": m * np.eye(n), "D": loss * np.eye(n), "K": stiff, "B": np.eye(n)}
    np.savez(tmp_path / "m.npz", **matrices)
    np.savez(tmp_path / "one.npz", **matrices | {"B": np.eye(n)[:, :1]})
    for letter, matrix in matrices.items():
        write_market(tmp_path / f"n.{letter}", matrix)
    for name in ("m.npz", "one.npz", "n.K"):
        refused(tmp_path / name, "matrix D is the damping matrix or the feedthrough", "zero matrix")
    damped = read_model(tmp_path / "m.npz", sidecar(tmp_path, 'damping_matrix = "D"\n'))
    static = np.linalg.inv(stiff)
    assert damped.transfer(np.zeros(1))[0] == pytest.approx(static)
    omega = 2 * np.sqrt(k / m) * np.sin(np.pi / (2 * (n + 1)))  # of the lowest mode
    lowest = min(damped.poles(), key=abs)
    assert abs(lowest) == pytest.approx(omega)
    assert -lowest.real == pytest.approx(loss / (2 * m))
    np.savez(tmp_path / "e.npz", E=np.zeros((n, n)), **matrices)
    direct = read_model(tmp_path / "e.npz")
    assert direct.pencil.is_undamped
    assert direct.transfer(np.zeros(1))[0] == pytest.approx(static + loss * np.eye(n))
    side = sidecar(tmp_path, 'damping_matrix = "D"\n')
    refused(tmp_path / "e.npz", "does not fit the matrices of the model", side=side)
    np.savez(tmp_path / "zero.npz", **matrices | {"D": np.zeros((n, n))})
    assert read_model(tmp_path / "zero.npz").pencil.is_undamped
    with pytest.raises(UsageError, match="whether matrix D is the damping matrix"):
        LinearModel(**matrices)
    assert LinearModel(**matrices, rayleigh=(0, 0)).D[0, 0] == loss
    # in the first-order form, D is the feedthrough matrix
    first = {"A": -stiff, "E": m * np.eye(n), "B": np.eye(n), "D": loss * np.eye(n)}
    np.savez(tmp_path / "first.npz", **first)
    assert read_model(tmp_path / "first.npz").D[0, 0] == loss


def test_a_large_sparse_damping_matrix_named_d_stays_sparse(tmp_path):
    """A dense D of 6000 rows would exceed the limit for feedthrough matrices."""
    n = 6000
    chain = sparse.diags_array([np.full(n, 2.0), np.full(n - 1, -1.0)], offsets=(0, 1))
    matrices = {"M": sparse.eye_array(n), "D": 0.01 * sparse.eye_array(n), "K": chain + chain.T}
    for letter, matrix in matrices.items():
        write_market(tmp_path / f"n.{letter}", sparse.coo_array(matrix))
    write_market(tmp_path / "n.B", np.eye(n, 1))
    damped = read_model(tmp_path / "n.K", sidecar(tmp_path, 'damping_matrix = "D"\n'))
    assert damped.E.nnz == n
    write_market(tmp_path / "n.E", sparse.coo_array(matrices["D"]))
    refused(tmp_path / "n.K", "too large for a feedthrough matrix", "leave out the matrix D")
    (tmp_path / "n.E").unlink()
    (tmp_path / "n.D").unlink()
    write_market(tmp_path / "n.D", sparse.coo_array((n, n)))
    refused(tmp_path / "n.K", "too large for a feedthrough matrix", "leave out the matrix D")


@pytest.mark.parametrize("letter", ["M", "K"])
def test_an_asymmetric_matrix_of_a_body_is_a_warning_with_its_size(letter, tmp_path):
    """One entry of -1 is 2 % too large beside diagonal entries of 2, so 1 % of the largest one."""
    n = 6
    chain = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    matrices = {"M": np.eye(n) + 0.1 * chain, "K": chain, "B": np.eye(n)[:, :1]}
    matrices[letter] = chain.copy()
    matrices[letter][2, 3] *= 1.02
    np.savez(tmp_path / "body.npz", **matrices)
    port = '[[ports]]\nname = "tip"\nkind = "mechanical"\ncolumn = 1\n'
    sidecar = tmp_path / "body.toml"
    sidecar.write_text(port)
    with pytest.warns(UserWarning, match=f"matrix {letter} is not symmetric.*up to 1 %") as caught:
        read_model(tmp_path / "body.npz")
    proposed = re.search(r"write  (.+)  into body\.toml", str(caught[0].message)).group(1)
    for text in (f"{proposed}\n{port}", port.replace("mechanical", "acoustic"), None):
        if text is None:
            sidecar.unlink()  # signal pins, of which no product is a power
        else:
            sidecar.write_text(text)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            read_model(tmp_path / "body.npz")


def rotor():
    """Return the matrices of a rotor with gyroscopic matrix G, and its two natural frequencies.

    The poles of ``x'' + g y' + x = 0`` and ``y'' - g x' + y = 0`` are j w with w^2 - 1 = +-g w.
    """
    g = 0.5
    matrices = {"M": np.eye(2), "K": np.eye(2), "B": np.eye(2)}
    w = np.sqrt(1 + g**2 / 4)
    return matrices, np.array([[0.0, g], [-g, 0.0]]), np.array([w - g / 2, w + g / 2])


def save_rotor(folder, kind, **more):
    matrices, G, _ = rotor()
    arrays = matrices | {"G": G} | more
    if kind == "files":
        write_family(folder, "m.{}.mtx", **arrays)
        return folder / "m"
    path = folder / f"m.{kind}"
    if kind == "mat":
        scipy_io.savemat(path, arrays)
    elif kind == "npz":
        np.savez(path, **arrays)
    else:  # a sparse G in an archive
        path = folder / "m.npz"
        csc = sparse.csc_array(arrays.pop("G"))
        parts = {f"G.{key}": getattr(csc, key) for key in ("data", "indices", "indptr", "shape")}
        np.savez(path, **arrays, **parts, **{"G.format": np.array("csc")})
    return path


@pytest.mark.parametrize("kind", ["mat", "npz", "sparse", "files"])
def test_a_matrix_of_unknown_name_is_named_and_its_advice_works(kind, tmp_path):
    """Follow the proposed TOML line; the natural frequencies then are those of the gyroscope."""
    path = save_rotor(tmp_path, kind, ones=np.ones((3, 3)))
    with pytest.warns(UserWarning, match="matrix G of 2 x 2 is not used") as caught:
        plain = read_model(path)
    assert abs(plain.poles()) == pytest.approx(1.0)
    assert len(caught) == 1  # the array with three rows is not part of the model
    line = re.search(r"write  (.+)  into m.toml", str(caught[0].message))[1]
    sidecar(tmp_path, line)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = read_model(path)
    assert np.unique(np.round(abs(model.poles()), 9)) == pytest.approx(rotor()[2])


@pytest.mark.parametrize("kind", ["mat", "npz"])
def test_a_second_damping_matrix_is_to_be_added(kind, tmp_path):
    path = save_rotor(tmp_path, kind, E=0.1 * np.eye(2))
    with pytest.warns(UserWarning, match="add it to the damping matrix"):
        read_model(path)


@pytest.mark.parametrize("kind", ["mat", "npz"])
def test_a_name_in_matrices_must_be_in_the_file(kind, tmp_path):
    path = save_rotor(tmp_path, kind)
    side = sidecar(tmp_path, 'matrices = { E = "G", K = "nonsense" }\n')
    error = refused(path, "the file contains no matrix nonsense", side=side)
    assert "G" in error.expected
    refused(path, "only from OP4", side=sidecar(tmp_path, 'matrices = { H = "G" }\n'))


def test_names_of_matrices_do_not_apply_to_files_of_one_matrix(tmp_path):
    path = save_rotor(tmp_path, "files")
    side = sidecar(tmp_path, 'matrices = { E = "G" }\n')
    refused(path, "does not contain names of matrices", "files", side=side)


@pytest.mark.parametrize("kind", ["mat", "npz"])
def test_the_matrix_of_a_term_is_no_unknown_matrix(kind, tmp_path):
    """Of a mass on springs of 1 and 3: at p = 2, the stiffness is 1 + 2 * 3 = 7."""
    arrays = {"M": np.eye(2), "K": np.eye(2), "B": np.eye(2), "spring": 3 * np.eye(2)}
    if kind == "mat":
        scipy_io.savemat(tmp_path / "m.mat", arrays)
    else:
        np.savez(tmp_path / "m.npz", **arrays)
    sidecar(
        tmp_path,
        "[parameters]\np = { default = 2, low = 1, high = 3 }\n"
        '[[terms]]\nmatrix = "K"\nfactor = "p"\nname = "spring"\n',
    )
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        model = read_model(tmp_path / f"m.{kind}")
    assert model.transfer(np.zeros(1))[0] == pytest.approx(np.eye(2) / 7)
