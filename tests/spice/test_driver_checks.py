"""Checks of what drivers and netlists of users give."""

import pytest
from device import models
from support import SimulationError, make_deck, simulate_deck


def test_an_amplifier_is_not_driven_beyond_its_rails(tmp_path):
    """3 A for 1 us into an output that takes 1 A: the rest charges 10 nF to 200 V."""
    build = models({
        "name": "driven", "analysis": {"type": "transient", "stop": 2e-6},
        "amplifier": {"part": "amplifier", "current_limit": 1.0, "pins": {"out": "push.out"}},
        "command": {"part": "source", "pins": {"out": "amplifier.command"}},
        "push": {"part": "source", "kind": "current",
                 "pulse": {"high": 3.0, "width": 1e-6, "edge": 1e-7}},
        "load": {"part": "capacitor", "capacitance": 10e-9, "pins": {"a": "push.out", "b": "gnd"}},
    })  # fmt: skip
    with pytest.raises(SimulationError, match="amplifier within its rails"):
        simulate_deck(build, make_deck(build), tmp_path)


RATED = """.subckt mine command out ref
Rsource command middle 10
Cslow middle ref 1e-8
Eout buffered ref middle ref 1
Rout buffered out 1
.ends mine
"""


@pytest.mark.parametrize(
    ("rating", "violated"),
    [
        ({"low": "-1 V", "high": "101 V", "slew": 6e8}, None),
        ({"high": "90 V"}, "mine.out within its rails"),
        ({"slew": 3e8}, "mine.out within its slew rate"),
    ],
)
def test_the_header_of_a_netlist_is_checked(rating, violated, tmp_path):
    """RC of 100 ns behind an edge of 200 ns rises by at most (1 - e^-2) 5e8 V/s."""
    (tmp_path / "mine.lib").write_text(RATED)
    text = ", ".join(f"{k} = {v!r}" for k, v in rating.items())
    (tmp_path / "a.toml").write_text(
        "[pulse]\npart = 'source'\npins = { out = 'mine.command' }\n"
        "pulse = { high = 100, width = 1e-5, edge = 2e-7, start = 1e-6 }\n"
        "[mine]\npart = 'netlist'\nfile = 'mine.lib'\nsubckt = 'mine'\n"
        f"ratings = {{ out = {{ {text} }} }}\npins = {{ out = 'load.a' }}\n"
        "[load]\npart = 'resistor'\nresistance = 1000.0\n"
        "[analysis]\nstop = 2e-5\n[solver]\nmax_step = 5e-8\n"
    )
    build = models(tmp_path / "a.toml")
    if violated is None:
        names = [c.name for c in simulate_deck(build, make_deck(build), tmp_path).verdict.checks]
        assert {"mine.out within its rails", "mine.out within its slew rate"} <= set(names)
        return
    with pytest.raises(SimulationError, match=violated):
        simulate_deck(build, make_deck(build), tmp_path)
