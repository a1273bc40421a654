"""Tables of a declaration as lookups in a netlist.

A lookup interpolates values at equally spaced arguments. The argument is counted in cells, ``s``,
with the place ``t`` from 0 to 1 within a cell and the weight ``w = t (1 - t)``. Each lookup is
``f(s) - w b(s)`` with two polylines ``f`` and ``b``, see :func:`smooth_lookup`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.netlist.expression import (
    Binary,
    Call,
    CircuitVariable,
    Name,
    Number,
    Tree,
    map_operands,
    walk_tree,
)
from kc2spice.netlist.spelling import format_number
from kc2spice.physics.symbolic import (
    ZERO,
    WeightedCalls,
    add_trees,
    evaluate_tree,
    format_tree,
    multiply_trees,
    split_calls,
    weighted_sum,
)

# node names of the cell index and of the position in the cell
CELL_NODE = "lookup_s"
WEIGHT_NODE = "lookup_w"


@dataclass(frozen=True)
class TableFunction:
    """A function of one argument between ``low`` and ``high`` in the netlist of a declaration.

    ``function`` returns the values at an array of arguments. ``points`` is the number of points of
    the lookup, ``unit`` is the unit of a value, for comments.
    """

    low: float
    high: float
    points: int
    function: Callable[[np.ndarray], np.ndarray]
    unit: str = ""

    @cached_property
    def values(self) -> np.ndarray:
        """Values at equally spaced arguments."""
        return np.asarray(self.function(np.linspace(self.low, self.high, self.points)))

    @property
    def range(self) -> tuple[float, float, int]:
        """Ends and number of the arguments."""
        return self.low, self.high, self.points


class Lookups:
    """Lookups in the ``laws`` of a declaration with ``tables``.

    Each term of a law has at most one table as a factor. Terms with equal other factors share one
    lookup. A lookup that occurs once is written into its law; every other lookup is a node.

    Raises
    ------
    UsageError : a table inside a function or a product of tables, or tables of several arguments.
    """

    def __init__(
        self, tables: Mapping[str, TableFunction], laws: Iterable[Tree], base: str
    ) -> None:
        self.tables, self.base = tables, base
        uses = Counter[WeightedCalls]()
        for law in laws:
            uses.update(calls for _, calls in split_calls(law, tables)[0])
        self._check_arguments(uses)
        self.labels: dict[WeightedCalls, str] = {}
        for calls in uses:
            (first, _), *others = calls
            self.labels[calls] = f"lookup_{len(self.labels)}" if others else first.function
        self.repeated = tuple(calls for calls, count in uses.items() if count > 1)

    def _check_arguments(self, uses: Iterable[WeightedCalls]) -> None:
        """Refuse tables of several arguments or ranges, which would need further cells."""
        self.argument: Tree | None = None
        ranges = {table.range for table in self.tables.values()}
        arguments = {call.arguments[0] for calls in uses for call, _ in calls}
        if len(arguments) > 1 or (arguments and len(ranges) > 1):
            raise UsageError(
                "the tables differ in their arguments or ranges",
                got=", ".join(sorted(map(format_tree, arguments))),
                expected="one common argument and range for all tables of a part",
            )
        if arguments:
            (self.argument,) = arguments
            self.low, high, self.points = next(iter(ranges))
            self.step = (high - self.low) / (self.points - 1)

    def values(self, tree: Tree) -> np.ndarray:
        """Values of an expression of tables alone at all points."""
        known = {name: table.values for name, table in self.tables.items()}
        return np.asarray(evaluate_tree(_name_calls(tree, self.tables), known))

    def describe(self, calls: WeightedCalls) -> str:
        """Return the formula and the unit of a lookup."""
        units = dict.fromkeys(self.tables[call.function].unit for call, _ in calls)
        return f"{format_tree(weighted_sum(calls))}: {', '.join(filter(None, units))}".removesuffix(
            ": "
        )

    @property
    def inline_formulas(self) -> dict[str, str]:
        """Formulas of the lookups that occur once, by their labels."""
        once = (calls for calls in self.labels if calls not in self.repeated)
        return {self.labels[calls]: self.describe(calls) for calls in once}

    def node_trees(self) -> dict[str, Tree]:
        """Return the expression of each lookup in node voltages, by its label."""
        result: dict[str, Tree] = {}
        for calls, label in self.labels.items():
            result[label] = (
                CircuitVariable("v", (label,))
                if calls in self.repeated
                else self.interpolate(self.values(weighted_sum(calls)))
            )
        return result

    def interpolate(self, values: np.ndarray) -> Tree:
        """Return the lookup of ``values`` at all points in node voltages."""
        cell, weight = (CircuitVariable("v", (node,)) for node in (CELL_NODE, WEIGHT_NODE))
        f, b = (Call("pwl", (cell, *points)) for points in smooth_lookup(values))
        return Binary("-", f, Binary("*", weight, b))

    def split(self, law: Tree) -> list[Tree]:
        """Return a law as terms with labels of lookups; lookups with nodes form one term."""
        if not has_tables(law, self.tables):
            return [law]
        terms, rest = split_calls(law, self.tables)
        sums, single = [rest], list[Tree]()
        for factor, calls in terms:
            group = sums if calls in self.repeated else single
            group.append(multiply_trees(factor, Name(self.labels[calls])))
        together = add_trees(*sums)
        return [*single, together] if together != ZERO or not single else single


def _name_calls(tree: Tree, tables: Mapping[str, TableFunction]) -> Tree:
    """Replace each call of a table in ``tree`` by the name of the table."""
    if isinstance(tree, Call) and tree.function in tables:
        return Name(tree.function)
    return map_operands(tree, lambda node: _name_calls(node, tables))


def has_tables(tree: Tree, tables: Iterable[str]) -> bool:
    """Whether ``tree`` calls a table."""
    known = set(tables)
    return any(isinstance(node, Call) and node.function in known for node in walk_tree(tree))


def smooth_lookup(values: np.ndarray) -> tuple[tuple[Number, ...], tuple[Number, ...]]:
    """Return the points of the lookups ``f`` and ``b``; ``f(s) - w(s) b(s)`` has a smooth slope.

    ``s`` counts cells from the first of the equally spaced ``values``, ``b`` are half the second
    differences and ``w = t (1 - t)`` with t the place within a cell, 0 to 1: the blend of the
    parabolas through three neighbours (Overhauser 1968), exact to third order, where a polyline's
    slope jumps at every point. One additional cubic value on either side keeps this order up to
    both ends. Beyond the ends the function is constant. Points of the smooth ``b`` that change ``f
    - w b`` by less than a sixteenth of a fourth difference, which the blend neglects, are left
    out, because ngspice needs a time in proportion to the square of the length to read a table.
    """
    weights = np.array([4, -6, 4, -1])
    first, last = weights @ values[:4], weights @ values[:-5:-1]
    f = np.concatenate([[first], values, [last]])
    halves = np.diff(f[[0, *range(f.size), -1]], 2) / 2
    # Fourth differences relate to second differences as second differences relate to the values,
    # except at the corners at both ends.
    largest, second = float(np.abs(values).max()), float(np.abs(2 * halves[2:-2]).max())
    return _table_points(f), _table_points(halves, second**2 / 4 / (largest or 1.0))


def _table_points(values: np.ndarray, tolerance: float = 0.0) -> tuple[Number, ...]:
    """Arguments of a ``pwl()`` of ``values`` at -1, 0, 1, ..., constant beyond both ends.

    ngspice extrapolates the outer segments, so each end gets a second point of equal value. Points
    that lie within ``tolerance`` of the lines between others are left out.
    """
    f = np.concatenate([values[:1], values, values[-1:]])
    indices, last = [0, 1], f.size - 2
    while indices[-1] < last:
        a = indices[-1]
        end = a + 1
        for b in range(a + 2, last + 1):
            line = np.linspace(f[a], f[b], b - a + 1)
            if np.abs(line - f[a : b + 1]).max() > tolerance:
                break
            end = b
        indices.append(end)
    result = []
    for k in (*indices, f.size - 1):
        # ngspice keeps 11 digits of a literal in an expression
        result += [Number(str(k - 2)), Number(format_number(float(f"{f[k]:.11g}")))]
    return tuple(result)
