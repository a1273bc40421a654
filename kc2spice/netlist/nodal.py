"""Nodal analysis of linear circuits: a circuit tree in, its frequency response out.

The equations are those of the elements as they stand in the tree, after the parameters of an
instance were inserted. Nothing is known here of the model that the circuit was made from
(C.-W. Ho, A. Ruehli, P. Brennan, IEEE Trans. Circuits Syst. 22 (1975) 504.)
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.netlist.circuit import Circuit, Element, Parameters, items_of
from kc2spice.netlist.expression import Tree, parse, value

GROUND = "0"
DENSE = 60  # unknowns up to which dense matrices, all frequencies at once, take less time
_BRANCHED = frozenset("vel")  # elements whose current is an unknown of its own


@dataclass(frozen=True, eq=False)
class NodalEquations:
    """``(G + s C) x = b``: node voltages, then currents of sources and inductors.

    ``rows`` are the unknowns by lower-case names, the current of an element as ``i(NAME)``; it
    flows into the first node of the element, through it, and out of the second one. Nodes at
    ground have no row. ``entries`` are rows, columns and values of G and of C.
    """

    rows: Mapping[str, int]
    entries: tuple[tuple[np.ndarray, np.ndarray, np.ndarray], ...]

    def solve(
        self, s: np.ndarray, loads: Sequence[Mapping[str, float]], answers: Sequence[str]
    ) -> np.ndarray:
        """The ``answers`` (len(s), answers, loads) to each of the ``loads``.

        A load is the current into each named node, or the voltage of each source ``i(NAME)``.
        An answer at ground is zero.
        """
        import scipy.sparse as sparse  # a library that is only written needs neither
        from scipy.sparse.linalg import splu

        n = len(self.rows)
        G, C = (sparse.csc_array((v, (i, j)), shape=(n, n)) for i, j, v in self.entries)
        b = np.zeros((n, len(loads)), complex)
        for column, load in enumerate(loads):
            for name, size in load.items():
                b[self.rows[name], column] += size
        rows = [self.rows.get(name, -1) for name in answers]
        result = np.zeros((len(s), len(answers), len(loads)), complex)
        if n <= DENSE:
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
    """The linear elements R, C, L, G, E and V of a subcircuit, whose sources are at rest.

    Raises
    ------
    UsageError : another element.
    """

    circuit: Circuit

    @cached_property
    def parameters(self) -> list[tuple[str, Tree]]:
        """Names in lower case with their expressions, in the order of the ``.param`` cards."""
        result: list[tuple[str, Tree]] = []
        for card in items_of(self.circuit.items, Parameters):
            for key, text in card.values.items():
                result.append((key.lower(), parse(text)))
        return result

    @cached_property
    def elements(self) -> list[tuple[Element, Tree | float]]:
        """Each element with the expression of its value, zero of a source."""
        return [(item, _value(item)) for item in items_of(self.circuit.items, Element)]

    def equations(
        self,
        values: Mapping[str, float],
        grounded: Collection[str],
        sources: Mapping[str, str],
    ) -> NodalEquations:
        """The equations of an instance.

        Parameters
        ----------
        values : its parameters, by names in lower case; all others have their defaults.
        grounded : its pins at ground.
        sources : further voltage sources from nodes to ground, the node by the source's name.
        """
        names = {key.lower(): value(parse(text), {}) for key, text in self.circuit.defaults.items()}
        names |= values
        for key, tree in self.parameters:
            names[key] = value(tree, names)
        extra_sources = [
            Element(kind="v", name=n, nodes=(node, GROUND)) for n, node in sources.items()
        ]
        every = [*self.elements, *((item, 0.0) for item in extra_sources)]
        low = {GROUND, *map(str.lower, grounded)}
        nodes = dict.fromkeys(end for item, _ in every for end in item.ends)
        unknowns = [node for node in nodes if node not in low]
        unknowns += [f"i({item.key})" for item, _ in every if item.kind in _BRANCHED]
        rows = {name: row for row, name in enumerate(unknowns)}
        stamps: tuple[list[tuple[int, int, float]], ...] = ([], [])
        for item, size in every:
            number = size if isinstance(size, float) else value(size, names)
            for part, i, j, entry in _stamps(item, number):
                if i in rows and j in rows:
                    stamps[part].append((rows[i], rows[j], entry))
        return NodalEquations(rows, tuple(map(_arrays, stamps)))


def _arrays(
    entries: Sequence[tuple[int, int, float]],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    i, j, v = zip(*entries, strict=True) if entries else ((), (), ())
    return np.array(i, int), np.array(j, int), np.array(v, float)


def _value(item: Element) -> Tree | float:
    if item.kind == "v":
        return 0.0
    if item.kind not in "rclge" or item.expression or len(item.values) != 1:
        raise UsageError(
            "not an element of a linear circuit",
            where=item.where,
            got=item.written[:80] or item.name,
            expected="R, C, L, G or E with one number",
        )
    try:
        return float(item.values[0])
    except ValueError:
        return parse(item.values[0], where=item.where)


def _stamps(item: Element, size: float) -> Iterable[tuple[int, str, str, float]]:
    """Entries of G (0) and C (1): equation, unknown, value. The equation of a node is the sum of
    the currents that leave it; that of a current is the law of its element."""
    a, b = item.ends[:2]
    if item.kind in "rc":
        part, conductance = ("rc".index(item.kind), 1 / size if item.kind == "r" else size)
        for row, sign in ((a, conductance), (b, -conductance)):
            yield part, row, a, sign
            yield part, row, b, -sign
        return
    if item.kind == "g":
        plus, minus = item.ends[2:4]
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
        plus, minus = item.ends[2:4]
        yield 0, current, plus, -size
        yield 0, current, minus, size
