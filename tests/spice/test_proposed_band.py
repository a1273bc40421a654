"""Checks of the band of a reduced model propose a band, and with this band the checks pass."""

import re

import pytest

import kc2spice as kc

SCENE = """[disc]
part = "disc"
layers = [
  { material = "brass", diameter = "35 mm", thickness = "0.3 mm" },
  { material = "PZT-5A", diameter = "25 mm", thickness = "0.23 mm", electrodes = "23 mm" },
]
support = { node = "22.4 mm" }
damping = { quality = 50 }
pins = { anode = "drive.out" }
"""
DRIVER = """[drive]
part = "netlist"
file = "drive.lib"
subckt = "drive"
[analysis]
type = "transient"
stop = "1 ms"
[probes]
v = { of = "disc.voltage", take = "max" }
"""
LIBRARY = """* a driver whose edges are not known before the run
.subckt drive out ref
V1 a ref PULSE(0 9 10u 2u 2u 100u 300u)
R1 a out 10
.ends
"""
AC = """rom = { band = ["0 Hz", "5 kHz"] }
[drive]
part = "source"
ac = "1 V"
[analysis]
type = "ac"
start = "1 kHz"
stop = "6 kHz"
points = 20
[probes]
v = { of = "disc.voltage", take = "max" }
"""


@pytest.mark.parametrize(
    ("rest", "label"),
    [(DRIVER, "frequency content, disc.anode"), (AC, "highest analysis frequency, disc")],
)
def test_the_proposed_band_contains_the_frequencies_of_the_run(rest, label, tmp_path):
    (tmp_path / "drive.lib").write_text(LIBRARY)
    path = tmp_path / "horn.toml"
    path.write_text(SCENE + rest)
    with pytest.warns(UserWarning, match=f"failed check: {label}") as issued:
        kc.run(path, tmp_path / "narrow")
    text = next(str(item.message) for item in issued if label in str(item.message))
    band = re.search(r'set disc\.rom\.band = (\["0 Hz", "[\d.]+ kHz"\])', text)
    assert band, text
    result = kc.run(path, tmp_path / "wide", overrides=[f"disc.rom.band={band[1]}"])
    assert all(check["passed"] for check in result.record["checks"])
