"""Bands that nobody states, supports that are hardly there, and modes that no port excites."""

import numpy as np
import pytest
from scipy import sparse
from support import LinearModel, _load_scene_body, choose_natural_band, find_band_end, reduce_model

K_LINK, MASS = 1e6, 1e-2


def free_chain(n, ground=0.0, form=np.asarray):
    """Masses between springs, the first one on a spring of this share of the others."""
    K = K_LINK * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[0, 0], K[-1, -1] = K_LINK * (1 + ground), K_LINK
    return {"M": form(MASS * np.eye(n)), "K": form(K)}


def free_frequencies(n):
    """``2 sqrt(k/m) sin(j pi / 2n)``, j from 1: those of a chain that nothing holds."""
    j = np.arange(1, n)
    return 2 * np.sqrt(K_LINK / MASS) * np.sin(j * np.pi / (2 * n)) / (2 * np.pi)


@pytest.mark.parametrize(("n", "form"), [(50, np.asarray), (400, sparse.csc_array)])
def test_rigid_body_modes_suggest_no_band(n, form):
    """Rounding gives them frequencies of millihertz."""
    model = LinearModel(**free_chain(n, form=form), B=np.eye(n)[:, [0]], rayleigh=(0.0, 1e-9))
    exact = free_frequencies(n)
    low, high = choose_natural_band(model.pencil)
    assert low == 0.0
    assert high == pytest.approx(1.1 * exact[4], rel=1e-6)
    assert find_band_end(model.pencil, 3, 1e9) == pytest.approx(exact[2], rel=1e-6)
    assert find_band_end(model.pencil, 3, 0.5 * exact[2]) == 0.5 * exact[2]


def test_unknowns_without_inertia_suggest_no_band():
    parts = free_chain(20, 1.0)
    parts["M"][-1, -1] = 0.0
    model = LinearModel(**parts, B=np.eye(20)[:, [0]], rayleigh=(0.0, 1e-9))
    K, M = parts["K"], parts["M"][:-1, :-1]  # the last one follows its neighbour
    held = K[:-1, :-1] - np.outer(K[:-1, -1], K[-1, :-1]) / K[-1, -1]
    exact = np.sqrt(np.sort(np.linalg.eigvals(np.linalg.solve(M, held)).real)) / (2 * np.pi)
    assert choose_natural_band(model.pencil)[1] == pytest.approx(1.1 * exact[4], rel=1e-6)


def test_a_body_of_a_scene_is_reduced_over_the_band_of_the_scene():
    model = _load_scene_body("buzzer_7bb_20_6:disc")
    from support import find_scene_band, load_scene

    scene = load_scene("buzzer_7bb_20_6")
    low, high = 0.8 * scene.analysis.start, 1.2 * scene.analysis.stop
    assert model.band == pytest.approx((low, high))
    assert find_scene_band(scene.get_part("disc", where=""), scene, model) == model.band


@pytest.mark.filterwarnings("ignore:its own response")
@pytest.mark.parametrize("ground", [1e-9, 1e-11, 1e-12])
def test_a_soft_support_is_no_free_body(ground):
    """Entries of 1e6 have ten digits after the point: a spring of 1e-6 N/m is known."""
    n = 40
    parts = free_chain(n, ground)
    model = LinearModel(**parts, B=np.eye(n)[:, [5]], rayleigh=(0.0, 1e-6))
    rom = reduce_model(model, tolerance=1e-3, band=(0.0, 900.0), norm="peak")
    known = parts["K"][0, 0] - K_LINK  # as it is stored
    assert rom.transfer([0.0])[0, 0, 0].real * known == pytest.approx(1.0, rel=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("dashpot", [0.0, 1e-2])
def test_modes_that_no_port_excites_are_in_no_estimate(dashpot):
    """Equal and opposite forces on a free chain: no rigid-body motion, no symmetric modes."""
    n = 700
    parts = free_chain(n, form=sparse.lil_array)
    E = 1e-8 * parts["K"]
    for k in (n // 3, n - 1 - n // 3):
        E[k, k] += dashpot
    B = np.zeros((n, 1))
    B[0], B[-1] = -1.0, 1.0
    parts = {k: sparse.csc_array(P) for k, P in (parts | {"E": E}).items()}
    exact = free_frequencies(n)
    top = float(exact[8])
    model = LinearModel(**parts, B=B)
    rom = reduce_model(model, tolerance=1e-4, band=(0.0, top))
    assert rom.certificate.error_estimate <= 1e-4
    frequency = np.r_[1e-3, exact[:8] * 1.001, np.linspace(0.1, 0.99, 20) * top]
    found, full = rom.transfer(frequency)[:, 0, 0], model.transfer(frequency)[:, 0, 0]
    assert np.abs(found - full).max() <= 1e-4 * np.abs(full).max()
    if not dashpot:  # a rod pulled at both ends: tan(q n/2) / q per link, q from the dispersion
        s = 2j * np.pi * frequency
        q = 2 * np.arcsin(np.sqrt(-(s**2) * MASS / (4 * K_LINK * (1 + 1e-8 * s)) + 0j))
        closed = np.tan(q * n / 2) / np.tan(q / 2) / (K_LINK * (1 + 1e-8 * s))
        closed = closed - 1 / (K_LINK * (1 + 1e-8 * s))
        assert np.abs(found - closed).max() <= 2e-4 * np.abs(closed).max()
