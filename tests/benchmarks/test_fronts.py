"""The laboratory's rows of shipped settings, on made-up records; never times."""

from __future__ import annotations

import pytest

from laboratory.figures import Picture
from laboratory.fronts import beaten
from laboratory.page import bench_sections, write_bench
from laboratory.points import ENOUGH, rounds, timed

BETTER = {"label": "rom.order 45", "settings": {"rom.order": 45}, "error": 1e-5, "time_s": 0.1}
FAILED = {"why": "timestep too small", "nearest": None, "keep": ""}


def front(nearest=None, keep=""):
    return {"error": 2e-4, "time_s": 0.2, "tried": 12, "nearest": nearest, "keep": keep}


@pytest.mark.parametrize(
    ("found", "count", "met"),
    [
        ({"a": front()}, 0, True),
        ({"a": front(), "b": front(BETTER)}, 1, False),
        ({"a": front(BETTER, "its figures are the paper's")}, 0, True),
        ({"a": front(), "b": FAILED}, 1, False),
    ],
)
def test_a_beaten_scene_without_a_reason_misses_the_target(found, count, met):
    ratio = beaten(found)
    assert ratio.value == count
    assert ratio.met is met
    assert ("b" in ratio.what.split(": ")[1]) is (count == 1)


def test_the_table_says_what_beats_a_scene_and_why_it_keeps_its_setting():
    record = {
        "ratios": {}, "planes": {}, "scaling": {},
        "fronts": {"a": front(), "b": front(BETTER, "the paper's"), "c": FAILED},
    }  # fmt: skip
    (section,) = bench_sections(record, [])
    a, b, c = section.rows
    assert a == ("a", "2.0e-04", "200 ms", "12", "none", "", "")
    assert b[4:] == ("rom.order 45; kept: the paper's", "1.0e-05", "100 ms")
    assert "timestep too small" in c


@pytest.mark.parametrize(
    ("seconds", "most", "expected"),
    [([], 5, 5), ([0.1], 5, 5), ([0.4 * ENOUGH], 5, 3), ([ENOUGH], 5, 1), ([9 * ENOUGH], 5, 1),
     ([0.4 * ENOUGH, 0.3 * ENOUGH], 5, 4), ([0.4 * ENOUGH, 0.2 * ENOUGH], 3, 3)],
)  # fmt: skip
def test_long_runs_are_repeated_less(seconds, most, expected):
    assert rounds(seconds, most) == expected


def test_short_work_is_repeated_as_asked():
    calls = []
    _, time = timed(lambda: calls.append(1), 5)
    assert len(calls) == time.repeats == 5


def test_the_page_holds_its_pictures(tmp_path):
    drawn = tmp_path / "bench_poles.png"
    drawn.write_bytes(b"\x89PNG, drawn")
    machine = dict.fromkeys(
        ["cpu", "cores", "os", "python", "numpy", "scipy", "ngspice", "compiler", "kc2spice"], "-"
    )
    record = {
        "machine": machine, "seconds": {}, "repeats": 1, "quick": False, "ratios": {},
        "planes": {}, "titles": {}, "scaling": {}, "fronts": {},
    }  # fmt: skip
    page = write_bench(tmp_path / "bench.html", record, [Picture(drawn, "Poles", "a < b")])
    text = page.read_text(encoding="utf-8")
    assert 'src="data:image/png;base64,iVBORywgZHJhd24="' in text
    assert "<figcaption>a &lt; b</figcaption>" in text
