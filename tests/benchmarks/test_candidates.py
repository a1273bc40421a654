"""Balancing by its definition, every candidate by its structure, and the choice by its errors."""

import numpy as np
import pytest
from scipy.linalg import expm

from kc2spice.bodies.piezo_stack import from_sector
from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.fem.piezo.keys import Chip
from kc2spice.rom.response import relative_error
from kc2spice.rom.structure import structure
from laboratory.candidates import SHIPPED, compare, shipped, table
from laboratory.reductions import balanced, candidates, gramians, of_pencil, projected

SMALL = {"sectors": 4, "rings": 2, "ring_spacing": 300e-6, "outer_rings": 2}
BAND = (0.0, 500e3)
ORDERS = (8, 12, 16)


@pytest.fixture(scope="module")
def small():
    """A coarse chip, its first-stage model and what the candidates make of both."""
    model = from_sector(assemble_kick(Chip(layers=3, mesh=SMALL)))
    large, reduction = shipped(model)
    return model, large, reduction, candidates(model, large, BAND, max(ORDERS))


def random_model():
    rng = np.random.default_rng(5)
    n = 5
    Q = [np.linalg.qr(rng.standard_normal((n, n)))[0] for _ in range(3)]
    M, E, K = (q @ np.diag(rng.uniform(0.5, 2.0, n)) @ q.T for q in Q)
    return M, 0.5 * E, K, rng.standard_normal((n, 2)), rng.standard_normal((3, n))


def test_gramians_are_the_energies_that_they_stand_for():
    """Impulse answers and free motions by the matrix exponential, energies by Simpson's rule."""
    M, E, K, B, C = random_model()
    n, step, steps = len(M), 0.01, 20_000
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ E]])
    advance = expm(step * A)
    start = np.hstack([np.vstack([0 * B, inverse @ B]), np.eye(2 * n)])
    motion = np.empty((steps + 1, *start.shape))
    for k in range(steps + 1):
        motion[k] = start
        start = advance @ start
    weight = np.r_[1, np.tile([4, 2], steps // 2 - 1), 4, 1] * step / 3
    impulse, free = motion[..., :2], C @ motion[:, :n, 2:]
    reach = np.einsum("t,tik,tjk->ij", weight, impulse, impulse)
    energy = np.einsum("t,toi,toj->ij", weight, free, free)
    found = gramians(M, E, K, B, C)
    expected = {
        "Pp": reach[:n, :n], "Pv": reach[n:, n:],
        "Qp": energy[:n, :n], "Qv": inverse @ energy[n:, n:] @ inverse,
    }  # fmt: skip
    for name, matrix in expected.items():
        np.testing.assert_allclose(getattr(found, name), matrix, atol=1e-7 * np.abs(matrix).max())


@pytest.mark.parametrize(
    ("variant", "reductor"),
    [("position-velocity", "SOBTpvReductor"), ("free velocity", "SOBTfvReductor")],
)
def test_balancing_is_that_of_pymor(small, variant, reductor):
    """Where the published method is a congruence for symmetric models, the responses are equal."""
    pytest.importorskip("pymor")
    from pymor.core.logger import set_log_levels
    from pymor.models.iosys import SecondOrderModel
    from pymor.reductors import sobt

    set_log_levels({"pymor": "ERROR"})
    large = small[1]
    omega = 2 * np.pi * BAND[1]  # time in units of the band, ports with a static compliance of one
    T = balanced(large, "position-velocity", np.empty((large.order, 0)))[:, :20]
    part = projected(large, np.linalg.qr(T)[0])
    B = part.B / np.sqrt(np.einsum("ki,ki->i", part.B, np.linalg.solve(part.K, part.B)))
    full = SecondOrderModel.from_matrices(omega**2 * part.M, omega * part.E, part.K, B, Cp=B.T)
    theirs = getattr(sobt, reductor)(full).reduce(8)
    found = balanced(part, variant, np.empty((part.order, 0)))[:, :8]
    found = np.linalg.qr(found)[0]
    M, E, K = (found.T @ X @ found for X in (omega**2 * part.M, omega * part.E, part.K))
    for s in (0.1j, 0.5j, 1j, 3j):
        ours = B.T @ found @ np.linalg.solve(s * s * M + s * E + K, found.T @ B)
        expected = theirs.transfer_function.eval_tf(s)
        np.testing.assert_allclose(ours, expected, atol=1e-6 * np.abs(expected).max())


def test_every_candidate_keeps_the_structure(small):
    model, _, _, ways = small
    static = model.transfer(np.zeros(1))[0].real
    for name, make in ways.items():
        for order in ORDERS:
            rom = make(order)
            assert rom.order == order
            found = structure(rom.pencil, BAND)
            assert found.stable
            assert found.passive
            if "static" in name or "Krylov" in name:
                gain = rom.transfer(np.zeros(1))[0].real
                np.testing.assert_allclose(gain, static, rtol=1e-9)


def test_all_orders_end_at_the_same_model(small):
    """With all states of the large model, every way that starts from it is that model again."""
    _, large, reduction, ways = small
    frequency = np.linspace(*BAND, 31)
    exact = large.transfer(frequency)
    whole = of_pencil(large, reduction.pencil)
    assert relative_error(whole.transfer(frequency), exact) < 1e-9
    # The Gramians' roots end at the root of double precision, the balanced directions with them.
    reached = ways["static vectors, balanced, position-velocity"](min(large.order, 30))
    assert relative_error(reached.transfer(frequency), exact) < 1e-2


@pytest.mark.slow
def test_the_one_that_ships_needs_the_fewest_states():
    """On the default chip, in contact and out of it."""
    found = compare(Chip(), (16, 20, 22))
    value = {(one.candidate, one.order): one for one in found}
    others = {one.candidate for one in found} - {SHIPPED}
    assert value[SHIPPED, 16].harmonic < 2e-5  # measured 1.3e-5
    assert value[SHIPPED, 20].harmonic < 2e-6  # 1.5e-6
    assert value[SHIPPED, 22].launch < 3e-4  # 1.4e-4
    for name in others:
        assert value[name, 20].harmonic > 100 * value[SHIPPED, 20].harmonic
        # Balancing around the static vectors launches as well; nothing launches better by far.
        assert value[name, 22].launch > 0.3 * value[SHIPPED, 22].launch
    assert table(found, "launch").count("\n") == len(others) + 2
