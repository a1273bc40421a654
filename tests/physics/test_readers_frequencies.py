"""Matrices that other tools wrote give the natural frequencies that these tools printed."""

from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import eigh

from kc2spice.bodies.readers import read_model

DATA = Path(__file__).parents[1] / "data" / "matrices"
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


def test_calculix_frequencies(tmp_path):
    side = with_sidecar(
        tmp_path, 'length = "mm"\n[[ports]]\nname="tip"\nkind="mechanical"\nnode=5\ndof="uz"\n'
    )
    model = read_model(DATA / "beam.sti", side)
    assert frequencies(model)[: len(CALCULIX)] == pytest.approx(CALCULIX, rel=1e-6)


def test_calculix_static_deflection_is_that_of_the_beam(tmp_path):
    """Bernoulli: F L^3 / (3 E I) + shear. Four coarse solids with a root that cannot contract are a
    little stiffer; a wrong unit would be a factor of ten.
    """
    (tmp_path / "beam.inp").write_bytes((DATA / "beam.inp").read_bytes())
    side = with_sidecar(
        tmp_path,
        'length = "mm"\nmesh = "beam.inp"\n[[ports]]\nname="tip"\nkind="mechanical"\n'
        'nodeset="TIP"\naxis="z"\n',
    )
    model = read_model(DATA / "beam.sti", side)
    compliance = float(model.transfer(np.array([0.0]))[0, 0, 0].real)
    length, width, height, modulus = 40e-3, 4e-3, 3e-3, 210e9
    bending = length**3 / (3 * modulus * width * height**3 / 12)
    shear = 1.2 * length / (modulus / 2.6 * width * height)
    assert compliance == pytest.approx(bending + shear, rel=0.06)


def test_nastran_punch_frequencies(tmp_path):
    side = with_sidecar(tmp_path, '[[ports]]\nname="tip"\nkind="mechanical"\nnode=5\ndof="uz"\n')
    found = frequencies(read_model(DATA / "wing.pch", side))
    assert found[2:] == pytest.approx(NASTRAN_DMIG, rel=1e-6)
    assert (found[:2] < 1e-2).all()  # the free wing moves rigidly


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
