"""A Python function that controls a scene: when it is asked, in which units, what it may be."""

from dataclasses import replace

import numpy as np
import pytest
from device import built

from kc2spice.core.errors import UsageError
from kc2spice.scene.load import load_scene
from kc2spice.sim.loop import run_shared
from kc2spice.workflow.decks import make_deck

PERIOD, DELAY = 10e-6, 4e-6  # s


def scene(**digits):
    """A displacement of 3 um in, a resistor of 2 kOhm on the controller's output."""
    return load_scene({
        "name": "controlled",
        "solver": {"stop": 100e-6, "max_step": 1e-6},
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
    return run_shared(make_deck(build), [part.type.sampled(part, build)])


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


def test_an_input_in_volts_is_seen_in_volts():
    tables = {
        "name": "controlled", "solver": {"stop": 25e-6, "max_step": 1e-6},
        "supply": {"part": "source", "dc": 0.25},
        "load": {"part": "resistor", "resistance": 2e3, "pins": {"a": "digits.out", "b": "gnd"}},
        "digits": {"part": "controller", "period": PERIOD, "inputs": ["y"], "units": {"y": "V"},
                   "file": "own.py", "pins": {"y": "supply.out"}},
    }  # fmt: skip
    seen = []
    loaded = load_scene(tables)
    part = loaded.part("digits")
    assert part.type.files(part, loaded) == ("own.py",)
    assert part.type.files(scene().part("digits"), loaded) == ()
    waves = ran(loaded, lambda time, inputs: seen.append(inputs["y"]) or 0.0)
    assert seen == pytest.approx(3 * [0.25])
    np.testing.assert_allclose(waves["digits.y"], 0.25)
    assert make_deck(built(loaded)).units["digits.y"] == "V"


def test_a_file_runs_only_when_it_is_trusted(tmp_path):
    (tmp_path / "law.py").write_text("def control(time, inputs):\n    return 7.0\n")
    loaded = replace(scene(file="law.py"), home=tmp_path)
    part = loaded.part("digits")
    with pytest.raises(UsageError, match="runs a Python file") as caught:
        part.type.sampled(part, built(loaded))
    assert "--trust" in caught.value.hint
    call = part.type.sampled(part, replace(built(loaded), trust=True)).call
    node = loaded.net("digits", "y")
    assert call(0.0, {node: 1.0}) == 7.0


@pytest.mark.parametrize(
    ("text", "words"),
    [("1 / 0\n", "the file fails"), ("x = 1\n", "no such function"), (None, "no such Python file")],
)
def test_files_that_are_no_function_are_refused(tmp_path, text, words):
    if text is not None:
        (tmp_path / "law.py").write_text(text)
    loaded = replace(scene(file="law.py"), home=tmp_path)
    part = loaded.part("digits")
    with pytest.raises(UsageError, match=words):
        part.type.sampled(part, replace(built(loaded), trust=True))


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"delay": PERIOD}, "after the next sample"),
        ({"inputs": [], "pins": {}}, "sees nothing"),
        ({"period": 0.0}, "period"),
    ],
)
def test_impossible_controllers_are_refused(keys, words):
    with pytest.raises(UsageError, match=words):
        scene(**keys)


@pytest.mark.parametrize("analysis", [{"type": "op"}, {"type": "ac", "start": 10.0, "stop": 1e3}])
def test_a_function_is_asked_in_a_transient_alone(analysis):
    tables = {
        "name": "controlled", "analysis": analysis, "supply": {"part": "source", "dc": 0.25},
        "load": {"part": "resistor", "resistance": 1e3, "pins": {"a": "digits.out", "b": "gnd"}},
        "digits": {"part": "controller", "period": PERIOD, "inputs": ["u"],
                   "units": {"u": "V"}, "pins": {"u": "supply.out"}},
    }  # fmt: skip
    with pytest.raises(UsageError, match="asked in time") as caught:
        load_scene(tables)
    assert (caught.value.where.split()[-1], caught.value.got) == ("digits", analysis["type"])
    load_scene({k: v for k, v in tables.items() if k != "analysis"})


def test_no_function_is_said_before_anything_runs():
    loaded = scene()
    part = loaded.part("digits")
    with pytest.raises(UsageError, match="no function"):
        part.type.sampled(part, built(loaded))
