"""Probes of flows and powers in heat, mechanics and sound against closed forms."""

import numpy as np
import pytest
import scipy
from support import differentiate

import kc2spice as kc

STIFFNESS, DAMPING, FORCE = 100.0, 0.5, 0.01  # N/m, N s/m, N


def final(of, take="final"):
    return {"of": of, "take": take}


def test_the_power_at_a_pin_of_heat_is_the_heat_flow():
    drive = {"part": "source", "kind": "heat_flow", "dc": "2 W"}
    scene = {
        "drive": drive,
        "path": {"part": "thermal_resistor", "resistance": 20.0, "pins": {"a": "drive.out"}},
        "analysis": {"type": "op"},
        "probes": {"power_w": final("path.power"), "flow_w": final("path.heat_flow")},
    }
    result = kc.run(scene)
    assert result.metrics["power_w"] == pytest.approx(2.0, rel=1e-9)
    assert result.metrics["flow_w"] == pytest.approx(2.0, rel=1e-9)
    assert result.record["metric_units"]["power_w"] == "W"


DASHPOT = {
    "drive": {"part": "source", "kind": "force"},
    "spring": {"part": "spring", "stiffness": STIFFNESS, "pins": {"a": "drive.out"}},
    "damper": {"part": "damper", "damping": DAMPING, "pins": {"a": "drive.out"}},
}


def dashpot(probes, analysis, **drive):
    """A spring beside a damper under a force."""
    return {**DASHPOT, "drive": {**DASHPOT["drive"], **drive}, "analysis": analysis,
            "probes": {name: final(of) for name, of in probes.items()}}  # fmt: skip


def test_mean_power_of_a_damper_at_a_frequency():
    f = np.array([1.0, 40.0])
    probes = {"lost_w": "damper.power", "stored_w": "spring.power"}
    analysis = {"type": "ac", "start": 1.0, "stop": 40.0, "points": 2, "scale": "linear"}
    result = kc.run(dashpot(probes, analysis, ac=FORCE))
    s = 2j * np.pi * result.waves["frequency"].real
    assert np.isin(f, result.waves["frequency"].real).all()
    velocity = s * FORCE / (STIFFNESS + s * DAMPING)
    np.testing.assert_allclose(result.waves["damper.power"], DAMPING * abs(velocity) ** 2 / 2)
    assert np.abs(result.waves["spring.power"]).max() < 1e-12 * result.waves["damper.power"].max()


def test_power_of_a_spring_and_a_damper_over_time():
    probes = {"lost_w": "damper.power", "stored_w": "spring.power", "given_w": "drive.power"}
    pulse = {"high": FORCE, "width": 1.0, "edge": 1e-5, "start": 1e-4}
    result = kc.run(dashpot(probes, {"type": "transient", "stop": 0.02}, pulse=pulse))
    t, tau = result.time - 1.05e-4, DAMPING / STIFFNESS
    late = t > 1e-3
    x = FORCE / STIFFNESS * -np.expm1(-t / tau)
    v = FORCE / DAMPING * np.exp(-t / tau)
    scale = FORCE**2 / DAMPING
    exact = {"damper": DAMPING * v**2, "spring": STIFFNESS * x * v, "drive": FORCE * v}
    for name, power in exact.items():
        off = np.abs(result.waves[f"{name}.power"] - power)[late]
        assert off.max() < 2e-3 * scale, name


def test_power_and_flow_of_sound_count_in_si():
    scene = {
        "drive": {"part": "source", "kind": "pressure", "ac": "3 Pa"},
        "load": {"part": "acoustic_resistor", "resistance": 2e6, "pins": {"a": "drive.out"}},
        "analysis": {"type": "ac", "start": 100.0, "stop": 200.0, "points": 3, "scale": "linear"},
        "probes": {"power_w": final("load.power"), "flow": final("load.volume_velocity")},
    }
    metrics = kc.run(scene).metrics
    assert metrics["power_w"] == pytest.approx(3.0**2 / 2e6 / 2, rel=1e-9)
    assert metrics["flow"] == pytest.approx(3.0 / 2e6, rel=1e-9)


def test_pins_of_a_model_have_meters_in_every_domain(tmp_path):
    """A piston on a spring: force and power at its rod, volume velocity and power at its face."""
    mass, area = 2e-4, 1e-4
    one = np.eye(1)
    matrices = {"M": mass * one, "E": DAMPING * one, "K": STIFFNESS * one, "B": [[1.0, -area]]}
    for letter, matrix in matrices.items():
        scipy.io.mmwrite(tmp_path / f"piston.{letter}.mtx", np.asarray(matrix))
    rows = {"rod": "mechanical", "face": "acoustic"}
    (tmp_path / "piston.toml").write_text("band = [0, 1e3]\n" + "\n".join(
        f'[[ports]]\nname = "{name}"\nkind = "{kind}"\ncolumn = {k}'
        for k, (name, kind) in enumerate(rows.items(), 1)
    ))  # fmt: skip
    probes = ["piston.rod.force", "piston.rod.power", "piston.face.volume_velocity",
              "piston.face.power", "piston.power", "load.power"]  # fmt: skip
    text = f"""
name = "pumped"
gravity = 0.0
[piston]
part = "matrices"
file = "piston"
pins = {{ rod = "drive.out", face = "load.a" }}
[load]
part = "acoustic_resistor"
resistance = 2e7
[drive]
part = "source"
kind = "force"
ac = {FORCE}
[analysis]
type = "ac"
start = 50
stop = 200
points = 4
scale = "linear"
[probes]
"""
    text += "\n".join(f'p{k} = {{ of = "{of}", take = "final" }}' for k, of in enumerate(probes))
    (tmp_path / "pumped.toml").write_text(text)
    waves = kc.run(kc.load_scene(tmp_path / "pumped.toml")).waves
    s = 2j * np.pi * waves["frequency"].real
    v = s * FORCE / (mass * s**2 + (DAMPING + area**2 * 2e7) * s + STIFFNESS)
    np.testing.assert_allclose(waves["piston.rod.force"], FORCE + 0 * v, rtol=1e-6)
    np.testing.assert_allclose(waves["piston.face.volume_velocity"], -area * v, rtol=1e-6)
    sound = area**2 * 2e7 * abs(v) ** 2 / 2
    np.testing.assert_allclose(waves["load.power"], sound, rtol=1e-6)
    np.testing.assert_allclose(waves["piston.face.power"], -sound, rtol=1e-6)
    work = DAMPING * abs(v) ** 2 / 2 + sound
    np.testing.assert_allclose(waves["piston.rod.power"], work, rtol=1e-6)
    np.testing.assert_allclose(waves["piston.power"], work, rtol=1e-6)  # of its first domain


def test_an_unknown_flow_lists_those_of_the_domain():
    probes = {"p": final("spring.current")}
    with pytest.raises(kc.errors.UsageError) as caught:
        kc.run({**DASHPOT, "analysis": {"type": "op"}, "probes": probes})
    assert "spring.power" in str(caught.value)
    assert "spring.force" in str(caught.value)


def test_a_power_at_a_pin_is_no_result_of_a_noise_analysis(tmp_path, monkeypatch):
    """A probe of it lists what the analysis has."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "half.lib").write_text(".subckt half a b\nR1 a b 1k\n.ends\n")
    half = {"part": "netlist", "file": "half.lib", "subckt": "half"}
    scene = {
        "drive": {"part": "source", "dc": 1.0},
        "half": {**half, "pins": {"a": "drive.out", "b": "gnd"}},
        "load": {"part": "resistor", "resistance": 1e3, "pins": {"a": "drive.out"}},
        "analysis": {"type": "noise", "output": "load.v", "start": 1, "stop": 1e3, "points": 10},
        "probes": {"p": {"of": "half.a.power"}},
    }
    with pytest.raises(kc.errors.UsageError, match=r"noise\.half\.r1"):
        kc.run(scene)


def test_slopes_are_those_of_parabolas_and_skip_equal_points():
    t = np.array([0.0, 0.1, 0.4, 0.4, 0.9, 1.0])
    np.testing.assert_allclose(differentiate(3 * t**2 - t, t), 6 * t - 1, rtol=1e-12)


def test_a_force_that_a_part_reports_needs_no_meter():
    """The force of a contact is its result, not that at its first pin."""
    scene = kc.load_scene("newtons_cradle")
    assert any(probe.of == "contact12.force" for probe in scene.probes.values())
    assert not scene.meters
