"""Keys of bodies from a mesh or CAD file, and functions to read their groups."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import filterfalse
from pathlib import Path
from typing import Annotated, Any, TypeAlias

import numpy as np
from pydantic import Field, StringConstraints, model_validator

from kc2spice.core.errors import UsageError, list_candidates, wrong
from kc2spice.core.quantities import (
    Count,
    Length,
    RefinementRule,
    Section,
    make_invalid_value_error,
)
from kc2spice.core.untrusted_files import locate_file_in_folder
from kc2spice.fem import mesh_file
from kc2spice.parts.bodies._linear_body_keys import FieldKeys
from kc2spice.scene.scene_classes import DeclaredScene, Part

Point: TypeAlias = tuple[Length, Length, Length]
Name: TypeAlias = Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,30}$")]
MeshFile: TypeAlias = Annotated[str, StringConstraints(min_length=1, max_length=255)]
MESH_FIELD = Field(  # definition of the key ``mesh`` in part types that require a mesh
    examples=['"part.msh"'],
    description=(
        "Mesh or CAD file in the scene's folder: .msh, .unv, .inp, .bdf, .nas, .vtu, "
        ".med, .exo, .e, .step, .stp or .brep"
    ),
)


# Hint for directions along y in an axisymmetric body.
HEIGHT_HINT = (
    "{action}: in an axisymmetric body, z is the height, even if the mesh file contains the height "
    "as y"
)


def reject_point_outside_section(point: Point | None, key: str) -> None:
    """Reject a point of an axisymmetric body whose second coordinate is not zero."""
    if point is not None and point[1] != 0:
        raise make_invalid_value_error(
            "a point of an axisymmetric body has no y coordinate",
            "[radius, 0, height]",
            key=key,
            hint=HEIGHT_HINT.format(action="write the height as the third coordinate"),
        )


class GroupKeys(Section):
    """Keys of a group of entities in a CAD file.

    A group contains the entities at given points, or the entities inside a box.
    """

    solids: tuple[Point, ...] = Field(
        (),
        description=(
            "Points that select solids of the CAD file: each solid that contains one of the points"
        ),
    )
    faces: tuple[Point, ...] = Field(
        (),
        description=(
            "Points that select faces of the CAD file: each face that contains one of the points"
        ),
    )
    curves: tuple[Point, ...] = Field(
        (),
        description=(
            "Points that select curves of the CAD file: each curve that contains one of the points"
        ),
    )
    points: tuple[Point, ...] = Field(
        (), description="Coordinates that select geometric points of the CAD file"
    )
    solids_in: tuple[Point, Point] | None = Field(
        None,
        description=(
            "Two opposite corners of a box that selects all solids of the CAD file inside the box"
        ),
    )
    faces_in: tuple[Point, Point] | None = Field(
        None,
        description=(
            "Two opposite corners of a box that selects all faces of the CAD file inside the box"
        ),
    )
    curves_in: tuple[Point, Point] | None = Field(
        None,
        description=(
            "Two opposite corners of a box that selects all curves of the CAD file inside the box"
        ),
    )
    points_in: tuple[Point, Point] | None = Field(
        None,
        description=(
            "Two opposite corners of a box that selects all geometric points of the CAD file "
            "inside the box"
        ),
    )

    @model_validator(mode="after")
    def _require_one_selector(self) -> GroupKeys:
        """Require exactly one key that selects the CAD entities of the group."""
        if len({key.removesuffix("_in") for key in self.model_fields_set}) != 1:
            raise make_invalid_value_error(
                "a group needs exactly one of the keys `solids`, `faces`, `curves` and `points`",
                None,
                hint="keep one of these keys in the group",
            )
        return self

    def make_selection(self, unit: float) -> dict[str, Any]:
        """Make the selection of CAD entities, with coordinates in the CAD file's unit.

        The coordinates [m] are divided by ``unit`` [m], the length unit of the CAD file.
        """
        kind = next(iter(self.model_fields_set)).removesuffix("_in")
        dimension = ("points", "curves", "faces", "solids").index(kind)
        at = np.divide(getattr(self, kind), unit)
        box = np.divide(getattr(self, f"{kind}_in") or (), unit)
        return {"dimension": dimension, "at": at.tolist(), "box": box.tolist() or None}


class MeshKeys(FieldKeys):
    """Base class for the keys of bodies from a mesh or CAD file."""

    mesh: Annotated[MeshFile | None, MESH_FIELD] = None
    unit: str | None = Field(
        None,
        description=(
            "Length unit of the coordinates in the mesh or CAD file; required if the file "
            "states no unit"
        ),
    )
    size: Length | None = Field(
        None, gt=0, description="Size of the finite elements in the mesh of a CAD file"
    )
    refine: Annotated[Count, RefinementRule(2.0, model=True, mesh=True)] = Field(
        1,
        ge=1,
        le=8,
        description="Refinement factor of the mesh, by which the size of all elements is divided",
    )
    merge: Length | None = Field(
        None,
        ge=0,
        description=(
            "Distance up to which mesh nodes are merged; with 0, solids that touch are not "
            "connected"
        ),
    )
    axisymmetric: bool = Field(
        False,
        description=(
            "Whether the mesh is the half section of a body of revolution; in all keys, x is the "
            "radius and z the height, even if the mesh file contains the height as y"
        ),
    )
    groups: dict[str, GroupKeys] = Field(default_factory=dict)
    materials: dict[str, str | dict[str, Any]] = Field(
        default_factory=dict,
        description="Material of each mesh group: a name, or a table of constants",
    )

    @property
    def split_count(self) -> int:
        """Number of times that each edge of a mesh file is halved; 0 for a CAD file."""
        return 0 if self.size else int(np.ceil(np.log2(self.refine)))


def mesh_path(part: Part[MeshKeys], scene: DeclaredScene) -> Path:
    """Return the path of a part's mesh file.

    Raises
    ------
    UsageError : the path points outside the folder of the scene.
    """
    return locate_file_in_folder(scene.get_folder(part), str(part.keys.mesh), f"{part.name}.mesh")


def find_mesh_problems(part: Part[MeshKeys], scene: DeclaredScene) -> Iterator[UsageError]:
    """Yield the error of an invalid mesh file, without reading the whole file."""
    try:
        path = mesh_path(part, scene)
        mesh_file.require_format(path)
        if not path.exists():
            raise mesh_file.make_missing_mesh_error(path)
        if path.is_file():
            mesh_file.find_length_unit(path, part.keys.unit)
    except UsageError as error:
        if error.where == "unit":
            error.where = f"{part.name}.unit"
        elif error.where == Path(str(part.keys.mesh)).name:
            error.where, error.got = f"{part.name}.mesh", error.got or repr(part.keys.mesh)
        yield error


def read_groups(keys: MeshKeys, home: Path, splits: int) -> mesh_file.GroupedMesh:
    """Read the mesh and its groups; the path of the file is relative to ``home``.

    Raises
    ------
    UsageError : a file cannot be read, or a group is empty.
    """
    path = locate_file_in_folder(home, str(keys.mesh), "mesh")
    unit = mesh_file.find_length_unit(path, keys.unit)
    return mesh_file.read_mesh(
        path,
        unit=unit,
        size=None if keys.size is None else keys.size / keys.refine,
        picks={name: group.make_selection(unit) for name, group in keys.groups.items()},
        dimension=2 if keys.axisymmetric else 3,
        splits=splits,
        merge=keys.merge,
    )


def assign_materials(names: Iterable[str], groups: mesh_file.GroupedMesh) -> np.ndarray:
    """Return the material of each element, as an index into the list ``names``.

    ``names`` are the names of the mesh groups that have a material.

    Raises
    ------
    UsageError : an element has no material or has two materials.
    """
    names = list(names)
    owner = np.full(groups.mesh.nelements, -1)
    for number, name in enumerate(names):
        cells = groups.get_group(name, f"materials.{name}", 0).members
        if (owner[cells] >= 0).any():
            raise wrong(
                f"materials.{name}",
                "some elements have two materials",
                got=f"elements that are also in the group {names[int(owner[cells].max())]}",
                expected="groups without common elements",
                hint=f"delete materials.{name}, or take the elements out of one group",
            )
        owner[cells] = number
    if (owner < 0).any():
        solids = [name for name, group in groups.groups.items() if group.codimension == 0]
        rest = [*filterfalse(names.__contains__, solids)] or solids
        raise wrong(
            "materials",
            "some elements have no material",
            got=f"{np.sum(owner < 0)} elements without material",
            expected="a material for every element",
            hint=f"add a material for one of these groups: {list_candidates('', rest)}",
        )
    return owner
