"""The retry ladder: the cause picks the rung, every rung is told, failures say where and what."""

import dataclasses
import re

import numpy as np
import pytest

from kc2spice.bodies.piezo_stack import piezo_stack, ring_radii
from kc2spice.core.errors import SimulationError
from kc2spice.parts.bench import loop_deck
from kc2spice.rom.modal import resonators
from kc2spice.rom.reduce import reduce
from kc2spice.scene.schema import Contact, Kick, Solver
from kc2spice.sim.failure import belongs_to
from kc2spice.sim.ladder import LadderError, climb
from kc2spice.sim.ngspice import run_deck
from kc2spice.sim.rungs import RUNGS, Settings, next_rung, with_settings
from kc2spice.sim.truth import find_truth
from kc2spice.spice.circuit import Deck

# A comparator without hysteresis drives a femtofarad: no step is short enough for it.
HOPELESS = "B1 0 b I={(V(b)>0.5) ? -1e6 : 1e6*TIME*1e6}\nC1 b 0 1e-15\nR1 b 0 1k\n.tran 1u 1m\n"


def deck(cards, stop=1e-3):
    return Deck("d", "d.cir", {"d.cir": f"* d\n{cards}.end\n"}, {"b": ("v(b)", 1.0)}, stop)


@pytest.fixture(scope="module")
def stiff(scene, header, table, tmp_path_factory):
    """A stiff contact without the breakpoints that keep its pivots: the first loop that fails."""
    device = piezo_stack(Kick())
    chip = resonators(reduce(device, order=30, band=(0.0, 500e3)))
    for voltage, edge in ((120, 2e-8), (140, 2e-7), (160, 1e-7)):
        varied = scene.model_copy(
            update={
                "kick": Kick.model_validate({"drive": {"voltage": voltage, "edge": edge}}),
                "contact": Contact(penalty=2e10),
                "solver": Solver(stop=0.51e-3),
            }
        )
        deck = loop_deck(varied, header, chip, ring_radii(Kick()), table)
        kick = re.sub(r"(?m)^[VR]tick .*\n", "", deck.files["kick.lib"])
        sick = dataclasses.replace(deck, files=deck.files | {"kick.lib": kick})
        try:
            run_deck(sick, tmp_path_factory.mktemp("stiff"), timeout=120)
        except SimulationError as error:
            assert "Timestep too small" in error.message
            return sick
    pytest.fail("every loop passes without the breakpoints")


def test_a_failed_time_step_is_cured_by_firmer_pivots(stiff, tmp_path):
    with pytest.warns(UserWarning, match=r"(?i)timestep too small.*trying firmer pivots"):
        climbed = climb(stiff, tmp_path, retries=3)
    first, second = climbed.attempts
    assert (first.rung, second.rung) == ("the scene's own settings", "firmer pivots")
    assert (second.cause, second.settings) == (None, "pivrel=0.1")
    assert first.part is not None
    assert ".options pivrel=0.1" in climbed.deck.files[stiff.main]
    assert "Retry ladder" in climbed.deck.files[stiff.main]
    assert climbed.waves["time"][-1] == pytest.approx(0.51e-3)
    assert (tmp_path / f"{stiff.name}.1.log").is_file()


def test_no_retries_when_switched_off(stiff, tmp_path):
    with pytest.raises(LadderError, match="Timestep too small") as caught:
        climb(stiff, tmp_path, retries=0)
    assert len(caught.value.attempts) == 1
    assert "solver.retries" in caught.value.hint


@pytest.mark.filterwarnings("ignore:closer")
def test_a_result_of_too_coarse_steps_is_run_again(scene, header, model, radii, table, tmp_path):
    coarse = scene.model_copy(update={"solver": Solver(reltol=0.03, max_step=1e-4)})
    deck = loop_deck(coarse, header, model, radii, table)
    with pytest.warns(UserWarning, match="closer tolerances"):
        climbed = climb(
            deck, tmp_path, retries=3, judge=lambda w: find_truth(w, coarse, table, model)
        )
    assert climbed.attempts[0].cause.split(":")[0] in ("work", "contact", "chip")
    points = [attempt.points for attempt in climbed.attempts]
    assert points == sorted(points)
    assert all(check.passed for check in climbed.truth.checks)


def test_what_no_tolerance_cures_is_not_run_again(scene, bench, model, table, tmp_path):
    def beyond(waves):
        far = waves.data | {"sphere.y": waves["sphere.y"] + 1.0}
        return find_truth(dataclasses.replace(waves, data=far), scene, table, model)

    with pytest.raises(LadderError, match="table_left") as caught:
        climb(bench, tmp_path, retries=3, judge=beyond)
    assert len(caught.value.attempts) == 1


@pytest.mark.filterwarnings("ignore:.*trying")
def test_the_last_failure_names_node_time_part_and_all_rungs(tmp_path):
    with pytest.raises(LadderError) as caught:
        climb(deck(HOPELESS), tmp_path, retries=4)
    error = caught.value
    assert [a.rung for a in error.attempts[1:]] == ["firmer pivots", "gear", "closer tolerances"]
    assert error.failure.node == "b"
    assert "node of b1, c1, r1" in str(error)
    for rung in error.attempts[1:]:
        assert rung.rung in error.hint
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
    with pytest.raises(LadderError, match=match) as caught:
        climb(deck(cards), tmp_path, retries=4)
    assert len(caught.value.attempts) == 1


@pytest.mark.filterwarnings("ignore:.*trying")
def test_a_loop_of_sources_is_told_as_such(tmp_path):
    with pytest.raises(LadderError, match="loops of voltage sources") as caught:
        climb(deck("V1 b 0 1\nV2 b 0 2\n.tran 1u 1m\n"), tmp_path, retries=4)
    assert [a.rung for a in caught.value.attempts[1:]] == ["firmer pivots"]
    assert caught.value.failure.kind == "singular"


def test_no_rung_is_taken_twice():
    tried = ()
    while rung := next_rung("timestep", tried):
        tried += (rung.name,)
    assert len(tried) == len(set(tried)) == sum("timestep" in rung.cures for rung in RUNGS)
    assert next_rung(None, ()) is None


def test_settings_add_up_and_have_the_last_word(tmp_path):
    sine = "V1 a 0 SIN(0 1 1k)\nR1 a b 1k\nC1 b 0 1u\n.options acct reltol=0.5 chgtol=1e-9\n"
    plain = deck(sine + ".tran 1u 1m 0 1e-4\n")
    closer = Settings(closer=0.1).plus(Settings((("method", "gear"),), 1e-4))
    assert closer.closer == pytest.approx(1e-5)
    changed = with_settings(plain, RUNGS[-1], closer)
    text = changed.files["d.cir"]
    assert ".options method=gear" in text
    assert text.index("reltol=0.5") < text.index(".options reltol=") < text.index(".tran 1u 1m 0 ")
    few, many = (run_deck(d, tmp_path)["time"].size for d in (plain, changed))
    assert many > 3 * few


@pytest.fixture(scope="module")
def bench(scene, header, model, radii, table):
    return loop_deck(scene, header, model, radii, table)


@pytest.mark.parametrize(
    ("node", "words"),
    [
        ("xkick.fr0", "pin R0 (1 V = 1 um, 1 A = 1 N)"),
        ("xkick.q3", "inside at q3"),
        ("b.xcontact.br2", "pin R2"),
        ("xsphere.v", "pin v (1 V = 1 m/s, 1 A = 1 N)"),
        ("r0", "xkick (kick) pin r0"),
        ("vkick#branch", "vkick in loop.cir"),
    ],
)
def test_nodes_are_given_to_their_parts(node, words, bench):
    assert words in belongs_to(bench, node)


@pytest.mark.parametrize("node", ["xnone.a", "nowhere", "x.y.z", "", "."])
def test_nodes_that_are_not_in_the_deck_belong_to_nothing(node, bench):
    assert belongs_to(bench, node) is None
