"""Constant loss factors as springs and dampers: closed forms, passivity, energy that is lost."""

import numpy as np
import pytest
from support import (
    LinearModel,
    Port,
    UsageError,
    add_structural_damping,
    compute_causal_stiffness_factor,
    fit_relaxing_stiffness,
)


@pytest.mark.parametrize("eta", [0.002, 0.03, 0.3])
@pytest.mark.parametrize("band", [(0.0, 200e3), (50.0, 90.0), (1e3, 1e6)])
def test_a_relaxing_stiffness_loses_the_same_share_at_all_frequencies(eta, band):
    at = 0.6 * band[1]
    chi = fit_relaxing_stiffness(eta, at, band, 0.02 * eta)
    f = np.geomspace(max(band[0], band[1] / 1e4), band[1], 991)
    value = chi(2j * np.pi * f)
    assert value.imag / value.real == pytest.approx(np.full(f.size, eta), rel=0.05)
    # the relation of Kramers and Kronig: a constant loss makes stiffness a power of frequency
    power = (f / at) ** (2 * np.arctan(eta) / np.pi)
    assert np.abs(value) == pytest.approx(np.hypot(1, eta) * power, rel=0.02 * eta)
    assert (
        np.abs(value / compute_causal_stiffness_factor(f, eta, at) - 1).max()
        <= 1.01 * chi.error
        <= 0.03 * eta
    )
    assert compute_causal_stiffness_factor(at, eta, at) == pytest.approx(1 + 1j * eta, rel=1e-12)


def test_a_relaxing_stiffness_is_passive_at_all_frequencies():
    chi = fit_relaxing_stiffness(0.05, 1e3, (100.0, 1e4), 1e-4)
    wide = 2j * np.pi * np.geomspace(1e-3, 1e9, 700)
    assert (chi(wide).imag >= 0).all()
    assert chi.constant >= 0
    assert (chi.amplitudes > 0).all()
    assert chi(np.array([1e12]))[0].real == pytest.approx(chi.instantaneous_factor, rel=1e-6)


def test_a_stiffness_without_loss_is_constant():
    chi = fit_relaxing_stiffness(0.0, 1e3, (0.0, 1e4), 1e-3)
    assert chi(2j * np.pi * np.array([1.0, 1e3])) == pytest.approx([1, 1])


def test_a_narrow_band_comes_nearer_to_a_loss_that_is_not_causal():
    off = []
    for width in (1.2, 2.0, 4.0):
        chi = fit_relaxing_stiffness(0.02, 1e3, (1e3 / width, 1e3 * width), 1e-9, noncausal=True)
        f = np.geomspace(1e3 / width, 1e3 * width, 300)
        off.append(np.abs(chi(2j * np.pi * f) - (1 + 0.02j)).max())
        assert off[-1] == pytest.approx(chi.error, rel=0.02)
        assert off[-1] < 0.02 / np.pi * np.log(width**2)
    assert off == sorted(off)


def test_a_structurally_damped_chain_is_k_times_one_plus_j_eta():
    """Against the solution with the complex stiffness at each frequency, resonances included."""
    n, eta = 4, 0.02
    K = 1e6 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    M, B = np.diag([1.0, 2.0, 1.5, 1.0]) * 1e-3, np.eye(n)[:, [0, 3]]
    ports = (Port("left", "mechanical"), Port("right", "mechanical"))
    model = LinearModel(M=M, K=K, B=B, ports=ports)
    modes = np.sqrt(np.linalg.eigvals(np.linalg.solve(M, K)).real) / (2 * np.pi)
    chi = fit_relaxing_stiffness(eta, modes.min(), (modes.min() / 3, 2 * modes.max()), 2e-3 * eta)
    damped = add_structural_damping(model, chi)
    assert damped.symmetric
    f = np.sort(np.r_[np.geomspace(modes.min() / 3, 2 * modes.max(), 60), modes])
    for at, H in zip(f, damped.transfer(f), strict=True):
        complex_stiffness = K * compute_causal_stiffness_factor(at, eta, modes.min())
        exact = B.T @ np.linalg.solve(complex_stiffness - (2 * np.pi * at) ** 2 * M, B)
        assert np.abs(H / exact - 1).max() < 0.02
    poles = damped.poles()
    assert (poles.real < 0).all()
    ringing = poles[poles.imag > 0]
    assert -2 * ringing.real / np.abs(ringing) == pytest.approx(np.full(n, eta), rel=0.02)


def test_values_that_are_no_loss_are_refused():
    for arguments in ((-0.1, 1e3, (0, 1e4)), (0.1, 0.0, (0, 1e4)), (0.1, 1e3, (1e4, 1e3))):
        with pytest.raises(UsageError, match="the loss factor, its frequency"):
            fit_relaxing_stiffness(*arguments, 1e-3)
    first = LinearModel(A=-np.eye(2), B=np.ones((2, 1)))
    with pytest.raises(UsageError, match="applies only to second-order models"):
        add_structural_damping(first, fit_relaxing_stiffness(0.1, 1e3, (0, 1e4), 1e-2))
