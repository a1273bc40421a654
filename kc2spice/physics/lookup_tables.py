"""Lookups: smooth interpolation of tables in a netlist.

A lookup interpolates a table of values at equally spaced arguments. The interval between two
neighbouring arguments is called a cell. The variable ``s`` is the distance of an argument from the
first argument in the table, divided by the cell size. The variable ``t`` from 0 to 1 is the
position within a cell, and ``w = t (1 - t)`` is a weight. Each lookup is ``f(s) - w b(s)`` with two
piecewise linear functions ``f`` and ``b``, see :func:`compute_smooth_lookup`.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.netlist.expression import (
    BinaryOperation,
    CircuitVariable,
    FunctionCall,
    Name,
    Number,
    Tree,
    map_operands,
    walk_tree,
)
from kc2spice.netlist.number_and_name_spelling import format_number
from kc2spice.physics.symbolic_algebra import (
    ZERO,
    WeightedCalls,
    add_trees,
    evaluate_tree,
    format_tree,
    make_weighted_sum,
    multiply_trees,
    split_calls,
)

# names of the nodes whose voltages are ``s`` and ``w``
CELL_NODE = "lookup_s"
WEIGHT_NODE = "lookup_w"


@dataclass(frozen=True)
class TableFunction:
    """Table in a declaration: a function of one argument from ``low`` to ``high``.

    ``function`` takes an array of arguments, and returns an array of the table's values. The lookup
    in the netlist has ``points`` equally spaced points. ``unit`` is the unit of the values, which
    netlist comments state.
    """

    low: float
    high: float
    points: int
    function: Callable[[np.ndarray], np.ndarray]
    unit: str = ""

    @cached_property
    def values(self) -> np.ndarray:
        """Values of the table at equally spaced arguments."""
        return np.asarray(self.function(np.linspace(self.low, self.high, self.points)))

    @property
    def argument_range(self) -> tuple[float, float, int]:
        """First argument, last argument, and number of points of the table."""
        return self.low, self.high, self.points


class Lookups:
    """Interpolated tables (lookups) in the laws of a declaration.

    Each term of a law has at most one table as a factor. Terms of a law that differ only in the
    table are combined into one lookup. A lookup that occurs once is written into the expression of
    the law. A lookup that occurs in several laws becomes a node of the netlist.

    Raises
    ------
    UsageError : a law contains a table inside a function, a product of tables, or tables of
        different arguments.
    """

    def __init__(
        self, tables: Mapping[str, TableFunction], laws: Iterable[Tree], base: str
    ) -> None:
        self.tables, self.base = tables, base
        uses = Counter[WeightedCalls]()
        for law in laws:
            uses.update(calls for _, calls in split_calls(law, tables)[0])
        self._require_common_argument(uses)
        self.labels: dict[WeightedCalls, str] = {}
        for calls in uses:
            (first, _), *others = calls
            self.labels[calls] = f"lookup_{len(self.labels)}" if others else first.function
        self.repeated = tuple(calls for calls, count in uses.items() if count > 1)

    def _require_common_argument(self, uses: Iterable[WeightedCalls]) -> None:
        """Reject tables with different arguments or ranges.

        Interpolation uses the same pair of neighbouring table points for all tables of a part.
        Therefore, all tables of a part need the same argument and range.
        """
        self.argument: Tree | None = None
        ranges = {table.argument_range for table in self.tables.values()}
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

    def evaluate_at_table_points(self, tree: Tree) -> np.ndarray:
        """Evaluate an expression with lookup tables at all points of these tables.

        The returned values are an array of shape (points,).
        """
        known = {name: table.values for name, table in self.tables.items()}
        return np.asarray(evaluate_tree(_replace_calls_by_names(tree, self.tables), known))

    def describe_lookup(self, calls: WeightedCalls) -> str:
        """Return the formula and the unit of a lookup, as text for a netlist comment."""
        units = dict.fromkeys(self.tables[call.function].unit for call, _ in calls)
        formula, unit = format_tree(make_weighted_sum(calls)), ", ".join(filter(None, units))
        return f"{formula}: {unit}" if unit else formula

    @property
    def single_use_formulas(self) -> dict[str, str]:
        """Formulas of single-use lookups, which only one law contains, keyed by label."""
        once = (calls for calls in self.labels if calls not in self.repeated)
        return {self.labels[calls]: self.describe_lookup(calls) for calls in once}

    def list_lookup_trees(self) -> dict[str, Tree]:
        """Return each lookup as an expression of node voltages, keyed by label."""
        result: dict[str, Tree] = {}
        for calls, label in self.labels.items():
            result[label] = (
                CircuitVariable("v", (label,))
                if calls in self.repeated
                else self.write_interpolation(
                    self.evaluate_at_table_points(make_weighted_sum(calls))
                )
            )
        return result

    def write_interpolation(self, values: np.ndarray) -> Tree:
        """Return an expression of node voltages that interpolates tabulated ``values``."""
        cell, weight = (CircuitVariable("v", (node,)) for node in (CELL_NODE, WEIGHT_NODE))
        f, b = (FunctionCall("pwl", (cell, *points)) for points in compute_smooth_lookup(values))
        return BinaryOperation("-", f, BinaryOperation("*", weight, b))

    def split_law(self, law: Tree) -> list[Tree]:
        """Split a law into terms, and replace its tables by the names of their lookups.

        One returned term contains all lookups that occur in several laws; the netlist computes the
        values of these lookups as node voltages. For each lookup that occurs in no other law, the
        returned list contains a term with this lookup alone.
        """
        if not has_tables(law, self.tables):
            return [law]
        terms, rest = split_calls(law, self.tables)
        sums, single = [rest], list[Tree]()
        for factor, calls in terms:
            group = sums if calls in self.repeated else single
            group.append(multiply_trees(factor, Name(self.labels[calls])))
        together = add_trees(*sums)
        return [*single, together] if together != ZERO or not single else single


def _replace_calls_by_names(tree: Tree, tables: Mapping[str, TableFunction]) -> Tree:
    """Replace each call of a table in an expression by the name of the table."""
    if isinstance(tree, FunctionCall) and tree.function in tables:
        return Name(tree.function)
    return map_operands(tree, lambda node: _replace_calls_by_names(node, tables))


def has_tables(tree: Tree, tables: Iterable[str]) -> bool:
    """Return whether an expression calls a table."""
    known = set(tables)
    return any(
        isinstance(node, FunctionCall) and node.function in known for node in walk_tree(tree)
    )


def compute_smooth_lookup(values: np.ndarray) -> tuple[tuple[Number, ...], tuple[Number, ...]]:
    """Return the points of two functions that together define a smooth table lookup.

    The functions ``f`` and ``b`` are piecewise linear. The function ``f`` interpolates the equally
    spaced ``values``. The function ``b`` interpolates the second differences of ``values``,
    multiplied by 1/2. The position within a cell is t from 0 to 1, and ``w = t (1 - t)``. The
    combination ``f - w b`` is the weighted mean of two parabolas, each through three neighbouring
    values (Overhauser 1968). The slope of ``f - w b`` is continuous, and its interpolation error is
    of the third order in the cell size. A cubic polynomial extrapolates one value beyond each end,
    so that the interpolation error at the ends is also of the third order. Beyond the ends, ``f - w
    b`` is constant.

    Redundant points of ``b`` are omitted, because the time that ngspice needs to read a table is
    proportional to the square of the number of points. A point is omitted if the omission changes
    interpolated values by less than the interpolation error. The interpolation error is estimated
    as 1/16 of the largest fourth difference of ``values``.
    """
    weights = np.array([4, -6, 4, -1])
    first, last = weights @ values[:4], weights @ values[:-5:-1]
    f = np.concatenate([[first], values, [last]])
    halves = np.diff(f[[0, *range(f.size), -1]], 2) / 2
    # The fourth difference is estimated as (second difference)^2 / value.
    # The second differences at both ends, where the function has corners, are excluded.
    largest, second = float(np.abs(values).max()), float(np.abs(2 * halves[2:-2]).max())
    return _list_pwl_points(f), _list_pwl_points(halves, second**2 / 4 / (largest or 1.0))


def _list_pwl_points(values: np.ndarray, tolerance: float = 0.0) -> tuple[Number, ...]:
    """List the points of a ``pwl()`` function with ``values`` at x = -1, 0, 1, ….

    ngspice extrapolates the outer segments. An additional point beyond each end has the value of
    the end point, so that ngspice extrapolates a constant. Points that are within ``tolerance`` of
    the straight line between their neighbours are omitted.
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
        # ngspice retains only 11 digits of a number in an expression
        result += [Number(str(k - 2)), Number(format_number(float(f"{f[k]:.11g}")))]
    return tuple(result)
