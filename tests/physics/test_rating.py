"""Ratings in heads, and the warning of a run that goes beyond them."""

import re
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import kc2spice as kc
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.ring_magnet_coils import rated_heating
from kc2spice.rom.linear import Certificate
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.spice.realize import subcircuit

ROOT = Path(__file__).parents[2]


def part_of(name, part, **overrides):
    scene = load_scene(name, {f"{part}.{k}": v for k, v in overrides.items()})
    return scene.parts[part], scene


def test_ratings_follow_layers_and_materials():
    chip, _ = part_of("impact", "kick")
    assert chip.type.rated(chip) == pytest.approx(2e6 * 2e-3 / 33)
    chip, _ = part_of("impact", "kick", rated_field=1e6)
    assert chip.type.rated(chip) == pytest.approx(1e6 * 2e-3 / 33)
    disc, _ = part_of("buzzer_7bb_20_6", "disc")
    (ceramic,) = (x for x in disc.keys.layers if x.electrodes is not None)
    assert disc.type.rated(disc) == pytest.approx(0.7e6 * ceramic.thickness)  # PZT-5A, TP-226
    beam, _ = part_of("harvester", "beam")
    assert beam.keys.wiring in (None, "series")
    thick = sum(x.thickness for x in beam.keys.layers if x.material == "PZT-5A")
    assert beam.type.rated(beam) == pytest.approx(0.7e6 * thick)


@pytest.mark.parametrize(("volts", "passed"), [(121.0, True), (-122.0, False)])
def test_a_run_beyond_the_rating_is_told(volts, passed):
    chip, scene = part_of("kick_and_catch", "kick")
    data = {"time": np.array([0.0, 1.0]), "kick.voltage": np.array([0.0, volts])}
    waves = Waveforms(data, {})
    build = Build(scene, {"kick": SimpleNamespace(certificate=None, facts={}, ports=())})
    found = [c for c in chip.type.checks(chip, build, waves) if "rating" in c.name]
    assert [(c.passed, c.fatal, c.unit) for c in found] == [(passed, False, "V")]


def test_the_head_states_the_rating():
    from kc2spice.netlist.read import read_lib

    (part,) = read_lib(ROOT / "netlists" / "impact" / "kick.lib")
    assert re.search(r"(?m)^\* rating: 121.2 V between electrodes", part.text)
    assert re.search(r"(?m)^\* sign: um and N count along each port's direction", part.text)


@pytest.mark.parametrize("wiring", ["series", "parallel"])
def test_a_mesh_gives_the_rating_of_its_layers(wiring):
    """Distances between the nodes of electrodes against thicknesses of layers."""
    layer = {"material": "PZT-5H", "thickness": 0.3e-3}
    tables = {"part": "bimorph", "length": 6e-3, "width": 2e-3, "layers": [layer, layer]}
    scene = load_scene(
        {"beam": tables | {"wiring": wiring}, "analysis": {"type": "ac", "start": 1e3, "stop": 1e4}}
    )
    (model,) = kc.build(scene).values()
    volts = 0.4e6 * 0.3e-3 * (2 if wiring == "series" else 1)
    assert model.facts["depoling_voltage_v"] == pytest.approx(volts, rel=1e-9)
    beam = scene.parts["beam"]
    assert beam.type.rated(beam) == pytest.approx(volts)


def langevin():
    return {
        "horn": {
            "part": "langevin",
            "front": [{"material": "aluminium", "diameter": 20e-3, "length": 30e-3}],
            "back": [{"material": "steel", "diameter": 20e-3, "length": 20e-3}],
            "rings": {"material": "PZT-8", "outer": 20e-3, "inner": 8e-3, "thickness": 3e-3},
            "bolt": {"material": "steel", "diameter": 6e-3},
        },
        "analysis": {"type": "ac", "start": 1e3, "stop": 1e5},
    }


def test_coils_are_rated_by_the_heat_in_their_copper():
    """Power in the coil's resistance over the heat capacity of all its turns."""
    catch, _ = part_of("kick_and_catch", "catch", rated_rise=80.0)
    keys = catch.keys
    length = keys.turns * np.pi * (keys.lower.inner + keys.lower.outer) / 2
    section = np.pi * keys.wire_diameter**2 / 4
    resistance = 1.7e-8 * length / section
    capacity = 8960 * 385 * length * section  # J/K, of copper
    limit = rated_heating(keys)
    assert limit * resistance / capacity == pytest.approx(80.0, rel=1e-3)


def test_a_foreign_model_says_that_nothing_is_known():
    ports = (
        kc.Port("anode", "electrical", pins=("anode", "cathode")),
        kc.Port("tip", "mechanical"),
    )
    one = np.diag([1.0, 4.0])
    gain = np.array([[1e-3, 1.0], [2e-3, 1.0]])
    model = kc.LinearModel(
        M=one, E=0.01 * one, K=1e6 * one, B=gain, D=np.diag([1e-9, 0.0]), ports=ports
    )
    head = subcircuit(model, "mine").text.partition(".subckt")[0]
    assert re.search(r"(?m)^\* rating: not known; keep field and stress", head)
    assert re.search(r"(?m)^\* validity: small signals at the temperature of its data", head)
    assert re.search(r"(?m)^\* sign: um and N count along each port's direction", head)


@pytest.mark.parametrize(("top", "passed"), [(5e5, True), (5.1e5, False)])
def test_a_sweep_beyond_the_certified_band_is_told(top, passed):
    chip, scene = part_of("harmonic", "kick")
    certificate = Certificate((0.0, 5e5), 1e-3, "made up", True, True)
    model = SimpleNamespace(certificate=certificate, facts={}, ports=())
    waves = Waveforms({"frequency": np.array([1e3, top])}, {})
    checks = chip.type.checks(chip, Build(scene, {"kick": model}), waves)
    found = [c for c in checks if "band" in c.name]
    assert [(c.passed, c.fatal, c.unit) for c in found] == [(passed, False, "Hz")]
