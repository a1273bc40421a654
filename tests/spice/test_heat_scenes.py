"""Scenes of the gallery with heat, against integrations of their equations by scipy."""

import re
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve
from support import Element, find_thermal_material, read_cards

import kc2spice as kc

HEATER, BOX = 0.513631, 5.13631  # J/K
FILM, WALL = 57.9268, 11.3740  # K/W
FAHRENHEIT = 5 / 9  # K
BTU_PER_HOUR = 1055.056 / 3600  # W


def thermostat_reference(stop):
    """Switching times [s], and least and largest rise of the box after the first of them [K]."""
    lower, upper, power = 30 * FAHRENHEIT, 55 * FAHRENHEIT, 10 * BTU_PER_HOUR
    state, time, on, switched, rises = np.zeros(2), 0.0, True, [], []

    def rates(t, y):
        across = (y[0] - y[1]) / FILM
        return [(power * on - across) / HEATER, (across - y[1] / WALL) / BOX]

    def crossing(t, y):
        return y[1] - (upper if on else lower)

    crossing.terminal = True
    while True:
        crossing.direction = 1 if on else -1
        found = solve_ivp(rates, (time, stop), state, events=crossing, rtol=1e-10, atol=1e-10)
        time, state = found.t[-1], found.y[:, -1]
        rises += found.y[1].tolist() if switched else []
        if found.status == 0:
            return np.array(switched), min(rises), max(rises)
        switched.append(time)
        on = not on


def test_the_thermostat_keeps_the_box_between_100_and_125_fahrenheit():
    """VM159. The time counts from the start of mains at 1 s."""
    result = kc.run("thermostat")
    box = result.waves["box.temperature"] / FAHRENHEIT + 70
    flow = result.waves["film.heat"] + result.waves["heater.heat"]  # of the heater
    edges = np.flatnonzero(np.diff(flow > 0.5 * flow.max()))
    switched = result.time[edges][1:] - 1.0
    exact, least, largest = thermostat_reference(720.0)
    assert len(exact) == 5
    # a step of time is 0.1 s, and each switching shifts the next ones
    np.testing.assert_allclose(switched, exact, atol=0.4)
    after = box[result.time > exact[0] + 1.0]
    # the heater is cold when it starts: the box falls below 100 F
    assert after.min() == pytest.approx(70 + least / FAHRENHEIT, abs=0.05)
    assert after.max() == pytest.approx(70 + largest / FAHRENHEIT, abs=0.05)
    assert 97 < after.min() < 100
    assert 125 < after.max() < 126


ROOM = 25.0  # degC, at which the parameters hold
JUNCTION_TO_CASE = 0.6  # K/W
AREAS = {"copper": 2e-4, "aluminium": 25e-4}  # m2
HEIGHTS = {"copper": 2e-3, "aluminium": 4e-3}  # m
JOINT = 2e-5 / 2e-4  # K/W
FILM_OF_SINK = 1 / (200 * 25e-4)  # K/W


def mosfet_power(junction):
    """Power [W] at 12 V and 4.3 V in saturation: Id = kp/2 (Vgs - Id Rs - Vth)^2."""
    threshold = 3.5 - 3e-3 * (junction - ROOM)

    def excess(current):
        return current - 8 / 2 * (4.3 - current * 5e-3 - threshold) ** 2

    return 12 * brentq(excess, 0.0, 40.0)


def sink_cells(count=40):
    """Capacities [J/K] and conductances [W/K] of a chain from the case to the room."""
    capacities, resistances = [], [0.0]
    for name, area in AREAS.items():
        material, step = find_thermal_material(name), HEIGHTS[name] / count
        half = step / (2 * material.conductivity[0] * area)
        for _ in range(count):
            resistances[-1] += half
            resistances.append(half)
            capacities.append(material.capacity * area * step)
        if name == "copper":
            resistances[-1] += JOINT
    resistances[-1] += FILM_OF_SINK
    return np.array(capacities), 1 / np.array(resistances)


def test_the_mosfet_heats_up_as_its_equations_and_those_of_its_sink_state():
    result = kc.run("mosfet_sink")
    capacities, conductances = sink_cells()
    capacities = np.r_[0.02, capacities]  # the chip
    conductances[0] = 1 / (1 / conductances[0] + JUNCTION_TO_CASE)

    def rates(t, T):
        across = conductances * (T - np.r_[T[1:], ROOM])
        into = np.r_[mosfet_power(T[0]), across[:-1]]
        return (into - across) / capacities

    start = np.full(len(capacities), ROOM)
    times = np.array([0.05, 0.3, 1.0, 5.0, 20.0, 58.0])
    exact = solve_ivp(rates, (0, 59), start, "BDF", times, rtol=1e-7, atol=1e-7)
    found = np.interp(times + 1.001, result.time, result.waves["chip.temperature"])
    np.testing.assert_allclose(found - ROOM, exact.y[0] - ROOM, rtol=5e-3)
    power = mosfet_power(result.waves["chip.temperature"][-1])
    assert result.waves["supply.i"][-1] == pytest.approx(power / 12, rel=1e-4)


def test_a_vdmos_with_thermal_pins_has_five_nodes():
    cards = "M1 d g s tj tc chip thermal temp=0\nM2 d g s chip\n.model chip VDMOS(NCHAN)\n"
    thermal, plain = (
        item for item in read_cards(cards, "cards").items if isinstance(item, Element)
    )
    assert (thermal.nodes, thermal.model) == (("d", "g", "s", "tj", "tc"), "chip")
    assert (thermal.values, dict(thermal.parameters)) == (("thermal",), {"temp": "0"})
    assert (plain.nodes, plain.model) == (("d", "g", "s"), "chip")


def test_the_converter_of_the_tutorial_follows_its_equations_at_rest(tmp_path):
    page = (Path(__file__).parents[2] / "docs" / "tutorials" / "heat.md").read_text("utf-8")
    files = dict(re.findall(r"(?ms)^cat > (\S+) <<'END'\n(.*?)^END$", page))
    for name in ("buck.lib", "converter.toml"):
        (tmp_path / name).write_text(files[name])
    stop = {"solver.stop": 3000.0}  # 18 time constants of the board
    result = kc.run(tmp_path / "converter.toml", overrides=stop)
    copper, fr4 = find_thermal_material("copper"), find_thermal_material("FR4")
    board = 70e-6 / copper.conductivity[2] + 1.5e-3 / fr4.conductivity[2] + 1 / 25
    board /= 15e-4  # m2

    def balance(x):
        current, on_board, in_switches = x
        winding = 0.1 * (1 + 0.00393 * on_board)
        switches = 0.1 * (1 + 7e-3 * in_switches)
        return [
            6.0 - current * (2 + winding + switches),
            board * current**2 * (winding + switches) - on_board,
            on_board + 15 * current**2 * switches - in_switches,
        ]

    current, on_board, _ = fsolve(balance, [2.7, 50.0, 60.0])
    assert result.metrics["warm_v"] == pytest.approx(2 * current, rel=1e-4)
    assert result.metrics["board_k"] == pytest.approx(on_board, rel=1e-3)
