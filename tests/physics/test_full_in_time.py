"""Full models at their ports: closed forms, matrices solved by hand, the usual code of contact."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import sparse
from support import (
    DeclaredLaw,
    LinearModel,
    Port,
    assemble_system,
    declare_point_mass,
    integrate_steps,
    laws,
    make_constant_waveform,
    make_element_law,
    make_linear_waveform,
    solve_ac,
    solve_operating_point,
)

M, K, ZETA = 2e-6, 8e4, 0.02
W = np.sqrt(K / M)
RAMP = 20e-6  # s, of the load
KICK = (laws.LawPort("tip", "translation"), laws.LawPort("anode", "electrical", "ret"))


def oscillator() -> LinearModel:
    """A mass on a spring with an electrode: 0.3 N/V, 1 nF clamped."""
    one = sparse.csc_array([[1.0]])
    return LinearModel(
        M=M * one, K=K * one, E=2 * ZETA * np.sqrt(M * K) * one, B=np.array([[1.0, 0.3]]),
        D=np.diag([0.0, 1e-9]),
        ports=(Port("tip", "mechanical"), Port("anode", "electrical", pins=("anode", "ret"))),
    )  # fmt: skip


def risen(t: np.ndarray) -> np.ndarray:
    """Response of a damped oscillator to a load that rises by 1 N/s, by Laplace transform."""
    d, w = ZETA * W, W * np.sqrt(1 - ZETA**2)
    wave = np.exp(-d * t) * (2 * ZETA / W * np.cos(w * t) + (2 * ZETA**2 - 1) / w * np.sin(w * t))
    return np.where(t > 0, (t - 2 * ZETA / W + wave) / K, 0.0)


def test_steps_follow_a_closed_form_with_an_error_of_second_order() -> None:
    force = laws.IdealSource("f", "force", make_linear_waveform(((0.0, 0.0), (RAMP, 1.0))))
    still = laws.IdealSource("v", "voltage", make_constant_waveform(0.0))
    body = laws.PortBody("x", oscillator(), KICK)
    joins = {"a": ("x.tip", "f.out"), "b": ("x.anode", "v.out")}
    system, errors = assemble_system((body, force, still), joins), []
    for count in (400, 800):
        step = 200e-6 / count
        run = integrate_steps(system, 0.0, step, count)
        exact = (risen(run.time) - risen(run.time - RAMP)) / RAMP
        errors.append(np.abs(run.waves["x.tip"] - exact).max() * K)
        # the charge of a short circuit is 0.3 C/m times the displacement, the current its rate
        current = 0.3 * np.gradient(exact, run.time)
        assert np.abs(run.waves["x.anode.through"] - current).max() < 0.02 * np.ptp(current)
    assert errors[1] < 1e-3
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_a_body_at_its_ports_is_the_same_as_with_its_states() -> None:
    """At rest and at a frequency, on a floating electrode with a capacitor and a spring."""
    full = oscillator()
    whole = {k: P.toarray() for k, P in zip("KEM", full.pencil.coefficients, strict=True)}
    states = laws.SecondOrderBody("x", replace(full, **whole), KICK)
    found = []
    for body in (states, laws.PortBody("x", full, KICK)):
        parts = (
            body, make_element_law("c", "capacitor", 2e-9), make_element_law("k", "spring", 3e4),
            DeclaredLaw("lifted", declare_point_mass(1e-3, -30.0), (1e-3, -30.0, 0.0, 0.0)),
            laws.IdealSource("f", "force", make_constant_waveform(0.1), 1.0),
        )  # fmt: skip
        joins = {"a": ("x.tip", "k.a", "lifted.a", "f.out"), "b": ("x.anode", "c.a")}
        system = assemble_system(parts, joins)
        point, waves = solve_operating_point(system), solve_ac(system, np.array([1e3, 2.9e4]))
        found.append((point["x.tip"], point["x.anode"], *waves["x.tip"], *waves["x.anode"]))
    np.testing.assert_allclose(found[1], found[0], rtol=1e-9)
    # by hand: 3 nF share the charge 0.3 u; 30 mN lift
    stiff = K + 3e4 + 0.3**2 / 3e-9
    assert found[1][0] == pytest.approx((0.1 + 0.03) / stiff, rel=1e-9)
    assert found[1][1] == pytest.approx(-0.3 * found[1][0] / 3e-9, rel=1e-9)
