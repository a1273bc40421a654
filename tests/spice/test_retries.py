"""Retries: the cause picks the setting, each is announced, failures say where and what."""

import dataclasses

import numpy as np
import pytest
from device import built
from support import (
    Check,
    Deck,
    RetriesFailedError,
    Verdict,
    form_verdict,
    make_deck,
    run_deck,
    run_with_retries,
)

import kc2spice as kc

# A comparator without hysteresis drives a femtofarad: no step is short enough for it.
HOPELESS = "B1 0 b I={(V(b)>0.5) ? -1e6 : 1e6*TIME*1e6}\nC1 b 0 1e-15\nR1 b 0 1k\n.tran 1u 1m\n"


def deck(cards, stop=1e-3):
    return Deck(name="d", text=f"* d\n{cards}.end\n", vectors={"b": ("v(b)", 1.0)}, stop=stop)


def batch(folder):
    return lambda deck: run_deck(deck, folder)


@pytest.mark.filterwarnings("ignore:tighter")
def test_a_result_of_too_coarse_steps_is_run_again(varied, model, table, tmp_path):
    coarse = varied(**{"solver.reltol": 0.03, "solver.max_step": 1e-4})
    build = built(coarse, model, table)
    with pytest.warns(UserWarning, match="tighter tolerances"):
        done = run_with_retries(
            make_deck(build),
            tmp_path,
            batch(tmp_path),
            retries=3,
            judge=lambda waves: form_verdict(waves, build),
        )
    books = [f"energy of {part}" for part in ("sphere", "contact", "kick")]
    assert done.attempts[0].cause.split(":")[0] in books
    points = [attempt.points for attempt in done.attempts]
    assert points == sorted(points)
    # what fails a run; modes in contact, whose steps only warn, are 1.5 % off at this reltol
    assert all(check.passed for check in done.verdict.checks if check.action == "fail")


def test_failures_that_no_tolerance_prevents_are_not_repeated(scene, loop, model, table, tmp_path):
    def beyond(waves):
        far = waves.data | {"sphere.y": waves["sphere.y"] + 1.0}
        return form_verdict(dataclasses.replace(waves, data=far), built(scene, model, table))

    with pytest.raises(RetriesFailedError, match="outside the force table") as caught:
        run_with_retries(loop, tmp_path, batch(tmp_path), retries=3, judge=beyond)
    assert len(caught.value.attempts) == 1


@pytest.mark.filterwarnings("ignore:.*trying")
def test_a_retry_of_a_long_run_states_that_it_may_take_as_long(tmp_path, monkeypatch):
    monkeypatch.setattr("kc2spice.sim.ngspice.LONG_ATTEMPT", 0.0)
    with (
        pytest.warns(UserWarning, match="up to 3 attempts of similar or longer duration") as shown,
        pytest.raises(RetriesFailedError),
    ):
        run_with_retries(
            deck(HOPELESS), tmp_path, batch(tmp_path), retries=3, judge=lambda waves: Verdict()
        )
    assert "1 attempt of similar or longer duration" in str(shown[-1].message)


@pytest.mark.filterwarnings("ignore:.*trying")
def test_the_last_failure_names_node_time_part_and_all_settings(tmp_path):
    with pytest.raises(RetriesFailedError) as caught:
        run_with_retries(
            deck(HOPELESS), tmp_path, batch(tmp_path), retries=4, judge=lambda waves: Verdict()
        )
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
    assert "hysteresis" in error.hint
    assert "kick" not in error.hint  # nothing of that name is there
    partial = error.failure.partial
    assert 0 < partial["time"][-1] <= error.failure.time < 1e-3
    assert np.isfinite(partial["b"]).all()


@pytest.mark.filterwarnings("ignore")
def test_a_check_that_shorter_steps_do_not_change_names_the_edited_cards(tmp_path):
    deck = kc.deck("impact")
    for name, text in deck.files.items():
        (tmp_path / name).write_text(text)
    path = tmp_path / deck.main_file_name
    right = path.read_text()
    path.write_text(right.replace("0 kick_ring0 kick_ring1 0", "0 kick_ring1 kick_ring0 0"))
    with pytest.raises(RetriesFailedError, match="shorter time steps do not change") as caught:
        kc.run("impact", deck=path)
    assert "reltol in" not in caught.value.hint
    card = next(line for line in path.read_text().splitlines() if line.startswith("Xkick"))
    number = path.read_text().splitlines().index(card) + 1
    edit = f"Xkick in line {number} (nodes kick_ring0 and kick_ring1 are exchanged)"
    assert caught.value.hint.endswith(f"compare these edits with a new export: {edit}")
    path.write_text(right)
    assert kc.run("impact", deck=path).checks


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("values", "blamed"), [((0.72, 0.72, 0.72), False), ((9, 3, 1), True)])
def test_only_a_check_that_depends_on_the_steps_blames_the_steps(values, blamed, tmp_path):
    left = iter(values)

    def judge(waves):
        advice = "the steps are too coarse: lower solver.reltol"
        return Verdict((Check("energy", next(left), 0.1, advice=advice, coarse=True),))

    linear = deck("V1 b 0 1\nR1 b 0 1\n.tran 1u 1m\n")
    with pytest.raises(RetriesFailedError) as caught:
        run_with_retries(linear, tmp_path, batch(tmp_path), retries=3, judge=judge)
    assert ("too coarse" in caught.value.message) == blamed
    assert ("reltol in the .options line" in caught.value.hint) == blamed
    assert ("kc2spice verify" in caught.value.hint) != blamed
