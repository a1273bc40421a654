"""PySpice and its fork InSpice read our libraries, beside our own use of libngspice."""

import importlib.util
import re
import sys
from pathlib import Path

import numpy as np
import pytest

HERE = Path(__file__).parent
EXAMPLE = HERE.parents[1] / "docs" / "examples" / "impedance_library.py"
CLIENT = HERE / "python_client.py"
STEP = 1e3  # Hz, of the example's sweep


@pytest.fixture
def interpreter(client, program):
    """A Python that has the client; InSpice needs 3.12."""
    return sys.executable if importlib.util.find_spec(client) else program(f"python-{client}")


@pytest.mark.parametrize("first", ["ours", "theirs"])
@pytest.mark.parametrize("client", ["PySpice", "InSpice"])
def test_impedance_from_a_library_beside_our_own_simulation(
    client, first, interpreter, deck_of, run, model, tmp_path
):
    (chip,) = deck_of("harmonic").parts
    (tmp_path / "kick.lib").write_text(chip.text)
    said = run([interpreter, str(CLIENT), first, str(EXAMPLE), client, "kick.lib"], tmp_path)
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
