"""InSpice reads our libraries and shares a process with our own use of libngspice."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).parent
EXAMPLE = HERE.parents[1] / "docs" / "examples" / "impedance_inspice.py"
CLIENT = HERE / "python_client.py"
STEP = 1e3  # Hz, of the example's sweep


@pytest.mark.parametrize("first", ["ours", "theirs"])
def test_impedance_from_a_library_beside_our_own_simulation(first, deck_of, run, model, tmp_path):
    pytest.importorskip("InSpice.Spice.Netlist")
    deck = deck_of("harmonic")
    (chip,) = deck.parts
    (tmp_path / "kick.lib").write_text(chip.text)
    said = run([sys.executable, str(CLIENT), first, str(EXAMPLE), "kick.lib"], tmp_path)
    assert said.count("ours 1.0000") == (2 if first == "ours" else 1)
    # free rings: the admittance is s times the modal charge per volt
    frequency = np.arange(1e5, 5e5 + 1, STEP)
    s = 2j * np.pi * frequency[:, None]
    anode = next(k for k, port in enumerate(model.ports) if port.kind == "electrical")
    compliance = model.gain[:, anode] ** 2 / (s**2 + s * model.damp + model.omega**2)
    charge = compliance.sum(axis=1) + model.D[anode, anode]
    impedance = 1 / np.abs(s[:, 0] * charge)
    for name, at in (("resonance", impedance.argmin()), ("antiresonance", impedance.argmax())):
        printed = re.findall(rf"(?m)^{name} (\S+) Hz, (\S+) Ohm", said)
        assert len(printed) == (1 if first == "ours" else 2)
        assert float(printed[0][0]) == pytest.approx(frequency[at], abs=STEP / 2)
        assert float(printed[0][1]) == pytest.approx(impedance[at], rel=1e-3)
