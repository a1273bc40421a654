"""Node coordinates and node sets from the input file of the tool that wrote the matrices.

Abaqus and CalculiX ``.inp`` (``*NODE``, ``*NSET``, one instance), Nastran bulk data (``GRID`` in
the basic system), Ansys ``.cdb`` (``NBLOCK``, ``CMBLOCK``), or ``.csv`` with lines
``node, x, y, z``.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from kc2spice.bodies.readers.limits import content, guarded
from kc2spice.core.errors import UsageError

_EXPECTED = "an .inp, .cdb, .bdf, .dat, .nas, .pch or .csv file with the nodes"


@dataclass(frozen=True, eq=False)
class Mesh:
    """Numbers (n,) and coordinates (n, 3) of the nodes in the file's own unit, node sets by name
    (upper case).
    """

    where: str
    node: np.ndarray
    at: np.ndarray
    sets: dict[str, np.ndarray] = field(default_factory=dict)

    def nodeset(self, name: str, where: str) -> np.ndarray:
        """Node numbers of a set.

        Raises
        ------
        UsageError : no such set, or an empty one.
        """
        found = self.sets.get(name.upper())
        if found is None or not len(found):
            got = f"{name!r} in {self.where}"
            expected = ", ".join(sorted(self.sets)) or "node sets in the mesh file"
            raise UsageError("no such node set", where=where, got=got, expected=expected)
        return found

    def nearest(self, place: tuple[float, ...], within: float | None, where: str) -> int:
        """Number of the node at ``place``, at most ``within`` away (1e-6 of the size by default).

        Raises
        ------
        UsageError : none is that near.
        """
        distance = np.linalg.norm(self.at - np.asarray(place), axis=1)
        best = int(distance.argmin())
        extent = float(np.ptp(self.at, axis=0).max())
        if distance[best] > (1e-6 * extent if within is None else within):
            x, y, z = self.at[best]
            raise UsageError(
                "no node is there",
                where=where,
                got=list(place),
                expected=f"within {distance[best]:.4g} of node {self.node[best]} at "
                f"[{x:g}, {y:g}, {z:g}]: raise 'within' or correct 'at'",
            )
        return int(self.node[best])


def read_mesh(path: Path) -> Mesh:
    """Nodes and node sets of ``path``, by its suffix.

    Raises
    ------
    UsageError : damaged, several instances, moved coordinates, or no node in it.
    """
    suffix = path.suffix.lower()
    readers = {".inp": _keywords, ".cdb": _blocks, ".csv": _table}
    readers |= dict.fromkeys((".bdf", ".dat", ".nas", ".pch", ".blk"), _bulk)
    if suffix not in readers:
        raise UsageError("is no mesh", where=str(path), got=suffix, expected=_EXPECTED)

    def read() -> tuple[np.ndarray, np.ndarray, dict[str, np.ndarray]]:
        nodes, sets = readers[suffix](path)  # numbers may be too large for any array
        node = np.fromiter(nodes, dtype=np.int64, count=len(nodes))
        named = {name: np.unique(np.array(list(n), dtype=np.int64)) for name, n in sets.items()}
        return node, np.array(list(nodes.values()), dtype=float), named

    node, at, named = guarded(path, _EXPECTED, read)
    if not len(node):
        raise UsageError("holds no node", where=str(path), expected=_EXPECTED)
    if not np.isfinite(at).all():
        raise UsageError("a coordinate is not finite", where=str(path), expected=_EXPECTED)
    return Mesh(str(path), node, at, named)


Nodes = dict[int, tuple[float, float, float]]
Found = tuple[Nodes, dict[str, list[int]]]


def _lines(path: Path) -> list[str]:
    return content(path).decode("utf-8", "replace").splitlines()


def _point(words: Iterable[str]) -> tuple[float, float, float]:
    plain = (word.upper().replace("D", "E") for word in words)
    values = [float(word) if word.strip() else 0.0 for word in plain][:3]
    x, y, z = values + [0.0] * (3 - len(values))
    return x, y, z


def _keywords(path: Path) -> Found:
    """Abaqus and CalculiX."""
    nodes: Nodes = {}
    sets: dict[str, list[int]] = {}
    keyword, options, instances = "", {}, 0
    for line in _lines(path):
        if line.startswith("**") or not line.strip():
            continue
        if line.startswith("*"):
            head, *rest = (word.strip() for word in line[1:].upper().split(","))
            keyword = head
            options = {
                k.strip(): v.strip().strip('"') for k, _, v in (w.partition("=") for w in rest)
            }
            instances += keyword == "INSTANCE"
            if instances > 1:
                raise ValueError(
                    "more than one *INSTANCE: its node numbers are not those of the mtx"
                )
            continue
        cells = line.split(",")
        if keyword == "INSTANCE" and any(float(c) for c in cells if c.strip()):
            raise ValueError("an *INSTANCE that is moved")
        if keyword == "NODE":
            nodes[int(cells[0])] = _point(cells[1:4])
            if "NSET" in options:
                sets.setdefault(options["NSET"], []).append(int(cells[0]))
        elif keyword == "NSET":
            _members(cells, options, sets)
    return nodes, sets


def _members(cells: list[str], options: dict[str, str], sets: dict[str, list[int]]) -> None:
    members = sets.setdefault(options.get("NSET", ""), [])
    words = [cell.strip().upper() for cell in cells if cell.strip()]
    if "GENERATE" in options:
        first, last, *step = (int(word) for word in words)
        if last - first > 10_000_000:
            raise ValueError("a node set of more than 10 million nodes")
        members.extend(range(first, last + 1, step[0] if step else 1))
        return
    for word in words:
        if word.lstrip("-").isdigit():
            members.append(int(word))
        else:
            members.extend(sets.get(word, ()))


def _bulk(path: Path) -> Found:
    """Nastran: GRID in small, large and free fields."""
    nodes: Nodes = {}
    lines = _lines(path)
    for number, line in enumerate(lines):
        if line[:4].upper() != "GRID":
            continue
        if "," in line:
            cells = [*line.split("$")[0].split(",")[1:], "", "", "", "", ""]
        elif "*" in line[:8]:
            following = lines[number + 1] if number + 1 < len(lines) else ""
            cells = [line[8 + k * 16 : 24 + k * 16] for k in range(4)] + [following[8:24]]
        else:
            cells = [line[8 + k * 8 : 16 + k * 8] for k in range(5)]
        if cells[1].strip() not in ("", "0"):
            raise ValueError(f"grid {cells[0].strip()} is in coordinate system {cells[1].strip()}")
        nodes[int(cells[0])] = _point(cells[2:5])
    return nodes, {}


def _blocks(path: Path) -> Found:
    """Ansys: NBLOCK (``i,i,i,x,y,z`` in fixed fields) and CMBLOCK of nodes."""
    nodes: Nodes = {}
    sets: dict[str, list[int]] = {}
    lines = iter(_lines(path))
    for line in lines:
        head = line.upper()
        if head.startswith("NBLOCK"):
            heads, wide, field_width = _nblock(next(lines))
            for row in lines:
                if row[:1] in ("N", "n", "-") or row.strip() == "-1":
                    break
                start = heads * wide
                coordinates = [
                    row[start + k * field_width : start + (k + 1) * field_width] for k in range(3)
                ]
                nodes[int(row[:wide])] = _point(coordinates)
        elif head.startswith("CMBLOCK"):
            _, name, kind, count, *_ = (word.strip() for word in head.split(","))
            next(lines)
            members: list[int] = []
            while len(members) < int(count.split("!")[0]):
                members += [int(word) for word in next(lines).split()]
            if kind == "NODE":
                sets[name] = _ranges(members)
    return nodes, sets


def _nblock(form: str) -> tuple[int, int, int]:
    """``(3i9,6e21.13e3)``: integers, their width, the width of a coordinate."""
    integers, floats = form.strip().strip("()").lower().split(",")[:2]
    count, width = integers.split("i")
    return int(count), int(width), int(floats.split("e")[1].split(".")[0])


def _ranges(members: list[int]) -> list[int]:
    """A negative number ends a range that the one before began."""
    found: list[int] = []
    for value in members:
        if value < 0 and found and -value - found[-1] < 10_000_000:
            found.extend(range(found[-1] + 1, -value + 1))
        else:
            found.append(value)
    return found


def _table(path: Path) -> Found:
    nodes: Nodes = {}
    for line in _lines(path):
        cells = line.split(",")
        if len(cells) >= 4 and cells[0].strip().isdigit():
            nodes[int(cells[0])] = _point(cells[1:4])
        elif nodes and line.strip():
            raise ValueError(f"line {line[:40]!r}")
    return nodes, {}
