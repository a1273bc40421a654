"""Netlists with a global ground inside, and netlists whose reference no pin joins."""

import re

import pytest
from support import load_scene

import kc2spice as kc

# Two ideal sources of V/2 and -V/2 to node 0, as an H-bridge at full drive. `nested` contains the
# bridge one level below. `floating` and `referenced` contain no ground. `sensed` only senses it.
LIBRARY = """\
* bridges
.subckt hbridge oa ob
Va oa 0 2.25
Vb ob GND -2.25
.ends
.subckt nested oa ob
X1 oa ob hbridge
.ends
.subckt floating oa ob
Va oa ob 4.5
.ends
.subckt referenced oa ob ref
Va oa ref 2.25
Vb ref ob 2.25
.ends
.subckt sensed oa ob
Eo oa ob oa 0 0.5
.ends
"""
VOLTS, OHMS = 4.5, 1e3


def bridge(folder, subckt, load=None, amp=None):
    """A resistor between the outputs of a subcircuit."""
    (folder / "bridge.lib").write_text(LIBRARY)
    path = folder / "bridge.toml"
    path.write_text(f"""
[load]
part = "resistor"
resistance = {OHMS}
pins = {{ a = "amp.oa", b = "amp.ob" }}
[amp]
part = "netlist"
file = "bridge.lib"
subckt = "{subckt}"
[analysis]
type = "op"
[probes.current]
of = "load.i"
take = "final"
""")
    return path


@pytest.mark.parametrize("subckt", ["hbridge", "nested"])
def test_an_h_bridge_drives_its_load_between_two_outputs(subckt, tmp_path):
    """Both halves of the voltage drive the load: I = V / R, not V / 2R."""
    result = kc.run(bridge(tmp_path, subckt))
    assert result.metrics["current"] == pytest.approx(VOLTS / OHMS, rel=1e-9)


@pytest.mark.parametrize("subckt", ["floating", "referenced", "sensed"])
def test_the_advice_about_a_missing_ground_shorts_no_output(subckt, tmp_path):
    """With the advised pin on ground, the load has the whole voltage of the bridge."""
    path = bridge(tmp_path, subckt)
    joined = {} if subckt != "referenced" else {"amp.pins.ref": "mid.a"}
    if joined:
        middle = {"mid.part": "resistor", "mid.resistance": 1.0, "mid.pins.b": "load.b"}
        joined |= middle
    with pytest.raises(kc.errors.UsageError, match="no pin of this circuit") as caught:
        load_scene(path, joined)
    pin, name = re.search(r'add  (\w+) = "gnd"  to the pins of (\w+)$', caught.value.hint).groups()
    if subckt == "referenced":
        assert f"{name}.{pin}" in ("amp.ref", "mid.a")
    if subckt == "sensed":  # the source senses its own output, which has no unique value
        return
    result = kc.run(path, overrides={**joined, f"{name}.pins.{pin}": "gnd"})
    assert result.metrics["current"] == pytest.approx(VOLTS / OHMS, rel=1e-9)


def test_a_default_join_of_a_reference_pin_is_a_note(tmp_path, cli):
    path = bridge(tmp_path, "referenced")
    note = "ref of amp is connected to gnd by default"
    details = {part["part"]: part["detail"] for part in kc.run(path).record["plan"]["parts"]}
    assert note in details["amp"]
    text = " ".join(cli("explain", str(path), "--set", "amp.pins.ref=gnd").stdout.split())
    assert note not in text
