"""Resonators, their answers in time, states without inertia, blocks: against closed forms."""

import dataclasses

import numpy as np
import pytest
from scipy.signal import StateSpace, lsim
from support import (
    Certificate,
    LinearModel,
    Port,
    Resonators,
    make_highest_modes_massless,
    simulate_resonators,
    tabulate_modes,
)

RNG = np.random.default_rng(12)
TIP = Port("mech", "mechanical")
CERTIFICATE = Certificate((0.0, 1.0), 1e-6, "told", True, True)


def modes(hertz, gain, *, ratio):
    """Resonators at ``hertz`` with one port."""
    omega = 2 * np.pi * np.asarray(hertz, dtype=float)
    gain = np.asarray(gain, dtype=float)[:, None]
    return Resonators(omega, 2 * ratio * omega, gain, np.zeros((1, 1)), (TIP,), CERTIFICATE)


# ---------------------------------------------------------------------------- answers in time

RATIOS = {"undamped": 0.0, "light": 0.01, "critical": 1.0, "nearly critical": 1 - 1e-10,
          "heavy": 30.0}  # fmt: skip


@pytest.mark.parametrize("name", RATIOS)
def test_modes_respond_to_piecewise_linear_loads(name):
    """Against scipy's ``lsim``; steps of a thousandth of a radian to three, and a block's end."""
    n, h = 4098, 0.1  # one step more than a block
    t = h * np.arange(n)
    load = 0.3 + np.interp(t, np.linspace(0, t[-1], 12), RNG.standard_normal(12))
    for omega in (0.01, 30.0):
        damp = 2 * RATIOS[name] * omega
        model = Resonators(np.array([omega]), np.array([damp]), np.array([[3.0]]),
                           np.array([[2.0]]), (TIP,), None)  # fmt: skip
        output, energy = simulate_resonators(model, t, load[:, None])
        system = StateSpace([[0, 1], [-(omega**2), -damp]], [[0], [3]], [[1, 0]], [[0]])
        _, _, states = lsim(system, load, t, X0=[3 * load[0] / omega**2, 0])
        size = abs(states[:, 0]).max()
        close = 1e-6 if "critical" not in name else 2e-4  # equal roots are moved apart
        np.testing.assert_allclose(output[:, 0], 3 * states[:, 0] + 2 * load, rtol=0,
                                   atol=close * 3 * size)  # fmt: skip
        stored = (states[:, 1] ** 2 + omega**2 * states[:, 0] ** 2) / 2 + load**2
        np.testing.assert_allclose(energy, stored, rtol=0, atol=close * stored.max())


# ----------------------------------------------------------------------------- without inertia


def test_the_certificate_states_where_inertia_ends_and_its_error():
    model = modes([0.5, 100.0], [2.0, 9.0], ratio=0.05)
    certificate = dataclasses.replace(CERTIFICATE, above=((2.0, 0.1), (4.0, 0.2), (8.0, 0.3)))
    model = dataclasses.replace(model, certificate=certificate)
    light = make_highest_modes_massless(model)
    frequency = np.linspace(0.0, 1.0, 2001)
    whole, less = model.to_linear_model(), light.to_linear_model()
    exact = whole.transfer(frequency)[:, 0, 0]
    error = (abs(less.transfer(frequency)[:, 0, 0] - exact) / abs(exact)).max()
    more = light.certificate.error_estimate - certificate.error_estimate
    assert error <= more + 1e-15  # rounding of both responses
    assert more <= 1.05 * error
    note = "modes at 100 Hz and above without inertia, whose effect is part of the error estimate"
    assert light.certificate.method == f"told; {note}"
    above = dict(light.certificate.above)
    at = np.array([2.0, 4.0])
    own = abs(less.transfer(at) / whole.transfer(at) - 1)[:, 0, 0]
    assert [above[2.0], above[4.0], above[8.0]] == pytest.approx([0.1 + own[0], 0.2 + own[1], 0.3])
    for tolerance, kept in ((1e-6 + 1.001 * more, 1), (1e-6 + 0.999 * more, 0)):
        assert make_highest_modes_massless(model, tolerance).massless == kept


# ----------------------------------------------------------------------------------- mode table


def chain(n, ends, damping):
    """Equal masses between equal springs; the port is at the first one."""
    K = 1e6 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    K[0, 0] = K[-1, -1] = ends
    return LinearModel(M=1e-3 * np.eye(n), K=K, E=damping(K), B=np.eye(n)[:, :1], ports=(TIP,))


def test_the_table_of_a_free_body_has_its_modes_and_not_its_flight():
    """A free chain: ``w = 2 sqrt(k/m) sin(j pi / 2n)``, shapes ``cos((2i - 1) j pi / 2n)``."""
    n = 7
    found = tabulate_modes(chain(n, 1e6, lambda K: 1e-7 * K))["modes"]
    j = np.arange(1, n)
    omega = 2 * np.sqrt(1e9) * np.sin(j * np.pi / 2 / n)
    assert [m["frequency_hz"] for m in found] == pytest.approx(omega / 2 / np.pi, rel=1e-6)
    assert [m["quality"] for m in found] == pytest.approx(1 / (1e-7 * omega), rel=1e-5)
    shares = 2 / n * np.cos(j * np.pi / 2 / n) ** 2 / 1e-3 / omega**2
    assert [m["couplings"]["mech"] for m in found] == pytest.approx(shares, rel=1e-4)


def test_the_table_of_modes_that_damping_couples():
    """A damper at one mass, by perturbation: ``w / Q`` is what it takes of each mode, to first
    order in it, and frequencies and shares stay."""
    n, added = 5, 0.02

    def damping(K):
        return np.diag([added, 0, 0, 0, 0])

    found = tabulate_modes(chain(n, 2e6, damping))["modes"]
    j = np.arange(1, n + 1)
    omega = 2 * np.sqrt(1e9) * np.sin(j * np.pi / 2 / (n + 1))
    gain2 = 2 / (n + 1) * np.sin(j * np.pi / (n + 1)) ** 2 / 1e-3
    assert [m["frequency_hz"] for m in found] == pytest.approx(omega / 2 / np.pi, rel=1e-5)
    assert [m["quality"] for m in found] == pytest.approx(omega / (added * gain2), rel=1e-3)
    shares = gain2 / omega**2
    assert [m["couplings"]["mech"] for m in found] == pytest.approx(shares, rel=1e-3)


def test_a_mode_that_lowers_a_capacitance_has_no_coupling_factor():
    """Damping that couples modes gives one of them a negative share, whose root is not a number."""
    damping = np.array([[0.1, 0.15], [0.15, 0.3]])
    ports = (TIP, Port("anode", "electrical"))
    model = LinearModel(M=np.eye(2), E=damping, K=np.diag([1.0, 4.0]), B=np.eye(2),
                        D=np.diag([0.0, 1.0]), ports=ports)  # fmt: skip
    first, second = (mode["couplings"]["anode"] for mode in tabulate_modes(model)["modes"])
    assert first == 0.0
    # the second mode alone: C = 1/4 F beside 1 F
    assert second == pytest.approx(np.sqrt(0.25 / 1.25), rel=0.02)
