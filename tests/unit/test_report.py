"""The run's figures and page from small synthetic waveforms: complete, self-contained, safe."""

import base64
import json
import math
import re
import struct
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from support import (
    BuiltScene,
    Check,
    Curve,
    Figure,
    PageSection,
    Panel,
    Waveforms,
    add_results_and_sources,
    compute_metrics,
    describe_plan,
    format_operating_point,
    format_percent,
    format_quantity,
    format_results,
    format_summary,
    format_value_and_limit,
    load_scene,
    remove_unit_words,
    render_figure,
    write_page,
    write_pngs,
    write_run,
)

TEMPLATES = Path(__file__).parents[2] / "templates"


def test_a_limit_has_the_unit_and_the_prefix_of_its_value() -> None:
    assert format_value_and_limit(4.06e5, 5e5, "Hz") == ("406 kHz", "500 kHz")
    assert format_value_and_limit(2.23e-5, 1e-3, "of its swing") == (
        "0.00223 % of its swing", "0.1 %",
    )  # fmt: skip
    assert format_value_and_limit(1.24e-3, 0.03, "relative, estimated") == (
        "0.124 %, estimated", "3 %",
    )  # fmt: skip
    assert format_value_and_limit(0.0, 1e-8, "m") == ("0 nm", "10 nm")
    assert format_value_and_limit(1.56e-5, 4.89e-3, "A2 s") == ("15.6 µs·A²", "4.89 ms·A²")


def test_a_rounding_error_prints_0() -> None:
    assert format_value_and_limit(2.84e-14, 1e-3, "of its swing")[0] == "0 % of its swing"
    assert format_value_and_limit(1e-15, 0.5, "V")[0] == "0 mV"
    assert format_value_and_limit(1e-9, 0.5, "V")[0] == "1 nV"
    point = {"a.i": (2.0, "A"), "b.i": (3e-13, "A"), "c.v": (3e-13, "V")}
    result = {"operating_point": {n: {"value": v, "unit": u} for n, (v, u) in point.items()}}
    assert format_operating_point(result) == [("a.i", "2 A"), ("c.v", "300 fV")]


def test_a_table_has_no_rows_of_numbers() -> None:
    metrics = {"peaks_m": [1.0, 2.0, 3.0], "band_hz": [1.0, 2.0], "first_m": 1.0}
    rows = format_summary({"metrics": metrics}).rows
    assert [name for name, _ in rows] == ["checks", "band", "first m"]


def test_two_keys_of_one_label_name_their_quantities() -> None:
    metrics = {"disc_turn_s": 0.0774, "disc_turn_m": 0.0193}
    result = {"metrics": metrics, "metric_units": {"disc_turn_s": "s", "disc_turn_m": "m"}}
    expected = [("disc turn, time", "77.4 ms"), ("disc turn, position", "19.3 mm")]
    assert format_summary(result).rows[1:] == expected


def test_a_small_share_is_printed_as_an_upper_bound() -> None:
    assert format_percent(3.56e-12) == "< 0.001 %"
    assert format_percent(1e-5) == "0.001 %"
    assert format_percent(0.16598, 2) == "17 %"
    unit = "of the energy exchanged"
    assert format_value_and_limit(7.55e-7, 1e-4, unit) == (f"< 0.001 % {unit}", "0.01 %")
    # a limit below 0.001 % needs the number
    assert format_value_and_limit(7.55e-7, 1e-6, "relative") == ("7.55e-05 %", "0.0001 %")


def test_a_limit_of_four_digits_has_its_own_prefix() -> None:
    assert format_value_and_limit(4.07e-8, 1.251e-6, "m") == ("40.7 nm", "1.25 µm")
    assert format_value_and_limit(1.81e-3, 0.12, "V") == ("1.81 mV", "120 mV")
    assert format_value_and_limit(1e9, 3.88e6, "Hz") == ("1 GHz", "3.88 MHz")
    assert format_value_and_limit(math.inf, 3.88e6, "Hz") == ("inf Hz", "3.88 MHz")


@pytest.mark.parametrize(
    ("unit", "bare"),
    [("of its swing", "relative"), ("relative, estimated", "relative"), ("V beyond", "V"),
     ("contact events", ""), ("1", ""), ("A2 s", "A2 s"), ("m per 100 V", "m per 100 V"),
     ("m/s", "m/s"), ("", "")],
)  # fmt: skip
def test_words_of_a_unit_are_not_in_tables(unit, bare) -> None:
    assert remove_unit_words(unit) == bare


@pytest.mark.parametrize(
    ("name", "label", "printed"),
    [
        ("energy of kick", "energy balance of kick", "energy balance of kick"),
        ("touches", "contact events", "contact events"),
        ("usual range of a_b", "", "usual range of a_b"),
        ("my_check", "", "my check"),
    ],
)
def test_a_check_is_printed_with_its_label(name, label, printed) -> None:
    check = Check(name, 2.0, 1.0, "V", "lower it", label=label)
    assert check.violation == f"failed check: {printed}: 2 V, limit 1 V: lower it"
    record = check.make_record()
    assert (record["name"], record["label"]) == (name, printed)
    assert ("VIOLATED", f"{printed}: 2 V, limit 1 V") in format_summary({"checks": [record]}).rows
    del record["label"]  # a record of an earlier version
    assert ("VIOLATED", f"{name}: 2 V, limit 1 V") in format_summary({"checks": [record]}).rows


def make_check(name: str, value: float, **more) -> dict[str, object]:
    check = {"name": name, "value": value, "limit": 1.0, "unit": "V", "passed": value <= 1.0}
    return {**check, "action": "warn", **more}


def test_the_check_closest_to_its_limit_is_first() -> None:
    checks = [make_check("a", 0.5), make_check("b", 0.9, action="fail"), make_check("c", 2.0)]
    checks.append(make_check("d", 0.0, limit=0.0))
    (table,) = (s for s in format_results({"checks": checks}) if s.head[:2] == ("", "check"))
    assert [row[1] for row in table.rows] == ["c", "b", "a", "d"]
    assert [row[-1] for row in table.rows] == ["warning", "error", "warning", "warning"]
    assert [row[0] for row in table.rows] == ["VIOLATED", "ok", "ok", "ok"]
    assert table.head[-1] == "if exceeded"


def test_a_probe_states_its_kind_and_its_result() -> None:
    result = {
        "metrics": {"tip_swing_m": 2e-3, "efficiency": 0.04396, "bvd": {"c0_f": 1e-9}},
        "metric_units": {"tip_swing_m": "m", "bvd.c0_f": "F"},
        "probes": {"tip_swing_m": {"of": "beam.u.tip", "take": "peak_to_peak"}},
    }
    assert format_summary(result).rows[1:] == [
        ("tip swing", "2 mm, peak-to-peak of beam.u.tip"),
        ("efficiency", "4.4 %"),
        ("equivalent circuit C0", "1 nF"),
    ]


def test_labels_follow_the_english_word_order() -> None:
    units = {"force_max_n": "N", "area_face_m2": "m2"}
    facts = {"force_max_n": 1.0, "mesh_error_modes": 0.0106, "area_face_m2": 1.0, "unknowns": 434}
    sections = format_results({"model": {"disc": facts}, "model_units": {"disc": units}})
    assert {s.title: s.rows for s in sections}["Model: disc"] == [
        ("unknowns of the full model", "434"), ("largest force", "1 N"), ("area of face", "1 m²"),
        ("mesh error, worst of the lowest modes", "1.06 %"),
    ]  # fmt: skip


def test_a_warning_of_a_metric_replaces_its_row() -> None:
    result = {"metrics": {"still_rising": True, "on": True}}
    assert format_summary(result).rows[1:] == [
        ("sphere still rising at the end", "yes"),
        ("on", "yes"),
    ]
    result["metric_warnings"] = {"still_rising": "the heights are not final"}
    assert format_summary(result).rows[1:] == [
        ("WARNING", "the heights are not final"), ("on", "yes"),
    ]  # fmt: skip


def test_the_run_time_omits_stages_without_time() -> None:
    wall = {"mesh": 0.0, "assemble": 0.0, "simulate": 1.234}

    def list_stages(result) -> list[tuple[str, str]]:
        return {s.title: s.rows for s in format_results({**result, "wall_s": wall})}["Run time"]

    spent = [("simulate", "1.23 s"), ("total", "1.23 s")]
    assert list_stages({}) == spent
    assert list_stages({"model": {"disc": {}}}) == [("models", "from the cache"), *spent]
    wall["assemble"] = 1.0
    assert list_stages({"model": {"disc": {}}})[0] == ("assemble", "1.00 s")


def test_a_reduced_model_has_the_name_of_its_part() -> None:
    rom = {"order": 5, "massless": 0, "band_hz": [504.0, 16800.0], "error_estimate": 2.69e-4,
           "method": "difference from a model; details", "norm": "pointwise"}  # fmt: skip
    modes = {"disc": {"units": {}, "modes": []}}
    result = {"rom": rom, "modes": modes}
    tables = {s.title: s.rows for s in format_results(result)}
    assert tables["Reduced model: disc"] == [
        ("states", "5"), ("band", "504 Hz to 16.8 kHz"), ("error estimate", "0.0269 %"),
        ("error estimated as", "difference from a model"),
        ("error relative to",
         "the response at each frequency or 1e-6 of its peak, whichever is larger"),
    ]  # fmt: skip
    text = "5 states, error estimate 0.027 %, 504 Hz to 16.8 kHz"
    assert format_summary(result).rows[-1] == ("reduced model of disc", text)
    assert "Reduced model" in {s.title for s in format_results({"rom": rom})}
    both = {s.title for s in format_results({**result, "roms": {"a": rom, "b": rom}})}
    assert {"Reduced model: a", "Reduced model: b"} <= both


def test_areas_and_volumes_have_the_power_of_the_prefix():
    assert format_quantity(3.14159e-4, "m2") == "3.142 cm²"
    assert format_quantity(-5.38e-6, "m3/s") == "−5.38 cm³/s"
    assert format_quantity(10.1e-3, "m3") == "10.1 dm³"
    assert format_quantity(2e-10, "m3") == "0.2 mm³"
    assert format_value_and_limit(1e-4, 2e-4, "m2") == ("1 cm²", "2 cm²")


def test_words_get_no_prefix():
    assert format_quantity(-3.84e-6, "over the limit") == "-3.84e-06 over the limit"
    assert format_quantity(0.8, "mm") == "800 µm"
    assert format_quantity(50.0, "mm") == "50 mm"
    assert format_quantity(2.35e-6, "m per 100 V") == "2.35 µm per 100 V"


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
        "frequency [Hz]",
        "height [mm]",
        (Curve("", np.geomspace(0.1, 1e6, t.size), y),),
        log_x=True,
        log_y=True,
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
    found = compute_metrics(waves, add_results_and_sources(BuiltScene(scene, {})))
    result = {
        "metrics": found.values,
        "metric_units": found.units,
        "plan": describe_plan(BuiltScene(scene, {})),
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
        "model_units": {"catch": {"coil_resistance_ohm": "Ohm"}},
        "files": ["kick.lib"],
    }
    path = write_run(out / "report.html", result, scene, figures(waves))
    return Page(path.read_text(encoding="utf-8"))


def test_page_has_all_sections(page: Page) -> None:
    assert page.headings == [
        "Result", "Device", "Main result", "Circuit", "Further figures", "Model: kick",
        "Model: catch", "Reduced model", "Run time", "Parts", "Numerical settings",
        "Neglected effects", "Simulator",
        "Files",
    ]  # fmt: skip


def test_page_loads_nothing_from_elsewhere_and_links_its_files(page: Page) -> None:
    assert [source for source in page.sources if not source.startswith("#")] == ["kick.lib"]
    library = (TEMPLATES / "uplot" / "uPlot.iife.min.js").read_text(encoding="utf-8").rstrip()
    assert library in page.text
    known = page.text.replace(library, "").replace("http://www.w3.org/2000/svg", "")
    assert "http" not in known


def test_page_contains_the_licence_of_its_library(page: Page) -> None:
    """The MIT licence asks for it in every copy."""
    assert (TEMPLATES / "uplot" / "LICENSE").read_text(encoding="utf-8").strip() in page.text
    assert "MIT" in page.text


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


def shown(curve: Curve) -> tuple[np.ndarray, np.ndarray]:
    """The points of a curve that a page has."""
    html = render_figure(Figure("", "", "", (Panel("", "", (curve,)),)))
    data = json.loads(re.search(r"json\">(.*?)</script>", html)[1])["panels"][0]["curves"][0]
    x, y = (np.frombuffer(base64.b64decode(data[k]), "<f4") for k in "xy")
    return x, y


def test_a_panel_without_curves_is_left_out():
    """An operating point, for example, has no curve over time."""
    empty = Panel("x", "y", ())
    assert render_figure(Figure("nothing", "Nothing", "No curve.", (empty,))) == ""
    full = Panel("x", "y", (Curve("rise", np.arange(3.0), np.arange(3.0)),))
    both = render_figure(Figure("one", "One", "A curve.", (empty, full)))
    assert len(json.loads(re.search(r">({.*})</script>", both)[1])["panels"]) == 1


def test_a_peak_of_one_point_is_drawn_wherever_it_is() -> None:
    t = np.linspace(0.0, 1.0, 100_000)
    for place in (0, 1, 77_777, 99_998, 99_999):
        for height in (2.0, -2.0):
            y = np.sin(500 * t)
            y[place] = height
            assert np.float32(height) in shown(Curve("", t, y))[1]


def test_figures_as_files(tmp_path: Path) -> None:
    drawn = [replace(figure, columns=2) for figure in figures(loop_waves())]
    assert write_pngs(tmp_path, drawn) == ["trajectory.png", "response.png"]
    for name in ("trajectory.png", "response.png"):
        width, height = png_size(tmp_path / name)
        assert width >= 1000  # 7 inches at 150 dots
        assert height >= 400
        assert (tmp_path / name).stat().st_size > 10_000  # an empty sheet is smaller


def test_page_shows_the_numbers_and_escapes_words(page: Page) -> None:
    assert "16 722" in page.cells
    assert "1.596 kΩ" in page.cells
    assert "<batch>" in page.cells  # arrived as text, not as a tag
    assert "yes" in page.cells


BAD = "</script><script>a()</script><img src=x onerror=a()>"


def test_markup_in_a_title_stays_text(tmp_path: Path) -> None:
    path = write_page(tmp_path / "x.html", BAD, BAD, [PageSection(BAD, [("&",)], note=BAD)])
    assert "a()</script>" not in path.read_text(encoding="utf-8")
    assert "<img" not in path.read_text(encoding="utf-8")


def test_all_natural_frequencies_are_in_the_tables_of_the_terminal():
    mode = {"frequency_hz": 9816.0, "quality": 17.0, "couplings": {"anode": 0.3}}
    modes = {"disc": {"units": {"anode": ""}, "modes": [{**mode, "frequency_hz": 3340.0}, mode]}}
    tables = {section.title: section for section in format_results({"modes": modes})}
    assert [row[0] for row in tables["Modes: disc"].rows] == ["3.34 kHz", "9.816 kHz"]


def test_the_columns_of_modes_state_the_quantity() -> None:
    """At 1 / (2 pi) Hz, the effective mass equals the static response to an acceleration."""
    couplings = {"face": 7.03e-15, "tip": 8.41e-4, "base": 0.0165, "anode": 0.326}
    units = {"face": "m3/Pa", "tip": "m/N", "base": "kg s2", "anode": ""}
    mode = {"frequency_hz": 1 / (2 * math.pi), "quality": 18.5, "couplings": couplings}
    (table,) = (
        section
        for section in format_results({"modes": {"beam": {"units": units, "modes": [mode]}}})
        if section.title == "Modes: beam"
    )
    assert dict(zip(table.head[2:], table.rows[0][2:], strict=True)) == {
        "compliance at face": "7.03e-15 m³/Pa", "compliance at tip": "841 µm/N",
        "effective mass at base": "16.5 g", "coupling factor of anode": "0.326",
    }  # fmt: skip


def test_the_uncertainty_of_a_level_has_a_sign_and_two_digits() -> None:
    result = {"metrics": {"level_error_db": 7.088}, "metric_units": {"level_error_db": "dB"}}
    text = "±7.1 dB, root sum of squares, without the baffle row"
    assert format_summary(result).rows[1:] == [("uncertainty of the level", text)]


def test_a_ratio_that_is_a_rounding_error_is_zero() -> None:
    assert format_value_and_limit(5e-16, 1e-11, "relative") == ("0 %", "1e-09 %")
    assert format_value_and_limit(1.2e-10, 5e-9, "relative") == ("1.2e-08 %", "5e-07 %")


def test_a_run_without_checks_does_not_read_like_a_failure():
    """0 passed would read like a failure."""
    assert format_summary({"checks": []}).rows[0] == ("checks", "no check applies to this run")
