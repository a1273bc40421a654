"""The commands that the README shows work as they stand."""

import json
import re
from pathlib import Path

import pytest
from commands import python, run_command
from support import format_quantity

from bench.page import bench_tables

ROOT = Path(__file__).parents[2]
RESULTS = (ROOT / "docs" / "evidence" / "results.md").read_text(encoding="utf-8")
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_readme_shows_the_two_commands_of_a_fresh_clone():
    lines = {line.split("#")[0].strip() for line in README.splitlines()}
    assert {"make demo", "make test"} <= lines


def test_readme_is_short():
    assert len(README.splitlines()) < 145


PAGES = ["docs/reference/matrices.md"]


@pytest.mark.parametrize("page", PAGES)
def test_python_blocks_run(page, tmp_path):
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert blocks
    (tmp_path / "block.py").write_text("\n".join(blocks), encoding="utf-8")
    python(tmp_path, "block.py")


def test_numbers_of_the_main_job_are_those_of_a_run(tmp_path):
    result = run_command("run", "kick_and_catch", "-o", tmp_path / "out", "--json")
    metrics, chip = result["metrics"], result["model"]["kick"]
    cells = dict(re.findall(r"(?m)^\| ([^|\n]+) \| ([^|\n]+) \|[^|\n]*\|$", RESULTS))
    stroke = 1e6 * chip["free_stroke_ring0_m_per_100v"]
    wanted = {
        "free stroke at 100 V (data sheet 2.2 µm)": f"{stroke:.3f} µm",
        "inside ±5 % of the step from": f"{1e3 * metrics['settling_time_s']:.2f} ms",
        "distance from the set point at 5 ms": f"{1e9 * abs(metrics['final_error_m']):.0f} nm",
        "coil current that holds the sphere": f"{1e3 * metrics['hold_current_a']:.2f} mA",
        "launch velocity": f"{metrics['launch_velocity_m_s']:.3f} m/s",
    }
    assert {name: cells.get(name) for name in wanted} == wanted


def test_pictures_are_there():
    for picture in re.findall(r"!\[[^]]*\]\(([^)]+)\)", README):
        assert (ROOT / picture).stat().st_size > 500, picture


def test_speed_table_is_that_of_the_committed_benchmark():
    record = json.loads(
        (ROOT / "docs" / "evidence" / "bench" / "bench.json").read_text(encoding="utf-8")
    )
    assert not record["quick"]
    assert (ROOT / "docs" / "evidence" / "bench" / "bench.md").read_text("utf-8") == bench_tables(
        record
    )
    speed = RESULTS.split("## Speed")[1]
    rows = re.findall(r"(?m)^\| `(\w+)` \|[^|]*\| ([^|]+) \|[^|]*\| ([^|]*) \|$", speed)
    assert {name for name, _, _ in rows} == set(record["ratios"])
    for name, value, error in rows:
        ratio = record["ratios"][name]
        assert value == format_quantity(ratio["value"], ratio["unit"], 3), name
        expected = "" if ratio["error"] is None else f"{ratio['error']:.0e}"
        assert error == ("< 1e-12" if 0 < (ratio["error"] or 0) < 1e-12 else expected), name
