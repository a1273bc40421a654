"""What gmsh finds in a mesh or makes of a CAD file, as plain arrays.

Runs in a process of its own (:mod:`kc2spice.core.child`), on a copy whose name and format
:mod:`kc2spice.fem.mesh_file` has chosen and checked: gmsh decides by extension and content what it
reads, runs any file that it does not know as a script, and has no option that keeps scripts from
starting programs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any

import numpy as np

from kc2spice.core.errors import UsageError
from kc2spice.core.gmsh_session import gmsh_session

DIMENSION = {0: "points", 1: "curves", 2: "faces", 3: "solids"}
TOUCHING = 1e-6  # of the body's size: how near a face passes by a point that picks it
MOST = 50_000_000  # elements that a size may ask for

Picks = Mapping[str, Mapping[str, Any]]


def tables(
    file: str, name: str, size: float | None, dimension: int, picks: Picks, splits: int
) -> dict[str, np.ndarray]:
    """Nodes, elements and physical groups of ``file``, which the user calls ``name``.

    ``size`` (in the file's unit) makes it a CAD file to be meshed; ``picks`` are groups of it by
    name: ``dimension``, points ``at``, corners of a ``box``.

    Returns ``points`` (n, 3); ``cells<k>`` (elements, nodes each), blocks of tetrahedra or
    triangles, corners first; ``group<k>``, numbers of such elements or nodes (elements, corners);
    and ``record``, JSON: name and dimension of each group.

    Raises
    ------
    UsageError : nothing to mesh, a pick that selects nothing, elements of another shape.
    """
    with gmsh_session("mesh") as gmsh:
        gmsh.option.setNumber("Geometry.OCCImportLabels", 1)
        gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
        gmsh.merge(file)
        if size is not None:
            _make(gmsh, size, dimension, picks)
        for _ in range(splits):
            gmsh.model.mesh.refine()
        return _collected(gmsh, dimension, name)


def box(file: str) -> dict[str, np.ndarray]:
    """``box`` (2, 3), lowest and highest coordinates of ``file`` in its own unit."""
    with gmsh_session("mesh") as gmsh:
        gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
        gmsh.merge(file)
        _, places, _ = gmsh.model.mesh.getNodes()
        points = places.reshape(-1, 3)
        if len(points):
            return {"box": np.array([points.min(axis=0), points.max(axis=0)])}
        return {"box": np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))}


def _collected(gmsh: ModuleType, dimension: int, where: str) -> dict[str, np.ndarray]:
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    order = np.argsort(tags)
    ranked = tags[order]

    def simplices(d: int, entities: Sequence[int]) -> list[tuple[np.ndarray, np.ndarray]]:
        """Numbers and nodes of all elements in them, which are simplices."""
        found = []
        for entity in entities:
            blocks = zip(*gmsh.model.mesh.getElements(d, entity), strict=True)
            for kind, numbers, nodes in blocks:
                shape, _, _, count, _, corners = gmsh.model.mesh.getElementProperties(kind)
                if corners != d + 1 or count not in (d + 1, (d + 1) * (d + 2) // 2):
                    raise UsageError(
                        "element that is not supported",
                        where="mesh",
                        got=shape,
                        expected="triangles, tetrahedra of order 1 or 2",
                    )
                at = np.minimum(np.searchsorted(ranked, nodes), len(ranked) - 1)
                if len(ranked) == 0 or (ranked[at] != nodes).any():
                    raise UsageError("an element has a node that is not there", where=where)
                found.append((numbers, order[at].reshape(-1, count)))
        return found

    body = simplices(dimension, [tag for _, tag in gmsh.model.getEntities(dimension)])
    arrays = {f"cells{k}": nodes for k, (_, nodes) in enumerate(body)}
    numbers = np.concatenate([np.empty(0, int), *(each for each, _ in body)])
    groups: list[tuple[str, int]] = []
    for d, physical in gmsh.model.getPhysicalGroups():
        members = simplices(d, gmsh.model.getEntitiesForPhysicalGroup(d, physical))
        if d == dimension:
            chosen = [each for each, _ in members]
            found = np.flatnonzero(np.isin(numbers, np.concatenate([np.empty(0, int), *chosen])))
        else:
            corners = [nodes[:, : d + 1] for _, nodes in members]
            found = np.concatenate([np.empty((0, d + 1), int), *corners])
        arrays[f"group{len(groups)}"] = found
        groups.append((gmsh.model.getPhysicalName(d, physical) or str(physical), int(d)))
    arrays |= {"points": coordinates.reshape(-1, 3), "record": np.array(json.dumps(groups))}
    return arrays


def _make(gmsh: ModuleType, size: float, dimension: int, picks: Picks) -> None:
    """Join the solids, name the groups, mesh with quadratic elements."""
    bodies = gmsh.model.getEntities(dimension)
    if not bodies:
        raise UsageError(f"has no {DIMENSION[dimension]}", where="mesh")
    sides = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
    wanted = float(np.prod(np.maximum(np.ptp(sides, axis=0) / size, 1.0)))
    if not wanted <= MOST:
        raise UsageError(
            "elements of this size are too many",
            where="size",
            got=f"about {wanted:.1g} of them",
            expected=f"at most {MOST}",
        )
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
        names[name, pick["dimension"]] = _pick(gmsh, name, **pick)
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


def _pick(
    gmsh: ModuleType,
    name: str,
    dimension: int,
    at: Sequence[Sequence[float]],
    box: Sequence[Sequence[float]] | None,
) -> list[int]:
    everything = gmsh.model.getBoundingBox(-1, -1)
    near = TOUCHING * float(np.linalg.norm(np.subtract(everything[3:], everything[:3])))
    found: list[int] = []
    for point in at:
        hits = [
            tag
            for d, tag in gmsh.model.getEntities(dimension)
            if _contains(gmsh, d, tag, np.asarray(point), near)
        ]
        if not hits:
            raise UsageError(
                f"no {DIMENSION[dimension][:-1]} contains this point",
                where=f"groups.{name}.at",
                got=[float(x) for x in point],
                expected="a point of the geometry, in the file's unit here",
            )
        found += hits
    if box is not None:
        low, high = np.min(box, axis=0) - near, np.max(box, axis=0) + near
        inside = gmsh.model.getEntitiesInBoundingBox(*low, *high, dimension)
        found += [tag for _, tag in inside]
    if not found:
        raise UsageError("group selects nothing", where=f"groups.{name}")
    return sorted({int(tag) for tag in found})


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
