"""Wrong wiring is named, with file and line, before any simulator runs."""

import time
from dataclasses import replace

import pytest
from support import Deck, UsageError, find_wiring_mistakes, require_valid_wiring

import kc2spice as kc

LIBRARY = """* divider: a part
* @pin 1 top unit=V flow=A
* @pin 2 mid unit=V flow=-
* @pin 3 bottom unit=V flow=A
.subckt divider top mid bottom ratio=0.5 total=1e3
.param upper={total*(1-ratio)}
R1 top mid {upper}
R2 mid bottom {total*ratio}
.ends divider
"""


def deck(cards, library=LIBRARY):
    text = f"* title\n.include divider.lib\n{cards}\n.end\n"
    return Deck(name="test", text=text, more={"divider.lib": library})


def complaints(cards, library=LIBRARY):
    return [(p.where, p.message, p.got) for p in find_wiring_mistakes(deck(cards, library))]


GOOD = [
    "V1 in 0 1e1\nR1 in 0 1e5\nR2 in 0 2.2k\nC1 in 0 10uF\nR3 in 0 1meg",
    "V1 in 0 1\nX1 in out 0 divider\nR9 out 0 1k\n.op",
    "V1 in 0 1\nX1 in out 0 divider ratio=0.1\n+ total=5\nR9 out 0 1k",
    "V1 in 0 DC 1 AC 1\nX1 in nc1 0 divider\nX2 in nc2 0 divider",
    "V1 in 0 1\nX1 in out 0 divider\nBx out 0 I={max(0, V(in)-V(out))*1e-3}",
    "V1 in 0 1\nX1 in free 0 divider",  # a signal pin may hang
    "V1 in 0 1\nR1 in lonely 1\n.save v(lonely)",
    "V1 in 0 1\nR1 in lonely 1\n.save v(in) v(lonely)",
    ".param gain=3\nV1 in 0 {gain}\nE1 out 0 in 0 {2*gain}\nR1 out 0 1",
    "V1 in 0 PULSE(0 1 0 1n 1n 1)\nR2 in 0 1\nF1 0 out V1 2\nR1 out 0 1",
    "V1 in 0 SIN(0 1 1k)\nS1 in out in 0 fast\n.model fast SW(VT=0.5)\nR1 out 0 1",
    "L1 in 0 1m\nL2 out 0 1m\nK1 L1 L2 0.9\nI1 0 in 1\nR1 out 0 1",
    ".func half(x) {x/2}\nV1 in 0 1\nB1 in 0 I={half(V(in))}",
    "V1 in 0 1\nR1 in 0 {agauss(1, 0, 1)}",  # parameters have functions of their own
    ".func abs(x) {sqrt(x*x)}\nV1 in 0 1\nB1 in 0 I={abs(V(in))}",  # one's own of a known name
    "V1 in 0 1\nB1 in 0 I=V(in)^2+V(in)**4\nE1 o 0 VALUE={V(in)**2}\nR1 o 0 1",
    "B1 in 0 V=sin(6.28*time) ; comment V(nowhere)\nR1 in 0 1 $ other V(nowhere)",
    "V1 in 0 1\nR1 in lonely 1\nB1 in 0 I=V(lonely)",  # what a law reads is no loose end
    "V1 in 0 1\nB1 in 0 I={V(in,0)+V(gnd)}",
    "V1 in 0 1\nB1 in 0 I=V(in)*3 || 1",  # odd, but no power
    "V1 in 0 1\nW1 out in V1 relay\n.model relay CSW(IT=1)\nR1 out 0 1",
    "V1 in 0 1\nX1 in out half\n.subckt half a b\nB1 b 0 I=V(a)\n.ends\nR1 out 0 1",
]


@pytest.mark.parametrize("cards", GOOD)
def test_sound_decks_pass(cards):
    assert complaints(cards) == []
    require_valid_wiring(deck(cards))


BAD = [
    ("V1 in 0 1\nX1 in out divider", "missing pins of divider: bottom", "test.cir:4"),
    ("V1 in 0 1\nX1 in out 0 0 divider", "too many pins of divider: 0", "test.cir:4"),
    ("V1 in 0 1\nX1 in out 0 dividr", "no such subcircuit", "test.cir:4"),
    ("V1 in 0 1\nX1 in out 0 divider rato=2", "no such parameter", "test.cir:4"),
    ("V1 in 0 1\nX1 in out 0 divider upper=2", "no such parameter", "test.cir:4"),
    ("V1 in 0 1\nR1 in 0 1\nR1 in 0 2", "two elements have the same name", "test.cir:5"),
    ("V1 in 0 1\nR1 in 0 4k7", "ngspice reads 4k7 as 4k", "test.cir:4"),
    ("V1 in 0 1\nR1 in 0 1\nC1 in 0 2n2", "ngspice reads 2n2 as 2n", "test.cir:5"),
    ("V1 in 0 1\nR1 in 0 1R5", "ngspice reads 1R5 as 1", "test.cir:4"),
    ("V1 in 0 1\nR1 in 0 1\nr1 in 0 2", "two elements have the same name", "test.cir:5"),
    ("V1 in 0 1\nR1 imn 0 1", "floating port: nothing else is wired to node imn", "test.cir:4"),
    ("V1 in 0 1\nX1 in out bot divider\nR1 out 0 1", "wired to node bot", "test.cir:4"),
    ("V1 in 0 1\nR1 in 0 {gane}", "no such parameter", "test.cir:4"),
    ("V1 in 0 1\nB1 in 0 I={V(imn)}", "no such node", "test.cir:4"),
    ("V1 in 0 1\nB1 in 0 I={I(V9)}", "no such source", "test.cir:4"),
    ("V1 in 0 1\nF1 in 0 V9 2", "no such", "test.cir:4"),
    ("V1 in 0 1\nS1 in 0 in 0 quick", "no such model", "test.cir:4"),
    ("V1 in 0 1\nZ1 in 0 in quick", "no such model", "test.cir:4"),
    ("V1 in 0 1\nB1 in 0 I=V(in)^3", "odd powers from the absolute value", "test.cir:4"),
    ("V1 in 0 1\n+ \nB1 in 0 I={V(in)*(2}", "not an expression", "test.cir:5"),
    ("V1 in 0 1\nB1 in 0 I={limit(V(in),0,1)}", "ngspice has no such function", "test.cir:4"),
    (".param a={b*2}\nV1 in 0 {a}\nR1 in 0 1", "no such parameter", "test.cir:3"),
    ("V1 in 0 1\nF1 in 0 R1 2\nR1 in 0 1", "no such", "test.cir:4"),
    ("V1 in 0 1\nX1 in nc_mid 0 more divider", "too many pins of divider: more", "test.cir:4"),
    ("V1 in 0 1\nX1 in nc_mid 0 more divider", "wired to node more", "test.cir:4"),
    ("F1 in 0 X1 2\nX1 in nc_mid 0 divider", "no such", "test.cir:3"),
    ("L1 in 0 1\nR1 in 0 1\nK1 L1 R1 0.9", "no such", "test.cir:5"),
    ("L1 in 0 1\nC1 in 0 1\nK1 L1 C1 0.9", "no such", "test.cir:5"),
    ("V1 in 0 1\nX1 in nc_mid loose divider", "wired to node loose", "test.cir:4"),
    ("V1 in 0 1\nR1 in free 1\nR2 in 0 {V(free)}", "wired to node free", "test.cir:4"),
]


@pytest.mark.parametrize(("cards", "message", "where"), BAD)
def test_wrong_wiring_is_named(cards, message, where):
    found = [(w, m) for w, m, _ in complaints(cards)]
    assert any(w == where and message in m for w, m in found), found
    with pytest.raises(UsageError) as caught:
        require_valid_wiring(deck(cards))
    assert caught.value.exit_code == 2
    assert "test.cir:" in str(caught.value)


def test_a_missing_include_suggests_no_file_that_includes_it():
    text = "* title\n.include divider.lib\n.end\n"
    more = {"divider.lib": ".include divider2.lib\n", "op.inc": "* nothing\n"}
    with pytest.raises(UsageError, match="included file not found") as caught:
        require_valid_wiring(Deck(name="test", text=text, more=more))
    assert caught.value.expected == "one of op.inc"
    assert caught.value.hint == "copy divider2.lib into the folder of the netlist"


@pytest.mark.parametrize(
    ("cards", "message"),
    [
        (".include other.lib", "included file not found"),
        ("V1 in 0 1\nR1 in", "element is not complete"),
        ("Yo in 0 1", "unknown kind of element"),
        (".subckt open a b\nR1 a b 1", "this subcircuit has no end"),
        (".subckt divider a b\nR1 a b 1\n.ends", "two subcircuits have the same name"),
        (".subckt twice a a\nR1 a 0 1\n.ends", "the pin a stands twice"),
        (".ends", ".ends without .subckt"),
        (".include divider.lib\n.include test.cir", "two subcircuits have the same name"),
        (".include test.cir", "a file includes itself"),
    ],
)
def test_unreadable_decks_are_named(cards, message):
    with pytest.raises(UsageError, match=message) as caught:
        require_valid_wiring(deck(cards))
    assert caught.value.where is not None
    assert caught.value.where.startswith(("test.cir:", "divider.lib:"))


def test_mistakes_inside_a_library_are_found():
    broken = LIBRARY.replace("R2 mid bottom", "R2 midd bottom")
    assert [m for _, m, _ in complaints("V1 in 0 1\nX1 in nc 0 divider", broken)] == [
        "floating port: nothing else is wired to node midd"
    ]


LOOPS = [  # cards inside of a subcircuit with the pins a and b, and the sources of the loop
    ("V1 a b 5\nV2 a b 6", ["V1", "V2"]),
    ("V1 a b 5\nV2 b a -5", ["V1", "V2"]),
    ("V1 a b 5\nV2 a m 2\nV3 m b 3", ["V2", "V1", "V3"]),
    ("V1 a b 5\nE1 a b c b 2\nR1 c b 1", ["V1", "E1"]),
    ("V1 a b 5\nVs a b 0\nH1 c b Vs 1\nR1 c b 1", ["V1", "Vs"]),
    ("V1 a b 5\nR1 a c 1\nV2 c b 6", []),
    ("V1 a b 5\nL1 a b 1m", []),
    ("V1 a b 5\nH1 a b V1 2", []),  # a resistor of 2 Ohm
    ("V1 a b 5\nB1 a b V=5*I(V1)", []),
]


@pytest.mark.parametrize(("cards", "names"), LOOPS)
def test_a_loop_of_ideal_sources_names_all_of_them(cards, names):
    """ngspice simulates exactly the circuits without a loop."""
    library = f"* loop\n.subckt divider a b\n{cards}\n.ends\n"
    wired = deck("R9 in 0 1k\nX1 in 0 divider\n.tran 1u 10u uic", library)
    wired = replace(wired, vectors={"v": ("v(in)", 1.0)})
    if not names:
        assert find_wiring_mistakes(wired) == []
        assert kc.simulate(wired).waves["v"][1:] == pytest.approx(5.0)
        return
    (error,) = find_wiring_mistakes(wired)
    assert error.message == "this voltage source closes a loop of ideal voltage sources"
    lines = {card.split()[0]: f"divider.lib:{k}" for k, card in enumerate(cards.split("\n"), 3)}
    assert error.got == f"a loop of {', '.join(f'{name} ({lines[name]})' for name in names)}"
    assert error.where == lines[names[-1]]
    with pytest.raises(kc.errors.SimulationError):
        kc.simulate(wired)


def test_a_loop_of_ideal_sources_in_two_instances_is_found():
    library = "* pair\n.subckt divider a b\nV1 a b 5\nR1 a b 1\n.ends\n"
    found = complaints("V2 in m 1\nR2 m 0 1\nX1 in 0 divider\nX2 m 0 divider", library)
    assert [got for _, _, got in found] == [
        "a loop of V2 (test.cir:3), V1 (divider.lib:3), V1 (divider.lib:3)"
    ]
    assert complaints("V2 in m 1\nR2 m 0 1\nX1 in 0 divider", library) == []
    assert complaints("V2 in in 1\nR2 in 0 1\nX1 in 0 divider", library)[0][1:] == (
        "both nodes of this voltage source are the same node", "V2 in in 1",
    )  # fmt: skip
    port = "V2 in 0 ac 1 portnum 1 z0 50\nX1 in 0 divider"
    assert complaints(port, library) == []


def test_deeply_nested_instances_are_checked_in_a_short_time():
    """Each of 30 levels has two instances of the level below: 10^9 instances of the source."""
    levels = ["* levels\n.subckt level0 a b\nV1 a m 5\nR1 m b 1\nV2 a c 0\nR2 c b 1\n.ends"]
    for k in range(1, 30):
        cells = f"X1 a m level{k - 1}\nX2 m b level{k - 1}\nR1 m 0 1k"
        levels.append(f".subckt level{k} a b\n{cells}\n.ends")
    levels.append(".subckt divider a b\nX1 a b level29\n.ends")
    begin = time.monotonic()
    assert complaints("V1 in 0 1\nX1 in 0 divider", "\n".join(levels)) == []
    series = (
        "\n".join(levels).replace("V1 a m 5\nR1 m b 1", "V1 a b 5").replace("V2 a c 0\nR2", "R2")
    )
    series = series.replace("R2 c b", "R2 a b")
    found = complaints("V3 in 0 1\nX1 in 0 divider", series)
    assert [got for _, _, got in found] == ["a loop of V3 (test.cir:3), V1 (divider.lib:3)"]
    assert time.monotonic() - begin < 10


def test_a_loop_through_ground_inside_a_subcircuit_is_found():
    library = "* pair\n.subckt divider a b\nV1 a 0 5\nR1 a b 1\n.ends\n"
    assert [got for _, _, got in complaints("V2 in 0 1\nX1 in 0 divider", library)] == [
        "a loop of V2 (test.cir:3), V1 (divider.lib:3)"
    ]
