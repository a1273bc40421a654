"""Readers of mesh and CAD files that use gmsh and return arrays.

:mod:`kc2spice.fem.mesh_file` calls these readers in a separate process.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from operator import itemgetter
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from kc2spice.core.errors import UsageError, wrong
from kc2spice.core.gmsh_session import gmsh_session
from kc2spice.fem.mesh_cells import CellBlock
from kc2spice.fem.mesh_formats import MESHIO_READERS, merge_file

ENTITY_NAMES = {0: "points", 1: "curves", 2: "faces", 3: "solids"}
# largest distance of an entity from the point that selects the entity, relative to the body's size
PICK_TOLERANCE = 1e-6
# Numbers of corners of the supported elements, keyed by the dimension of the elements.
CORNER_COUNTS = {0: (1,), 1: (2,), 2: (3, 4), 3: (4, 5, 6, 8)}
ELEMENT_NAMES = "triangles, quadrilaterals, tetrahedra, pyramids, prisms and hexahedra"
MAX_ELEMENTS = 50_000_000  # largest number of elements that a mesh size may produce

Picks = Mapping[str, Mapping[str, Any]]


def extract_mesh(
    file: str, name: str, size: float | None, dimension: int, picks: Picks, splits: int
) -> dict[str, np.ndarray]:
    """Extract nodes, elements and physical groups of a mesh or CAD file.

    ``name`` is the file name that error messages state. Every edge of the mesh is halved ``splits``
    times.

    For a CAD file, ``size`` is the largest edge length of the elements in the new mesh, in the unit
    of the file. ``picks`` defines groups of entities (points, curves, faces or solids) of a CAD
    file, keyed by name. Each pick contains the ``dimension`` of the selected entities, points
    ``at`` that lie on the entities, and two corners of a ``box`` around the entities.

    The returned dictionary contains these arrays:

    * ``points`` (n, 3): positions of the nodes,
    * ``cells<k>`` (elements, nodes): node numbers of the elements of block k, corners first; a
      block contains elements of one kind,
    * ``local<k>`` (nodes, d): positions of the nodes of block k on the reference element,
    * ``corners`` (blocks,): number of corners of each element of a block,
    * ``numbers`` (elements,): numbers that the file states for the elements,
    * ``group<k>``: for a group with the dimension of the body, the indices of its elements; for a
      group of lower dimension, the corner nodes (elements, corners) of its elements, where
      triangles repeat their last corner,
    * ``record``: JSON text with the name and dimension of each group.

    Raises
    ------
    UsageError : there are no solids to mesh, a group of ``picks`` selects no entity, or elements
        have an unsupported shape.
    """
    with gmsh_session() as gmsh:
        gmsh.option.setNumber("Geometry.OCCImportLabels", 1)
        gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
        _merge_file(gmsh, file, dimension)
        if size is not None:
            _mesh_cad(gmsh, size, dimension, picks)
        for _ in range(splits):
            gmsh.model.mesh.refine()
        arrays = _collect_arrays(gmsh, dimension, name)
    if Path(file).suffix in MESHIO_READERS:  # meshio ignores the element numbers
        arrays["numbers"] = np.full(len(arrays["numbers"]), -1)
    return arrays


def measure_bounding_box(file: str) -> dict[str, np.ndarray]:
    """Return two opposite corners of the bounding box of a file's mesh or geometry.

    The returned mapping contains the corners as the array ``box`` of shape (2, 3).

    The coordinates are in mm for a STEP file, and otherwise in the unit of the file.
    """
    with gmsh_session() as gmsh:
        gmsh.option.setString("Geometry.OCCTargetUnit", "MM")
        _merge_file(gmsh, file, 3)
        _, places, _ = gmsh.model.mesh.getNodes()
        points = places.reshape(-1, 3)
        if len(points):
            return {"box": np.array([points.min(axis=0), points.max(axis=0)])}
        return {"box": np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))}


def _merge_file(gmsh: ModuleType, file: str, dimension: int) -> None:
    """Add the mesh or geometry of a file to the current gmsh model."""
    if Path(file).suffix in MESHIO_READERS:
        merge_file(gmsh, file, dimension)
    else:
        gmsh.merge(file)


def _collect_arrays(gmsh: ModuleType, dimension: int, where: str) -> dict[str, np.ndarray]:
    """Return the mesh in the current gmsh model as named arrays."""
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    order = np.argsort(tags)
    ranked = tags[order]

    def list_blocks(d: int, entities: Iterable[int]) -> list[tuple[np.ndarray, CellBlock]]:
        """Return a cell block and its element numbers for each entity and element type.

        The entities have the dimension ``d``.
        """
        result = []
        for entity in entities:
            blocks = zip(*gmsh.model.mesh.getElements(d, entity), strict=True)
            for kind, numbers, nodes in blocks:
                properties = gmsh.model.mesh.getElementProperties(kind)
                shape, _, degree, count, places, corners = properties
                if corners not in CORNER_COUNTS[d] or degree > 2:
                    expected = "elements of order 1 or 2: " + ELEMENT_NAMES
                    raise wrong(
                        "mesh",
                        "the mesh has an element type that is not supported",
                        got=shape,
                        expected=expected,
                        hint="mesh with Mesh.ElementOrder = 2 in gmsh",
                    )
                at = np.minimum(np.searchsorted(ranked, nodes), len(ranked) - 1)
                if len(ranked) == 0 or (ranked[at] != nodes).any():
                    raise UsageError(
                        "an element has a node that does not exist",
                        where=where,
                        hint="export the mesh again, with all nodes",
                    )
                local = np.reshape(places, (count, -1))[:, :d]
                result.append((numbers, CellBlock(order[at].reshape(-1, count), corners, local)))
        return result

    body = list_blocks(dimension, map(itemgetter(1), gmsh.model.getEntities(dimension)))
    arrays = {"corners": np.array([block.corners for _, block in body], dtype=int)}
    for k, (_, block) in enumerate(body):
        arrays |= {f"cells{k}": block.nodes, f"local{k}": block.local}
    numbers = np.concatenate([np.empty(0, int), *map(itemgetter(0), body)])
    groups: list[tuple[str, int]] = []
    for d, physical in gmsh.model.getPhysicalGroups():
        members = list_blocks(d, gmsh.model.getEntitiesForPhysicalGroup(d, physical))
        if d == dimension:
            selected = np.concatenate([np.empty(0, int), *map(itemgetter(0), members)])
            result = np.flatnonzero(np.isin(numbers, selected))
        else:
            result = _collect_corner_nodes(map(itemgetter(1), members), max(CORNER_COUNTS[d]))
        arrays[f"group{len(groups)}"] = result
        groups.append((gmsh.model.getPhysicalName(d, physical) or str(physical), int(d)))
    arrays |= {"points": coordinates.reshape(-1, 3), "record": np.array(json.dumps(groups))}
    arrays["numbers"] = numbers
    return arrays


def _collect_corner_nodes(blocks: Iterable[CellBlock], width: int) -> np.ndarray:
    """Return the numbers of the corner nodes of all elements in several blocks.

    The returned array has a row for each element, and ``width`` columns. The row of an element with
    fewer than ``width`` corners repeats the last corner.
    """
    rows = [np.empty((0, width), int)]
    for block in blocks:
        columns = np.minimum(np.arange(width), block.corners - 1)
        rows.append(block.nodes[:, columns])
    return np.concatenate(rows)


def _mesh_cad(gmsh: ModuleType, size: float, dimension: int, picks: Picks) -> None:
    """Join the solids of a CAD file, add groups, and mesh with quadratic elements.

    The groups consist of the labelled entities of the file and the entities that ``picks`` selects.
    """
    bodies = gmsh.model.getEntities(dimension)
    if not bodies:
        raise UsageError(
            f"the CAD file contains no {ENTITY_NAMES[dimension]}",
            where="mesh",
            hint=f"export the {ENTITY_NAMES[dimension]} of the body into this file",
        )
    sides = np.reshape(gmsh.model.getBoundingBox(-1, -1), (2, 3))
    elements = float(np.prod(np.maximum(np.ptp(sides, axis=0) / size, 1.0)))
    if not elements <= MAX_ELEMENTS:
        raise wrong(
            "size",
            "this element size gives too many elements",
            got=f"about {elements:.1g} elements",
            expected=f"at most {MAX_ELEMENTS} elements",
            hint="write a larger size",
        )
    labels = {e: gmsh.model.getEntityName(*e).rsplit("/", 1)[-1] for e in gmsh.model.getEntities()}
    if len(bodies) > 1:
        _, pieces = gmsh.model.occ.fragment(bodies[:1], bodies[1:])
        gmsh.model.occ.synchronize()
        entities = set(gmsh.model.getEntities())
        pieces_of, texts = dict(zip(bodies, pieces, strict=True)), labels
        labels = {}
        for entity, text in texts.items():
            if entity[0] == dimension or entity in entities:
                labels |= dict.fromkeys(pieces_of.get(entity, [entity]), text)
    names: dict[tuple[str, int], list[int]] = {}
    for (d, tag), text in labels.items():
        if text:
            names.setdefault((text, d), []).append(tag)
    for name, pick in picks.items():
        names[name, pick["dimension"]] = _select_entities(gmsh, name, **pick)
    for (name, d), tags in names.items():
        gmsh.model.addPhysicalGroup(d, tags, name=name)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    gmsh.option.setNumber("Mesh.SaveAll", 1)
    gmsh.model.mesh.generate(dimension)
    gmsh.model.mesh.setOrder(2)
    if dimension == 3:
        gmsh.model.mesh.optimize("HighOrder")


def _select_entities(
    gmsh: ModuleType,
    name: str,
    dimension: int,
    at: Sequence[Sequence[float]],
    box: Sequence[Sequence[float]] | None,
) -> list[int]:
    """Select the entities that contain a given point or lie inside a given box.

    ``at`` contains the points. The entities have the given ``dimension`` and form the group
    ``name``.
    """
    everything = gmsh.model.getBoundingBox(-1, -1)
    near = PICK_TOLERANCE * float(np.linalg.norm(np.subtract(everything[3:], everything[:3])))
    result: list[int] = []
    for point in at:
        hits = [
            tag
            for d, tag in gmsh.model.getEntities(dimension)
            if _is_entity_near(gmsh, d, tag, np.asarray(point), near)
        ]
        if not hits:
            raise wrong(
                f"groups.{name}.at",
                f"no {ENTITY_NAMES[dimension][:-1]} contains this point",
                got=list(map(float, point)),
                expected="a point of the geometry, in the unit of the file",
                hint=f"write a point of the {ENTITY_NAMES[dimension]} in the unit of the file",
            )
        result += hits
    if box is not None:
        low, high = np.min(box, axis=0) - near, np.max(box, axis=0) + near
        inside = gmsh.model.getEntitiesInBoundingBox(*low, *high, dimension)
        result += map(itemgetter(1), inside)
    if not result:
        raise UsageError(
            f"this group selects none of the {ENTITY_NAMES[dimension]} of the geometry",
            where=f"groups.{name}",
            expected=(
                f"a point on one of the {ENTITY_NAMES[dimension]}, or a box that contains one of "
                f"the {ENTITY_NAMES[dimension]}"
            ),
            hint=f"enlarge the box of groups.{name}, with coordinates in the unit of the file",
        )
    return sorted(set(map(int, result)))


def _is_entity_near(gmsh: ModuleType, d: int, tag: int, point: np.ndarray, near: float) -> bool:
    """Return whether the distance between an entity and a point is below a tolerance.

    The distance is measured to the entity within its boundary, not to the unbounded surface or
    curve that contains the entity.
    """
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
