"""Differentiation, simplification and compilation of expression trees.

The nodes of the trees are objects of :mod:`kc2spice.netlist.expression`. Expressions may contain
the operators ``+ - * / ^``, calls of tables, and these functions:

* ``exp``, ``ln``, ``sqrt``, ``sin``, ``cos``, ``sinh``, ``cosh``, ``tanh``, ``atan``,
* the one-sided function ``max(0, e)``,
* ``above(e)``, which is 1 where e is above zero, and 0 elsewhere,
* ``clip(e)``, which limits e to the range from -1 to 1,
* ``poly(e, c0, c1, ...)``, a power series in e whose coefficients are numbers,
* ``integral(f, x)``, the integral of ``f(x)`` from zero to ``x``. A netlist cannot contain an
  integral.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Set
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, reduce
from itertools import chain
from typing import Any

import numpy as np

from kc2spice.core.errors import UsageError, did_you_mean, list_candidates
from kc2spice.netlist.expression import (
    BinaryOperation,
    CircuitVariable,
    ConditionalExpression,
    ExpressionWriter,
    FunctionCall,
    Name,
    Number,
    Tree,
    UnaryOperation,
    list_operands,
    map_operands,
    parse_expression,
    substitute_names,
    walk_tree,
)

ZERO = Number("0")
ONE = Number("1")
SLOPE_SUFFIX = "_slope"  # suffix of the names of the derivatives of tables
_LITERAL_DIGITS = 11  # number of digits that ngspice uses of a number in an expression
_HELP_PAGE = "docs/reference/declarations.md"
_REPLACEMENTS = {
    "abs": "write max(0, x) + max(0, -x) for |x|",
    "log": "write ln(x) for the natural logarithm, ln(x)/ln(10) for the decimal one",
    "log10": "write ln(x)/ln(10)",
    "pow": "write x^2, or exp(n*ln(x)) if n is not a whole number",
    "min": "write a - max(0, a - b) for the smaller one of a and b",
    "sgn": "write above(x) - above(-x)",
    "sign": "write above(x) - above(-x)",
    "tan": "write sin(x)/cos(x)",
}
# Functions that accept only certain arguments, with examples of these arguments.
_RESTRICTED_FUNCTIONS = ("max(0, …)", "above(…)", "clip(…)", "poly(…, numbers)", "integral(…, x)")
# Derivative of each function with respect to its argument u.
_FUNCTION_DERIVATIVES = {
    "exp": "exp(u)", "ln": "1/u", "sqrt": "0.5/sqrt(u)", "sin": "cos(u)", "cos": "-sin(u)",
    "sinh": "cosh(u)", "cosh": "sinh(u)", "tanh": "1-tanh(u)*tanh(u)", "atan": "1/(1+u*u)",
}  # fmt: skip
_NUMPY_NAMES = {"ln": "log", "atan": "arctan"}
_GAUSS_NODES, _GAUSS_WEIGHTS = np.polynomial.legendre.leggauss(30)


@cache
def parse_simplified(text: str, where: str = "expression", tables: tuple[str, ...] = ()) -> Tree:
    """Return the simplified expression tree of a text.

    ``tables`` contains the names of tables, which are functions of one argument. The functions of
    the tables must be passed when the expression is evaluated. The derivative of a table ``f`` has
    the name ``f_slope``. Error messages contain ``where``.

    Raises
    ------
    UsageError : the text is not an expression, or contains a function or operator that cannot be
        differentiated.
    """
    tree = parse_expression(text, where=where)
    for node in walk_tree(tree):
        match node:
            case FunctionCall("max", (first, _)) if simplify(first) == ZERO:
                continue
            case FunctionCall("integral", (_, Name(_))) | FunctionCall("clip" | "above", (_,)):
                continue
            case FunctionCall("poly", (_, *series)) if series and not any(map(find_names, series)):
                continue
            case FunctionCall(name, (_,)) if name in _FUNCTION_DERIVATIVES or name in tables:
                continue
            case FunctionCall(name, _):
                functions = (*_RESTRICTED_FUNCTIONS, *_FUNCTION_DERIVATIVES, *tables)
                raise UsageError(
                    "expressions in the declaration of a part do not support this function",
                    where=where,
                    got=name,
                    expected="one of " + list_candidates(name, functions, _HELP_PAGE),
                    hint=_REPLACEMENTS.get(name)
                    or did_you_mean(name, [*_FUNCTION_DERIVATIVES, *tables]),
                )
            case ConditionalExpression() | CircuitVariable():
                raise UsageError(
                    "this expression contains a condition or a circuit variable such as V(a)",
                    where=where,
                    got=text,
                    expected="only names, numbers, operators and functions",
                    hint="for a condition, write above(x), which is 1 for x > 0 and otherwise 0",
                )
    try:
        return simplify(_replace_step_functions(tree))
    except UsageError as error:
        error.where = error.where or where
        raise


def _replace_step_functions(tree: Tree) -> Tree:
    """Replace each step function ``above(e)`` by the condition ``e > 0 ? 1 : 0``."""
    match tree:
        case FunctionCall("above", (value,)):
            return _make_step_function(simplify(_replace_step_functions(value)))
    return map_operands(tree, _replace_step_functions)


class _CardWriter(ExpressionWriter):
    """Writer that formats expression trees for netlist cards."""

    def write_call(self, function: str, arguments: tuple[Tree, ...]) -> str:
        """Return the text of a function call in the syntax of netlist cards."""
        match function, arguments:
            case "sqrt", (
                FunctionCall("max", (_, value)),
            ):  # unlike sqrt(max(0, e)), sqrt(max(1e-18, e)) has a finite slope at e = 0
                return f"sqrt(max(1e-18, {self.write_tree(value)}))"
            case "clip", (value,):
                return f"max(-1, min(1, {self.write_tree(value)}))"
            case "poly", (value, *series):
                return f"({self.write_tree(write_horner(value, series))})"
        return super().write_call(function, arguments)


def format_tree(tree: Tree) -> str:
    """Return the text of an expression tree for a netlist card.

    The text of ``sqrt(max(0, e))`` is ``sqrt(max(1e-18, e))``, whose derivative at e = 0 is finite.

    Raises
    ------
    UsageError : the tree contains an integral, which a netlist cannot express.
    """
    for node in walk_tree(tree):
        if isinstance(node, FunctionCall) and node.function == "integral":
            raise UsageError(
                "an integral cannot be written to a netlist",
                got=ExpressionWriter().write_tree(node),
                hint="write the closed form of the integral",
            )
    return _CardWriter().write_tree(tree)


def find_names(tree: Tree) -> frozenset[str]:
    """Return the names of all variables and parameters in an expression."""
    return frozenset(node.text for node in walk_tree(tree) if isinstance(node, Name))


def is_affine(tree: Tree, variables: Set[str]) -> bool:
    """Return whether an expression is an affine function of ``variables``."""
    return all(
        variables.isdisjoint(find_names(differentiate_tree(tree, name))) for name in variables
    )


def add_trees(*trees: Tree) -> Tree:
    """Return the simplified sum of expressions."""
    return simplify(_chain_operator("+", (ZERO, *trees)))


def subtract_trees(first: Tree, second: Tree) -> Tree:
    """Return the simplified difference of two expressions."""
    return simplify(BinaryOperation("-", first, second))


def multiply_trees(*trees: Tree) -> Tree:
    """Return the simplified product of expressions."""
    return simplify(_chain_operator("*", (ONE, *trees)))


def divide_trees(first: Tree, second: Tree) -> Tree:
    """Return the simplified quotient of two expressions."""
    return simplify(BinaryOperation("/", first, second))


def _chain_operator(op: str, trees: Iterable[Tree]) -> Tree:
    """Return the expressions, joined by the operator ``op`` from left to right."""
    first, *rest = trees
    for tree in rest:
        first = BinaryOperation(op, first, tree)
    return first


# --- derivatives ----------------------------------------------------------------------------------


@cache
def differentiate_tree(tree: Tree, name: str) -> Tree:
    """Return the exact, simplified derivative of ``tree`` with respect to ``name``."""
    return simplify(_differentiate(tree, name))


def _differentiate(tree: Tree, name: str) -> Tree:
    """Return the derivative of ``tree`` with respect to ``name``.

    The derivative is not simplified.
    """
    match tree:
        case Name(found):
            return ONE if found == name else ZERO
        case UnaryOperation(op, value):
            return UnaryOperation(op, _differentiate(value, name))
        case BinaryOperation("+" | "-" as op, left, right):
            return _make_sum(op, _differentiate(left, name), _differentiate(right, name))
        case BinaryOperation("*", left, right):
            first = _make_product(_differentiate(left, name), right)
            return _make_sum("+", first, _make_product(left, _differentiate(right, name)))
        case BinaryOperation("/", above, below):
            slope = _make_product(above, _differentiate(below, name))
            fall = (
                slope
                if slope == ZERO
                else BinaryOperation("/", slope, BinaryOperation("*", below, below))
            )
            return _make_sum("-", BinaryOperation("/", _differentiate(above, name), below), fall)
        case FunctionCall("integral", (f, Name(x))):
            inner = FunctionCall("integral", (differentiate_tree(f, name), Name(x)))
            return f if x == name else inner if name in find_names(f) else ZERO
        case FunctionCall("max", (_, value)):
            return BinaryOperation("*", _make_step_function(value), _differentiate(value, name))
        case FunctionCall("poly", (value, _, *higher)):
            series = []
            for k, coefficient in enumerate(higher, 1):
                series.append(_make_number(k * float(evaluate_tree(coefficient, {}))))
            slope = FunctionCall("poly", (value, *series)) if series else ZERO
            return BinaryOperation("*", slope, _differentiate(value, name))
        case FunctionCall("clip", (value,)):
            free = BinaryOperation(
                "-",
                ONE,
                BinaryOperation("+", *map(_make_step_function, _subtract_clip_limits(value))),
            )
            return BinaryOperation("*", free, _differentiate(value, name))
        case FunctionCall(function, (value,)):
            table = function not in _FUNCTION_DERIVATIVES
            outer = (
                FunctionCall(function + SLOPE_SUFFIX, (value,))
                if table
                else _differentiate_function(function, value)
            )
            return _make_product(outer, _differentiate(value, name))
    return ZERO  # numbers, and step functions away from the step, have zero slope


def _differentiate_function(function: str, value: Tree) -> Tree:
    """Return the derivative of a function with respect to its argument."""
    return substitute_names(parse_expression(_FUNCTION_DERIVATIVES[function]), {"u": value})


def _make_product(left: Tree, right: Tree) -> Tree:
    """Return the product of two trees; zero if a factor is zero."""
    return ZERO if ZERO in (left, right) else BinaryOperation("*", left, right)


def _make_sum(op: str, left: Tree, right: Tree) -> Tree:
    """Return the sum or difference of two trees.

    If the right tree is zero, it is omitted.
    """
    return left if right == ZERO else BinaryOperation(op, left, right)


def write_horner(value: Tree, series: Iterable[Tree]) -> Tree:
    """Return a power series in ``value`` as nested products (Horner's rule).

    ``series`` contains the coefficients c0, c1, … of the powers.
    """
    *lower, result = series
    for item in reversed(lower):
        result = BinaryOperation("+", item, BinaryOperation("*", value, result))
    return result


def _make_step_function(value: Tree) -> Tree:
    """Return an expression that is 1 if ``value`` is above zero, otherwise 0."""
    return ConditionalExpression(BinaryOperation(">", value, ZERO), ONE, ZERO)


def _subtract_clip_limits(value: Tree) -> tuple[Tree, Tree]:
    """Return by how much ``value`` is above 1 and below -1, as two expressions.

    If ``clip(value)`` limits the value to 1, the first expression, ``value - 1``, is positive. If
    ``clip(value)`` limits the value to -1, the second expression, ``-value - 1``, is positive.
    """
    return subtract_trees(value, ONE), subtract_trees(UnaryOperation("-", value), ONE)


# --- sums of products with rational coefficients --------------------------------------------------


@dataclass(frozen=True)
class _Product:
    """Product of factors, divided by other factors, with a rational coefficient."""

    coefficient: Fraction
    numerator: tuple[Tree, ...] = ()
    denominator: tuple[Tree, ...] = ()

    def multiply_by(self, other: _Product) -> _Product:
        """Return this product multiplied by the product ``other``."""
        both = (
            Counter(self.numerator + other.numerator),
            Counter(self.denominator + other.denominator),
        )
        above, below = both[0] - both[1], both[1] - both[0]
        for root in list(below):
            match root:
                case FunctionCall("sqrt", (value,)) if value in above:  # a / sqrt(a) is sqrt(a)
                    above = above - Counter([value]) + Counter([root])
                    below = below - Counter([root])
        return _Product(
            self.coefficient * other.coefficient,
            _remove_redundant_steps(above),
            _remove_redundant_steps(below),
        )

    def invert_product(self) -> _Product:
        """Return the reciprocal of the product."""
        if not self.coefficient:
            raise UsageError("the equations of the part contain a division by zero")
        return _Product(1 / self.coefficient, self.denominator, self.numerator)

    def make_tree(self) -> Tree:
        """Return the expression tree of the product without the sign of its coefficient."""
        size, below = abs(self.coefficient), self.denominator
        if Fraction(f"{float(size):.{_LITERAL_DIGITS}g}") != size:
            size, below = Fraction(size.numerator), (_make_number(size.denominator), *below)
        above = (
            (_make_number(size), *self.numerator)
            if size != 1 or not self.numerator
            else self.numerator
        )
        numerator = _chain_operator("*", above)
        return BinaryOperation("/", numerator, _chain_operator("*", below)) if below else numerator


def _make_number(value: Fraction | float) -> Number:
    """Return a number as an expression tree."""
    return Number(f"{float(value):.{_LITERAL_DIGITS}g}")


def _remove_redundant_steps(counts: Counter[Tree]) -> tuple[Tree, ...]:
    """Return the factors of a product without redundant step functions.

    ``counts`` contains the number of occurrences of each factor. The step function of e is
    redundant if the product also contains ``max(0, e)``, the square root of ``max(0, e)``, or the
    same step function.
    """
    factors: list[Tree] = []
    for factor in counts.elements():
        match factor:
            case ConditionalExpression(BinaryOperation(">", value, _), _, _):
                closed = FunctionCall("max", (ZERO, value))
                if not {closed, FunctionCall("sqrt", (closed,))} & {*counts, *factors}:
                    factors += [factor] * (factor not in factors)
            case _:
                factors.append(factor)
    return tuple(factors)


@cache
def simplify(tree: Tree) -> Tree:
    """Return an equal expression, with equal terms added and equal factors cancelled.

    Numbers are calculated as exact fractions.
    """
    return _build_sum(_list_nonzero_terms(tree))


def _list_nonzero_terms(tree: Tree) -> list[_Product]:
    """Return the terms of an expression that have a nonzero coefficient."""
    return [term for term in _list_terms(tree) if term.coefficient]


def _build_sum(terms: list[_Product]) -> Tree:
    """Return the expression tree of a sum of products; positive terms are first."""
    if not terms:
        return ZERO
    first, *rest = sorted(terms, key=lambda term: term.coefficient < 0)
    total: Tree = (
        first.make_tree() if first.coefficient > 0 else UnaryOperation("-", first.make_tree())
    )
    for term in rest:
        total = BinaryOperation("+" if term.coefficient > 0 else "-", total, term.make_tree())
    return total


def _list_terms(tree: Tree) -> list[_Product]:
    """Return the terms of an expression as products; their coefficients may be zero."""
    match tree:
        case Number(value):
            return [_Product(Fraction(value))]
        case UnaryOperation("-" | "+", _) | BinaryOperation("+" | "-", _, _):
            return _merge_terms(_list_sum_terms(tree))
        case BinaryOperation("*", left, right):
            return [_factor_into_product(left).multiply_by(_factor_into_product(right))]
        case BinaryOperation("/", left, right):
            return [
                _factor_into_product(left).multiply_by(_factor_into_product(right).invert_product())
            ]
        case BinaryOperation("^", base, Number(power)) if float(power).is_integer():
            factors = [_factor_into_product(base)] * int(float(power))
            return [reduce(_Product.multiply_by, factors, _Product(Fraction(1)))]
        case BinaryOperation("^", base, UnaryOperation("-", power)):
            return [_factor_into_product(BinaryOperation("^", base, power)).invert_product()]
        case BinaryOperation("^", base, power):
            text = ExpressionWriter().write_tree(_make_exponential(base, power))
            raise UsageError(
                "the exponent is not a whole number",
                got=ExpressionWriter().write_tree(tree),
                expected="a whole number after ^",
                hint=f"write {text} for a positive base",
            )
    if not _may_differ_from_zero(tree):
        return []
    return [_Product(Fraction(1), (map_operands(tree, simplify),))]


def _make_exponential(base: Tree, power: Tree) -> Tree:
    """Write ``base^power`` as ``exp(power ln(base))``."""
    return FunctionCall("exp", (BinaryOperation("*", power, FunctionCall("ln", (base,))),))


def _list_sum_terms(tree: Tree, sign: int = 1) -> Iterator[_Product]:
    """Yield the terms of nested sums, multiplied by ``sign``.

    The caller receives the terms of all nested sums together, so one search finds all equal terms.
    """
    match tree:
        case UnaryOperation("-" | "+" as op, value):
            yield from _list_sum_terms(value, -sign if op == "-" else sign)
        case BinaryOperation("+" | "-" as op, left, right):
            yield from _list_sum_terms(left, sign)
            yield from _list_sum_terms(right, -sign if op == "-" else sign)
        case _:
            yield from (
                _Product(sign * t.coefficient, t.numerator, t.denominator)
                for t in _list_terms(tree)
            )


def _may_differ_from_zero(tree: Tree) -> bool:
    """Return whether a tree may differ from zero.

    The result is False only for ``max(0, e)`` in which the simplified expression e is zero.
    """
    return not (
        isinstance(tree, FunctionCall)
        and tree.function == "max"
        and simplify(tree.arguments[1]) == ZERO
    )


# The results are cached, because the derivative of a product contains the same sums many times.
@cache
def _factor_into_product(tree: Tree) -> _Product:
    """Return an expression as a product; a sum of several terms becomes one factor."""
    result = _list_nonzero_terms(tree)
    if len(result) == 1:
        return result[0]
    return _Product(Fraction(1), (_build_sum(result),)) if result else _Product(Fraction(0))


def _merge_terms(terms: Iterable[_Product]) -> list[_Product]:
    """Return the terms after adding terms with equal factors."""
    sums: dict[tuple[frozenset[Any], frozenset[Any]], _Product] = {}
    for term in terms:
        above, below = Counter(term.numerator), Counter(term.denominator)
        key = frozenset(above.items()), frozenset(below.items())
        before = sums.get(key)
        size = term.coefficient + (before.coefficient if before else 0)
        first = before or term
        sums[key] = _Product(size, first.numerator, first.denominator)
    return list(sums.values())


# --- tables ---------------------------------------------------------------------------------------

WeightedCalls = tuple[tuple[FunctionCall, Fraction], ...]


def split_calls(
    tree: Tree, functions: Container[str]
) -> tuple[list[tuple[Tree, WeightedCalls]], Tree]:
    """Split an expression into terms with calls of ``functions``, and remaining terms.

    Each term that contains calls of ``functions`` is returned as a pair: a factor, and a weighted
    sum of the calls. The first weight of each sum is 1. The remaining terms are returned as a
    single sum.

    Raises
    ------
    UsageError : a call is an argument of another function, or calls are multiplied.
    """
    weights: dict[Tree, dict[FunctionCall, Fraction]] = {}
    rest = []
    for term in _list_nonzero_terms(tree):
        calls = [
            f for f in term.numerator if isinstance(f, FunctionCall) and f.function in functions
        ]
        others = tuple((Counter(term.numerator) - Counter(calls)).elements())
        factor = _Product(Fraction(1), others, term.denominator).make_tree()
        inner = (node.function for node in walk_tree(factor) if isinstance(node, FunctionCall))
        if len(calls) > 1 or any(name in functions for name in inner):
            raise UsageError(
                "a netlist cannot contain a function of a table or a product of tables",
                got=ExpressionWriter().write_tree(term.make_tree()),
                expected="a sum of terms, each with at most one table as a factor",
            )
        if calls:
            sums = weights.setdefault(factor, {})
            sums[calls[0]] = sums.get(calls[0], Fraction(0)) + term.coefficient
        else:
            rest.append(term)
    result = []
    for factor, sums in weights.items():
        (_, unit), *_ = rows = sorted(sums.items(), key=str)
        calls_and_weights = tuple((call, weight / unit) for call, weight in rows)
        result.append((multiply_trees(_make_number(unit), factor), calls_and_weights))
    return result, _build_sum(rest)


def make_weighted_sum(calls: WeightedCalls) -> Tree:
    """Return the weighted sum ``sum_k weight_k call_k`` of function calls."""
    return add_trees(*(multiply_trees(_make_number(weight), call) for call, weight in calls))


# --- functions ------------------------------------------------------------------------------------


def find_kinks(tree: Tree) -> tuple[Tree, ...]:
    """Find all kinks in an expression; return arguments such as x of ``max(0, x)``.

    Steps count as kinks. Arguments of inner functions precede arguments of outer functions.
    """
    result = [*chain.from_iterable(map(find_kinks, list_operands(tree)))]
    match tree:
        case FunctionCall("clip", (value,)):
            result += _subtract_clip_limits(value)
        case FunctionCall("max", (_, value)) | ConditionalExpression(
            BinaryOperation(">", value, _), _, _
        ):
            result.append(value)
    return tuple(dict.fromkeys(result))


def replace_kinks(tree: Tree, corners: tuple[Tree, ...]) -> Tree:
    """Replace kinks of an expression by flags: ``max(0, x)`` becomes ``flag0 * x``.

    The expression ``corners[0]`` belongs to the flag ``flag0``, ``corners[1]`` to ``flag1``, and so
    on. A flag is 1 if its expression in ``corners`` is above zero, otherwise 0. The returned
    expression is smooth as long as no flag changes its value.
    """
    match tree:
        # If a step makes the argument negative, the root must be zero instead of complex.
        case FunctionCall("sqrt", (FunctionCall("max", (_, value)),)):
            return FunctionCall(
                "sqrt", (FunctionCall("max", (ZERO, replace_kinks(value, corners))),)
            )
        case FunctionCall("max", (_, value)):
            return BinaryOperation("*", _name_flag(value, corners), replace_kinks(value, corners))
        case FunctionCall("clip", (value,)):
            over_one, under_one = _subtract_clip_limits(value)
            above, below = _name_flag(over_one, corners), _name_flag(under_one, corners)
            free, ends = (
                BinaryOperation("-", ONE, BinaryOperation("+", above, below)),
                BinaryOperation("-", above, below),
            )
            return BinaryOperation(
                "+", BinaryOperation("*", free, replace_kinks(value, corners)), ends
            )
        case ConditionalExpression(BinaryOperation(">", value, _), _, _):
            return _name_flag(value, corners)
    return map_operands(tree, lambda node: replace_kinks(node, corners))


def _name_flag(argument: Tree, corners: tuple[Tree, ...]) -> Name:
    """Return the name of the flag that is 1 if ``argument`` is positive.

    ``corners`` contains the arguments of all functions with a kink, including ``argument``.
    """
    return Name(f"flag{corners.index(argument)}")


class _PythonWriter(ExpressionWriter):
    """Writer that formats expression trees in Python syntax."""

    def format_name(self, text: str) -> str:
        """Return the Python name of a variable."""
        return f"_{text}"  # with the underscore, a key may be a Python keyword

    def write_tree(self, tree: Tree, level: int = 0) -> str:
        """Write an expression tree as Python text."""
        if isinstance(tree, ConditionalExpression):
            test, yes, no = map(self.write_tree, (tree.test, tree.yes, tree.no))
            return f"where({test}, {yes}, {no})"
        return super().write_tree(tree, level)

    def write_call(self, function: str, arguments: tuple[Tree, ...]) -> str:
        """Return the text of a function call in Python syntax."""
        if function == "integral":
            f, x = arguments
            return (
                f"integral(lambda {self.write_tree(x)}: {self.write_tree(f)}, {self.write_tree(x)})"
            )
        if function == "poly":
            return f"({self.write_tree(write_horner(arguments[0], arguments[1:]))})"
        if function == "clip":
            return f"clip({self.write_tree(arguments[0])}, -1, 1)"
        return super().write_call(_get_python_name(function), arguments)


def _get_python_name(function: str) -> str:
    """Return the Python name of a function.

    The name of a table differs from all possible names of keys.
    """
    known = function in _FUNCTION_SCOPE or function in _NUMPY_NAMES
    return _NUMPY_NAMES.get(function, function) if known else f"table_{function}"


def _integrate_from_zero(f: Callable[[Any], Any], x: Any) -> Any:
    """Integrate ``f`` from zero to ``x`` by Gauss quadrature with 30 points."""
    half = 0.5 * x
    return (
        sum(w * f(half * (1.0 + n)) for n, w in zip(_GAUSS_NODES, _GAUSS_WEIGHTS, strict=True))
        * half
    )


_FUNCTION_SCOPE = {
    name: getattr(np, _NUMPY_NAMES.get(name, name)) for name in _FUNCTION_DERIVATIVES
}
_FUNCTION_SCOPE |= {_NUMPY_NAMES[name]: _FUNCTION_SCOPE[name] for name in _NUMPY_NAMES} | {
    "integral": _integrate_from_zero
}
_FUNCTION_SCOPE |= {"max": np.maximum, "clip": np.clip, "where": np.where}


def compile_function(
    trees: Iterable[Tree],
    arguments: Iterable[str],
    tables: Mapping[str, Callable[[Any], Any]] | None = None,
) -> Callable[..., tuple[Any, ...]]:
    """Return a compiled function that evaluates expressions for values of arguments.

    The values of the arguments are numbers or arrays. ``tables`` contains the functions of the
    tables, keyed by name.
    """
    heads = ", ".join(map("_{}".format, arguments))
    values = "".join(map("{}, ".format, map(_PythonWriter().write_tree, trees)))
    scope = dict(_FUNCTION_SCOPE)
    for name, table in (tables or {}).items():
        scope[_get_python_name(name)] = table
    compiled: Callable[..., tuple[Any, ...]] = eval(f"lambda {heads}: ({values})", scope)
    return compiled


def evaluate_tree(tree: Tree, known: Mapping[str, Any]) -> Any:
    """Return the value of an expression for known values of its names.

    ``known`` contains numbers or arrays, keyed by name.
    """
    return np.asarray(compile_function((tree,), known)(*known.values())[0])
