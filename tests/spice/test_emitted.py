"""The error estimate of a library is that of its elements: ngspice and closed forms against it."""

import json
import re
import warnings
from itertools import product

import numpy as np
import pytest
from device import bench
from support import (
    Certificate,
    GateMissedError,
    LinearModel,
    Param,
    ParameterAxis,
    Port,
    ResonatorsOverRanges,
    app,
    estimate_circuit_error,
    evaluate_polynomials,
    parameter_ranges,
    parametric_subcircuit,
    read_cards,
    require_circuit_tolerance,
    run_deck,
    subcircuit,
    terminals,
)
from typer.testing import CliRunner

W, Q, FORCE, CHARGE, CLAMPED = 2 * np.pi * 1e3, 50.0, 3.0, 2e-4, 20e-12
BAND = (0.01, 2e3)
CERTIFICATE = Certificate(BAND, 1e-6, "by hand", True, True)
PORTS = (Port("anode", "electrical", pins=("anode", "cathode")), Port("tip", "mechanical"))


def sensor(certificate=CERTIFICATE):
    """One mode, moved by a force and by the voltage of 20 pF."""
    return LinearModel(
        M=np.eye(1), E=np.array([[W / Q]]), K=np.array([[W**2]]), B=np.array([[CHARGE, FORCE]]),
        D=np.diag([CLAMPED, 0.0]), ports=PORTS, certificate=certificate,
    )  # fmt: skip


def charges(f):
    """Charge per volt and per newton (n,) of it."""
    s = 2j * np.pi * f
    z = 1 / (s**2 + s * W / Q + W**2)
    return CLAMPED + CHARGE**2 * z, CHARGE * FORCE * z


def test_a_small_floating_electrode_keeps_its_charge_at_a_hundredth_of_a_hertz(tmp_path):
    """Pushed: on 30 pF against its own capacitance, and into a charge amplifier."""
    part = subcircuit(sensor(), "sensor")
    cards = """
Cload open 0 30e-12
Xopen open 0 tip1 0 sensor
Itip1 0 tip1 DC 0 AC 1
Vamp short 0 DC 0 AC 0
Xshort short 0 tip2 0 sensor
Itip2 0 tip2 DC 0 AC 1
.ac dec 4 0.01 2000"""
    vectors = {"open": ("v(open)", 1.0), "short": ("i(vamp)", -1.0)}
    waves = run_deck(bench([part], cards, vectors), tmp_path)
    f = waves["frequency"].real
    per_volt, per_newton = charges(f)
    open_volts = -per_newton / (per_volt + 30e-12)
    assert np.abs(waves["open"] / open_volts - 1).max() < 1e-7
    assert np.abs(waves["short"] / (2j * np.pi * f * per_newton) - 1).max() < 1e-7


def test_the_error_of_an_element_is_detected_at_the_lowest_frequency():
    """A leak g takes g / (w C) of the current."""
    part = subcircuit(sensor(), "sensor")
    assert part.reduction.circuit_error == pytest.approx(1e-9 / (2 * np.pi * BAND[0]), rel=1e-3)
    assert part.reduction.worst_hz == BAND[0]
    text = re.sub(r"(?m)^(Gleak .*) \S+$", r"\1 1e-15", part.text)
    leaky = read_cards(text, part.filename).subcircuits[0]
    found = estimate_circuit_error(leaky, part.pins, sensor(), BAND)
    assert found.error == pytest.approx(1e-15 / (2 * np.pi * BAND[0] * CLAMPED), rel=1e-3)
    assert found.frequency == BAND[0]


def test_the_error_of_an_element_is_detected_at_a_resonance():
    """A damping that is 1 % off, at the resonance."""
    part = subcircuit(sensor(), "sensor")
    drag = float(re.search(r"(?m)^Gd1 .*\{damping\*(\S+)\}", part.text)[1])
    off = part.text.replace(f"damping*{drag}", f"damping*{1.01 * drag}")
    found = estimate_circuit_error(
        read_cards(off, part.filename).subcircuits[0], part.pins, sensor(), BAND
    )
    assert found.error == pytest.approx(0.01 / 1.01, rel=1e-3)
    assert found.frequency == pytest.approx(1e3, rel=1e-3)


def test_the_head_states_the_error_of_the_elements(monkeypatch):
    monkeypatch.setattr(terminals, "LEAK_RATE", 1e-3)
    part = subcircuit(sensor(), "sensor")
    leaked = 1e-3 / (2 * np.pi * BAND[0])
    assert part.reduction.error_estimate == pytest.approx(1e-6 + leaked, rel=1e-3)
    stated = float(re.search(r"norm=\w+ error=(\S+)", part.text)[1])
    assert leaked < stated < 1.02 * leaked
    with pytest.raises(GateMissedError, match="exceeds the tolerance"):
        require_circuit_tolerance(part, sensor(), 1e-3)
    require_circuit_tolerance(part, sensor(), 0.1)


def test_rounding_of_the_given_matrices_is_no_fault_of_the_circuit():
    """The difference of two stiffnesses of 1e13 carries the response."""
    stiff = 1e13
    K = stiff * np.array([[1.0, -1.0], [-1.0, 1.0]]) + np.eye(2)
    certificate = Certificate((0.01, 0.1), 1e-9, "by hand", True, True)
    model = LinearModel(
        M=np.eye(2), E=np.diag([0.1, 0.3]), K=K, B=np.array([[1.0], [2.0]]),
        ports=(Port("tip", "mechanical"),), certificate=certificate,
    )  # fmt: skip
    part = subcircuit(model, "soft")
    assert part.reduction.circuit_error > 1e-5
    with pytest.warns(UserWarning, match="rounding errors in the matrices of the model"):
        require_circuit_tolerance(part, model, 1e-8)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        require_circuit_tolerance(subcircuit(sensor(), "sensor"), sensor(), 1e-5)


def test_parametric_circuits_are_compared_at_corners_and_inside(monkeypatch):
    """A frequency that grows with a parameter's power, in the netlist 1e-6 of it too strongly."""
    axis = ParameterAxis("length", 0.5, 2.0)
    exponents = np.array([[0], [1]])
    model = ResonatorsOverRanges(
        axes=(axis,), losses=(), ports=PORTS[1:], exponents=exponents, blocks=(1,),
        diagonal=np.array([[np.log(W)], [0.2]]), below=np.zeros((2, 1, 1)),
        gain=np.array([[[FORCE]], [[0.0]]]), capacitance=np.zeros((2, 0)),
        shared=np.zeros((2, 0, 0)), rayleigh=np.array([[0.0, np.log(1e-5)], [0.0, 0.0]]),
        damped=(False, True), facts={}, certificate=CERTIFICATE,
    )  # fmt: skip
    parameter = Param("length", 1.0, "m", "of it", 0.5, 2.0)
    points = [at for _, at in parameter_ranges.sample_range(model, [parameter])]
    assert {0.5, 2.0} <= {at["length"] for at in points}
    assert sum(0.5 < at["length"] < 2.0 for at in points) >= 4
    part = parametric_subcircuit(model, "bar", [parameter])
    assert part.reduction.circuit_error < 1e-9
    spelled = evaluate_polynomials(np.array([[1.0]]), exponents)  # what x1 = 1 must give
    assert spelled.tolist() == [[1.0, 1.0]]
    text = part.text.replace("l1_1={exp(", "l1_1={exp(1e-6*x1+")
    assert text != part.text
    circuit = read_cards(text, part.filename).subcircuits[0]
    errors = {}
    for value in (1.0, 2.0):
        exact = model.evaluate({"length": value})
        errors[value] = estimate_circuit_error(
            circuit, part.pins, exact, BAND, values={"length": value}
        )
    assert errors[1.0].error < 1e-9
    quality = 1 / (1e-5 * W * np.exp(0.2))
    assert errors[2.0].error == pytest.approx(2e-6 * quality, rel=0.05)


def test_reduce_and_export_end_with_4_where_the_circuit_misses_the_tolerance(monkeypatch, tmp_path):
    rng = np.random.default_rng(1)
    K = np.diag((2 * np.pi * np.linspace(1e3, 9e3, 6)) ** 2)
    B = rng.normal(size=(6, 1))
    np.savez(tmp_path / "m.npz", M=np.eye(6), E=1e-6 * K, K=K, B=1e-3 * B, C=1e-3 * B.T,
             D=np.array([[1e-12]]))  # fmt: skip
    (tmp_path / "m.toml").write_text('[[ports]]\nname = "plate"\nkind = "electrical"\ncolumn = 1\n')
    words = ["reduce", str(tmp_path / "m.npz"), "--band", "1", "8000", "--tolerance", "1e-4"]
    fine = CliRunner().invoke(app, [*words, "-o", str(tmp_path / "fine"), "--json"])
    assert fine.exit_code == 0, fine.output
    assert json.loads(fine.stdout)["error_estimate"] < 1e-4
    scene = tmp_path / "s.toml"
    scene.write_text(
        '[body]\npart = "matrices"\nfile = "m.npz"\npins = { plate = "v.out" }\n'
        '[body.rom]\ntolerance = 1e-4\nband = ["1 Hz", "8 kHz"]\n'
        '[v]\npart = "source"\nac = "1 V"\n'
        '[analysis]\ntype = "ac"\nstart = "1 Hz"\nstop = "8 kHz"\npoints = 20\n'
    )
    monkeypatch.setattr(terminals, "LEAK_RATE", 0.1)
    for command in (words, ["export", str(scene)]):
        missed = CliRunner().invoke(app, [*command, "-o", str(tmp_path / "missed")])
        assert missed.exit_code == 4, missed.output
        assert not (tmp_path / "missed").exists()


@pytest.mark.parametrize(("dense", "noise"), list(product([False, True], repeat=2)))
def test_every_form_of_a_circuit_agrees_with_its_model(dense, noise):
    part = subcircuit(sensor(), "sensor", dense=dense, noise=noise)
    assert part.reduction.circuit_error < 2e-8
