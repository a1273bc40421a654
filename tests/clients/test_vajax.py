"""vajax compiles a Verilog-A module and runs it with fixed steps: a kick against the modes' sum."""

from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lsim
from support import format_module

CLIENT = Path(__file__).parent / "vajax_client.py"
STEP, STOP, VOLTS = 10e-9, 40e-6, 100.0
CIRCUIT = """a chip on a pulse
ground 0
model {name} {name}
model v vsource
model resistor resistor
x1 (anode 0 {rings} 0) {name}
v1 (anode 0) v type="pulse" val0=0 val1={volts} delay=1u rise=0.1u fall=0.1u width=24.9u period=1
{free}
control
  options tran_method="trap"
  analysis tran1 tran step=10n stop=40u
endc
"""


@pytest.mark.slow
def test_a_module_follows_a_pulse(deck_of, program, run, model, tmp_path):
    python = program("python-vajax")
    chip = deck_of("harmonic").parts[0]
    rings = [pin.name for pin in chip.pins if pin.name.startswith("ring")]
    ((file, text),) = format_module(chip).items()
    (tmp_path / file).write_text(text)
    free = "\n".join(f"r{ring} ({ring} 0) resistor r=1e12" for ring in rings)
    name, nodes = Path(file).stem, " ".join(rings)
    circuit = CIRCUIT.format(name=name, rings=nodes, free=free, volts=VOLTS)
    (tmp_path / "kick.sim").write_text(circuit)
    run([python, str(CLIENT), file, "kick.sim", str(STEP), str(STOP), "waves.npz"], tmp_path)
    with np.load(tmp_path / "waves.npz") as waves:
        time, found = waves["time"], waves["ring0"]
    time, first = np.unique(time, return_index=True)
    assert time[-1] == pytest.approx(STOP, rel=1e-2)
    exact = 1e6 * stroke(model, time)
    assert np.abs(found[first] - exact).max() < 1e-3 * exact.max()


def stroke(model, time):
    """Displacement [m] of the free ring 0 under the pulse: modes in scipy, exact."""
    names = [port.name for port in model.ports]
    ring, anode = names.index("ring0"), names.index("anode")
    grid = np.arange(0.0, time[-1] + 1e-9, 1e-9)
    drive = np.interp(grid, [0, 1e-6, 1.1e-6, 26e-6, 26.1e-6], [0, 0, VOLTS, VOLTS, 0])
    total = np.zeros(grid.size)
    for omega, damp, gain in zip(model.omega, model.damp, model.gain, strict=True):
        system = ([gain[ring] * gain[anode]], [1.0, damp, omega**2])
        total += lsim(system, drive, grid)[1]
    return np.interp(time, grid, total)
