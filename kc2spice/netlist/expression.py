"""Expression trees of source laws and parameters, and names of result vectors."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Any

from kc2spice.core.errors import UsageError

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?P<suffix>[A-Za-z]*))"
    r"|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<op>\*\*|<=|>=|==|!=|&&|\|\||[-+*/^<>?:(),{}!~%]))"
)
# COMMON_FUNCTIONS exist in all simulators. BUILT_IN_NAMES are constants and variables of ngspice.
# FUNCTIONS are the functions that behavioural sources of ngspice accept.
# The function ``limit`` is excluded, because it returns 0 in a behavioural source of ngspice.
COMMON_FUNCTIONS = frozenset((
    "abs", "acos", "asin", "atan", "cos", "cosh", "exp", "floor", "ln", "max", "min", "sin",
    "sinh", "sqrt", "tan", "tanh",
))  # fmt: skip
FUNCTIONS = COMMON_FUNCTIONS.union((
    "acosh", "asinh", "atanh", "buf", "ceil", "inv", "log", "log10", "nint", "pow", "pwl", "pwr",
    "sgn", "u", "u2", "uramp",
))  # fmt: skip
BUILT_IN_NAMES = frozenset(("boltz", "e", "gmin", "hertz", "pi", "temp", "temper", "time", "vt"))
_OPERATOR_LEVELS = (("||",), ("&&",), ("==", "!=", "<", ">", "<=", ">="), ("+", "-"), ("*", "/"))
_PRECEDENCE: dict[str, int] = {}
for _rank, _operators in enumerate(_OPERATOR_LEVELS):
    _PRECEDENCE |= dict.fromkeys(_operators, _rank)
# Powers of ten of the scale factors that may follow a number, such as 6 for ``meg``.
PREFIXES = {"meg": 6, "t": 12, "g": 9, "k": 3, "m": -3, "u": -6, "n": -9, "p": -12, "f": -15, "": 0}
MIL = 25.4e-6  # scale factor ``mil`` [m], the only scale factor that is not a power of ten


@dataclass(frozen=True)
class Number:
    """Number as text, without a scale factor or a unit."""

    text: str


@dataclass(frozen=True)
class Name:
    """Name of a parameter, or a built-in name such as ``time``."""

    text: str


@dataclass(frozen=True)
class CircuitVariable:
    """Circuit variable ``V(a)``, ``V(a,b)`` or ``I(source)`` in an expression.

    ``kind`` is ``v`` for a voltage and ``i`` for a current.
    """

    kind: str
    names: tuple[str, ...]


@dataclass(frozen=True)
class FunctionCall:
    """Function call, with the name of the function in lower case."""

    function: str
    arguments: tuple[Tree, ...]


@dataclass(frozen=True)
class UnaryOperation:
    """Sign or logical negation of an operand."""

    op: str
    value: Tree


@dataclass(frozen=True)
class BinaryOperation:
    """Operation with two operands, ``left op right``."""

    op: str
    left: Tree
    right: Tree


@dataclass(frozen=True)
class ConditionalExpression:
    """Conditional expression ``test ? yes : no``."""

    test: Tree
    yes: Tree
    no: Tree


Tree = (
    Number
    | Name
    | CircuitVariable
    | FunctionCall
    | UnaryOperation
    | BinaryOperation
    | ConditionalExpression
)


def parse_expression(text: str, *, where: str = "expression") -> Tree:
    """Parse a text to an expression tree.

    Braces have the meaning of parentheses, and outer quotes are ignored.

    Raises
    ------
    UsageError : the text is not an expression.
    """
    return _Parser(text.strip().strip("'\""), where).parse_complete_text()


def parse_literal(text: str, *, where: str = "expression") -> float | None:
    """Return the value of a text that is one number, such as ``4.7k``; otherwise None.

    The result is None for any other expression.

    Raises
    ------
    UsageError : the text is not an expression.
    """
    sign, tree = "", parse_expression(text, where=where)
    if isinstance(tree, UnaryOperation) and tree.op in "+-":
        sign, tree = tree.op, tree.value
    return float(sign + tree.text) if isinstance(tree, Number) else None


def walk_tree(tree: Tree) -> Iterator[Tree]:
    """Yield a tree and all its subtrees."""
    yield tree
    for child in list_operands(tree):
        yield from walk_tree(child)


def list_operands(tree: Tree) -> tuple[Tree, ...]:
    """Return the operands of the outermost operation of an expression tree."""
    below = tree.arguments if isinstance(tree, FunctionCall) else vars(tree).values()
    return tuple(item for item in below if isinstance(item, Tree))


def find_probed_names(tree: Tree, kind: str) -> frozenset[str]:
    """Return the nodes or devices that an expression refers to, in lower case.

    If ``kind`` is ``"v"``, the names are the nodes whose voltages occur in the expression. If
    ``kind`` is ``"i"``, the names are the devices whose currents occur in the expression.
    """
    result = set[str]()
    for leaf in walk_tree(tree):
        if isinstance(leaf, CircuitVariable) and leaf.kind == kind:
            result.update(map(str.lower, leaf.names))
    return frozenset(result)


def map_operands(tree: Tree, change: Callable[[Tree], Tree]) -> Tree:
    """Apply a function to each operand of an expression tree's outermost operation."""
    if isinstance(tree, FunctionCall):
        return FunctionCall(tree.function, tuple(map(change, tree.arguments)))
    kind: Any = type(tree)
    return kind(*(change(x) if isinstance(x, Tree) else x for x in vars(tree).values()))


_MATH_FUNCTIONS: dict[str, Callable[..., float]] = {
    name: getattr(math, name)
    for name in ("acos", "asin", "atan", "cos", "cosh", "exp", "sin", "sinh", "tan", "tanh")
} | {"abs": abs, "ln": math.log, "log10": math.log10, "max": max, "min": min, "sqrt": math.sqrt}
_OPERATORS: dict[str, Callable[[float, float], float]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
    "^": operator.pow, "<": operator.lt, ">": operator.gt, "<=": operator.le, ">=": operator.ge,
    "==": operator.eq, "!=": operator.ne,
}  # fmt: skip


def evaluate_parameter(tree: Tree, names: Mapping[str, float]) -> float:
    """Return the value of an expression that contains only numbers and parameters.

    Parameters
    ----------
    tree : expression for the value of an element or of a parameter.
    names : values of the parameters, keyed by names in lower case.

    Raises
    ------
    UsageError : a parameter has no value, or the expression contains voltages or currents.

    Examples
    --------
    >>> evaluate_parameter(parse_expression("{2*k+1}"), {"k": 3.0})
    7.0
    """
    match tree:
        case Number(text):
            return float(text)
        case Name(text) if text.lower() in names:
            return names[text.lower()]
        case FunctionCall(function, arguments) if function in _MATH_FUNCTIONS:
            return float(
                _MATH_FUNCTIONS[function](*(evaluate_parameter(item, names) for item in arguments))
            )
        case UnaryOperation("-" | "+" as op, inner):
            return (
                -evaluate_parameter(inner, names) if op == "-" else evaluate_parameter(inner, names)
            )
        case BinaryOperation(op, left, right) if op in _OPERATORS:
            return float(
                _OPERATORS[op](evaluate_parameter(left, names), evaluate_parameter(right, names))
            )
        case ConditionalExpression(test, yes, no):
            return evaluate_parameter(yes if evaluate_parameter(test, names) else no, names)
    raise UsageError(
        "this expression is not a number",
        where="expression",
        got=ExpressionWriter().write_tree(tree)[:80],
    )


def substitute_names(tree: Tree, values: Mapping[str, Tree]) -> Tree:
    """Replace names in an expression tree by values."""
    if isinstance(tree, Name):
        return values.get(tree.text, tree)
    return map_operands(tree, lambda node: substitute_names(node, values))


class ExpressionWriter:
    """Writer of expression trees as text; the methods can be overridden by dialects."""

    def format_name(self, text: str) -> str:
        """Return the spelling of a parameter or keyword."""
        return text

    def write_call(self, function: str, arguments: tuple[Tree, ...]) -> str:
        """Return the text of a function call with its arguments."""
        return f"{function}({', '.join(map(self.write_tree, arguments))})"

    def write_tree(self, tree: Tree, level: int = 0) -> str:
        """Write an expression tree as text.

        The result is in parentheses if the precedence of the outermost operator is below ``level``.
        """
        match tree:
            case Number(text):
                return text
            case Name(text):
                return self.format_name(text)
            case CircuitVariable(kind, names):
                return f"{kind.upper()}({','.join(names)})"
            case FunctionCall(function, arguments):
                return self.write_call(function, arguments)
            case ConditionalExpression(test, yes, no):
                return f"({self.write_tree(test)} ? {self.write_tree(yes)} : {self.write_tree(no)})"
            case UnaryOperation(op, value):
                text = f"{op}{self.write_tree(value, len(_OPERATOR_LEVELS))}"
                return f"({text})" if level > 3 else text
            case BinaryOperation("^", left, right):
                level = len(_OPERATOR_LEVELS)
                return f"{self.write_tree(left, level)}^{self.write_tree(right, level)}"
            case BinaryOperation(op, left, right):
                rank = _PRECEDENCE[op]
                text = f"{self.write_tree(left, rank)}{op}{self.write_tree(right, rank + 1)}"
                return f"({text})" if rank < level else text
        raise TypeError(tree)


class _Parser:
    """Recursive-descent parser of expressions."""

    def __init__(self, text: str, where: str) -> None:
        self.text, self.where, self.at = text, where, 0

    def parse_complete_text(self) -> Tree:
        """Parse the complete text as one expression; reject text after the expression."""
        tree = self.parse_choice()
        if self.text[self.at :].strip():
            raise self.make_error("unexpected text")
        return tree

    def make_error(self, fault: str) -> UsageError:
        """Return the error for unexpected text."""
        return UsageError(
            f"this text is not an expression: {fault}",
            where=self.where,
            got=f"{self.text[:60]!r} at {self.text[self.at : self.at + 20]!r}",
            hint=self._advise(fault),
        )

    def _advise(self, what: str) -> str:
        """Return advice on how to correct the text at the current position."""
        rest = self.text[self.at : self.at + 20].strip()
        if what.startswith(")"):
            return "add the missing ) of this expression"
        if not rest:
            return "complete the expression at its end"
        return f"correct the text from  {rest}  on"

    def peek_token(self) -> re.Match[str] | None:
        """Return the next token without consuming the token."""
        return _TOKEN.match(self.text, self.at)

    def accept_operator(self, *ops: str) -> str | None:
        """Consume and return the next token if it is one of several operators."""
        match = self.peek_token()
        if match and match["op"] in ops:
            self.at = match.end()
            return match["op"]
        return None

    def expect_operator(self, op: str) -> None:
        """Consume an operator; raise an error if the next token is another token."""
        if self.accept_operator(op) is None:
            raise self.make_error(f"{op} expected")

    def parse_choice(self) -> Tree:
        """Parse a conditional expression ``test ? yes : no``, or a simpler expression."""
        test = self.parse_binary(0)
        if self.accept_operator("?") is None:
            return test
        yes = self.parse_choice()
        self.expect_operator(":")
        return ConditionalExpression(test, yes, self.parse_choice())

    def parse_binary(self, depth: int) -> Tree:
        """Parse binary operations of one precedence level."""
        left = self.parse_unary()
        while (result := self.peek_token()) and _PRECEDENCE.get(result["op"], -1) >= depth:
            self.at = result.end()
            left = BinaryOperation(
                result["op"], left, self.parse_binary(_PRECEDENCE[result["op"]] + 1)
            )
        return left

    def parse_unary(self) -> Tree:
        """Parse a sign or negation."""
        if op := self.accept_operator("-", "+", "!"):
            return UnaryOperation(op, self.parse_unary())
        value = self.parse_primary()
        if self.accept_operator("^", "**"):
            return BinaryOperation("^", value, self.parse_unary())
        return value

    def parse_primary(self) -> Tree:
        """Parse a number, a name, a call or an expression in parentheses."""
        match = self.peek_token()
        if match is None:
            raise self.make_error("a number, a name or a bracket expected")
        self.at = match.end()
        if match["number"]:
            return Number(_remove_scale_factor(match["number"], match["suffix"]))
        if match["name"]:
            return self.parse_name_or_call(match["name"])
        if closing := {"(": ")", "{": "}"}.get(match["op"]):
            inner = self.parse_choice()
            self.expect_operator(closing)
            return inner
        self.at = match.start()
        raise self.make_error("a number, a name or a bracket expected")

    def parse_name_or_call(self, name: str) -> Tree:
        """Parse a name, or a function call if a parenthesis follows the name."""
        if self.accept_operator("(") is None:
            return Name(name)
        if name.lower() in ("v", "i"):
            end = self.text.find(")", self.at)
            inside, self.at = self.text[self.at : end], end + 1
            if end < 0 or not inside.strip():
                raise self.make_error("a node expected")
            return CircuitVariable(name.lower(), tuple(map(str.strip, inside.split(","))))
        arguments: list[Tree] = []
        if self.accept_operator(")") is None:
            arguments.append(self.parse_choice())
            while self.accept_operator(","):
                arguments.append(self.parse_choice())
            self.expect_operator(")")
        return FunctionCall(name.lower(), tuple(arguments))


def _remove_scale_factor(literal: str, suffix: str) -> str:
    """Return the text of a number in which the scale factor is multiplied out."""
    if not suffix:
        return literal
    plain = literal.removesuffix(suffix)
    if suffix.lower().startswith("mil"):
        return repr(float(plain) * MIL)
    power = next(power for key, power in PREFIXES.items() if suffix.lower().startswith(key))
    return repr(float(Decimal(plain).scaleb(power)))  # rounds only once


# --- vectors of results: voltages of nodes and currents of devices, also inside instances ---


@dataclass(frozen=True)
class Trace:
    """Saved vector: node voltage, voltage between two nodes, or device current.

    If ``quantity`` is ``v``, ``names`` are the nodes, such as ``xa.xb.node``. If ``quantity`` is
    ``i``, ``names[0]`` is the device and ``path`` lists the nested subcircuit instances that
    contain the device, outermost first. ``parameter`` is the device parameter that contains the
    current.
    """

    quantity: str
    names: tuple[str, ...]
    path: tuple[str, ...] = ()
    parameter: str = ""

    def qualify_with_instance(self, instance: str) -> Trace:
        """Return the saved vector with its names prefixed by a subcircuit instance."""
        if self.quantity == "v":
            return replace(self, names=tuple(f"{instance}.{name}" for name in self.names))
        return replace(self, path=(instance, *self.path))

    def __str__(self) -> str:
        """Return the ngspice name of the vector.

        In the name, the device letter precedes the path of instances.
        """
        device = ".".join([self.names[0][0], *self.path, *self.names] if self.path else self.names)
        if self.parameter:
            return f"@{device}[{self.parameter}]"
        return f"{self.quantity}({','.join(self.names) if self.quantity == 'v' else device})"


def parse_vector(text: str) -> Trace | None:
    """Return the vector that a text denotes; None if the text denotes no vector.

    The text may be ``v(node)``, ``v(a,b)``, the name of a node, ``i(source)`` or
    ``@device[parameter]``.
    """
    text = text.strip("\"'")
    head, _, inside = text.partition("(")
    if text.startswith("@") and text.endswith("]"):
        device, _, parameter = text[1:-1].partition("[")
        return _parse_device(device, parameter)
    if not inside:
        return Trace("v", (text,))
    if head.lower() not in ("v", "i") or not inside.endswith(")") or "(" in inside:
        return None
    names = tuple(map(str.strip, inside[:-1].split(",")))
    return Trace("v", names) if head.lower() == "v" else _parse_device(names[0], "")


def _parse_device(text: str, parameter: str) -> Trace:
    """Parse the name of a device, which may be inside nested subcircuit instances."""
    *path, name = text.split(".")
    inner = path[1:] if path and len(path[0]) == 1 else path
    return Trace("i", (name,), tuple(inner), parameter)


def split_terms(expression: str) -> list[tuple[float, str]]:
    """Split a sum into terms; return the sign and the ngspice vector of each term.

    The result for ``v(a)-v(b)`` is ``[(1, "v(a)"), (-1, "v(b)")]``.
    """
    result = filter(None, expression.replace("-", "+-").split("+"))
    return [(-1.0 if term.startswith("-") else 1.0, term.removeprefix("-")) for term in result]


def join_terms(signed: Iterable[tuple[float, str]]) -> str:
    """Join terms, each a sign and a vector name, to a sum such as ``v(a)-v(b)``."""
    return "".join(("-" if sign < 0 else "+") + text for sign, text in signed).removeprefix("+")
