"""The integrator of any composition against closed forms, its balances, and the loop's own law."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.linalg import expm

from kc2spice.core import laws as L
from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.physics.contact import ContactLaw, Normal
from kc2spice.reference.assemble import assemble
from kc2spice.reference.equilibrium import dc, operating_point
from kc2spice.reference.integrate import Result, transient
from kc2spice.reference.linear import ac


def balanced(result: Result, share: float) -> bool:
    energy = result.energy
    return abs(energy.residual) < share * energy.turnover


def test_rlc_answers_a_ramp_as_the_matrix_exponential() -> None:
    r, ind, c, edge = 100.0, 1e-3, 1e-6, 20e-6
    system = assemble(
        [L.Source("v", "voltage", L.Line.pulse(1.0, 1.0, edge)), L.TwoTerminal("r", 0, 1 / r),
         L.TwoTerminal("l", -1, 1 / ind), L.TwoTerminal("c", 1, c)],
        {"in": ["v.out", "r.a"], "mid": ["r.b", "l.a"], "out": ["l.b", "c.a"]},
    )  # fmt: skip
    times = np.linspace(0.0, 1e-3, 101)
    result = transient(system, 1e-3, 1e-10, times=times)
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
    # Half of what the source gives is lost in the end, whatever the resistance (nearly a step).
    shares = result.energy.shares
    assert shares["c"].after == pytest.approx(0.5 * c, rel=1e-4)


def test_current_of_a_capacitor_jumps_behind_a_corner_however_that_is_rounded() -> None:
    """i = C dV/dt: zero at the corner itself, as circuit simulators write it, C V / edge after."""
    c, corner, edge = 1e-6, 0.0305, 1e-7
    ramp = L.Line(((0.0, 0.0), (np.nextafter(corner, 0.0), 0.0), (corner + edge, 100.0)))
    system = assemble(
        [L.Source("v", "voltage", ramp), L.TwoTerminal("c", 1, c), L.TwoTerminal("r", 0, 1 / 1e3)],
        {"in": ["v.out", "c.a", "r.a"]},
    )
    result = transient(system, 0.031, 1e-9, times=np.array([0.0, 0.03, corner, corner + edge / 2]))
    at = np.searchsorted(result.time, [corner, corner + edge / 2])
    assert result.waves["c.a.through"][at] == pytest.approx([0.0, c * 100.0 / edge], abs=1.0)


def test_mass_spring_damper_rings_down() -> None:
    m, k, d = 1e-3, 1e3, 0.1
    system = assemble(
        [
            L.Mass("m", m, position=1e-4),
            L.TwoTerminal("k", -1, k, "displacement"),
            L.TwoTerminal("d", 0, d, "displacement"),
        ],
        {"x": ["m.a", "k.a", "d.a"]},
    )
    times = np.linspace(0.0, 0.05, 200)
    result = transient(system, 0.05, 1e-8, times=times)
    a, w = d / (2 * m), np.sqrt(k / m - (d / (2 * m)) ** 2)
    exact = 1e-4 * np.exp(-a * times) * (np.cos(w * times) + a / w * np.sin(w * times))
    assert np.abs(result.waves["m.a"] - exact).max() < 1e-10
    assert balanced(result, 1e-9)
    assert result.energy.shares["d"].dissipated == pytest.approx(5e-6 * (1 - np.exp(-2 * a * 0.05)),
                                                                 rel=0.02)  # fmt: skip


def test_sphere_bounces_on_a_spring_without_loss() -> None:
    m, k, h = 1e-3, 1e5, 1e-3
    system = assemble(
        [L.Mass("ball", m, gravity=9.81, position=h),
         ContactLaw("floor", ("a",), Normal(k), np.zeros(1))],
        {"y": ["ball.a", "floor.b"], "gnd": ["floor.a"]},
    )  # fmt: skip
    result = transient(system, 0.1, 1e-9)
    closes = [e.time for e in result.events if e.what == "a closes"]
    opens = [e.time for e in result.events if e.what == "a opens"]
    speed, w = np.sqrt(2 * 9.81 * h), np.sqrt(k / m)
    touch = 2 / w * (np.pi / 2 + np.arctan(9.81 / (w * speed)))
    assert closes[0] == pytest.approx(np.sqrt(2 * h / 9.81), rel=1e-9)
    assert opens[0] - closes[0] == pytest.approx(touch, rel=1e-8)
    period = touch + 2 * speed / 9.81
    assert len(closes) == int((0.1 - closes[0]) / period) + 1
    assert closes[-1] - closes[0] == pytest.approx((len(closes) - 1) * period, rel=1e-8)
    assert balanced(result, 1e-8)


def test_two_masses_exchange_momentum_through_a_contact_spring() -> None:
    system = assemble(
        [L.Mass("a", 1e-3, position=0.0, velocity=1.0), L.Mass("b", 3e-3, position=1e-3),
         ContactLaw("hit", ("a",), Normal(1e6), np.zeros(1))],
        {"left": ["a.a", "hit.a"], "right": ["b.a", "hit.b"]},
    )  # fmt: skip
    result = transient(system, 3e-3, 1e-10)
    va, vb = result.waves["a.a.rate"], result.waves["b.a.rate"]
    assert np.abs(1e-3 * va + 3e-3 * vb - 1e-3).max() < 1e-12
    assert va[-1] == pytest.approx(-0.5, rel=1e-9)
    assert vb[-1] == pytest.approx(0.5, rel=1e-9)
    half_period = np.pi * np.sqrt(0.75e-3 / 1e6)
    assert result.events[1].time - result.events[0].time == pytest.approx(half_period, rel=1e-9)


def piezo(name: str, stiffness: float = 2e7, mass: float = 1e-3) -> L.LinearBody:
    """One mode, 0.4 N/V, 100 nF clamped, whose top moves with the mode."""
    gain, c0 = 0.4, 100e-9
    ports = (L.Port("top", "displacement"), L.Port("anode", "electrical"))
    b = np.array([[1.0, gain]])
    return L.LinearBody(name, np.array([mass]), np.array([2.0]), np.array([stiffness]), b, b.T,
                        np.diag([0.0, c0]), ports)  # fmt: skip


def test_piezo_with_a_resistor_as_its_load() -> None:
    system = assemble(
        [
            piezo("p"),
            L.TwoTerminal("load", 0, 1 / 1e4),
            L.Source("push", "force", L.Line.pulse(1, 1, 1e-4)),
        ],
        {"hot": ["p.anode", "load.a"], "tip": ["p.top", "push.out"]},
    )
    times = np.linspace(0.0, 1e-3, 60)
    result = transient(system, 1e-3, 1e-10, times=times)
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
    response = ac(system, np.array([1e3, 2.2e4, 5e4]), "push")
    for f, x in zip(response["frequency"], response["p.top"], strict=True):
        s = 2j * np.pi * f
        volts = -s * g / (s * c + 1 / r)
        assert x == pytest.approx(1 / (m * s * s + d * s + k - g * volts), rel=1e-9)


def test_coils_with_resistance_keep_energy() -> None:
    y = np.linspace(-5e-3, 5e-3, 21)
    columns = np.column_stack((0 * y, 0.3 * np.cos(200 * y), 0.02 * y))
    table = L.ForceTable(y, columns, 1)
    coil = L.CoilForce("coil", table, np.array([5.0]), np.array([[1e-3]]))
    system = assemble(
        [coil, L.Mass("m", 1e-2), L.TwoTerminal("k", -1, 500.0, "displacement"),
         L.Source("v", "voltage", L.Line.pulse(2.0, 1.0, 1e-4))],
        {"y": ["coil.y", "m.a", "k.a"], "e": ["coil.a1", "v.out"]},
    )  # fmt: skip
    result = transient(system, 0.005, 1e-7)
    assert balanced(result, 1e-6)
    assert np.abs(result.waves["m.a"]).max() > 1e-5
    # The induced voltage is force over current times speed: seen as v - R i - L di/dt at rest end.
    late = operating_point(system)
    assert late.values["coil.i1"] == pytest.approx(0.0, abs=1e-15)


def test_imprint_solves_the_complementarity() -> None:
    contact = ContactLaw("c", ("top",), Normal(1e7), np.array([1e-6]))
    system = assemble(
        [piezo("p"), contact, L.Source("push", "displacement", L.Line.constant(0.0))],
        {"t": ["p.top", "c.top"], "b": ["c.b", "push.out"], "gnd": ["p.anode"]},
    )
    depth = np.linspace(0.0, 5e-6, 6)
    swept = dc(system, "push", -depth)
    soft = 1 / (1 / 2e7 + 1 / 1e7)
    assert swept["c.top.through"] == pytest.approx(soft * np.maximum(0, depth - 1e-6), rel=1e-9)


@pytest.mark.parametrize(
    ("laws", "joins", "words"),
    [
        ([L.TwoTerminal("r", 0, 1.0), L.Mass("m", 1.0)], {"n": ["r.a", "m.a"]}, "different kinds"),
        ([L.Mass("m", 1.0), L.Mass("m", 1.0)], {}, "one name"),
        ([L.Mass("m", 1.0)], {"n": ["m.b"]}, "no such pin"),
        ([L.Mass("m", 1.0)], {"n": ["m.a"], "o": ["m.a"]}, "two nets"),
        ([L.Source("v", "voltage", L.Line.constant(1.0)),
          L.Source("w", "voltage", L.Line.constant(2.0))], {"n": ["v.out", "w.out"]},
         "prescribe the same"),
    ],
)  # fmt: skip
def test_bad_compositions_are_refused(
    laws: list[L.Law], joins: dict[str, list[str]], words: str
) -> None:
    with pytest.raises(UsageError, match=words):
        assemble(laws, joins)


def test_falling_mass_without_a_start_has_no_equilibrium() -> None:
    with pytest.raises(SimulationError, match="equilibrium"):
        operating_point(assemble([L.Mass("m", 1.0, gravity=9.81)], {}))
