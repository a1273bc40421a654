"""Five circuits of LTspice and PSpice with several constructs each, against integration by scipy.

The circuits were drawn at random around these constructs. The references contain the equations of
each circuit, written from the help pages of both programs, and share no code with the importer.
"""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq
from test_imported_netlists import diode_current, run

TRANSIENT = """[analysis]
stop = "{stop}"
[solver]
max_step = "{step}"
reltol = 1e-6
"""


def compare(result, wave, exact, component, tolerance):
    """Largest difference of a wave to a component of a solution, relative to its range."""
    values = exact.sol(result.waves["time"])[component]
    span = np.ptp(values)
    assert span > 0
    assert np.abs(result.waves[wave] - values).max() < tolerance * span


@pytest.mark.slow
def test_a_boost_converter_with_ideal_diode_and_controlled_resistor(tmp_path):
    """Rser, R=, if(), nested subcircuits with parameters, .func, an epsilon, ratings and 4k7."""
    library = """* boost converter
.subckt own vin out gate PARAMS: lx=100u
.param twice=2*lx
.func closed(v) {if(v>0.5, 1, 0)}
XL vin sw coil PARAMS: l={twice/2} esr=0.2
R1 sw 0 R={if(closed(V(gate)), 0.05, 1Meg)}
D1 sw out DX
C1 out 0 10µ Rser=30m V=50 Irms=1.2 mfg="any" pn="C-1"
R2 out 0 4k7 tol=1
.model DX D(Ron=50m Roff=10Meg Vfwd=0.4 Vrev=100 epsilon=0.1)
.ends own
.subckt coil a b PARAMS: l=1u esr=1
L1 a b {l} Rser={esr}
.ends coil
"""
    result = run(tmp_path, library, """
pins = { vin = "s.out", out = "load.a", gate = "g.out" }
[s]
part = "source"
dc = "5 V"
[g]
part = "source"
pulse = { high = "1 V", low = "0 V", width = "20 us", edge = "100 ns", period = "50 us" }
[load]
part = "resistor"
resistance = "150 Ohm"
""" + TRANSIENT.format(stop="200 us", step="50 ns"))  # fmt: skip
    R = 1 / (1 / 150 + 1 / 4700)

    def gate(t):
        t = t % 50e-6
        return float(np.interp(t, [0, 1e-7, 20e-6, 20.1e-6], [0, 1, 1, 0]))

    def output(charge, current):
        """v = charge/C + 0.03 (i - v/R)"""
        return (charge / 10e-6 + 0.03 * current) / (1 + 0.03 / R)

    def node(t, i, charge):
        """Voltage of the switched node, at which the currents are in balance."""
        r = 0.05 if gate(t) > 0.5 else 1e6

        def excess(v):
            d = brentq(
                lambda x: x - diode_current(v - output(charge, x), ron=0.05, roff=1e7, vfwd=0.4,
                                            vrev=100, eps=0.1), -1e5, 1e5, xtol=1e-12)  # fmt: skip
            return i - v / r - d

        v = brentq(excess, -50, 200, xtol=1e-10)
        return v, i - v / r

    def slope(t, y):
        v, d = node(t, y[0], y[1])
        return [(5 - 0.2 * y[0] - v) / 100e-6, d - output(y[1], d) / R]

    # the initial state of the run: the converter at rest with a source of 5 V and an open switch
    def charge_at_rest(i):
        return 10e-6 * R * (i - (5 - 0.2 * i) / 1e6)

    rest = brentq(lambda i: node(0.0, i, charge_at_rest(i))[0] - (5 - 0.2 * i), 0, 1)
    start = [rest, charge_at_rest(rest)]
    time, values = [0.0], [np.array(start)]
    pieces = [0.0]
    for k in range(4):
        pieces += [50e-6 * k + 0.05e-6, 50e-6 * k + 20.05e-6]
    for a, b in zip(pieces, [*pieces[1:], 200e-6], strict=True):
        part = solve_ivp(slope, (a, b), values[-1], "LSODA", rtol=1e-7, atol=1e-12, max_step=2e-6)
        time += list(part.t[1:])
        values += list(part.y.T[1:])
    charge = np.array(values)[:, 1]
    currents = np.array([node(t, *y)[1] for t, y in zip(time, values, strict=True)])
    exact = output(charge, currents)
    found = np.interp(time, result.waves["time"], result.waves["load.v"])
    off = np.abs(found - exact)
    assert np.ptp(exact) > 3
    assert np.median(off) < 1e-3 * np.ptp(exact)
    assert off.max() < 1e-2 * np.ptp(exact)


def test_a_filter_with_tables_limits_and_powers(tmp_path):
    """E table=, G with limit() and pwrs(), I(R1), Rpar and Cpar, hypot and table()."""
    library = """* filter
.subckt own a out
R1 a m 1k
C1 m 0 100n Rpar=47k Rser=10
E1 e 0 m 0 table=(-2,-1, 0,0, 1,0.8, 3,1)
R2 e f 2.2k
C2 f 0 22n Cpar=3n
B1 0 out I={limit(pwrs(V(f),1.5)*1m + 0.2*I(R1), -2m, 1.5m)}
R3 out 0 1k5
C3 out 0 47n
B2 out 0 I=table(V(out), -1,-0.2m, 0,0, 2,0.5m)*hypot(V(m),1)
.ends own
"""
    result = run(tmp_path, library, """
pins = { a = "s.out", out = "load.a" }
[s]
part = "source"
sine = { amplitude = "4 V", frequency = "1 kHz" }
[load]
part = "resistor"
resistance = "10 kOhm"
""" + TRANSIENT.format(stop="3 ms", step="1 us"))  # fmt: skip

    def middle(t, q):
        """Node m: 1 kOhm to the source, 47 kOhm to ground, and 10 Ohm in series with 100 nF."""
        a = 4 * np.sin(2e3 * np.pi * t)
        v = (a / 1e3 + q / 10) / (1 / 1e3 + 1 / 10 + 1 / 47e3)
        return v, (a - v) / 1e3, (v - q) / 10

    def slope(t, y):
        q, f, out = y
        m, i1, into = middle(t, q)
        e = np.interp(m, [-2, 0, 1, 3], [-1, 0, 0.8, 1])
        i = np.sign(f) * abs(f) ** 1.5 * 1e-3 + 0.2 * i1
        i = min(max(i, -2e-3), 1.5e-3)
        back = np.interp(out, [-1, 0, 2], [-0.2e-3, 0, 0.5e-3]) * np.hypot(m, 1)
        drain = out * (1 / 1500 + 1 / 10e3)
        return [into / 100e-9, (e - f) / 2200 / 25e-9, (i - drain - back) / 47e-9]

    exact = solve_ivp(slope, (0, 3e-3), [0, 0, 0], "LSODA", rtol=1e-9, atol=1e-12, max_step=1e-6,
                      dense_output=True)  # fmt: skip
    compare(result, "load.v", exact, 2, 2e-3)


@pytest.mark.parametrize("seed", range(3))
def test_a_chain_of_logic_and_rounding(tmp_path, seed):
    """&, |, !, buf, inv, int, round, sqr, pwr, **, u, uramp and nested .func, at random levels."""
    draw = np.random.default_rng(seed)
    a, b, c = np.round(draw.uniform(0.3, 2.5, 3), 3)
    library = f"""* logic
.subckt own x out
.param a={a} b={{a+{b}}}
.func square(z) {{sqr(z)-1}}
.func both(p,q) {{square(p)*q**2}}
B1 n1 0 V={{if((V(x)>a) & !(V(x)>b), 1, inv(V(x)))}}
B2 n2 0 V={{buf(V(n1)) + (V(x)<-{c} | V(x)>2*b)}}
B3 n3 0 V={{int(V(x)*1.7) + 0.25*round(V(x)*{c})}}
B4 n4 0 V={{both(V(n2)+0.1, 0.3)+pwr(V(x),1.3)-uramp(V(x)-{a})*u(V(n2)-1.5)}}
B5 0 out I={{(V(n4)+0.5*V(n3))/250}} Rpar=250
.ends own
"""
    result = run(tmp_path, library, """pins = { x = "v.out", out = "load.a" }
[load]
part = "resistor"
resistance = "750 Ohm"
[v]
part = "source"
[analysis]
type = "dc"
sweep = "v.dc"
from = -4.0123
to = 5.0371
points = 331
[solver]
reltol = 1e-7
""")  # fmt: skip
    x = np.linspace(-4.0123, 5.0371, 331)
    b = a + b
    n1 = np.where((x > a) & ~(x > b), 1.0, np.where(x > 0.5, 0.0, 1.0))
    n2 = np.where(n1 > 0.5, 1.0, 0.0) + ((x < -c) | (x > 2 * b))
    n3 = np.trunc(1.7 * x) + 0.25 * np.floor(c * x + 0.5)
    both = ((n2 + 0.1) ** 2 - 1) * 0.3**2
    n4 = both + np.abs(x) ** 1.3 - np.maximum(x - a, 0) * (n2 > 1.5)
    expected = 0.75 * (n4 + 0.5 * n3)
    assert result.waves["load.v"] == pytest.approx(expected, abs=1e-5)


def test_a_transistor_with_a_clamped_inductor(tmp_path):
    """VDMOS with ratings, ako: of a diode, Rser and Rpar, I() of an inductor, E VALUE."""
    library = """* clamped inductor
.subckt own vdd gate sense
.param ind=330u kick={3*4}
L1 vdd d {ind} Rser=1.5 Rpar=20k
M1 d gate 0 NX
C1 d 0 1n
D1 d z DCLAMP
V1 z 0 {kick} Rser=2
E1 sense 0 VALUE={I(L1)*10}
.model NX VDMOS(Kp=2 Vto=1.5 Rds=1G lambda=0.02 Vds=30 Ron=10m Qg=5n mfg=any)
.model DBASE D(Ron=0.5 Roff=100Meg Vfwd=0.6 Ilimit=4)
.model DCLAMP ako:DBASE D(Vfwd=0.9)
.ends own
"""
    result = run(tmp_path, library, """
pins = { vdd = "s.out", gate = "g.out", sense = "load.a" }
[s]
part = "source"
dc = "9 V"
[g]
part = "source"
pulse = { high = "4 V", low = "0 V", width = "40 us", edge = "2 us", start = "5 us" }
[load]
part = "resistor"
resistance = "1 kOhm"
""" + TRANSIENT.format(stop="150 us", step="50 ns"))  # fmt: skip

    def drain(t, d):
        g = np.interp(t, [5e-6, 7e-6, 45e-6, 47e-6], [0, 4, 4, 0]) - 1.5
        if g <= 0:
            return 0.0
        square = 2 * (g * d - d * d / 2) if d < g else g * g
        return square * (1 + 0.02 * d)

    def clamp(d):
        if d < 12.9:
            return (d - 12) / 1e8
        return brentq(lambda x: x - diode_current(d - 12 - 2 * x, ron=0.5, roff=1e8, vfwd=0.9,
                                                  ilimit=4), -1, 4, xtol=1e-14)  # fmt: skip

    def slope(t, y):
        i, d = y
        charging = i + (9 - d) / 20e3 - drain(t, d) - d / 1e9 - clamp(d)
        return [(9 - d - 1.5 * i) / 330e-6, charging / 1e-9]

    exact = solve_ivp(slope, (0, 150e-6), [0.0, 9.0], "LSODA", rtol=1e-8, atol=1e-12,
                      max_step=1e-7, dense_output=True)  # fmt: skip
    # Rpar is part of the inductor, whose current I() contains that of Rpar
    i, d = exact.sol(result.waves["time"])
    expected = 10 * (i + (9 - d) / 20e3)
    assert np.abs(result.waves["load.v"] - expected).max() < 3e-3 * np.ptp(expected)


def test_a_pspice_oscillator_with_gradual_switches(tmp_path):
    """VSWITCH, ISWITCH, E VALUE, E TABLE, ^, IF and .PARAM in PSpice's syntax."""
    library = """* relaxation
.SUBCKT own a out PARAMS: tau=1
.PARAM cap={2.2n*tau}
.FUNC cube(x) {x^3}
R1 a m 10k
C1 m 0 {cap}
S1 m k ctl 0 SMOD
R2 k 0 330
E1 ctl 0 VALUE={IF(V(m)>0, 0.8*V(m), 0)}
V1 m2 m 0
R3 m2 n 22k
C2 n 0 1n
W1 n 0 V1 WMOD
E2 e 0 TABLE {V(n)} = (-2,-1) (0,0) (1,0.9) (4,1.2)
E3 out 0 VALUE={V(e)+0.01*cube(V(m))}
.MODEL SMOD VSWITCH(Ron=50 Roff=1Meg Von=2 Voff=0.5)
.MODEL WMOD ISWITCH(Ron=500 Roff=200k Ion=150u Ioff=20u)
.ENDS own
"""
    result = run(tmp_path, library, """
pins = { a = "s.out", out = "load.a" }
[s]
part = "source"
sine = { amplitude = "8 V", frequency = "3 kHz" }
[load]
part = "resistor"
resistance = "1 kOhm"
""" + TRANSIENT.format(stop="1 ms", step="500 ns"), syntax="pspice")  # fmt: skip

    def gradual(control, on, off, ron, roff):
        """PSpice's resistance between both levels, by logarithms of resistances."""
        low, high = min(on, off), max(on, off)
        x = min(max(control, low), high)
        mean = np.log(np.sqrt(ron * roff))
        ratio = np.log(ron / roff)
        middle, width = (on + off) / 2, on - off
        return np.exp(mean + 3 * ratio * (x - middle) / (2 * width)
                      - 2 * ratio * (x - middle) ** 3 / width**3)  # fmt: skip

    def slope(t, y):
        m, n = y
        into = (8 * np.sin(6e3 * np.pi * t) - m) / 10e3
        control = 0.8 * m if m > 0 else 0.0
        switch = m / (gradual(control, 2, 0.5, 50, 1e6) + 330)
        i3 = (m - n) / 22e3
        # V1 runs from m2 to m: its current is the current into m2, against that of R3
        w = n / gradual(-i3, 150e-6, 20e-6, 500, 200e3)
        return [(into - switch - i3) / 2.2e-9, (i3 - w) / 1e-9]

    exact = solve_ivp(slope, (0, 1e-3), [0, 0], "LSODA", rtol=1e-9, atol=1e-12, max_step=5e-7,
                      dense_output=True)  # fmt: skip
    m, n = exact.sol(result.waves["time"])
    expected = np.interp(n, [-2, 0, 1, 4], [-1, 0, 0.9, 1.2]) + 0.01 * m**3
    assert np.abs(result.waves["load.v"] - expected).max() < 2e-3 * np.ptp(expected)
