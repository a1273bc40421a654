"""Parts that state their physics as expressions, in ngspice and in the independent integrator,
against closed forms of textbooks."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from scipy.special import ellipk
from support import (
    BuiltScene,
    Declaration,
    DeclaredPart,
    Printer,
    Waveforms,
    add_results_and_sources,
    assemble_system,
    branch,
    displacement,
    form_verdict,
    get_scene_laws,
    list_dialect_names,
    load_scene,
    measured,
    parttype,
    solve_laws,
    solve_transient,
    voltage,
    write_dialect_files,
    write_subcircuit_items,
)

import kc2spice as kc

EPS = 8.8541878188e-12
AREA, GAP, K = 1e-8, 2e-6, 1.5


def both(scene, name):
    """A wave of a scene by ngspice and by the laws."""
    waves = kc.run(scene).waves
    scale = next(iter(waves))
    law = solve_laws(
        add_results_and_sources(BuiltScene(load_scene(scene), {})),
        Waveforms({scale: waves[scale]}, {}),
    ).results
    return waves[scale], waves[name], law[name]


def plate(last):
    return {
        "name": "plate",
        "plate": {"part": "parallel_plate", "area": AREA, "gap": GAP, "travel": 1.5e-6,
                  "stop": 1e4, "pins": {"plus": "drive.out", "a": "spring.a"}},
        "spring": {"part": "spring", "stiffness": K},
        "drive": {"part": "source", "dc": 0.0},
        "analysis": {"type": "dc", "sweep": "drive.dc", "from": 0.0, "to": last, "points": 100},
        "solver": {"reltol": 1e-7},
    }  # fmt: skip


def test_a_plate_closes_a_third_of_its_gap_and_snaps_in():
    pull_in = np.sqrt(8 * K * GAP**3 / (27 * EPS * AREA))
    volts, *found = both(plate(0.999 * pull_in), "plate.x")
    for x in found:
        np.testing.assert_allclose(K * x * (GAP - x) ** 2, EPS * AREA * volts**2 / 2, rtol=1e-5)
        assert 0.3 * GAP < x[-1] < GAP / 3
    beyond = kc.run(plate(1.01 * pull_in)).waves["plate.x"]
    assert beyond[-2] < GAP / 2 < 1.5e-6 < beyond[-1]


def test_a_charge_behind_ideal_sources_flows_as_it_changes():
    """``i = C' v + C v'`` of a comb whose motion and voltage are both prescribed: the integrator
    has nothing left to solve for, and the current is a derivative of what it is given."""
    scene = {
        "name": "forced",
        "comb": {"part": "comb_drive", "fingers": 100, "thickness": 20e-6, "gap": 2e-6,
                 "overlap": 10e-6, "travel": 8e-6, "pins": {"plus": "drive.out", "a": "push.out"}},
        "drive": {"part": "source", "sine": {"amplitude": 10.0, "frequency": 1e3}},
        "push": {"part": "source", "kind": "displacement",
                 "sine": {"amplitude": 5e-6, "frequency": 300.0}},
        "load": {"part": "resistor", "resistance": 1e3, "pins": {"a": "far.out"}},
        "far": {"part": "source", "sine": {"amplitude": 1.0, "frequency": 1e3}},
        "solver": {"stop": 2e-3, "max_step": 1e-6, "reltol": 1e-6},
    }  # fmt: skip
    times, *found = both(scene, "comb.i")
    w, u = 2e3 * np.pi, 600 * np.pi
    slope = 2 * 100 * EPS * 20e-6 / 2e-6
    v, x = 10 * np.sin(w * times), 5e-6 * np.sin(u * times)
    exact = slope * ((10e-6 + x) * 10 * w * np.cos(w * times) + 5e-6 * u * np.cos(u * times) * v)
    later = times > 1e-5  # a transient begins at rest
    for i in found:
        np.testing.assert_allclose(i[later], exact[later], atol=1e-4 * exact.max())


def test_a_coil_in_motion_takes_few_steps():
    """The flux depends on the stroke: an error estimate by its slope at an earlier step sees an
    error that no shorter step makes smaller, and needs tens of thousands of them for this."""
    (network,) = get_scene_laws(BuiltScene(load_scene("loudspeaker"), {})).networks
    assert (
        solve_transient(assemble_system(network.laws, network.joins), 5e-3, 1e-9).time.size < 2000
    )


COIL = {"part": "voice_coil", "resistance": 6.0, "inductance": 5e-4, "bl": 5.0, "cms": 1e-3,
        "damping": 0.5}  # fmt: skip


def test_a_voice_coil_at_large_strokes():
    """``x / Cms(x) = Bl(x) v / R`` under a constant voltage, and ``v = Bl(x) x'`` when pushed at a
    constant velocity, with all terms of Bl(x) and Cms(x) of the same size."""
    bl1, bl2, cms1, cms2 = 400.0, 2e5, 0.05, 30.0
    coil = COIL | {"bl1": bl1, "bl2": bl2, "cms1": cms1, "cms2": cms2}
    sweep = {"type": "dc", "sweep": "drive.dc", "from": -1.2, "to": 1.2, "points": 9}
    drive = {"part": "source", "dc": 0.0}
    on_spring = coil | {"pins": {"plus": "drive.out", "a": "spring.a"}}
    volts, *found = both({"name": "coil", "coil": on_spring, "drive": drive, "analysis": sweep,
                          "spring": {"part": "spring", "stiffness": 100.0},
                          "solver": {"reltol": 1e-7}}, "coil.x")  # fmt: skip

    def unbalanced(x, i):
        return 100.0 * x + x / (1e-3 + cms1 * x + cms2 * x**2) - (5.0 + bl1 * x + bl2 * x**2) * i

    exact = [brentq(unbalanced, -4e-3, 4e-3, args=(v / 6.0,)) for v in volts]
    for x in found:
        np.testing.assert_allclose(x, exact, rtol=1e-5, atol=1e-9)
    speed = {"part": "source", "kind": "displacement", "pwl": [[0.0, 0.0], [0.1, 4e-3]]}
    pushed = coil | {"pins": {"plus": "load.a", "a": "push.out"}}
    load = {"part": "resistor", "resistance": 1e6}
    times, *found = both({"name": "coil", "coil": pushed, "load": load, "push": speed,
                          "solver": {"stop": 0.1, "max_step": 1e-3}}, "coil.v")  # fmt: skip
    x = 0.04 * times
    for v in found:
        late = (times > 0.01) & (times < 0.099)
        exact = 0.04 * (5.0 + bl1 * x + bl2 * x**2)
        np.testing.assert_allclose(v[late], exact[late], rtol=1e-3)


def test_a_voice_coil_at_small_signals():
    """The impedance is ``R + s L + s Bl^2 / (m s^2 + c s + 1 / Cms)``."""
    scene = {
        "name": "coil",
        "coil": {**COIL, "pins": {"plus": "drive.out", "a": "cone.a"}},
        "cone": {"part": "mass", "mass": 0.01},
        "drive": {"part": "source", "kind": "voltage", "dc": 0.0, "ac": 1.0},
        "analysis": {"type": "ac", "start": 5.0, "stop": 5e3, "points": 60},
    }
    f, *found = both(scene, "coil.i")
    s = 2j * np.pi * f.real
    impedance = 6.0 + s * 5e-4 + s * 25.0 / (0.01 * s**2 + 0.5 * s + 1e3)
    for i in found:
        np.testing.assert_allclose(1 / i, impedance, rtol=1e-8)


@pytest.mark.parametrize("amplitude", [1e-5, 1e-4, 3e-4])
def test_a_cubic_spring_swings_faster_the_further_it_swings(amplitude):
    """Duffing's period without damping: ``4 K(m) / sqrt(w0^2 + b A^2)``, a complete elliptic
    integral; 2e-5 is the phase that 400 steps a period lose by the trapezoidal rule."""
    k, h, mass = 100.0, 5e9, 25e-6
    stiff = k + h * amplitude**2
    period = 4 * ellipk(h * amplitude**2 / (2 * stiff)) / np.sqrt(stiff / mass)
    scene = {
        "name": "duffing",
        "spring": {"part": "cubic_spring", "stiffness": k, "cubic": h, "pins": {"a": "mass.a"}},
        "mass": {"part": "mass", "mass": mass, "position": amplitude},
        "solver": {"reltol": 1e-6, "max_step": period / 400, "stop": 5.1 * period},
        "gravity": 0.0,
    }
    times, *found = both(scene, "spring.x")
    for x in found:
        t = np.interp(np.linspace(0, 1, x.size), np.linspace(0, 1, times.size), times)
        down = np.flatnonzero((x[:-1] > 0) & (x[1:] <= 0))
        crossed = t[down] + (t[down + 1] - t[down]) * x[down] / (x[down] - x[down + 1])
        assert np.diff(crossed).mean() == pytest.approx(period, rel=1e-4)


def test_a_force_that_is_off_is_in_the_balance():
    """Of the stop of a plate, by a hundredth; the run itself keeps 1e-3 of what is turned over."""
    scene = load_scene("plate_pull_in", {"solver.stop": "6 ms"})
    waves = kc.run(scene).waves
    build = add_results_and_sources(BuiltScene(scene, {}))
    wrong = {**waves, "plate.force": 1.01 * waves["plate.force"]}
    good, bad = (
        dict(form_verdict(Waveforms(data, {}), build).balances)["plate"]
        for data in ({**waves}, wrong)
    )
    assert good.relative_imbalance < good.limit < bad.relative_imbalance


def test_beyond_its_limit_a_part_fails_by_name():
    scene = {
        "name": "soft",
        "spring": {"part": "cubic_spring", "stiffness": 100.0, "cubic": -1e9,
                   "pins": {"a": "push.out"}},
        "push": {"part": "source", "kind": "displacement", "dc": "0.3 mm"},
        "analysis": {"type": "op"},
    }  # fmt: skip
    with pytest.raises(kc.errors.SimulationError, match="tangent stiffness of spring"):
        kc.run(scene)


@pytest.mark.parametrize(("core", "magnet", "amps"), [(0.0, 0.0, 0.5), (4.5e5, 300.0, 0.2)])
def test_a_keeper_rests_where_spring_force_and_magnetic_force_are_equal(core, magnet, amps):
    """Force ``flux^2 / (MU_0 area)`` of two gaps, against the root of a cubic in what is left."""
    area, gap, turns, k = 1e-4, 2e-3, 400.0, 3e5
    scene = {
        "name": "keeper",
        "yoke": {"part": "reluctance", "area": area, "gap": gap, "gaps": 2, "core": core,
                 "magnet": magnet, "turns": turns, "resistance": 1.0, "travel": 1.8e-3,
                 "pins": {"plus": "drive.out", "a": "keeper.a"}},
        "keeper": {"part": "spring", "stiffness": k},
        "drive": {"part": "source", "kind": "current", "dc": amps},
        "analysis": {"type": "op"},
    }  # fmt: skip
    mu = 4e-7 * np.pi
    whole, left = turns * amps + magnet, np.polynomial.Polynomial([core, 2 / (mu * area)])
    balance = k * np.polynomial.Polynomial([gap, -1]) * left**2 * mu * area - whole**2
    rest = gap - max(r.real for r in balance.roots() if abs(r.imag) < 1e-12)
    assert kc.run(scene).waves["yoke.x"][-1] == pytest.approx(rest, rel=1e-6)


@pytest.mark.parametrize(("stop", "warned"), [(0.4e-3, False), (0.8e-3, True)])
def test_a_second_impact_on_a_stop_is_reported(stop, warned):
    """On a spring, in pieces of sines: between strikes near pull-in an error of steps grows."""
    m, k, hard, travel, speed = 1e-6, 100.0, 1e6, 2e-6, 0.05
    comb = {"fingers": 10, "thickness": "1 um", "gap": "1 um", "overlap": "1 mm"}
    result = kc.run({
        "name": "bouncing",
        "drive": {"part": "source", "dc": 0.0},
        "comb": {"part": "comb_drive", "travel": travel, "stop": hard, **comb, "restitution": 1.0,
                 "pins": {"plus": "drive.out", "a": "mass.a"}},
        "mass": {"part": "mass", "mass": m, "velocity": speed},
        "spring": {"part": "spring", "stiffness": k, "pins": {"a": "mass.a"}},
        "analysis": {"type": "transient", "stop": stop},
    })  # fmt: skip
    w, inner, rest = np.sqrt(k / m), np.sqrt((k + hard) / m), hard * travel / (k + hard)
    angle = np.arcsin(travel * w / speed)  # of the free motion where it meets the stop
    off, fast = travel - rest, speed * np.cos(angle) / inner
    closed, free = 2 * np.arctan2(fast, off) / inner, (np.pi + 2 * angle) / w
    since = (result.waves["time"] - angle / w) % (closed + free)
    inside = rest + off * np.cos(inner * since) + fast * np.sin(inner * since)
    outside = speed / w * np.sin(np.pi - angle + w * (since - closed))
    exact, share = np.where(since < closed, inside, outside), np.gradient(result.waves["time"])
    error = np.sqrt(share @ (result.waves["comb.x"] - exact) ** 2 / (share @ exact**2))
    assert error < 1e-3
    (strikes,) = (c for c in result.record["checks"] if c["name"] == "strikes of comb")
    assert strikes["passed"] is not warned


class RegulatorKeys(kc.Section):
    """PI regulator of a voltage, whose integral stands still at its limit."""

    setpoint: float = 1.0
    kp: float = 2.0
    ki: float = 4e3
    most: float = 1.5


REGULATOR = DeclaredPart(
    Declaration(
        "regulator",
        "PI regulator with a limit",
        RegulatorKeys,
        (measured(voltage("v", "measured", "ref")), voltage("u", "out", "ref")),
        signals={"error": "setpoint - v", "wanted": "kp*error + integral"},
        states={"integral": "ki*error*(1 - above(wanted - most) - above(-wanted - most))"},
        content="0.5*(u - most*clip(wanted/most))^2",  # behind an ohm
    )
)


def test_states_and_signals_are_those_of_the_stated_controller(monkeypatch):
    """A capacitor held at 3 V through 10 Ohm and the ohm, loaded beyond the limit for 1 ms, by
    scipy."""
    monkeypatch.setitem(parttype._types, "regulator", REGULATOR)
    stop, ohms, farads, drawn, edge = 4e-3, 11.0, 100e-6, 0.06, 1e-6
    pulse = {"high": drawn, "width": 1e-3, "edge": edge, "start": 0.5e-3}
    scene = {
        "name": "regulated",
        "regulator": {"part": "regulator", "setpoint": 3.0, "most": 3.5,
                      "pins": {"measured": "tank.a", "out": "line.a"}},
        "line": {"part": "resistor", "resistance": ohms - 1.0, "pins": {"b": "tank.a"}},
        "tank": {"part": "capacitor", "capacitance": farads},
        "load": {"part": "source", "kind": "current", "pulse": pulse,
                 "pins": {"out": "gnd", "ret": "tank.a"}},
        "solver": {"stop": stop, "max_step": 5e-6, "reltol": 1e-6},
    }  # fmt: skip
    ngspice = kc.run(scene).waves
    laws = solve_laws(
        add_results_and_sources(BuiltScene(load_scene(scene), {})),
        Waveforms({"time": ngspice["time"]}, {}),
    ).results
    corners = 0.5e-3 + np.array([0.0, edge, 1e-3, 1e-3 + edge])

    def wanted(t, y, *_):
        return 2.0 * (3.0 - y[0]) + y[1] - 3.5

    def rates(t, y, held):
        load = np.interp(t, corners, [0.0, drawn, drawn, 0.0])
        charging = (min(wanted(t, y), 0.0) + 3.5 - y[0]) / ohms - load
        return charging / farads, 0.0 if held else 4e3 * (3.0 - y[0])

    wanted.terminal, pieces, t, y = True, [], 0.0, [3.0, 3.0]
    while t < stop:
        wanted.direction = 1.0 - 2.0 * (len(pieces) % 2)  # to the limit, and away from it
        pieces.append(
            solve_ivp(rates, (t, stop), y, rtol=1e-9, atol=1e-12, max_step=2e-6, events=wanted,
                      dense_output=True, args=(len(pieces) % 2 == 1,))
        )  # fmt: skip
        t, y = pieces[-1].t[-1], pieces[-1].y[:, -1]
    assert len(pieces) == 3
    for waves, limit in ((ngspice, 1e-4), (laws, 1e-7)):
        owner = np.searchsorted([piece.t[-1] for piece in pieces[:-1]], waves["time"])
        exact = [pieces[k].sol(t)[1] for k, t in zip(owner, waves["time"], strict=True)]
        np.testing.assert_allclose(waves["regulator.integral"], exact, rtol=limit)
    for dialect in list_dialect_names()[1:]:
        assert write_dialect_files(kc.deck(scene), dialect)


def test_a_law_with_a_step_is_not_linear():
    """A step has no slope on either side: its switching is all that it does."""
    stepped = Declaration(
        "stepped",
        "a conductance above a volt",
        kc.Section,
        (voltage("v", "a", "b"),),
        content="above(v - 1)*v",
    )
    assert not stepped.is_linear
    assert "V(a,b)-1>0" in "\n".join(Printer().format_cards(write_subcircuit_items(stepped)))


class PusherKeys(kc.Section):
    """A force in proportion to a voltage that takes no current."""

    gain: float = 2e-3


PUSHER = DeclaredPart(
    Declaration(
        "pusher",
        "force by a voltage",
        PusherKeys,
        (measured(voltage("v", "command", "ref")), displacement("x", "a", "b")),
        content="-gain*v*x_rate",
    )
)


def test_a_measured_branch_supplies_no_energy(monkeypatch):
    """A mass under ``gain v`` goes ``gain v t^2 / 2 m``; the run's own balance holds."""
    monkeypatch.setitem(parttype._types, "pusher", PUSHER)
    pulse = {"high": 1.0, "width": 1.0, "edge": 1e-9, "start": 1e-6}
    scene = {
        "name": "pushed",
        "gravity": 0.0,
        "pusher": {"part": "pusher", "pins": {"command": "drive.out", "a": "box.a"}},
        "box": {"part": "mass", "mass": 1e-3, "position": 0.0},
        "drive": {"part": "source", "pulse": pulse},
        "solver": {"stop": 1e-3, "max_step": 1e-6, "reltol": 1e-6},
    }
    times, *found = both(scene, "pusher.x")
    exact = 2e-3 * np.maximum(times - 1e-6, 0.0) ** 2 / 2e-3
    for x in found:
        np.testing.assert_allclose(x[-1], exact[-1], rtol=1e-4)
    build = add_results_and_sources(BuiltScene(load_scene(scene), {}))
    balance = dict(form_verdict(Waveforms(dict(kc.run(scene).waves), {}), build).balances)["pusher"]
    assert balance.scale > 0
    assert balance.missing < 1e-3 * balance.scale


class CoolingKeys(kc.Section):
    linear: float
    cubic: float


@pytest.fixture
def cooling(monkeypatch):
    """A surface that loses ``linear T + cubic T^3`` watts."""
    loss = "0.5*linear*temperature^2 + 0.25*cubic*temperature^4"
    declaration = Declaration("cooling", "surface", CoolingKeys, (branch("temperature"),),
                              content=loss)  # fmt: skip
    monkeypatch.setitem(parttype._types, "cooling", DeclaredPart(declaration))


def test_heat_loss_by_a_cubic_law_sets_the_time_step(cooling):
    """``C T' = P - a T - b T^3`` by scipy, for a minute: heat cannot ring, so that error control
    chooses the steps."""
    capacity, power, a, b = 0.5, 2.0, 0.02, 1e-6
    scene = load_scene({
        "name": "cooled",
        "plate": {"part": "thermal_capacitor", "capacity": capacity,
                  "pins": {"a": "heater.out", "b": "gnd"}},
        "surface": {"part": "cooling", "linear": a, "cubic": b,
                    "pins": {"a": "heater.out", "b": "gnd"}},
        "heater": {"part": "source", "kind": "heat_flow",
                   "pulse": {"high": power, "start": 1.0, "width": 30.0, "edge": 1e-3}},
        "analysis": {"type": "transient", "stop": 61.0},
        "solver": {"reltol": 1e-5},
        "probes": {"hot_k": {"of": "plate.temperature"}},
    })  # fmt: skip
    waves = kc.run(scene).waves
    corners = [1.0, 1.001, 31.001, 31.002]

    def rate(t, y):
        return (power * np.interp(t, corners, [0, 1, 1, 0]) - a * y - b * y**3) / capacity

    exact = solve_ivp(rate, (0, 61), [0.0], "DOP853", t_eval=waves["time"], rtol=1e-10, atol=1e-10,
                      max_step=0.05).y[0]  # fmt: skip
    assert waves["time"].size < 20_000
    np.testing.assert_allclose(waves["plate.temperature"], exact, atol=1e-4 * exact.max())


OPENED_COMB = {
    "name": "opened",
    "comb": {"part": "comb_drive", "fingers": 50, "thickness": 1e-5, "gap": 2e-6, "overlap": 1e-6,
             "travel": 1e-5, "pins": {"plus": "drive.out", "a": "spring.a"}},
    "spring": {"part": "spring", "stiffness": 1.0},
    "drive": {"part": "source", "dc": 0.0},
    "push": {"part": "source", "kind": "force", "dc": -2e-6, "pins": {"out": "spring.a"}},
    "analysis": {"type": "dc", "sweep": "drive.dc", "from": 0.0, "to": 1.0, "points": 11},
}  # fmt: skip


def test_a_violated_limit_names_the_key_to_change():
    with pytest.raises(
        kc.errors.SimulationError, match="the two combs no longer overlap"
    ) as caught:
        kc.run(OPENED_COMB)
    assert caught.value.hint == "raise the key comb.overlap"
    kc.run(OPENED_COMB | {"comb": OPENED_COMB["comb"] | {"overlap": 3e-6}})


def test_all_remedies_belong_to_limits():
    limited = 0
    for kind in parttype.load_part_types().values():
        declaration = getattr(kind, "declaration", None)
        if declaration is not None and declaration.limits:
            limited += 1
            assert declaration.remedies.keys() <= declaration.limits.keys()
    assert limited >= 5
