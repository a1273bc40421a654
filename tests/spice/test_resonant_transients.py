"""Plain transients of what resonates are right, or refused: no scene says how to step.

The oracle shares nothing with the product but the bodies' matrices, reduced over a band wide enough
by themselves: scipy's exact response of ``M x'' + E x' + K x = B u`` to a drive of straight lines
on a grid, fine enough for a sine that what lies between its points is 1e-6 of it.
"""

import warnings
from pathlib import Path

import numpy as np
import pytest
from device import models
from scipy.signal import lsim
from support import LinearisedSystem, SimulationError, load_scene, run_scene

import kc2spice as kc

DISC = """
[body]
part = "disc"
layers = [
  { material = "brass", diameter = "20 mm", thickness = "0.2 mm" },
  { material = "PZT-5A", diameter = "15 mm", thickness = "0.22 mm" },
]
support = { node = "13 mm" }
damping = { quality = QUALITY }
pins = { anode = "drive.out", cathode = "gnd" }
"""
PORT, HIGH = "centre", 3e5  # judged there; highest frequency of the oracle's model [Hz]
FREQUENCY = {"rlc": 10e3, "oscillator": 5e3}


def circuit(family, quality):
    """Text of a scene, its output, and M, E, K, B, C of it with the drive as input."""
    if family == "disc":
        text = DISC.replace("QUALITY", f"{quality:g}")
        return f"{text}\n[probes]\np = {{ of = 'body.u.{PORT}' }}\n", f"body.u.{PORT}", None
    w = 2 * np.pi * FREQUENCY[family]
    scale = 1e-3  # H, or kg
    loss, stiff = scale * w / quality, scale * w**2
    parts = [("l", "inductor", "inductance", scale, "r.b"), ("c", "capacitor", "capacitance",
             1 / stiff, "l.b"), ("r", "resistor", "resistance", loss, "drive.out")]  # fmt: skip
    if family == "oscillator":
        parts = [("m", "mass", "mass", scale, "k.a"), ("d", "damper", "damping", loss, "m.a"),
                 ("k", "spring", "stiffness", stiff, "drive.out")]  # fmt: skip
    text = "".join(
        f'[{name}]\npart = "{kind}"\n{key} = {value!r}\npins = {{ a = "{pin}" }}\n'
        for name, kind, key, value, pin in parts
    )
    if family == "rlc":
        return text, "c.v", (scale, loss, stiff, stiff, 1.0)
    return text, "m.x", (scale, loss, stiff, 1.0, 1.0)


def drive(shape, f, family, cycles):
    """The source's table, its values over time, and the end of the run."""
    kind = 'kind = "force"\n' if family == "oscillator" else ""
    edge, period = 0.02 / f, 1 / f
    if shape == "sine":
        text = f"sine = {{ amplitude = 1.0, frequency = {f!r} }}"
        return kind + text, lambda t: np.sin(2 * np.pi * f * t), cycles / f
    count = 5 if shape == "burst" else cycles + 1
    text = (
        f"pulse = {{ high = 1.0, width = {period / 2!r}, edge = {edge!r}, "
        f"period = {period!r}, count = {count} }}"
    )
    corners = [0, edge, period / 2, period / 2 + edge, period]

    def value(t):
        inside = np.interp(np.mod(t, period), corners, [0, 1, 1, 0, 0])
        return np.where(t < count * period, inside, 0.0)

    return kind + text, value, cycles / f


def oracle(matrices, value, stop, f):
    """Times and output of scipy on a grid that holds the corners."""
    M, E, K, B, C = (np.atleast_2d(x) for x in matrices)
    n = len(M)
    inverse = np.linalg.inv(M)
    A = np.block([[np.zeros((n, n)), np.eye(n)], [-inverse @ K, -inverse @ E]])
    drive = np.vstack([np.zeros((n, 1)), inverse @ B.reshape(n, 1)])
    out = np.hstack([C.reshape(1, n), np.zeros((1, n))])
    step = 1 / (1000 * f)
    t = np.arange(round(stop / step) + 1) * step
    scale = np.concatenate([np.ones(n), np.full(n, 2 * np.pi * f)])  # equal sizes of the states
    _, y, _ = lsim(
        (A * scale / scale[:, None], drive / scale[:, None], out * scale, 0), value(t), t
    )
    return t, y


def body_matrices(text, folder):
    """The body's matrices from voltage to displacement, and its strongest resonance [Hz]."""
    path = folder / "wide.toml"
    path.write_text(
        'name = "wide"\n' + text + f"\n[rom]\ntolerance = 1e-5\nband = [0, {HIGH!r}]\n"
        '[drive]\npart = "source"\nac = 1.0\n[analysis]\ntype = "ac"\nstart = 1\nstop = 2\n'
    )
    model = models(path).models["body"]
    K, E, M = model.pencil.make_dense().coefficients
    i, o = model.inputs.index("anode"), model.outputs.index(PORT)
    f = np.geomspace(HIGH / 300, HIGH, 6000)
    s = 2j * np.pi * f[:, None, None]
    x = np.linalg.solve(s**2 * M + s * E + K, np.tile(model.B[:, [i]], (f.size, 1, 1)))
    peak = f[np.abs(model.C[o] @ x[..., 0].T).argmax()]
    return (M, E, K, model.B[:, i], model.C[o]), float(peak)


def judged(family, quality, shape, folder, cycles, detune=0.0):
    """Error of the amplitude and of the wave, None where the run was refused."""
    text, output, matrices = circuit(family, quality)
    f = FREQUENCY.get(family)
    if matrices is None:
        matrices, f = body_matrices(text, folder)
    f *= 1 + detune / quality
    table, value, stop = drive(shape, f, family, cycles)
    path = folder / "case.toml"
    path.write_text(
        f'name = "case"\n{text}\n[drive]\npart = "source"\n{table}\n'
        f'[analysis]\ntype = "transient"\nstop = {stop!r}\n'
    )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            run_scene(load_scene(path), folder / "out")
    except SimulationError:
        return None
    found = np.load(folder / "out" / "waveforms.npz")
    t, exact = oracle(matrices, value, stop, f)
    ours = np.interp(t, found["time"], found[output])
    found, rms = (
        np.array([np.sqrt(np.mean(part**2)) for part in np.array_split(wave, 8)])
        for wave in (ours, exact)
    )
    amplitude = np.abs(found - rms).max() / rms.max()
    return amplitude, np.abs(ours - exact).max() / np.abs(exact).max()


FEW = [
    ("rlc", 30, "square", 30, 0.0), ("oscillator", 300, "burst", 50, 0.0),
    pytest.param("disc", 30, "sine", 25, 0.3, marks=pytest.mark.slow),
]  # fmt: skip
MANY = [
    (family, quality, shape, cycles, detune)
    for family in ("rlc", "oscillator", "disc")
    for quality, shape, cycles, detune in (
        (10, "sine", 40, 0.0), (1000, "sine", 150, 0.5), (100, "sine", 200, 0.5),
        (30, "square", 50, 0.0), (300, "square", 150, 0.2), (1000, "burst", 100, 0.0),
    )
]  # fmt: skip


@pytest.mark.parametrize(("family", "quality", "shape", "cycles", "detune"), FEW)
def test_a_plain_run_is_right_to_a_thousandth(family, quality, shape, cycles, detune, tmp_path):
    amplitude, wave = judged(family, quality, shape, tmp_path, cycles, detune)
    assert amplitude < 1e-3
    assert wave < 3e-3  # interpolation between its points and SHAPE of the steps


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize(("family", "quality", "shape", "cycles", "detune"), MANY)
def test_resonant_transients_are_right_or_refused(family, quality, shape, cycles, detune, tmp_path):
    found = judged(family, quality, shape, tmp_path, cycles, detune)
    print(f"RESONANT {family} Q {quality} {shape}: {found}")
    assert found is None or found[0] < 1e-2


def test_an_edge_that_begins_at_the_end_of_the_run_is_no_error_of_its_steps():
    """36 periods of 250 us end at 9 ms, where a current may already be that of the next edge."""
    tables = {
        "drive": {"part": "source", "pulse": {"high": "5 V", "width": "125 us", "edge": "0.1 us",
                                              "period": "250 us"}},
        "r": {"part": "resistor", "resistance": "1 kOhm", "pins": {"a": "drive.out"}},
        "c": {"part": "capacitor", "capacitance": "20 nF", "pins": {"a": "r.b"}},
        "analysis": {"type": "transient", "stop": "9 ms"},
    }  # fmt: skip
    (check,) = (c for c in kc.run(kc.load_scene(tables)).checks if c.name.startswith("time steps"))
    assert check.value < 1e-3


def test_a_run_solves_the_eigenvalues_of_its_circuit_once(monkeypatch):
    """The choice of the largest step and the check of the steps share one record."""
    tables = {
        "drive": {"part": "source", "pulse": {"high": "5 V", "width": "0.2 ms", "edge": "1 us"}},
        "r": {"part": "resistor", "resistance": "10 Ohm", "pins": {"a": "drive.out"}},
        "l": {"part": "inductor", "inductance": "1 mH", "pins": {"a": "r.b"}},
        "c": {"part": "capacitor", "capacitance": "20 nF", "pins": {"a": "l.b"}},
        "analysis": {"type": "transient", "stop": "0.4 ms"},
    }  # fmt: skip
    solved, modes = [], LinearisedSystem.modes.func

    def counted(linear):
        solved.append(linear)
        return modes(linear)

    monkeypatch.setattr(LinearisedSystem.modes, "func", counted)
    result = kc.run(kc.load_scene(tables))
    assert len(solved) == 1
    assert [check.name for check in result.checks if check.name.startswith("time steps")]
    assert "natural mode at" in result.record["largest_step"]["why"]


@pytest.mark.parametrize("small", [1.0, 1e-6])
def test_a_capacitor_between_two_free_nodes_leaves_the_resonance_known(small):
    """A capacitor between a coil and a load stores charge, but its nodes carry no more of it.

    The power is that of scipy's exact response to the square wave. With ``small``, capacitors of
    very different sizes are in the same circuit: a second branch without effect on the load.
    """
    inductance, resistance, capacitance = 1e-3, 10.2, 7.036e-9
    period, width, edge, grid = 16.66e-6, 8.28e-6, 50e-9, 10e-9
    tables = {
        "drive": {"part": "source", "pulse": {"high": "24 V", "width": width, "edge": edge,
                                              "period": period}},
        "rs": {"part": "resistor", "resistance": 0.2, "pins": {"a": "drive.out"}},
        "l": {"part": "inductor", "inductance": inductance, "pins": {"a": "rs.b"}},
        "c": {"part": "capacitor", "capacitance": capacitance, "pins": {"a": "l.b", "b": "load.a"}},
        "load": {"part": "resistor", "resistance": 10.0},
        "r2": {"part": "resistor", "resistance": 1e3, "pins": {"a": "drive.out"}},
        "c2": {"part": "capacitor", "capacitance": small * 1e-9,
               "pins": {"a": "r2.b", "b": "r3.a"}},
        "r3": {"part": "resistor", "resistance": 1e3},
        "analysis": {"type": "transient", "stop": "5 ms"},
        "probes": {"p": {"of": "load.power", "take": "mean"}},
    }  # fmt: skip
    result = kc.run(kc.load_scene(tables))
    t = grid * np.arange(round(5e-3 / grid) + 1)
    corners = [0.0, edge, width, width + edge, period]
    voltage = np.interp(np.mod(t, period), corners, [0.0, 24.0, 24.0, 0.0, 0.0])
    _, current, _ = lsim(
        ([1.0, 0.0], [inductance, resistance, 1 / capacitance]), voltage, t
    )  # I/U = s / (L s^2 + R s + 1/C)
    expected = 10.0 * np.trapezoid(current**2, t) / t[-1]
    assert result.metrics["p"] == pytest.approx(expected, rel=1e-3)
    assert "natural mode at" in result.record["largest_step"]["why"]


def test_a_pulse_train_limits_the_step_of_a_circuit_without_equations(tmp_path):
    """The simulator takes 50 steps per period of the train, also if the run has 1000 periods."""
    (tmp_path / "stage.lib").write_text(
        "* stage\n.subckt stage in out ref\nR1 in out 10\nC1 out ref 1n\n.ends\n"
    )
    scene = tmp_path / "stage.toml"
    scene.write_text(
        """
[gate]
part = "source"
pulse = { high = "5 V", width = "8 us", edge = "0.1 us", period = "20 us" }
[stage]
part = "netlist"
file = "stage.lib"
subckt = "stage"
pins = { in = "gate.out", out = "load.a", ref = "gnd" }
[load]
part = "resistor"
resistance = "1 kOhm"
[analysis]
type = "transient"
stop = "20 ms"
"""
    )
    result = kc.run(scene)
    assert result.record["largest_step"]["s"] == pytest.approx(20e-6 / 50)
    assert "1/50 of a period of gate" in result.record["largest_step"]["why"]


BVD_C0, BVD_FS, BVD_CM, BVD_RM = 17.717e-9, 4400.0, 2.1652e-9, 200.97  # of a buzzer disc
BVD_LM = 1 / ((2 * np.pi * BVD_FS) ** 2 * BVD_CM)
SQUARE = {"high": "5 V", "width": "113.636 us", "edge": "0.1 us", "period": "227.272 us"}


def bvd_behind_netlist(cards, **keys):
    """Tables of a resonator whose drive passes a user's netlist with the pins in and out."""
    Path("stage.lib").write_text(f"* stage\n.subckt stage in out\n{cards}\n.ends\n")
    values = {"fs": BVD_FS, "cm": BVD_CM, "c0": BVD_C0, "rm": BVD_RM}
    return {
        "buzzer": {"part": "bvd", **values, **keys, "pins": {"anode": "stage.out"}},
        "stage": {"part": "netlist", "file": "stage.lib", "subckt": "stage",
                  "pins": {"in": "gate.out"}},
        "gate": {"part": "source", "pulse": SQUARE},
        "analysis": {"type": "transient", "stop": "20 ms"},
        "probes": {"swing": {"of": "buzzer.voltage", "take": "peak_to_peak", "periods": 5}},
    }  # fmt: skip


def exact_bvd_voltage(resistance, stop=20e-3, grid=20e-9):
    """Voltage of the resonator behind a resistor and the square wave: scipy's exact response."""
    t = grid * np.arange(round(stop / grid) + 1)
    drive = np.interp(np.mod(t, 227.272e-6), np.array([0, 0.1, 113.636, 113.736, 227.272]) * 1e-6,
                      [0.0, 5.0, 5.0, 0.0, 0.0])  # fmt: skip
    # states: voltage v of c0, current j of lm, voltage u of cm
    A = np.array([[-1 / resistance / BVD_C0, -1 / BVD_C0, 0.0],
                  [1 / BVD_LM, -BVD_RM / BVD_LM, -1 / BVD_LM], [0.0, 1 / BVD_CM, 0.0]])  # fmt: skip
    B = np.array([[1 / resistance / BVD_C0], [0.0], [0.0]])
    _, y, _ = lsim((A, B, [[1.0, 0.0, 0.0]], [[0.0]]), drive, t)
    return t, y


@pytest.mark.parametrize("largest", [None, "4.545 us"])
def test_a_resonator_behind_a_netlist_is_as_accurate_as_on_a_source(largest, tmp_path, monkeypatch):
    """Without a step of the scene, the device limits the step; a longer step is found and refined.

    The step of 4.545 us is 1/50 of the period; with it, the voltage was 5 % too large.
    """
    monkeypatch.chdir(tmp_path)
    tables = bvd_behind_netlist("R1 in out 2k")
    if largest:
        tables["solver"] = {"max_step": largest}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = kc.run(kc.load_scene(tables))
    t, voltage = exact_bvd_voltage(2e3)
    last = voltage[t > t[-1] - 5 * 227.272e-6]
    assert result.metrics["swing"] == pytest.approx(np.ptp(last), rel=3e-3)
    names = {check.name: check for check in result.checks}
    assert names["time steps of buzzer compared with its exact response"].value < 0.01
    assert "energy of buzzer" in names
    if largest is None:
        assert "natural mode at" in result.record["largest_step"]["why"]
    else:
        assert result.record["simulator"]["attempts"][1:]  # the check asked for a second run


def test_a_current_source_does_not_hide_the_natural_modes_of_a_resonator(tmp_path, monkeypatch):
    """A current into a floating capacitance has no bounded answer, but the mode limits the step."""
    monkeypatch.chdir(tmp_path)
    tables = bvd_behind_netlist("R1 in out 2k")
    del tables["stage"]
    tables["buzzer"]["pins"] = {"anode": "gate.out"}
    tables["analysis"]["stop"] = "60 ms"  # ten time constants of the mode
    f = 4640.0
    tables["gate"] = {"part": "source", "kind": "current",
                      "sine": {"amplitude": "1 mA", "frequency": f}}  # fmt: skip
    result = kc.run(kc.load_scene(tables))
    assert "natural mode at" in result.record["largest_step"]["why"]
    w = 2j * np.pi * f
    admittance = w * BVD_C0 + 1 / (BVD_RM + w * BVD_LM + 1 / (w * BVD_CM))
    expected = 2e-3 / abs(admittance)
    assert result.metrics["swing"] == pytest.approx(expected, rel=5e-3)


def test_a_free_disc_with_a_radiation_load_limits_the_step(tmp_path):
    """Neither the missing equilibrium of a free disc nor its radiation hides its modes."""
    text = DISC.replace("QUALITY", "80").replace('support = { node = "13 mm" }', "")
    text = text.replace('anode = "drive.out"', 'front_face = "front.face", anode = "stage.out"')
    scene = tmp_path / "disc.toml"
    (tmp_path / "stage.lib").write_text("* s\n.subckt stage in out\nR1 in out 10\n.ends\n")
    scene.write_text(
        text
        + """
[front]
part = "radiation"
shape = "baffled_piston"
radius = "10 mm"
motion = "piston"
[stage]
part = "netlist"
file = "stage.lib"
subckt = "stage"
pins = { in = "drive.out" }
[drive]
part = "source"
pulse = { high = "5 V", width = "76 us", edge = "5 us", period = "152 us" }
[analysis]
type = "transient"
stop = "5 ms"
"""
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        limit = run_scene(kc.load_scene(str(scene)), tmp_path / "out")["largest_step"]
    assert "natural mode at" in limit["why"]
    assert limit["s"] < 1e-6  # 1/50 of the period of the drive is 3.04 us


@pytest.mark.parametrize(("rated", "passes"), [("15 V", True), ("6 V", False)])
def test_the_simulated_voltage_is_compared_with_the_rated_voltage(
    rated, passes, tmp_path, monkeypatch
):
    """An inductor in the netlist raises the voltage far above the 5 V of the source."""
    monkeypatch.chdir(tmp_path)
    tables = bvd_behind_netlist("R1 in a 50\nL1 a out 10m", rated_voltage=rated)
    tables["analysis"]["stop"] = "2 ms"
    with warnings.catch_warnings(record=True) as seen:
        warnings.simplefilter("always")
        result = kc.run(kc.load_scene(tables))
    check = next(check for check in result.checks if check.name == "rating of buzzer")
    assert check.value == pytest.approx(np.abs(result.waves["buzzer.voltage"]).max())
    assert check.passed is passes
    assert any("peak voltage of buzzer" in str(row.message) for row in seen) is not passes
