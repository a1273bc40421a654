"""Names in a deck are unique, whatever parts and pins are called: its nets are the scene's."""

import numpy as np
import pytest
from device import built

from kc2spice.core.errors import UsageError
from kc2spice.scene.load import load_scene
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.decks import make_deck


def test_two_parts_whose_pins_read_alike_keep_their_voltages(tmp_path, monkeypatch):
    """Both pins would be ``n_c_a``: 1 V and 2 V would be one net."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.lib").write_text(".subckt one c_a ref\nV1 c_a ref 1\nR1 c_a ref 1k\n.ends\n")
    (tmp_path / "two.lib").write_text(".subckt two a ref\nR0 s a 1\nV2 s ref 2\n.ends\n")
    scene = load_scene({
        "name": "alike", "analysis": {"stop": 1e-5}, "solver": {"max_step": 1e-6},
        "n": {"part": "netlist", "file": "one.lib", "subckt": "one"},
        "n_c": {"part": "netlist", "file": "two.lib", "subckt": "two"},
        "r1": {"part": "resistor", "resistance": 1e6, "pins": {"a": "n.c_a"}},
        "r2": {"part": "resistor", "resistance": 1e6, "pins": {"a": "n_c.a"}},
    })  # fmt: skip
    waves = run_deck(make_deck(built(scene)), tmp_path)
    np.testing.assert_allclose(waves["r1.v"], 1.0, rtol=1e-9)
    np.testing.assert_allclose(waves["r2.v"], 2.0, rtol=2e-6)  # 1 Ohm against 1 MOhm


def test_pins_that_differ_in_case_only_are_refused(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "one.lib").write_text(".subckt one A a\nR1 A a 1k\n.ends\n")
    with pytest.raises(UsageError, match="differ in case only"):
        load_scene({"name": "one", "n": {"part": "netlist", "file": "one.lib", "subckt": "one",
                    "pins": {"A": "gnd"}}})  # fmt: skip
