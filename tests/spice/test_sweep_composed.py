"""Sweeps of a scene with files of its own."""

import shutil
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext

import numpy as np
import pytest
from scipy.io import mmwrite
from support import read_scene_text, sweep_execution
from sweeps import rows

OWN = """
name = "own"
[beam]
part = "matrices"
file = "beam.M.mtx"
sidecar = "beam.toml"
pins = { tip = "push.out" }
[push]
part = "source"
kind = "force"
file = "push.csv"
[solver]
stop = "2 ms"
max_step = "10 us"
[probes]
top = { of = "beam.u.tip", take = "max" }
"""


@pytest.fixture
def own(tmp_path):
    """A chain of three masses with its matrices, its ports and a force over time, in files."""
    home = tmp_path / "home"
    home.mkdir()
    (home / "own.toml").write_text(OWN)
    stiff = 1e4 * np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    arrays = {"M": 1e-3 * np.eye(3), "K": stiff, "E": 1e-5 * stiff, "B": np.eye(3)[:, 2:],
              "C": np.eye(3)[2:]}  # fmt: skip
    for name, array in arrays.items():
        mmwrite(home / f"beam.{name}.mtx", array)
    port = '[[ports]]\nname = "tip"\nkind = "mechanical"\ncolumn = 1\n'
    (home / "beam.toml").write_text(f'files = {{ K = "stiff.mtx" }}\n{port}')
    (home / "beam.K.mtx").rename(home / "stiff.mtx")
    (home / "push.csv").write_text("0,0\n1e-4,1\n1,1\n")
    return home


def test_files_of_the_parts_travel_with_the_sweep(own, tmp_path):
    path = str(own / "own.toml")
    names = {name for name, _ in read_scene_text(path).files}
    assert names == {"push.csv", "beam.toml", "stiff.mtx", *(f"beam.{x}.mtx" for x in "MEBC")}
    found = sweep_execution.make_sweep(read_scene_text(path), ("solver.reltol=1e-3,1e-4",))
    before = found.digest
    (own / "push.csv").write_text("0,0\n1e-4,2\n1,2\n")
    again = sweep_execution.make_sweep(read_scene_text(path), ("solver.reltol=1e-3,1e-4",))
    assert again.digest != before
    shutil.rmtree(own)  # as on another machine
    summary = sweep_execution.run_sweep(
        found, tmp_path / "o", lambda: nullcontext((ThreadPoolExecutor(1), 1))
    )
    assert summary["failed"] == 0
    # A step of 1 N within a fifth of the period: static 3e-4 m, overshoot below twice of it.
    assert all(3e-4 < float(row["top"]) < 6e-4 for row in rows(summary))
