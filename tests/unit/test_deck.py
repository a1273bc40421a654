"""A deck as data: analyses, options, vectors; heads of libraries."""

import math
from dataclasses import replace

import pytest

from kc2spice.netlist.circuit import Param, Pin, Subcircuit, positive
from kc2spice.netlist.deck import Command, Deck, Option, ac, dc, terms, transient
from kc2spice.rom.linear import Certificate
from kc2spice.scene.parttype import ErrorRow, LeftOut, Modelled
from kc2spice.scene.plan import Plan
from kc2spice.spice.header import Header, parameter_list, part_header, plan_lines, rom_line

TEXT = """title
V1 a 0 1
.OPTIONS reltol=1e-5 gmin=1e-13 method=gear
.opt reltol = 2e-5
.save v(a)
.tran 1u 1m
.ac dec 1 1 10
.end
"""


def test_analyses_say_what_was_asked():
    assert transient(2.0, 0.5, uic=False).card == ".tran 0.002 2.0 0 0.5"
    assert transient(2.0, 1e-3, uic=True).card == ".tran 0.001 2.0 0 0.001 uic"
    assert ac(10.0, 1e3, 7, "linear").card == ".ac lin 7 10.0 1000.0"
    assert ac(10.0, 1e3, 7, "log").card == ".ac dec 4 10.0 1000.0"
    assert ac(10.0, 1e3, 8, "log").card == ".ac dec 4 10.0 1000.0"
    assert ac(1.0, 1e9, 3, "log").card == ".ac dec 1 1.0 1000000000.0"
    narrow = math.ceil(100 / math.log10(1010 / 1000))
    assert ac(1000.0, 1010.0, 100, "log").card == f".ac dec {narrow} 1000.0 1010.0"
    assert ac(1e3, 1e3, 100, "log").card.startswith(".ac dec ")  # a band that is one frequency
    assert dc("V1", 1.0, 3.0, 5).card == ".dc V1 1.0 3.125 0.5"
    assert Command("op", ()).card == ".op"


def test_options_of_a_text_stand_before_its_first_analysis():
    deck = Deck(name="one", text=TEXT)
    assert deck.option("reltol") == "2e-5"
    assert deck.option("gmin") == "1e-13"
    assert deck.option("tol") is None
    more = deck.with_options({"reltol": "1e-3", "noacct": ""}, "why")
    assert more.option("reltol") == "1e-3"
    expected = TEXT.replace(".tran", ".options reltol=1e-3\n.options noacct\n.tran")
    assert more.files == {"one.cir": expected}


def test_options_replace_each_other():
    deck = Deck(name="one", options=(Option("reltol", "1e-3", ""), Option("trtol", "1", "")))
    found = deck.with_options({"reltol": "1e-6"}, "exact").options
    assert found == (Option("trtol", "1", ""), Option("reltol", "1e-6", "exact"))
    assert deck.option("reltol") == "1e-3"
    assert deck.option("abstol") is None
    twice = replace(deck, options=(*deck.options, Option("reltol", "1e-4", "")))
    assert twice.option("reltol") == "1e-4"
    assert ".options reltol=1e-3" in deck.files["one.cir"]


def test_results_are_saved_beside_those_of_a_text():
    deck = Deck(name="one", text=TEXT, vectors={"a": ("v(a)", 1.0)})
    more = deck.saving({"b": ("v(b)", 2.0), "c": ("v(c)", 3.0)})
    assert more.vectors == {"a": ("v(a)", 1.0), "b": ("v(b)", 2.0), "c": ("v(c)", 3.0)}
    assert more.files["one.cir"] == TEXT.replace(".tran", ".save v(b) v(c)\n.tran")
    bare = Deck(name="one", text=TEXT.replace(".save v(a)\n", ""))  # saves all
    assert bare.saving(more.vectors).text == bare.text
    own = Deck(name="two").saving({"b": ("v(b)", 2.0)})
    assert own.text is None
    assert own.saved == ("v(b)",)


def test_a_vector_is_saved_once():
    vectors = {"sum": ("v(a)+v(b)", 1.0), "difference": ("v(b)-v(c)", 1.0)}
    assert Deck(name="one", vectors=vectors).saved == ("v(a)", "v(b)", "v(c)")
    assert terms("v(a)-v(b)+i(c)") == [(1.0, "v(a)"), (-1.0, "v(b)"), (1.0, "i(c)")]
    assert terms("-v(a)") == [(-1.0, "v(a)")]


def test_the_largest_step_of_a_transient_can_be_changed():
    deck = Deck(name="one", command=transient(1.0, 1e-2, uic=True))
    assert deck.with_steps(0.5).command.card == ".tran 0.001 1.0 0 0.005 uic"
    settled = Deck(name="one", command=transient(1.0, 1e-2, uic=False))
    assert settled.with_steps(2.0).command.card == ".tran 0.001 1.0 0 0.02"
    for other in (Command("tran", ("1", "2", "0")), ac(1.0, 10.0, 3, "linear")):
        same = Deck(name="one", command=other)
        assert same.with_steps(0.5) is same


# --------------------------------------------------------------------------------- libraries


@pytest.mark.parametrize(
    ("error", "written"),
    [(1.2345e-4, "0.000124"), (1.23e-4, "0.000123"), (9.994e-3, "0.01"), (9.999e-3, "0.01"),
     (1e-6, "1e-06"), (1.001e-6, "1.01e-06")],
)  # fmt: skip
def test_a_bound_is_rounded_upwards(error, written):
    certificate = Certificate((0.0, 5e5), error, "residual", True, True)
    line = rom_line(7, certificate)
    assert line.startswith(
        f"* rom: order=7 band=0.0..500000.0 Hz norm=pointwise error={written} (residual); above"
    )
    assert line.endswith("above the band not certified; a contact or a steep edge excites it\n")


def test_what_contact_sees_above_the_band_is_said():
    above = ((1e6, 0.0123), (2e6, 0.5))
    line = rom_line(7, Certificate((0.0, 5e5), 1e-4, "residual", True, True, above))
    assert "certified, compliance off by 0.012 at 1e+06 Hz, 0.5 at 2e+06 Hz; a contact" in line


def test_the_head_of_a_library():
    pins = (Pin("a", "um", "N"), Pin("ref", "V", "A"))
    params = (Param("k", 2.0, "N/m", "stiffness\n.control"), positive("c", 1e-9, "F", "size"),
              Param("x", 0.0, "-", "share", high=1.0))  # fmt: skip
    text = part_header(Header("my\nscene", "0"), "part: title", pins, params, rating="none")
    lines = text.splitlines()
    assert lines[0] == "* part: title"
    assert lines[2] == "* scene: my scene hash=0"
    assert lines[4].startswith("* sign: um, m/s and N count upwards")
    assert lines[7:] == [
        "* @pin 1 a unit=um flow=N",
        "* @pin 2 ref unit=V flow=A",
        "* @param k=2.0 unit=N/m stiffness .control",
        "* @param c=1e-09 unit=F range=1e-30..inf size",
        "* @param x=0.0 unit=- range=-inf..1 share",
    ]
    electrical = part_header(Header("s", "0"), "part", pins[1:], rating="none")
    assert "* sign: 1 V counts from the reference, 1 A into the pin\n" in electrical
    thermal = part_header(Header("s", "0"), "part", (Pin("t", "K", "W"),), rating="none")
    assert "* sign: 1 V counts from the reference, 1 A into the pin\n" in thermal
    assert parameter_list(params) == "k=2.0 c=1e-09 x=0.0"
    assert (params[0].low, params[0].high) == (-math.inf, math.inf)


def test_the_head_of_a_deck_tells_its_parts_and_errors_in_lines_of_98_columns():
    parts = (Modelled("chip", "", ""), Modelled("ball", "", ""))
    errors = (ErrorRow("mesh", None, 1.234e-3, "", ""), ErrorRow("steps", 0.01, None, "", ""))
    found = Plan(parts, (), (LeftOut("heat", "", ""), LeftOut("air\n.exec", "", "")), 0.05, errors)
    assert plan_lines(found).splitlines() == [
        "* modelled: chip, ball",
        "* relative errors expected, error_budget 0.05: mesh 0.0012, steps not estimated of 0.01",
        "* left out (sizes: kc2spice explain): heat; air .exec",
    ]
    short = plan_lines(replace(found, error_budget=None, left_out=()))
    assert short.splitlines()[1].startswith("* relative errors expected: mesh")
    assert "left out" not in short
    long = plan_lines(Plan((), (), (LeftOut("xx" + 200 * " x", "", ""),), None, ())).splitlines()
    assert [len(line) for line in long[:-1]] == [98, 97, 97, 97]  # an even number, an odd one
    assert all(line.startswith("*   x x") for line in long[1:])


def test_a_subcircuit_is_written_under_its_own_name_or_another(tmp_path):
    part = Subcircuit("part", (Pin("a", "V", "A"),), (positive("k", 2.5, "-", ""),), "* text\n")
    assert part.write(tmp_path) == tmp_path / "part.lib"
    assert part.write(tmp_path / "other.lib") == tmp_path / "other.lib"
    assert (tmp_path / "other.lib").read_text() == "* text\n"
    assert repr(part) == "<Subcircuit part: pins a[V/A]; k=2.5>"
