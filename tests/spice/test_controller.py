"""A Python function that controls a scene: when it is asked, in which units, what it may be."""

from dataclasses import replace

import numpy as np
import pytest
from device import built

from kc2spice.core.errors import UsageError
from kc2spice.scene.load import load_scene
from kc2spice.sim.shared import run_shared
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.refine import time_again
from kc2spice.workflow.run import complete
from kc2spice.workflow.verify.verify import verify

PERIOD, DELAY = 10e-6, 4e-6  # s


def scene(analysis=None, **digits):
    """A displacement of 3 um in, a resistor of 2 kOhm on the controller's output."""
    steps = {"max_step": 1e-6} | ({} if analysis else {"stop": 100e-6})
    return load_scene({
        "name": "controlled", "analysis": analysis or {"type": "transient"},
        "solver": steps,
        "move": {"part": "source", "kind": "displacement", "dc": 3e-6},
        "load": {"part": "resistor", "resistance": 2e3, "pins": {"a": "digits.out", "b": "gnd"}},
        "digits": {
            "part": "controller", "period": PERIOD, "delay": DELAY, "inputs": ["y"],
            "pins": {"y": "move.out"}, **digits,
        },
        "probes": {"out": {"of": "load.v", "take": "final"}},
    })  # fmt: skip


def ran(loaded, function):
    build = replace(built(loaded), functions={"digits": function})
    part = loaded.part("digits")
    return run_shared(make_deck(build), [part.type.settable(part, build)["out"]])


@pytest.mark.parametrize(("output", "factor"), [("voltage", 1.0), ("current", 2e3)])
def test_inputs_are_si_and_the_output_is_held_from_the_delay_on(output, factor):
    seen = []

    def staircase(time, inputs):
        seen.append((time, inputs["y"]))
        return 1e-3 * len(seen)

    waves = ran(scene(output=output), staircase)
    times, heights = np.array(seen).T
    np.testing.assert_allclose(times, PERIOD * np.arange(11), atol=1e-15)
    np.testing.assert_allclose(heights, 3e-6, rtol=1e-9)
    for share, step in ((0.2, 0), (0.9, 1)):  # before and after the delay
        at = PERIOD * (np.arange(1, 9) + share)
        held = np.interp(at, waves["time"], waves["load.v"])
        np.testing.assert_allclose(held, factor * 1e-3 * (np.arange(1, 9) + step), rtol=1e-9)
    np.testing.assert_allclose(waves["digits.y"], 3e-6, rtol=1e-9)


def test_a_file_runs_only_when_it_is_trusted(tmp_path):
    (tmp_path / "law.py").write_text("def control(time, inputs):\n    return 7.0\n")
    loaded = replace(scene(file="law.py"), home=tmp_path)
    part = loaded.part("digits")
    with pytest.raises(UsageError, match="runs a Python file") as caught:
        part.type.settable(part, built(loaded))
    assert "--trust" in caught.value.hint
    with pytest.raises(UsageError, match="runs a Python file"):
        verify([loaded], tmp_path / "out")
    assert verify([loaded], tmp_path / "out", trust=True)["scenes"]["controlled"]["passed"]
    call = part.type.settable(part, replace(built(loaded), trust=True))["out"].call
    node = loaded.net("digits", "y")
    assert call(0.0, {node: 1.0}) == 7.0


def test_a_run_says_that_it_was_within_this_process_and_can_be_timed_again(tmp_path):
    """The simulator's own process can neither call functions nor be timed for one that does."""
    done = complete(scene(), tmp_path, functions={"digits": lambda time, inputs: 1.0})
    assert done.record["simulator"]["engine"] == "shared"
    assert done.run.cpu_s > 0
    assert time_again(done.run) > 0


def test_files_that_are_no_function_are_refused(tmp_path):
    for text, words in (("1 / 0\n", "the file fails"), ("x = 1\n", "no such function")):
        (tmp_path / "law.py").write_text(text)
        loaded = replace(scene(file="law.py"), home=tmp_path)
        part = loaded.part("digits")
        with pytest.raises(UsageError, match=words):
            part.type.settable(part, replace(built(loaded), trust=True))


def test_impossible_controllers_are_refused():
    for keys, words in (({"delay": PERIOD}, "after the next sample"),
                        ({"inputs": [], "pins": {}}, "sees nothing"),
                        ({"analysis": {"type": "op"}}, "asked in time")):  # fmt: skip
        with pytest.raises(UsageError, match=words):
            scene(**keys)
