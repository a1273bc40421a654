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
    file: str, size: float | None, dimension: int, picks: Picks, splits: int
) -> dict[str, np.ndarray]:
    """Nodes, elements and physical groups of ``file``.

    ``size`` (in the file's unit) makes it a CAD file to be meshed; ``picks`` are groups of it by
    name: ``dimension``, points ``at``, corners of a ``box``.

    Returns ``tags`` (n,) and ``points`` (n, 3) of nodes; ``tags<k>`` and ``nodes<k>`` (elements,
    nodes each) of blocks of elements; and ``record``, JSON: ``blocks`` (dimension, entity, name,
    corners of each) and ``groups`` (name, dimension, entities of each).

    Raises
    ------
    UsageError : nothing to mesh, a pick that selects nothing.
    """
    with gmsh_session("mesh") as gmsh:
        gmsh.option.setNumber("Geometry.OCCImportLabels", 1)
        gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
        gmsh.merge(file)
        if size is not None:
            _make(gmsh, size, dimension, picks)
        for _ in range(splits):
            gmsh.model.mesh.refine()
        return _collected(gmsh)


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


def _collected(gmsh: ModuleType) -> dict[str, np.ndarray]:
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    arrays = {"tags": tags.astype(np.int64), "points": coordinates.reshape(-1, 3)}
    blocks: list[tuple[int, int, str, int]] = []
    for d, entity in gmsh.model.getEntities():
        for kind, numbers, nodes in zip(*gmsh.model.mesh.getElements(d, entity), strict=True):
            name, _, _, count, _, corners = gmsh.model.mesh.getElementProperties(kind)
            arrays[f"tags{len(blocks)}"] = numbers.astype(np.int64)
            arrays[f"nodes{len(blocks)}"] = nodes.reshape(-1, count).astype(np.int64)
            blocks.append((int(d), int(entity), name, int(corners)))
    groups = []
    for d, physical in gmsh.model.getPhysicalGroups():
        name = gmsh.model.getPhysicalName(d, physical) or str(physical)
        members = gmsh.model.getEntitiesForPhysicalGroup(d, physical)
        groups.append((name, int(d), [int(tag) for tag in members]))
    return {**arrays, "record": np.array(json.dumps({"blocks": blocks, "groups": groups}))}


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
