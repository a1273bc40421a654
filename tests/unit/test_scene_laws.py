"""The laws of a scene are joined as its parts are."""

import subprocess
import sys

import pytest

from kc2spice.equations.scene_laws import scene_laws
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import Build

LOW_PASS = {
    "name": "low_pass",
    "drive": {"part": "source", "sine": {"amplitude": "1 V", "frequency": "1 kHz"}},
    "r": {"part": "resistor", "resistance": "1 kOhm", "pins": {"a": "drive.out", "b": "c.a"}},
    "c": {"part": "capacitor", "capacitance": "100 nF"},
    "analysis": {"type": "transient", "stop": "2 ms"},
}


def test_networks_share_nothing_but_ground():
    two = {k: v for k, v in LOW_PASS.items() if k not in ("name", "analysis")}
    twin = {f"{k}_2": v for k, v in two.items()}
    twin["r_2"] = twin["r_2"] | {"pins": {"a": "drive_2.out", "b": "c_2.a"}}
    laws = scene_laws(Build(load_scene({**LOW_PASS, **twin}), {}))
    names = [sorted(network.names) for network in laws.networks]
    assert names == [["c", "drive", "r"], ["c_2", "drive_2", "r_2"]]
    assert not any(network.has_sources_only for network in laws.networks)


@pytest.mark.parametrize("module", ["scene_laws", "networks", "replay"])
def test_laws_load_no_solver(module):
    code = f"import sys, kc2spice.equations.{module}; print('scipy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
