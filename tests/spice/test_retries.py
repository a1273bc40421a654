"""Retries: the cause picks the setting, each is announced, failures say where and what."""

import dataclasses
import re

import numpy as np
import pytest
from device import built, deck_of, edited

from kc2spice.core.errors import SimulationError
from kc2spice.core.progress import Clock, silent
from kc2spice.netlist.deck import Deck
from kc2spice.sim.ngspice import run_deck
from kc2spice.sim.retries import RetriesFailedError, run_with_retries
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.judge import verdict
from kc2spice.workflow.models import build_models

# A comparator without hysteresis drives a femtofarad: no step is short enough for it.
HOPELESS = "B1 0 b I={(V(b)>0.5) ? -1e6 : 1e6*TIME*1e6}\nC1 b 0 1e-15\nR1 b 0 1k\n.tran 1u 1m\n"


def deck(cards, stop=1e-3):
    return Deck(name="d", text=f"* d\n{cards}.end\n", vectors={"b": ("v(b)", 1.0)}, stop=stop)


@pytest.fixture(scope="module")
def stiff(varied, tmp_path_factory):
    """A stiff contact without the breakpoints that keep its pivots: the first loop that fails."""
    for voltage, edge in ((120, 2e-8), (140, 2e-7), (160, 1e-7)):
        keys = {"kick.drive.voltage": voltage, "kick.drive.edge": edge}
        # contact ports without inertia hide the defect
        keys |= {"contact.penalty": 2e10, "contact.inertia": "lumped", "solver.stop": 0.51e-3}
        deck = make_deck(build_models(varied(**keys), Clock(silent)))
        sick = edited(deck, lambda text: re.sub(r"(?m)^[VR]tick .*\n", "", text))
        assert sick.files["kick.lib"] != deck.files["kick.lib"]
        try:
            run_deck(sick, tmp_path_factory.mktemp("stiff"), timeout=120)
        except SimulationError as error:
            assert "Timestep too small" in error.message
            return sick
    pytest.fail("every loop passes without the breakpoints")


@pytest.mark.slow
def test_a_failed_time_step_is_cured_by_firmer_pivots(stiff, tmp_path):
    with pytest.warns(UserWarning, match=r"(?i)timestep too small.*trying firmer pivots"):
        done = run_with_retries(stiff, tmp_path, retries=3)
    first, second = done.attempts
    assert (first.setting, second.setting) == ("the scene's own settings", "firmer pivots")
    assert (second.cause, second.settings) == (None, "pivrel=0.1")
    assert first.part is not None
    assert ".options pivrel=0.1\n*        retry with firmer pivots" in done.deck.files[stiff.main]
    assert done.waves["time"][-1] == pytest.approx(0.51e-3)
    assert (tmp_path / f"{stiff.name}.1.log").is_file()


def test_no_retries_when_switched_off(tmp_path):
    with pytest.raises(RetriesFailedError, match="imestep too small") as caught:
        run_with_retries(deck(HOPELESS), tmp_path, retries=0)
    assert len(caught.value.attempts) == 1
    assert "solver.retries" in caught.value.hint


@pytest.mark.filterwarnings("ignore:tighter")
def test_a_result_of_too_coarse_steps_is_run_again(varied, model, table, tmp_path):
    coarse = varied(**{"solver.reltol": 0.03, "solver.max_step": 1e-4})
    build = built(coarse, model, table)
    with pytest.warns(UserWarning, match="tighter tolerances"):
        done = run_with_retries(
            make_deck(build), tmp_path, retries=3, judge=lambda waves: verdict(waves, build)
        )
    books = [f"energy of {part}" for part in ("sphere", "contact", "kick")]
    assert done.attempts[0].cause.split(":")[0] in books
    points = [attempt.points for attempt in done.attempts]
    assert points == sorted(points)
    assert all(check.passed for check in done.verdict.checks)


def test_what_no_tolerance_cures_is_not_run_again(scene, loop, model, table, tmp_path):
    def beyond(waves):
        far = waves.data | {"sphere.y": waves["sphere.y"] + 1.0}
        return verdict(dataclasses.replace(waves, data=far), built(scene, model, table))

    with pytest.raises(RetriesFailedError, match="table_left") as caught:
        run_with_retries(loop, tmp_path, retries=3, judge=beyond)
    assert len(caught.value.attempts) == 1


@pytest.mark.filterwarnings("ignore:.*trying")
def test_the_last_failure_names_node_time_part_and_all_settings(tmp_path):
    with pytest.raises(RetriesFailedError) as caught:
        run_with_retries(deck(HOPELESS), tmp_path, retries=4)
    error = caught.value
    assert [a.setting for a in error.attempts[1:]] == [
        "firmer pivots",
        "gear",
        "tighter tolerances",
    ]
    assert error.failure.node == "b"
    assert "node of b1, c1, r1" in str(error)
    for attempt in error.attempts[1:]:
        assert attempt.setting in error.hint
    partial = error.failure.partial
    assert 0 < partial["time"][-1] <= error.failure.time < 1e-3
    assert np.isfinite(partial["b"]).all()


@pytest.mark.parametrize(
    ("cards", "match"),
    [
        ("R1 b 0 1\nX1 a b nosub\n.tran 1u 1m\n", "unknown subckt"),
        ("V1 b 0 1\nR1 b 0 {nothing}\n.tran 1u 1m\n", "ngspice failed"),
    ],
)
def test_mistakes_in_the_netlist_are_not_retried(cards, match, tmp_path):
    with pytest.raises(RetriesFailedError, match=match) as caught:
        run_with_retries(deck(cards), tmp_path, retries=4)
    assert len(caught.value.attempts) == 1


@pytest.mark.filterwarnings("ignore:.*trying")
def test_a_loop_of_sources_is_told_as_such(tmp_path):
    with pytest.raises(RetriesFailedError, match="loops of voltage sources") as caught:
        run_with_retries(deck("V1 b 0 1\nV2 b 0 2\n.tran 1u 1m\n"), tmp_path, retries=4)
    assert [a.setting for a in caught.value.attempts[1:]] == ["firmer pivots"]
    assert caught.value.failure.kind == "singular"


@pytest.fixture(scope="module")
def loop(scene, model, table):
    return deck_of(scene, model, table)
