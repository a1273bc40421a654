"""Scenes of plain parts through ``run``'s own path, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from device import models
from support import (
    SimulationError,
    UsageError,
    compute_mean_frequency,
    compute_metrics,
    load_scene,
    make_deck,
    require_valid_wiring,
    simulate_deck,
)

import kc2spice as kc

R, L, C = 50.0, 1e-3, 1e-6
OMEGA, ZETA = 1 / np.sqrt(L * C), R / 2 * np.sqrt(C / L)


def run(tables, directory):
    """Waveforms and metrics of a scene; no check may fail."""
    scene = load_scene(tables)
    build = models(scene)
    deck = make_deck(build)
    require_valid_wiring(deck)
    waves = simulate_deck(build, deck, directory).waves
    return waves, compute_metrics(waves, build).values


def rlc(source, analysis, **more):
    """Source, resistor, inductor and capacitor in series."""
    return {
        "supply": {"part": "source", **source, "pins": {"out": "ohm.a"}},
        "ohm": {"part": "resistor", "resistance": R, "pins": {"b": "coil.a"}},
        "coil": {"part": "inductor", "inductance": L, "pins": {"b": "cap.a"}},
        "cap": {"part": "capacitor", "capacitance": C},
        "analysis": analysis,
        **more,
    }


# -------------------------------------------------------------------------------- analyses


def test_dc_sweeps_a_source(tmp_path):
    analysis = {"type": "dc", "sweep": "supply.dc", "from": "-5 V", "to": "5 V", "points": 11}
    tables = rlc({"dc": 1.0}, analysis) | {
        "leak": {"part": "resistor", "resistance": 3 * R, "pins": {"a": "cap.a"}}
    }
    waves, _ = run(tables, tmp_path)
    volts = np.linspace(-5, 5, 11)
    np.testing.assert_allclose(waves["supply.v"], volts, atol=1e-12)
    np.testing.assert_allclose(waves["cap.v"], 0.75 * volts, atol=1e-9)
    np.testing.assert_allclose(waves["leak.i"], volts / (4 * R), atol=1e-12)


# ----------------------------------------------------------------------------------- sources


def trapezoid(t, start, width, edge, low, high):
    """By its definition: ``width`` at half height."""
    up = np.clip((t - start) / edge, 0, 1)
    down = np.clip((t - start - width) / edge, 0, 1)
    return low + (high - low) * (up - down)


SHAPES = {
    "constant": ({"dc": "3 V"}, lambda t: 3.0 + 0 * t),
    "a pulse": (
        {"pulse": {"high": 5.0, "low": -1.0, "width": 20e-6, "edge": 2e-6, "start": 10e-6}},
        lambda t: trapezoid(t, 10e-6, 20e-6, 2e-6, -1.0, 5.0),
    ),
    "three pulses": (
        {"pulse": {"high": 1.0, "width": 5e-6, "edge": 1e-6, "start": 3e-6, "period": 15e-6,
                   "count": 3}},
        lambda t: sum(trapezoid(t, 3e-6 + k * 15e-6, 5e-6, 1e-6, 0.0, 1.0) for k in range(3)),
    ),
    "pulses without end": (
        {"pulse": {"high": 1.0, "width": 5e-6, "edge": 1e-6, "start": 3e-6, "period": 15e-6}},
        lambda t: sum(trapezoid(t, 3e-6 + k * 15e-6, 5e-6, 1e-6, 0.0, 1.0) for k in range(8)),
    ),
    "triangles that touch": (
        {"pulse": {"high": 1.0, "width": 5e-6, "edge": 5e-6, "period": 10e-6, "count": 4}},
        lambda t: sum(trapezoid(t, k * 10e-6, 5e-6, 5e-6, 0.0, 1.0) for k in range(4)),
    ),
    "a sine": (
        {"sine": {"amplitude": 2.0, "frequency": "50 kHz", "start": 13e-6}},
        lambda t: np.where(t < 13e-6, 0.0, 2 * np.sin(2 * np.pi * 50e3 * (t - 13e-6))),
    ),
    "corners": (
        {"pwl": [["0 us", 0.0], ["10 us", "2 V"], [40e-6, -1.0], [70e-6, -1.0]]},
        lambda t: np.interp(t, [0, 10e-6, 40e-6, 70e-6], [0, 2, -1, -1]),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SHAPES)
def test_a_source_follows_its_keys(name, tmp_path):
    keys, law = SHAPES[name]
    tables = rlc(keys, {"stop": 100e-6}, solver={"max_step": 0.5e-6})
    waves, _ = run(tables, tmp_path)
    t = waves["time"]
    np.testing.assert_allclose(waves["supply.v"], law(t), atol=1e-6)


def test_a_source_follows_a_file(tmp_path):
    (tmp_path / "drive.csv").write_text("time,volt\n0,0\n1e-5,2.5\n3e-5,-1\n")
    (tmp_path / "a.toml").write_text(
        "solver = { max_step = 1e-6 }\nanalysis = { stop = 5e-5 }\n"
        '[supply]\npart = "source"\nfile = "drive.csv"\npins = { out = "ohm.a" }\n'
        '[ohm]\npart = "resistor"\nresistance = 1.0\n'
    )
    build = models(tmp_path / "a.toml")
    waves = simulate_deck(build, make_deck(build), tmp_path / "out").waves
    exact = np.interp(waves["time"], [0, 1e-5, 3e-5], [0, 2.5, -1])
    np.testing.assert_allclose(waves["supply.v"], exact, atol=1e-6)


LOADS = {
    "voltage": 'part = "resistor"\nresistance = 1.0',
    "current": 'part = "resistor"\nresistance = 1.0',
    "force": 'part = "spring"\nstiffness = 1e3',
    "displacement": 'part = "spring"\nstiffness = 1e3',
}


@pytest.mark.parametrize("kind", LOADS)
def test_a_source_that_is_not_as_defined_fails_the_run(kind, tmp_path):
    """Of each kind, between two pins of which none is ground."""
    (tmp_path / "a.toml").write_text(
        f'[drive]\npart = "source"\nkind = "{kind}"\npins = {{ out = "load.a", ret = "load.b" }}\n'
        "pulse = { high = 1e-3, width = 1e-6, edge = 1e-6, start = 2e-6 }\n"
        f'[load]\n{LOADS[kind]}\n[tie]\n{LOADS[kind]}\npins = {{ a = "load.b" }}\n'
        "[analysis]\nstop = 1e-5\n"
    )
    build = models(tmp_path / "a.toml")
    deck = make_deck(build)
    checks = simulate_deck(build, deck, tmp_path).verdict.checks
    assert any("drives as defined" in c.name for c in checks)
    wrong = tuple(
        replace(item, values=tuple(word.replace("3e-06", "3.01e-06") for word in item.values))
        for item in deck.items
    )
    with pytest.raises(SimulationError, match="waveform error of drive"):
        simulate_deck(build, replace(deck, items=wrong), tmp_path)


# ------------------------------------------------------------------------------------ probes


def test_every_take_of_a_probe(tmp_path):
    takes = ("max", "min", "final", "rms", "peak_to_peak")
    probes = {take: {"of": "supply.v", "take": take} for take in takes}
    probes |= {"rise": {"of": "cap.v", "take": "crossing", "level": 0.3}}
    probes |= {"never": {"of": "cap.v", "take": "crossing", "level": 100.0}}
    wave = {"sine": {"amplitude": 2.0, "frequency": 10e3}}
    tables = rlc(wave, {"stop": 1e-4}, probes=probes, solver={"max_step": 2e-7})
    waves, found = run(tables, tmp_path)
    assert found["max"] == pytest.approx(2.0, rel=1e-4)
    assert found["min"] == pytest.approx(-2.0, rel=1e-4)
    assert found["final"] == pytest.approx(0.0, abs=1e-6)
    assert found["rms"] == pytest.approx(2 / np.sqrt(2), rel=1e-4)
    assert found["peak_to_peak"] == pytest.approx(4.0, rel=1e-4)
    k = int(np.argmax(waves["cap.v"] >= 0.3))
    assert waves["time"][k - 1] <= found["rise"] <= waves["time"][k]
    assert found["never"] is None


@pytest.mark.parametrize("ends", [(1.0, 5.0), (5.0, 1.0)])
def test_probes_do_not_depend_on_the_direction_of_a_sweep(ends, tmp_path):
    """Of v / 10 from 1 V to 5 V: mean 0.3 A, mean square (0.5^3 - 0.1^3) / (3 0.4) A^2."""
    probes = {take: {"of": "ohm.i", "take": take} for take in ("mean", "rms", "max", "min")}
    probes |= {"at_2v": {"of": "ohm.i", "at": 2.0}}
    probes |= {"cross": {"of": "ohm.i", "take": "crossing", "level": 0.33}}
    tables = {
        "supply": {"part": "source", "dc": 0.0, "pins": {"out": "ohm.a"}},
        "ohm": {"part": "resistor", "resistance": 10.0},
        "analysis": {"type": "dc", "sweep": "supply.dc", "from": ends[0], "to": ends[1],
                     "points": 201},
        "probes": probes,
    }  # fmt: skip
    _, found = run(tables, tmp_path)
    exact = {"mean": 0.3, "rms": np.sqrt(0.124 / 1.2), "max": 0.5, "min": 0.1, "at_2v": 0.2,
             "cross": 3.3}  # fmt: skip
    assert {name: found[name] for name in exact} == pytest.approx(exact, rel=1e-4)


@pytest.mark.parametrize("ends", [(1.0, 5.0), (5.0, 1.0)])
def test_a_sweep_that_returns_begins_at_its_first_value(ends, tmp_path):
    tables = {
        "supply": {"part": "source", "dc": 0.0, "pins": {"out": "ohm.a"}},
        "ohm": {"part": "resistor", "resistance": 10.0},
        "analysis": {"type": "dc", "sweep": "supply.dc", "from": ends[0], "to": ends[1],
                     "points": 5, "back": True},
    }  # fmt: skip
    waves, _ = run(tables, tmp_path)
    there = np.linspace(*ends, 5)
    back = there[-2::-1]
    np.testing.assert_allclose(waves["supply.v"], np.concatenate([there, back]), rtol=1e-9)
    np.testing.assert_allclose(waves["ohm.i"], np.concatenate([there, back]) / 10, rtol=1e-9)
    assert waves.scale[0] == pytest.approx(ends[0], rel=1e-12)


def test_cycles_over_a_falling_scale_have_the_same_rate():
    """Of ten cycles in 2 V."""
    x = np.linspace(0.0, 2.0, 4001)
    y = np.sin(10 * np.pi * x) * (1 + x)
    assert compute_mean_frequency(x, y) == pytest.approx(5.0, rel=1e-3)
    assert compute_mean_frequency(x[::-1], y) == pytest.approx(5.0, rel=1e-3)


def test_place_of_a_peak_and_value_at_a_frequency():
    """Of 1 / (1 - r^2 + 2j zeta r) in closed form."""
    probes = {"peak_at": {"of": "cap.v", "take": "argmax"}, "there": {"of": "cap.v", "at": "3 kHz"},
              "half": {"of": "cap.i", "at": 3e3}}  # fmt: skip
    tables = rlc({"ac": 1.0}, {"type": "ac", "start": 1e3, "stop": 2e4, "points": 2_000},
                 probes=probes)  # fmt: skip
    tables["ohm"]["resistance"], zeta = R / 10, ZETA / 10
    result = kc.run(tables)
    natural = OMEGA / (2 * np.pi)
    found = result.metrics
    assert found["peak_at"] == pytest.approx(natural * np.sqrt(1 - 2 * zeta**2), rel=2e-3)
    r = 3e3 / natural
    exact = abs(1 / (1 - r**2 + 2j * zeta * r))
    assert found["there"] == pytest.approx(exact, rel=1e-5)
    assert found["half"] == pytest.approx(exact * 2 * np.pi * 3e3 * C, rel=1e-5)
    assert result.record["metric_units"] == {"peak_at": "Hz", "there": "V", "half": "A"}


def test_a_probe_of_an_unknown_result_lists_existing_results(tmp_path):
    probes = {"top": {"of": "cap.volt", "take": "max"}}
    with pytest.raises(UsageError, match=r"(?s)probes\.top\.of.*cap\.v"):
        run(rlc({"dc": 1.0}, {"stop": 1e-4}, probes=probes), tmp_path)
