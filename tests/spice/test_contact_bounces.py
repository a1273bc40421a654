"""A hundred bounces keep their energy, and coarse steps do not pass unnoticed."""

from __future__ import annotations

import dataclasses
import re
import sys
from pathlib import Path

import pytest
from device import built, edited

from kc2spice.core.errors import SimulationError
from kc2spice.scene.judge import require
from kc2spice.scene.load import load_scene
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.judge import verdict

sys.path.insert(0, str(Path(__file__).parent))
from hard_cases.bounces import OPTIONS, bounce
from hard_cases.kit import Bench


@pytest.mark.parametrize("options", ["trap, 1e-3", "trap, 1e-6, chgtol 1e-12"])
def test_watched_edges_keep_the_energy_at_every_tolerance(options, tmp_path):
    bounced = bounce(Bench(tmp_path), "max(0, x), edges watched", OPTIONS[options])
    assert abs(bounced.energy) < 1e-3
    assert bounced.missed == 0
    assert bounced.points < 40_000


def test_without_the_watch_a_hundred_bounces_go_wrong(tmp_path):
    """The defect is real: what the switch cures is seen when it is taken out."""
    bounced = bounce(Bench(tmp_path), "max(0, x)", OPTIONS["trap, 1e-3"])
    assert abs(bounced.energy) > 0.1


def test_coarse_steps_over_many_landings_are_noticed(model, tmp_path):
    """ngspice's own options, no watch: the sphere gains height, and the run fails."""
    overrides = ["gravity=9.81 m/s2", "impact.velocity=-10 mm/s", "kick.electrical=short",
                 "solver.stop=7 ms", "solver.max_step=40 us"]  # fmt: skip
    build = built(load_scene("impact", ["contact.rings=all", *overrides]), model)
    deck = edited(make_deck(build), lambda text: re.sub(r"(?m)^Snear.*\n", "", text))
    kept = tuple(o for o in deck.options if o.key not in ("reltol", "trtol", "chgtol"))
    waves = run_deck(dataclasses.replace(deck, options=kept), tmp_path)
    with pytest.raises(SimulationError, match="contradicts physics"):
        require(verdict(waves, build).checks, "impact")
