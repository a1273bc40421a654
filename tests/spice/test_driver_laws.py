"""Laws of the drivers against ngspice on their netlists, and both against equations by hand.

The equations here have no nodes: what carries no charge is eliminated with pencil and paper.
"""

import numpy as np
import pytest
from device import both, built
from own_equations import VT, integrated
from support import (
    CoilLoad,
    LinearDrive,
    PwmDrive,
    assemble_system,
    find_replayed_nets,
    get_scene_laws,
    load_scene,
    make_linear_waveform,
    solve_transient,
)
from support import laws as L

FARAD, HENRY = 1e-7, 1e-6  # F, in place of a chip; H, before it where it rings
OUTPUT = 0.1  # Ohm, of an operational amplifier
COILS = CoilLoad(inductance=73e-3, resistance=3192.0, current=0.1)


def pulse(t, high, start=1e-6, edge=1e-7, width=1e-5):
    return high * np.interp(t, [start, start + edge, start + width, start + width + edge],
                            [0.0, 1.0, 1.0, 0.0])  # fmt: skip


def corners(start=1e-6, edge=1e-7, width=1e-5):
    return start, start + edge, start + width, start + width + edge


def limited(value, most):
    return min(max(value, -most), most)


def compensation(c, difference, gbw, slew, low, high):
    """A microfarad behind a limited input stage, with a leak and with stiff rails."""
    gm, most = 2e-6 * np.pi * gbw, 1e-6 * slew
    current = limited(gm * difference, most) - gm / 1e7 * c
    return (current - 1e3 * most * (max(c - high, 0.0) - max(low - c, 0.0))) / 1e-6


def amplifier(t, y, high, resistance, bandwidth, slew, current_limit, rail):
    c, out = y
    share = 20e3 / (20e3 + resistance)  # of the feedback's divider, seen from the drive
    i = limited((c - share * out) / (OUTPUT + share * resistance), current_limit)
    drive = share * (out + resistance * i)
    difference = (pulse(t, high) - drive) / 20
    rate = compensation(c, difference, 20 * bandwidth, slew, -10.0, rail)
    return [rate, (drive - out) / resistance / FARAD]


def charge_drive(t, y, high, resistance, bandwidth, slew, current_limit, rail, sense, capacitance):
    c, chip, cathode = y
    i = limited((c - cathode - chip) / (OUTPUT + resistance), current_limit)
    gbw = bandwidth * (1 + sense / capacitance)
    target = capacitance / sense * pulse(t, high)
    rate = compensation(c, target - cathode, gbw, slew, -rail, rail)
    return [rate, (i - capacitance * chip) / FARAD, i / sense - cathode]


def coil_loop(y, bandwidth, current_limit):
    """Feedback current, voltages of the drive and of the sense resistor."""
    c, held, coils = y
    feedback = 1e3 * (1 + 2 * np.pi * bandwidth * COILS.inductance / 100) + 100
    both = (c / 1.1 + (100 * coils - held) / feedback - coils) / (1 / 1.1 + 1 / feedback)
    back = coils - limited((c - both) / 1.1, current_limit)
    return back, 100 * coils - held - feedback * back, 100 * (coils - back)


def linear_drive(t, y, high, bandwidth, slew, rail, current_limit):
    ratio = 2 * np.pi * bandwidth * COILS.inductance / 100
    back, drive, ret = coil_loop(y, bandwidth, current_limit)
    inverting, gbw = ret - 1e3 * back, 5 * bandwidth * (1 + ratio)
    command = pulse(t, high, 1e-5, 1e-7, 1.0)
    farad = COILS.inductance / (COILS.resistance + 100) / (1e3 * ratio)
    rate = compensation(y[0], command - inverting, gbw, slew, -rail, rail)
    across = drive - ret - COILS.resistance * y[2]
    return [rate, back / farad, across / COILS.inductance]


def pwm_drive(t, y, high, rail, frequency, bandwidth, resistance, edge):
    """A PI controller with a real amplifier, whose output is compared with a triangle of 10 V."""
    c, held, coils = y
    r2 = 1e5 * 2 * np.pi * bandwidth * COILS.inductance * 10 / 100 / rail
    loop = COILS.resistance + 2 * resistance + 1.0
    farad, series = COILS.inductance / loop / r2, 1e3 + 1e5 + r2
    u = (c + OUTPUT * (100 * coils - held) / series) / (1 + OUTPUT / series)
    back = (100 * coils - held - u) / series
    triangle = 20 / np.pi * np.arcsin(0.9999 * np.sin(2 * np.pi * frequency * t))
    duty = limited((u - triangle) / (20 * frequency * edge), 1.0)
    command = pulse(t, high, 1e-5, 1e-7, 1.0)
    beyond = 1e6 * (max(c - 12, 0.0) - max(-12 - c, 0.0))
    rate = 2e7 * np.pi * (command - (u + held + r2 * back) - c / 1e7 - beyond)
    return [rate, back / farad, (rail * duty - loop * coils) / COILS.inductance]


def transistor(gate, drain, limit):
    """Level 1 with 12 V at the gate, a threshold of 3 V and the diode of its bulk; to source."""
    k = 2 * limit / 81

    def channel(over, v):
        return 0.0 if over <= 0 else k * (over * v - v * v / 2 if v < over else over**2 / 2)

    forward = drain >= 0
    current = channel(gate - 3, drain) if forward else -channel(gate - drain - 3, -drain)
    return current - 1e-14 * np.expm1(min(-drain / VT, 100.0))


def half_bridge(t, y, high, resistance, rail, current_limit, gate_resistance, reservoir,
                supply_resistance, leakage):  # fmt: skip
    tank, top, bridge, low, load, chip = y
    asked = 2 * pulse(t, high) / rail
    gates = 12 * min(max(asked - 1, 0.0), 1.0), 12 * min(max(1 - asked, 0.0), 1.0)
    upper = transistor(top - bridge, tank - bridge, current_limit)
    lower = transistor(low, bridge, current_limit)
    gate = (bridge + gates[0] - top) / gate_resistance
    C = np.zeros((4, 4))
    for a, b, farad in ((0, None, reservoir), (1, 2, 5e-10), (0, 1, 2e-11), (3, None, 5e-10),
                        (2, 3, 2e-11), (2, None, 1e-10)):  # fmt: skip
        ends = [k for k in (a, b) if k is not None]
        C[ends, ends] += farad
        if b is not None:
            C[a, b] -= farad
            C[b, a] -= farad
    currents = [(rail - tank) / supply_resistance - upper, gate,
                upper - lower - gate - load - bridge / leakage,
                (gates[1] - low) / gate_resistance]  # fmt: skip
    rates = np.linalg.solve(C, currents)
    return [*rates, (bridge - resistance * load - chip) / HENRY, load / FARAD]


CHIP = {"chip": {"part": "capacitor", "capacitance": FARAD,
                 "pins": {"a": "driver.out", "b": "gnd"}}}  # fmt: skip
FLOATING = {"chip": {"part": "capacitor", "capacitance": FARAD,
                     "pins": {"a": "driver.anode", "b": "driver.cathode"}}}  # fmt: skip
RINGING = {
    "wire": {"part": "inductor", "inductance": HENRY,
             "pins": {"a": "driver.out", "b": "chip.a"}},
    "chip": {"part": "capacitor", "capacitance": FARAD, "pins": {"b": "gnd"}},
}  # fmt: skip
WINDINGS = {
    "coils": {"part": "inductor", "inductance": COILS.inductance,
              "pins": {"a": "driver.drive", "b": "copper.a"}},
    "copper": {"part": "resistor", "resistance": COILS.resistance, "pins": {"b": "driver.ret"}},
}  # fmt: skip
FAST = {"high": 100.0, "width": 1e-5, "edge": 1e-7, "start": 1e-6}
STEP = {"high": 5.0, "width": 1.0, "edge": 1e-7, "start": 1e-5}

# Each driver meets its limits: slew rate, current, rails, an empty reservoir.
CASES = {
    "amplifier": (
        amplifier, CHIP, FAST, 2e-5, [0.0, 0.0], {"driver.out": lambda y: y[:, 1]},
        {"rail": 90.0, "resistance": 0.5, "bandwidth": 2e6, "slew": 5e7, "current_limit": 4.0},
    ),
    "charge_drive": (
        charge_drive, FLOATING, FAST, 2e-5, [0.0, 0.0, 0.0],
        {"driver.cathode": lambda y: y[:, 2], "driver.anode": lambda y: y[:, 1] + y[:, 2]},
        {"capacitance": 150e-9, "sense": 1e-6, "rail": 140.0, "resistance": 2.0,
         "bandwidth": 2e5, "slew": 1e8, "current_limit": 6.0},
    ),
    "linear_drive": (
        linear_drive, WINDINGS, STEP, 4e-4, [0.0, 0.0, 0.0],
        {"coils.i": lambda y: y[:, 2],
         "driver.drive": lambda y: np.array([coil_loop(row, 2e4, 0.2)[1] for row in y])},
        {"rail": 100.0, "bandwidth": 2e4, "slew": 5e6},
    ),
    "pwm_drive": (
        pwm_drive, WINDINGS, STEP, 3e-5, [0.0, 0.0, 0.0],
        {"coils.i": lambda y: y[:, 2], "driver.i": lambda y: y[:, 2]},
        {"rail": 400.0, "frequency": 1e5, "bandwidth": 2e4, "resistance": 3.0, "edge": 2e-7},
    ),
    "half_bridge": (
        half_bridge, RINGING, FAST, 2e-5, [100.0, 0.0, 0.0, 12.0, 0.0, 0.0],
        {"chip.v": lambda y: y[:, 5], "driver.i": lambda y: y[:, 4],
         "driver.out": lambda y: y[:, 2] - 0.3 * y[:, 4]},
        {"rail": 100.0, "resistance": 0.3, "current_limit": 5.0, "gate_resistance": 10.0,
         "reservoir": 1e-6, "supply_resistance": 100.0, "leakage": 1e7},
    ),
}  # fmt: skip


def off(ours, exact):
    """Rms of a difference of two waves, relative to the rms of the second one."""
    return float(np.sqrt(np.mean((ours - exact) ** 2) / np.mean(exact**2)))


@pytest.mark.parametrize(
    "name",
    [
        *(name for name in CASES if name != "half_bridge"),
        pytest.param("half_bridge", marks=pytest.mark.slow),
    ],
)
def test_a_law_a_netlist_and_equations_by_hand_agree(name, tmp_path, monkeypatch):
    equations, load, wave, stop, start, results, keys = CASES[name]
    for driver in (LinearDrive, PwmDrive):
        monkeypatch.setattr(driver, "compute_coil_load", lambda self, part, build: COILS)
    largest = stop / (8000 if name == "half_bridge" else 2000)
    scene = {
        "name": "driven", "analysis": {"type": "transient", "stop": stop},
        "driver": {"part": name, **keys},
        "command": {"part": "source", "pulse": wave, "pins": {"out": "driver.command"}},
        "solver": {"reltol": 1e-6, "max_step": largest}, **load,
    }  # fmt: skip
    waves, exact, failed = both(load_scene(scene), tmp_path)
    assert {check.name for check in failed} <= {"clipping of driver"}  # each driver meets its rails
    t = exact["time"]
    if name == "linear_drive":
        keys = keys | {"current_limit": 2 * COILS.current}
    ends = corners(wave["start"], wave["edge"], wave["width"])
    if name == "pwm_drive":
        ends = (*ends, *np.arange(0.0, stop, 1e-6))  # so that no step misses an edge of the bridge
    times, states = integrated(
        lambda t, y: equations(t, y, wave["high"], **keys), np.array(start), ends, stop, t
    )
    # the current of the bridge is the small voltage of 3 Ohm, interpolated between time steps
    limit = 1e-4 if name == "pwm_drive" else 1e-5
    for result, read in results.items():
        hand = np.interp(waves["time"], times, read(states))
        assert off(np.interp(waves["time"], t, exact[result]), hand) < limit, result
        assert off(waves[result], hand) < 2e-4, result


def test_leaks_of_a_charge_drive_keep_its_operating_point(tmp_path):
    """Leaks in the ratio of the capacitances leave the command on the chip, whatever it has."""
    waves, exact, failed = both(load_scene({
        "name": "still", "analysis": {"type": "op"}, **FLOATING,
        "driver": {"part": "charge_drive"},
        "command": {"part": "source", "dc": 10.0, "pins": {"out": "driver.command"}},
    }), tmp_path)  # fmt: skip
    assert not failed
    loop = 1 + 1e-7 * (1 + 1e-6 / 150e-9)  # an amplifier of gain 1e7
    assert exact["chip.v"][0] == pytest.approx(10.0 / loop, rel=1e-8)
    assert waves["chip.v"][0] == pytest.approx(exact["chip.v"][0], rel=1e-6)


def test_a_source_replaces_an_unknown_driver_beside_coils(model, table):
    """A user's netlist kicks a body; the driver of the coils has equations."""
    scene = load_scene("bring_your_own", {"catch.driver.linear.rail": 48.0})
    laws = get_scene_laws(built(scene, model, table))
    assert laws.parts_without_law == ("kick_driver",)
    assert find_replayed_nets(laws) == {"kick_anode": "electrical"}


def test_a_controller_commands_a_driver_by_its_law(model, table):
    """The sphere passes the set point at 10 mm/s: ``100 Ohm (kp e + ki int e dt + kd de/dt)``."""
    laws = get_scene_laws(built(load_scene("coil_rails"), model, table))
    assert laws.parts_without_law == ()
    law, keys = laws.laws["control"], laws.build.scene.parts["control"].keys
    setpoint = law.values[law.declaration.parameters.index("setpoint")]
    speed, stop, on = 0.01, 4e-3, 1e-6
    first = setpoint - speed * stop / 2
    path = make_linear_waveform(
        ((0.0, 1e6 * first), (stop, 1e6 * (first + speed * stop)))
    )  # um, a signal
    enabled = make_linear_waveform(((0.0, 0.0), (on, 0.0), (1.01 * on, 1.0)))
    sources = [L.IdealSource("y", "signal", path), L.IdealSource("enable", "signal", enabled)]
    joins = {"y": ("y.out", "control.y"), "enable": ("enable.out", "control.enable")}
    run = solve_transient(
        assemble_system([law, *sources], joins), stop, 1e-9, np.linspace(0, stop, 201)
    )
    t = run.time[run.time > 30e-6]
    error = speed * (stop / 2 - t)
    integral = speed * ((stop * t - t**2) - (stop * on - on**2)) / 2
    exact = 100.0 * (keys.kp * error + keys.ki * integral - keys.kd * speed)
    command = run.waves["control.command"][run.time > 30e-6]
    np.testing.assert_allclose(command, exact, atol=1e-6 * np.abs(exact).max())
