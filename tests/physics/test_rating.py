"""Ratings in heads, and the warning of a run that goes beyond them."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import (
    BuiltScene,
    Certificate,
    LinearModel,
    Port,
    Waveforms,
    add_results_and_sources,
    load_scene,
)

ROOT = Path(__file__).parents[2]
ONE = np.eye(1)
MODEL = LinearModel(K=ONE, E=0.1 * ONE, M=ONE, B=ONE, ports=(Port("anode", "electrical"),))


def part_of(name, part, **overrides):
    scene = load_scene(name, {f"{part}.{k}": v for k, v in overrides.items()})
    return scene.parts[part], scene


def test_ratings_follow_layers_and_materials():
    chip, _ = part_of("impact", "kick")
    assert chip.type.rated_voltage(chip) == pytest.approx(2e6 * 2e-3 / 33)
    chip, _ = part_of("impact", "kick", rated_field=1e6)
    assert chip.type.rated_voltage(chip) == pytest.approx(1e6 * 2e-3 / 33)
    disc, _ = part_of("buzzer_7bb_20_6", "disc")
    (ceramic,) = (x for x in disc.keys.layers if x.electrodes is not None)
    volts = 0.7e6 * ceramic.thickness  # PZT-5A, TP-226
    assert disc.type.rated_voltage(disc) == pytest.approx(volts)
    beam, _ = part_of("harvester", "beam")
    assert beam.keys.wiring in (None, "series")
    thick = sum(x.thickness for x in beam.keys.layers if x.material == "PZT-5A")
    assert beam.type.rated_voltage(beam) == pytest.approx(0.7e6 * thick)


@pytest.mark.parametrize(("volts", "passed"), [(121.0, True), (-122.0, False)])
def test_a_run_beyond_the_rating_prints_a_warning(volts, passed):
    chip, scene = part_of("kick_and_catch", "kick")
    data = {"time": np.array([0.0, 1.0]), "kick.voltage": np.array([0.0, volts])}
    waves = Waveforms(data, {})
    build = add_results_and_sources(BuiltScene(scene, {"kick": MODEL}))
    found = [c for c in chip.type.checks(chip, build, waves) if "rating" in getattr(c, "name", "")]
    assert [(c.passed, c.is_fatal, c.unit) for c in found] == [(passed, False, "V")]


@pytest.mark.parametrize("scale", ["frequency", "sweep", "time"])
def test_the_rating_holds_in_every_analysis(scale):
    """20 kV at a chip that stands 121 V: as an amplitude, as a value of a sweep, over time."""
    chip, scene = part_of("kick_and_catch", "kick")
    volts = np.array([1.0, -2e4]) * (1j if scale == "frequency" else 1.0)
    waves = Waveforms({scale: np.array([1.0, 2.0]), "kick.voltage": volts}, {})
    build = add_results_and_sources(BuiltScene(scene, {"kick": MODEL}))
    found = [c for c in chip.type.checks(chip, build, waves) if "rating" in getattr(c, "name", "")]
    assert [(c.passed, c.value) for c in found] == [(False, 2e4)]


def test_the_head_states_the_rating():
    from support import read_lib

    (part,) = read_lib(ROOT / "netlists" / "impact" / "impact_kick.lib")
    assert re.search(r"(?m)^\* rating: 121.2 V between the electrodes", part.text)
    assert re.search(r"(?m)^\* sign: um and N are positive along each port's direction", part.text)


@pytest.mark.parametrize(("top", "passed"), [(5e5, True), (5.1e5, False)])
def test_a_sweep_beyond_the_certified_band_prints_a_warning(top, passed):
    chip, scene = part_of("harmonic", "kick")
    certificate = Certificate((0.0, 5e5), 1e-3, "made up", True, True)
    model = replace(MODEL, certificate=certificate)
    waves = Waveforms({"frequency": np.array([1e3, top])}, {})
    checks = chip.type.checks(
        chip, add_results_and_sources(BuiltScene(scene, {"kick": model})), waves
    )
    found = [c for c in checks if "band" in c.name]
    assert [(c.passed, c.is_fatal, c.unit) for c in found] == [(passed, False, "Hz")]
