"""The measurement of large bodies: its reference solutions, and a quick run of all kinds."""

import numpy as np
import pytest
from commands import python
from scipy import sparse
from scipy.sparse.linalg import spsolve

from bench.exact import FullModel
from bench.scale import elastic_matrices

BETA = 1e-7  # s


@pytest.mark.parametrize("shift", [0.0, 1e10])
@pytest.mark.parametrize("massless", [False, True])
def test_reference_solutions_agree_with_direct_ones(shift, massless):
    """A supported solid, also with the expansion of a free one, and with massless unknowns."""
    mass, stiffness, load = elastic_matrices(2)
    n, count = load.shape
    matrix = stiffness
    if massless:  # coupled to the first displacements, as potentials are
        spread = sparse.eye_array(n, 50, format="csc") * 1e9
        matrix = sparse.block_array([[stiffness, spread], [spread.T, -1e10 * sparse.eye_array(50)]])
    zero = sparse.csc_array((matrix.shape[0] - n,) * 2)
    inertia = sparse.block_diag([mass, zero])
    model = FullModel(sparse.csc_array(matrix), mass, load, np.zeros((count, count)), BETA, shift)
    frequencies = 0.0, 71e3
    answers, residual = model.response(frequencies)
    assert residual < 1e-9
    forces = np.vstack([load, np.zeros((zero.shape[0], count))]).astype(complex)
    for frequency, answer in zip(frequencies, answers, strict=True):
        s = 2j * np.pi * frequency
        x = spsolve(sparse.csc_array((1 + BETA * s) * matrix + s**2 * inertia), forces)[:n]
        assert answer == pytest.approx(load.T @ x, rel=1e-8)


@pytest.mark.slow
@pytest.mark.campaign
def test_bodies_of_all_kinds_are_measured_with_their_true_errors(tmp_path):
    """The true errors are below the error estimates, which are below the tolerance."""
    text = python(tmp_path, "-m", "bench.scale", "--quick")
    lines = (line.strip("| ").split("|") for line in text.splitlines())
    rows = [line for line in lines if line[0].strip().isdigit()]
    assert len(rows) == 6
    for row in rows:
        estimate, error = map(float, row[-2:])
        assert error <= 1.05 * estimate <= 1.05e-4
