"""Expressions of cards: what they are worth, and that writing them anew changes nothing."""

import operator

import pytest
from support import (
    BinaryOperation,
    ConditionalExpression,
    ExpressionWriter,
    Number,
    UnaryOperation,
    parse_expression,
)

OPERATORS = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
    "^": operator.pow, "<": operator.lt, ">": operator.gt, "<=": operator.le, ">=": operator.ge,
    "==": operator.eq, "!=": operator.ne, "&&": lambda a, b: bool(a and b),
    "||": lambda a, b: bool(a or b),
}  # fmt: skip


def worth(tree):
    match tree:
        case Number(text):
            return float(text)
        case UnaryOperation(op, value):
            return {"-": operator.neg, "+": operator.pos, "!": operator.not_}[op](worth(value))
        case BinaryOperation(op, left, right):
            return OPERATORS[op](worth(left), worth(right))
        case ConditionalExpression(test, yes, no):
            return worth(yes) if worth(test) else worth(no)
    raise TypeError(tree)


VALUES = [
    ("1-2-3", 1 - 2 - 3, "1-2-3"),
    ("1-(2-3)", 1 - (2 - 3), "1-(2-3)"),
    ("8/4/2", 8 / 4 / 2, "8/4/2"),
    ("8/{4/2}", 8 / (4 / 2), "8/(4/2)"),
    ("8/(4*2)", 8 / (4 * 2), "8/(4*2)"),
    ("1+2*3", 1 + 2 * 3, "1+2*3"),
    ("(1+2)*3", (1 + 2) * 3, "(1+2)*3"),
    ("((1*2))+(3)", 5, "1*2+3"),
    ("-1+2", 1, "-1+2"),
    ("1 - -2", 3, "1-(-2)"),
    ("2*-3", -6, "2*(-3)"),
    ("-(1+2)", -3, "-(1+2)"),
    ("- -2", 2, "-(-2)"),
    ("+2", 2, "+2"),
    ("1<2+3", True, "1<2+3"),
    ("(1<2)+3", 4, "(1<2)+3"),
    ("5>=2 && 1!=1 || 2<=2", True, "5>=2&&1!=1||2<=2"),
    ("1==1 || 1==2 && 1==2", True, "1==1||1==2&&1==2"),
    ("(1==1 || 1==2) && 1==2", False, "(1==1||1==2)&&1==2"),
    ("!(1>2)", True, "!(1>2)"),
    ("1>2 ? 3 : 1<2 ? 4 : 5", 4, "(1>2 ? 3 : (1<2 ? 4 : 5))"),
    ("1<2 ? 1>2 ? 3 : 4 : 5", 4, "(1<2 ? (1>2 ? 3 : 4) : 5)"),
    ("'2*3'", 6, "2*3"),
]


@pytest.mark.parametrize(("text", "value", "written"), VALUES)
def test_an_expression_keeps_its_value(text, value, written):
    tree = parse_expression(text)
    assert worth(tree) == value
    assert ExpressionWriter().write_tree(tree) == written
    assert parse_expression(written) == tree


@pytest.mark.parametrize(
    ("text", "value"), [("2^3^2", 512), ("2**-1", 0.5), ("-2^2", -4), ("3*2^2", 12), ("2^2*3", 12)]
)
def test_a_power_binds_closest_and_from_the_right(text, value):
    assert worth(parse_expression(text)) == value


@pytest.mark.parametrize(
    ("text", "value"),
    [("3t", 3e12), ("3G", 3e9), ("3meg", 3e6), ("3MegOhm", 3e6), ("3k", 3e3), ("3m", 3e-3),
     ("3mil", 3 * 25.4e-6), ("3u", 3e-6), ("3nF", 3e-9), ("3p", 3e-12), ("3f", 3e-15),
     ("3V", 3.0), ("1.5e2k", 1.5e5), (".5", 0.5), ("2.", 2.0), ("1e-3", 1e-3), ("2E+1", 20.0)],
)  # fmt: skip
def test_scale_factors_are_ngspices(text, value):
    tree = parse_expression(text)
    assert isinstance(tree, Number)
    assert float(tree.text) == pytest.approx(value, rel=1e-15)
    assert parse_expression(f"max({text}, 1)").arguments == (tree, Number("1"))
