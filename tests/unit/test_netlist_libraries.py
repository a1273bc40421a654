"""Every committed library stands alone, says what it is, and shares a deck with all others."""

import re
import runpy
from pathlib import Path

import pytest
from support import Circuit, Element, Printer, parse_literal, read_cards, read_lib

NETLISTS = Path(__file__).parents[2] / "netlists"
LIBRARIES = sorted(NETLISTS.glob("*/*.lib"))
TOOL = runpy.run_path(str(NETLISTS.parent / "tools" / "netlists.py"))
OURS = [p for p in LIBRARIES if "* tool: kc2spice" in p.read_text()[:400]]
HEAD = re.compile(r"(?m)^\* (sign|validity|rating): (\S.*)$")
NUMBER = re.compile(r"(?<![\w.])\d+\.?\d*(?:e[-+]?\d+)?(?:meg|[tgkmunpf])?(?![\w.])")
# what a head says of temperature
WARMTH = re.compile(r"temperature|27 C")


def test_the_table_of_parts_is_complete_and_current():
    page = (NETLISTS / "README.md").read_text()
    table = set(re.findall(r"`(\w+\.lib)`", page))
    assert table == {re.sub(r"(?<=[a-z])\d+(?=\.lib)", "", p.name) for p in LIBRARIES}
    assert TOOL["page"]() == page


@pytest.mark.parametrize("path", OURS, ids=lambda p: f"{p.parent.name}/{p.stem}")
def test_a_head_states_sign_validity_rating_and_units(path):
    text = path.read_text()
    head = text.partition(".subckt")[0].replace("\n*   ", " ")
    assert [key for key, _ in HEAD.findall(head)] == ["sign", "validity", "rating"]
    told = dict(HEAD.findall(head))
    assert WARMTH.search(told["validity"])
    (part,) = read_lib(path)
    assert [pin.name for pin in part.pins] == re.findall(r"(?m)^\* @pin \d+ (\w+)", head)
    moved = any(pin.flow == "N" for pin in part.pins)
    assert ("um" in told["sign"]) == moved
    for param in part.params:
        assert param.unit, param.name
        assert param.low <= param.default <= param.high, param.name
        assert param.unit == "-" or param.doc, param.name


def test_few_files_are_committed():
    """Decks with the libraries that they include, the symbols of all, and a page."""
    assert len([path for path in NETLISTS.iterdir() if path.is_file()]) == 2
    for folder in filter(Path.is_dir, NETLISTS.iterdir()):
        text = "".join(path.read_text("utf-8") for path in folder.glob("*.cir"))
        included = set(re.findall(r"(?m)^\.include (\S+)$", text))
        assert included == {path.name for path in folder.glob("*.lib")}, folder.name
    assert {p.suffix for p in NETLISTS.glob("*/*")} == {".cir", ".lib"}


def test_the_symbols_are_those_of_the_libraries():
    assert TOOL["all_symbols"]() == (NETLISTS / "kc2spice.kicad_sym").read_text()


def tokens(text):
    """Cards without blanks, brackets and continuation, and numbers as values: printing may change
    their spelling."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("*")]
    joined = NUMBER.sub(lambda number: repr(parse_literal(number[0])), "\n".join(lines))
    joined = joined.replace("\n+", "")
    return [re.sub(r"[\s(){},]", "", card).lower() for card in joined.splitlines()]


def laws(circuit):
    for item in circuit.items:
        if isinstance(item, Circuit):
            yield from laws(item)
        elif isinstance(item, Element) and item.quantity:
            yield item.law


@pytest.mark.parametrize("path", LIBRARIES, ids=lambda p: f"{p.parent.name}/{p.stem}")
def test_printing_a_library_again_gives_the_same_text(path):
    text = path.read_text()
    tree = read_cards(text, path.name)
    printed = Printer().format_file(tree)
    again = read_cards(printed, path.name)
    assert list(laws(tree)) == list(laws(again))
    assert Printer().format_file(again) == printed
    assert tokens(printed) == tokens(text)
    assert printed == text or path not in OURS
