"""Truth checks pass on a good run and see runs that are wrong in silence."""

import dataclasses

import numpy as np
import pytest

from kc2spice.errors import SimulationError
from kc2spice.parts.bench import loop_deck
from kc2spice.scene.schema import Kick, Solver
from kc2spice.sim.ngspice import run_deck
from kc2spice.sim.truth import require_truth, truth_checks


@pytest.fixture(scope="module")
def waves(scene, header, model, radii, table, tmp_path_factory):
    deck = loop_deck(scene, header, model, radii, table)
    return run_deck(deck, tmp_path_factory.mktemp("truth"))


def test_good_run_passes(waves, scene, table):
    checks = require_truth(waves, scene, table)
    assert {c.name for c in checks} == {"table_left", "outer_ring", "work"}
    assert next(c for c in checks if c.name == "work").value < 2e-4


def test_energy_from_nowhere_is_seen(waves, scene, table):
    faster = dict(waves.data)
    faster["sphere.v"] = waves["sphere.v"] + np.linspace(0, 0.05, waves["time"].size)
    with pytest.raises(SimulationError, match="work"):
        require_truth(dataclasses.replace(waves, data=faster), scene, table)


def test_contact_beyond_the_last_ring_is_seen(waves, scene, table):
    wide = waves.data | {"contact.force.R5": np.full_like(waves["time"], 0.1)}
    with pytest.raises(SimulationError, match="outer_ring"):
        require_truth(dataclasses.replace(waves, data=wide), scene, table)


def test_sphere_beyond_the_table_is_seen(scene, header, model, radii, table, tmp_path):
    kick = Kick.model_validate({"drive": {"voltage": 100.0}})  # too much for the made-up device
    hard = scene.model_copy(update={"kick": kick, "control": None, "solver": Solver(stop=6e-3)})
    waves = run_deck(loop_deck(hard, header, model, radii, table), tmp_path)
    failed = [c.name for c in truth_checks(waves, hard, table) if not c.passed]
    assert failed == ["table_left"]


def test_steps_too_coarse_for_the_contact_are_seen(scene, header, model, radii, table, tmp_path):
    """Tolerances at which ngspice ends without a word, with a wrong launch."""
    coarse = scene.model_copy(update={"solver": Solver(reltol=0.1, max_step=1e-4)})
    deck = loop_deck(coarse, header, model, radii, table)
    main = deck.files[deck.main].replace("trtol=1\n", "trtol=7\n")
    sloppy = dataclasses.replace(deck, files=deck.files | {deck.main: main})
    with pytest.raises(SimulationError, match="work"):
        require_truth(run_deck(sloppy, tmp_path), coarse, table)
