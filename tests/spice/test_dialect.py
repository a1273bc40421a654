"""Xyce and LTspice texts against their published grammars, and against what ngspice computes."""

import math
import re
from dataclasses import replace

import numpy as np
import pyparsing as pp
import pytest
from support import (
    ContactForce,
    Deck,
    Header,
    UsageError,
    declare_contact,
    find_dialect,
    format_module,
    list_dialect_names,
    parse_subcircuits,
    run_deck,
    translate_deck,
    write_dialect_files,
)
from support import make_declared_subcircuit as declared

pp.ParserElement.set_default_whitespace_chars(" \t\n")


# -------------------------------------------------------------------- the published grammars
#
# Xyce Reference Guide: chapter "Expressions" (operators, arithmetic functions), devices B, C, E,
# F, G, H, I, K, L, R, S, V, X, commands .SUBCKT, .PARAM, .MODEL, .PRINT, .OPTIONS, .TRAN, .AC,
# .DC, .INCLUDE. LTspice Help: "B. Arbitrary behavioral sources", "S. Voltage controlled switch",
# ".param", ".subckt", ".save", ".options", ".tran", ".ac", ".dc".

NUMBER = pp.Regex(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?(?![\w.])")
WORD = pp.Regex(r"[A-Za-z_]\w*")
NODE = pp.Regex(r"(?i)(?!params:)\w[\w:]*")
XYCE_FUNCTIONS = {
    "abs": 1, "acos": 1, "asin": 1, "atan": 1, "cos": 1, "cosh": 1, "exp": 1, "floor": 1, "ln": 1,
    "max": 2, "min": 2, "sgn": 1, "sin": 1, "sinh": 1, "sqrt": 1, "tan": 1, "tanh": 1, "uramp": 1,
    "if": 3, "table": None,
}  # fmt: skip
LTSPICE_FUNCTIONS = dict(XYCE_FUNCTIONS)
del XYCE_FUNCTIONS["uramp"]  # it has a wrong derivative there


def expression(functions, *, braces):
    """Sums of products; ``braces``: parameters stand in braces of their own (LTspice)."""
    whole = pp.Forward()
    probe = pp.Regex(r"[VI]\(\w+(,\w+)?\)")
    calls = [
        pp.CaselessKeyword(name)
        + "("
        + (pp.DelimitedList(whole) if n is None else pp.DelimitedList(whole, min=n, max=n))
        + ")"
        for name, n in functions.items()
    ]
    name = "{" + WORD + "}" if braces else WORD
    plain = pp.CaselessKeyword("time") | pp.CaselessKeyword("pi")
    atom = NUMBER | probe | pp.MatchFirst(calls) | plain | name | "(" + whole + ")"
    unary = pp.ZeroOrMore(pp.one_of("+ -")) + atom
    product = unary + pp.ZeroOrMore(pp.one_of("* /") + unary)
    total = product + pp.ZeroOrMore(pp.one_of("+ -") + product)
    whole <<= total + pp.Optional(pp.one_of("< > <= >=") + total)
    return whole


def grammar(dialect):
    """One card; the braces of values hold parameter expressions without voltages in both."""
    inner = expression(XYCE_FUNCTIONS, braces=False)
    value = NUMBER | "{" + inner + "}"
    pairs = pp.OneOrMore(WORD + "=" + value)
    named = pp.CaselessKeyword("IC") + "=" + value
    wave = pp.one_of("PULSE PWL SIN EXP", caseless=True) + "(" + pp.OneOrMore(value) + ")"
    source = pp.Optional(pp.CaselessKeyword("DC")) + pp.Optional(value)
    source += pp.Optional(pp.CaselessKeyword("AC") + pp.OneOrMore(NUMBER)) + pp.Optional(wave)
    two, four = NODE + NODE, NODE + NODE + NODE + NODE
    law = {
        "xyce": "{" + expression(XYCE_FUNCTIONS, braces=False) + "}",
        "ltspice": expression(LTSPICE_FUNCTIONS, braces=True),
    }[dialect]
    keyword = pp.CaselessLiteral("PARAMS:")
    result = pp.Regex(r"[VI]\([\w:]+\)")
    model = {
        "xyce": pp.CaselessKeyword("VSWITCH")
        + "(VON=" + NUMBER + "VOFF=" + NUMBER + "RON=" + NUMBER + "ROFF=" + NUMBER + ")",
        "ltspice": pp.CaselessKeyword("SW")
        + "(VT=" + NUMBER + "VH=" + NUMBER + "RON=" + NUMBER + "ROFF=" + NUMBER + ")",
    }[dialect]  # fmt: skip
    output = {
        "xyce": ".print" + pp.one_of("TRAN AC DC") + "format=raw" + pp.OneOrMore(result),
        "ltspice": ".save" + pp.OneOrMore(result),
    }[dialect]
    complex_result = {
        "xyce": pp.Regex(r"(V|VM|I|IR)\([\w:]+\)"),
        "ltspice": pp.Regex(r"(mag|re)\([VI]\([\w:]+\)\)") | result,
    }[dialect]
    taken = pp.one_of("MAX MIN PP AVG RMS") + complex_result
    taken |= "FIND" + complex_result + pp.Regex("AT=") + NUMBER
    taken |= "WHEN" + complex_result + "=" + NUMBER + "CROSS=1"
    measure = {
        "xyce": ".measure" + pp.one_of("TRAN AC DC") + WORD + (
            (taken + pp.Optional(pp.one_of("OUTPUT=TIME OUTPUT=FREQ")))
            | "EQN {" + NUMBER + "*" + WORD + "}"),
        "ltspice": ".meas" + pp.one_of("TRAN AC DC") + WORD + (
            taken | "PARAM" + NUMBER + "*" + WORD),
    }[dialect]  # fmt: skip
    option = {
        "xyce": ".options timeint" + pp.OneOrMore(pp.Regex(r"(reltol|abstol|method)=\S+")),
        "ltspice": ".options"
        + pp.OneOrMore(pp.Regex(r"(reltol|abstol|vntol|chgtol|trtol|method|gmin)=\S+")),
    }[dialect]
    coil_tail = pp.Literal("Rser=0") if dialect == "ltspice" else pp.Empty()

    def device(letters):
        return pp.Regex(rf"[{letters}{letters.upper()}]\w*")

    return pp.StringStart() + pp.MatchFirst([
        device("r") + two + value,
        device("c") + two + value + pp.Optional(named),
        device("l") + two + value + pp.Optional(named) + coil_tail,
        device("k") + NODE + NODE + value,
        device("vi") + two + source,
        device("ge") + four + value,
        device("fh") + two + NODE + value,
        device("b") + two + pp.one_of("V= I=") + law,
        device("s") + four + WORD,
        device("x") + pp.OneOrMore(NODE + ~pp.FollowedBy("=")) + pp.Optional(keyword + pairs),
        ".subckt" + pp.OneOrMore(NODE + ~pp.FollowedBy("=")) + pp.Optional(keyword + pairs),
        ".ends" + pp.Optional(WORD),
        ".param" + pairs,
        ".model" + WORD + model,
        ".include" + pp.Regex(r"\S+"),
        ".tran" + pp.OneOrMore(value) + pp.Optional(pp.CaselessKeyword("UIC")),
        ".ac" + pp.one_of("lin dec oct", caseless=True) + value + value + value,
        ".dc" + pp.OneOrMore(WORD + value + value + value),
        pp.one_of(".ic .nodeset") + pp.OneOrMore(pp.Regex(r"V\([\w:]+\)=\S+")),
        option, output, measure, pp.Keyword(".op"), pp.Keyword(".end"),
    ]) + pp.StringEnd()  # fmt: skip


def cards(text):
    """Logical lines of a netlist, read without the product's reader."""
    lines = [line for line in text.splitlines() if line.strip() and not line.startswith("*")]
    joined = "\n".join(lines).replace("\n+", " ")
    return joined.splitlines()


@pytest.mark.parametrize("dialect", ["xyce", "ltspice"])
def test_every_card_of_the_loop_is_in_the_grammar(loop, dialect):
    card = grammar(dialect)
    translated = write_dialect_files(loop, dialect)
    assert set(translated) == set(loop.files)
    for name, text in translated.items():
        before, after = len(cards(loop.files[name])), len(cards(text))
        if name != loop.main_file_name:  # .save cards are merged and options dropped there
            assert before == after
        for line in cards(text):
            card.parse_string(line)


PRESSED = ContactForce(
    1e9, 1.5, curve=(1.0, 0.2, -0.1, 0.1, 0.0, 0.1), depth=1e-5, pace=1e-8, radius=1e-3
)
LAWS = {
    "hertz": ContactForce(1e9, 1.5), "damped": ContactForce(1e7, damping=0.5),
    "hertz, damped": ContactForce(1e9, 1.5, damping=0.5), "dry": ContactForce(1e7, friction=0.3),
    "pressure": PRESSED,
}  # fmt: skip


def pressing(law):
    header = Header("laws", "0")
    return declared(header, "contact", declare_contact(("patch",), (0.0,), law), {})


@pytest.mark.parametrize("dialect", ["xyce", "ltspice"])
def test_every_law_of_a_contact_is_in_the_grammar(dialect):
    card = grammar(dialect)
    for law in LAWS.values():
        part = pressing(law)
        text = find_dialect(dialect)().format_file(part.circuit)
        assert len(cards(text)) == len(cards(part.text))
        for line in cards(text):
            card.parse_string(line)


@pytest.mark.parametrize("dialect", ["xyce", "ltspice"])
def test_the_grammar_refuses_ngspice(loop, dialect):
    """Otherwise the test above could not fail."""
    card = grammar(dialect)
    refused = 0
    for text in loop.files.values():
        for line in cards(text):
            try:
                card.parse_string(line)
            except pp.ParseException:
                refused += 1
    assert refused > 20


# ------------------------------------------------------------------------------- constructs


def one(cards_):
    text = f"* title\n{cards_}\n.tran 1 1\n.end\n"
    return Deck(name="one", text=text)


REFUSED = [
    "B1 a 0 I=pwl(V(c), 0, 0, 1, 1)",  # ngspice goes on with the slope, a table stays flat
    "B1 a 0 I=pwl(V(c), 0, 1, 1, 1, 1)", "B1 a 0 I=limit(V(c), 0, 1)", "B1 a 0 I=V(b)*hertz",
    "E1 a 0 LAPLACE {V(b)} {1/(1+s)}", ".model d D(IS=1e-14 LEVEL=3)", ".csparam c=1",
    ".model n NMOS(LEVEL=49)", ".control\n.endc", "Z1 a b c d", "A1 a b c", ".width out=80",
    ".save @m1[gm]", ".save nothing", "V1 a 0 PWL(file=x)", "R1 a 0 1 scale=2", "C1 a 0 1u tc3=1",
]  # fmt: skip


@pytest.mark.parametrize("dialect", ["xyce", "ltspice"])
def test_constructs_that_a_dialect_lacks_are_rejected(dialect):
    for source in REFUSED:
        with pytest.raises(UsageError) as caught:
            translate_deck(one(source), dialect)
        assert "one.cir:2" in str(caught.value), source


def test_switches_that_xyce_does_not_have_are_refused():
    for values in ("VT=0.5 VH=0.1", "VT={k}"):
        deck = one(f".model m SW({values})")
        with pytest.raises(UsageError, match=r"hysteresis|threshold"):
            translate_deck(deck, "xyce")
        assert values in translate_deck(deck, "ltspice").files["one.cir"]


def xyce(cards_, **facts):
    """``(text, results)`` of a deck in Xyce's words."""
    spoken = translate_deck(Deck(name="one", text=f"* title\n{cards_}\n.end\n", **facts), "xyce")
    return spoken.files["one.cir"], spoken.vectors


def test_decks_for_xyce_contain_its_deviations():
    """Each of these was seen in runs of Xyce 7.10 against ngspice."""
    touch = ".subckt touch a b\nC1 a b 1u IC=0\n.ends\nX1 n 0 touch\nR1 n 0 1\n.tran 1u 1m"
    started, resting = xyce(f"{touch} 0 1u uic")[0], xyce(touch)[0]
    assert "IC=0" in started  # which it obeys without uic, too
    assert "IC=0" not in resting
    assert (".nodeset V(n)=0" in started, ".nodeset V(n)=0" in resting) == (False, True)
    for given, written in (("1e-3", "1e-05"), ("1e-5", "1e-06")):
        assert f"reltol={written}\n" in xyce(f".options reltol={given}\n.tran 1u 1m")[0]
        assert f"reltol={given}\n" in xyce(f".options reltol={given}\n.op")[0]
    for controlled, ceiling in ((True, "1e-06"), (False, "0.0002")):
        assert f" 0 {ceiling}\n" in xyce(".tran 1u 1m 0 0.0002", may_have_loop=controlled)[0]
    *_, points, start, stop = xyce(".ac dec 7 10 900")[0].splitlines()[1].split()
    last = float(start) * 10 ** (math.floor(int(points) * math.log10(float(stop) / 10)) / 7)
    assert 900 <= last < 900 * 10 ** (1 / 7)
    _, results = xyce(".op", vectors={"d": ("v(a)-v(b)-@b.x1.c[i]", 2.0)})
    assert results["d"] == ("V(a)-V(b)-I(x1:c)", 2.0)


def test_unknown_dialects_are_refused(loop):
    with pytest.raises(UsageError, match="this dialect does not exist") as caught:
        translate_deck(loop, "hspice")
    assert caught.value.expected == "one of " + ", ".join(list_dialect_names())


# ---------------------------------------------------------------------------------- meaning


def flat(x, *points):
    return float(np.interp(x, points[::2], points[1::2]))


def logic(v, b, c, k):
    """Logic as ngspice computes it: every number but zero is true."""
    return 3.0 if (v > 1 or c == 0) and b != 0 and k != 7 else -2.0


TREES = {  # of v = V(a,b) …, as ngspice 46 documents its functions
    "B1 x 0 I=k*V(a)^3-V(b)**2": lambda a, b, c, k: k * abs(a) ** 3 - abs(b) ** 2,
    "B1 x 0 I=pow(V(a),3)/{k^2}": lambda a, b, c, k: abs(a) ** 3 / k**2,
    "B1 x 0 I=(V(a)>1||V(c)==0)&&V(b)&&!(k==7)?3:-2": logic,
    "B1 x 0 I=V(b)!=0?V(a):k": lambda a, b, c, k: a if b != 0 else k,
    "E1 x 0 vol='V(a)*exp(-V(b))'": lambda a, b, c, k: a * math.exp(-b),
    "G1 x 0 value={0.0/(k+V(a))+1*V(b)+e}": lambda a, b, c, k: b + math.e,
    "G1 x 0 POLY(2) a 0 b 0 1 2 3 4 5 6":
        lambda a, b, c, k: 1 + 2 * a + 3 * b + 4 * a * a + 5 * a * b + 6 * b * b,
    "B1 x 0 I=!0+(-0)*V(a)+(+V(b))": lambda a, b, c, k: 1 + b,
    "E1 x 0 POLY(1) a 0 2": lambda a, b, c, k: 2 * a,
    "E1 x 0 TABLE {V(a)} = (-1,3) (1,4)": lambda a, b, c, k: flat(a, -1, 3, 1, 4),
}  # fmt: skip


@pytest.mark.parametrize("dialect", ["xyce", "ltspice"])
def test_expressions_have_equal_values_in_all_spellings(dialect):
    known = {"if_": lambda test, yes, no: yes if test else no, "abs": abs, "exp": math.exp,
             "pow": pow, "max": max, "table": flat}  # fmt: skip
    for card, expected in TREES.items():
        text = translate_deck(one(card), dialect).files["one.cir"].partition("\n")[2]
        written = text.replace("\n+", "").splitlines()[0].split("=", 1)[1]
        law = re.sub(r"V\((\w)(,0)?\)", r"\1", written.replace("if(", "if_("))
        law = law.replace("{", "(").replace("}", ")")
        for a in (-1.5, 0.0, 0.5, 2.0):
            for b, c, k in ((0.0, 0.0, 2.0), (0.3, 1.0, 7.0), (-1.0, 0.0, 2.0)):
                got = eval(law, known | {"a": a, "b": b, "c": c, "k": k})
                assert got == pytest.approx(expected(a, b, c, k), rel=1e-14), (card, written)


def test_libraries_for_ltspice_run_the_same_in_ngspice(loop, tmp_path):
    """ngspice reads all of LTspice's spellings but ``table``, so it can judge the rest."""
    spoken = translate_deck(loop, "ltspice").files
    files = {n: t.replace("table(", "pwl(") for n, t in spoken.items() if n != loop.main_file_name}
    short = loop.files[loop.main_file_name].replace(" 5m 0 ", " 700u 0 ")
    own = replace(loop, text=short, options=(), stop=0.0007)
    twin = replace(own, parts=(), more=files)
    first, second = run_deck(own, tmp_path / "own"), run_deck(twin, tmp_path / "twin")
    assert first["contact.force"].max() > 1.0
    # the same equations, rounded differently where braces become numbers: contact multiplies it
    at = np.linspace(0, 0.0007, 701)
    for key in ("sphere.y", "kick.u.ring0", "coil.upper.current"):
        one_, two = (np.interp(at, w["time"], w[key]) for w in (first, second))
        np.testing.assert_allclose(two, one_, rtol=0, atol=2e-4 * np.ptp(one_))


@pytest.mark.parametrize(
    ("dialect", "name"), [("xyce", "xmass:place_x"), ("ltspice", "mass:place_x")]
)
def test_start_values_name_nodes_as_results_do(dialect, name):
    """A start value at a node within a subcircuit was printed in the words of ngspice."""
    body = ".subckt body x\nC1 x place_x 1u\nR1 place_x 0 1k\n.ends\nXmass a body\nRa a 0 1k"
    cards = f"{body}\n.save v(xmass.place_x)\n.ic v(xmass.place_x)=200 v(a)=1\n.tran 1u 1m"
    deck = Deck(name="one", text=f"* title\n{cards}\n.end\n")
    text = translate_deck(deck, dialect).files["one.cir"]
    assert f".ic V({name})=200 V(a)=1\n" in text
    others = [line for line in text.splitlines() if not line.startswith(".ic")]
    assert any(f"V({name})" in line for line in others)  # as a result


# Numbers on cards as ngspice 39 reads them (print of @r1[resistance]), and the double that each is.
READ_BY_NGSPICE = {
    "5Meg": 5e6, "1M": 1e-3, "3mil": 3 * 25.4e-6, "2a": 2.0, "4x": 4.0, "10Ohm": 10.0,
    "1kOhm": 1e3, "2.5uF": 2.5e-6, "7e3Hz": 7e3, "1e-3": 1e-3, "47": 47.0,
}  # fmt: skip
# Scale factors that the manuals of LTspice and Xyce both have.
SHARED = {"t": 1e12, "g": 1e9, "meg": 1e6, "k": 1e3, "m": 1e-3, "u": 1e-6, "n": 1e-9, "p": 1e-12,
          "f": 1e-15, "": 1.0}  # fmt: skip


@pytest.mark.parametrize("dialect", ["xyce", "ltspice"])
@pytest.mark.parametrize("word", READ_BY_NGSPICE)
def test_a_number_is_the_same_double_in_all_dialects(word, dialect):
    """No letters remain but scale factors that every simulator reads alike: LTspice has no atto."""
    card = translate_deck(one(f"R1 a 0 {word} noisy=0"), dialect).files["one.cir"].splitlines()[1]
    *_, written = card.split()
    digits, letters = re.fullmatch(r"([\d.]+(?:e[-+]?\d+)?)([a-z]*)", written.lower()).groups()
    assert float(digits) * SHARED[letters] == pytest.approx(READ_BY_NGSPICE[word], rel=1e-15)


# Commands, and the doubles that ngspice reads on them.
COMMANDS = {
    ".tran 1us 10ms 0 2a uic": [1e-6, 1e-2, 0.0, 2.0],
    ".ac dec 10 1Hz 1000Hz": [10.0, 1.0, 1000.0],
    ".dc V1 0 3mil 1mil": [0.0, 3 * 25.4e-6, 25.4e-6],
    ".ic v(a)=2mil": [2 * 25.4e-6],
    ".options reltol=10a": [10.0],
}


@pytest.mark.parametrize("card", COMMANDS)
def test_numbers_of_commands_have_no_letters(card):
    """Every number is one that ``float`` reads; Xyce changes ends of ranges, steps and reltol."""
    keyword = card.split()[0]
    analysis = "" if keyword in (".tran", ".ac", ".dc") else ".op\n"
    deck = Deck(name="one", text=f"* title\nV1 a 0 1\nR1 a 0 1k\n{card}\n{analysis}.end\n")
    for dialect in ("ltspice", "xyce"):
        lines = translate_deck(deck, dialect).files["one.cir"].splitlines()
        (written,) = filter(re.compile(rf"{re.escape(keyword)}\b").match, lines)
        values = [float(text) for text in re.findall(r"(?<=[ =])\d\S*", written)]
        assert len(values) == len(COMMANDS[card])
        if dialect == "ltspice":
            assert values == pytest.approx(COMMANDS[card], rel=1e-15)


def test_modules_of_verilog_a_have_numbers_without_letters():
    """Verilog-A reads M as mega and has no Meg, so that modules have plain numbers."""
    cards_ = "R1 a b 5Meg\nR2 a b 1M\nC1 a b 2mil\nB1 a b I=V(a,b)*3a+4Ohm"
    (part,) = parse_subcircuits(f"* load\n.subckt load a b\n{cards_}\n.ends load\n", "load.lib")
    (module,) = format_module(part).values()
    numbers = re.findall(r"(?<![\w.])\d[\w.]*(?:(?<=e)-\d+)?", module)
    assert list(map(float, numbers)) == [5e6, 1e-3, 2 * 25.4e-6, 3.0, 4.0]


def test_a_refusal_names_one_action():
    with pytest.raises(UsageError) as caught:
        translate_deck(one("R1 a 0 1 scale=2"), "xyce")
    assert "parameter scale of this R card" in str(caught.value)
    assert caught.value.hint.startswith("rewrite this card")
