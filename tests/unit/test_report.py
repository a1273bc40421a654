"""The run's figures and page from small synthetic waveforms: complete, self-contained, safe."""

from __future__ import annotations

import base64
import json
import re
import shutil
import struct
import subprocess
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from kc2spice.core.figure import Curve, Figure, Panel
from kc2spice.core.waveforms import Waveforms
from kc2spice.report.figures import draw_all
from kc2spice.report.html import SHOWN, Section, _thinned, write_page
from kc2spice.report.plots import open_sheet, plain_log
from kc2spice.report.run_page import write_run
from kc2spice.report.words import fact, quantity
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.workflow.judge import metrics


def loop_waves() -> Waveforms:
    """A caught sphere with the names of waveforms.npz, drawn by hand."""
    t = np.union1d(np.linspace(0, 5e-3, 500), np.linspace(4.9e-4, 6e-4, 400))
    s = np.maximum(0.0, t - 5.057e-4)
    y = 2.5e-3 - 1.5e-3 * np.exp(-s / 0.4e-3)
    load = 3.0 * np.clip((5.057e-4 - t) / 5e-6, 0.0, 1.0)
    data = {"time": t, "sphere.y": y, "sphere.v": np.gradient(y, t), "contact.force": load}
    data |= {f"contact.force.ring{i}": load * (i == 0) for i in range(6)}
    data |= {f"kick.u.ring{i}": 2e-6 * np.exp(-s / 5e-5) for i in range(6)}
    data |= {"kick.voltage": 100.0 * (s > 0), "kick.current": 0 * t, "control.error": 2.5e-3 - y}
    data |= {"coil.upper.current": 0.1 * np.exp(-s / 1e-4)}
    return Waveforms(data | {"coil.lower.current": -data["coil.upper.current"]}, {})


def figures(waves: Waveforms) -> tuple[Figure, ...]:
    """One of two panels with all that a panel may have, one of a single line over a log axis."""
    t, y = waves["time"], waves["sphere.y"]
    whole = Curve("ngspice", 1e3 * t, 1e3 * y)
    exact = Curve("scipy", 1e3 * t, 1e3 * y, "reference")
    top = Panel(
        "", "height [mm]", (whole, exact), levels=((2.5, "set point"),),
        bands=((2.425, 2.575, "settling band"),), marks=((0.507, "launch"),), span=(0.0, 5.0),
    )  # fmt: skip
    rings = tuple(
        Curve(f"ring{k}", 1e3 * t, 1e6 * waves[f"kick.u.ring{k}"] + 0.01 * k) for k in range(6)
    )
    bottom = Panel("time [ms]", "displacement [um]", rings)
    response = Panel(
        "frequency [Hz]", "height [mm]", (Curve("", 1 + t, y),), log_x=True, log_y=True
    )
    return (
        Figure("trajectory", "Trajectory", "Above and below.", (top, bottom)),
        Figure("response", "Response", "One line.", (response,)),
    )


def png_size(path: Path) -> tuple[int, int]:
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", head[16:24])


class Page(HTMLParser):
    """Collects headings, image sources and every address that a browser would load."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.headings: list[str] = []
        self.sources: list[str] = []
        self.cells: list[str] = []
        self.text = text
        self._open = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self._open = tag
        self.sources += [value or "" for name, value in attrs if name in ("src", "href")]

    def handle_data(self, data: str) -> None:
        if self._open == "h2" and data.strip():
            self.headings.append(data)
        if self._open == "td" and data.strip():
            self.cells.append(data)


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Page:
    out = tmp_path_factory.mktemp("report")
    waves, scene = loop_waves(), load_scene("kick_and_catch", [])
    pictures = draw_all(out, figures(waves))
    assert [p.path.stem for p in pictures] == ["trajectory", "response"]
    for picture in pictures:
        width, height = png_size(picture.path)
        assert width >= 1000  # 7 inches at 150 dots
        assert height >= 450
        assert picture.path.stat().st_size > 10_000  # an empty sheet is smaller
    result = {
        "metrics": metrics(waves, Build(scene, {})),
        "wall_s": {"mesh": 1.5, "simulate": 0.5},
        "simulator": {"name": "ngspice", "version": "39", "engine": "<batch>"},
        "steps": {"accepted": 1234, "rejected": 5},
        "rom": {
            "order": 30,
            "ports": ["ring0", "anode"],
            "band_hz": [0, 5e5],
            "error_estimate": 1e-3,
        },
        "model": {"kick": {"unknowns": 16722}, "catch": {"coil_resistance_ohm": 1596.0}},
        "files": ["kick.lib"],
    }
    found = {figure.name: figure for figure in figures(waves)}
    pictures = [replace(picture, figure=found[picture.path.stem]) for picture in pictures]
    path = write_run(out / "report.html", result, scene, pictures)
    return Page(path.read_text(encoding="utf-8"))


def test_page_has_all_sections(page: Page) -> None:
    assert page.headings == [
        "Device", "Circuit", "Figures", "Metrics", "Model: kick", "Model: catch", "Reduced model",
        "What is modelled", "Expected errors", "What is left out", "Simulator", "Wall time",
        "Files",
    ]  # fmt: skip


def test_page_loads_nothing_from_elsewhere_and_links_its_files(page: Page) -> None:
    pictures = [source for source in page.sources if source.startswith("data:image/png;base64,")]
    assert len(pictures) == 2
    assert [source for source in page.sources if source not in pictures] == ["kick.lib"]
    assert "http" not in page.text.replace("http://www.w3.org/2000/svg", "")


def test_sketch_names_every_part_and_net(page: Page) -> None:
    scene = load_scene("kick_and_catch")
    for net in {n for (_, _), n in scene.nets.items()} - {"0"}:
        joined = [key for key, other in scene.nets.items() if other == net]
        assert (f">{net}<" in page.text) == (len(joined) > 1)
    assert all(f">{name}<" in page.text for name in scene.parts)
    assert "sphere: radius 1 mm" in page.text
    circle = re.search(r'<circle cx="[\d.]+" cy="[\d.]+" r="([\d.]+)" fill="#D9D9D9"', page.text)
    chip = re.search(
        r'<rect x="[-\d.]+" y="[-\d.]+" width="([\d.]+)"[^>]* fill="#F3D9A4"', page.text
    )
    assert 2 * float(circle[1]) / float(chip[1]) == pytest.approx(2 / 3, rel=1e-2)  # mm over mm


def test_curves_in_the_page_are_those_of_the_figure() -> None:
    t = np.union1d(np.linspace(0, 1, 50_000), 0.5 + np.linspace(0, 1e-6, 100))
    y = np.where(np.abs(t - 0.5) < 1e-6, 1.0, 0.0) + 1e-3 * np.sin(40 * t)
    y[1234] = -3.0
    thin = _thinned(Curve("", t, y))
    x, v = (np.frombuffer(base64.b64decode(thin[k]), "<f4") for k in "xy")
    assert x.size <= SHOWN
    assert (v.min(), x[v.argmin()]) == (np.float32(-3), np.float32(t[1234]))
    away = np.abs(t - 0.5) > 5e-5  # the jumps themselves have no width in float32
    assert np.abs(np.interp(t, x, v) - y)[away].max() < 2e-3


@pytest.mark.skipif(shutil.which("node") is None, reason="needs node")
def test_the_script_draws_and_zooms(page: Page, tmp_path: Path) -> None:
    """Run by a JavaScript engine against the few parts of a browser that it uses."""
    (tmp_path / "page.html").write_text(page.text, encoding="utf-8")
    browser = Path(__file__).parents[1] / "data" / "browser.js"
    done = subprocess.run(["node", str(browser), str(tmp_path / "page.html")],
                          capture_output=True, text=True, check=False)  # fmt: skip
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["panels"] == 3
    assert found["strokes"] > 30
    assert found["images"] == 0  # the canvas stands in for the picture
    assert found["labels"][:2] == ["ngspice", "scipy"]
    assert "2.5" in found["read"]
    assert found["zoomed"] < 0.6 * found["whole"]
    assert found["reset"] == found["whole"]


def test_page_shows_the_numbers_and_escapes_words(page: Page) -> None:
    assert "16 722" in page.cells
    assert "1.596 kΩ" in page.cells
    assert "<batch>" in page.cells  # arrived as text, not as a tag
    assert "yes" in page.cells


def test_markup_in_a_title_stays_text(tmp_path: Path) -> None:
    path = write_page(tmp_path / "x.html", "<script>a()</script>", "", [Section("s", [("&",)])])
    assert "<script>" not in path.read_text(encoding="utf-8")


def test_a_run_without_catch_says_nothing_of_one() -> None:
    scene = load_scene({"kick": {}, "contact": {}, "sphere": {}})
    waves = loop_waves()
    kept = {k: v for k, v in waves.data.items() if not k.startswith(("coil", "control"))}
    found = metrics(Waveforms(kept, {}), Build(scene, {}))
    assert "launch_velocity_m_s" in found
    assert "caught" not in found


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (5.0573e-4, "s", "505.73 µs"),
        (-3.112e-6, "m", "−3.112 µm"),
        (143.19e-9, "F", "143.19 nF"),
        (1.386e-4, "kg", "138.6 mg"),
        (0.0, "s", "0 s"),
        (None, "s", "—"),
        (1e-20, "N", "1e-20 N"),
        (-2.5e12, "Hz", "−2.5e+12 Hz"),
        (1.057e-3, "", "0.001057"),
    ],
)
def test_quantities_carry_prefixes(value: float | None, unit: str, text: str) -> None:
    assert quantity(value, unit) == text


@pytest.mark.parametrize(
    ("key", "value", "shown"),
    [
        ("launch_velocity_m_s", 1.02, ("launch velocity", "1.02 m/s")),
        ("hold_current_a", 4.9e-4, ("hold current", "490 µA")),
        ("settling_time_s", None, ("settling time", "not reached")),
        ("free_stroke_m_per_100v", 2.35e-6, ("free stroke", "2.35 µm per 100 V")),
        ("free_stroke_m_per_v", 2.35e-8, ("free stroke", "23.5 nm/V")),
        ("kick_charge_peak_c", 1.4e-5, ("kick charge peak", "14 µC")),
        ("band_hz", [0, 5e5], ("band", "0 Hz, 500 kHz")),
        ("caught", True, ("caught", "yes")),
        ("bvd_c0_f", 1e-9, ("equivalent circuit C0", "1 nF")),
        ("force_n", [1.0] * 9, ("force", "9 values, in result.json")),
    ],
)
def test_facts_take_their_unit_from_the_key(key: str, value: object, shown: tuple) -> None:
    assert fact(key, value) == shown


@pytest.mark.parametrize(
    ("low", "high", "labels"),
    [(1.5, 520.0, ["2", "5", "10", "20", "50", "100", "200", "500"]),
     (0.5e-3, 2e4, ["0.001", "0.01", "0.1", "1", "10", "100", "1000", "10000"])],
)  # fmt: skip
def test_logarithmic_axes_have_plain_numbers(low, high, labels):
    axes = open_sheet((7.0, 4.0)).subplots()
    axes.set(xscale="log")
    axes.plot([low, high], [0.0, 1.0])
    axes.set_xlim(low, high)
    plain_log(axes.xaxis)
    axes.figure.draw_without_rendering()
    ticks = axes.get_xticks()
    shown = [axes.xaxis.get_major_formatter()(t) for t in ticks if low <= t <= high]
    assert shown == labels
    assert not axes.get_xticks(minor=True).size
