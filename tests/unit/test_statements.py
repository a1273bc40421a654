"""Text of netlists: what is one card, one word, one name, one number."""

import pytest

from kc2spice.core.errors import UsageError
from kc2spice.netlist.cards import comment, distinct, name, number, word
from kc2spice.netlist.statements import beside, split_comment, statements, words

TEXT = """R0 the title
* above

R1 a b ; behind
* within
+ 1k // behind
  + tc=1 $ behind
C1 a b 1u
* below
"""


def test_cards_know_their_lines_and_comments():
    found = [(s.line, s.text, s.comments) for s in statements(TEXT, "a.cir", title=True)]
    assert found == [
        (4, "R1 a b 1k tc=1", ("R0 the title", "* above", "")),
        (8, "C1 a b 1u", ("* within",)),
        (10, "", ("* below",)),
    ]
    first, *_, last = statements(TEXT, "a.cir")
    assert (first.text, first.keyword, first.where) == ("R0 the title", "r0", "a.cir:1")
    assert (last.keyword, last.words, last.where) == ("", [], "a.cir:10")
    assert len(statements("R1 a b 1\n", "a.cir")) == 1
    assert statements("", "a.cir") == []


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("R1  a\tb", ["R1", "a", "b"]),
        ("X1 a b = c d =e f= g", ["X1", "a", "b=c", "d=e", "f=g"]),
        ("B1 a I={a <= b == c >= d != e}", ["B1", "a", "I={a <= b == c >= d != e}"]),
        ("V1 a PWL(0 (1 2) 3) b", ["V1", "a", "PWL(0 (1 2) 3)", "b"]),
        ("a [1 {2 3} 4] b", ["a", "[1 {2 3} 4]", "b"]),
        ("a) b c", ["a)", "b", "c"]),
        ("""a 'b "c' d "e 'f" g""", ["a", "'b \"c'", "d", '"e \'f"', "g"]),
        ("'(' a b", ["'('", "a", "b"]),
    ],
)
def test_brackets_and_quotes_hold_words_together(text, expected):
    assert words(text) == expected


@pytest.mark.parametrize(
    ("line", "expected"),
    [
        ("R1 a b 1 ; x ; y", ("R1 a b 1", "x ; y")),
        ("R1 a b 1 // x", ("R1 a b 1", "x")),
        ("R1 a b 1 $ x", ("R1 a b 1", "x")),
        ("R1 a$b c$ 1", ("R1 a$b c$ 1", "")),
    ],
)
def test_what_begins_a_comment_behind_a_card(line, expected):
    assert split_comment(line) == expected


def test_paths_count_from_the_file_that_says_them():
    assert beside("main.cir", "a.lib") == "a.lib"
    assert beside("sub/b.lib", "a.lib") == "sub/a.lib"


@pytest.mark.parametrize("text", ["a", "R_1", "x" * 64])
def test_names(text):
    assert name(text) == text


@pytest.mark.parametrize(
    "text", ["", "1a", "_a", "a b", "a\n", "a.b", "ä", "x" * 65, "GND", "time", "m"]
)
def test_what_is_no_name(text):
    with pytest.raises(UsageError, match="not a netlist name") as caught:
        name(text)
    assert caught.value.where == "netlist"


def test_units_are_one_printable_word():
    for text in ("m/s", "-", "u" * 64):
        assert word(text) == text
    for text in ("", " ", "a b", "a\x00b", "a\n", "u" * 65):
        with pytest.raises(UsageError, match="not one word"):
            word(text)


def test_pins_differ_in_more_than_case_and_from_inner_nodes():
    distinct(["a", "q", "q1x"], r"q\d", where="part")
    for taken in (["a", "b", "A"], ["b", "Q1"]):
        with pytest.raises(UsageError, match="taken") as caught:
            distinct(taken, r"q\d", where="part")
        assert caught.value.where == "part"


def test_numbers_keep_all_digits_and_comments_one_line():
    assert [number(x) for x in (0.1, 1e-300, 1 / 3, 5)] == ["0.1", "1e-300", repr(1 / 3), "5.0"]
    for value in (float("nan"), float("inf")):
        with pytest.raises(UsageError, match="cannot hold"):
            number(value)
    assert comment(" a\n.control\t b\x00c  ") == "a .control b c"
