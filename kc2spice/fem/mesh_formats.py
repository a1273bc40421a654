"""Conversion of mesh files that meshio reads to discrete entities of gmsh.

Element sets, node sets and integer cell data become physical groups. A node set that contains all
corners of some faces on the surface of the body becomes a group of these faces. Any other node set
becomes a group of points.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from importlib import import_module
from itertools import count, islice
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from scipy.optimize import linear_sum_assignment

from kc2spice.core.errors import UsageError, wrong
from kc2spice.core.optional_libraries import import_optional
from kc2spice.fem.mesh_cells import ELEMENT_FACES

# Reader module of meshio, and the additional library that this reader needs, keyed by file suffix.
MESHIO_READERS = {
    ".inp": ("abaqus", None), ".bdf": ("nastran", None), ".nas": ("nastran", None),
    ".vtu": ("vtu", None), ".med": ("med", "h5py"), ".exo": ("exodus", "netCDF4"),
    ".e": ("exodus", "netCDF4"),
}  # fmt: skip
_ELEMENT_ORDER_HINT = "mesh with linear or quadratic elements in the program that made the mesh"
# Name in gmsh, dimension, and number of corners of each element shape.
# The key is the beginning of the name of the element in meshio.
ELEMENT_SHAPES = {
    "vertex": ("Point", 0, 1), "line": ("Line", 1, 2), "triangle": ("Triangle", 2, 3),
    "quad": ("Quadrangle", 2, 4), "tetra": ("Tetrahedron", 3, 4),
    "pyramid": ("Pyramid", 3, 5), "wedge": ("Prism", 3, 6), "hexahedron": ("Hexahedron", 3, 8),
}  # fmt: skip
TETRAHEDRON_FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (2, 0, 3))
MAX_QUOTE_LENGTH = 60  # largest number of characters that an error message quotes of a line
MAX_GROUPS = 1000  # largest number of groups from one array of integer cell data
# Largest permitted distance between a node and its position in an element with straight edges,
# divided by the length of the longest edge.
# The middle node of a semicircular edge lies half a chord length away from the chord.
MAX_BULGE = 0.5
_INCLUDE_LINE = {
    "abaqus": re.compile(
        rb"^\s*\*\s*include\b|^\s*\*[^*\n]*\binput\s*=.*", re.IGNORECASE | re.MULTILINE
    ),
    "nastran": re.compile(rb"^\s*include\b", re.IGNORECASE | re.MULTILINE),
    "vtu": re.compile(rb"<!(DOCTYPE|ENTITY)"),
}
# Lines of Abaqus files that change the mesh but that meshio ignores.
# Each item contains a pattern, the permitted number of matching lines, and the hint for the error.
IGNORED_LINES = (
    (rb"^[ \t]*\*[ \t]*(NGEN|NFILL|NCOPY|NMAP|ELGEN|ELCOPY|SYSTEM)\b.*", 0,
     "write all nodes and elements in global coordinates"),
    (rb"^[ \t]*\*[ \t]*NODE\b.*\bSYSTEM[ \t]*=[ \t]*[CS].*", 0,
     "write all nodes in cartesian coordinates"),
    (rb"^[ \t]*\*[ \t]*INSTANCE\b.*(?=\n[ \t]*[-+.\d])", 0,
     "export without parts and assemblies"),
    (rb"^[ \t]*\*[ \t]*PART\b.*", 1, "write one part, or export without parts and assemblies"),
)  # fmt: skip
_GRID_LINE = re.compile(rb"^(?:GRID|GRDSET)\b.*", re.MULTILINE)
# Beginning of a continuation line in a Nastran file, whose first field is empty.
_CONTINUATION_LINE = re.compile(rb"^(?:(?=,)| (?=       | *,))(?=.*\S)", re.MULTILINE)
# Patterns of Abaqus element names, keyed by dimension. The regex group matches the number of nodes.
ABAQUS_TYPES = {
    2: re.compile(r"(?:DC|AC|C|CG)(?:AX|PS|PE|2D)(\d+)[A-Z]*"),
    3: re.compile(r"(?:DC|AC|C|QC)3D(\d+)[A-Z]*"),
}
# Names of elements in meshio, keyed by dimension and by number of nodes.
MESHIO_NAMES = {
    2: {3: "triangle", 4: "quad", 6: "triangle6", 8: "quad8"},
    3: {4: "tetra", 5: "pyramid", 6: "wedge", 8: "hexahedron", 10: "tetra10", 15: "wedge15",
        20: "hexahedron20", 27: "hexahedron27"},
}  # fmt: skip
# Number of nodes of UNV elements, keyed by element type.
# UNV elements of the types in UNV_BEAMS have an additional line.
UNV_NODES = {
    11: 2, 21: 2, 22: 3, 24: 3, 41: 3, 42: 6, 44: 4, 45: 8, 81: 3, 82: 6, 84: 4, 85: 8, 91: 3,
    92: 6, 94: 4, 95: 8, 111: 4, 112: 6, 113: 15, 115: 8, 116: 20, 118: 10,
}  # fmt: skip
UNV_BEAMS = (11, 21, 22, 23, 24)
_UNV_ELEMENT_DATASET = re.compile(rb"^    -1[ \t\r]*\n *2412[ \t\r]*\n(.*?)^    -1", re.M | re.S)
_ELEMENT_TYPE = re.compile(rb"\bTYPE[ \t]*=[ \t]*(\w+)", re.IGNORECASE)
_ELEMENT_LINE = re.compile(rb"^[ \t]*\*ELEMENT[ \t]*,.*", re.IGNORECASE | re.MULTILINE)
_ELEMENT_SET_NAME = re.compile(rb"ELSET\s*=\s*([^,\s]+)", re.IGNORECASE)


def reject_unsupported_content(suffix: str, data: bytes, where: str) -> None:
    """Reject mesh files that include other files, or that meshio reads incorrectly.

    Raises
    ------
    UsageError : the file refers to another file, or contains lines that change the mesh but that
        meshio ignores; or in an Abaqus file, some elements are in no element set, or several blocks
        have the same element set.
    MissingToolError : the library that meshio needs for this format is not installed.
    """
    reader, library = MESHIO_READERS[suffix]
    if library:
        import_optional(library, where)
    pattern = _INCLUDE_LINE.get(reader)
    match = pattern.search(data) if pattern else None
    if match:
        raise wrong(
            where,
            "this file refers to other files",
            got=match[0].decode().strip(),
            expected="one file with nodes and elements",
            hint="insert the text of these files",
        )
    for line, hint in _list_ignored_lines(reader, data):
        got = line.decode(errors="replace").strip()[:MAX_QUOTE_LENGTH]
        raise wrong(
            where,
            "the file contains a command that moves or generates parts of the mesh",
            got=got,
            expected="nodes and elements of one body in cartesian coordinates",
            hint=hint,
        )
    if reader == "abaqus":
        names = list(map(_ELEMENT_SET_NAME.search, _ELEMENT_LINE.findall(data)))
        sets = [name[1].upper() for name in names if name]
        if sets and (len(sets) < len(names) or len(set(sets)) < len(sets)):
            raise wrong(
                where,
                "some *ELEMENT lines have no ELSET, or the same ELSET as another *ELEMENT line",
                expected="a different ELSET in every *ELEMENT line, or no *ELEMENT line with ELSET",
                hint="delete ELSET from all *ELEMENT lines, and define the sets by *ELSET lines",
            )


def _list_ignored_lines(reader: str, data: bytes) -> Iterator[tuple[bytes, str]]:
    """Yield each line that meshio ignores although the line changes the mesh.

    Each item also contains the hint for the error message.
    """
    if reader == "abaqus":
        for text, plain, hint in IGNORED_LINES:
            lines = re.finditer(text, data, re.IGNORECASE | re.MULTILINE)
            yield from ((line[0], hint) for line in islice(lines, plain, None))
    if reader == "nastran":
        for match in _GRID_LINE.finditer(data):
            line = match[0]
            large = line.startswith(b"GRID*")
            field = line[24:40] if large else line[16:24]
            field = line.split(b",")[2] if line.count(b",") > 1 else field
            if line.startswith(b"GRDSET") or field.strip(b" 0"):
                yield line, "write all nodes in the basic coordinate system"


def merge_file(gmsh: ModuleType, file: str, dimension: int) -> None:
    """Read a mesh file with meshio, and add the mesh to the current gmsh model.

    ``dimension`` is the dimension of the body, 2 or 3. For files that gmsh itself can read, use
    ``gmsh.merge`` instead.
    """
    reader = MESHIO_READERS[Path(file).suffix][0]
    _extend_meshio(reader, Path(file))
    mesh = import_module(f"meshio.{reader}").read(file)
    points = np.zeros((len(mesh.points), 3))
    points[:, : np.shape(mesh.points)[1]] = mesh.points
    blocks, faces = [], []
    for cells in mesh.cells:
        shape = ELEMENT_SHAPES.get(re.sub(r"\d+$", "", cells.type))
        if shape is None:
            raise wrong(
                "mesh",
                "the mesh has an element type that is not supported",
                got=cells.type,
                expected="elements of order 1 or 2",
                hint=_ELEMENT_ORDER_HINT,
            )
        nodes = np.asarray(cells.data)
        if nodes.size and not 0 <= nodes.min() <= nodes.max() < len(points):
            raise UsageError(
                "an element has a node that does not exist",
                where="mesh",
                hint="export the mesh again, with all nodes",
            )
        blocks.append((shape, nodes))
    for (_, d, corners), nodes in blocks:
        if d == dimension:
            faces += _list_faces(nodes[:, :corners], d)
    total = sum(len(nodes) for _, nodes in blocks)
    owner = np.repeat([d for (_, d, _), _ in blocks], [len(nodes) for _, nodes in blocks])
    sets = _collect_element_sets(mesh, file, reader, owner)
    gmsh.model.addDiscreteEntity(dimension, 1)
    gmsh.model.mesh.addNodes(
        dimension, 1, np.arange(1, len(points) + 1), points.astype(float).ravel()
    )
    tags = count(2)
    signature = np.zeros(total, int)
    for members in sets.values():
        inside = np.isin(np.arange(total), members)
        signature = np.unique(2 * signature + inside, return_inverse=True)[1]
    entity_of: dict[tuple[int, int], int] = {}
    start = 0
    for (family, d, corners), nodes in blocks:
        kind = _find_element_kind(gmsh, family, corners, nodes.shape[1])
        nodes = _order_nodes(gmsh, kind, family, corners, nodes, points)
        marks = signature[start : start + len(nodes)]
        for mark in np.unique(marks):
            key = (d, int(mark))
            if key not in entity_of:
                entity_of[key] = gmsh.model.addDiscreteEntity(d, next(tags))
            gmsh.model.mesh.addElementsByType(
                entity_of[key], kind, [], nodes[marks == mark].ravel() + 1
            )
        start += len(nodes)
    for (name, d), members in sets.items():
        marks = np.unique(signature[members])
        entities = [entity_of[d, int(mark)] for mark in marks]
        gmsh.model.addPhysicalGroup(d, entities, name=name)
    for name, nodes in _collect_node_sets(mesh).items():
        _add_node_set(gmsh, name, nodes, faces, dimension, next(tags))


def _extend_meshio(reader: str, file: Path) -> None:
    """Add features to meshio that the mesh file needs and meshio lacks.

    The added features are prisms with 15 nodes, some Abaqus elements, and continuation lines in
    Nastran files. If ``reader`` is "nastran", continuation lines are rewritten in the ``file``,
    which must be a copy of the user's file.
    """
    import_module("meshio._mesh").topological_dimension.setdefault("wedge15", 3)
    if reader == "abaqus":
        known = import_module("meshio.abaqus._abaqus").abaqus_to_meshio_type
        for word in set(_ELEMENT_TYPE.findall(file.read_bytes())):
            kind = _find_meshio_name(word.decode())
            if kind is not None:
                known.setdefault(word.decode(), kind)
    if reader == "nastran":
        head, mark, bulk = file.read_bytes().partition(b"BEGIN BULK")
        file.write_bytes(head + mark + _CONTINUATION_LINE.sub(b"+", bulk))


def _find_meshio_name(name: str) -> str | None:
    """Return meshio's name of an Abaqus solid or plane element, or None."""
    for dimension, pattern in ABAQUS_TYPES.items():
        if match := pattern.fullmatch(name.upper()):
            return MESHIO_NAMES[dimension].get(int(match[1]))
    return None


def require_unv_node_counts(data: bytes, where: str) -> None:
    """Require that each element of a UNV file has the node count of its type.

    gmsh writes elements with 9, 18 and 27 nodes under types with fewer nodes. From an element with
    9, 18 or 27 nodes, gmsh reads only the corners.

    Raises
    ------
    UsageError : an element does not have the number of nodes that its type requires.
    """
    for dataset in _UNV_ELEMENT_DATASET.findall(data):
        lines = iter(dataset.splitlines())
        for header in lines:
            fields = list(map(int, header.split()))
            if len(fields) < 6:
                return  # gmsh reports a damaged file
            kind, nodes = fields[1], fields[5]
            if nodes != UNV_NODES.get(kind, nodes):
                raise wrong(
                    where,
                    "the number of nodes does not match the UNV element type",
                    got=f"an element of type {kind} with {nodes} nodes",
                    expected=f"{UNV_NODES[kind]} nodes",
                    hint=(
                        "export linear elements, or quadratic elements with nodes on corners and "
                        "edges only"
                    ),
                )
            more = -(-nodes // 8) + (kind in UNV_BEAMS)
            list(islice(lines, more))


def _list_faces(cells: np.ndarray, dimension: int) -> list[np.ndarray]:
    """Return the corners of all faces of all elements.

    The list contains one array (elements, corners) for each face of the reference element. Faces
    between two elements are included twice.
    """
    corners = cells.shape[1]
    if dimension == 2:
        return [cells[:, [k, (k + 1) % corners]] for k in range(corners)]
    return [cells[:, face] for face in ELEMENT_FACES.get(corners, TETRAHEDRON_FACES)]


def _collect_element_sets(
    mesh: Any, file: str, reader: str, dimensions: np.ndarray
) -> dict[tuple[str, int], np.ndarray]:
    """Return the element numbers of each set, keyed by name and dimension of the set."""
    result: dict[tuple[str, int], np.ndarray] = {}
    starts = np.cumsum([0, *(len(cells.data) for cells in mesh.cells)])
    named_sets = list(_list_named_sets(mesh, file, reader, starts))
    for name, members in named_sets:
        for d in np.unique(dimensions[members]):
            text = name
            if any(other == name for other, _ in result):
                text = f"{name} of dimension {d}"
            result[text, int(d)] = members[dimensions[members] == d]
    return result


def _list_named_sets(
    mesh: Any, file: str, reader: str, starts: np.ndarray
) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the name and the element numbers of each set or group of elements.

    Elements with the same value of integer cell data form a group, whose name contains the value.
    """
    for name, parts in mesh.cell_sets.items():
        pieces = [start + np.asarray(p, int) for start, p in zip(starts, parts, strict=False)]
        yield name, np.concatenate([np.empty(0, int), *pieces])
    if reader == "exodus":
        for name, k in _list_exodus_blocks(file):
            yield name, np.arange(starts[k], starts[k + 1])
    arrays = {}
    for name, parts in mesh.cell_data.items():
        values = np.concatenate([np.asarray(part) for part in parts])
        if values.ndim == 1 and values.dtype.kind in "iu" and len(np.unique(values)) <= MAX_GROUPS:
            arrays[name] = values
    names = getattr(mesh, "cell_tags", {})
    for array, values in arrays.items():
        members: dict[str, list[np.ndarray]] = {}
        for value in np.unique(values[values != 0]):
            texts = names.get(int(value), []) if array == "cell_tags" else []
            for text in texts or [str(value) if len(arrays) == 1 else f"{array} {value}"]:
                members.setdefault(text, []).append(np.flatnonzero(values == value))
        for text, pieces in members.items():
            yield text, np.concatenate(pieces)


def _list_exodus_blocks(file: str) -> Iterator[tuple[str, int]]:
    """Yield the name and the index of each element block in an Exodus file.

    If a block has no name, its number is used as name.
    """
    with import_optional("netCDF4", file).Dataset(file) as data:
        places = [int(key[7:]) - 1 for key in data.variables if re.fullmatch(r"connect\d+", key)]
        numbers = data.variables["eb_prop1"][:] if "eb_prop1" in data.variables else None
        names = data.variables.get("eb_names")
        if names is not None:
            names.set_auto_mask(False)
        for k, place in enumerate(places):
            text = "" if names is None else b"".join(names[place]).decode().strip("\0 ")
            yield text or str(place + 1 if numbers is None else numbers[place]), k


def _collect_node_sets(mesh: Any) -> dict[str, np.ndarray]:
    """Return the node numbers of each node set, keyed by the name of the set."""
    result = {name: np.asarray(nodes, int) for name, nodes in mesh.point_sets.items()}
    tags = np.asarray(mesh.point_data.get("point_tags", []))
    for tag, names in getattr(mesh, "point_tags", {}).items():
        for name in names:
            nodes = np.flatnonzero(tags == tag)
            result[name] = np.union1d(result.get(name, np.empty(0, int)), nodes)
    return result


def _add_node_set(
    gmsh: ModuleType,
    name: str,
    nodes: np.ndarray,
    faces: list[np.ndarray],
    dimension: int,
    tag: int,
) -> None:
    """Add a node set to gmsh as a physical group that consists of faces or points.

    The group consists of the surface faces of the body that have all their corners in the node set.
    If no surface face has all its corners in the set, the group consists of one point for each node
    of the set.
    """
    inside = [face[np.isin(face, nodes).all(axis=1)] for face in faces]
    surface = []
    for width in (2, 3, 4):
        parts = [face for face in inside if face.shape[1] == width]
        corners = np.concatenate([np.empty((0, width), int), *parts])
        _, first, times = np.unique(
            np.sort(corners, axis=1), axis=0, return_index=True, return_counts=True
        )
        surface.append((width, corners[first[times == 1]]))
    d = dimension - 1 if any(len(corners) for _, corners in surface) else 0
    gmsh.model.addDiscreteEntity(d, tag)
    if d:
        for width, corners in surface:
            kind = {2: 1, 3: 2, 4: 3}[width]
            if len(corners):
                gmsh.model.mesh.addElementsByType(tag, kind, [], corners.ravel() + 1)
    else:
        gmsh.model.mesh.addElementsByType(tag, 15, [], nodes + 1)
    gmsh.model.addPhysicalGroup(d, [tag], name=name)


def _find_element_kind(gmsh: ModuleType, shape: str, corners: int, nodes: int) -> int:
    """Return gmsh's number of the element type with a given shape and node count."""
    if shape == "Point":
        return 15
    if nodes == corners:
        return int(gmsh.model.mesh.getElementType(shape, 1))
    for serendipity in (False, True):
        kind = int(gmsh.model.mesh.getElementType(shape, 2, serendipity))
        if kind > 0 and gmsh.model.mesh.getElementProperties(kind)[3] == nodes:
            return kind
    raise wrong(
        "mesh",
        "the mesh has an element type that is not supported",
        got=f"{shape} with {nodes} nodes",
        expected="elements of order 1 or 2",
        hint=_ELEMENT_ORDER_HINT,
    )


def _order_nodes(
    gmsh: ModuleType, kind: int, shape: str, corners: int, nodes: np.ndarray, points: np.ndarray
) -> np.ndarray:
    """Reorder the nodes of elements to the node order of gmsh.

    ``nodes`` has the shape (elements, nodes per element). The order of nodes on edges and faces
    differs between programs. The returned order minimises the sum of the squared distances between
    each node and its position in an element with straight edges.
    """
    extra = nodes[:, corners:]
    if not extra.size:
        return nodes
    local = gmsh.model.mesh.getElementProperties(kind)[4].reshape(nodes.shape[1], -1)
    places = np.zeros((len(local), 3))
    places[:, : local.shape[1]] = local
    linear = gmsh.model.mesh.getElementType(shape, 1)
    weights = gmsh.model.mesh.getBasisFunctions(linear, places.ravel(), "Lagrange")[1]
    straight = np.einsum("lc,ecd->eld", weights.reshape(-1, corners), points[nodes[:, :corners]])
    apart = points[extra][:, None] - straight[:, corners:, None]
    order = linear_sum_assignment((apart**2).sum(axis=(0, 3)))[1]
    bulge = np.linalg.norm(apart[:, np.arange(len(order)), order], axis=-1).max(axis=1)
    ends = points[nodes[:, :corners]]
    longest = np.linalg.norm(ends[:, None] - ends[:, :, None], axis=-1).max(axis=(1, 2))
    far = np.flatnonzero(bulge > MAX_BULGE * longest)
    if far.size:
        raise wrong(
            "mesh",
            "mid-edge nodes are far from their edges",
            got=f"{far.size} of {len(nodes)} elements of {nodes.shape[1]} nodes",
            expected="for each element its corner nodes, then mid-edge nodes close to the edges",
            hint="write the mesh with the corners of each element first, or with straight edges",
        )
    return np.column_stack([nodes[:, :corners], extra[:, order]])
