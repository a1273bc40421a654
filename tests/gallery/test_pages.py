"""Pages in a real browser: every curve is drawn and read, legends and zoom work, nothing overflows.

The browser is Chromium of this machine or of ``tools/clients.sh``, driven by playwright.
"""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest
from commands import run_command
from support import ColourMap, Curve, Figure, PageSection, Panel, write_page

# A response, a sweep there and back, noise, an impact, a waveform of many cycles.
RUNS = {
    "buzzer_7bb_20_6": (),
    "plate_pull_in": (),
    "buzzer_noise": (),
    "impact": (),
    "buzzer_square": ("--set", "disc.fields=true"),
}
DUFFING = ("sweep", "duffing", "--set", "mass.mass=2e-5:4e-5:3")
SWEEPS = {"curves": (), "map": ("--set", "spring.stiffness=80,100,140")}
NARROW, WIDE = 400, 1280
CACHE = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "kc2spice-clients"
CLIENTS = Path(os.environ.get("KC2SPICE_CLIENTS", CACHE))


def executable():
    own = CLIENTS / "bin" / "chromium"
    return shutil.which("chromium") or (str(own) if own.exists() else None)


@pytest.fixture(scope="module")
def browser():
    driver = pytest.importorskip("playwright.sync_api", reason="needs playwright")
    if executable() is None:
        pytest.skip("needs Chromium: the package of Debian, or that of tools/clients.sh")
    with driver.sync_playwright() as session:
        opened = session.chromium.launch(executable_path=executable(), args=["--no-sandbox"])
        yield opened
        opened.close()


PROBE = Path(__file__).parents[1] / "data" / "probe.js"
FEWEST = 25  # pixels of a curve


class Sheet:
    """An open page with its errors and with all that it loaded."""

    def __init__(self, browser, path, width=WIDE, scheme="light"):
        self.errors, self.loaded = [], []
        self.tab = browser.new_page(
            viewport={"width": width, "height": 900}, color_scheme=scheme, device_scale_factor=1
        )
        self.tab.on("console", lambda message: self.errors.append(message.text))
        self.tab.on("pageerror", lambda error: self.errors.append(str(error)))
        self.tab.on("request", lambda request: self.loaded.append(request.url))
        self.tab.add_init_script(path=PROBE)
        self.tab.goto(path.absolute().as_uri())
        self.tab.wait_for_timeout(100)

    def ask(self, name, *words):
        """An answer of the script PROBE."""
        return self.tab.evaluate("([name, words]) => probe[name](...words)", [name, words])

    def wait(self):
        self.tab.wait_for_timeout(60)

    def becomes(self, condition):
        """Whether it holds within five seconds; a busy machine draws late."""
        for _ in range(100):
            if condition():
                return True
            self.tab.wait_for_timeout(50)
        return False

    def area(self, k):
        """Centre and size of the plotting area of a chart, scrolled to."""
        over = self.tab.locator(".u-over").nth(k)
        over.scroll_into_view_if_needed()
        box = over.bounding_box()
        return box["x"], box["y"], box["width"], box["height"]

    def point(self, k, across, up=0.5):
        x, y, width, height = self.area(k)
        self.tab.mouse.move(x + across * width, y + (1 - up) * height)

    def drag(self, k, first, last):
        self.point(k, *first)
        self.tab.mouse.down()
        self.point(k, *last)
        self.tab.mouse.up()
        self.wait()


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """Page of each kind, made once."""
    made = {}

    def page(name):
        if name not in made:
            out = tmp_path_factory.mktemp(name)
            if name in SWEEPS:
                run_command(*DUFFING, *SWEEPS[name], "-o", out, "--json")
                made[name] = out / "sweep.html"
            elif name == "verify":
                run_command("verify", "duffing", "-o", out, "--json")
                made[name] = out / "verify.html"
            else:
                run_command("run", name, *RUNS[name], "-o", out, "--json")
                made[name] = out / "report.html"
        return made[name]

    return page


@pytest.mark.slow
@pytest.mark.parametrize("name", [*RUNS, *SWEEPS, "verify"])
def test_a_page_works(name, pages, browser):
    """No error, every curve drawn, a value under the pointer, zoom, legend, no overflow."""
    require_works(browser, pages(name))


def require_works(browser, path):
    sheet = Sheet(browser, path)
    charts = [len(names) for names in sheet.ask("curves")]
    figures = sheet.tab.locator("figure[data-plot]").count()
    assert charts
    assert sheet.tab.locator("figure[data-plot] canvas[aria-label]").count() == len(charts)
    assert sheet.tab.locator("figure[data-plot]:has(canvas)").count() == figures
    assert max(charts) <= 4
    assert not [row for row in sheet.ask("count") if row[1] < FEWEST]
    assert all(count > FEWEST for count in sheet.ask("opaque"))
    for k, curves in enumerate(charts):
        require_reads(sheet, k, curves)
        require_zooms(sheet, k)
    if sum(charts):
        require_hides(sheet)
    assert not sheet.errors
    assert sheet.loaded == [path.absolute().as_uri()]
    for scheme in ("light", "dark"):
        narrow = Sheet(browser, path, NARROW, scheme)
        assert narrow.tab.evaluate("document.documentElement.scrollWidth") <= NARROW
        assert not [row for row in narrow.ask("count") if row[1] < FEWEST]
        assert not narrow.errors


def require_reads(sheet, k, curves):
    """Some place along the axis has a value of each curve; of a map, some place has a colour."""
    colours = sheet.tab.locator(".panels > div").nth(k).locator("output")
    found = set()
    for across in (0.02, 0.3, 0.5, 0.7, 0.98):
        sheet.point(k, across)
        sheet.wait()
        found |= {i for i, text in enumerate(sheet.ask("readings", k)) if text}
        found |= {0 for text in colours.all_inner_texts() if ":" in text}
    assert found >= set(range(curves + 1)) or not (curves or colours.count())


def require_zooms(sheet, k):
    before = sheet.ask("ranges", k)
    sheet.drag(k, (0.4, 0.5), (0.6, 0.55))

    def enlarged():
        (low, high), _ = sheet.ask("ranges", k)
        return before[0][0] < low < high < before[0][1]

    def reset():
        return np.allclose(sheet.ask("ranges", k), before, rtol=1e-9, atol=1e-12)

    assert sheet.becomes(enlarged)
    sheet.tab.mouse.dblclick(*middle(sheet.area(k)))
    assert sheet.becomes(reset), (sheet.ask("ranges", k), before)


def middle(area):
    x, y, width, height = area
    return x + width / 2, y + height / 2


def require_hides(sheet):
    """A click and a key on a name of the legend."""
    name = sheet.tab.locator(".u-series th[role=button]").first
    for act in (name.click, lambda: name.press("Enter")):
        before = sheet.ask("shown")
        act()
        assert sheet.becomes(lambda before=before: sheet.ask("shown") is not before)
        assert name.get_attribute("aria-pressed") == str(not before).lower()


# --- figures made here --------------------------------------------------------------------------


def sheet_of(browser, folder, *panels, scheme="light", width=WIDE, columns=1, title="Title"):
    figure = Figure("f", title, "Caption.", panels, columns=columns)
    path = write_page(folder / "page.html", "Page", "", [PageSection("Section", figures=[figure])])
    sheet = Sheet(browser, path, width, scheme)
    assert not sheet.errors
    return sheet


def test_the_value_under_the_pointer_is_that_of_the_curve(browser, tmp_path):
    x = np.linspace(0.0, 5.0, 20_001)
    curves = Curve("fall", x, 3e-3 * np.exp(-x)), Curve("rise", x[::7], 1e-3 * x[::7])
    sheet = sheet_of(browser, tmp_path, Panel("time in ms", "height in m", curves))
    for across in (0.1, 0.5, 0.9):
        sheet.point(0, across)
        sheet.wait()
        at, fall, rise = sheet.ask("readings", 0)
        assert at.endswith(" ms")
        assert fall.endswith(" mm")
        at, fall, rise = (float(text.split()[0]) for text in (at, fall, rise))
        assert at == pytest.approx(5 * across, abs=0.02)
        assert fall == pytest.approx(3 * np.exp(-at), rel=3e-3)
        assert rise == pytest.approx(at, abs=0.01)  # its next point that the page contains


def test_a_return_sweep_is_a_separate_curve(browser, tmp_path):
    x = np.array([0.0, 1.0, 2.0, 3.0, 2.0, 1.0, 0.0])
    y = np.array([0.0, 1.0, 2.0, 9.0, 8.0, 7.0, 6.0])
    sheet = sheet_of(browser, tmp_path, Panel("voltage in V", "gap in um", (Curve("gap", x, y),)))
    sheet.point(0, 1 / 3)
    sheet.wait()
    assert [text.split()[0] for text in sheet.ask("readings", 0)] == ["1", "1", "7"]
    assert sheet.ask("curves")[0] == [
        "gap",
        "gap, back",
    ]
    assert all(count > FEWEST for _, count in sheet.ask("count"))


def test_a_sweep_shows_its_first_and_its_last_point(browser, tmp_path):
    """Also if the nearest numbers of single precision lie beyond the axis."""
    for first, last in ((2e-5, 4e-5), (0.7, 0.9)):
        x = np.array([first, (first + last) / 2, last])
        curve = Curve("m", x, np.array([1.0, 1.5, 9.0]), "o-")
        panel = Panel("mass in kg", "y in V", (curve,), span=(first, last))
        sheet = sheet_of(browser, tmp_path, panel)
        for across, expected in ((0.001, 1.0), (0.999, 9.0)):
            sheet.point(0, across)
            sheet.wait()
            assert float(sheet.ask("readings", 0)[1].split()[0]) == expected
        low, high = sheet.ask("ranges", 0)[1]
        assert low < 1.0 < 9.0 < high


def test_axes_have_prefixes(browser, tmp_path):
    x = np.linspace(1.0, 2.0, 9)
    panels = (
        Panel("", "a in m", (Curve("a", 1e-5 * x, 1e-7 * x),)),
        Panel("mass in kg", "b in kV/mm", (Curve("b", 1e-5 * x, x),), levels=((1.5, "limit"),)),
    )
    sheet = sheet_of(browser, tmp_path, *panels)
    texts = sheet.tab.locator(".panels > div > div:first-child").all_inner_texts()
    assert texts == ["a in nm", "b in kV/mm"]
    sheet.point(1, 0.0)
    sheet.wait()
    assert sheet.ask("readings", 1) == ["10 mg", "1 kV/mm"]
    assert sheet.ask("readings", 0) == ["10 mg", "100 nm"]  # both panels are read as one
    f = np.linspace(1.0, 2.0, 9)
    near = Panel("frequency in Hz", "|Z| in Ω", (Curve("Z", f, 1e5 * f),), log_y=True)
    far = Panel("frequency in Hz", "|Z| in Ω", (Curve("Z", f, 10 ** (3 * f)),), log_y=True)
    sheet = sheet_of(browser, tmp_path, near, far)
    texts = sheet.tab.locator(".panels > div > div:first-child").all_inner_texts()
    assert texts == ["|Z| in kΩ", "|Z| in Ω"]
    assert "150" in sheet.ask("texts", 0)[1]
    assert sheet.ask("texts", 1)[1] == ["10³", "10⁴", "10⁵", "10⁶"]


def test_many_curves_have_several_legends(browser, tmp_path):
    x = np.linspace(0.0, 1.0, 50)
    curves = tuple(Curve(f"c{k}", x, k + x) for k in range(9))
    reference = Curve("exact", x, x, "reference")
    sheet = sheet_of(browser, tmp_path, Panel("time in s", "y", (reference, *curves)))
    legends = sheet.ask("curves")
    assert all(1 < len(names) <= 4 and names[-1] == "exact" for names in legends)
    assert sorted(n for names in legends for n in names[:-1]) == [f"c{k}" for k in range(9)]


def test_points_of_one_place_are_all_there(browser, tmp_path):
    x, y = np.array([2.0, 1.0, 2.0, -1.0, 2.0]), np.arange(5.0)
    names = tuple("abcde")
    panel = Panel("error", "time in s", (Curve("runs", x, y, "o", names),))
    sheet = sheet_of(browser, tmp_path, panel)
    assert sheet.ask("values", 0, 1) == [3.0, 1.0, 0.0, 2.0, 4.0]
    sheet.point(0, 0.0)
    sheet.wait()
    assert sheet.ask("readings", 0)[1] == "d 3 s"


@pytest.mark.parametrize("width", [NARROW, WIDE])
def test_a_long_waveform_is_its_envelope_until_it_is_enlarged(browser, tmp_path, width):
    """Of 1000 cycles every column of pixels is filled between -1 and 1; of ten it is not."""
    t = np.linspace(0.0, 1.0, 40_001)
    panel = Panel("time in s", "u", (Curve("u", t, np.sin(2000 * np.pi * t)),))
    sheet = sheet_of(browser, tmp_path, panel, width=width)
    assert sheet.ask("filled", 0, 0.37) == 1.0
    sheet.ask("zoom", 0, 0.5, 0.51)
    sheet.wait()
    assert 0.02 < sheet.ask("filled", 0, 0.37) < 0.6


def test_a_map_has_its_colours_and_a_logarithmic_axis_its_powers(browser, tmp_path):
    z, ends = np.array([[1.0, 2.0], [3.0, np.nan]]), np.array([0.0, 1.0])
    sheet = sheet_of(
        browser, tmp_path, Panel("a in V", "b in m", (), map=ColourMap(ends, ends, z, "c"))
    )
    assert sheet.ask("colour", 0, 0.2, 0.2) == [0x44, 0x01, 0x54]
    assert sheet.ask("colour", 0, 0.2, 0.8) == [0xFD, 0xE7, 0x25]
    sheet.point(0, 0.75, 0.25)
    sheet.wait()
    assert sheet.tab.locator("output").inner_text() == "1, 0: 2"
    f = np.geomspace(0.1, 1e6, 200)
    log = Panel("frequency in Hz", "|Z| in Ω", (Curve("", f, 1 / f),), log_x=True, log_y=True)
    other = sheet_of(browser, tmp_path, log)
    texts = other.ask("texts", 0)
    assert {"10⁵", "10⁻¹"} <= {*texts[0]}
    assert {"10⁻⁶"} <= {*texts[1]}


def test_a_level_beyond_the_curve_is_shown_again_after_a_zoom(browser, tmp_path):
    x = np.linspace(0.0, 1.0, 50)
    panel = Panel("time in s", "y", (Curve("y", x, x),), levels=((5.0, "limit"),))
    sheet = sheet_of(browser, tmp_path, panel)
    assert sheet.ask("ranges", 0)[1][1] > 5.0
    require_zooms(sheet, 0)


def test_equal_axes_stay_equal_in_a_window_of_another_size(browser, tmp_path):
    """Pixels of a millimetre across and up, at first, in a narrower window, and enlarged."""
    x, y = np.array([0.0, 30.0, 30.0, 0.0, 0.0]), np.array([0.0, 0.0, 8.0, 8.0, 0.0])
    sheet = sheet_of(browser, tmp_path, Panel("mm", "mm", (Curve("edge", x, y),), equal=True))
    ways = (
        lambda: None,
        lambda: sheet.tab.set_viewport_size({"width": 500, "height": 800}),
        lambda: sheet.drag(0, (0.3, 0.4), (0.5, 0.8)),
    )
    for change in ways:
        change()
        sheet.wait()
        _, _, width, height = sheet.area(0)
        (x0, x1), (y0, y1) = sheet.ask("ranges", 0)
        assert width / (x1 - x0) == pytest.approx(height / (y1 - y0), rel=0.01)


BAD = "</script><script>a()</script><img src=x onerror=a()>"


def test_markup_in_names_stays_text(browser, tmp_path):
    x = np.arange(3.0)
    curve = Curve(BAD, x, x, "o", (BAD, BAD, BAD))
    panel = Panel(BAD, BAD, (curve,), ((1.0, BAD),), ((0.0, 1.0, BAD),), ((1.0, BAD),))
    sheet = sheet_of(browser, tmp_path, panel, title=BAD)
    assert sheet.tab.locator("figure h3").inner_text() == BAD
    assert sheet.tab.locator("img").count() == 0
    assert len(sheet.loaded) == 1


def test_dark_pages_have_light_ink(browser, tmp_path):
    x = np.linspace(0.0, 1.0, 50)
    panel = Panel("time in s", "y", (Curve("y", x, x),))
    ink, paper = sheet_of(browser, tmp_path, panel).ask("brightness")
    assert ink < 150 < 700 < paper
    ink, paper = sheet_of(browser, tmp_path, panel, scheme="dark").ask("brightness")
    assert paper < 150 < 600 < ink
