"""Page and figures of a verification: every solution, every gate, the paper's numbers."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from kc2spice.core.waveforms import Waveforms
from kc2spice.report.figures import draw_all
from kc2spice.report.paper import paper_section
from kc2spice.report.verdict import Findings
from kc2spice.report.verify_figures import comparison, responses
from kc2spice.report.verify_page import write_verify
from kc2spice.report.words import quantity
from kc2spice.scene.gates import Cost, Gate, Limit
from kc2spice.scene.load import load_scene
from kc2spice.workflow.verify.compare import (
    Solution,
    gate_limits,
    measured,
    metric_errors,
    output_errors,
)
from kc2spice.workflow.verify.verify import _shipped


def swing(error: float) -> Waveforms:
    t = np.linspace(0.0, 1e-3, 200)
    y = 1e-6 * np.sin(2e4 * t)
    return Waveforms({"time": t, "ball.y": y * (1 + error), "ball.force": 0.2 + 0 * t}, {})


def test_solutions_and_their_differences_are_drawn(tmp_path: Path) -> None:
    solutions = {"laws": swing(0.0), "netlist": swing(1e-4)}
    figures = list(comparison("scene", "swing", solutions, {"ball.y": "m", "ball.force": "N"}))
    assert [figure.name for figure in figures] == ["scene_solutions", "scene_differences"]
    worst = max(curve.y.max() for curve in figures[1].panels[0].curves)
    assert worst == pytest.approx(1e-4, rel=1e-6)
    for picture in draw_all(tmp_path, figures):
        assert picture.path.stat().st_size > 10_000


def test_responses_show_each_port_to_itself() -> None:
    f = np.linspace(1e3, 1e5, 50)
    waves = Waveforms({"frequency": f, "a>a": 1 / f, "a>b": 2 / f, "b>b": 3 / f}, {})
    (figure,) = responses("disc", {"netlist": waves})
    assert [panel.y for panel in figure.panels] == ["|a>a|", "|b>b|"]


@pytest.mark.parametrize(
    ("measure", "value"), [("travel", 5e-4), ("absolute", 1e-9), ("largest", 1e-3)]
)
def test_gates_measure_what_they_say(measure: str, value: float) -> None:
    ours, exact = Solution(swing(1e-3), {}), Solution(swing(0.0), {})
    found = measured(Gate("height", "ball.y", {}, measure), ours, exact)  # type: ignore[arg-type]
    assert found == pytest.approx(value, rel=1e-2)


def test_a_gate_that_one_solution_never_reaches_fails() -> None:
    gate = Gate("launch", "launch_velocity_m_s", {"ngspice_vs_rom": 1e-4}, leads=True)
    ours, exact = (Solution(swing(0.0), {"launch_velocity_m_s": v}) for v in (None, 1.0))
    (limit,), leading = gate_limits([gate], "ngspice_vs_rom", ours, exact)
    assert not limit.passed
    assert leading is None
    assert gate_limits([gate], "ngspice_vs_rom", ours, ours) == ([], None)


def test_small_metrics_are_judged_by_the_waves_of_their_unit() -> None:
    ours, exact = (Solution(swing(0.0), {"final_error_m": v}) for v in (2e-12, 1e-12))
    errors = dict(metric_errors(ours, exact, {"ball.y": "m"}))
    assert errors["final_error_m"] == pytest.approx(1e-3, rel=1e-2)


def test_errors_of_waves_are_of_both_solutions() -> None:
    found = {e.output: e for e in output_errors("ngspice_vs_rom", swing(1e-3), swing(0.0))}
    assert found["ball.y"].rms == pytest.approx(1e-3, rel=1e-6)
    assert found["ball.force"].largest == 0.0


def test_the_rms_of_an_error_is_over_time() -> None:
    """A quarter of the time is wrong by 1 %, with most of the points there; then a single point."""
    t = np.union1d(np.linspace(0.0, 0.25, 1001), np.linspace(0.25, 1.0, 101))
    exact = Waveforms({"time": t, "u": 1 + 0 * t}, {})
    wrong = Waveforms({"time": t, "u": 1 + 0.01 * (t <= 0.25)}, {})
    (found,) = output_errors("x", wrong, exact)
    assert found.rms == pytest.approx(0.005, rel=0.02)
    one, other = (Waveforms({"x": np.zeros(1), "u": np.array([v])}, {}) for v in (1.01, 1.0))
    assert output_errors("x", one, other)[0].rms == pytest.approx(0.01)


def test_page_shows_gates_costs_and_the_paper(tmp_path: Path) -> None:
    met = Limit("position error / travel", 3e-5, 1e-4)
    missed = Limit("separation time", 4e-8, 2e-8, "s")
    found = {
        "impact": Findings(
            checks=(met, missed),
            costs=(Cost("full model", 3.0), Cost("ngspice", 0.02, "full model", {"travel": 3e-5})),
            errors={"ngspice_vs_fom": 3e-5},
            speedup={"low_rank": 333.0},
            metrics={"separation_time_s": 9.92e-6, "full_wall_s": 3.0},
            notes=("Mesh error dominates.",),
            shipped=True,
        ),
        "imprint": Findings(checks=(met,), errors={}, speedup={}, costs=(), metrics={}),
    }
    text = write_verify(tmp_path / "verify.html", found).read_text(encoding="utf-8")
    for words in (
        "impact: gates", "impact: time and error", "impact: paper and here", "imprint: gates",
        "Mesh error dominates.", quantity(9.92e-6, "s"), "11 µs", "333",
    ):  # fmt: skip
        assert words in text, words
    assert text.count('class="bad"') == 2  # the gate, and the scene in the summary
    assert text.count('class="good"') == 3
    other = {"impact": replace(found["impact"], shipped=False)}
    text = write_verify(tmp_path / "other.html", other).read_text(encoding="utf-8")
    assert "paper and here" not in text


@pytest.mark.parametrize(
    ("name", "change", "shipped"),
    [
        ("impact", {}, True),
        ("impact", {"sphere.radius": 2e-3}, False),
        ({"name": "other", "kick": {}}, {}, False),
    ],
)
def test_only_the_papers_own_scene_is_set_beside_it(name, change, shipped) -> None:
    assert _shipped(load_scene(name, change)) is shipped


def test_paper_rows_need_our_value() -> None:
    assert paper_section("impact", {}).rows == []
    (row,) = paper_section("harmonic", {"unknowns": 16722}).rows
    assert row[2:4] == ("16 702", "16 722")


def response(low: float, high: float) -> Waveforms:
    """Two entries over 10 frequencies; the second is off by ``low`` at the first two, then by
    ``high``."""
    f = np.arange(1.0, 11.0)
    error = np.where(f <= 2.0, low, high)
    return Waveforms({"frequency": f, "a>a": 1.0 / f, "a>b": (1.0 + error) / f}, {})


@pytest.mark.parametrize(("share", "value"), [(1.0, 1e-3), (0.2, 1e-6)])
def test_a_share_of_the_scale_is_its_lowest(share: float, value: float) -> None:
    ours, exact = Solution(response(1e-6, 1e-3), {}), Solution(response(0.0, 0.0), {})
    gate = Gate("response", "*>*", {}, "spectral", share=share)
    assert measured(gate, ours, exact) == pytest.approx(value, rel=1e-6)


@pytest.mark.parametrize("wrong", ["catch.force.0", "catch.force.1", "catch.force.2"])
def test_a_gate_of_several_waves_looks_at_each(wrong: str) -> None:
    waves = {f"catch.force.{k}": np.linspace(0.0, k + 1.0, 5) for k in range(3)}
    exact = Waveforms({"y": np.arange(5.0)} | waves, {})
    ours = Waveforms(exact.data | {wrong: exact[wrong] + 0.03}, {})
    gate = Gate("force", "catch.force.*", {}, "largest")
    assert measured(gate, Solution(ours, {}), Solution(exact, {})) == pytest.approx(0.01)


@pytest.mark.parametrize("wrong", ["a>a", "a>b"])
def test_a_gate_of_a_response_looks_at_every_pair(wrong: str) -> None:
    exact = response(0.0, 0.0)
    ours = Waveforms(exact.data | {wrong: exact[wrong] * 1.01}, {})
    gate = Gate("response", "*>*", {}, "spectral")
    assert measured(gate, Solution(ours, {}), Solution(exact, {})) == pytest.approx(0.01)
