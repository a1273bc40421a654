"""Meshes and CAD files of the user's own, read by gmsh, with named groups.

``.msh`` files bring elements and physical groups. ``.step`` and ``.brep`` files are meshed here;
their solids are first made to share faces. Their groups are the labels of the file and what a
:class:`Pick` selects.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from skfem.mesh import Mesh, MeshTet, MeshTet2, MeshTri, MeshTri2

from kc2spice.core.child import in_child
from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import read_bounded
from kc2spice.core.units import quantity

STEP = (".step", ".stp")
# How each file must begin, and the name under which gmsh gets it.
FORMATS = {
    ".msh": (b"$MeshFormat", "mesh.msh"), ".brep": (b"DBRep_DrawableShape", "mesh.brep"),
    ".step": (b"ISO-10303-21;", "mesh.step"), ".stp": (b"ISO-10303-21;", "mesh.step"),
}  # fmt: skip
VERSIONS = ("2", "2.0", "2.1", "2.2", "4", "4.0", "4.1")  # of .msh files
MAX_BYTES = 2_000_000_000  # of a file
_HEAD = 200  # bytes that tell its format
LENGTHS = ("m", "cm", "mm", "um")  # that a file without unit may be in
MILLIMETRE = 1e-3  # what STEP files are converted to, whatever they are written in
_TET_EDGES = ((0, 1), (1, 2), (2, 0), (3, 0), (3, 2), (3, 1))  # order of gmsh's mid-edge nodes
_TRI_EDGES = ((0, 1), (1, 2), (2, 0))
_STEP_TEXT = re.compile(rb"'(?:[^']|'')*'|/\*.*?\*/", re.DOTALL)


@dataclass(frozen=True)
class Pick:
    """Entities of a CAD file: those that contain one of the points ``at`` (n, 3), or that lie in
    ``box`` (two corners). ``dimension`` 0 to 3 counts points, curves, faces, solids. Metres.
    """

    dimension: int
    at: np.ndarray | Sequence[Sequence[float]] = ()
    box: np.ndarray | Sequence[Sequence[float]] | None = None


@dataclass(frozen=True)
class Group:
    """One named set: elements (``codimension`` 0), facets (1) or nodes (2, 3) of the mesh.

    ``shares`` of nodes are their parts of the length of a curve, equal for points.
    """

    codimension: int
    members: np.ndarray
    shares: np.ndarray | None = None


@dataclass(frozen=True)
class GroupedMesh:
    """A quadratic mesh [m] of tetrahedra or triangles, and its groups by name."""

    mesh: Mesh
    groups: Mapping[str, Group]


def read_mesh(
    path: Path,
    *,
    unit: float,
    size: float | None = None,
    picks: Mapping[str, Pick] | None = None,
    dimension: int = 3,
    splits: int = 0,
) -> GroupedMesh:
    """Read or make the mesh; ``unit`` is the file's unit of length [m], ``size`` the largest edge
    of the elements of a CAD file [m], ``splits`` how often every edge is halved.

    Raises
    ------
    UsageError : no such file, not of the kind that its name says, without solids, a CAD file
        without size, or a pick that selects nothing.
    """
    data = _content(path)
    if path.suffix.lower() in STEP and unit != MILLIMETRE:
        raise UsageError(
            "a STEP file states its own unit",
            where="unit",
            got=f"{unit:g} m",
            expected="no unit, or mm",
        )
    cad = path.suffix.lower() != ".msh"
    if cad == (size is None):
        raise UsageError(
            "a CAD file needs the size of its elements" if cad else "a mesh has its size already",
            where="size",
            expected='a length such as "1 mm"' if cad else "no size with .msh",
        )
    if picks and not cad:
        raise UsageError(
            "groups are picked in CAD files only",
            where="groups",
            hint="name physical groups in the mesh",
        )
    request = {
        "size": None if size is None else size / unit,
        "dimension": dimension,
        "picks": _scaled(picks or {}, unit),
        "splits": splits,
    }
    found = _ask_gmsh("tables", path, data, **request)
    return _collect(found, unit, dimension, str(path))


def length_unit(path: Path, unit: str | None) -> float:
    """The unit of length [m] of a file's numbers, which ``unit`` names where the format does not.

    Raises
    ------
    UsageError : neither of them says it; the message has the size in units that it may be.
    """
    if path.suffix.lower() in STEP or unit is not None:
        return quantity(f"1 {unit or 'mm'}", "m", where="unit")
    sides = extent(path)
    sizes = (f'"{name}" if it is {_sides(quantity(f"1 {name}", "m") * sides)}' for name in LENGTHS)
    raise UsageError(
        f"a {path.suffix} file does not state its unit of length",
        where="unit",
        got=f"{' x '.join(f'{side:.4g}' for side in sides)} in that unit",
        expected=", ".join(sizes),
        hint='state it beside mesh, such as unit = "mm"',
    )


def extent(path: Path) -> np.ndarray:
    """Sides (3,) of the bounding box of a file, in its own unit (mm of STEP files).

    Raises
    ------
    UsageError : as :func:`read_mesh`.
    """
    low, high = _ask_gmsh("box", path, _content(path))["box"]
    return np.asarray(high - low)


def _sides(sides: np.ndarray) -> str:
    return " x ".join(f"{1e3 * side:.4g}" for side in sides) + " mm"


def _ask_gmsh(function: str, path: Path, data: bytes, **request: Any) -> dict[str, np.ndarray]:
    file = FORMATS[path.suffix.lower()][1]
    request["file"] = file
    try:
        return in_child(
            f"kc2spice.fem.gmsh_reader:{function}", request, lambda home: _write(home / file, data)
        )
    except ValueError as error:
        raise UsageError("gmsh cannot read or mesh this", where=str(path), got=str(error)) from None


def require_format(path: Path, head: bytes | None = None) -> None:
    """Refuse a file that is not what its name says: gmsh runs what it does not know as a script.

    ``head`` is how the file begins, looked up if absent; a file that is not there passes.

    Raises
    ------
    UsageError : a suffix that is not read, or a file that begins otherwise.
    """
    known = FORMATS.get(path.suffix.lower())
    if known is None:
        raise UsageError(
            "not a kind of mesh",
            where=str(path),
            got=path.suffix or "no suffix",
            expected=", ".join(FORMATS),
        )
    if head is None:
        if not path.is_file():
            return
        with path.open("rb") as file:
            head = file.read(_HEAD)
    magic, wrong = known[0], "is not what its name says"
    if not head.startswith(magic):
        raise UsageError(
            wrong,
            where=str(path),
            got=repr(head[:20])[1:],
            expected=f"{magic.decode()} as its very first characters",
        )
    if magic == b"$MeshFormat" and not _is_mesh(head):
        raise UsageError(
            wrong,
            where=str(path),
            got=repr(head[:40])[1:],
            expected="a header of version 2 or 4, as text or binary",
            hint='gmsh.option.setNumber("Mesh.MshFileVersion", 4.1) before gmsh.write',
        )


def _content(path: Path) -> bytes:
    """What a file holds, which is what its name says."""
    require_format(path)
    try:
        data = read_bounded(path, MAX_BYTES)
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UsageError("cannot be read", where=str(path), got=reason) from None
    require_format(path, data[:_HEAD])
    if path.suffix.lower() in STEP and b"DOCUMENT_FILE" in _STEP_TEXT.sub(b"", data):
        raise UsageError(
            "refers to other files",
            where=str(path),
            got="DOCUMENT_FILE",
            expected="one file with all solids",
            hint="export it without external references",
        )
    return data


def _is_mesh(head: bytes) -> bool:
    """Whether the lines of ``$MeshFormat`` are those of a version that is read."""
    first, second, rest = [*head.split(b"\n", 2), b"", b""][:3]
    words = second.decode("ascii", "replace").split()
    if first.strip() != b"$MeshFormat" or len(words) != 3:
        return False
    version, binary, width = words
    if version not in VERSIONS or width != "8" or binary not in ("0", "1"):
        return False
    one = rest[:4] in (b"\1\0\0\0", b"\0\0\0\1")
    return one if binary == "1" else rest.lstrip().startswith(b"$EndMeshFormat")


def _write(path: Path, data: bytes) -> None:
    path.write_bytes(data)


def _scaled(picks: Mapping[str, Pick], unit: float) -> dict[str, Any]:
    return {
        name: {
            "dimension": p.dimension,
            "at": (np.reshape(p.at, (-1, 3)) / unit).tolist(),
            "box": None if p.box is None else (np.asarray(p.box) / unit).tolist(),
        }
        for name, p in picks.items()
    }


@dataclass(frozen=True)
class _Block:
    """Elements of one kind in one entity: tags (k,), nodes (k, nodes each), corners first."""

    dimension: int
    entity: int
    name: str
    corners: int
    tags: np.ndarray
    nodes: np.ndarray


def _collect(
    found: Mapping[str, np.ndarray], unit: float, dimension: int, where: str
) -> GroupedMesh:
    record = json.loads(str(found["record"]))
    blocks = [
        _Block(d, entity, name, corners, found[f"tags{k}"], found[f"nodes{k}"])
        for k, (d, entity, name, corners) in enumerate(record["blocks"])
    ]
    place = _places(found["tags"], where)
    points = unit * found["points"]
    if not np.isfinite(points).all():
        raise UsageError("a node is not at a finite place", where=where)
    if dimension == 2:
        points = _meridian(points, where)
    body = _simplices(blocks, dimension)
    if not body:
        raise UsageError(f"has no {'tetrahedra' if dimension == 3 else 'triangles'}", where=where)
    cells = np.concatenate([place(nodes[:, : dimension + 1]) for _, nodes in body])
    mesh = _quadratic(points, cells, [place(nodes) for _, nodes in body])
    table = _Table(mesh, np.unique(cells), len(points))
    number = {tag: k for k, tag in enumerate(np.concatenate([tags for tags, _ in body]))}
    groups = {}
    for name, d, entities in record["groups"]:
        if name in groups:
            raise UsageError("two groups of one name", where=where, got=name)
        parts = [part for entity in entities for part in _simplices(blocks, d, entity)]
        corners = [place(nodes[:, : d + 1]) for _, nodes in parts]
        joined = np.concatenate(corners) if corners else np.empty((0, d + 1), int)
        if d == dimension:
            members = np.array([number[tag] for tags, _ in parts for tag in tags], int)
            groups[name] = Group(0, np.unique(members))
        elif d == dimension - 1:
            groups[name] = Group(1, np.unique(table.facets(joined, name)))
        else:
            groups[name] = Group(dimension - d, *table.shares(joined, points, name))
    return GroupedMesh(mesh, groups)


def _places(tags: np.ndarray, where: str) -> Callable[[np.ndarray], np.ndarray]:
    """Where in ``tags`` (n,) each of an array of nodes stands; tags may be far apart."""
    order = np.argsort(tags)
    ranked = tags[order]

    def place(nodes: np.ndarray) -> np.ndarray:
        at = np.minimum(np.searchsorted(ranked, nodes), len(ranked) - 1)
        if len(ranked) == 0 or (ranked[at] != nodes).any():
            raise UsageError("an element has a node that is not there", where=where)
        return np.asarray(order[at])

    return place


def _simplices(
    blocks: Sequence[_Block], d: int, entity: int | None = None
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Tags and nodes of the simplices of a dimension, or of one entity of it.

    Raises
    ------
    UsageError : elements of another shape.
    """
    result = []
    for block in blocks:
        if block.dimension != d or entity not in (None, block.entity):
            continue
        count = block.nodes.shape[1]
        if block.corners != d + 1 or count not in (d + 1, (d + 1) * (d + 2) // 2):
            raise UsageError(
                "element that is not supported",
                where="mesh",
                got=block.name,
                expected="triangles, tetrahedra of order 1 or 2",
            )
        result.append((block.tags, block.nodes))
    return result


def _meridian(points: np.ndarray, where: str) -> np.ndarray:
    """Radius and height of a plane mesh, whose plane is x-y (y the axis) or x-z (z the axis)."""
    flat = [axis for axis in (2, 1) if np.ptp(points[:, axis]) <= 1e-9 * np.ptp(points)]
    if not flat:
        raise UsageError("axisymmetric mesh is not plane", where=where, expected="z = 0 or y = 0")
    return points[:, [0, 3 - flat[0]]]


def _quadratic(points: np.ndarray, cells: np.ndarray, full: list[np.ndarray]) -> Mesh:
    """The mesh with the mid-edge nodes of the file; straight edges where it has none."""
    vertices, corners = np.unique(cells, return_inverse=True)
    corners = corners.reshape(cells.shape)
    tetrahedra = cells.shape[1] == 4
    kind, curved = (MeshTet, MeshTet2) if tetrahedra else (MeshTri, MeshTri2)
    mesh = curved.from_mesh(kind(points[vertices].T.copy(), corners.T.copy()))
    places, start = mesh.doflocs.copy(), 0
    ends = _TET_EDGES if tetrahedra else _TRI_EDGES
    for nodes in full:
        own = corners[start : start + len(nodes)]
        start += len(nodes)
        for edge, middle in zip(ends, nodes.T[cells.shape[1] :], strict=False):
            places[:, _edge_nodes(mesh, own[:, edge])] = points[middle].T
    return curved(places, mesh.t)


def _edge_nodes(mesh: Mesh, pairs: np.ndarray) -> np.ndarray:
    """Nodes in the middle of edges given by vertices (k, 2)."""
    edges = mesh.edges if mesh.dim() == 3 else mesh.facets
    return mesh.nvertices + _find(edges, pairs, mesh.nvertices)


def _find(simplices: np.ndarray, wanted: np.ndarray, vertices: int) -> np.ndarray:
    """Columns of ``simplices`` (corners, n) that have the corners ``wanted`` (k, corners); -1
    where there is none.
    """
    base = vertices ** np.arange(len(simplices))
    keys, asked = base @ np.sort(simplices, axis=0), np.sort(wanted, axis=1) @ base
    order = np.argsort(keys)
    place = order[np.minimum(np.searchsorted(keys[order], asked), len(keys) - 1)]
    return np.where(keys[place] == asked, place, -1)


class _Table:
    """Facets and nodes of the mesh by the node numbers of the file."""

    def __init__(self, mesh: Mesh, vertices: np.ndarray, points: int) -> None:
        self.mesh = mesh
        self.number = np.full(points, -1)
        self.number[vertices] = np.arange(len(vertices))

    def facets(self, corners: np.ndarray, name: str) -> np.ndarray:
        """Facets with these corners (k, d)."""
        return _inside(_find(self.mesh.facets, self.number[corners], self.mesh.nvertices), name)

    def shares(
        self, corners: np.ndarray, points: np.ndarray, name: str
    ) -> tuple[np.ndarray, np.ndarray]:
        """Nodes on points (k, 1) or line elements (k, 2), and their parts of the whole length."""
        ends = self.number[corners]
        _inside(ends, name)
        if corners.shape[1] == 1:
            nodes, weights = ends.ravel(), np.ones(len(ends))
        else:
            length = np.linalg.norm(points[corners[:, 0]] - points[corners[:, 1]], axis=1)
            middle = _edge_nodes(self.mesh, ends)
            _inside(middle - self.mesh.nvertices, name)
            nodes = np.concatenate([ends[:, 0], ends[:, 1], middle])
            weights = np.concatenate([length, length, 4 * length]) / 6  # Simpson's rule
        unique, place = np.unique(nodes, return_inverse=True)
        total = np.bincount(place, weights, len(unique))
        return unique, total / (total.sum() or 1.0)


def _inside(found: np.ndarray, name: str) -> np.ndarray:
    if (found < 0).any():
        raise UsageError("group does not lie on the body's elements", where=f"group {name}")
    return found
