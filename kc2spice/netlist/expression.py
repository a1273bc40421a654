"""Expressions of sources and parameters as trees, written in any dialect; names of results."""

from __future__ import annotations

import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import Any

from kc2spice.core.errors import UsageError

_TOKEN = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?P<suffix>[A-Za-z]*))"
    r"|(?P<name>[A-Za-z_]\w*)"
    r"|(?P<op>\*\*|<=|>=|==|!=|&&|\|\||[-+*/^<>?:(),{}!~%]))"
)
# Functions that all simulators have; those of ngspice's behavioural sources, where ``limit`` is of
# its statistics and returns 0; and its words.
EVERYWHERE = frozenset((
    "abs", "acos", "asin", "atan", "cos", "cosh", "exp", "floor", "ln", "max", "min", "sin",
    "sinh", "sqrt", "tan", "tanh",
))  # fmt: skip
FUNCTIONS = EVERYWHERE.union((
    "acosh", "asinh", "atanh", "buf", "ceil", "inv", "log", "log10", "nint", "pow", "pwl", "pwr",
    "sgn", "u", "u2", "uramp",
))  # fmt: skip
BUILT_IN = frozenset(("boltz", "e", "gmin", "hertz", "pi", "temp", "temper", "time", "vt"))
_LEVELS = (("||",), ("&&",), ("==", "!=", "<", ">", "<=", ">="), ("+", "-"), ("*", "/"))
_RANK = {op: rank for rank, ops in enumerate(_LEVELS) for op in ops}
#: Powers of ten of the scale factors behind a number.
PREFIXES = {"meg": 6, "t": 12, "g": 9, "k": 3, "m": -3, "u": -6, "n": -9, "p": -12, "f": -15, "": 0}
MIL = 25.4e-6  # m, the one scale factor that is no power of ten


@dataclass(frozen=True)
class Number:
    """A literal, as it was written, without suffix letters."""

    text: str


@dataclass(frozen=True)
class Name:
    """A parameter, or a word like ``time``."""

    text: str


@dataclass(frozen=True)
class CircuitVariable:
    """``V(a)``, ``V(a,b)`` or ``I(source)``; ``kind`` is ``v`` or ``i``."""

    kind: str
    names: tuple[str, ...]


@dataclass(frozen=True)
class Call:
    """A function, its name in lower case."""

    function: str
    arguments: tuple[Tree, ...]


@dataclass(frozen=True)
class Unary:
    """Sign or negation."""

    op: str
    value: Tree


@dataclass(frozen=True)
class Binary:
    """``left op right``."""

    op: str
    left: Tree
    right: Tree


@dataclass(frozen=True)
class Choice:
    """``test ? yes : no``."""

    test: Tree
    yes: Tree
    no: Tree


Tree = Number | Name | CircuitVariable | Call | Unary | Binary | Choice


def parse(text: str, *, where: str = "expression") -> Tree:
    """The tree of ``text``; braces and quotes around it, or around parts of it, mean nothing.

    Raises
    ------
    UsageError : not an expression.
    """
    return _Parser(text.strip().strip("'\""), where).whole_text()


def literal(text: str, *, where: str = "expression") -> float | None:
    """The value of a number with its sign and scale factor, None of any other expression.

    Raises
    ------
    UsageError : not an expression.
    """
    sign, tree = "", parse(text, where=where)
    if isinstance(tree, Unary) and tree.op in "+-":
        sign, tree = tree.op, tree.value
    return float(sign + tree.text) if isinstance(tree, Number) else None


def walk(tree: Tree) -> Iterator[Tree]:
    """The tree and everything below it."""
    yield tree
    for child in children(tree):
        yield from walk(child)


def children(tree: Tree) -> tuple[Tree, ...]:
    """Direct operands of ``tree``."""
    below = tree.arguments if isinstance(tree, Call) else vars(tree).values()
    return tuple(item for item in below if isinstance(item, Tree))


def rebuilt(tree: Tree, change: Callable[[Tree], Tree]) -> Tree:
    """``tree`` with what stands directly below it changed."""
    if isinstance(tree, Call):
        return Call(tree.function, tuple(map(change, tree.arguments)))
    kind: Any = type(tree)
    return kind(*(change(x) if isinstance(x, Tree) else x for x in vars(tree).values()))


_MATH: dict[str, Callable[..., float]] = {
    name: getattr(math, name)
    for name in ("acos", "asin", "atan", "cos", "cosh", "exp", "sin", "sinh", "tan", "tanh")
} | {"abs": abs, "ln": math.log, "log10": math.log10, "max": max, "min": min, "sqrt": math.sqrt}
_OPERATORS: dict[str, Callable[[float, float], float]] = {
    "+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv,
    "^": operator.pow, "<": operator.lt, ">": operator.gt, "<=": operator.le, ">=": operator.ge,
    "==": operator.eq, "!=": operator.ne,
}  # fmt: skip


def value(tree: Tree, names: Mapping[str, float]) -> float:
    """The number that an expression of parameters has.

    Parameters
    ----------
    tree : of an element's or a parameter's value.
    names : values of the parameters, by names in lower case.

    Raises
    ------
    UsageError : a parameter without a value, or what is no number, such as a voltage.

    Examples
    --------
    >>> value(parse("{2*k+1}"), {"k": 3.0})
    7.0
    """
    match tree:
        case Number(text):
            return float(text)
        case Name(text) if text.lower() in names:
            return names[text.lower()]
        case Call(function, arguments) if function in _MATH:
            return float(_MATH[function](*(value(item, names) for item in arguments)))
        case Unary("-" | "+" as op, inner):
            return -value(inner, names) if op == "-" else value(inner, names)
        case Binary(op, left, right) if op in _OPERATORS:
            return float(_OPERATORS[op](value(left, names), value(right, names)))
        case Choice(test, yes, no):
            return value(yes if value(test, names) else no, names)
    raise UsageError("not a number", where="expression", got=Writer().write(tree)[:80])


def substitute(tree: Tree, values: Mapping[str, Tree]) -> Tree:
    """``tree`` with trees in place of names."""
    if isinstance(tree, Name):
        return values.get(tree.text, tree)
    return rebuilt(tree, lambda node: substitute(node, values))


class Writer:
    """Writes trees; a dialect overrides the spelling of names and functions, or what it writes."""

    def name(self, text: str) -> str:
        """A parameter or keyword."""
        return text

    def call(self, function: str, arguments: tuple[Tree, ...]) -> str:
        """A function with its arguments."""
        return f"{function}({', '.join(map(self.write, arguments))})"

    def write(self, tree: Tree, level: int = 0) -> str:
        """Text of ``tree``, in parentheses where it binds weaker than its surroundings."""
        match tree:
            case Number(text):
                return text
            case Name(text):
                return self.name(text)
            case CircuitVariable(kind, names):
                return f"{kind.upper()}({','.join(names)})"
            case Call(function, arguments):
                return self.call(function, arguments)
            case Choice(test, yes, no):
                return f"({self.write(test)} ? {self.write(yes)} : {self.write(no)})"
            case Unary(op, value):
                text = f"{op}{self.write(value, len(_LEVELS))}"
                return f"({text})" if level > 3 else text
            case Binary("^", left, right):
                return f"{self.write(left, len(_LEVELS))}^{self.write(right, len(_LEVELS))}"
            case Binary(op, left, right):
                rank = _RANK[op]
                text = f"{self.write(left, rank)}{op}{self.write(right, rank + 1)}"
                return f"({text})" if rank < level else text
        raise TypeError(tree)


class _Parser:
    def __init__(self, text: str, where: str) -> None:
        self.text, self.where, self.at = text, where, 0

    def whole_text(self) -> Tree:
        tree = self.choice()
        if self.text[self.at :].strip():
            raise self.error("stray text")
        return tree

    def error(self, what: str) -> UsageError:
        return UsageError(
            f"not an expression: {what}",
            where=self.where,
            got=f"{self.text[:60]!r} at {self.text[self.at : self.at + 20]!r}",
        )

    def peek(self) -> re.Match[str] | None:
        return _TOKEN.match(self.text, self.at)

    def accept(self, *ops: str) -> str | None:
        match = self.peek()
        if match and match["op"] in ops:
            self.at = match.end()
            return match["op"]
        return None

    def expect(self, op: str) -> None:
        if self.accept(op) is None:
            raise self.error(f"{op} expected")

    def choice(self) -> Tree:
        test = self.level(0)
        if self.accept("?") is None:
            return test
        yes = self.choice()
        self.expect(":")
        return Choice(test, yes, self.choice())

    def level(self, depth: int) -> Tree:
        left = self.unary()
        while (result := self.peek()) and _RANK.get(result["op"], -1) >= depth:
            self.at = result.end()
            left = Binary(result["op"], left, self.level(_RANK[result["op"]] + 1))
        return left

    def unary(self) -> Tree:
        if op := self.accept("-", "+", "!"):
            return Unary(op, self.unary())
        value = self.primary()
        if self.accept("^", "**"):
            return Binary("^", value, self.unary())
        return value

    def primary(self) -> Tree:
        match = self.peek()
        if match is None:
            raise self.error("something expected")
        self.at = match.end()
        if match["number"]:
            return Number(_plain(match["number"], match["suffix"]))
        if match["name"]:
            return self.name_or_call(match["name"])
        if closing := {"(": ")", "{": "}"}.get(match["op"]):
            inner = self.choice()
            self.expect(closing)
            return inner
        self.at = match.start()
        raise self.error("something expected")

    def name_or_call(self, name: str) -> Tree:
        if self.accept("(") is None:
            return Name(name)
        if name.lower() in ("v", "i"):
            end = self.text.find(")", self.at)
            inside, self.at = self.text[self.at : end], end + 1
            if end < 0 or not inside.strip():
                raise self.error("a node expected")
            return CircuitVariable(name.lower(), tuple(n.strip() for n in inside.split(",")))
        arguments: list[Tree] = []
        if self.accept(")") is None:
            arguments.append(self.choice())
            while self.accept(","):
                arguments.append(self.choice())
            self.expect(")")
        return Call(name.lower(), tuple(arguments))


def _plain(literal: str, suffix: str) -> str:
    """A literal without its scale factor; letters behind the factor mean nothing."""
    if not suffix:
        return literal
    plain = literal.removesuffix(suffix)
    if suffix.lower().startswith("mil"):
        return repr(float(plain) * MIL)
    power = next(power for key, power in PREFIXES.items() if suffix.lower().startswith(key))
    return repr(float(Decimal(plain).scaleb(power)))  # rounded once


# --- results: voltages of nodes and currents of devices, also inside of instances ---


@dataclass(frozen=True)
class Trace:
    """A saved vector: ``quantity`` is ``v`` of one or two nodes (``xa.xb.node``) or ``i`` of the
    device ``names[0]`` inside of the instances ``path``, by its ``parameter`` where it has one.
    """

    quantity: str
    names: tuple[str, ...]
    path: tuple[str, ...] = ()
    parameter: str = ""

    def within(self, instance: str) -> Trace:
        """The same inside of an instance of the circuit."""
        if self.quantity == "v":
            return replace(self, names=tuple(f"{instance}.{name}" for name in self.names))
        return replace(self, path=(instance, *self.path))

    def __str__(self) -> str:
        """As ngspice has it: the letter of an inner device stands before its path."""
        device = ".".join([self.names[0][0], *self.path, *self.names] if self.path else self.names)
        if self.parameter:
            return f"@{device}[{self.parameter}]"
        return f"{self.quantity}({','.join(self.names) if self.quantity == 'v' else device})"


def vector(text: str) -> Trace | None:
    """``v(node)``, ``v(a,b)``, a bare node, ``i(source)`` or ``@device[parameter]`` as a trace.

    None of anything else.
    """
    text = text.strip("\"'")
    head, _, inside = text.partition("(")
    if text.startswith("@") and text.endswith("]"):
        device, _, parameter = text[1:-1].partition("[")
        return _device(device, parameter)
    if not inside:
        return Trace("v", (text,))
    if head.lower() not in ("v", "i") or not inside.endswith(")") or "(" in inside:
        return None
    names = tuple(name.strip() for name in inside[:-1].split(","))
    return Trace("v", names) if head.lower() == "v" else _device(names[0], "")


def _device(text: str, parameter: str) -> Trace:
    *path, name = text.split(".")
    inner = path[1:] if path and len(path[0]) == 1 else path
    return Trace("i", (name,), tuple(inner), parameter)


def terms(expression: str) -> list[tuple[float, str]]:
    """Signs and vectors of a sum: ``v(a)-v(b)`` is ``[(1, "v(a)"), (-1, "v(b)")]``."""
    result = filter(None, expression.replace("-", "+-").split("+"))
    return [(-1.0 if term.startswith("-") else 1.0, term.removeprefix("-")) for term in result]


def added(signed: list[tuple[float, str]]) -> str:
    """The inverse of :func:`terms`."""
    return "".join(("-" if sign < 0 else "+") + text for sign, text in signed).removeprefix("+")
