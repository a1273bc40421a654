"""Maxima over frequency do not depend on where the scene's own frequencies lie."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

import kc2spice as kc

OSCILLATOR = """
[push]
part = "source"
kind = "force"
ac = "1 mN"
pins = {{ out = "mass.a" }}
[mass]
part = "mass"
mass = "1 g"
pins = {{ a = "spring.a" }}
[spring]
part = "spring"
stiffness = "1 kN/m"
[damper]
part = "damper"
damping = "{damping} N s/m"
pins = {{ a = "spring.a" }}
[analysis]
type = "ac"
start = "50 Hz"
stop = "500 Hz"
points = {points}
[probes]
largest = {{ of = "mass.x", take = "max" }}
place = {{ of = "mass.x", take = "argmax" }}
"""


@pytest.mark.parametrize("quality", [5, 50, 2000, 20_000, 1e6])
@pytest.mark.parametrize("points", [7, 40])
def test_a_resonance_between_the_points_has_its_closed_form(quality, points, scene_file):
    """``|x| = F / (c sqrt(k/m - c^2 / 4 m^2))`` at ``w^2 = k/m - c^2 / 2 m^2`` is the largest."""
    F, m, k = 1e-3, 1e-3, 1e3
    c = np.sqrt(k * m) / quality
    found = kc.run(scene_file(OSCILLATOR.format(damping=c, points=points)))
    f = np.sqrt(k / m - c**2 / (2 * m**2)) / (2 * np.pi)
    assert found.metrics["place"] == pytest.approx(f, rel=2e-3 / quality + 1e-9)
    # the parabola leaves out the pole at negative frequency, a share 1/Q of the response
    expected = F / (c * np.sqrt(k / m - c**2 / (4 * m**2)))
    assert found.metrics["largest"] == pytest.approx(expected, rel=1e-3 / quality + 1e-5)
    frequency = found.frequency
    assert frequency.size >= points
    assert (np.diff(frequency) > 0).all()


@pytest.mark.parametrize("quality", [20, 2000, 1e5])
@pytest.mark.parametrize("points", [7, 40])
def test_the_least_response_is_that_of_the_absorber(quality, points):
    """A force drives a mass ``m`` on ``k``, which carries an absorber ``n`` on ``s`` and ``d``: the
    response is least near ``w^2 = s / n``, by both equations of motion."""
    F, m, k, n, s = 1e-3, 1e-3, 1e3, 0.2e-3, 150.0
    d, c = np.sqrt(s * n) / quality, 0.02
    free = {"part": "mass", "mass": n, "pins": {"a": "soft.b"}}
    result = kc.run({
        "gravity": 0.0,
        "push": {"part": "source", "kind": "force", "ac": F, "pins": {"out": "heavy.a"}},
        "heavy": {"part": "mass", "mass": m},
        "stiff": {"part": "spring", "stiffness": k, "pins": {"a": "heavy.a"}},
        "loss": {"part": "damper", "damping": c, "pins": {"a": "heavy.a"}},
        "soft": {"part": "spring", "stiffness": s, "pins": {"a": "heavy.a"}},
        "rub": {"part": "damper", "damping": d, "pins": {"a": "heavy.a", "b": "soft.b"}},
        "light": free,
        "analysis": {"type": "ac", "start": 50.0, "stop": 200.0, "points": points},
        "probes": {"least": {"of": "heavy.x", "take": "min"}},
    })  # fmt: skip

    def size(w):
        z = s + 1j * w * d
        A = [[k + z - m * w**2 + 1j * w * c, -z], [-z, z - n * w**2]]
        return abs(np.linalg.solve(A, [F, 0])[0])

    at = np.sqrt(s / n)
    near = minimize_scalar(size, bounds=(0.99 * at, 1.01 * at), options={"xatol": 1e-9 * at})
    assert result.metrics["least"] == pytest.approx(near.fun, rel=2e-3)


def test_resonances_are_those_of_body_and_driver_together(tmp_path):
    """A coil in series with a capacitive body has a resonance that neither has alone."""
    M, K, C0, R, L = np.diag([1e-6, 1e-6]), np.diag([4e3, 9e4]), 2e-9, 1.0, 0.05
    E, b = 1e-4 * np.sqrt(M @ K), np.array([[1e-3], [2e-3]])
    np.savez(tmp_path / "body.npz", M=M, E=E, K=K, B=b, C=b.T, D=[[C0]])
    (tmp_path / "body.toml").write_text(
        '[[ports]]\nname = "anode"\nkind = "electrical"\ncolumn = 1\n'
    )
    scene = tmp_path / "driven.toml"
    scene.write_text(
        f"""
[drive]
part = "source"
ac = 1.0
pins = {{ out = "r.a" }}
[r]
part = "resistor"
resistance = {R}
pins = {{ b = "coil.a" }}
[coil]
part = "inductor"
inductance = {L}
pins = {{ b = "body.anode" }}
[body]
part = "matrices"
file = "body.npz"
[analysis]
type = "ac"
start = 3e3
stop = 6e4
points = 25
[probes]
volts = {{ of = "body.voltage", take = "max" }}
place = {{ of = "body.voltage", take = "argmax" }}
"""
    )

    def volts(f):
        s = 2j * np.pi * f
        Y = s * (C0 + (b.T @ np.linalg.solve(s**2 * M + s * E + K, b))[0, 0])
        return abs(1 / (1 + Y * (R + s * L)))

    grid = np.linspace(3e3, 6e4, 200_001)
    near = grid[np.argmax([volts(f) for f in grid[::10]]) * 10]
    best = minimize_scalar(
        lambda f: -volts(f), bounds=(near - 10, near + 10), method="bounded",
        options={"xatol": 1e-6},
    )  # fmt: skip
    metrics = kc.run(scene).metrics
    assert metrics["volts"] == pytest.approx(-best.fun, rel=1e-4)
    assert metrics["place"] == pytest.approx(best.x, rel=1e-6)


def test_a_part_without_equations_is_named(tmp_path):
    """The resonance of the body alone is resolved; a netlist around it may move that."""
    M, K, E, b = [[1e-6]], [[4e3]], [[1e-6 * np.sqrt(4e9) / 5000]], [[1e-3]]
    np.savez(tmp_path / "body.npz", M=M, E=E, K=K, B=b, C=b, D=[[2e-9]])
    (tmp_path / "body.toml").write_text(
        '[[ports]]\nname = "anode"\nkind = "electrical"\ncolumn = 1\n'
    )
    (tmp_path / "own.lib").write_text(".subckt own a b\nR1 a b 1m\n.ends\n")
    (tmp_path / "s.toml").write_text(
        '[body]\npart = "matrices"\nfile = "body.npz"\npins = { anode = "own.b" }\n'
        '[own]\npart = "netlist"\nfile = "own.lib"\nsubckt = "own"\npins = { a = "drive.out" }\n'
        '[drive]\npart = "source"\nac = 1.0\n'
        '[analysis]\ntype = "ac"\nstart = 5e3\nstop = 2e4\npoints = 10\n'
        '[probes]\ni = { of = "body.current", take = "max" }\n'
        'least = { of = "body.current", take = "min" }\n'
    )
    with (
        pytest.warns(UserWarning, match="no equations for the part own"),
        pytest.warns(UserWarning, match=r"minimum of body.current is searched for only at"),
    ):
        found = kc.run(tmp_path / "s.toml")
    s = 2j * np.pi * found.frequency
    Y = s * (2e-9 + 1e-6 / (s**2 * 1e-6 + s * E[0][0] + 4e3))
    assert found.metrics["i"] == pytest.approx(np.abs(Y / (1 + 1e-3 * Y)).max(), rel=1e-3)
    # b^2 / E at resonance, short of the resistance in series
    assert found.metrics["i"] == pytest.approx(1e-6 / E[0][0], rel=1e-3)


def test_noise_has_the_power_of_a_resonance_between_the_points(scene_file):
    """Equipartition: ``k <x^2> = k_B T`` whatever the damping."""
    text = OSCILLATOR.format(damping=1e-4, points=60)
    text = text[text.index("[mass]") : text.index("[analysis]")]
    text += '[analysis]\ntype = "noise"\noutput = "mass.x"\nstart = 0.1\nstop = 1e5\npoints = 60\n'
    rms = kc.run(scene_file(text)).metrics["noise"]
    assert rms == pytest.approx(np.sqrt(1.380649e-23 * 300.15 / 1e3), rel=0.02)


SOFTENING = """
[push]
part = "source"
kind = "force"
dc = 3.57e-9
ac = 5.26e-9
pins = { out = "mass.a" }
[mass]
part = "mass"
mass = 2.106e-10
pins = { a = "spring.a" }
[spring]
part = "cubic_spring"
stiffness = 4.863e-3
cubic = -4.722e8
[damper]
part = "damper"
damping = 2.106e-9
pins = { a = "spring.a" }
[analysis]
type = "ac"
start = 70
stop = 3.6e3
points = 20
[probes]
largest = { of = "mass.x", take = "max" }
there = { of = "mass.x", at = "2 kHz" }
"""


@pytest.mark.parametrize("edited", [False, True])
def test_all_frequencies_are_about_one_operating_point(edited, scene_file, tmp_path):
    """``x = F / (k + 3 c x0^2 + i w d - w^2 m)``, ``x0`` the smallest of three roots of
    ``k x + c x^3 = F0``: the response that one analysis leaves leads the next to another root."""
    F0, F, m, k, c, d = 3.57e-9, 5.26e-9, 2.106e-10, 4.863e-3, -4.722e8, 2.106e-9
    path = scene_file(SOFTENING)
    result = kc.run(path)
    if edited:
        for name, text in result.deck.files.items():
            (tmp_path / name).write_text(text)
        main = tmp_path / result.deck.main_file_name
        main.write_text(main.read_text().replace(".end\n", "* edited\n.end\n"))
        result = kc.run(path, deck=main)
    roots = np.roots([c, 0.0, k, -F0])
    x0 = roots[np.abs(roots).argmin()].real
    s = 2j * np.pi * result.frequency
    exact = F / (k + 3 * c * x0**2 + d * s + m * s**2)
    np.testing.assert_allclose(result.waves["mass.x"], exact, rtol=1e-3)
    stiff = k + 3 * c * x0**2
    largest = F / (d * np.sqrt(stiff / m - d**2 / (4 * m**2)))
    assert result.metrics["largest"] == pytest.approx(largest, rel=1e-3)
    s = 2j * np.pi * 2e3
    assert result.metrics["there"] == pytest.approx(abs(F / (stiff + d * s + m * s**2)), rel=1e-5)


LOADED_BUZZER = """
[disc]
part = "disc"
layers = [
  {{ material = "brass", diameter = "20 mm", thickness = "0.2 mm" }},
  {{ material = "PZT-5A", diameter = "14 mm", thickness = "0.22 mm", electrodes = "12.8 mm" }},
]
damping = {{ quality = 300 }}
pins = {{ anode = "drive.out", front_face = "air.face" }}
[air]
part = "radiation"
radius = "10 mm"
[drive]
part = "source"
ac = "1 V"
[analysis]
type = "ac"
start = "6 kHz"
stop = "6.6 kHz"
points = {points}
[probes]
largest = {{ of = "air.flow", take = "max" }}
"""


@pytest.mark.filterwarnings("error", "ignore:.*does not move like a piston")
def test_a_face_that_drives_masses_of_fluid_has_its_resonance(scene_file):
    """The fluid moves with the face, so its masses have no motion of their own.

    The oracle is a response at so many points that its maximum needs no search.
    """
    few, many = (kc.run(scene_file(LOADED_BUZZER.format(points=n))) for n in (9, 3001))
    assert few.metrics["largest"] == pytest.approx(many.metrics["largest"], rel=2e-3)
