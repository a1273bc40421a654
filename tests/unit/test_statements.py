"""Text of netlists: what is one card, one word, one name, one number."""

import pytest

from kc2spice.core.errors import UsageError
from kc2spice.netlist.cards import comment, distinct, name, number, word


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
