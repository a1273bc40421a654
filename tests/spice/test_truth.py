"""Truth checks pass on a good run and see runs that are wrong in silence."""

import dataclasses

import numpy as np
import pytest

from kc2spice.errors import SimulationError
from kc2spice.parts.bench import loop_deck
from kc2spice.scene.schema import Kick, Solver
from kc2spice.sim.ngspice import run_deck
from kc2spice.sim.truth import require, truth_checks


@pytest.fixture(scope="module")
def waves(scene, header, model, radii, table, tmp_path_factory):
    deck = loop_deck(scene, header, model, radii, table)
    return run_deck(deck, tmp_path_factory.mktemp("truth"))


def require_truth(waves, scene, table, model):
    require(truth_checks(waves, scene, table, model), scene)


def changed(waves, **arrays):
    named = {name.replace("_", "."): array for name, array in arrays.items()}
    return dataclasses.replace(waves, data=waves.data | named)


def test_good_run_passes(waves, scene, table, model):
    checks = truth_checks(waves, scene, table, model)
    require(checks, scene)
    assert {c.name for c in checks} == {"table_left", "outer_ring", "work"}
    assert next(c for c in checks if c.name == "work").value < 2e-4


def test_energy_from_nowhere_is_seen(waves, scene, table, model):
    faster = waves["sphere.v"] + np.linspace(0, 0.05, waves["time"].size)
    with pytest.raises(SimulationError, match="work"):
        require_truth(changed(waves, sphere_v=faster), scene, table, model)


def test_contact_beyond_the_last_ring_is_seen(waves, scene, table, model):
    wide = changed(waves, contact_force_R5=np.full_like(waves["time"], 0.1))
    with pytest.raises(SimulationError, match="outer_ring"):
        require_truth(wide, scene, table, model)


@pytest.mark.parametrize("kept", [1, 2, 3])
def test_a_ring_that_was_left_out_and_would_have_closed_is_seen(kept, waves, scene, table, model):
    """The same waveforms, as a run without the outer rings would leave them: R1 closes in them."""
    chip = dataclasses.replace(
        model,
        gain=np.delete(model.gain, range(kept, 6), axis=1),
        ports=(*model.ports[:kept], model.ports[-1]),
    )
    closed = [waves[f"contact.force.R{k}"].max() > 0 for k in range(6)]
    assert closed == [True, True, False, False, False, False]
    (check,) = (c for c in truth_checks(waves, scene, table, chip) if c.name == "ring_left_out")
    assert check.passed is not closed[kept]
    if closed[kept]:
        with pytest.raises(SimulationError, match=rf"more than {kept}, or to 'all'"):
            require((check,), scene)


def test_sphere_beyond_the_table_is_seen(scene, header, model, radii, table, tmp_path):
    kick = Kick.model_validate({"drive": {"voltage": 100.0}})  # too much for the made-up device
    hard = scene.model_copy(update={"kick": kick, "control": None, "solver": Solver(stop=6e-3)})
    waves = run_deck(loop_deck(hard, header, model, radii, table), tmp_path)
    failed = [c.name for c in truth_checks(waves, hard, table, model) if not c.passed]
    assert failed == ["table_left"]


def test_steps_too_coarse_for_the_contact_are_seen(scene, header, model, radii, table, tmp_path):
    """Tolerances at which ngspice ends without a word, with a wrong launch."""
    coarse = scene.model_copy(update={"solver": Solver(reltol=0.1, max_step=1e-4)})
    deck = loop_deck(coarse, header, model, radii, table)
    main = deck.files[deck.main].replace("trtol=1\n", "trtol=7\n")
    sloppy = dataclasses.replace(deck, files=deck.files | {deck.main: main})
    with pytest.raises(SimulationError, match="work"):
        require_truth(run_deck(sloppy, tmp_path), coarse, table, model)
