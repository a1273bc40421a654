"""Errors of reduced models under the loads of a run, against scipy and closed forms."""

import numpy as np
import pytest
from scipy.signal import lsim
from support import (
    LinearModel,
    Port,
    ReductionsByOrder,
    compute_time_errors,
    compute_time_response,
    find_last_change,
)

PUSH = (Port("tip", "mechanical"),)
EVERY = [np.ones(1, bool)]


def oscillator(hertz, ratio=1e-4):
    w, one = 2 * np.pi * hertz, np.eye(1)
    return LinearModel(M=one, E=2 * ratio * w * one, K=w**2 * one, B=one, ports=PUSH)


def chain(masses, dashpot=0.0, ratio=0.0):
    """Masses between springs, the first one held; a ``dashpot`` at the end couples the modes."""
    links = np.eye(masses) - np.eye(masses, k=-1)
    K = 1e6 * links.T @ links
    E = ratio * 1e-4 * K
    E[-1, -1] += dashpot
    B = np.eye(masses)[:, -1:]
    return LinearModel(M=1e-3 * np.eye(masses), E=E, K=K, B=B, ports=PUSH)


@pytest.mark.parametrize("dashpot", [0.0, 0.5])
def test_responses_to_recorded_loads_are_those_of_scipy(dashpot):
    model = chain(4, dashpot, ratio=0.02)
    t = np.unique(np.r_[np.linspace(0, 2e-2, 400), 3e-3 + np.linspace(0, 1e-5, 20)])
    load = np.interp(t, [0, 3e-3, 3.01e-3, 8e-3, 8.01e-3], [0.0, 0.0, 2.0, 2.0, -1.0])[:, None]
    K, E, M = model.pencil.make_dense().coefficients
    A = np.block([[np.zeros((4, 4)), np.eye(4)], [-K / M[0, 0], -E / M[0, 0]]])
    B = np.r_[np.zeros((4, 1)), model.B / M[0, 0]]
    even = np.linspace(0, 2e-2, 40_001)
    _, exact, _ = lsim(
        (A, B, np.c_[model.C, np.zeros((1, 4))], 0), np.interp(even, t, load[:, 0]), even
    )
    found = compute_time_response(model, t, load)
    np.testing.assert_allclose(found[:, 0], np.interp(t, even, exact), atol=3e-4 * np.ptp(exact))


@pytest.mark.parametrize(("periods", "expected"), [(1, 0.0), (300, 1.0)])
def test_a_shifted_resonance_counts_as_far_as_loads_excite_it(periods, expected):
    """A resonance 0.1 % too high: nothing after a pulse of a period, all beats after 300."""
    exact, shifted = oscillator(1e3), oscillator(1.001e3)
    t = np.linspace(0, periods * 1e-3, 40 * periods + 1)
    errors = compute_time_errors(shifted, exact, t, np.sin(2e3 * np.pi * t)[:, None], EVERY)
    # amplitudes grow alike, phases part by pi 1e-3 a period
    if expected:
        assert 0.3 < errors["tip"] < expected
    else:
        assert errors["tip"] < 3e-3
    pointwise = abs(shifted.transfer(np.array([1e3])) / exact.transfer(np.array([1e3])) - 1)
    assert pointwise > 0.9


def test_models_without_the_motions_that_a_load_excites_are_off():
    """One state of eight: the static answer is exact, that to a short pulse is not."""
    full = chain(8, ratio=0.01)
    V = np.linalg.solve(full.K, full.B)
    small = LinearModel(
        **{key: V.T @ getattr(full, key) @ V for key in "MEK"}, B=V.T @ full.B, ports=PUSH
    )
    t = np.linspace(0, 5e-3, 2001)
    constant = np.ones((t.size, 1))
    assert compute_time_errors(small, full, t, constant, EVERY)["tip"] < 1e-3
    pulse = np.interp(t, [1e-3, 1.05e-3, 1.1e-3], [0.0, 1.0, 0.0])[:, None]
    assert compute_time_errors(small, full, t, pulse, EVERY)["tip"] > 0.5


def test_a_richer_model_is_made_of_the_full_one():
    full = chain(500, ratio=0.01)
    rich = ReductionsByOrder(full).make_enriched_model(10, (0.0, 1e3))
    assert rich.order == 70
    f = np.linspace(0, 1e3, 50)
    np.testing.assert_allclose(rich.transfer(f), full.transfer(f), rtol=1e-6)
    assert ReductionsByOrder(chain(40)).make_enriched_model(10, (0.0, 1e3)).order == 40


def test_loads_that_cancel_count_by_themselves():
    """An open electrode: its charge is the small difference of what voltage and force give."""

    def body(shift):
        w = 2e3 * np.pi * (1 + shift)
        one = np.eye(1)
        ports = (Port("tip", "mechanical"), Port("anode", "electrical"))
        return LinearModel(M=one, E=20 * one, K=w**2 * one, B=np.array([[1.0, 2.0]]),
                           D=np.diag([0.0, 1e-7]), ports=ports)  # fmt: skip

    exact = body(0.0)
    t = np.linspace(0, 5e-3, 4001)
    force = np.sin(600 * np.pi * t)
    charge = compute_time_response(exact, t, np.c_[force, 0 * t])[:, 1]
    # quasi-static: the voltage that draws this charge back
    gain = 1e-7 + 4 / (2e3 * np.pi) ** 2
    load = np.c_[force, -charge / gain]
    groups = [np.array([True, False]), np.array([False, True])]
    assert compute_time_errors(body(1e-4), exact, t, load, groups)["anode"] < 5e-3


def test_waves_are_compared_until_the_last_change():
    load = np.array([[0.0, 1.0], [1.0, 1.0], [1.0, 1.0 + 1e-12], [1.0, 1.0]])
    assert find_last_change(load) == 1
    assert find_last_change(np.ones((3, 2))) == 0
