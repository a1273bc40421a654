"""Probes of a user's own subcircuit: pins and nodes inside, checked before anything is run."""

import json

import numpy as np
import pytest

SCENE = """
name = "divided"
analysis = {{ type = "ac", start = "1 kHz", stop = "2 kHz", points = 3, scale = "linear" }}
[drive]
part = "source"
ac = "1 V"
pins = {{ out = "filter.in" }}
[filter]
part = "netlist"
file = "filter.lib"
subckt = "filter"
pins = {{ out = "load.a" }}
[load]
part = "resistor"
resistance = "1 kOhm"
[probes.looked]
of = "filter.{node}"
take = "value"
at = "1 kHz"
"""
FILTER = """* low pass, a buffer inside
.subckt filter in out ref
R1 in Mid 1k
C1 mid ref 100n
Xb mid out ref buffer
.ends
.subckt buffer in out ref
E1 inner ref in ref 1
R2 inner out 1k
.ends
"""
POLE = 1 / np.sqrt(1 + (2 * np.pi * 1e3 * 1e3 * 100e-9) ** 2)  # of 1 kOhm and 100 nF at 1 kHz


@pytest.fixture
def looked(tmp_path, cli):
    (tmp_path / "filter.lib").write_text(FILTER)

    def run(node):
        (tmp_path / "divided.toml").write_text(SCENE.format(node=node))
        return cli("run", "divided.toml", "-o", "out", "--json")

    return run


@pytest.mark.parametrize(
    ("node", "share"), [("in", 1.0), ("mid", POLE), ("xb.inner", POLE), ("out", POLE / 2)]
)
def test_a_probe_reads_pins_and_inner_nodes(looked, node, share):
    done = looked(node)
    assert done.exit_code == 0, done.stderr
    # ngspice adds 1e-12 S to nodes: far below
    assert json.loads(done.stdout)["metrics"]["looked"] == pytest.approx(share, rel=1e-6)


def test_an_unknown_node_is_an_error_before_the_run(looked, tmp_path):
    done = looked("mod")
    said = " ".join(done.stderr.split())
    assert done.exit_code == 2
    assert "probes.looked" in said
    assert "got: 'filter.mod'" in said
    assert "of filter: mid, out, in, ref" in said
    assert "simulate" not in said
    assert not (tmp_path / "out").exists()
