"""The integrator of any composition against closed forms, its balances, and the loop's own law."""

import numpy as np
import pytest
from scipy.linalg import expm
from support import (
    ContactForce,
    Declaration,
    DeclaredLaw,
    LinearModel,
    Port,
    Section,
    SimulationError,
    Trajectory,
    assemble_system,
    declare_contact,
    declare_point_mass,
    make_element_law,
    make_linear_waveform,
    make_sine_waveform,
    measured,
    solve_ac,
    solve_operating_point,
    solve_transient,
    voltage,
)
from support import laws as L


def touching(name: str, stiffness: float) -> DeclaredLaw:
    """A spring that pin ``a`` closes upwards against pin ``b``."""
    stated = declare_contact(("a",), (0.0,), ContactForce(stiffness), rigid=(False, False))
    return DeclaredLaw(name, stated, tuple(stated.compute_parameter_values(stated.keys()).values()))


def mass(
    name: str, kg: float, gravity: float = 0.0, start: tuple[float, float] | None = None
) -> DeclaredLaw:
    return DeclaredLaw(name, declare_point_mass(kg, gravity), (kg, gravity, 0.0, 0.0), start)


def balanced(result: Trajectory, share: float) -> bool:
    energy = result.energy
    return abs(energy.residual) < share * energy.turnover


def test_the_ramp_response_of_an_rlc_circuit_is_the_matrix_exponential() -> None:
    r, ind, c, edge = 100.0, 1e-3, 1e-6, 20e-6
    system = assemble_system(
        [L.IdealSource("v", "voltage", make_linear_waveform(((0, 0), (edge, 1)))),
         make_element_law("r", "resistor", r), make_element_law("l", "inductor", ind),
         make_element_law("c", "capacitor", c)],
        {"in": ["v.out", "r.a"], "mid": ["r.b", "l.a"], "out": ["l.b", "c.a"]},
    )  # fmt: skip
    times = np.linspace(0.0, 1e-3, 101)
    result = solve_transient(system, 1e-3, 1e-10, times=times)
    a = np.array([[0, 1 / c, 0, 0], [-1 / ind, -r / ind, 1 / ind, 0], [0, 0, 0, 1], [0, 0, 0, 0]])
    end = expm(a * edge) @ [0, 0, 0, 1 / edge]
    hold = end * [1, 1, 1, 0]
    exact = [
        (expm(a * t) @ [0, 0, 0, 1 / edge] if t <= edge else expm(a * (t - edge)) @ hold)[:2]
        for t in times
    ]
    assert np.abs(result.waves["c.a"] - np.array(exact)[:, 0]).max() < 1e-6
    assert np.abs(result.waves["r.a.through"] - np.array(exact)[:, 1]).max() < 1e-7
    assert np.abs(result.waves["v.out.through"] + np.array(exact)[:, 1]).max() < 1e-7
    assert balanced(result, 1e-9)
    # What comes in, by the exact current, and what of it is not in the capacitor in the end.
    nodes, weights = np.polynomial.legendre.leggauss(12)
    rise = 0.5 * edge * (1 + nodes)
    current = np.array([(expm(a * t) @ [0, 0, 0, 1 / edge])[1] for t in rise])
    came = 0.5 * edge * weights @ (current * rise / edge) + c * (exact[-1][0] - end[0])
    lost = came - 0.5 * c * exact[-1][0] ** 2
    assert result.energy.turnover == pytest.approx(came + lost, rel=1e-6)


def test_sphere_bounces_on_a_spring_without_loss() -> None:
    m, k, h = 1e-3, 1e5, 1e-3
    system = assemble_system(
        [mass("ball", m, 9.81, (h, 0.0)),
         touching("floor", k)],
        {"y": ["ball.a", "floor.b"], "gnd": ["floor.a"]},
    )  # fmt: skip
    result = solve_transient(system, 0.1, 1e-9)
    closes, opens = result.events[::2], result.events[1::2]
    speed, w = np.sqrt(2 * 9.81 * h), np.sqrt(k / m)
    touch = 2 / w * (np.pi / 2 + np.arctan(9.81 / (w * speed)))
    assert closes[0] == pytest.approx(np.sqrt(2 * h / 9.81), rel=1e-9)
    assert opens[0] - closes[0] == pytest.approx(touch, rel=1e-8)
    period = touch + 2 * speed / 9.81
    assert len(closes) == int((0.1 - closes[0]) / period) + 1
    assert closes[-1] - closes[0] == pytest.approx((len(closes) - 1) * period, rel=1e-8)
    assert balanced(result, 1e-8)


def test_every_element_reports_its_flow() -> None:
    """Under a ramp of voltage, or of displacement, each alone."""
    kinds = {"voltage": ["resistor", "capacitor", "inductor"], "displacement": ["spring", "damper"]}
    value, stop, t = 2e-3, 1e-3, np.linspace(0.0, 1e-3, 7)
    exact = {"resistor": t / value, "capacitor": value + 0 * t, "inductor": t**2 / (2 * value),
             "spring": value * t, "damper": value + 0 * t}  # fmt: skip
    for drive, found in kinds.items():
        for kind in found:
            ramp = L.IdealSource("ramp", drive, make_linear_waveform(((0, 0), (stop, stop))))
            system = assemble_system(
                [ramp, make_element_law("e", kind, value)], {"net": ["ramp.out", "e.a"]}
            )
            waves = solve_transient(system, stop, 1e-9, t).waves
            np.testing.assert_allclose(waves["e.a.through"], exact[kind], atol=1e-9 * value)
            np.testing.assert_allclose(waves["ramp.out.through"], -exact[kind], atol=1e-9 * value)


def piezo(name: str, stiffness: float = 2e7, mass: float = 1e-3) -> L.SecondOrderBody:
    """One mode, 0.4 N/V, 100 nF clamped, whose top moves with the mode."""
    gain, c0 = 0.4, 100e-9
    ports = (L.LawPort("top", "translation"), L.LawPort("anode", "electrical"))
    M, E, K = np.array([[[mass]], [[2.0]], [[stiffness]]])
    kinds = Port("top", "mechanical"), Port("anode", "electrical")
    model = LinearModel(M=M, E=E, K=K, B=np.array([[1.0, gain]]), D=np.diag([0.0, c0]), ports=kinds)
    return L.SecondOrderBody(name, model, ports)


def test_piezo_with_a_resistor_as_its_load() -> None:
    system = assemble_system(
        [
            piezo("p"),
            make_element_law("load", "resistor", 1e4),
            L.IdealSource("push", "force", make_linear_waveform(((0, 0), (1e-4, 1))), 1.0),
        ],
        {"hot": ["p.anode", "load.a"], "tip": ["p.top", "push.out"]},
    )
    times = np.linspace(0.0, 1e-3, 60)
    result = solve_transient(system, 1e-3, 1e-10, times=times)
    # States x, v, V, F: m v' = F - k x - d v + g V and C0 V' + g v + V / R = 0.
    m, k, d, g, c, r = 1e-3, 2e7, 2.0, 0.4, 100e-9, 1e4
    a = np.array([[0, 1, 0, 0, 0], [-k / m, -d / m, g / m, 1 / m, 0],
                  [0, -g / c, -1 / (r * c), 0, 0], [0, 0, 0, 0, 1], [0] * 5])  # fmt: skip
    ramp = np.array([0, 0, 0, 0, 1e4])
    end = (expm(a * 1e-4) @ ramp) * [1, 1, 1, 1, 0]
    exact = np.array([
        expm(a * t) @ ramp if t <= 1e-4 else expm(a * (t - 1e-4)) @ end for t in times
    ])  # fmt: skip
    assert np.abs(result.waves["p.top"] - exact[:, 0]).max() < 1e-14
    assert np.abs(result.waves["p.anode"] - exact[:, 2]).max() < 1e-8 * np.abs(exact[:, 2]).max()
    assert balanced(result, 1e-8)
    response = solve_ac(system, np.array([1e3, 2.2e4, 5e4]))
    for f, x in zip(response["frequency"], response["p.top"], strict=True):
        s = 2j * np.pi * f
        volts = -s * g / (s * c + 1 / r)
        assert x == pytest.approx(1 / (m * s * s + d * s + k - g * volts), rel=1e-9)


def test_falling_mass_without_a_start_has_no_equilibrium() -> None:
    with pytest.raises(SimulationError, match="equilibrium"):
        solve_operating_point(assemble_system([mass("m", 1.0, 9.81)], {}))


def test_a_shaken_mass_pulls_at_what_shakes_it() -> None:
    size, f, m = 1e-6, 1e3, 1e-3
    parts = [L.IdealSource("table", "displacement", make_sine_waveform(size, f)), mass("block", m)]
    system = assemble_system(parts, {"x": ["table.out", "block.a"]})
    times = np.linspace(0.0, 2e-3, 41)
    result = solve_transient(system, 2e-3, 1e-9, times)
    w = 2 * np.pi * f
    exact = m * size * w**2 * np.sin(w * times)
    assert np.abs(result.waves["table.out.through"] - exact).max() < 1e-9 * exact.max()


def test_inductors_in_series_share_the_voltage_of_a_ramp() -> None:
    """Index 2: v = (L1 + L2) i', with as much at each as its inductance."""
    system = assemble_system(
        [L.IdealSource("v", "voltage", make_linear_waveform(((0, 0), (1e-3, 1)))),
         make_element_law("one", "inductor", 1e-3), make_element_law("two", "inductor", 2e-3)],
        {"in": ["v.out", "one.a"], "mid": ["one.b", "two.a"]},
    )  # fmt: skip
    times = np.linspace(0.0, 1e-3, 11)
    waves = solve_transient(system, 1e-3, 1e-9, times).waves
    np.testing.assert_allclose(waves["two.a"], 2 / 3 * times / 1e-3, atol=1e-9)
    np.testing.assert_allclose(waves["one.a.through"], times**2 / 2e-3 / 3e-3, atol=1e-9)


def test_free_ringing_under_a_falling_ball_is_resolved() -> None:
    """112 periods, with the energy that they lose."""
    edge, stop, ball = 1e-4, 5e-3, 1e-9
    system = assemble_system(
        [piezo("p"), L.IdealSource("push", "force", make_linear_waveform(((0, 0), (edge, 1)))),
         mass("ball", ball, 9.81, (1e-2, 0.0)),
         touching("touch", 1e5)],
        {"tip": ["p.top", "push.out", "touch.a"], "y": ["ball.a", "touch.b"], "gnd": ["p.anode"]},
    )  # fmt: skip
    times = np.linspace(edge, stop, 50)
    result = solve_transient(system, stop, 1e-9, times)
    # States x, v, F, F'.
    a = np.array([[0, 1, 0, 0], [-2e7 / 1e-3, -2 / 1e-3, 1 / 1e-3, 0], [0, 0, 0, 1], [0] * 4])
    begun = (expm(a * edge) @ [0, 0, 0, 1 / edge]) * [1, 1, 1, 0]
    exact = [(expm(a * (t - edge)) @ begun)[0] for t in times]
    assert np.abs(result.waves["p.top"] - np.array(exact)).max() < 1e-14
    np.testing.assert_allclose(result.waves["ball.a"], 1e-2 - 9.81 / 2 * times**2, rtol=1e-9)
    assert balanced(result, 1e-8)


def test_rounding_of_a_derivative_does_not_shorten_the_steps() -> None:
    """A derivative of 1 kV whose rounding errors exceed the tolerance.

    ``u = GAIN (v - followed)`` with ``followed' = (v - followed) / LAG`` is ``GAIN LAG v'``, and
    ``x' = (u - x - 0.1 tanh(x)) / LAG`` follows it: ``x + 0.1 tanh(x) = GAIN LAG v'`` but for lags.
    """
    gain, lag = 2e5, 5e-9
    branches = (measured(voltage("v", "p", "n")),)
    states = {
        "followed": f"(v - followed)/{lag!r}",
        "x": f"({gain!r}*(v - followed) - x - 0.1*tanh(x))/{lag!r}",
    }
    declared = Declaration("follower", "derivative", Section, branches, states=states)
    source = L.IdealSource("s", "voltage", make_sine_waveform(1e3, 0.5 / np.pi))
    joins = {"net": ("s.out", "d.p"), L.GROUND: ("d.n",)}
    system = assemble_system([source, DeclaredLaw("d", declared, ())], joins)
    run = solve_transient(system, 1.0, 1.5e-9)
    assert len(run.time) < 800
    x = run.waves["d.x"][run.time > 0.1]
    exact = gain * lag * 1e3 * np.cos(run.time[run.time > 0.1])
    np.testing.assert_allclose(x + 0.1 * np.tanh(x), exact, atol=5e-8)


def test_a_step_of_a_signal_saturates_what_follows_it() -> None:
    """A node steps to 10 V at 0.5 s; an amplifier with a limited slew rate follows another device.

    ``c' = SLEW clip(FAST (v - c) / SLEW)`` rises with SLEW, then settles exponentially.
    """
    slew, fast = 20.0, 1e3
    branches = measured(voltage("enable", "p", "n")), voltage("v", "q", "n")
    step = Declaration(
        "step", "switch", Section, branches, content="0.5*(v - 10*above(enable - 0.5))^2"
    )
    states = {"c": f"{slew!r}*clip({fast!r}*(v - c)/{slew!r})"}
    follower = Declaration(
        "follower", "amplifier", Section, (measured(voltage("v", "q", "n")),), states=states
    )
    source = L.IdealSource("s", "voltage", make_linear_waveform(((0.0, 0.0), (1.0, 1.0))))
    laws = [source, DeclaredLaw("a", step, ()), DeclaredLaw("b", follower, ())]
    joins = {"in": ("s.out", "a.p"), "out": ("a.q", "b.q"), L.GROUND: ("a.n", "b.n")}
    run = solve_transient(assemble_system(laws, joins), 1.0, 1e-9, np.linspace(0, 1, 101))
    settled = 0.5 + (10 - slew / fast) / slew
    t = run.time
    exact = np.where(
        t < settled,
        slew * np.maximum(t - 0.5, 0.0),
        10 - slew / fast * np.exp(-fast * np.maximum(t - settled, 0.0)),
    )
    np.testing.assert_allclose(run.waves["b.c"], exact, atol=1e-6)
