"""Readers of mesh files and CAD files that return meshes with named groups.

gmsh reads the elements and physical groups in ``.msh`` and ``.unv`` files. meshio reads other mesh
formats (:mod:`kc2spice.fem.mesh_formats`). gmsh also meshes the CAD files ``.step`` and ``.brep``.
Before meshing, touching solids of a CAD file are joined so that neighbouring solids share faces.
The groups of a CAD file are its labelled entities and the entities that the argument ``picks`` of
:func:`read_mesh` selects.

If gmsh does not recognise the format of a file, gmsh runs the file as a script. No option of gmsh
prevents scripts from starting programs. Therefore gmsh runs in a separate process
(:mod:`kc2spice.core.untrusted_files`), on a copy of the file with a safe name and a verified
format.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path
from typing import Any

import numpy as np
from skfem.mesh import Mesh

from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import UsageError, list_candidates, unknown, wrong
from kc2spice.core.files import suggest_file
from kc2spice.core.key_actions import DeleteKey
from kc2spice.core.other_file_formats import SURFACE_SUFFIXES
from kc2spice.core.quantities import convert_quantity
from kc2spice.core.untrusted_files import call_in_child, read_bounded
from kc2spice.fem.mesh_cells import (
    CellBlock,
    divide_faces,
    find_edge_nodes,
    find_entities_by_corners,
    is_product_mesh,
    make_quadratic_mesh,
    reject_folded_elements,
)
from kc2spice.fem.mesh_formats import (
    MESHIO_READERS,
    reject_unsupported_content,
    require_unv_node_counts,
)
from kc2spice.fem.mesh_nodes import merge_nodes, reject_unconnected_solids

STEP_SUFFIXES = (".step", ".stp")
CAD_SUFFIXES = (*STEP_SUFFIXES, ".brep")
# First bytes of each format, and the file name of the copy that gmsh reads, keyed by file
# extension.
FILE_FORMATS = {
    ".msh": (b"$MeshFormat", "mesh.msh"), ".brep": (b"DBRep_DrawableShape", "mesh.brep"),
    ".step": (b"ISO-10303-21;", "mesh.step"), ".stp": (b"ISO-10303-21;", "mesh.step"),
    ".inp": (b"", "mesh.inp"), ".bdf": (b"", "mesh.bdf"), ".nas": (b"", "mesh.nas"),
    ".unv": (b"    -1", "mesh.unv"), ".vtu": (b"<", "mesh.vtu"), ".med": (b"\x89HDF", "mesh.med"),
    ".exo": (b"", "mesh.exo"), ".e": (b"", "mesh.e"),
}  # fmt: skip
MAX_FILE_BYTES = 2_000_000_000  # largest size of a mesh or CAD file
_HEAD_BYTES = 200  # number of bytes at the start of a file that identify its format
LENGTH_UNITS_ACCEPTED = ("m", "cm", "mm", "um")  # units that a user may state for a file
MILLIMETRE = 1e-3  # m, unit of length after gmsh has read a STEP file
# Pattern of the header of a .msh file in an accepted version.
# The bytes after the version show whether numbers are text, little-endian or big-endian.
_MSH_HEADER = re.compile(
    rb"\$MeshFormat[ \t\r]*\n[ \t]*(2|2\.[012]|4|4\.[01])[ \t]+"
    rb"(0[ \t]+8[ \t\r]*\n\s*\$EndMeshFormat|1[ \t]+8[ \t\r]*\n(\x01\0\0\0|\0\0\0\x01))"
)
_UNV_DATASET_MARK = re.compile(
    rb"^    -1[ \t\r]*$", re.MULTILINE
)  # line before and after each dataset in a .unv file
_STEP_STRING_OR_COMMENT = re.compile(rb"'(?:[^']|'')*'|/\*.*?\*/", re.DOTALL)


@dataclass(frozen=True, eq=False)
class Group(EqualByContent):
    """Named set of elements, facets or nodes of the mesh.

    ``members`` are the numbers of the elements, facets or nodes. ``codimension`` is 0 for elements,
    1 for facets, and 2 or 3 for nodes. ``shares`` contains the weights of the nodes, whose sum is
    1. On a curve, the weight of a node is its share in the length of the curve. Points have equal
    weights.
    """

    codimension: int
    members: np.ndarray
    shares: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class GroupedMesh:
    """Quadratic mesh with coordinates in metres, and groups keyed by name.

    A solid mesh consists of tetrahedra or hexahedra, and a plane mesh of triangles or
    quadrilaterals. Each element of the mesh was made from one element of the file, whose number is
    in ``numbers`` (elements,).
    """

    mesh: Mesh
    groups: Mapping[str, Group]
    numbers: np.ndarray

    def get_group(self, name: str, where: str, *codimensions: int) -> Group:
        """Return the group with a given name; reject a group of an unsuitable dimension.

        The group must have one of the ``codimensions``. ``where`` is the scene key that contains
        the name of the group.

        Raises
        ------
        UsageError : the group does not exist, is empty, or has another codimension.
        """
        result = self.groups.get(name)
        # a force or a support may act on a volume, but a volume is never proposed for it
        proposed = codimensions or (1, 2, 3)
        fitting = [key for key, group in self.groups.items() if group.codimension in proposed]
        kinds = ("elements", "faces", "curves", "points")
        if self.mesh.dim() == 2:
            kinds = ("elements", "curves", "points", "")
        needed = " or ".join(kinds[c] for c in codimensions or (1,))
        if result is None and not fitting:
            dimension = self.mesh.dim() - proposed[0]
            entities = ("points", "curves", "surfaces", "volumes")[dimension]
            command = f'gmsh.model.addPhysicalGroup({dimension}, [1], name="{name}")'
            raise UsageError(
                f"the mesh has no groups{f' of {needed}' if self.groups else ''}",
                where=where,
                got=repr(name),
                expected="a physical group of the mesh for each material, electrode and port",
                hint=f"add the group in gmsh, with the tags of its {entities} in place of 1: "
                f"{command}",
            )
        if result is None:
            raise unknown("the mesh has no such group", name, sorted(fitting), where)
        if not result.members.size:
            filled = [key for key, group in self.groups.items() if group.members.size]
            raise wrong(
                where,
                "this group is empty",
                got=name,
                expected="a group with elements in the mesh",
                hint=f"use a group that is not empty: {list_candidates(name, filled)}",
            )
        if codimensions and result.codimension not in codimensions:
            hint = f"write {fitting[0]} in place of {name}" if fitting else (
                f"add a group of {needed} to the mesh"
            )  # fmt: skip
            raise wrong(
                where,
                f"this group does not consist of {needed}",
                got=f"{name}, a group of {kinds[result.codimension]}",
                expected=(
                    f"a group of {needed}: {list_candidates(name, fitting) or 'the mesh has none'}"
                ),
                hint=hint,
            )
        return result


def read_mesh(
    path: Path,
    *,
    unit: float,
    size: float | None = None,
    picks: Mapping[str, Mapping[str, Any]] | None = None,
    dimension: int = 3,
    splits: int = 0,
    merge: float | None = None,
) -> GroupedMesh:
    """Return the mesh of a mesh file, or a new mesh of a CAD file.

    ``unit`` is the file's unit of length [m]. For a CAD file, ``size`` is the largest edge length
    [m] of the elements in the new mesh. ``dimension`` is 3 for solids, and 2 for a plane mesh.
    Every edge of the mesh is halved ``splits`` times.

    ``picks`` defines groups of a CAD file, keyed by name. A group consists of entities of one
    ``dimension`` (0 to 3: points, curves, faces, solids). Each entity contains one of the points
    ``at`` (n, 3), or lies inside a ``box`` between two opposite corners. The coordinates of ``at``
    and ``box`` are in the unit of the file.

    Nodes that are at most ``merge`` [m] apart become one node. If ``merge`` is 0, touching solids
    without common nodes are accepted.

    Raises
    ------
    UsageError : the file is missing or contains no solids, or its format does not match its suffix.
        For a CAD file, the error is also raised if ``size`` is missing or if a point or box in
        ``picks`` selects no entity. Solids that touch without common nodes also cause the error,
        because they are not connected. With ``merge = 0``, unconnected solids are accepted.
    """
    data = _read_content(path)
    if path.suffix.lower() in STEP_SUFFIXES and unit != MILLIMETRE:
        raise wrong(
            "unit",
            "a STEP file is converted from its own unit to mm, so no other unit is possible",
            got=f"a unit of {unit:g} m",
            expected='no key `unit`, or  unit = "mm"',
            hint=DeleteKey("unit"),
        )
    cad = path.suffix.lower() in CAD_SUFFIXES
    if cad == (size is None):
        if cad:
            raise wrong(
                "size",
                "a CAD file needs an element size",
                expected='a length such as "1 mm"',
                hint='add for example  size = "1 mm"',
            )
        raise wrong(
            "size",
            f"size has no effect on a {path.suffix} file, which contains elements already",
            got=f"{size:g} m",
            expected="no size",
            hint=DeleteKey("size"),
        )
    if picks and not cad:
        raise wrong(
            "groups",
            "the key `groups` applies only to CAD files",
            hint="name physical groups in the mesh",
        )
    result = _call_gmsh(
        "extract_mesh",
        path,
        data,
        name=str(path),
        size=None if size is None else size / unit,
        dimension=dimension,
        picks=dict(picks or {}),
        splits=splits,
    )
    return _assemble_mesh(result, unit, dimension, str(path), merge)


def find_length_unit(path: Path, unit: str | None) -> float:
    """Return the unit of length [m] of a file, from its format or from the scene.

    ``unit`` is the unit that the scene states, or None.

    Raises
    ------
    UsageError : neither the format nor ``unit`` states the unit. The error message states the size
        of the body for each possible unit.
    """
    if path.suffix.lower() in STEP_SUFFIXES or unit is not None:
        try:
            return convert_quantity(f"1 {unit or 'mm'}", "m", where="unit")
        except UsageError as error:
            near = re.search(r'"1 (\w+)"', error.hint or "")
            hint = f'write  unit = "{near[1] if near else "mm"}"'
            if str(unit).lower() in _IMPERIAL_UNITS:
                hint = f'export the mesh in millimetres, and write  unit = "mm"  in place of {unit}'
            raise wrong(
                "unit",
                "this text is not a unit of length",
                got=repr(unit),
                expected=f"one of {', '.join(LENGTH_UNITS_ACCEPTED)}",
                hint=hint,
            ) from error
    sides = measure_extent(path)

    def format_sides(scale: float) -> str:
        """Format the sides of the mesh's bounding box, multiplied by a scale factor."""
        return " x ".join(f"{float(f'{scale * side:.4g}'):.12g}" for side in sides)

    sizes = (
        f'"{name}" if it is {format_sides(1e3 * convert_quantity(f"1 {name}", "m"))} mm'
        for name in LENGTH_UNITS_ACCEPTED
    )
    raise wrong(
        "unit",
        f"a {path.suffix} file does not state its unit of length",
        got=f"a body of {format_sides(1.0)} in the unit of the file",
        expected=", ".join(sizes),
        hint='add  unit = "mm"  below mesh, if the size in mm is right',
    )


_IMPERIAL_UNITS = ("in", "inch", "inches", "mil", "mils", "thou", "ft", "feet")


def measure_extent(path: Path) -> np.ndarray:
    """Return the three side lengths of the bounding box of the body in a file.

    The side lengths are in mm for a STEP file, and otherwise in the unit of the file.

    Raises
    ------
    UsageError : the file is missing, or its format does not match its suffix.
    """
    low, high = _call_gmsh("measure_bounding_box", path, _read_content(path))["box"]
    return np.asarray(high - low)


def _call_gmsh(function: str, path: Path, data: bytes, **request: Any) -> dict[str, np.ndarray]:
    """Call a function of :mod:`kc2spice.fem.mesh_by_gmsh` in a separate process.

    ``data`` is the content of the file ``path``. The separate process reads a copy of this file,
    which is written from ``data``. ``request`` contains the other arguments of the called function.
    """
    file = FILE_FORMATS[path.suffix.lower()][1]

    def write_copy(home: Path) -> None:
        """Write a copy of the mesh file to a folder."""
        (home / file).write_bytes(data)

    request = {**request, "file": file}
    try:
        return call_in_child(f"kc2spice.fem.mesh_by_gmsh:{function}", request, write_copy)
    except ValueError as error:
        reader = "meshio" if path.suffix.lower() in MESHIO_READERS else "gmsh"
        raise UsageError(
            f"{reader} cannot read or mesh this file",
            where=path.name,
            got=str(error),
            expected=f"a complete {path.suffix} file with volume elements",
            hint=f"export {path.name} again from the mesher; the file may be truncated",
        ) from None


def require_format(path: Path, head: bytes | None = None) -> None:
    """Reject a file whose content does not match the format of its suffix.

    This check is necessary, because gmsh runs files of unknown format as scripts. ``head`` contains
    the first bytes of the file, which are by default read from the file. A missing file raises no
    error.

    Raises
    ------
    UsageError : the suffix is unknown, or the content does not have the format of the suffix.
    """
    known = FILE_FORMATS.get(path.suffix.lower())
    if known is None:
        hint = "save the volume mesh as .msh, for example with gmsh"
        if path.suffix.lower() in SURFACE_SUFFIXES:
            hint = "save the CAD model as .step: this file contains surfaces, not volumes"
        raise wrong(
            path.name,
            "this file is not a mesh or CAD file in a supported format",
            got=path.suffix or "a name without suffix",
            expected=f"a file that ends with {list_candidates(path.suffix, FILE_FORMATS)}",
            hint=hint,
        )
    if head is None:
        if not path.is_file():
            return
        with path.open("rb") as file:
            head = file.read(_HEAD_BYTES)
    if not head.strip():
        raise wrong(
            path.name,
            "this file is empty",
            expected=f"a {path.suffix} file",
            hint=f"export {path.name} again from the mesher",
        )
    magic = known[0]
    got, expected = head[:20], f"a file that begins with {magic.decode(errors='backslashreplace')}"
    hint = f"export the file again as {path.suffix}"
    if head.startswith(magic):
        if magic != b"$MeshFormat" or _MSH_HEADER.match(head):
            return
        got, expected = head[:40], "a header of version 2 or 4, as text or binary"
        hint = 'gmsh.option.setNumber("Mesh.MshFileVersion", 4.1) before gmsh.write'
    raise wrong(
        path.name,
        "the content of this file does not match its suffix",
        got=repr(got)[1:],
        expected=expected,
        hint=hint,
    )


def make_missing_mesh_error(path: Path) -> UsageError:
    """Make the error about a mesh or CAD file that does not exist."""
    return wrong(
        path.name,
        "this file does not exist",
        expected=f"a mesh or CAD file: {list_candidates(path.suffix, FILE_FORMATS)}",
        hint=suggest_file(path, tuple(FILE_FORMATS))
        or f"copy {path.name} into the folder {path.parent}",
    )


def _read_content(path: Path) -> bytes:
    """Check the format of a mesh or CAD file, and return the content of the file."""
    require_format(path)
    try:
        data = read_bounded(path, MAX_FILE_BYTES)
    except (OSError, ValueError) as error:
        if isinstance(error, FileNotFoundError):
            raise make_missing_mesh_error(path) from None
        reason = getattr(error, "strerror", None) or str(error)
        raise wrong(
            str(path),
            f"this file cannot be read: {reason}",
            expected=None,
            hint=f"check the permissions and the size of {path}",
        ) from None
    require_format(path, data[:_HEAD_BYTES])
    if path.suffix.lower() == ".unv" and len(_UNV_DATASET_MARK.findall(data)) % 2:
        raise wrong(
            str(path),
            "the file ends within a dataset",
            expected="a line -1 before and after each dataset",
            hint="export the file again",
        )
    if path.suffix.lower() == ".unv":
        require_unv_node_counts(data, str(path))
    if path.suffix.lower() in MESHIO_READERS:
        reject_unsupported_content(path.suffix.lower(), data, str(path))
    if path.suffix.lower() in STEP_SUFFIXES and b"DOCUMENT_FILE" in _STEP_STRING_OR_COMMENT.sub(
        b"", data
    ):
        raise wrong(
            str(path),
            "this file refers to other files",
            got="DOCUMENT_FILE",
            expected="one file with all solids",
            hint=f"export {path.name} without external references",
        )
    return data


def _assemble_mesh(
    arrays: Mapping[str, np.ndarray],
    unit: float,
    dimension: int,
    where: str,
    merge: float | None = None,
) -> GroupedMesh:
    """Assemble the mesh and its groups from the arrays that gmsh has returned."""
    points = unit * arrays["points"]
    if not np.isfinite(points).all():
        raise UsageError(
            "a node has a coordinate that is not a finite number",
            where=where,
            hint="export the mesh again",
        )
    # an axisymmetric mesh is in the x-y plane with the axis y, or in the x-z plane with the axis z
    if dimension == 2:
        flat = [axis for axis in (2, 1) if np.ptp(points[:, axis]) <= 1e-9 * np.ptp(points)]
        if not flat:
            raise wrong(
                Path(where).name,
                "the nodes of the axisymmetric mesh are not in one plane",
                expected="all nodes at z = 0, or all at y = 0",
                hint="delete the key `axisymmetric`, because this mesh is not a plane section",
            )
        points = points[:, [0, 3 - flat[0]]]
    blocks = []
    for k, corners in enumerate(arrays["corners"]):
        blocks.append(CellBlock(arrays[f"cells{k}"], int(corners), arrays[f"local{k}"]))
    record = json.loads(str(arrays["record"]))
    if not blocks:
        raise _make_empty_mesh_error(dimension, max(map(itemgetter(1), record), default=0), where)
    reject_folded_elements(points, blocks, where)
    same = np.arange(len(points))
    if merge:
        same = merge_nodes(points, blocks, merge)
        blocks = [block.renumber_nodes(same) for block in blocks]
    if merge != 0:
        owners = {name: arrays[f"group{k}"] for k, (name, d) in enumerate(record) if d == dimension}
        reject_unconnected_solids(points, blocks, owners, where)
    mesh, number, parent = make_quadratic_mesh(points, blocks)
    groups: dict[str, Group] = {}
    for k, (name, d) in enumerate(record):
        members = arrays[f"group{k}"] if d == dimension else same[arrays[f"group{k}"]]
        if name in groups:
            raise wrong(
                where,
                "two groups have the same name",
                got=name,
                expected="a name for each group",
                hint="rename one of these groups in gmsh",
            )
        if d == dimension:
            groups[name] = Group(0, np.flatnonzero(np.isin(parent, members)))
        elif d == dimension - 1:
            if d == 2 and not is_product_mesh(blocks):
                members = divide_faces(members)
            facets = find_entities_by_corners(mesh.facets, number[members])
            groups[name] = Group(1, np.unique(_require_entities_on_body(facets, name)))
        else:
            ends = _require_entities_on_body(number[members], name)
            length = np.linalg.norm(points[members[:, 0]] - points[members[:, -1]], axis=1)
            groups[name] = Group(dimension - d, *_compute_node_weights(mesh, ends, length, name))
    return GroupedMesh(mesh, groups, arrays["numbers"][parent])


def _make_empty_mesh_error(dimension: int, grouped: int, where: str) -> UsageError:
    """Make the error for a mesh without elements of the required dimension.

    ``grouped`` is the largest dimension of a group in the file.
    """
    shape, what = ("tetrahedra", "solid") if dimension == 3 else ("triangles", "face")
    problem, hint = f"the mesh has no {shape}", f"mesh the {what} with "
    hint += f"gmsh.model.mesh.generate({dimension}) before gmsh.write"
    if grouped == 2 and dimension == 3:
        problem = "the mesh contains only faces, but shell elements are not supported"
        hint = "extrude the faces to solids, or set axisymmetric = true for the half section of a "
        hint += "body of revolution"
    expected = f"{shape}, prisms or hexahedra in each solid of the body"
    if dimension == 2:
        expected = "triangles or quadrilaterals in each face of the body"
    return UsageError(problem, where=where, expected=expected, hint=hint)


def _compute_node_weights(
    mesh: Mesh, ends: np.ndarray, length: np.ndarray, name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes of a group of points or line elements, and the node weights.

    ``ends`` contains the nodes of points (k, 1), or the end nodes of line elements (k, 2). The sum
    of the weights is 1. On line elements, the weight of a node is its share in the total length.
    """
    nodes, weights = ends.ravel(), np.ones(len(ends))
    if ends.shape[1] == 2:
        middle = find_edge_nodes(mesh, ends)
        _require_entities_on_body(middle - mesh.nvertices, name)
        nodes = np.concatenate([*ends.T, middle])
        weights = np.concatenate([length, length, 4 * length]) / 6  # weights of Simpson's rule
    unique, place = np.unique(nodes, return_inverse=True)
    total = np.bincount(place, weights, len(unique))
    return unique, total / (total.sum() or 1.0)


def _require_entities_on_body(places: np.ndarray, name: str) -> np.ndarray:
    """Return the indices unchanged; reject a group with entities outside of the body.

    The index -1 marks an entity that is not on the body, and raises an error.
    """
    if (places < 0).any():
        raise UsageError(
            "this group does not lie on the elements of the body",
            where=f"group {name}",
            expected="faces, curves or points of the elements that have a material",
            hint=f"give the solid beside {name} a material",
        )
    return places
