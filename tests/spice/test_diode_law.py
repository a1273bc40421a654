"""Law of the diode against ngspice on its netlist, and both against equations by hand.

The equations here use the names of SPICE for the parameters of the model D: IS, N, RS, CJO, TT, BV.
"""

import math
from functools import cache

import numpy as np
import pytest
from device import both, built
from own_equations import integrated
from scipy.optimize import brentq
from support import (
    Junction,
    assemble_system,
    get_scene_laws,
    integrate_steps,
    load_scene,
    make_linear_waveform,
    solve_operating_point,
    solve_transient,
)
from support import laws as L

VT = 1.38064852e-23 * 300.15 / 1.6021766208e-19  # V, with the constants of ngspice
IS, N, CJO, TT = 2.52e-9, 1.752, 4e-12, 20e-9  # of the default diode


@cache
def breakdown_start(saturation, n, bv):
    """Reverse voltage [V] beyond which the current rises exponentially; it is 1 mA at ``bv``."""
    return brentq(lambda x: np.log(1e-3 / saturation + 1 - x / VT) - (bv - x) / (n * VT), 0.0, bv)


def current(v, saturation=IS, n=N, bv=100.0):
    """Current [A] at the voltage ``v`` of the junction, with the conductance gmin of ngspice."""
    width, start = n * VT, breakdown_start(saturation, n, bv)
    if v < -start:
        return -saturation * math.exp(-(start + v) / width) + 1e-12 * v
    if v < -3 * width:
        return -saturation * (1 + (3 * width / (math.e * v)) ** 3) + 1e-12 * v
    return saturation * math.expm1(v / width) + 1e-12 * v


def capacitance(v, cjo=CJO, tt=TT, saturation=IS, n=N):
    """Capacitance [F]: depletion, which rises linearly above 0.5 V, and diffusion."""
    depletion = cjo / math.sqrt(1 - v) if v < 0.5 else cjo * (0.25 + 0.5 * v) / 0.5**1.5
    slope = (current(v + 1e-6, saturation, n) - current(v - 1e-6, saturation, n)) / 2e-6 - 1e-12
    return depletion + tt * slope


def driven(wave, ohm, analysis, **keys):
    """Scene of a source behind a resistor with a diode to ground."""
    return {
        "name": "driven", "analysis": analysis,
        "source": {"part": "source", **wave, "pins": {"out": "r.a"}},
        "r": {"part": "resistor", "resistance": ohm, "pins": {"b": "d.anode"}},
        "d": {"part": "diode", "pins": {"cathode": "gnd"}, **keys},
    }  # fmt: skip


def off(ours, exact):
    """Rms of a difference of two waves, relative to the rms of the second one."""
    return float(np.sqrt(np.mean((ours - exact) ** 2) / np.mean(exact**2)))


@pytest.mark.parametrize("resistance", [0.568, 0.0])
def test_a_sweep_through_breakdown_and_forward(resistance, tmp_path):
    sweep = {"type": "dc", "sweep": "source.dc", "from": -130.0, "to": 10.0, "points": 29}
    scene = driven({"dc": 0.0}, 100.0, sweep, series_resistance=resistance)
    waves, exact, failed = both(load_scene(scene), tmp_path)
    assert not failed
    total = 100.0 + resistance

    def hand(volt):
        v = brentq(lambda v: (volt - v) / total - current(v), -130.0, 10.0, xtol=1e-14)
        return (volt - v) / total

    i = np.array([hand(volt) for volt in waves["sweep"]])
    np.testing.assert_allclose(exact["d.i"], i, rtol=1e-6, atol=1e-13)
    np.testing.assert_allclose(waves["d.i"], exact["d.i"], rtol=1e-6, atol=1e-12)


def test_the_thermal_voltage_is_that_of_ngspice(tmp_path):
    keys = {"saturation_current": 1e-14, "emission": 1.0, "series_resistance": 0.0}
    scene = driven({"kind": "current", "dc": 1e-6}, 1.0, {"type": "op"}, **keys)
    waves, exact, failed = both(load_scene(scene), tmp_path)
    assert not failed
    v = float((waves["source.v"] - 1e-6)[0])
    assert v / np.log(1e-6 / 1e-14 + 1) == pytest.approx(VT, rel=1e-6)
    assert exact["source.v"][0] == pytest.approx(waves["source.v"][0], rel=1e-9)


@pytest.mark.parametrize("volt", [1.5, -5.0])
def test_small_signals_and_noise(volt, tmp_path):
    """Conductance and capacitance of the operating point, shot noise and thermal noise."""
    span = {"start": 1e4, "stop": 1e9, "points": 41}
    scene = driven({"dc": volt, "ac": 1.0}, 1e3, {"type": "ac", **span}, series_resistance=5.0)
    waves, exact, failed = both(load_scene(scene), tmp_path)
    v = brentq(lambda v: (volt - v) / 1005 - current(v), -10, 10, xtol=1e-15)
    slope = (current(v + 1e-5) - current(v - 1e-5)) / 2e-5
    s = 2j * np.pi * waves["frequency"]
    admittance = slope + s * capacitance(v)
    hand = 1 / (1005 + 1 / admittance)
    assert not failed
    assert np.abs(exact["d.i"] / hand - 1).max() < 1e-6
    assert np.abs(waves["r.i"] / exact["r.i"] - 1).max() < 1e-8

    noisy = scene | {"analysis": {"type": "noise", "output": "d.anode", **span}}
    waves, exact, failed = both(load_scene(noisy), tmp_path)
    thermal = 4 * 1.38064852e-23 * 300.15
    across = 1 / (1e-3 + 1 / (5 + 1 / admittance))
    shot = 2 * 1.6021766208e-19 * abs(current(v)) * np.abs(1 / admittance) ** 2
    share = np.abs(across / (5 + 1 / admittance)) ** 2
    density = np.sqrt(thermal * 1e-3 * np.abs(across) ** 2 + share * (thermal * 5 + shot))
    assert not failed
    assert np.abs(exact["noise"] / density - 1).max() < 1e-6
    assert np.abs(waves["noise"] / density - 1).max() < 1e-6


def test_a_rectifier_that_breaks_through(tmp_path):
    """A sine of 30 V through 1 kOhm to a diode that breaks through at 20 V."""
    f, keys = 1e4, {"breakdown_voltage": 20.0, "capacitance": 1e-9, "series_resistance": 2.0}
    scene = driven(
        {"sine": {"amplitude": 30.0, "frequency": f}}, 1e3, {"type": "transient", "stop": 1.5 / f},
        **keys,
    ) | {"solver": {"reltol": 1e-6, "max_step": 1e-3 / f}}  # fmt: skip
    waves, exact, failed = both(load_scene(scene), tmp_path)

    def through(t, v):
        return (30 * np.sin(2 * np.pi * f * t) - v) / 1002

    def rate(t, y):
        v = float(y[0])
        slope = (current(v + 1e-6, bv=20.0) - current(v - 1e-6, bv=20.0)) / 2e-6 - 1e-12
        depletion = capacitance(v, 1e-9, 0.0)
        return [(through(t, v) - current(v, bv=20.0)) / (depletion + TT * slope)]

    times, states = integrated(rate, np.zeros(1), (), 1.5 / f, exact["time"])
    assert not failed
    assert states.min() < -20.0
    assert states.max() > 0.5
    hand = through(times, states[:, 0])
    assert off(exact["d.i"], np.interp(exact["time"], times, hand)) < 1e-4
    assert off(waves["d.i"], np.interp(waves["time"], times, hand)) < 1e-4


BRIDGE = {
    "source": {"part": "source", "sine": {"amplitude": 10.0, "frequency": 1e4},
               "pins": {"out": "r.a", "ret": "d2.anode"}},
    "r": {"part": "resistor", "resistance": 100.0, "pins": {"b": "d1.anode"}},
    "d1": {"part": "diode", "series_resistance": 0.0, "pins": {"cathode": "store.a"}},
    "d2": {"part": "diode", "series_resistance": 0.0, "pins": {"cathode": "store.a"}},
    "d3": {"part": "diode", "series_resistance": 0.0,
           "pins": {"anode": "gnd", "cathode": "d1.anode"}},
    "d4": {"part": "diode", "series_resistance": 0.0,
           "pins": {"anode": "gnd", "cathode": "d2.anode"}},
    "store": {"part": "capacitor", "capacitance": 1e-7},
    "load": {"part": "resistor", "resistance": 1e4, "pins": {"a": "store.a"}},
}  # fmt: skip


def bridge_rates(t, y):
    """Balances of the nets ``a``, ``c`` and of the store, which the capacitances couple."""
    a, c, store = y
    source = (10 * np.sin(2 * np.pi * 1e4 * t) + c - a) / 100
    C, balance = np.diag([0.0, 0.0, 1e-7]), np.array([source, -source, -store / 1e4])
    for plus, minus in ((0, 2), (1, 2), (None, 0), (None, 1)):
        v = (0.0 if plus is None else y[plus]) - y[minus]
        for net, sign in ((plus, 1.0), (minus, -1.0)):
            if net is None:
                continue
            balance[net] -= sign * current(v)
            for other, rate in ((plus, 1.0), (minus, -1.0)):
                if other is not None:
                    C[net, other] += sign * rate * capacitance(v)
    return np.linalg.solve(C, balance)


def test_a_bridge_floats_where_all_its_diodes_block(tmp_path):
    """The junctions alone determine the voltage of the floating source over ground."""
    stop = 1.3e-4
    scene = {"name": "bridge", **BRIDGE, "analysis": {"type": "transient", "stop": stop},
             "solver": {"reltol": 1e-6, "max_step": 5e-8}}  # fmt: skip
    waves, exact, failed = both(load_scene(scene), tmp_path)
    times, states = integrated(bridge_rates, np.zeros(3), (), stop, exact["time"], rtol=1e-8)
    assert not failed
    hand = np.interp(exact["time"], times, states[:, 2])
    assert off(exact["store.v"], hand) < 1e-6
    assert off(waves["store.v"], np.interp(waves["time"], times, states[:, 2])) < 2e-5
    through = np.array([(current(a - s), current(c - s)) for a, c, s in states])
    assert 0.1 < (through.max(axis=1) < 1e-8).mean() < 0.9
    d2 = np.interp(exact["time"], times, through[:, 1])
    assert off(exact["d2.i"], d2) < 1e-2  # apart from the current of the charge


def test_a_bridge_conserves_energy():
    scene = {"name": "bridge", **BRIDGE, "analysis": {"type": "transient", "stop": 1e-4}}
    (network,) = get_scene_laws(built(load_scene(scene), others=True)).networks
    run = solve_transient(assemble_system(network.laws, network.joins), 1e-4, 1e-9)
    assert abs(run.energy.residual) < 1e-9 * run.energy.turnover


def test_a_step_of_equal_length_crosses_an_edge():
    """Within one step the source jumps to 100 V: Newton's method limits the junction's voltage."""
    pulse = {"high": 100.0, "width": 1e-5, "edge": 1e-9, "start": 1e-6}
    scene = driven({"pulse": pulse}, 100.0, {"type": "transient", "stop": 1e-5})
    (network,) = get_scene_laws(built(load_scene(scene), others=True)).networks
    steps = integrate_steps(assemble_system(network.laws, network.joins), 0.0, 1e-7, 50)
    v = brentq(lambda v: (100 - v) / 100.568 - current(v), 0.0, 2.0)
    assert steps.waves["d.inner"][-1] == pytest.approx(v, rel=1e-3)
    assert steps.waves["d.anode"][-1] == pytest.approx(v + 0.568 * current(v), rel=1e-3)


def test_a_high_voltage_has_an_operating_point():
    """Without a limit, the first iterate of 10 kV overflows the exponential function."""
    junction = Junction("d", IS, N, 0.0, CJO, TT, 100.0)
    for volt in (1e4, -1e4):
        source = L.IdealSource("s", "current", make_linear_waveform([(0.0, volt / 100)]))
        joins = {"a": ("s.out", "d.anode"), L.GROUND: ("s.ret", "d.cathode")}
        v = solve_operating_point(assemble_system([junction, source], joins))["d.anode"]
        assert current(v) == pytest.approx(volt / 100, rel=1e-9)
