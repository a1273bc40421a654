"""Structural damping of piezoelectric matrices with electrodes, against direct complex solutions.

A chain of masses has a potential on each of its lower masses, and an electrode at its end. The
whole coupled matrix is solved by numpy; nothing is eliminated there.
"""

import numpy as np
import pytest
from support import UsageError

import kc2spice as kc

MASSES, POTENTIALS = 24, 8  # displacements, and potentials between two electrodes
BAND = (0.0, 120.0)
SIDECAR = """
band = [0, 120]
[[ports]]
name = "drive"
kind = "electrical"
node = 200
[[ports]]
name = "tip"
kind = "mechanical"
node = 24
dof = "ux"
"""


def springs(stiffness):
    """Stiffness matrix of springs in a row that starts at ground."""
    stretch = np.eye(len(stiffness)) - np.eye(len(stiffness), k=-1)
    return stretch.T @ np.diag(stiffness) @ stretch


def matrices(loss):
    """K and M with displacements, then potentials; ``loss`` (springs,) are loss factors."""
    rng = np.random.default_rng(7)
    stiffness = 1e6 * np.exp(rng.uniform(-0.5, 0.5, MASSES))
    coupling = np.zeros((MASSES, POTENTIALS + 1))
    for k in range(POTENTIALS):  # each spring is a piece of ceramic between two potentials
        coupling[k, k : k + 2] = 3e-2, -3e-2
    dielectric = np.diag(np.full(POTENTIALS, 2.0)) - np.eye(POTENTIALS, k=1)
    dielectric -= np.eye(POTENTIALS, k=-1)
    capacitance = np.zeros((POTENTIALS + 1,) * 2)
    capacitance[:-1, :-1] = dielectric
    capacitance[-1, -1], capacitance[-1, -2], capacitance[-2, -1] = 1.0, -1.0, -1.0
    capacitance *= 1e-8
    K_uu = springs(stiffness) + 1j * springs(stiffness * loss)
    K = np.block([[K_uu, coupling], [coupling.T, -capacitance]])
    M = np.zeros(K.shape)
    M[:MASSES, :MASSES] = np.diag(np.exp(rng.uniform(-0.5, 0.5, MASSES)))
    return K, M


def response(K, M, frequency):
    """Charge and displacement per volt and newton by solutions of the whole matrix."""
    electrode, tip, free = len(K) - 1, MASSES - 1, len(K) - 1
    result = []
    for s in 2j * np.pi * frequency:
        P = K + s**2 * M
        loads = np.zeros((free, 2))
        loads[:, 0], loads[tip, 1] = -K[:free, electrode].real, 1.0
        x = np.vstack([np.linalg.solve(P[:free, :free], loads), [[1.0, 0.0]]])
        result.append(np.array([-K[electrode] @ x, x[tip]]))
    return np.array(result)


def natural_frequencies(K, M):
    """Frequencies [Hz] with a shorted electrode, at which the response has its peaks."""
    u, p = slice(0, MASSES), slice(MASSES, MASSES + POTENTIALS)
    condensed = K[u, u] - K[u, p] @ np.linalg.solve(K[p, p], K[p, u])
    return np.sqrt(np.linalg.eigvals(np.linalg.solve(M[u, u], condensed)).real) / (2 * np.pi)


def model_of(folder, K, M, more=""):
    nodes = np.r_[1 : MASSES + 1, 101 : 101 + POTENTIALS, 200]
    dofs = np.r_[np.full(MASSES, 1), np.full(POTENTIALS + 1, 9)]
    np.savez(folder / "piezo.npz", K=K, M=M, nodes=nodes, dofs=dofs)
    (folder / "piezo.toml").write_text(more + SIDECAR)
    return kc.read_model(folder / "piezo.npz")


TWO_MATERIALS = np.r_[np.full(POTENTIALS, 4e-3), np.full(MASSES - POTENTIALS, 2e-2)]


def test_a_complex_stiffness_beside_electrodes_has_the_response_of_the_whole_matrix(tmp_path):
    K, M = matrices(TWO_MATERIALS)
    frequency = np.array([1.0, 11.0, 60.0, 110.0])
    found = model_of(tmp_path, K, M).transfer(frequency)
    np.testing.assert_allclose(found, response(K, M, frequency), rtol=1e-7)


@pytest.mark.filterwarnings("ignore:no causal model")
@pytest.mark.parametrize("loss", [TWO_MATERIALS, np.full(MASSES, 1e-2)])
def test_the_reduction_is_passive_with_a_valid_error_estimate(tmp_path, loss):
    K, M = matrices(loss)
    rom = kc.reduce(model_of(tmp_path, K, M), tolerance=1e-3, norm="peak")
    assert rom.certificate.passive
    near = natural_frequencies(K.real, M)
    frequency = np.r_[np.linspace(1.0, BAND[1], 300), near[near < BAND[1]]]
    exact = response(K, M, frequency)
    error = np.abs(rom.transfer(frequency) - exact) / np.abs(exact).max(axis=0)
    estimate = rom.certificate.error_estimate
    assert error.max() <= estimate < 1e-3 + loss.max()
    assert kc.subcircuit(rom, "piezo").reduction.error_estimate < 1.1 * estimate + 1e-6


def test_losses_of_potentials_are_refused(tmp_path):
    K, M = matrices(TWO_MATERIALS)
    K[-1, -1] *= 1 + 0.01j
    with pytest.raises(UsageError, match="imaginary parts in the rows of the electric potentials"):
        model_of(tmp_path, K, M)


def test_two_statements_of_structural_damping_are_refused(tmp_path):
    K, M = matrices(TWO_MATERIALS)
    with pytest.raises(UsageError, match="defined twice"):
        model_of(tmp_path, K, M, "damping = { loss_factor = 0.02 }\n")
