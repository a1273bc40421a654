"""Meshes and CAD files of the user's own, read by gmsh, with named groups.

``.msh`` files bring elements and physical groups. ``.step`` and ``.brep`` files are meshed here;
their solids are first made to share faces. Their groups are the labels of the file and what a
:class:`Pick` selects.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import numpy as np
from skfem.mesh import Mesh, MeshTet, MeshTet2, MeshTri, MeshTri2

from kc2spice.core.errors import UsageError
from kc2spice.core.gmsh_session import gmsh_session

SUFFIXES = {".msh": b"$MeshFormat", ".step": b"ISO-10303", ".stp": b"ISO-10303",
            ".brep": b"DBRep_DrawableShape"}  # fmt: skip
STEP = (".step", ".stp")
MILLIMETRE = 1e-3  # what STEP files are converted to, whatever they are written in
_TET_EDGES = ((0, 1), (1, 2), (2, 0), (3, 0), (3, 2), (3, 1))  # order of gmsh's mid-edge nodes
_TRI_EDGES = ((0, 1), (1, 2), (2, 0))
_DIMENSION = {0: "points", 1: "curves", 2: "faces", 3: "solids"}
TOUCHING = 1e-6  # of the body's size: how near a face passes by a point that picks it


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
    _require_kind(path)
    if path.suffix.lower() in STEP and unit != MILLIMETRE:
        raise UsageError("a STEP file states its own unit", where="unit", got=f"{unit:g} m",
                         expected="no unit, or mm")  # fmt: skip
    cad = path.suffix.lower() != ".msh"
    if cad == (size is None):
        raise UsageError(
            "a CAD file needs the size of its elements" if cad else "a mesh has its size already",
            where="size", expected='a length such as "1 mm"' if cad else "no size with .msh",
        )  # fmt: skip
    if picks and not cad:
        raise UsageError("groups are picked in CAD files only", where="groups",
                         hint="name physical groups in the mesh")  # fmt: skip
    with gmsh_session(path.stem) as gmsh:
        try:
            gmsh.option.setNumber("Geometry.OCCImportLabels", 1)
            gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
            gmsh.merge(str(path))
            if cad:
                assert size is not None
                _make(gmsh, size / unit, dimension, _scaled(picks or {}, unit))
            for _ in range(splits):
                gmsh.model.mesh.refine()
        except Exception as error:
            if isinstance(error, UsageError):
                raise
            raise UsageError(
                "gmsh cannot read or mesh this", where=str(path), got=str(error)
            ) from None
        return _collect(gmsh, unit, dimension, str(path))


def _require_kind(path: Path) -> None:
    """gmsh runs scripts by their content, so only what the name says is let through."""
    magic = SUFFIXES.get(path.suffix.lower())
    if magic is None:
        raise UsageError("not a kind of mesh", where=str(path), got=path.suffix,
                         expected=", ".join(SUFFIXES))  # fmt: skip
    try:
        with path.open("rb") as file:
            head = file.read(200)
    except OSError as error:
        raise UsageError("cannot be read", where=str(path), got=error.strerror) from None
    if magic not in head:
        raise UsageError("is not what its name says", where=str(path),
                         expected=f"{magic.decode()} at its beginning")  # fmt: skip


def _scaled(picks: Mapping[str, Pick], unit: float) -> dict[str, Pick]:
    return {
        name: Pick(p.dimension, np.reshape(p.at, (-1, 3)) / unit,
                   None if p.box is None else np.asarray(p.box) / unit)
        for name, p in picks.items()
    }  # fmt: skip


def _make(gmsh: ModuleType, size: float, dimension: int, picks: Mapping[str, Pick]) -> None:
    """Join the solids, name the groups, mesh with quadratic elements."""
    bodies = gmsh.model.getEntities(dimension)
    if not bodies:
        raise UsageError(f"has no {_DIMENSION[dimension]}", where="mesh")
    labels = {entity: _label(gmsh, entity) for entity in gmsh.model.getEntities()}
    if len(bodies) > 1:
        _, pieces = gmsh.model.occ.fragment(bodies[:1], bodies[1:])
        gmsh.model.occ.synchronize()
        found = set(gmsh.model.getEntities())
        kept = {e: text for e, text in labels.items() if e[0] == dimension or e in found}
        origin = dict(zip(bodies, pieces, strict=True))
        labels = {new: text for e, text in kept.items() for new in origin.get(e, [e])}
    names: dict[tuple[str, int], list[int]] = {}
    for (d, tag), text in labels.items():
        if text:
            names.setdefault((text, d), []).append(tag)
    for name, pick in picks.items():
        names[name, pick.dimension] = _pick(gmsh, name, pick)
    for (name, d), tags in names.items():
        gmsh.model.addPhysicalGroup(d, tags, name=name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.SaveAll", 1)
    gmsh.model.mesh.generate(dimension)
    gmsh.model.mesh.setOrder(2)
    if dimension == 3:
        gmsh.model.mesh.optimize("HighOrder")


def _label(gmsh: ModuleType, entity: tuple[int, int]) -> str:
    return str(gmsh.model.getEntityName(*entity)).rsplit("/", 1)[-1]


def _pick(gmsh: ModuleType, name: str, pick: Pick) -> list[int]:
    everything = gmsh.model.getBoundingBox(-1, -1)
    near = TOUCHING * float(np.linalg.norm(np.subtract(everything[3:], everything[:3])))
    found: list[int] = []
    for point in pick.at:
        hits = [tag for d, tag in gmsh.model.getEntities(pick.dimension)
                if _contains(gmsh, d, tag, np.asarray(point), near)]  # fmt: skip
        if not hits:
            raise UsageError(
                f"no {_DIMENSION[pick.dimension][:-1]} contains this point",
                where=f"groups.{name}.at", got=[float(x) for x in point],
                expected="a point of the geometry, in the file's unit here",
            )  # fmt: skip
        found += hits
    if pick.box is not None:
        low, high = np.min(pick.box, axis=0) - near, np.max(pick.box, axis=0) + near
        inside = gmsh.model.getEntitiesInBoundingBox(*low, *high, pick.dimension)
        found += [tag for _, tag in inside]
    if not found:
        raise UsageError("group selects nothing", where=f"groups.{name}")
    return sorted(set(found))


def _contains(gmsh: ModuleType, d: int, tag: int, point: np.ndarray, near: float) -> bool:
    """Whether the entity passes within ``near`` of the point, itself and not its continuation."""
    box = np.array(gmsh.model.getBoundingBox(d, tag))
    if np.any(point < box[:3] - near) or np.any(point > box[3:] + near):
        return False
    if d == 0:
        return True
    if d == 3:
        return bool(gmsh.model.isInside(d, tag, point))
    closest, parameter = gmsh.model.getClosestPoint(d, tag, point)
    return bool(
        np.linalg.norm(closest - point) <= near
        and gmsh.model.isInside(d, tag, parameter, parametric=True)
    )


def _collect(gmsh: ModuleType, unit: float, dimension: int, where: str) -> GroupedMesh:
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    place = np.zeros(int(tags.max(initial=0)) + 1, int)
    place[tags.astype(int)] = np.arange(len(tags))
    points = unit * coordinates.reshape(-1, 3)
    if dimension == 2:
        points = _meridian(points, where)
    found = _elements(gmsh, dimension, -1)
    if not found:
        raise UsageError(f"has no {'tetrahedra' if dimension == 3 else 'triangles'}", where=where)
    cells = np.concatenate([place[nodes[:, : dimension + 1]] for _, nodes in found])
    mesh = _quadratic(points, cells, [place[nodes] for _, nodes in found])
    table = _Table(mesh, np.unique(cells), len(points))
    number = {tag: k for k, tag in enumerate(np.concatenate([tags for tags, _ in found]))}
    groups = {}
    for d, physical in gmsh.model.getPhysicalGroups():
        name = gmsh.model.getPhysicalName(d, physical) or str(physical)
        if name in groups:
            raise UsageError("two groups of one name", where=where, got=name)
        parts = [part for entity in gmsh.model.getEntitiesForPhysicalGroup(d, physical)
                 for part in _elements(gmsh, d, entity)]  # fmt: skip
        corners = [place[nodes[:, : d + 1]] for _, nodes in parts]
        joined = np.concatenate(corners) if corners else np.empty((0, d + 1), int)
        if d == dimension:
            members = np.array([number[tag] for tags, _ in parts for tag in tags], int)
            groups[name] = Group(0, np.unique(members))
        elif d == dimension - 1:
            groups[name] = Group(1, np.unique(table.facets(joined, name)))
        else:
            groups[name] = Group(dimension - d, *table.shares(joined, points, name))
    return GroupedMesh(mesh, groups)


def _elements(gmsh: ModuleType, d: int, entity: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Tags and nodes (elements, nodes each) of the simplices of a dimension, corners first.

    Raises
    ------
    UsageError : elements of another shape.
    """
    result = []
    for kind, tags, nodes in zip(*gmsh.model.mesh.getElements(d, entity), strict=True):
        name, _, _, count, _, corners = gmsh.model.mesh.getElementProperties(kind)
        if corners != d + 1 or count not in (corners, corners * (d + 2) // 2):
            raise UsageError("element that is not supported", where="mesh", got=name,
                             expected="triangles, tetrahedra of order 1 or 2")  # fmt: skip
        result.append((tags, nodes.reshape(-1, count).astype(int)))
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
