"""Node coordinates and node sets from input files of finite-element programs.

The formats are:

* Abaqus and CalculiX ``.inp`` with ``*NODE`` and ``*NSET``, and at most one instance,
* Nastran bulk data with ``GRID`` in the basic coordinate system,
* Ansys ``.cdb`` with ``NBLOCK`` and ``CMBLOCK``,
* ``.csv`` with lines ``node, x, y, z``.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from kc2spice.bodies.readers.fem_program_formats import list_bulk_data_cards, parse_fortran_number
from kc2spice.bodies.readers.raw_matrices import MAX_ROWS, parse_file
from kc2spice.core.errors import UsageError, unknown, wrong

_EXPECTED = "an .inp, .cdb, .bdf, .dat, .nas, .pch or .csv file with the nodes"


@dataclass(frozen=True, eq=False)
class NodeMesh:
    """Numbers and coordinates of the nodes of a mesh, and its node sets.

    ``node`` (n,) contains the numbers of the nodes, and ``at`` (n, 3) their coordinates in the unit
    of the file. ``sets`` contains the node numbers of each node set, keyed by the name of the set
    in capital letters. ``where`` is the path of the mesh file.
    """

    where: str
    node: np.ndarray
    at: np.ndarray
    sets: dict[str, np.ndarray] = field(default_factory=dict)

    def get_node_set(self, name: str, where: str) -> np.ndarray:
        """Return the numbers of the nodes in the node set ``name``.

        ``where`` is the key that contains the name, for error messages.

        Raises
        ------
        UsageError : the node set does not exist, or is empty.
        """
        result = self.sets.get(name.upper())
        if result is None or not len(result):
            raise unknown(f"{self.where} has no such node set", name, sorted(self.sets), where)
        return result

    def find_nearest_node(self, place: tuple[float, ...], within: float | None, where: str) -> int:
        """Return the number of the node that is nearest to the point ``place``.

        The distance between node and point must be at most ``within``, by default 1e-6 times the
        size of the mesh. ``where`` is the key that contains the point, for error messages.

        Raises
        ------
        UsageError : no node is within the permitted distance.
        """
        distance = np.linalg.norm(self.at - np.asarray(place), axis=1)
        best = int(distance.argmin())
        extent = float(np.ptp(self.at, axis=0).max())
        if distance[best] > (1e-6 * extent if within is None else within):
            x, y, z = self.at[best]
            expected = f"within {distance[best]:.4g} of node {self.node[best]} at "
            expected += f"[{x:g}, {y:g}, {z:g}]"
            raise wrong(
                where,
                "the mesh has no node at this point",
                got=list(place),
                expected=expected,
                hint=f"write  at = [{x:.9g}, {y:.9g}, {z:.9g}]",
            )
        return int(self.node[best])


def read_nodes(path: Path) -> NodeMesh:
    """Read the nodes and node sets in a mesh file.

    The file extension determines the format.

    Raises
    ------
    UsageError : the file is damaged, has an unknown format, or contains several instances,
        transformed coordinates, or no nodes.
    """
    read = _READERS.get(path.suffix.lower())
    if read is None:
        raise UsageError(
            "this file is not a mesh in a supported format",
            where=str(path),
            got=path.suffix,
            expected=_EXPECTED,
            hint="export the mesh in one of these formats",
        )

    def parse_nodes(data: bytes) -> NodeMesh:
        """Parse nodes and node sets of a mesh file; require finite node coordinates."""
        nodes, sets = read(data)
        if not nodes:
            raise ValueError("the file contains no node")
        node = np.fromiter(nodes, dtype=np.int64, count=len(nodes))
        at = np.array(list(nodes.values()), dtype=float)
        if not np.isfinite(at).all():
            raise ValueError("a node coordinate is not a finite number")
        node_sets = {name: np.unique(np.array(item, np.int64)) for name, item in sets.items()}
        return NodeMesh(str(path), node, at, node_sets)

    return parse_file(path, _EXPECTED, parse_nodes)


Nodes = dict[int, tuple[float, float, float]]
Content = tuple[Nodes, dict[str, list[int]]]


def _decode_lines(data: bytes) -> list[str]:
    """Return the lines of UTF-8 text; bytes that are not UTF-8 are replaced."""
    return data.decode("utf-8", "replace").splitlines()


def _split_at_commas(line: str) -> list[str]:
    """Split a line at its commas into words, and remove the blanks around each word."""
    return list(map(str.strip, line.split(",")))


def _parse_point(words: Iterable[str]) -> tuple[float, float, float]:
    """Parse the coordinates of a node; missing coordinates are 0."""
    values = [parse_fortran_number(word) if word.strip() else 0.0 for word in words][:3]
    x, y, z = values + [0.0] * (3 - len(values))
    return x, y, z


class _NodeSets(dict[str, list[int]]):
    """Mapping of node-set names to node numbers, with a limit of the total number.

    The limit is necessary, because a few characters in a mesh file may define a large range of
    nodes.
    """

    def add(self, name: str, members: Sequence[int]) -> None:
        """Add nodes to the node set ``name``; raise an error if the total is too large."""
        if len(members) + sum(map(len, self.values())) > MAX_ROWS:
            raise ValueError(f"the node sets have more than {MAX_ROWS} nodes")
        self.setdefault(name, []).extend(members)


def _parse_abaqus_nodes(data: bytes) -> Content:
    """Parse the nodes and node sets in an input file of Abaqus or CalculiX."""
    nodes: Nodes = {}
    sets = _NodeSets()
    keyword, options, instances = "", dict[str, str](), 0
    for line in _decode_lines(data):
        if line.startswith("**") or not line.strip():
            continue
        if line.startswith("*"):
            keyword, *words = _split_at_commas(line[1:].upper())
            options = {}
            for word in words:
                key, _, value = word.partition("=")
                options[key.strip()] = value.strip().strip('"')
            instances += keyword == "INSTANCE"
            if instances > 1:
                raise ValueError(
                    "a file with more than one *INSTANCE cannot be used, because its node numbers "
                    "differ from the node numbers in the .mtx file"
                )
            continue
        cells = _split_at_commas(line)
        filled, name = list(filter(None, cells)), options.get("NSET", "")
        if keyword == "INSTANCE" and any(map(float, filled)):
            raise ValueError("an *INSTANCE with a translation or rotation is not supported")
        if keyword == "NODE":
            nodes[int(cells[0])] = _parse_point(cells[1:4])
            if name:
                sets.setdefault(name, []).append(int(cells[0]))
        elif keyword == "NSET" and "GENERATE" in options:
            first, last, *step = map(int, filled)
            sets.add(name, range(first, last + 1, step[0] if step else 1))
        elif keyword == "NSET":
            for word in map(str.upper, filled):
                number = word.lstrip("-").isdigit()
                sets.add(name, [int(word)] if number else sets.get(word, ()))
    return nodes, sets


def _parse_bulk_data(data: bytes) -> Content:
    """Parse the nodes on the GRID cards of Nastran bulk data."""
    nodes: Nodes = {}
    for cells in list_bulk_data_cards(data, "GRID"):
        number, system, *place = map(str.strip, cells[:5])
        if system not in ("", "0"):
            raise ValueError(
                f"grid {number} is in coordinate system {system}, not in the basic system"
            )
        nodes[int(number)] = _parse_point(place)
    return nodes, {}


def _parse_blocks(data: bytes) -> Content:
    """Parse the nodes and node sets in a ``.cdb`` file of Ansys.

    Nodes follow the command ``NBLOCK``. Each line of nodes contains a node number, two other
    integers and the coordinates x, y, z, in fields of fixed width. A node set follows the command
    ``CMBLOCK``.
    """
    nodes: Nodes = {}
    sets = _NodeSets()
    lines = iter(_decode_lines(data))
    for line in lines:
        head = line.upper()
        if head.startswith("NBLOCK"):
            # The format (3i9,6e21.13e3) states number and width of integer and coordinate fields.
            integers, floats = next(lines).strip().strip("()").lower().split(",")[:2]
            fields, wide = map(int, integers.split("i"))
            item = int(floats.split("e")[1].split(".")[0])
            ends = range(fields * wide, fields * wide + 4 * item, item)
            for row in lines:
                if row[:1] in ("N", "n", "-") or row.strip() == "-1":
                    break
                nodes[int(row[:wide])] = _parse_point(row[a:b] for a, b in pairwise(ends))
        elif head.startswith("CMBLOCK"):
            _, name, kind, count, *_ = _split_at_commas(head)
            next(lines)
            members: list[int] = []
            while len(members) < int(count.split("!")[0]):
                members += list(map(int, next(lines).split()))
            for before, number in pairwise([0, *members] if kind == "NODE" else ()):
                # a negative number ends a range that begins with the previous number
                sets.add(name, range(before + 1, 1 - number) if number < 0 else [number])
    return nodes, sets


def _parse_table(data: bytes) -> Content:
    """Parse a text table of node numbers and coordinates.

    Lines with other content may occur only before the first node.
    """
    nodes: Nodes = {}
    for line in _decode_lines(data):
        cells = line.split(",")
        if len(cells) >= 4 and cells[0].strip().isdigit():
            nodes[int(cells[0])] = _parse_point(cells[1:4])
        elif nodes and line.strip():
            raise ValueError(f"line {line[:40]!r} does not contain a node and its coordinates")
    return nodes, {}


_READERS = {".inp": _parse_abaqus_nodes, ".cdb": _parse_blocks, ".csv": _parse_table}
_READERS |= dict.fromkeys((".bdf", ".dat", ".nas", ".pch", ".blk"), _parse_bulk_data)
