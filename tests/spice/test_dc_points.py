"""A curve has as many points as were asked for, wherever it begins and ends."""

import random
import subprocess

import pytest

from kc2spice.netlist.deck import dc
from kc2spice.sim.ngspice import find_ngspice


@pytest.mark.parametrize("seed", range(12))
def test_no_point_is_lost_by_rounding(seed, tmp_path):
    rng = random.Random(seed)
    first, last = rng.uniform(-1e4, 0.0), rng.uniform(1.0, 1e4)
    points = rng.choice((2, 401, 2001))
    card = dc("V1", first, last, points).card
    deck = tmp_path / "curve.cir"
    deck.write_text(f"* curve\nV1 a 0 0\nR1 a 0 1\n{card}\n.print dc v(a)\n.end\n", "utf-8")
    said = subprocess.run(
        [find_ngspice().path, "-b", deck], capture_output=True, text=True, check=True
    ).stdout
    rows = [words for line in said.splitlines() if len(words := line.split()) == 3]
    values = [float(words[1]) for words in rows if words[0].isdigit()]
    assert len(values) == points
    assert values[-1] == pytest.approx(last, rel=1e-6, abs=1e-6)
