"""Cards to elements and scopes: nodes, controls, models and values of each letter."""

import pytest

from kc2spice.core.errors import UsageError
from kc2spice.netlist.elements import behaviour, circuit, element
from kc2spice.netlist.statements import statements


def one(card):
    (statement,) = statements(card, "one.cir")
    return element(statement)


@pytest.mark.parametrize(
    ("card", "nodes", "sources", "model", "values", "params"),
    [
        ("Rx A b 1k", "a b", "", None, ("1k",), {}),
        ("R1 a b R = {2 * k} tc=1", "a b", "", None, (), {"r": "{2 * k}", "tc": "1"}),
        ("C1 a b 1u IC=2", "a b", "", None, ("1u",), {"ic": "2"}),
        ("L1 a b 1m", "a b", "", None, ("1m",), {}),
        ("V1 a b", "a b", "", None, (), {}),
        ("V1 a b DC 1 AC 2", "a b", "", None, ("DC", "1", "AC", "2"), {}),
        ("I1 a b PULSE (0 1)", "a b", "", None, ("PULSE", "(0 1)"), {}),
        ("E1 a b c d 2", "a b c d", "", None, ("2",), {}),
        ("G1 a b c d 2 m=3", "a b c d", "", None, ("2",), {"m": "3"}),
        ("E1 a b vol='2*V(c)'", "a b", "", None, (), {"vol": "'2*V(c)'"}),
        ("G1 a b VALUE {V(c)}", "a b", "", None, ("VALUE", "{V(c)}"), {}),
        ("E1 a b table {V(c)} = (0,0)", "a b", "", None, ("table", "{V(c)}=(0,0)"), {}),
        ("E1 a b POLY(1) c d 0 1", "a b", "", None, ("POLY(1)", "c", "d", "0", "1"), {}),
        ("G1 a b values d 2", "a b values d", "", None, ("2",), {}),
        ("F1 a b Vs 2", "a b", "vs", None, ("2",), {}),
        ("H1 a b Vs 2", "a b", "vs", None, ("2",), {}),
        ("W1 a b Vs model on", "a b", "vs", "model", ("on",), {}),
        ("S1 a b c d Model OFF", "a b c d", "", "Model", ("OFF",), {}),
        ("K1 L1 L2 0.9", "", "l1 l2", None, ("0.9",), {}),
        ("B1 a b I=2", "a b", "", None, ("I=2",), {"i": "2"}),
        ("T1 a b c d Z0=50 TD=1n", "a b c d", "", None, (), {"z0": "50", "td": "1n"}),
        ("D1 a b fast 2", "a b", "", "fast", ("2",), {}),
        ("Q1 c b e fast", "c b e", "", "fast", (), {}),
        ("Q1 c b e s fast", "c b e s", "", "fast", (), {}),
        ("Q1 c b e fast 2", "c b e", "", "fast", ("2",), {}),
        ("Q1 c b e fast .5", "c b e", "", "fast", (".5",), {}),
        ("Q1 c b e fast area=2", "c b e", "", "fast", (), {"area": "2"}),
        ("J1 d g s fast", "d g s", "", "fast", (), {}),
        ("Z1 d g s fast 2", "d g s", "", "fast", ("2",), {}),
        ("M1 d g s b nch L=1u", "d g s b", "", "nch", (), {"l": "1u"}),
        ("M1 d g s vdmos m=2", "d g s", "", "vdmos", (), {"m": "2"}),
        ("X1 A b Amp", "a b", "", "Amp", (), {}),
        ("X1 a b params: Amp gain = 2", "a b", "", "Amp", (), {"gain": "2"}),
        ("X1 Amp", "", "", "Amp", (), {}),
    ],
)
def test_an_element_is_split_as_the_simulator_does(card, nodes, sources, model, values, params):
    part = one(card)
    assert (part.kind, part.name) == (card[0].lower(), card.split()[0].lower())
    assert part.nodes == tuple(nodes.split())
    assert part.sources == tuple(sources.split())
    assert (part.model, part.values, part.params) == (model, values, params)


@pytest.mark.parametrize(
    "card",
    ["R1 a b", "R1 a", "V1 a", "E1 a b c d", "F1 a b V1", "F1 a b", "K1 L1 L2", "D1 a b",
     "Q1 a b c", "S1 a b c d", "W1 a b V1", "M1 a b c", "R1 a=1 b 2", "R1 V(a) b 2", "E1 a b",
     "G1 a", "G1 a b gain=2"],
)  # fmt: skip
def test_an_element_that_lacks_a_word_is_named(card):
    with pytest.raises(UsageError, match="element is not complete") as caught:
        one(card)
    assert caught.value.where == "one.cir:1"


@pytest.mark.parametrize(
    ("card", "law"),
    [
        ("B1 a b I = {V(a) * 2}", ("I", "{V(a) * 2}")),
        ("B1 a b v=V(a)-1 + 2", ("V", "V(a)-1 + 2")),
    ],
)
def test_a_law_goes_on_to_the_end_of_its_card(card, law):
    assert behaviour(one(card)) == law


def test_a_source_without_law_is_named():
    with pytest.raises(UsageError, match="without a law") as caught:
        behaviour(one("B1 a b X=2"))
    assert caught.value.where == "one.cir:1"


MAIN = """Rtitle is no card
.ac lin 1 1 2
.ic v(a)=1
.nodeset v(a)=1
.tran 1 2
.include sub/parts.lib
X1 in 0 amp
.param K=2
.control
R2 not here
.endc
.model Fast D (is=1)
.end
R3 behind the end
"""
PARTS = """.subckt Amp in ref Gain=2 params: Ohm=1k
.param inner={gain*2}
.model slow D
.subckt deep p
R1 p 0 {ohm}
.ends deep
Xd in deep
.ends
.inc more.lib
"""


def test_scopes_know_what_they_and_the_outer_ones_define():
    files = {"main.cir": MAIN, "sub/parts.lib": PARTS, "sub/more.lib": "Rmore a 0 1\n"}
    top = circuit("main.cir", files)
    assert [part.name for part in top.elements] == ["rmore", "x1"]
    assert top.elements[0].statement.where == "sub/more.lib:1"
    assert list(top.models) == ["fast"]
    assert [card.keyword for card in top.commands] == [".ac", ".ic", ".nodeset", ".tran", ".param"]
    amp = top.find("AMP")
    assert amp.pins == ("in", "ref")
    assert amp.defaults == {"gain": "2", "ohm": "1k"}
    assert set(amp.params) == {"gain", "ohm", "inner"}
    deep = amp.find("Deep")
    assert top.find("deep") is None
    assert deep.find("amp") is amp
    assert [deep.knows_param(name) for name in ("K", "gain", "inner", "p")] == [True] * 3 + [False]
    assert [deep.knows_model(name) for name in ("FAST", "slow", "none")] == [True, True, False]
    assert not top.knows_param("gain")
    assert not top.knows_model("slow")


@pytest.mark.parametrize(
    ("text", "message", "where"),
    [
        (".include inner.lib", ".ends without .subckt", "inner.lib:2"),
        (".subckt a b\n.include inner.lib\n.ends", ".ends without .subckt", "inner.lib:2"),
        (".include open.lib", "subcircuit is not closed", "open.lib:1"),
        (".include", "included file is not there", "main.cir:2"),
        (".subckt params:", "subcircuit has no name", "main.cir:2"),
        ("X1 a=1", "instance names no subcircuit", "main.cir:2"),
        (".model fast", "model card is not complete", "main.cir:2"),
    ],
)
def test_what_does_not_close_is_named(text, message, where):
    files = {"inner.lib": "R1 a 0 1\n.ends\n", "open.lib": ".subckt a b\nR1 b 0 1\n"}
    with pytest.raises(UsageError, match=message) as caught:
        circuit("main.cir", {"main.cir": f"* title\n{text}\n", **files})
    assert caught.value.where == where
