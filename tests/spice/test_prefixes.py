"""Numbers with prefixes are the same doubles in ngspice as the numbers that they replace."""

import re
from decimal import Decimal

import numpy as np
import pytest
from support import (
    Deck,
    format_with_prefix,
    parse_literal,
    read_parameter,
    read_value,
    run_deck,
    write_numbers_with_prefixes,
)

EVERYDAY = [
    "1e-07", "1e-05", "5e-08", "2.49e-05", "0.0005", "4.7e-08", "400000000.0", "0.1", "1000.0",
    "3.288200310757317e-05", "-1.5e-06", "999.99999999", "1e-18", "2.2e+16",
]  # fmt: skip


def draw(count):
    """Numbers of one to seventeen digits from 1e-14 to 1e12, as a netlist has them."""
    random = np.random.default_rng(44)
    sizes = 10 ** random.uniform(-14, 12, count)
    digits = random.integers(1, 18, count)
    rounded = (float(f"{x:.{n}g}") for x, n in zip(sizes, digits, strict=True))
    return [repr(x) for x in rounded]


NUMBERS = EVERYDAY + draw(600)
CARDS = {
    "value": "V{k} n{k} 0 {text}",
    "waveform": "V{k} n{k} 0 PWL(0 {text} 1 {text})",
    "parameter": ".param p{k}={text}\nV{k} n{k} 0 {{p{k}}}",
    "default": ".subckt s{k} a p={text}\nV1 a 0 {{p}}\n.ends\nX{k} n{k} s{k}",
    "instance": "X{k} n{k} s p={text}",
}
SOURCE = ".subckt s a p=1\nV1 a 0 {p}\n.ends"


def read_by_ngspice(kind, texts, folder):
    """The doubles that ngspice reads."""
    cards = [CARDS[kind].format(k=k, text=text) for k, text in enumerate(texts)]
    text = "\n".join(["numbers", SOURCE, *cards, ".op", ".end", ""])
    vectors = {f"n{k}": (f"v(n{k})", 1.0) for k in range(len(texts))}
    waves = run_deck(Deck(name="numbers", text=text, vectors=vectors), folder)
    return np.array([waves[name][0] for name in vectors])


@pytest.mark.parametrize("kind", CARDS)
def test_ngspice_reads_the_same_double(kind, tmp_path):
    plain = read_by_ngspice(kind, NUMBERS, tmp_path / "plain")
    spelled = [format_with_prefix(text) for text in NUMBERS]
    assert sum(text != other for text, other in zip(NUMBERS, spelled, strict=True)) > 500
    assert np.array_equal(read_by_ngspice(kind, spelled, tmp_path / "prefix"), plain)
    read = read_value if kind in ("value", "waveform") else read_parameter
    assert [read(text) for text in NUMBERS] == plain.tolist()


def test_plain_prefixes_would_be_other_doubles(tmp_path):
    """Plain prefixes round differently: 100n is not 1e-07."""
    one, other = read_by_ngspice("value", ["1e-07", "100n"], tmp_path)
    assert one != other


def test_our_reader_reads_the_true_value():
    for text in NUMBERS:
        assert parse_literal(format_with_prefix(text)) == float(Decimal(text))


def test_numbers_are_those_of_an_engineer():
    for text in draw(300):
        spelled = format_with_prefix(text)
        mantissa = re.match(r"[\d.]+", spelled)[0]
        assert spelled == text or 0.1 <= float(mantissa) < 1000


@pytest.mark.parametrize(
    ("text", "spelled"),
    [("PULSE(0.0 100.0 0.0005 2.49e-05)", "PULSE(0 100 500u 24.9u)"), ("EXTERNAL", "EXTERNAL"),
     ("10", "10"), ("n1.5e-6", "n1.5e-6"), ("24.9u", "24.9u"),
     ("PULSE(1e999 1e-999 0)", "PULSE(1e999 1e-999 0)")],
)  # fmt: skip
def test_words_without_numbers_are_unchanged(text, spelled):
    assert write_numbers_with_prefixes(text) == spelled
