"""Scenes of a user's own, from one TOML file to run, sweep and verify, by the command line."""

from pathlib import Path

import numpy as np
import pytest
from commands import run_command
from kicked import kicked

ROOT = Path(__file__).parents[2]
TWO_STACKS = ROOT / "docs" / "examples" / "two_stacks.toml"


@pytest.mark.slow  # 20 s of the independent integrator for the two stacks
@pytest.mark.parametrize(
    ("write", "swept", "metric"),
    [
        (lambda folder: TWO_STACKS, "bridge.resistance=2:20:3", "large_top"),
        (kicked, "push.pulse.high=0.2:0.3:3", "launch_velocity_m_s"),
    ],
    ids=["two stacks on one half-bridge", "mass on a spring kicked by matrices"],
)
def test_a_scene_from_scratch_runs_sweeps_and_verifies(write, swept, metric, tmp_path):
    scene = str(write(tmp_path))
    run = run_command("run", scene, "--out", tmp_path / "run", "--json")
    assert run["metrics"][metric] > 0
    sweep = run_command("sweep", scene, "--set", swept, "--out", tmp_path / "sweep", "--json")
    assert (sweep["points"], sweep["failed"]) == (3, 0)
    rows = np.genfromtxt(tmp_path / sweep["table"], delimiter=",", names=True)
    assert np.ptp(rows[metric]) > 0.05 * rows[metric].max()
    verified = run_command("verify", scene, "--out", tmp_path / "verify", "--json")
    assert verified["passed"]
    names = [check["name"] for check in verified["checks"]]
    assert any(name.startswith("every wave") for name in names)
    assert any("netlist versus ROM" in name for name in names)
    if write is kicked:
        # all six states integrated with located events: 0.08364828 m/s, four of them 0.08358288 m/s
        assert verified["errors"]["rom_vs_fom"] == pytest.approx(7.82e-4, rel=0.01)
        assert {"energy of beam, ngspice", "energy of contact, ngspice"} <= set(names)
        assert any(name.startswith("every metric") for name in names)
