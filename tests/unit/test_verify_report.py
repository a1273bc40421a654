"""Figures and page of a verification: every road, every gate, the paper's numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from kc2spice.core.waveforms import Waveforms
from kc2spice.report import verify_figures as figures
from kc2spice.report.figures import run_figures
from kc2spice.report.html import quantity
from kc2spice.report.paper import paper_section
from kc2spice.report.verdict import Check, Findings, Road
from kc2spice.report.verify_page import write_verify
from kc2spice.scene.load import load_scene

NAMES = ["R0", "R1", "anode"]


def harmonic(error: float) -> Waveforms:
    f = np.linspace(2.5e3, 5e5, 40)
    h = 1.0 / (1.0 - (f / 2.7e5) ** 2 + 0.02j) * (1.0 + error * f / 5e5)
    return Waveforms({"frequency": f} | {f"{a}>{b}": h for a in NAMES for b in NAMES}, {})


def imprint(error: float) -> Waveforms:
    depth = np.linspace(0.0, 50e-6, 51)
    rings = {f"contact.force.R{k}": 4e6 * np.maximum(0.0, depth - 1.9e-5 * k) for k in range(4)}
    total = sum(rings.values()) * (1.0 + error)
    return Waveforms({"imprint.depth": depth, "contact.force": total} | rings, {})


def impact(error: float) -> Waveforms:
    t = np.linspace(0.0, 15e-6, 200)
    w = np.pi / 9e-6
    touch = (t > 1e-6) & (t < 10e-6)
    y = np.where(touch, -np.sin(w * (t - 1e-6)) / w, np.abs(t - 5.5e-6) - 4.5e-6)
    y = 1e-3 + y * (1.0 + error)
    data = {"time": t, "sphere.y": y, "sphere.v": np.gradient(y, t)}
    return Waveforms(data | {"contact.force": np.where(touch, 1.0, 0.0)}, {})


def roads(make: Any) -> dict[str, Waveforms]:
    return {"full model": make(0.0), "reduced model": make(1e-5), "ngspice": make(2e-5)}


def test_pair_error_is_relative() -> None:
    error = figures.pair_error(harmonic(1e-3), harmonic(0.0), "R0>anode")
    f = harmonic(0.0)["frequency"]
    assert error == pytest.approx(1e-3 * f / 5e5, rel=1e-9)
    assert figures.ports(harmonic(0.0)) == NAMES


def test_every_comparison_is_drawn(tmp_path: Path) -> None:
    pictures = [
        *figures.harmonic_figures(tmp_path, roads(harmonic)),
        *figures.imprint_figures(tmp_path, roads(imprint)),
        *figures.impact_figures(tmp_path, roads(impact), 1e-3),
    ]
    assert [p.path.name for p in pictures] == [
        "harmonic_response.png", "harmonic_error_reduced_model.png", "harmonic_error_ngspice.png",
        "imprint.png", "impact.png",
    ]  # fmt: skip
    for picture in pictures:
        assert picture.path.stat().st_size > 10_000


@pytest.mark.parametrize(
    ("scene", "make"), [("harmonic", harmonic), ("imprint", imprint), ("impact", impact)]
)
def test_a_single_run_is_drawn_alone(tmp_path: Path, scene: str, make: Any) -> None:
    (picture,) = run_figures(tmp_path, load_scene(scene, []), make(0.0))
    assert picture.path.stat().st_size > 10_000


def test_rings_close_where_their_force_begins() -> None:
    # R3 would close at 57 um, which is deeper than the push.
    assert figures._activations(imprint(0.0)) == pytest.approx([20e-6, 39e-6])


def test_page_shows_gates_roads_and_the_paper(tmp_path: Path) -> None:
    met = Check("position error / travel", 3e-5, 1e-4)
    missed = Check("separation time", 4e-8, 2e-8, "s")
    found = {
        "impact": Findings(
            checks=(met, missed),
            roads=(Road("full model", 3.0), Road("ngspice", 0.02, "full model", {"travel": 3e-5})),
            errors={"ngspice_vs_fom": 3e-5},
            speedup={"low_rank": 333.0},
            metrics={"separation_time_s": 9.92e-6, "full_wall_s": 3.0},
            notes=("Mesh error dominates.",),
        ),
        "imprint": Findings(checks=(met,), errors={}, speedup={}, roads=(), metrics={}),
    }
    text = write_verify(tmp_path / "verify.html", found).read_text(encoding="utf-8")
    for words in (
        "impact: gates", "impact: time and error", "impact: paper and here", "imprint: gates",
        "Mesh error dominates.", quantity(9.92e-6, "s"), "11 µs", "10.675 ks", "333",
    ):  # fmt: skip
        assert words in text, words
    assert text.count('class="bad"') == 2  # the gate, and the scene in the summary
    assert text.count('class="good"') == 3


def test_paper_rows_need_our_value() -> None:
    assert paper_section("impact", {}).rows == []
    (row,) = paper_section("harmonic", {"unknowns": 16722}).rows
    assert row[2:4] == ("16 702", "16 722")
