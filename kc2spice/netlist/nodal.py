"""Frequency response of a linear circuit, by nodal analysis of a parsed netlist.

The equations follow only from the elements of the netlist and from the parameters of an instance.
The response is therefore independent of the model from which the circuit was generated (C.-W. Ho,
A. Ruehli, P. Brennan, IEEE Trans. Circuits Syst. 22 (1975) 504).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import filterfalse

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.netlist.circuit import Circuit, Element, Parameters, select_items
from kc2spice.netlist.expression import Tree, evaluate_parameter, parse_expression

GROUND = "0"
# Largest number of unknowns for which dense matrices are faster than sparse matrices.
# Dense matrices are solved for all frequencies at once, and sparse matrices for one frequency at a
# time.
MAX_DENSE_UNKNOWNS = 60
_BRANCH_KINDS = frozenset("vel")  # element letters whose current is an additional unknown


@dataclass(frozen=True, eq=False)
class NodalEquations:
    """Equations ``(G + s C) x = b`` of the node voltages and some element currents.

    ``rows`` contains the number of each unknown, keyed by the lower-case node name, or by
    ``i(NAME)`` for the current of an element. An element current flows through the element from its
    first to its second node. The voltages of nodes at ground are not unknowns. ``entries`` contains
    the row numbers, column numbers and values of the matrices G and C.
    """

    rows: Mapping[str, int]
    entries: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]

    def solve(
        self, s: np.ndarray, loads: Sequence[Mapping[str, float]], answers: Sequence[str]
    ) -> np.ndarray:
        """Solve for selected unknowns at each frequency and under each load.

        The result has the shape (len(s), len(answers), len(loads)); ``s`` contains complex
        frequencies. A load contains currents into nodes, keyed by node, and voltages of sources,
        keyed by ``i(NAME)``. The voltage of a grounded node is zero.
        """
        # imported here, because a program that only writes a library does not need these packages
        import scipy.sparse as sparse
        from scipy.sparse.linalg import splu

        n = len(self.rows)
        G, C = (sparse.csc_array((v, (i, j)), shape=(n, n)) for i, j, v in self.entries)
        b = np.zeros((n, len(loads)), complex)
        for column, load in enumerate(loads):
            for name, size in load.items():
                b[self.rows[name], column] += size
        rows = [self.rows.get(name, -1) for name in answers]
        result = np.zeros((len(s), len(answers), len(loads)), complex)
        if n <= MAX_DENSE_UNKNOWNS:
            A = G.toarray() + s[:, None, None] * C.toarray()
            x = np.linalg.solve(A, np.broadcast_to(b, (len(s), *b.shape)))
            result[:] = np.where(np.array(rows)[:, None] >= 0, x[:, rows], 0.0)
            return result
        for k, point in enumerate(s):
            x = splu(sparse.csc_matrix(G + point * C)).solve(b)
            result[k] = np.where(np.array(rows)[:, None] >= 0, x[rows], 0.0)
        return result


@dataclass(frozen=True)
class NodalCircuit:
    """Linear subcircuit of R, C, L, G, E and V elements with all sources at zero.

    Raises
    ------
    UsageError : the subcircuit contains an element of another kind.
    """

    circuit: Circuit

    @cached_property
    def parameters(self) -> list[tuple[str, Tree]]:
        """Lower-case name and expression of each parameter, in the order of the cards."""
        result: list[tuple[str, Tree]] = []
        for card in select_items(self.circuit.items, Parameters):
            for key, text in card.values.items():
                result.append((key.lower(), parse_expression(text)))
        return result

    @cached_property
    def element_values(self) -> list[tuple[Element, Tree | float]]:
        """Pairs of an element and its value or expression; voltage sources have value 0."""
        items = select_items(self.circuit.items, Element)
        return list(zip(items, map(_parse_value, items), strict=True))

    def equations(
        self,
        values: Mapping[str, float],
        grounded: Collection[str],
        sources: Mapping[str, str],
    ) -> NodalEquations:
        """Return the nodal equations of the circuit for given parameter values.

        Parameters
        ----------
        values : parameters of the instance, keyed by lower-case name; all others have their
            default values.
        grounded : pins of the instance at ground.
        sources : additional voltage sources to ground: the node of each source, keyed by its name.
        """
        elements = list(self.element_values)
        for name, node in sources.items():
            elements.append((Element(kind="v", name=name, nodes=(node, GROUND)), 0.0))
        rows = _number_unknowns(elements, {GROUND, *map(str.lower, grounded)})
        names = self._evaluate_parameters(values)
        stamps: tuple[list[tuple[int, int, float]], ...] = ([], [])
        for item, size in elements:
            number = size if isinstance(size, float) else evaluate_parameter(size, names)
            for part, i, j, entry in _stamp_entries(item, number):
                if i in rows and j in rows:
                    stamps[part].append((rows[i], rows[j], entry))
        return NodalEquations(rows, tuple(map(_split_columns, stamps)))

    def _evaluate_parameters(self, values: Mapping[str, float]) -> dict[str, float]:
        """Return the values of all parameters, keyed by lower-case name."""
        names: dict[str, float] = {}
        for key, text in self.circuit.defaults.items():
            names[key.lower()] = evaluate_parameter(parse_expression(text), {})
        names |= values
        for key, tree in self.parameters:
            names[key] = evaluate_parameter(tree, names)
        return names


def _number_unknowns(
    elements: Iterable[tuple[Element, object]], grounded: Collection[str]
) -> dict[str, int]:
    """Number the unknowns: first the node voltages, then the currents of elements."""
    nodes, currents = dict[str, None](), []
    for item, _ in elements:
        nodes |= dict.fromkeys(item.lower_case_nodes)
        if item.kind in _BRANCH_KINDS:
            currents.append(f"i({item.key})")
    unknowns = [*filterfalse(grounded.__contains__, nodes), *currents]
    return dict(zip(unknowns, range(len(unknowns)), strict=True))


def _split_columns(
    entries: Sequence[tuple[int, int, float]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Split matrix entries into row indices, column indices and values, as arrays."""
    i, j, v = zip(*entries, strict=True) if entries else ((), (), ())
    return np.array(i, int), np.array(j, int), np.array(v, float)


def _parse_value(item: Element) -> Tree | float:
    """Return the value of a linear element, which is a number or an expression."""
    if item.kind == "v":
        return 0.0
    if item.kind not in "rclge" or item.expression or len(item.values) != 1:
        raise UsageError(
            "this element is not linear",
            where=item.where,
            got=item.written[:80] or item.name,
            expected="R, C, L, G or E with one number",
        )
    try:
        return float(item.values[0])
    except ValueError:
        return parse_expression(item.values[0], where=item.where)


def _stamp_entries(item: Element, size: float) -> Iterable[tuple[int, str, str, float]]:
    """Yield the entries of the matrices G and C that one element contributes.

    An entry consists of the number of the matrix (0: G, 1: C), the number of the equation, the
    number of the unknown, and the value.

    The equation of a node states that the currents out of the node sum to zero. The equation of an
    element's current is the constitutive equation of the element.
    """
    a, b = item.lower_case_nodes[:2]
    if item.kind in "rc":
        part, conductance = ("rc".index(item.kind), 1 / size if item.kind == "r" else size)
        for row, sign in ((a, conductance), (b, -conductance)):
            yield part, row, a, sign
            yield part, row, b, -sign
        return
    if item.kind == "g":
        plus, minus = item.lower_case_nodes[2:4]
        for row, sign in ((a, size), (b, -size)):
            yield 0, row, plus, sign
            yield 0, row, minus, -sign
        return
    current = f"i({item.key})"
    yield 0, a, current, 1.0
    yield 0, b, current, -1.0
    yield 0, current, a, 1.0
    yield 0, current, b, -1.0
    if item.kind == "l":
        yield 1, current, current, -size
    if item.kind == "e":
        plus, minus = item.lower_case_nodes[2:4]
        yield 0, current, plus, -size
        yield 0, current, minus, size
