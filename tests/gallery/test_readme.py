"""The commands that the README shows work as they stand."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

from kc2spice.report.html import quantity
from laboratory.page import bench_tables

ROOT = Path(__file__).parents[2]
BLOCKS = re.findall(r"```sh\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
LINES = [line for block in BLOCKS for line in block.splitlines()]
# NAME stands for the reader's own files.
COMMANDS = [c for c in LINES if c.startswith("kc2spice ") and "NAME" not in c]


def test_readme_shows_the_commands_of_its_table():
    assert len(COMMANDS) >= 5
    assert {"make demo", "make test"} <= {line.split("#")[0].strip() for line in LINES}


@pytest.mark.parametrize("command", COMMANDS)
def test_command_works(command, tmp_path):
    words = shlex.split(command, comments=True)[1:]
    done = subprocess.run(
        [sys.executable, "-m", "kc2spice", *words],
        cwd=tmp_path, capture_output=True, text=True, check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
    )  # fmt: skip
    assert done.returncode == 0, done.stderr


def test_pictures_are_there():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for picture in re.findall(r"!\[[^]]*\]\(([^)]+)\)", text):
        assert (ROOT / picture).stat().st_size > 5_000, picture


def test_speed_table_is_that_of_the_committed_benchmark():
    record = json.loads((ROOT / "docs" / "bench" / "bench.json").read_text(encoding="utf-8"))
    assert not record["quick"]
    assert (ROOT / "docs" / "bench" / "bench.md").read_text("utf-8") == bench_tables(record)
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"(?m)^\| `(\w+)` \|[^|]*\| ([^|]+) \| ([^|]+) \|", text)
    assert len(rows) >= 10
    for name, value, error in rows:
        ratio = record["ratios"][name]
        assert value == quantity(ratio["value"], ratio["unit"], 3), name
        assert error == ("–" if ratio["error"] is None else f"{ratio['error']:.1e}"), name
