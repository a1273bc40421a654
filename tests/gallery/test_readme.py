"""The commands that the README shows work as they stand."""

import json
import re
import shlex
from pathlib import Path

import pytest
from commands import asked, python, typed

from kc2spice.report.html import quantity
from laboratory.page import bench_tables

ROOT = Path(__file__).parents[2]
RESULTS = (ROOT / "docs" / "evidence" / "results.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"```sh\n(.*?)```", (ROOT / "README.md").read_text(encoding="utf-8"), re.DOTALL)
LINES = [line for block in BLOCKS for line in block.splitlines()]
# NAME stands for the reader's own files.
COMMANDS = [c for c in LINES if c.startswith("kc2spice ") and "NAME" not in c]


def test_readme_shows_the_commands_of_its_table():
    assert len(COMMANDS) >= 5
    assert {"make demo", "make test"} <= {line.split("#")[0].strip() for line in LINES}


def test_commands_work_in_their_order(tmp_path):
    """In one directory, as a reader has: some use files of others."""
    typed(tmp_path, [shlex.split(command, comments=True)[1:] for command in COMMANDS])


PAGES = ["README.md", "docs/tutorials/matrices_from_scikit_fem.md", "docs/reference/matrices.md"]


@pytest.mark.parametrize("page", PAGES)
def test_python_blocks_run(page, tmp_path):
    text = (ROOT / page).read_text(encoding="utf-8")
    blocks = re.findall(r"```python\n(.*?)```", text, re.DOTALL)
    assert blocks
    (tmp_path / "block.py").write_text("\n".join(blocks), encoding="utf-8")
    python(tmp_path, "block.py")


def test_buzzer_of_the_journey_runs(tmp_path):
    page = (ROOT / "docs" / "tutorials" / "first_buzzer.md").read_text(encoding="utf-8")
    scene, probes = re.findall(r"```toml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "buzzer.toml").write_text(scene + probes, encoding="utf-8")
    metrics = asked("run", tmp_path / "buzzer.toml", "-o", tmp_path / "out", "--json")["metrics"]
    assert metrics["resonance_hz"] == pytest.approx(6300, rel=0.1)
    assert "peak_a" in metrics


def test_numbers_of_the_main_job_are_those_of_a_run(tmp_path):
    result = asked("run", "kick_and_catch", "-o", tmp_path / "out", "--json")
    metrics, chip = result["metrics"], result["model"]["kick"]
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    for shown in (f"{metrics['launch_velocity_m_s']:.2f} m/s",
                  f"{1e3 * metrics['settling_time_s']:.2f} ms",
                  f"{chip['unknowns']:,} equations".replace(",", " ")):  # fmt: skip
        assert shown in readme, shown
    cells = dict(re.findall(r"(?m)^\| ([^|\n]+) \| ([^|\n]+) \|[^|\n]*\|$", RESULTS))
    stroke = 1e6 * chip["free_stroke_ring0_m_per_100v"]
    wanted = {
        "free stroke at 100 V (data sheet 2.2 µm)": f"{stroke:.3f} µm",
        "inside ±5 % of the step from": f"{1e3 * metrics['settling_time_s']:.2f} ms on",
        "position at 5 ms, above the set point": f"{1e9 * abs(metrics['final_error_m']):.0f} nm",
        "coil current that holds the sphere": f"{1e3 * metrics['hold_current_a']:.2f} mA",
        "launch velocity, 5.7 µs after the kick begins":
            f"{metrics['launch_velocity_m_s']:.3f} m/s",
    }  # fmt: skip
    assert {name: cells.get(name) for name in wanted} == wanted


def test_pictures_are_there():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    for picture in re.findall(r"!\[[^]]*\]\(([^)]+)\)", text):
        assert (ROOT / picture).stat().st_size > 3_000, picture


def test_speed_table_is_that_of_the_committed_benchmark():
    record = json.loads(
        (ROOT / "docs" / "evidence" / "bench" / "bench.json").read_text(encoding="utf-8")
    )
    assert not record["quick"]
    assert (ROOT / "docs" / "evidence" / "bench" / "bench.md").read_text("utf-8") == bench_tables(
        record
    )
    rows = re.findall(r"(?m)^\| `(\w+)` \|[^|]*\| ([^|]+) \| ([^|]+) \|$", RESULTS)
    assert len(rows) >= 10
    for name, value, error in rows:
        ratio = record["ratios"][name]
        assert value == quantity(ratio["value"], ratio["unit"], 3), name
        assert error == ("–" if ratio["error"] is None else f"{ratio['error']:.1e}"), name
