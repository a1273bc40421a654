"""Matrices that other tools wrote give the natural frequencies that these tools printed."""

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh
from scipy.sparse.linalg import eigsh
from support import read_model

DATA = Path(__file__).parents[1] / "data" / "matrices"
# A folder with the files that tests/data/matrices/README.md lists as not shipped.
ELSEWHERE = Path(os.environ.get("KC2SPICE_FOREIGN_MATRICES", "nowhere"))
# Cycles per time of beam.dat, test_case.f06 and inboard.out, seven digits each.
CALCULIX = (1610.114, 2136.937, 10642.51, 13816.11, 19568.23, 32884.14)
NASTRAN_DMIG = (2.114057e1, 2.135569e1, 1.287332e2, 1.297476e2, 4.371801e2, 4.382013e2,
                1.258988e3, 1.259566e3)  # fmt: skip
NASTRAN_OP4 = (6.129345e0, 6.130134e0, 2.363188e1, 7.051064e1, 7.079153e1, 1.048085e2)


def frequencies(model):
    """Natural frequencies [Hz] of the undamped model, ascending."""
    K, M = (m.toarray() for m in (model.K, model.M))
    try:
        squares = eigh(K, M, eigvals_only=True)
    except np.linalg.LinAlgError:  # the mass is only semi-definite
        with np.errstate(divide="ignore"):
            squares = 1 / eigh(M, K, eigvals_only=True)[::-1]
    return np.sqrt(np.abs(squares)) / (2 * np.pi)


def with_sidecar(tmp_path, text):
    path = tmp_path / "sidecar.toml"
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    ("name", "rigid", "expected"), [("beam.sti", 0, CALCULIX), ("wing.pch", 2, NASTRAN_DMIG)]
)
def test_calculix_and_nastran_punch_frequencies(tmp_path, name, rigid, expected):
    tip = 'length = "mm"\n[[ports]]\nname="tip"\nkind="mechanical"\nnode=5\ndof="uz"\n'
    found = frequencies(read_model(DATA / name, with_sidecar(tmp_path, tip)))
    assert found[rigid : rigid + len(expected)] == pytest.approx(expected, rel=1e-6)
    assert (found[:rigid] < 1e-2).all()  # the free wing moves rigidly


def test_nastran_op4_frequencies(tmp_path):
    """Craig-Bampton matrices: with the boundary fixed, the modes of the run are left."""
    rows = [f"{grid},{c}" for grid in (3, 11, 19, 27) for c in range(1, 7)]
    rows += [f"{2995001 + i},0" for i in range(8)]
    (tmp_path / "rows.csv").write_text("\n".join(rows))
    side = with_sidecar(
        tmp_path,
        'dofs = "rows.csv"\n[[fixed]]\nnodes = [3, 11, 19, 27]\n'
        '[[ports]]\nname="in"\nkind="input"\nnode=2995001\ndof="scalar"\n'
        '[[ports]]\nname="out"\nkind="output"\nnode=2995002\ndof="scalar"\n',
    )
    found = frequencies(read_model(DATA / "inboard.op4", side))
    assert found[:6] == pytest.approx(NASTRAN_OP4, rel=1e-6)


def lowest(model, count, shift):
    """Natural frequencies [Hz] of a large model, rigid motions as zero."""
    squares = eigsh(model.K, count, M=model.M, sigma=shift, return_eigenvectors=False)
    return np.sqrt(np.abs(np.sort(squares))) / (2 * np.pi)


def test_ansys_full_frequencies(tmp_path):
    """The file that ships with the reader, and what its documentation prints, to a millihertz."""
    pytest.importorskip("ansys.mapdl.reader", reason="pip install ansys-mapdl-reader")
    from ansys.mapdl.reader import examples

    side = with_sidecar(tmp_path, '[[ports]]\nname="p"\nkind="mechanical"\nnode=100\ndof="uz"\n')
    found = lowest(read_model(examples.fullfile, side), 4, 1.0)
    assert found == pytest.approx((1283.200, 1283.200, 5781.975, 6919.399), rel=1e-6)


def elsewhere(*names):
    missing = [name for name in names if not (ELSEWHERE / name).is_file()]
    if missing:
        pytest.skip(f"KC2SPICE_FOREIGN_MATRICES has no {', '.join(missing)}")
    return ELSEWHERE


def test_abaqus_coordinate_frequencies(tmp_path):
    """A free rotor; its owner's test compares with 104.6370132606291 Hz at a hundredth of K."""
    folder = elsewhere("rotorDiscTestSTIF1.mtx", "rotorDiscTestMASS1.mtx")
    for name in ("rotorDiscTestSTIF1.mtx", "rotorDiscTestMASS1.mtx"):
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    rows = "".join(f"{k // 3 + 1},{k % 3 + 1}\n" for k in range(345))
    (tmp_path / "rows.csv").write_text(rows)
    path = tmp_path / "rotor.toml"
    path.write_text(
        'files = { K = "rotorDiscTestSTIF1.mtx", M = "rotorDiscTestMASS1.mtx" }\n'
        'dofs = "rows.csv"\n[[ports]]\nname="p"\nkind="mechanical"\nnode=5\ndof="uz"\n'
    )
    found = lowest(read_model(path), 8, -1e4)
    assert (found[:6] < 1e-2).all()
    assert found[6] == pytest.approx(10 * 104.6370132606291, rel=1e-9)


def test_ansys_harwell_boeing_frequencies(tmp_path):
    """A simply supported BEAM188 of 100 elements, E = 210 GPa, 8000 kg/m3, 0.3 m high, 100 m long:
    Bernoulli's frequencies, less what shear and the linear element take."""
    names = [f"{letter}Matrix.{kind}" for letter in "KM" for kind in ("matrix", "mapping")]
    folder = elsewhere(*names)
    for name in names:
        (tmp_path / name).write_bytes((folder / name).read_bytes())
    path = tmp_path / "beam.toml"
    path.write_text(
        'files = { K = "KMatrix.matrix", M = "MMatrix.matrix" }\n'
        '[[ports]]\nname="p"\nkind="mechanical"\nnode=52\ndof="uy"\n'
    )
    found = lowest(read_model(path), 4, -1e-3)
    first = np.pi / 2 * np.sqrt(210e9 * 0.3**2 / (12 * 8000)) / 100**2
    assert found == pytest.approx(first * np.arange(1, 5) ** 2, rel=3e-3)
    assert found[0] == pytest.approx(first, rel=2e-4)
