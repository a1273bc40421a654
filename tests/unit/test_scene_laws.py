"""The laws of a scene are made once for a build, and again when its keys or models change."""

import subprocess
import sys
from collections import Counter
from dataclasses import replace

import pytest
from support import (
    BuiltScene,
    StageTimer,
    build_models,
    get_scene_laws,
    ignore_progress,
    load_scene,
    store_laws,
)

import kc2spice as kc

LOW_PASS = {
    "name": "low_pass",
    "drive": {"part": "source", "sine": {"amplitude": "1 V", "frequency": "1 kHz"}, "ac": "1 V"},
    "r": {"part": "resistor", "resistance": "1 kOhm", "pins": {"a": "drive.out", "b": "c.a"}},
    "c": {"part": "capacitor", "capacitance": "100 nF"},
    "analysis": {"type": "transient", "stop": "2 ms"},
}


SMALL_SIGNAL_ANALYSES = {"type": "ac", "start": "10 Hz", "stop": "100 kHz", "points": 20}


@pytest.mark.parametrize("analysis", [LOW_PASS["analysis"], SMALL_SIGNAL_ANALYSES])
def test_a_run_calls_the_law_of_each_part_once(analysis, monkeypatch):
    """For the time step, its check after the simulation, the operating point and resonances."""
    scene, asked = load_scene({**LOW_PASS, "analysis": analysis}), Counter()
    for kind in {type(part.type) for part in scene.parts.values()}:
        law = kind.law

        def counted(self, part, build, law=law):
            asked[part.name] += 1
            return law(self, part, build)

        monkeypatch.setattr(kind, "law", counted)
    result = kc.run(scene)
    names = {check.name for check in result.checks}
    compared = "time steps compared with the exact solution" in names
    assert compared is (analysis["type"] == "transient")
    assert asked == {"drive": 1, "r": 1, "c": 1}


def test_a_build_carries_its_laws():
    build = build_models(load_scene(LOW_PASS), StageTimer(ignore_progress))
    assert get_scene_laws(build) is build.laws is get_scene_laws(build)
    assert get_scene_laws(build).networks is get_scene_laws(build).networks


def test_laws_of_other_keys_or_models_are_made_again():
    build = build_models(load_scene(LOW_PASS), StageTimer(ignore_progress))
    other = load_scene(LOW_PASS, {"r.resistance": "2 kOhm"})
    changed = get_scene_laws(replace(build, scene=other))
    assert changed.build.scene is other
    assert changed is not get_scene_laws(build)
    assert get_scene_laws(replace(build, models=dict(build.models))) is not get_scene_laws(build)


def test_networks_share_nothing_but_ground():
    two = {k: v for k, v in LOW_PASS.items() if k not in ("name", "analysis")}
    twin = {f"{k}_2": v for k, v in two.items()}
    twin["r_2"] = twin["r_2"] | {"pins": {"a": "drive_2.out", "b": "c_2.a"}}
    laws = store_laws(BuiltScene(load_scene({**LOW_PASS, **twin}), {})).laws
    names = [sorted(network.law_names) for network in laws.networks]
    assert names == [["c", "drive", "r"], ["c_2", "drive_2", "r_2"]]
    assert not any(network.has_sources_only for network in laws.networks)


@pytest.mark.parametrize("module", ["scene_laws", "networks", "recorded_sources"])
def test_laws_load_no_solver(module):
    code = f"import sys, kc2spice.equations.{module}; print('scipy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
