"""Tables of declarations as lookups in netlists, against closed forms and scipy."""

from dataclasses import replace

import numpy as np
import pytest
from device import bench
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from support import (
    Declaration,
    Section,
    TableFunction,
    UsageError,
    current,
    displacement,
    make_coils_subcircuit,
    make_declared_subcircuit,
    run_deck,
    voltage,
)

LENGTH = 1e-3  # m, of one radian
SPRING = displacement("x", "a", "b")


def declare_spring(**physics):
    """A declaration with the tables ``bend`` and ``stiff``."""
    tables = {"tables": ("bend", "stiff"), **physics}
    branches = tables.pop("branches", (SPRING,))
    return Declaration("leaf", "spring with a table", Section, branches, **tables)


def list_functions(points):
    """The tables of a spring of the force ``sin(x / LENGTH)``, and their slopes."""
    words = {
        "bend": lambda x: LENGTH * (1 - np.cos(x / LENGTH)),
        "bend_slope": lambda x: np.sin(x / LENGTH),
        "stiff": lambda x: np.cos(x / LENGTH),
        "stiff_slope": lambda x: -np.sin(x / LENGTH) / LENGTH,
    }
    return {name: TableFunction(-2e-3, 2e-3, points, function) for name, function in words.items()}


def write_spring(header, declaration, points=41):
    return make_declared_subcircuit(header, "leaf", declaration, {}, tables=list_functions(points))


def sweep_force(header, declaration, points, tmp_path):
    """Displacement [m] and force [N] of a spring."""
    cards = "Va a 0 0\nXleaf a 0 leaf\n.dc Va -1950 1950 13"
    vectors = {"x": ("v(a)", 1e-6), "force": ("v(xleaf.f_x)", 1.0)}
    waves = run_deck(bench([write_spring(header, declaration, points)], cards, vectors), tmp_path)
    return waves["x"], waves["force"]


def test_an_energy_with_a_table_has_the_force_of_its_slope(header, tmp_path):
    """``U = 3 bend(x) - 2e-3 stiff(x)``, one lookup of two tables, exact to third order."""
    declared = declare_spring(energy="3*bend(x) - 2e-3*stiff(x)")
    errors = []
    for points in (21, 41):
        x, force = sweep_force(header, declared, points, tmp_path)
        exact = (3 + 2e-3 / LENGTH) * np.sin(x / LENGTH)
        errors.append(np.abs(force - exact).max())
    assert errors[1] < 2e-4
    assert errors[0] / errors[1] > 7  # 2^3 for half the step


def test_a_lookup_is_constant_beyond_its_ends(header, tmp_path):
    declared = declare_spring(energy="bend(x)")
    cards = "Va a 0 0\nXleaf a 0 leaf\n.dc Va 2000 2600 200"
    vectors = {"force": ("v(xleaf.f_x)", 1.0)}
    waves = run_deck(bench([write_spring(header, declared)], cards, vectors), tmp_path)
    np.testing.assert_allclose(waves["force"][1:], waves["force"][-1], rtol=1e-9)


@pytest.mark.parametrize(
    ("physics", "message"),
    [
        (
            {"energy": "bend(x)*stiff(x)"},
            "cannot contain a function of a table or a product of tables",
        ),
        (
            {"energy": "exp(bend(x)/1e-3)"},
            "cannot contain a function of a table or a product of tables",
        ),
        ({"energy": "bend(x) + bend(2*x)"}, "differ in their arguments or ranges"),
        (
            {"branches": (SPRING, voltage("v", "p", "n")), "content": "0.5*v^2*stiff(x)"},
            "only in forces and inductances",
        ),
        (
            {"branches": (SPRING, current("i", "p", "n")), "coenergy": "stiff(x)*i^4"},
            "must not depend on a current",
        ),
        (
            {
                "branches": (SPRING, current("i", "p", "n")),
                "coenergy": "stiff(x)*i^2",
                "content": "i^4",
            },
            "tabulated inductance is not constant",
        ),
    ],
)
def test_a_netlist_refuses_other_tables(header, physics, message):
    with pytest.raises(UsageError, match=message):
        write_spring(header, declare_spring(**physics))


def write_strong_table(table):
    """A table whose inductances change by tens of percent over the height."""
    shape = table.coefficients / np.abs(table.coefficients).max(axis=0, initial=1e-12)
    largest = np.array([1e-4, 0.3, 0.3, 4.0, 1.0, 4.0])
    shape[:, 4] = shape[:, 3]
    return replace(table, coefficients=largest * shape)


def integrate_coils(table, place, speed, volts, stop):
    """Currents [A] of ``v = R i + L(y) di/dt + (L'(y) i + c(y)) speed``, by scipy.

    ``L' = [[2 c11, c12], [c12, 2 c22]]``; the mean of L over the nodes is that of the table.
    """
    slopes = CubicSpline(table.y, table.coefficients)
    integrals = slopes.antiderivative()
    constant = table.inductance[0] - spread(integrals(table.y).mean(axis=0))

    def change(t, i):
        y, v = place(t), speed(t)
        induced = (spread(slopes(y)) @ i + slopes(y)[1:3]) * v
        matrix = constant + spread(integrals(y))
        return np.linalg.solve(matrix, volts(t) - table.resistance * i - induced)

    start = (volts(0) - slopes(place(0))[1:3] * speed(0)) / table.resistance  # at rest
    solution = solve_ivp(change, (0, stop), start, rtol=1e-9, atol=1e-12, dense_output=True)
    return slopes, solution.sol


def spread(c):
    """Matrix of the coefficients of the products of currents."""
    return np.array([[2 * c[3], c[4]], [c[4], 2 * c[5]]])


def test_moving_coils_follow_their_equations(header, table, tmp_path):
    """Both coils on voltages, the sphere on a sine of 4 mm and 60 Hz: currents and force."""
    strong, stop, turn = write_strong_table(table), 0.004, 2 * np.pi * 60
    cards = f"""By y 0 V=2500+4000*sin({turn!r}*time)
Bv v 0 V=4e-3*{turn!r}*cos({turn!r}*time)
Vlower lp 0 SIN(0 40 3000)
Vupper up 0 SIN(0 25 1700)
Xcoil lp 0 up 0 y v 0 coil
.options reltol=1e-6 abstol=1e-14 chgtol=1e-14 trtol=1
.tran 1e-05 {stop} 0 5e-07"""
    vectors = {
        "lower": ("v(xcoil.i1)", 1.0), "upper": ("v(xcoil.i2)", 1.0), "force": ("i(bv)", 1.0),
    }  # fmt: skip
    deck = bench([make_coils_subcircuit(header, strong, points=401)], cards, vectors, stop)
    waves = run_deck(deck, tmp_path)
    t = waves["time"]
    slopes, solution = integrate_coils(
        strong,
        lambda t: 2.5e-3 + 4e-3 * np.sin(turn * t),
        lambda t: 4e-3 * turn * np.cos(turn * t),
        lambda t: np.array([40 * np.sin(6e3 * np.pi * t), 25 * np.sin(3.4e3 * np.pi * t)]),
        stop,
    )
    lower, upper = solution(t)
    c = slopes(2.5e-3 + 4e-3 * np.sin(turn * t)).T
    force = c[0] + c[1] * lower + c[2] * upper
    force += c[3] * lower**2 + c[4] * lower * upper + c[5] * upper**2
    for name, exact in (("lower", lower), ("upper", upper), ("force", force)):
        assert np.abs(waves[name] - exact).max() < 2e-5 * np.abs(exact).max(), name
