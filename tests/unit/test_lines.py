"""Continuation lines: no line of more than 100 characters, and the same card for every reader."""

import random

import numpy as np
import pytest
from support import Deck, Printer, parse_subcircuits, read_cards, run_deck, wrap_card, wrap_comments

SUM = "+".join(f"{k}e-05*V(in_{k % 3},0)/w{k % 2}" for k in range(1, 40))
CARDS = [
    "X1 " + " ".join(f"n{k}" for k in range(30)) + " body damping={scale*2} gap=100.00n",
    f"B1 out 0 I={{{SUM}}}",
    f".param slope={{{SUM.replace('V(in_', 'max(a_')}}}",
    "V1 a 0 PWL(" + " ".join(f"{k}u {k % 2}" for k in range(60)) + ")",
]


@pytest.mark.parametrize("card", CARDS)
def test_a_long_card_reads_back_as_the_same(card):
    lines = list(wrap_card(card))
    assert len(lines) > 1
    assert max(map(len, lines)) <= 100
    assert all(line.startswith("+ ") for line in lines[1:])
    texts = ("\n".join(text) + "\n" for text in (lines, [card]))
    one, whole = (Printer().format_file(read_cards(text, "cards.lib")) for text in texts)
    assert one == whole


def test_short_cards_and_words_that_have_no_end_stay():
    assert list(wrap_card("R1 a b 1k")) == ["R1 a b 1k"]
    path = f'.include "{"long name " * 12}.lib"'
    assert path.partition(" ")[2] in "\n".join(wrap_card(path))


def test_comments_go_on_behind_three_blanks():
    use = "* use: X1 " + "node " * 16 + "body " + "damping=1 " * 6
    first, second = wrap_comments(use)
    assert second.startswith("*   + damping=1")
    assert " ".join([first, second.removeprefix("*   + ")]) == use.strip()
    law = list(wrap_comments("*   force = " + "+".join(["stop*max(0,x)"] * 20)))
    assert max(map(len, law)) <= 100
    assert len(law) > 2
    two = f"* {'first ' * 10}\n* {'second ' * 10}"
    assert list(wrap_comments(two)) == two.split("\n")


def test_a_library_with_long_comments_reads_back_with_its_title_and_parameters():
    words = "many words " * 12
    text = f"""* part: {words}
* @pin 1 a unit=V flow=A
* @pin 2 b unit=V flow=A
* @param size=2.0 unit=Ohm range=1..3 {words}
.subckt part a b size=2
R1 a b {{size}}
.ends part
"""
    printed = Printer().format_file(read_cards(text, "part.lib"))
    assert max(map(len, printed.splitlines())) <= 100
    (part,) = parse_subcircuits(printed, "part.lib")
    assert part.title == f"part: {words.strip()}"
    assert part.params[0].doc == words.strip()


def test_ngspice_reads_the_same_number_from_continued_expressions(tmp_path):
    numbers = random.Random(3)
    terms = [f"{numbers.uniform(-1, 1):.12g}*x^{k}" for k in range(2, 30)]
    law = "+".join(terms).replace("+-", "-")
    values = []
    for name, lines in (("whole", [law]), ("continued", [])):
        card = f"B1 out 0 V={{{law}}}"
        cards = [card] if lines else list(wrap_card(card))
        parameter = f".param y={{{law.replace('^', '**')}}}"
        cards += [parameter] if lines else list(wrap_card(parameter))
        assert (len(cards) > 2) == (name == "continued")
        text = "\n".join([name, ".param x=0.9", *cards, "V1 p 0 {y}", "R1 out 0 1", ".op", ".end"])
        deck = Deck(
            name=name, text=text + "\n", vectors={n: (f"v({n})", 1.0) for n in ("out", "p")}
        )
        waves = run_deck(deck, tmp_path)
        values.append([float(waves[n].real[-1]) for n in ("out", "p")])
    x = 0.9
    expected = sum(float(t.partition("*")[0]) * x ** int(t.partition("^")[2]) for t in terms)
    assert values[0] == values[1]
    assert values[0] == pytest.approx(np.full(2, expected), rel=1e-9)
