"""Heat of the catch's coils: fixed point, warming by recorded currents, and loops at rails."""

from functools import partial

import numpy as np
import pytest
import scipy
from support import UsageError, coils, find_resistance_coefficient

import kc2spice as kc

COPPER = find_resistance_coefficient("copper")
PATH = {
    "copper": {"part": "thermal_capacitor", "capacity": "0.02 J/K"},
    "potting": {"part": "thermal_resistor", "resistance": "40 K/W", "pins": {"a": "copper.a"}},
}


def catch_alone(pins, **tables):
    """A catch without magnets, whose coils do not lift the sphere, beside a path of heat."""
    catch = {"pins": {"heat": "copper.a"} | pins, "remanence": 0.0}
    tables.setdefault("catch", catch)
    checks = {"range": "warn"}
    scene = {"name": "alone", "gravity": 0.0, "sphere": {}, "checks": checks}
    return scene | PATH | tables


def resistance_of_both():
    """Resistance of both coils at the reference temperature [Ohm]."""
    keys = kc.load_scene("kick_and_catch").parts["catch"].keys
    length = 2 * keys.turns * np.pi * (keys.lower.inner + keys.lower.outer)
    return keys.resistivity * length / (np.pi / 4 * keys.wire_diameter**2)


def warming(drive, R0, a, C, Rth, t):
    """Temperature [K] of a resistance at a voltage [V] that heats itself, by scipy."""

    def slope(time, T):
        power = drive(time) ** 2 / (R0 * (1 + a * T[0]))
        return [(power - T[0] / Rth) / C]

    return scipy.integrate.solve_ivp(slope, (0, t[-1]), [0.0], "LSODA", t, rtol=1e-10).y[0]


SERIES = {"drive": "drive.out", "ret": "gnd"}  # resistances in series
REAL = {"up": "drive.out", "lp": "gnd"}  # with inductances and back-EMF


@pytest.mark.parametrize(
    ("pins", "coefficient"), [(SERIES, None), (SERIES, 1e-2), (REAL, None), (REAL, 1e-2)]
)
def test_coils_at_a_voltage_warm_as_scipy_integrates(pins, coefficient):
    keys = {} if coefficient is None else {"temperature_coefficient": coefficient}
    pulse = {"high": "150 V", "width": "9 s", "edge": "1 us"}
    scene = catch_alone(
        pins,
        drive={"part": "source", "pulse": pulse},
        solver={"stop": "0.4 s", "max_step": "1 ms", "reltol": 1e-6},
    )
    scene["catch"] |= keys
    result = kc.run(scene)
    a = COPPER if coefficient is None else coefficient
    exact = warming(lambda t: 150.0, resistance_of_both(), a, 0.02, 40.0, result.time)
    rise = result.waves["coil.temperature"]
    assert exact.max() > 60
    assert np.abs(rise - exact).max() < 5e-4 * exact.max()
    current = 150.0 / (resistance_of_both() * (1 + a * exact))
    settled = result.time > 2e-3  # the inductances delay the current by 0.1 ms
    difference = np.abs(result.waves["coil.upper.current"]) - current
    assert np.abs(difference[settled]).max() < 2e-4 * current.max()
    assert result.metrics["coil_resistance_ratio"] == pytest.approx(1 + a * exact.max(), rel=1e-4)
    balances = [check for check in result.checks if check.name == "energy of catch"]
    assert balances
    assert all(check.passed for check in balances)


@pytest.mark.slow
@pytest.mark.parametrize("pins", [pytest.param(SERIES, marks=pytest.mark.slow), REAL])
def test_verify_integrates_the_coupled_equations(pins):
    drive = {"part": "source", "sine": {"amplitude": "150 V", "frequency": "200 Hz"}}
    solver = {"stop": "20 ms", "reltol": 1e-5}
    verdict = kc.verify(catch_alone(pins, drive=drive, solver=solver))
    assert verdict["passed"], [check for check in verdict["checks"] if not check["passed"]]


@pytest.mark.slow
def test_verify_fails_if_the_resistance_follows_another_temperature(monkeypatch):
    make = coils.make_law
    hotter = partial(make, temperature_coefficient=1.2 * COPPER)
    monkeypatch.setattr(coils, "make_law", hotter)
    drive = {"part": "source", "sine": {"amplitude": "150 V", "frequency": "200 Hz"}}
    scene = catch_alone(SERIES, drive=drive, solver={"stop": "20 ms", "reltol": 1e-5})
    verdict = kc.verify(scene)
    missed = [check["name"] for check in verdict["checks"] if not check["passed"]]
    assert any("ngspice versus equations" in name for name in missed), missed


def test_the_heat_of_the_catch_needs_a_path():
    drive = {"part": "source", "dc": "1 V"}
    scene = catch_alone(SERIES, drive=drive, analysis={"type": "op"})
    del scene["potting"]
    with pytest.raises(UsageError, match="heat cannot flow"):
        kc.run(scene)


def test_a_coefficient_without_a_pin_of_heat_is_refused():
    scene = kc.load_scene("kick_and_catch").tables | {"catch": {"temperature_coefficient": 1e-3}}
    with pytest.raises(UsageError, match="no effect without a heat pin"):
        kc.load_scene(scene)


@pytest.mark.slow
def test_a_warm_catch_between_rails_throws_the_sphere_higher():
    """The temperature follows the recorded currents; a warm housing takes current."""
    warm = kc.run("coil_self_heating")
    cold = kc.run(kc.load_scene("coil_self_heating", overrides={"housing.dc": "0 K"}))
    t, waves = warm.time, warm.waves
    each = resistance_of_both() / 2
    squares = waves["coil.lower.current"] ** 2 + waves["coil.upper.current"] ** 2

    def slope(time, T):
        power = each * (1 + COPPER * T[0]) * np.interp(time, t, squares)
        return [(power - (T[0] - 60.0) / 17.2) / 0.1556]

    exact = scipy.integrate.solve_ivp(
        slope, (0, t[-1]), [60.0], "RK45", t, rtol=1e-9, max_step=5e-6
    ).y[0]
    rise = waves["coil.temperature"] - 60.0
    assert np.ptp(exact) > 0.02
    assert np.abs(rise - exact + 60.0).max() < 1e-3 * np.ptp(exact)
    # the rails bound the current by their voltage over the resistance of warm copper
    most = 60.0 / (resistance_of_both() * (1 + COPPER * 60.0))
    assert warm.metrics["coil_current_peak_a"] == pytest.approx(most, rel=0.02)
    assert warm.metrics["peak_height_m"] > 1.1 * cold.metrics["peak_height_m"]
    assert abs(cold.metrics["final_error_m"]) < 1e-6


@pytest.mark.slow
def test_ideal_currents_in_the_loop_of_the_paper_only_need_more_voltage():
    """An ideal current source keeps the loop; the copper takes up nearly all heat."""
    cold = kc.load_scene("kick_and_catch")
    copper = {"part": "thermal_capacitor", "capacity": "0.1556 J/K"}
    tables = cold.tables | PATH | {"copper": copper}
    tables["potting"] = PATH["potting"] | {"resistance": "1000 K/W"}  # takes 3e-5 of the heat
    tables["catch"] = {**tables["catch"], "pins": {"heat": "copper.a"}}
    tables["name"] = "kick_and_catch_heat"
    warm = kc.load_scene(tables)
    notes = " ".join(map(str, warm.parts["catch"].type.notes(warm.parts["catch"], warm)))
    assert "self-heating" not in notes
    before = " ".join(map(str, cold.parts["catch"].type.notes(cold.parts["catch"], cold)))
    assert "self-heating" in before
    result, plain = kc.run(warm), kc.run(cold)
    for name in ("launch_velocity_m_s", "peak_height_m", "settling_time_s"):
        assert result.metrics[name] == pytest.approx(plain.metrics[name], rel=1e-4)
    each, t = resistance_of_both() / 2, result.time
    squares = 2 * result.waves["coil.upper.current"] ** 2
    heat = scipy.integrate.trapezoid(each * squares, t)
    rise = result.waves["coil.temperature"][-1]
    # T' = P (1 + a T) / C: the rise is (exp(a E / C) - 1) / a
    assert rise > 0.1
    assert rise == pytest.approx(np.expm1(COPPER * heat / 0.1556) / COPPER, rel=1e-3)
