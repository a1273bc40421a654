"""Every committed library runs in ngspice with nothing beside it and ngspice's own options."""

import subprocess
from pathlib import Path

import pytest
from support import read_lib, read_raw

NETLISTS = Path(__file__).parents[2] / "netlists"
LIBRARIES = sorted(NETLISTS.glob("*/*.lib"))
REFERENCES = {"base", "ref", "ambient"}


@pytest.mark.parametrize("path", LIBRARIES, ids=lambda p: f"{p.parent.name}/{p.stem}")
def test_a_library_runs_without_kc2spice(path, tmp_path):
    """A volt, a micrometre or an ampere rises at the first pin; all pins end in a resistor."""
    cards = ["* alone", f".include {path}"]
    for part in read_lib(path):
        names = [pin.name for pin in part.pins]
        nodes = ["0" if name in REFERENCES else f"n{k}" for k, name in enumerate(names)]
        cards.append(f"X1 {' '.join(nodes)} {part.name}")
        cards += [f"R{k} {node} 0 1k" for k, node in enumerate(nodes) if node != "0"]
    cards += ["Idrive 0 n0 PULSE(0 1m 1u 1u 1u 5u)", ".tran 0.1u 10u", ".end"]
    (tmp_path / "alone.cir").write_text("\n".join(cards) + "\n")
    done = subprocess.run(
        ["ngspice", "-b", "-n", "-r", "alone.raw", "alone.cir"],
        cwd=tmp_path, capture_output=True, text=True, timeout=60, check=False,
    )  # fmt: skip
    said = done.stdout + done.stderr
    assert done.returncode == 0, said[-2000:]
    assert "warning" not in said.lower(), said[-2000:]
    waves = read_raw(tmp_path / "alone.raw")
    assert waves["time"][-1] == pytest.approx(1e-5)
    assert abs(waves["v(n0)"]).max() > 0.0
