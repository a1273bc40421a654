"""A Python function that controls a scene: when it is asked, in which units, what it may be."""

from dataclasses import replace

import numpy as np
import pytest
from device import built
from support import (
    RetriesFailedError,
    StageTimer,
    UsageError,
    complete_run,
    load_scene,
    make_deck,
    repeat_timing,
    run_in_libngspice,
    verify_scenes,
)

import kc2spice as kc

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
    build = built(loaded, functions={"digits": function})
    part = loaded.get_part("digits")
    return run_in_libngspice(make_deck(build), [part.type.settable_quantities(part, build)["out"]])


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
    part = loaded.get_part("digits")
    with pytest.raises(UsageError, match="runs a Python file") as caught:
        built(loaded)
    assert "--trust" in caught.value.hint
    with pytest.raises(UsageError, match="runs a Python file"):
        verify_scenes([loaded], tmp_path / "out")
    assert verify_scenes([loaded], tmp_path / "out", trust=True)["scenes"]["controlled"]["passed"]
    call = part.type.settable_quantities(part, built(loaded, trust=True))["out"].call
    node = loaded.get_net("digits", "y")
    assert call(0.0, {node: 1.0}) == 7.0


def test_a_run_in_this_process_states_it_and_can_be_timed_again(tmp_path):
    """The simulator's own process can neither call functions nor be timed for one that does."""
    done = complete_run(
        scene(), tmp_path, StageTimer(), functions={"digits": lambda time, inputs: 1.0}
    )
    assert done.record["simulator"]["engine"] == "shared"
    assert done.run.cpu_s > 0
    assert repeat_timing(done.run) > 0


def test_files_that_are_no_function_are_refused(tmp_path):
    for text, words in (
        ("1 / 0\n", "law.py ends with an error"),
        ("x = 1\n", "defines no function of this name"),
    ):
        (tmp_path / "law.py").write_text(text)
        loaded = replace(scene(file="law.py"), home=tmp_path)
        part = loaded.get_part("digits")
        with pytest.raises(UsageError, match=words):
            part.type.settable_quantities(part, built(loaded, trust=True))


def test_impossible_controllers_are_refused():
    for keys, words in (({"delay": PERIOD}, "not shorter than the sampling period"),
                        ({"inputs": [], "pins": {}}, "has no inputs"),
                        ({"analysis": {"type": "op"}}, "needs a transient")):  # fmt: skip
        with pytest.raises(UsageError, match=words):
            scene(**keys)


LAW = """
from pathlib import Path
calls = []
def control(time, inputs):
    calls.append(time)
    with Path(__file__).with_suffix(".log").open("a") as log:
        log.write(f"{time} {len(calls)}\\n")
    return 0.0
"""
SCENE = """
analysis = { type = "transient", stop = "1 ms" }
own = { part = "netlist", file = "own.lib", subckt = "own" }
load = { part = "resistor", resistance = 1e3 }
[digits]
part = "controller"
file = "law.py"
inputs = ["y"]
units = { y = "V" }
pins = { y = "own.b", out = "load.a" }
"""
# A comparator without hysteresis drives a femtofarad: no step is short enough for it.
HOPELESS = """.subckt own b
B1 0 b I={(V(b)>0.5) ? -1e6 : 1e6*TIME*1e6}
C1 b 0 1e-15
R1 b 0 1k
.ends
"""


@pytest.mark.filterwarnings("ignore:.*trying")
def test_a_failed_step_is_repeated_with_a_reset_function(tmp_path):
    """As without a function; the failure says where, what was tried, and keeps the waveforms."""
    (tmp_path / "own.lib").write_text(HOPELESS)
    (tmp_path / "law.py").write_text(LAW)
    (tmp_path / "hopeless.toml").write_text(SCENE)
    with pytest.raises(RetriesFailedError, match="Timestep too small") as caught:
        kc.run(tmp_path / "hopeless.toml", tmp_path / "out", trust=True)
    error, tried = caught.value, ["firmer pivots", "gear", "tighter tolerances"]
    assert [a.setting for a in error.attempts[1:]] == tried
    assert "node of xown" in str(error)
    assert "kick" not in error.hint  # the scene has none
    assert error.failure.partial["time"][-1] <= error.failure.time < 1e-9
    assert (tmp_path / "out.failed" / "waveforms.partial.npz").is_file()
    assert (tmp_path / "law.log").read_text() == "0.0 1\n" * 4  # no attempt reached a second one
