"""Noise against equipartition and against what a body answers at its port."""

import numpy as np
import pytest
from support import NOISE_WAVE, Waveforms, noise_analysis

import kc2spice as kc

KT = 1.380649e-23 * 300.15  # J
CIRCUIT = """
[analysis]
type = "noise"
output = "{output}"
start = {start}
stop = {stop}
points = {points}
"""
OSCILLATOR = """
[mass]
part = "mass"
mass = "1 ug"
pins = { a = "spring.a" }
[spring]
part = "spring"
stiffness = "10 N/m"
[damper]
part = "damper"
damping = "1e-5 N s/m"
pins = { a = "spring.a" }
"""
FILTER = """
[r]
part = "resistor"
resistance = "1 MOhm"
pins = { a = "c.a" }
[c]
part = "capacitor"
capacitance = "1 nF"
"""
BEAM = """
[beam]
part = "bimorph"
length = "10 mm"
width = "2 mm"
layers = [{ material = "PZT-5A", thickness = "0.1 mm" }, { material = "PZT-5A", thickness = "0.1 mm" }]
wiring = "series"
damping = { ratio = 0.01 }
pins = { anode = "gnd", base = "gnd", tip = "rest.a" }
[rest]
part = "spring"
stiffness = "1 uN/m"
"""  # noqa: E501
COIL = """
[coil]
part = "voice_coil"
resistance = "6 Ohm"
inductance = "0.5 mH"
bl = "5 N/A"
cms = "1 mm/N"
damping = "1 N s/m"
pins = { plus = "gnd", minus = "gnd", a = "cone.a" }
[cone]
part = "mass"
mass = "10 g"
"""


def noise(tmp_path, parts, **words):
    scene = tmp_path / "noisy.toml"
    scene.write_text(parts + CIRCUIT.format(**words))
    return kc.run(scene)


@pytest.mark.parametrize(
    ("parts", "output", "total", "unit"),
    [
        (OSCILLATOR, "mass.x", np.sqrt(KT / 10), "m"),
        (FILTER, "c.v", np.sqrt(KT / 1e-9), "V"),
        (COIL, "coil.x", np.sqrt(KT * 1e-3), "m"),
    ],
)
def test_equipartition(tmp_path, parts, output, total, unit):
    found = noise(tmp_path, parts, output=output, start=0.01, stop=1e7, points=4000)
    # of the band: 0.01 Hz misses 1e-4 of the power of the filter, the rule of integration 1e-5
    assert found.metrics["noise"] == pytest.approx(total, rel=1e-4)
    assert found.record["metric_units"]["noise"] == unit
    added = [wave for name, wave in found.waves.items() if name.startswith("noise.")]
    np.testing.assert_allclose(np.linalg.norm(added, axis=0), found.waves["noise"], rtol=1e-6)


@pytest.mark.slow
def test_a_body_has_the_noise_of_its_dissipation(tmp_path):
    found = noise(tmp_path, BEAM, output="beam.tip", start=100, stop=3000, points=40)
    f = found.frequency[::6]
    full = kc.build(tmp_path / "noisy.toml")["beam"]
    s = 2j * np.pi * f
    tip = full.inputs.index("tip")
    compliance = 1 / (1e-6 + 1 / full.transfer(f)[:, tip, tip])
    density = np.sqrt(4 * KT * (s * compliance).real) / np.abs(s)
    # the reduction's tolerance on a peak of a hundredth of damping
    np.testing.assert_allclose(found.waves["noise"][::6], density, rtol=3e-3)


def test_damping_that_couples_modes(tmp_path):
    """Two masses whose damper is on one of them: no modes of their own, but a body's blocks."""
    M, K, E = np.diag([1e-6, 2e-6]), np.array([[3e2, -1e2], [-1e2, 2e2]]), np.diag([1e-3, 0.0])
    np.savez(tmp_path / "two.npz", M=M, K=K, E=E, B=np.array([[0.0], [1.0]]))
    (tmp_path / "two.toml").write_text('[[ports]]\nname = "tip"\nkind = "mechanical"\ncolumn = 1\n')
    body = '[body]\npart = "matrices"\nfile = "two.npz"\n[rest]\npart = "spring"\n'
    body += 'stiffness = "1 uN/m"\npins = { a = "body.tip" }\n'
    found = noise(tmp_path, body, output="body.tip", start=100, stop=1e4, points=600)
    s = 2j * np.pi * found.frequency
    P = s[:, None, None] ** 2 * M + s[:, None, None] * E + K + np.diag([0.0, 1e-6])
    compliance = np.linalg.inv(P)[:, 1, 1]
    density = np.sqrt(4 * KT * (s * compliance).real) / np.abs(s)
    np.testing.assert_allclose(found.waves["noise"], density, rtol=1e-6)


AMPLIFIER = """
[amplifier]
part = "amplifier"
{given}
pins = {{ command = "gnd", out = "load.a" }}
[load]
part = "resistor"
resistance = "1 GOhm"
"""


@pytest.mark.parametrize(("volts", "amperes"), [(0.0, 0.0), (20e-9, 0.0), (0.0, 50e-12)])
def test_an_amplifier_has_the_noise_of_its_inputs(tmp_path, volts, amperes):
    """Times its gain of 20, of which each input's divider has 950 Ohm; behind it are 2 Ohm."""
    given = f"noise_voltage = {volts}" if volts else f"noise_current = {amperes}" * bool(amperes)
    parts = AMPLIFIER.format(given=given)
    found = noise(tmp_path, parts, output="load.v", start=10, stop=1e3, points=20)
    power = 400 * (volts**2 + 2 * (950 * amperes) ** 2 + 2 * 4 * KT * 950) + 4 * KT * 2
    # a gain of 1e7 at rest leaves 2e-6, a bandwidth of 2 MHz less
    np.testing.assert_allclose(found.waves["noise"], np.sqrt(power), rtol=1e-5)
    # the powers of one part's sources add up; the load's current flows into the 2 Ohm
    band = 1e3 - 10
    by_part = found.metrics["noise_by_part"]
    assert by_part["amplifier"] == pytest.approx(np.sqrt(power * band), rel=1e-5)
    assert by_part["load"] == pytest.approx(np.sqrt(4 * KT / 1e9 * 2**2 * band), rel=1e-4)


def test_a_sensor_has_the_noise_that_it_states(tmp_path):
    """1 nm rms up to 10 kHz: 10 pm per root Hz."""
    parts = """
[sensor]
part = "sensor"
bandwidth = "10 kHz"
noise = "1 nm"
pins = { of = "push.out" }
[push]
part = "source"
kind = "displacement"
dc = "0 um"
"""
    found = noise(tmp_path, parts, output="sensor.y", start=10, stop=1e4, points=20)
    np.testing.assert_allclose(found.waves["noise"], 1e-11, rtol=1e-6)


@pytest.mark.parametrize(("points", "passed"), [(41, False), (4001, True)])
def test_frequencies_that_miss_a_resonance_are_noticed(points, passed):
    """An undamped circuit of the user's own, whose resonance no equations tell."""
    f = np.linspace(100.0, 300.0, points)
    density = 1 / np.abs(1 - (f / 201.3) ** 2 + 1j * f / 201.3 / 500)
    (check,) = noise_analysis.check_noise(Waveforms({"frequency": f, NOISE_WAVE: density}, {}))
    assert check.passed is passed
