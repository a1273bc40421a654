"""Structural damping of one oscillator in closed form, and ladders with real poles only."""

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.rom.linear import LinearModel, Port
from kc2spice.rom.reduce import reduce
from kc2spice.spice.realize import subcircuit


def test_one_oscillator_has_its_loss_at_resonance():
    """``1 / (k (1 + j eta) - m w^2)`` is ``1 / (j eta k)`` there."""
    k, m, eta = 4e4, 1e-2, 0.03
    model = LinearModel(M=np.eye(1) * m, K=np.eye(1) * k * (1 + 1j * eta), B=np.eye(1))
    resonance = np.sqrt(k / m) / (2 * np.pi)
    assert model.transfer([resonance])[0, 0, 0] == pytest.approx(1 / (1j * eta * k))
    with pytest.warns(UserWarning, match="no causal model has a structural damping of 0.03"):
        rom = reduce(model, tolerance=1e-4, band=(0.0, 2 * resonance), norm="pointwise")
    assert rom.transfer([resonance])[0, 0, 0] == pytest.approx(1 / (1j * eta * k), rel=1e-6)
    frequency = np.linspace(0.01, 1.99, 199) * resonance
    w = 2 * np.pi * frequency
    exact = 1 / (k * (1 + 1j * eta) - m * w**2)
    error = np.abs(rom.transfer(frequency)[:, 0, 0] / exact - 1).max()
    assert 0.5 * eta < error <= rom.certificate.error_estimate <= 1.3 * eta
    assert rom.certificate.passive


def test_what_is_no_single_loss_factor_is_refused():
    K = np.diag([1.0, 2.0])
    for bad in (K * (1 - 0.1j), K + 1j * np.diag([0.1, 0.1])):
        with pytest.raises(UsageError, match="without a single loss factor"):
            LinearModel(M=np.eye(2), K=bad, B=np.eye(2))
    model = LinearModel(M=np.eye(2), K=K * (1 + 0.1j), B=np.eye(2))
    with pytest.raises(UsageError, match="no state-space form"):
        model.state_space()
    with pytest.raises(UsageError, match="within a tolerance"):
        reduce(model, order=1, band=(0.0, 1.0))


@pytest.mark.parametrize("kind", ["signal", "mechanical"])
def test_a_ladder_of_real_poles_becomes_a_passive_model_of_first_order(kind):
    """An RC ladder written in second order, or overdamped masses: inertia 1e-9 does nothing."""
    n = 60
    K = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    K[-1, -1] = 1.0
    ports = (Port("tip", "mechanical"),) if kind == "mechanical" else ()
    full = LinearModel(M=1e-9 * np.eye(n), E=np.eye(n), K=K, B=np.eye(n)[:, [0]], ports=ports)
    rom = reduce(full, tolerance=1e-4, band=(0.0, 0.1), norm="peak")
    assert rom.first_order
    # In second order 16 states. Conservative ports keep their static answer exactly.
    assert rom.order == (7 if kind == "signal" else 8)
    assert rom.certificate.passive
    values, X = np.linalg.eigh(K)
    frequency = np.r_[0.0, np.geomspace(1e-5, 0.1, 100)]
    s = 2j * np.pi * frequency[:, None]
    exact = (X[0] ** 2 / (s + values)).sum(axis=1)
    error = np.abs(rom.transfer(frequency)[:, 0, 0] - exact).max() / np.abs(exact).max()
    assert error <= rom.certificate.error_estimate <= 1e-4
    subcircuit(rom, "ladder")
    parts = rom.pencil.dense().coefficients
    assert all(np.array_equal(P, P.T) for P in parts)
    assert all(np.linalg.eigvalsh(P)[0] > 0 for P in parts)
    heavy = LinearModel(M=np.eye(n), E=0.1 * np.eye(n), K=K, B=np.eye(n)[:, [0]], ports=ports)
    assert not reduce(heavy, tolerance=1e-2, band=(0.0, 0.1), norm="peak").first_order


@pytest.mark.parametrize(("tolerance", "states"), [(1e-2, 6), (1e-3, 8), (1e-4, 11)])
def test_two_ports_of_a_network_of_resistors_and_capacitors_stay_passive(tolerance, states):
    """In first order. Balanced truncation has 8, 11 and 13 states, and is not passive by its form.
    Real parts of the impedances at all frequencies show that the fit of rates and gains is."""
    n, rng = 40, np.random.default_rng(3)
    K = np.diag(rng.uniform(0.01, 0.1, n))
    for k in range(n - 1):
        K[k : k + 2, k : k + 2] += rng.uniform(0.5, 2) * np.array([[1, -1], [-1, 1]])
    E, B = np.diag(rng.uniform(0.5, 2, n)), np.eye(n)[:, [0, n // 2]]
    rom = reduce(LinearModel(E=E, K=K, B=B), tolerance=tolerance, band=(0.0, 0.3), norm="peak")
    assert rom.first_order
    assert rom.certificate.passive
    frequency = np.r_[0.0, np.geomspace(1e-5, 0.3, 150)]
    exact = np.array([B.T @ np.linalg.solve(K + 2j * np.pi * f * E, B) for f in frequency])
    error = (np.abs(rom.transfer(frequency) - exact) / np.abs(exact).max(axis=0)).max()
    assert error <= rom.certificate.error_estimate <= tolerance
    wide = rom.transfer(np.geomspace(1e-6, 1e3, 60))
    assert np.linalg.eigvalsh(wide.real).min() > 0
    assert rom.poles().real.max() < 0
    assert np.abs(rom.poles().imag).max() == 0
    assert rom.order == states
