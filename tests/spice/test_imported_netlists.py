"""Circuits for LTspice and PSpice, imported and run in ngspice, against integration by scipy.

The references share no code with the importer: they state what the help pages of LTspice say of
each element and function, in numpy.
"""

import math
import random
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from support import UsageError, read_cards, translate_circuit

import kc2spice as kc


def run(folder, library, scene, syntax="ltspice"):
    """The result of a scene with the part ``own`` of subcircuit ``own``."""
    (folder / "own.lib").write_text(library, encoding="utf-8")
    head = f'[own]\npart = "netlist"\nfile = "own.lib"\nsubckt = "own"\nsyntax = "{syntax}"\n'
    (folder / "scene.toml").write_text(head + scene, encoding="utf-8")
    return kc.run(folder / "scene.toml")


# --- the ideal diode ----------------------------------------------------------------------------


def diode_current(v, ron=1.0, roff=1e12, vfwd=0.0, vrev=math.inf, rrev=None, eps=0.0, reps=0.0,
                  ilimit=math.inf, rlimit=math.inf):  # fmt: skip
    """Slopes by region, integrated: off from -vrev to vfwd, ramps of widths eps and reps beyond."""
    rrev = ron if rrev is None else rrev

    def slope(x):
        if x >= vfwd:
            part = min(1.0, (x - vfwd) / eps) if eps else 1.0
            return 1 / roff + part * (1 / ron - 1 / roff)
        if x <= -vrev:
            part = min(1.0, (-vrev - x) / reps) if reps else 1.0
            return 1 / roff + part * (1 / rrev - 1 / roff)
        return 1 / roff

    corners = sorted({0.0, v, *(c for c in (vfwd, vfwd + eps, -vrev, -vrev - reps)
                                if min(0, v) < c < max(0, v))})  # fmt: skip
    middles = [(a + b) / 2 for a, b in pairwise(corners)]
    widths = np.diff(corners)
    total = sum(w * slope(m) for w, m in zip(widths, middles, strict=True)) * np.sign(v)
    limit = ilimit if total > 0 else rlimit
    return float(total if math.isinf(limit) else limit * math.tanh(total / limit))


@pytest.mark.parametrize(
    ("model", "settings"),
    [
        ("Ron=0.5 Roff=1k Vfwd=0.7", {"ron": 0.5, "roff": 1e3, "vfwd": 0.7}),
        ("Ron=2 Vfwd=1 Vrev=2 Rrev=5 Roff=1Meg",
         {"ron": 2, "vfwd": 1, "vrev": 2, "rrev": 5, "roff": 1e6}),
        ("Ron=1 Vfwd=.5 Vrev=1 Roff=1Meg epsilon=1 revepsilon=.6",
         {"vfwd": 0.5, "vrev": 1, "roff": 1e6, "eps": 1, "reps": 0.6}),
        ("Ron=.1 Vfwd=.5 Vrev=1 Roff=1Meg Ilimit=1 RevIlimit=2",
         {"ron": 0.1, "vfwd": 0.5, "vrev": 1, "roff": 1e6, "ilimit": 1, "rlimit": 2}),
    ],
)  # fmt: skip
def test_an_ideal_diode_has_its_lines_transitions_and_limits(model, settings, tmp_path):
    library = f".subckt own a\nD1 a 0 X\n.model X D({model})\n.ends\n"
    result = run(tmp_path, library, """pins = { a = "v.out" }
[v]
part = "source"
[analysis]
type = "dc"
sweep = "v.dc"
from = -3
to = 3
points = 121
""")  # fmt: skip
    volts = np.linspace(-3, 3, 121)
    expected = np.array([diode_current(v, **settings) for v in volts])
    # gmin is 1e-12 S; Newton's method stops at a change of 1e-3 of a curved characteristic.
    rel = 1e-3 if "Ilimit" in model or "epsilon" in model else 2e-6
    assert result.waves["v.i"] == pytest.approx(expected, rel=rel, abs=1e-11)


def test_a_bridge_of_ideal_diodes_charges_its_capacitor(tmp_path):
    library = """* a bridge rectifier
.subckt own p n plus minus
D1 p plus IDEAL
D2 n plus IDEAL
D3 minus p IDEAL
D4 minus n IDEAL
C1 plus minus 47n
.model IDEAL D(Ron=0.5 Roff=100Meg Vfwd=0.25 Vrev=60)
.ends own
"""
    result = run(tmp_path, library, """
pins = { p = "g.out", n = "g.ret", plus = "load.a", minus = "gnd" }
[load]
part = "resistor"
resistance = "10 kOhm"
[g]
part = "source"
sine = { amplitude = "3 V", frequency = "10 kHz" }
[analysis]
stop = "2 ms"
[solver]
max_step = "0.1 us"
""")  # fmt: skip

    def slope(t, y):
        across = abs(3 * np.sin(2e4 * np.pi * t)) - y[0]
        current = diode_current(across / 2, ron=0.5, roff=1e8, vfwd=0.25)
        return [(current - y[0] / 1e4) / 47e-9]

    exact = solve_ivp(slope, (0, 2e-3), [0], "LSODA", max_step=2e-7, rtol=1e-9, atol=1e-10)
    time, volts = result.waves["time"], result.waves["load.v"]
    off = np.abs(np.interp(exact.t, time, volts) - exact.y[0]).max()
    assert off < 2e-3 * 2.5


# --- parasitic elements -------------------------------------------------------------------------

SWEEP = """pins = { a = "drive.out" }
[drive]
part = "source"
ac = 1
[analysis]
type = "ac"
start = 1e3
stop = 1e8
points = 51
"""


def beside(*impedances):
    return 1 / sum(1 / z for z in impedances)


@pytest.mark.parametrize(
    ("card", "impedance"),
    [
        ("C1 a 0 10n Rser=20m Lser=3n Rpar=1Meg Cpar=2p RLshunt=5",
         lambda s: beside(0.02 + beside(3e-9 * s, 5) + 1 / (1e-8 * s), 1e6, 1 / (2e-12 * s))),
        ("L1 a 0 10µ Rser=0.1 Rpar=2k Cpar=15p",
         lambda s: beside(0.1 + 1e-5 * s, 2e3, 1 / (15e-12 * s))),
        ('C1 a 0 22u V=16 Irms=2.5 Rser=20m Lser=3n mfg="Würth" pn="885 012" type="X5R"',
         lambda s: 0.02 + 3e-9 * s + 1 / (2.2e-5 * s)),
        ('L1 a 0 10µ Ipk=2 Rser=0.05 Rpar=1k Cpar=2p mfg="Coilcraft" pn="DO3316P"',
         lambda s: beside(0.05 + 1e-5 * s, 1e3, 1 / (2e-12 * s))),
        ("R1 a 0 4k7 tol=1 pwr=0.1", lambda s: 4700 + 0 * s),
        ("L1 a 0 4u7", lambda s: 4.7e-6 * s + 1e-3),
        ("L1 a 0 4u7 Rser=0", lambda s: 4.7e-6 * s),
        ("R1 a 0 4k7", lambda s: 4700 + 0 * s),
        ("V1 a b 0 Rser=50 Cpar=1n\nR1 b 0 10", lambda s: 10 + beside(50, 1 / (1e-9 * s))),
        ("B1 a 0 I=V(a)/1k Cpar=1n Rpar=3k tripdv=1 tripdt=1n",
         lambda s: beside(1e3, 3e3, 1 / (1e-9 * s))),
        ("R1 a 0 R=2*(100+0*V(a))", lambda s: 200 + 0 * s),
    ],
)  # fmt: skip
def test_parasitic_elements_have_the_impedance_of_their_circuit(card, impedance, tmp_path):
    result = run(tmp_path, f".subckt own a\n{card}\n.ends\n", SWEEP)
    s = 2j * np.pi * result.waves["frequency"].real
    current = result.waves["drive.i"]
    assert np.abs(current * impedance(s) - 1).max() < 1e-6


# --- functions ----------------------------------------------------------------------------------


def median(x, a, b):
    return sorted((x, a, b))[1]


def table(x, *points):
    return float(np.interp(x, points[::2], points[1::2]))


MEANINGS = {
    "limit": median, "table": table, "if_": lambda c, a, b: a if c > 0.5 else b,
    "pwr": lambda x, y: abs(x) ** y, "pwrs": lambda x, y: math.copysign(abs(x) ** y, x),
    "int_": math.trunc, "hypot": math.hypot, "sgn": lambda x: (x > 0) - (x < 0),
    "u": lambda x: float(x > 0), "uramp": lambda x: max(x, 0.0),
    "buf": lambda x: float(x > 0.5), "inv": lambda x: float(x <= 0.5),
    "abs": abs, "min": min, "max": max, "exp": math.exp, "tanh": math.tanh, "sqrt": math.sqrt,
    "log": math.log, "arctan": math.atan,
}  # fmt: skip


def drawn(rng, depth):
    """A random expression as LTspice writes it, and as Python reads it."""
    if depth == 0:
        value = round(rng.uniform(-2, 2), 2)
        return rng.choice((("V(a)", "va"), ("V(b)", "vb"), (f"({value})", f"({value})")))
    x, y, z = (drawn(rng, depth - 1) for _ in range(3))
    name = rng.choice((
        "+", "*", "limit", "if", "if_number", "table", "pwrs", "pwr", "power", "hypot", "int",
        "and", "or", "not", "buf", "inv", "uramp", "abs", "min", "max", "tanh", "sqrt", "log",
        "arctan",
    ))  # fmt: skip
    match name:
        case "+" | "*":
            return f"({x[0]}{name}{y[0]})", f"({x[1]}{name}{y[1]})"
        case "if":
            return (f"if({x[0]}<{y[0]},{z[0]},{x[0]})", f"if_({x[1]}<{y[1]},{z[1]},{x[1]})")
        case "if_number":
            return f"if({x[0]},{y[0]},{z[0]})", f"if_({x[1]},{y[1]},{z[1]})"
        case "limit":
            return tuple(f"limit({x[k]},{y[k]},{z[k]})" for k in (0, 1))
        case "table":
            points = "-1,0.5,0,-1,0.7,2"
            return f"table({x[0]},{points})", f"table({x[1]},{points})"
        case "pwrs" | "pwr":
            return f"{name}({x[0]},1.5)", f"{name}({x[1]},1.5)"
        case "power":
            n = rng.choice((2, 3, 5))
            return f"({x[0]})**{n}", f"(({x[1]})**{n})"
        case "int":
            return f"int({x[0]})", f"int_({x[1]})"
        case "and" | "or":
            sign = {"and": "&", "or": "|"}[name]
            return (f"(({x[0]}>0) {sign} ({y[0]}))",
                    f"float((({x[1]})>0) {name} (({y[1]})>0.5))")  # fmt: skip
        case "not":
            return f"(!({x[0]}))", f"float(not (({x[1]})>0.5))"
        case "hypot" | "min" | "max":
            return tuple(f"{name}({x[k]},{y[k]})" for k in (0, 1))
        case "sqrt":
            return tuple(f"sqrt(abs({x[k]}))" for k in (0, 1))
        case "log":
            return tuple(f"log(abs({x[k]})+0.1)" for k in (0, 1))
    return f"{name}({x[0]})", f"{name}({x[1]})"


def evaluated(text, va, vb):
    return float(eval(text, {"__builtins__": {"float": float}}, MEANINGS | {"va": va, "vb": vb}))


def is_smooth(text, va, vb):
    """Whether a small change of the inputs changes little: no step of the expression lies there."""
    values = [evaluated(text, va + da, vb + db) for da in (-1e-5, 1e-5) for db in (-1e-5, 1e-5)]
    return max(values) - min(values) < 1e-3 * (1 + abs(values[0]))


@pytest.mark.parametrize("seed", range(4))
def test_random_expressions_have_the_values_that_ltspice_defines(seed, tmp_path):
    rng = random.Random(seed)
    va, vb = 0.37 + seed * 0.29, -1.13 + 0.41 * seed
    pairs = []
    while len(pairs) < 60:
        pair = drawn(rng, rng.choice((1, 2, 3)))
        if abs(evaluated(pair[1], va, vb)) < 1e4 and is_smooth(pair[1], va, vb):
            pairs.append(pair)
    cards = [f"B{k} n{k} 0 V={text}\nR{k} n{k} 0 1k" for k, (text, _) in enumerate(pairs)]
    library = "\n".join((".subckt own a b", *cards, ".ends", ""))
    probes = "\n".join(f'[probes.p{k}]\nof = "own.n{k}"\ntake = "final"' for k in range(60))
    result = run(tmp_path, library, f"""pins = {{ a = "va.out", b = "vb.out" }}
[va]
part = "source"
dc = {va}
[vb]
part = "source"
dc = {vb}
[analysis]
type = "op"
{probes}
""")  # fmt: skip
    for k, (text, python) in enumerate(pairs):
        assert result.metrics[f"p{k}"] == pytest.approx(
            evaluated(python, va, vb), rel=1e-6, abs=1e-6
        ), text


# --- PSpice: an operational amplifier by its equations ------------------------------------------


def test_a_pspice_amplifier_slews_and_clips_by_its_equations(tmp_path):
    """``c dv/dt = limit(gm (in - v), +-i) - v/r``, the output within its rails."""
    library = """* PSpice
.subckt own plus out params: rail=5 slew=2e6
.func sat(x, m) {LIMIT(x, -m, m)}
Gstage 0 c VALUE={sat(1e-3*(V(plus)-V(c)), slew*1e-9)}
Cc c 0 1n
Rc c 0 1meg
Eout drive 0 VALUE={TABLE(V(c), -rail, -rail, rail, rail)}
Rout drive out 10
.ends own
"""
    result = run(tmp_path, library, """pins = { plus = "g.out", out = "load.a" }
[load]
part = "resistor"
resistance = 90
[g]
part = "source"
pwl = [[0, 0], ["1 us", 0], ["1.1 us", 8], ["10 us", 8], ["10.1 us", -3]]
[analysis]
stop = "20 us"
[solver]
max_step = "20 ns"
""", "pspice")  # fmt: skip

    def command(t):
        return np.interp(t, [0, 1e-6, 1.1e-6, 1e-5, 1.01e-5], [0, 0, 8, 8, -3])

    def slope(t, v):
        return [(median(1e-3 * (command(t) - v[0]), -2e-3, 2e-3) - v[0] / 1e6) / 1e-9]

    exact = solve_ivp(slope, (0, 2e-5), [0], "LSODA", max_step=1e-8, rtol=1e-9, atol=1e-9)
    out = 0.9 * np.clip(exact.y[0], -5, 5)
    off = np.interp(exact.t, result.waves["time"], result.waves["load.v"]) - out
    assert np.abs(off).max() < 5e-3 * 5


# --- VDMOS: a transistor that discharges a capacitor ---------------------------------------------


def test_a_vdmos_discharges_a_capacitor_by_its_square_law(tmp_path):
    """``kp ((vgs - vto) vds - vds^2 / 2)``, in saturation ``kp (vgs - vto)^2 / 2``, behind ``Rd``.
    Ratings and maker of the model are of no equation."""
    library = """.subckt own d g
M1 d g 0 SW
.model SW VDMOS(nchan Vto=2 Kp=4 Rd=0.05 Rs=0 Rg=3 Lambda=0 Cgdmax=.5n Cgdmin=.05n Cgs=1n A=1
+ Cjo=.3n Rds=1e9 Vds=60 Ron=10m Qg=20n mfg=Nobody)
.ends own
"""
    result = run(tmp_path, library, """pins = { d = "push.out", g = "gate.out" }
[store]
part = "capacitor"
capacitance = "10 uF"
pins = { a = "push.out", b = "gnd" }
[push]
part = "source"
kind = "current"
pulse = { high = 10, width = "10 us", edge = "10 ns" }
[gate]
part = "source"
pulse = { high = 4, width = "1 ms", edge = "10 ns", start = "15 us" }
[analysis]
stop = "40 us"
[solver]
max_step = "20 ns"
""")  # fmt: skip

    def current(v, gate):
        on, r = max(gate - 2.0, 0.0), 0.05
        if v - r * 2 * on**2 >= on:
            return 2 * on**2
        b = 4 * on + 1 / r  # of 2 vds^2 - b vds + v / r = 0
        return (v - (b - math.sqrt(b**2 - 8 * v / r)) / 4) / r

    def slope(t, v):
        push = np.interp(t, [0, 1e-8, 1e-5, 1.001e-5], [0, 10, 10, 0])
        gate = np.interp(t, [1.5e-5, 1.501e-5], [0, 4])
        return [(push - current(v[0], gate)) / 1e-5]

    exact = solve_ivp(slope, (0, 4e-5), [0], "LSODA", max_step=2e-8, rtol=1e-8, atol=1e-8)
    off = np.interp(exact.t, result.waves["time"], result.waves["store.v"]) - exact.y[0]
    assert np.abs(off).max() < 1e-2 * 10


# --- what has no equal --------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("card", "message"),
    [
        ("B1 a 0 V=delay(V(a), 1u)", "a delay of a voltage has no equivalent"),
        ("B1 a 0 I=idt(V(a))", "a time integral has no equivalent"),
        ("B1 a 0 I=V(a)^3", r"reads \^ as exclusive or"),
        ("B1 a 0 I=V(a)**1.5", "a power with a base that can be negative"),
        ("C1 a 0 Q=1n*x", "a capacitor with a charge expression"),
        ("L1 a 0 Flux=1n*x", "an inductor with a flux expression"),
        ("E1 a 0 a 0 Laplace=1/(1+s)", "Laplace transform"),
        ("S1 a 0 a 0 X\n.model X SW(Ron=1 Roff=1Meg Vt=1 Vh=-.2)", "opens gradually"),
        ("S1 a 0 a 0 X\n.model X SW(Ron=1 Roff=1Meg Ilimit=1)", "ilimit of a switch"),
        ("B1 a 0 I=V(a) laplace=1/(1+s)", "laplace of a behavioural source"),
        ("D1 a 0 X\n.model X ako:Y D()", "the base model of this model is missing"),
        ("A1 a 0 0 0 0 0 b 0 AND", "an A device of LTspice"),
        ("I1 a 0 1 load", "a current source with the option `load`"),
    ],
)
def test_constructs_without_an_equivalent_are_rejected_with_their_line(card, message):
    text = f".subckt own a\nR1 a 0 1\n{card}\n.ends\n"
    with pytest.raises(UsageError, match=message) as caught:
        translate_circuit(read_cards(text, "own.lib"), "ltspice")
    assert caught.value.where.startswith("own.lib:")


def test_pspice_has_no_unit_in_place_of_the_decimal_point():
    """The card stays as it is, and the check of the whole deck names what ngspice would read."""
    resistor = translate_circuit(read_cards("R1 a 0 4k7\n", "r.lib"), "pspice").items[0]
    assert resistor.values == ("4k7",)


def test_a_model_begins_with_another_one():
    text = ".model base NPN(Bf=100 Is=1f)\n.model own ako:base NPN(Bf=200 mfg=X)\nQ1 c b e own\n"
    models = translate_circuit(read_cards(text, "m.lib"), "ltspice").items[:2]
    assert models[1].type.lower() == "npn"
    assert models[1].parameters == {"bf": "200", "is": "1f"}


def test_a_current_of_any_element_can_be_read(tmp_path):
    """``I(R1)`` of 3 V across 1 kOhm and 2 kOhm, a thousand times as a voltage."""
    library = ".subckt own a o\nR1 a m 1k\nR2 m 0 2k\nB1 o 0 V=1000*I(R1)\n.ends\n"
    result = run(tmp_path, library, """pins = { a = "v.out", o = "load.a" }
[v]
part = "source"
dc = 3
[load]
part = "resistor"
resistance = 1000
[analysis]
type = "op"
""")  # fmt: skip
    assert result.waves["load.v"][0] == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize(
    ("cards", "exact"),
    [
        ("C1 a 0 10n Rpar=1k Cpar=5n", lambda s: 15e-9 * s + 1e-3),
        ("L1 a 0 1m Rser=5 Rpar=200", lambda s: 1 / (5 + 1e-3 * s) + 5e-3),
        ("D1 a 0 X\n.model X D(Ron=10 Roff=1k Vfwd=5)", lambda s: 1e-3 + 0 * s),
        ("R1 a 0 R=100+0*V(a)", lambda s: 1e-2 + 0 * s),
        ("B1 a 0 I=V(a)/50 Rpar=100", lambda s: 0.03 + 0 * s),
        ("C1 a 0 10n Rser=50 Rpar=1k m=2", lambda s: 2 / (50 + 1 / (1e-8 * s)) + 2e-3),
    ],
)
def test_the_current_of_an_element_includes_its_parasitic_elements(cards, exact, tmp_path):
    """LTspice's ``I(C1)`` is the current at the terminals; ``m`` counts whole elements."""
    name = cards.split()[0]
    library = f".subckt own a o\nB9 o 0 V=1000*I({name})\n{cards}\n.ends\n"
    scene = SWEEP.replace('pins = { a = "drive.out" }', 'pins = { a = "drive.out", o = "load.a" }')
    result = run(tmp_path, library, scene + '[load]\npart = "resistor"\nresistance = 1000\n')
    admittance = exact(2j * np.pi * result.waves["frequency"].real)
    assert np.abs(result.waves["load.v"] / 1000 / admittance - 1).max() < 1e-6


def test_ratings_become_a_comment():
    text = "C1 a 0 1u V=25 mfg=KEMET ic=2\n"
    capacitor = translate_circuit(read_cards(text, "own.lib"), "ltspice").items[0]
    assert capacitor.parameters == {"ic": "2"}
    assert capacitor.notes == ("* C1: the equations do not contain V=25 mfg=KEMET",)


def switch_resistance(control, on, off, high, low):
    """PSpice's reference guide: ``exp(Lm + 3 Lr (c - m) / (2 d) - 2 Lr (c - m)^3 / d^3)``."""
    mean, ratio = math.log(math.sqrt(on * off)), math.log(on / off)
    middle, width = (high + low) / 2, high - low
    x = np.clip((control - middle) / width, -0.5, 0.5)
    return math.exp(mean + 1.5 * ratio * x - 2 * ratio * x**3)


@pytest.mark.parametrize("control", [-0.3, 0.05, 0.2, 0.35, 0.5, 0.9])
@pytest.mark.parametrize(("high", "low"), [(0.7, 0.0), (0.1, 0.6)])
@pytest.mark.parametrize("kind", ["S", "W"])
def test_a_gradual_switch_of_pspice_has_its_resistance(kind, high, low, control, tmp_path):
    """The control of W is the current through 1 Ohm, so that its numbers are those of S."""
    ends = "Von={0} Voff={1}" if kind == "S" else "Ion={0} Ioff={1}"
    switch = "c 0" if kind == "S" else "Vsense"
    model = "VSWITCH" if kind == "S" else "ISWITCH"
    library = f""".subckt own a c
Rc c m 1
Vsense m 0 0
{kind}1 a 0 {switch} X
.model X {model}(Ron=50 Roff=1e9 {ends.format(high, low)})
.ends
"""
    scene = f"""pins = {{ a = "drive.out", c = "control.out" }}
[drive]
part = "source"
dc = 2
[control]
part = "source"
dc = {control}
[analysis]
type = "op"
"""
    result = run(tmp_path, library, scene, "pspice")
    exact = 2 / switch_resistance(control, 50, 1e9, high, low)
    assert result.waves["drive.i"][0] == pytest.approx(exact, rel=1e-6, abs=4e-12)


def test_a_switch_of_pspice_with_hysteresis_is_that_of_ngspice():
    text = "S1 a 0 c 0 X\n.model X VSWITCH(Ron=1 Roff=1Meg Vt=1 Vh=0.2)\n"
    switch, model = translate_circuit(read_cards(text, "own.lib"), "pspice").items
    assert (switch.kind, model.type) == ("s", "SW")
    assert model.parameters == {"Ron": "1", "Roff": "1Meg", "Vt": "1", "Vh": "0.2"}


@pytest.mark.parametrize("points", ["table=(-1, -1m, 0, 0, 2, 8m)", "table(-1 -1m, 0 0, 2 8m)"])
@pytest.mark.parametrize("drive", [-3, -0.5, 0.5, 1.5, 5])
def test_a_table_of_ltspice_is_linear_between_its_points(points, drive, tmp_path):
    scene = f"""pins = {{ a = "drive.out" }}
[drive]
part = "source"
dc = {drive}
[analysis]
type = "op"
"""
    library = f".subckt own a\nG1 a 0 a 0 {points}\n.ends\n"
    current = run(tmp_path, library, scene).waves["drive.i"][0]
    assert current == pytest.approx(np.interp(drive, [-1, 0, 2], [-1e-3, 0, 8e-3]), rel=1e-6)


def test_a_resistor_of_pspice_at_absolute_zero_has_no_noise():
    text = "R1 a 0 N 1k\n.model N RES(T_ABS=-273.15)\nD1 a 0 J\n.model J D(T_ABS=50)\n"
    resistor, quiet, diode, _ = translate_circuit(read_cards(text, "own.lib"), "pspice").items
    assert resistor.parameters == {"noisy": "0"}
    assert quiet.parameters == {}
    assert diode.parameters == {"temp": "50"}


# Controlled sources of PSpice, with their values at the voltages a and b. Va and Vb carry a / 10
# and b / 10. The load of 1 Ohm and the resistor of 1 Ohm in the subcircuit halve a current.
SOURCES = {
    "E1 o 0 POLY(2) (a,0) (b,0) 0 .5 .5": lambda a, b: 0.5 * a + 0.5 * b,
    "E1 o 0 poly(2) a 0 b 0 1 2 3 4 5 6":
        lambda a, b: 1 + 2 * a + 3 * b + 4 * a * a + 5 * a * b + 6 * b * b,
    "E1 o 0 POLY (1) (a b) -1 2": lambda a, b: -1 + 2 * (a - b),
    "E1 o 0 POLY(1) a 0 2": lambda a, b: 2 * a,
    "E1 o 0 POLY(1) a 0 {-k} {k * (1 + k)}": lambda a, b: -3 + 12 * a,
    "G1 0 o POLY(2) (a,0) (b,0) 0 .5 .5": lambda a, b: (0.5 * a + 0.5 * b) / 2,
    "F1 0 o POLY(2) Va Vb 1 2 3": lambda a, b: (1 + 0.2 * a + 0.3 * b) / 2,
    "F1 0 o POLY(1) Va 2": lambda a, b: 0.1 * a,
    "H1 o 0 POLY (1) (Va) 1 20": lambda a, b: 1 + 2 * a,
    "H1 o 0 POLY(1) Va 20": lambda a, b: 2 * a,
    "E1 o 0 VALUE={2*V(a)-1}": lambda a, b: 2 * a - 1,
    "E1 (o,0) VALUE = {-V(a)}": lambda a, b: -a,
    "E1 o 0 VALUE={5}": lambda a, b: 5 + 0 * a,
    "E1 o 0 VALUE={k}": lambda a, b: 3 + 0 * a,
    "E1 o 0 VALUE={(V(a)+1)*(V(b)+2)}": lambda a, b: (a + 1) * (b + 2),
    "E1 o 0 VALUE={2*I(Va)+1}": lambda a, b: 0.2 * a + 1,
    "E1 o 0 VALUE={0.5*V(a,b)+LIMIT(2*V(a),-1,1)}":
        lambda a, b: 0.5 * (a - b) + np.clip(2 * a, -1, 1),
    "E1 o 0 VALUE={0.5*V(b)+TABLE(V(a),-1,0,1,3)}":
        lambda a, b: 0.5 * b + np.clip(1.5 * (a + 1), 0, 3),
    "G1 0 o VALUE={2*V(a)-1}": lambda a, b: (2 * a - 1) / 2,
    "E1 o 0 (a,b) 2": lambda a, b: 2 * (a - b),
    "G1 (0,o) (a,b) {k}": lambda a, b: 1.5 * (a - b),
}  # fmt: skip


@pytest.mark.parametrize("syntax", ["pspice", "ltspice"])
@pytest.mark.parametrize("card", SOURCES)
def test_controlled_sources_of_other_simulators_have_their_values(card, syntax, tmp_path):
    library = (
        ".subckt own a b o params: k=3\nRa a ma 10\nVa ma 0 0\nRb b mb 10\nVb mb 0 0\n"
        f"Ro o 0 1\n{card}\n.ends\n"
    )
    result = run(tmp_path, library, """pins = { a = "va.out", b = "vb.out", o = "load.a" }
[load]
part = "resistor"
resistance = "1 Ohm"
[va]
part = "source"
[vb]
part = "source"
dc = "0.7 V"
[analysis]
type = "dc"
sweep = "va.dc"
from = -2
to = 2.5
points = 10
""", syntax)  # fmt: skip
    volts = np.linspace(-2, 2.5, 10)
    expected = SOURCES[card](volts, 0.7)
    assert result.waves["load.v"] == pytest.approx(expected, rel=1e-4, abs=1e-8)


# Boyle model (G. R. Boyle et al., IEEE J. Solid-State Circuits 9 (1974) 353) of an op-amp.
BOYLE = """
.subckt amp 1 2 3 4 5
c1 11 12 5.544E-12
c2 6 7 20.00E-12
dc 5 53 dx
de 54 5 dx
dlp 90 91 dx
dln 92 90 dx
dp 4 3 dx
egnd 99 0 poly(2) (3,0) (4,0) 0 .5 .5
fb 7 99 poly(5) vb vc ve vlp vln 0 15.91E6 -20E6 20E6 20E6 -20E6
ga 6 0 11 12 125.7E-6
gcm 0 6 10 99 7.067E-9
iee 3 10 dc 10.04E-6
hlim 90 0 vlim 1K
q1 11 2 13 qx
q2 12 1 14 qx
r2 6 9 100.0E3
rc1 4 11 7.957E3
rc2 4 12 7.957E3
re1 13 10 2.773E3
re2 14 10 2.773E3
ree 10 99 19.92E6
ro1 8 5 50
ro2 7 99 50
rp 3 4 30.31E3
vb 9 0 dc 0
vc 3 53 dc 2.100
ve 54 4 dc .6
vlim 7 8 dc 0
vlp 91 0 dc 40
vln 0 92 dc 40
.model dx D(Is=800.0E-18 Rs=1)
.model qx PNP(Is=800.0E-18 Bf=250)
.ends
"""


@pytest.mark.parametrize("syntax", ["pspice", "ltspice", "ngspice"])
def test_an_op_amp_macro_of_boyle_amplifies_by_its_feedback(syntax, tmp_path):
    library = BOYLE + (
        ".subckt own in out vcc\nX1 in fb vcc 0 out amp\nRf fb out 10k\nRg fb mid 10k\n"
        "Vm mid 0 1\n.ends\n"
    )
    result = run(tmp_path, library, """pins = { in = "sig.out", out = "load.a", vcc = "supply.out" }
[load]
part = "resistor"
resistance = "10 kOhm"
[supply]
part = "source"
dc = "12 V"
[sig]
part = "source"
dc = "2.5 V"
[analysis]
type = "op"
""", syntax)  # fmt: skip
    assert result.waves["load.v"][0] == pytest.approx(1 + 2 * (2.5 - 1), rel=1e-3)


def test_a_scene_sets_the_parameters_of_a_subcircuit(tmp_path):
    """A divider of 1 kOhm and RL: the ratio is RL / (RL + 1 kOhm)."""
    library = ".subckt own in out params: RL=1k\nR1 in out 1k\nR2 out 0 {RL}\n.ends\n"
    scene = """pins = { in = "drive.out", out = "load.a" }
[load]
part = "resistor"
resistance = "1 TOhm"
[drive]
part = "source"
dc = "1 V"
[analysis]
type = "op"
[probes]
v = { of = "load.v" }
"""
    run(tmp_path, library, scene, "ngspice")
    loaded = kc.load_scene(tmp_path / "scene.toml")
    table = kc.sweep(loaded, {"own.parameters.rl": [1e3, 3e3]}, workers=1)
    assert table["v"] == pytest.approx([0.5, 0.75], rel=1e-6)
    with pytest.raises(UsageError, match="the subcircuit has no such parameter") as caught:
        kc.load_scene(loaded, {"own.parameters.RX": 1e3})
    assert caught.value.hint == "write rl in place of RX"


def test_a_laplace_transform_of_pspice_is_refused():
    text = "E1 a 0 LAPLACE {V(b)} = {1/(1+s)}\n"
    with pytest.raises(UsageError, match="Laplace transform"):
        translate_circuit(read_cards(text, "own.lib"), "pspice")


# --- edges between two time points --------------------------------------------------------------

COMPARATOR = """.subckt own in out ref
Vtri tri ref PULSE(-1 1 0 9.9u 9.9u 0.2u 20u)
Bcmp p ref V={5*(1+tanh(200*(V(in,ref)-V(tri,ref))))}
Rout p out 0.1
.ends
"""
MODULATED = """pins = {{ in = "signal.out" }}
[load]
part = "resistor"
resistance = "100 Ohm"
pins = {{ a = "own.out", b = "gnd" }}
[signal]
part = "source"
dc = "0.5 V"
[analysis]
type = "transient"
stop = "2 ms"
[solver]
max_step = "{step}"
"""


def test_edges_between_two_time_points_cause_a_warning(tmp_path):
    """The duty cycle of an input of 0.5 V is the share of the period with a triangle below it."""
    duty = (0.75 * 2 * 9.9) / 20
    results = {}
    for step in ("5 us", "50 ns"):
        result = run(tmp_path, COMPARATOR, MODULATED.format(step=step), "ngspice")
        time, volts = result.waves["time"], result.waves["load.v"]
        mean = np.trapezoid(volts, time) / time[-1]
        (check,) = (c for c in result.checks if c.name.startswith("edges of "))
        results[step] = check, abs(mean - 10 * duty * 100 / 100.1) / 10
    coarse, error = results["5 us"]
    assert (coarse.passed, coarse.action) == (False, "warn")
    assert error <= coarse.value
    assert "set solver.max_step to " in coarse.advice
    fine, error = results["50 ns"]
    assert fine.passed
    assert error <= fine.value
