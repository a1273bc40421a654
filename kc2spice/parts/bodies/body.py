"""The part ``body``: the user's mesh or CAD file as a linear model.

The groups of the mesh or CAD file are used for materials, supports, electrodes and ports::

    [bracket]
    part = "body"
    mesh = "bracket.step"
    unit = "mm"                   # length unit of the file; STEP files contain their unit
    size = "2 mm"                 # element size, for CAD files only
    materials = { frame = "aluminium", patch = "PZT-5A" }
    poling = { patch = [0, 0, 1] }    # or "radial" or "tangential" about z, or a CSV file
    axes = { frame = { z = [0, 0, 1], x = [0, 1, 0] } }    # material axes of a group
    fixed = ["foot"]              # or { group = "foot", axes = "z" } for a roller support
    electrodes = { anode = "top", cathode = "bottom" }
    ports = [
        { name = "tip", group = "end", axis = "z" },
        { name = "base", kind = "base", axis = "z" },
    ]

The groups of a CAD file are its labels and the groups that the key ``groups`` defines. The key
``groups`` selects entities by points in the entities, or by a box around the entities:
``groups = { top = { faces = [["5 mm", 0, "1 mm"]] }, end = { faces_in = [[…], […]] } }``.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import numpy as np
from pydantic import Field, StringConstraints, ValidationInfo, model_validator

from kc2spice.bodies import solid_models as fe
from kc2spice.bodies.undamped_models import FiniteElementModel
from kc2spice.core.cache import load_or_build
from kc2spice.core.domains import ACCELERATION, ACOUSTIC, ELECTRICAL, ROTATION, TRANSLATION
from kc2spice.core.errors import UsageError, name_part_in_errors, wrong
from kc2spice.core.figure import Curve, Figure, FileWriter, Panel
from kc2spice.core.key_actions import DeleteKey
from kc2spice.core.key_errors import validate_table
from kc2spice.core.naming import list_names
from kc2spice.core.quantities import Section, make_invalid_value_error
from kc2spice.core.untrusted_files import locate_file_in_folder
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem import mesh_file
from kc2spice.fem.body_keys import DampingKeys
from kc2spice.fem.element_poling import (
    PolingTable,
    compute_centres,
    find_coarse_elements,
    read_poling,
)
from kc2spice.fem.materials import (
    CylindricalAxes,
    ElementAxes,
    Material,
    advise_missing_ceramic_keys,
    compute_poling_rotation,
    find_material,
)
from kc2spice.fem.solid import Solid, compute_node_shares
from kc2spice.parts.bodies._body_figures import draw_edges
from kc2spice.parts.bodies._body_model import hash_file
from kc2spice.parts.bodies._mesh_keys import (
    HEIGHT_HINT,
    MESH_FIELD,
    MeshFile,
    MeshKeys,
    Name,
    Point,
    assign_materials,
    find_mesh_problems,
    mesh_path,
    read_groups,
    reject_point_outside_section,
)
from kc2spice.parts.bodies._meshed_bodies import MeshedBody, check_q_factor
from kc2spice.parts.bodies._neglected_effects import Envelope, estimate_surface_and_air_mass
from kc2spice.physics.conductors import OPTIONAL_HEAT_PINS
from kc2spice.rom.linear_model import Port
from kc2spice.scene.part_records import NeglectedEffect
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import BuiltScene, DeclaredScene, GovernedScene, Part, Scene

Vector: TypeAlias = tuple[float, float, float]
_MOTION_NAMES = ("x", "y", "z", "rx", "ry", "rz")
# Radial, circumferential and axial component of the poling vector, keyed by ``direction``.
_CYLINDRICAL_VECTORS = {"radial": (1.0, 0.0, 0.0), "tangential": (0.0, 1.0, 0.0)}
# Physical domain of each kind of port.
# The kind ``rigid`` is absent, because the domain of its ports depends on the motion of the face.
_DOMAINS_OF_KINDS = {"mean": TRANSLATION, "base": ACCELERATION, "face": ACOUSTIC}
_NEEDS_OF_KINDS = {
    "mean": "needs the key `group` or the key `at`",
    "rigid": "needs the key `group`",
    "base": "accepts neither the key `group` nor the key `at`",
    "face": "needs the key `group`",
}
_PLACE_HINTS = {
    "mean": 'add for example  group = "NAME"  with a group of the mesh, and omit the key `at`',
    "rigid": 'add for example  group = "NAME"  with a group of faces, and omit the key `at`',
    "base": "delete the keys `group` and `at`",
    "face": 'add for example  group = "NAME"  with a group of faces, and omit the key `at`',
}
_REFERENCE_NAMES = ("cathode", "gnd", "ground")


class SupportKeys(Section):
    """Keys of a support: a mesh group with zero displacement along some axes.

    In an axisymmetric body, ``x`` is the radial axis and ``z`` the axis of revolution.
    """

    group: str = Field(examples=['"top"'], description="Mesh group whose nodes are clamped")
    axes: Annotated[str, StringConstraints(pattern="^[xyz]{1,3}$")] = Field(
        "xyz",
        description=(
            "Axes along which the clamped nodes cannot move; in an axisymmetric mesh, x "
            "is the radial axis, and z the axis of revolution"
        ),
    )


class PortKeys(Section):
    """Keys of a mechanical or acoustic port of a body.

    A port of the kind *mean* has the mean displacement of a group along ``axis``; its force is
    distributed over the group. The group of a *mean* port consists of elements, faces, curves or
    points. A port of the kind *rigid* makes a face rigid. The *rigid* port is one motion (``x`` …
    ``rz``) of the face; without ``axis``, all six motions become the ports ``NAME_x`` …
    ``NAME_rz``. The input of a *base* port is the acceleration of the body's support. The input of
    a *face* port is the pressure on a group of faces; its output is the volume that the group
    displaces. Without a group, the key ``at`` selects the mesh node nearest to a point.
    """

    name: Name = Field(
        examples=['"tip"'],
        description=(
            "Name of the body's port, which is also the name of its pin; names of internal nodes, "
            "such as p1 and q1, are reserved"
        ),
    )
    group: str | None = Field(None, description="Mesh group on which the port acts")
    at: Point | None = Field(
        None,
        description=(
            "Coordinates of a point; the port acts on the mesh node nearest to this point"
        ),
    )
    axis: Literal["x", "y", "z", "rx", "ry", "rz"] | Vector | None = Field(
        None, description="Direction of the displacement at the port, or axis of the rotation"
    )
    kind: Literal["mean", "rigid", "base", "face"] = Field(
        "mean",
        description=(
            "Kind of port: mean displacement of a group, motion of a rigid face, "
            "acceleration of the support (base), or sound pressure on a face"
        ),
    )

    @model_validator(mode="after")
    def _require_consistent_keys(self) -> PortKeys:
        """Reject contradictory keys of a port."""
        places = (self.group is not None) + (self.at is not None)
        of_group = self.kind in ("rigid", "face")
        if places != (0 if self.kind == "base" else 1) or (of_group and self.at):
            raise make_invalid_value_error(
                f'kind = "{self.kind}" {_NEEDS_OF_KINDS[self.kind]}',
                None,
                hint=_PLACE_HINTS[self.kind],
            )
        if self.kind == "face":
            if self.axis is not None:
                raise make_invalid_value_error(
                    'a port with kind = "face" cannot have the key `axis`', None, hint="delete axis"
                )
            return self
        turning = isinstance(self.axis, str) and self.axis.startswith("r")
        if self.kind != "rigid" and (self.axis is None or turning):
            raise make_invalid_value_error(
                "this port needs the key `axis`: x, y, z or three numbers",
                None,
                hint='add for example  axis = "z"',
            )
        if self.kind == "rigid" and isinstance(self.axis, tuple):
            raise make_invalid_value_error(
                "a rigid face moves along x, y, z, rx, ry or rz",
                None,
                hint='write for example  axis = "z"',
            )
        if isinstance(self.axis, tuple) and not any(self.axis):
            raise make_invalid_value_error(
                "axis is a zero vector", None, hint='write for example  axis = "z"'
            )
        return self

    @property
    def motions(self) -> tuple[str, ...]:
        """Names of the rigid-face motions that become ports."""
        return _MOTION_NAMES if self.axis is None else (str(self.axis),)

    @property
    def ports(self) -> tuple[Port, ...]:
        """Ports of the model that this entry of the key ``ports`` defines."""
        if self.kind != "rigid":
            return (Port(self.name, _DOMAINS_OF_KINDS[self.kind].port),)
        result = []
        for motion in self.motions:
            name = self.name if self.axis else f"{self.name}_{motion}"
            domain = ROTATION if motion.startswith("r") else TRANSLATION
            result.append(Port(name, domain.port))
        return tuple(result)

    @property
    def direction(self) -> np.ndarray:
        """Unit vector of the port's translation, an array of shape (3,)."""
        if isinstance(self.axis, str):
            return np.eye(3)["xyz".index(self.axis)]
        axis = np.asarray(self.axis, float)
        return np.asarray(axis / np.linalg.norm(axis))


class PolingKeys(Section):
    """Keys of a poling: its direction in cylindrical coordinates, or a CSV file.

    The CSV file contains poling vectors in the columns ``element, px, py, pz`` with the element
    numbers of a mesh file, or ``x, y, z, px, py, pz`` in the unit of the mesh. In a file with
    points, the point nearest to an element determines its poling.
    """

    direction: Vector | None = Field(
        None, description="Radial, circumferential and axial component of the poling direction"
    )
    axis: Vector = Field(
        (0.0, 0.0, 1.0),
        description=(
            "Direction of the axis of the cylindrical coordinates in which the key `direction` "
            "states the poling direction"
        ),
    )
    through: Point = Field(
        (0.0, 0.0, 0.0),
        description=(
            "Point on the axis of the cylindrical coordinates in which the key `direction` states "
            "the poling direction"
        ),
    )
    file: Annotated[str, StringConstraints(min_length=1, max_length=255)] | None = Field(
        None,
        description=(
            "CSV file in the scene's folder that lists poling directions, either for "
            "elements or for points of the body"
        ),
    )

    @property
    def contradiction(self) -> str:
        """Reason why the poling keys are contradictory; empty for a valid poling."""
        if (self.direction is None) == (self.file is None):
            return "it needs exactly one of the keys `direction` and `file`"
        if self.file and self.model_fields_set != {"file"}:
            return "axis and through cannot be combined with a CSV file"
        if self.direction and not (any(self.direction) and any(self.axis)):
            return "direction or axis is a zero vector"
        return ""

    @property
    def correction_hint(self) -> str:
        """Hint on how to correct invalid poling keys."""
        if self.direction is not None and self.file is not None:
            return "delete direction or file"
        if self.file:
            return "delete axis and through"
        return "write for example  direction = [0, 0, 1]"


class AxesKeys(Section):
    """Keys of a material's three axes, cartesian or cylindrical, for all its tensors.

    The key ``poling`` states only the third axis.
    """

    z: Vector = Field(
        (0.0, 0.0, 1.0),
        description=(
            "Direction of the third material axis; for cylindrical axes, direction of the "
            "cylinder axis"
        ),
    )
    x: Vector | None = Field(
        None,
        description=(
            "Direction of the first material axis, perpendicular to the key `z`; by default "
            "the x axis of the body"
        ),
    )
    origin: Point | None = Field(
        None,
        description=(
            "Point on the cylinder axis of cylindrical material axes; by default the origin "
            "of the body's coordinates"
        ),
    )
    kind: Literal["cartesian", "cylindrical"] = Field(
        "cartesian",
        description=(
            "Kind of the material axes: cartesian, or cylindrical (first axis radial, "
            "second circumferential, third axial)"
        ),
    )

    @model_validator(mode="after")
    def _require_valid_axes(self) -> AxesKeys:
        """Reject material axes that are incomplete, zero or not perpendicular."""
        if not any(self.z):
            raise make_invalid_value_error(
                "z has no length", None, hint="write for example  z = [0, 0, 1]"
            )
        if self.kind == "cylindrical":
            if self.x is not None:
                raise make_invalid_value_error(
                    "cylindrical axes cannot have the key `x`, because their first axis is radial",
                    None,
                    hint=DeleteKey("x"),
                )
            return self
        if self.origin is not None:
            raise make_invalid_value_error(
                'origin needs  kind = "cylindrical"', None, hint='write  kind = "cylindrical"'
            )
        first = np.asarray(self.x or (1.0, 0.0, 0.0))
        if not first.any():
            raise make_invalid_value_error(
                "x has no length", None, hint="write for example  x = [1, 0, 0]"
            )
        if abs(first @ self.z) > 1e-6 * np.linalg.norm(first) * np.linalg.norm(self.z):
            problem = "x and z are not perpendicular"
            raise make_invalid_value_error(
                problem if self.x else f"{problem}: state x beside z",
                None,
                hint="write for example  x = [1, 0, 0]  and  z = [0, 0, 1]",
            )
        return self

    @property
    def rotation(self) -> np.ndarray:
        """Rotation matrix (3, 3) whose columns are the material axes."""
        first, third = np.asarray(self.x or (1.0, 0.0, 0.0)), np.asarray(self.z)
        third = third / np.linalg.norm(third)
        first = first - third * (first @ third)
        first = first / np.linalg.norm(first)
        return np.stack([first, np.cross(third, first), third], axis=-1)

    def rotate_material(self, plain: Material) -> Material:
        """Return the material with its tensors rotated to the stated axes."""
        if self.kind == "cartesian":
            return plain.rotate(self.rotation)
        return replace(plain, local_axes=CylindricalAxes(self.z, self.origin or (0.0, 0.0, 0.0)))


class BodyKeys(MeshKeys):
    """Keys of a piezoelectric or elastic body from a mesh or CAD file.

    The return pin of all electrodes is the electrode ``cathode``, ``gnd`` or ``ground``, in this
    order of preference. If no electrode has one of these names, the last electrode is the return
    pin. Electrodes in the list ``floating`` are equipotential, and their charge is zero.
    """

    mesh: Annotated[MeshFile, MESH_FIELD]
    materials: dict[str, str | dict[str, Any]] = Field(
        examples=['{ GROUP = "steel" }  where GROUP is a group of the mesh'],
        min_length=1,
        description="Material of each mesh group: a name, or a table of constants",
    )
    poling: dict[str, Vector | Literal["radial", "tangential"] | PolingKeys] = Field(
        default_factory=dict,
        description=(
            "Poling direction (third material axis) of each mesh group: a vector (by default "
            'z), "radial" or "tangential" about z, or a table of poling keys'
        ),
    )
    axes: dict[str, AxesKeys] = Field(
        default_factory=dict,
        description=(
            "Material axes of each mesh group: a table with the vectors x and z, or for "
            "cylindrical axes with the vector z and the point `origin`"
        ),
    )
    fixed: tuple[str | SupportKeys, ...] = Field(
        (),
        description=(
            "Mesh groups whose nodes are clamped: names, or tables with a group and its "
            "clamped axes"
        ),
    )
    electrodes: dict[Name, str | tuple[str, ...]] = Field(
        default_factory=dict,
        description=(
            "Electrodes of the body: for each pin, a mesh group, or a list of mesh groups"
        ),
    )
    floating: tuple[str, ...] = Field(
        (), description="Floating electrodes: mesh groups of conductors that have no pin"
    )
    ports: tuple[PortKeys, ...] = ()
    damping: DampingKeys = DampingKeys()

    @property
    def reference_electrode(self) -> str:
        """Name of the electrode with zero voltage; empty without electrodes."""
        last = next(reversed(self.electrodes), "")
        return next((name for name in _REFERENCE_NAMES if name in self.electrodes), last)

    @property
    def poling_files(self) -> dict[str, str]:
        """Paths of the CSV files with poling vectors, keyed by mesh group."""
        result = {}
        for group, item in self.poling.items():
            if isinstance(item, PolingKeys) and item.file is not None:
                result[group] = item.file
        return result

    @property
    def all_ports(self) -> tuple[Port, ...]:
        """Ports of the model, electrical ports first."""
        result = []
        for name in self.electrodes:
            if name != self.reference_electrode:
                result.append(Port(name, ELECTRICAL.port, pins=(name, self.reference_electrode)))
        for item in self.ports:
            result += item.ports
        return tuple(result)

    @model_validator(mode="after")
    def _check_consistency(self, info: ValidationInfo) -> BodyKeys:
        """Reject contradictory keys, such as ``poling`` and ``axes`` of an element group."""
        stray = set(self.poling) - set(self.materials)
        if stray:
            raise make_invalid_value_error(
                f"poling contains groups without a material: {', '.join(sorted(stray))}",
                None,
                hint=f"add a material for {min(stray)}, or delete poling.{min(stray)}",
            )
        stray = set(self.axes) - set(self.materials)
        if stray:
            raise make_invalid_value_error(
                f"axes contains groups without a material: {', '.join(sorted(stray))}",
                None,
                hint=f"add a material for {min(stray)}, or delete axes.{min(stray)}",
            )
        both = set(self.axes) & set(self.poling)
        if both:
            raise make_invalid_value_error(
                f"poling and axes cannot apply to the same group: {', '.join(sorted(both))}",
                None,
                hint=f"delete poling.{min(both)}, because axes.{min(both)}.z is its direction",
            )
        for group, item in self.poling.items():
            if isinstance(item, PolingKeys) and item.contradiction:
                raise make_invalid_value_error(
                    f"poling of {group}: {item.contradiction}", None, hint=item.correction_hint
                )
        vectors = (item for item in self.poling.values() if isinstance(item, tuple))
        if not all(map(any, vectors)):
            raise make_invalid_value_error(
                "poling contains a zero vector", None, hint="write for example  [0, 0, 1]"
            )
        if len(self.electrodes) == 1:
            raise make_invalid_value_error(
                "the reference electrode is missing: a body needs at least two electrodes",
                None,
                hint='add for example  cathode = "GROUP"  to electrodes, with a group of faces',
            )
        if not self.electrodes and not self.ports:
            raise make_invalid_value_error(
                "a body needs electrodes or ports",
                "electrodes, each with a group of faces, or ports, each with a group or a point",
                hint=f"add for example  {_write_terminal_example(self, info)}",
            )
        if self.axisymmetric:
            _reject_axes_outside_section(self)
        names = Counter([*list_names(self.ports), *self.electrodes])
        twice = [name for name, count in names.items() if count > 1]
        if twice:
            raise make_invalid_value_error(
                f"several ports or electrodes have the same name: {', '.join(sorted(twice))}",
                None,
                hint=f"rename one of the ports or electrodes {twice[0]}",
            )
        return self


def _reject_axes_outside_section(keys: BodyKeys) -> None:
    """Reject directions of an axisymmetric body that its mesh does not contain.

    The accelerated support of an axisymmetric body moves only along the axis of revolution.
    """
    for number, port in enumerate(keys.ports):
        reject_point_outside_section(port.at, f"ports.{number}.at")
        if port.kind not in ("mean", "base"):
            continue
        radius, normal, _ = port.direction
        if normal or (radius and port.kind == "base"):
            raise make_invalid_value_error(
                "a port of an axisymmetric body cannot move along this axis",
                "z" if port.kind == "base" else "x (radius), z (height) or [radius, 0, height]",
                key=f"ports.{number}.axis",
                hint=HEIGHT_HINT.format(action='write  axis = "z"'),
            )
    for number, support in enumerate(keys.fixed):
        if not isinstance(support, SupportKeys) or set(support.axes) == set("xyz"):
            continue
        if "y" in support.axes:
            axes = support.axes.replace("z", "").replace("y", "z")
            raise make_invalid_value_error(
                "an axisymmetric body has no displacement along y",
                "x (radius), z (height), xz or xyz",
                key=f"fixed.{number}.axes",
                hint=HEIGHT_HINT.format(action=f'write  axes = "{axes}"'),
            )
    for group, vector in keys.poling.items():
        if isinstance(vector, tuple) and vector[1]:
            raise make_invalid_value_error(
                "the poling direction is not in the plane of the axisymmetric mesh",
                "[radius, 0, height]",
                key=f"poling.{group}",
                hint=HEIGHT_HINT.format(action="write for example  [0, 0, 1]"),
            )


def _write_terminal_example(keys: BodyKeys, info: ValidationInfo) -> str:
    """Return an example of the keys ``electrodes`` or ``ports`` for an error hint.

    The example has electrodes on a piezoelectric group of the mesh. Without such a group, the
    example has a port on a group of faces. Without any group of faces, the example has a port at a
    point.
    """
    place, clamped = "at = [0, 0, 0]", {item for item in keys.fixed if isinstance(item, str)}
    with suppress(UsageError):
        read = read_groups(keys, (info.context or {}).get("home", Path()), 0)
        faces = {k: g.members for k, g in read.groups.items() if g.codimension == 1 and k}
        active = [
            k for k, item in keys.materials.items() if find_material(item, k).is_piezoelectric
        ]
        cells = [read.groups[k].members for k in active if k in read.groups]
        if cells:
            touching = np.any(np.isin(read.mesh.f2t, np.concatenate(cells)), axis=0)
            plated = [k for k, members in faces.items() if np.all(np.take(touching, members))]
            if len(plated) > 1:
                return f'electrodes = {{ anode = "{plated[0]}", cathode = "{plated[1]}" }}'
        free = [name for name in faces if name not in clamped]
        place = f'group = "{free[0]}"' if free else place
    return f'ports = [{{ name = "tip", {place}, axis = "z" }}]'


def build_fe_model(
    keys: BodyKeys | Mapping[str, Any], home: Path, where: str = "body"
) -> FiniteElementModel:
    """Read the mesh with its groups, and assemble the full model of the body.

    The path of the mesh is relative to ``home``. The key ``refine`` divides the element size. The
    elements of a ``.msh`` file are split until each edge is at most 1/refine times its original
    length.

    Raises
    ------
    UsageError : a file cannot be read; a group is missing, empty, of the wrong dimension, or used
        twice; an element has no material; or an electrode is on a material that is not
        piezoelectric.
    """
    keys = validate_table(BodyKeys, keys, where)
    with name_part_in_errors(where):
        result = read_groups(keys, home, keys.split_count)
        solid = _make_solid(keys, result, _read_polings(keys, home, result))
        assembled = fe.make_damped_model(solid, _make_boundary_conditions(keys, result, solid))
    facts = dict(assembled.model.facts)
    sides = 1e3 * np.ptp(result.mesh.p, axis=1)
    if keys.axisymmetric:
        inner, outer = 1e3 * result.mesh.p[0].min(), 1e3 * result.mesh.p[0].max()
        if inner > 1e-9 * outer:  # otherwise, the body has no bore
            facts["extent_inner_radius_mm"] = float(inner)
        facts["extent_outer_radius_mm"] = float(outer)
        facts["extent_height_mm"] = float(sides[1])
    else:
        for axis, side in zip("xyz", sides, strict=True):
            facts[f"extent_{axis}_mm"] = float(side)
    return replace(assembled, model=assembled.model.copy_with(facts=facts))


def _read_polings(
    keys: BodyKeys, home: Path, groups: mesh_file.GroupedMesh
) -> dict[str, ElementAxes]:
    """Read the poling axes of the elements from CSV files, keyed by mesh group."""
    tables: dict[str, PolingTable] = {}
    for group, file in keys.poling_files.items():
        where = f"poling.{group}"
        tables[group] = read_poling(
            locate_file_in_folder(home, file, where), where, keys.axisymmetric
        )
    numbered = [group for group, table in tables.items() if table.numbers is not None]
    if numbered and keys.size is not None:
        raise wrong(
            f"poling.{numbered[0]}",
            "the poling file refers to element numbers, but a CAD file has no element numbers",
            hint="write a poling file with the columns x, y, z, px, py, pz",
        )
    numbers = groups.numbers
    if numbered and keys.split_count:
        file_mesh = read_groups(keys, home, 0)
        numbers = file_mesh.numbers[find_coarse_elements(file_mesh.mesh, groups.mesh)]
    result = {}
    unit = mesh_file.find_length_unit(locate_file_in_folder(home, keys.mesh, "mesh"), keys.unit)
    for group, table in tables.items():
        members = groups.get_group(group, f"materials.{group}", 0).members
        rows = table.select_rows(numbers, compute_centres(groups.mesh) / unit, members)
        rotations = np.tile(np.eye(3), (groups.mesh.nelements, 1, 1))
        rotations[members] = np.array([*map(compute_poling_rotation, table.directions)])[rows]
        result[group] = ElementAxes(rotations)
    return result


def _make_solid(
    keys: BodyKeys, groups: mesh_file.GroupedMesh, element_axes: Mapping[str, ElementAxes]
) -> Solid:
    """Return the meshed solid with the material of each mesh group."""
    owner = assign_materials(keys.materials, groups)
    materials = []
    for name, name_or_table in keys.materials.items():
        plain = find_material(name_or_table, f"materials.{name}")
        if name in element_axes:
            made_of = replace(plain, local_axes=element_axes[name])
        else:
            made_of = _orient_material(plain, keys, name)
        materials.append(replace(made_of, name=f"{name} ({made_of.name})"))
    return Solid(groups.mesh, tuple(materials), owner, keys.axisymmetric)


def _orient_material(plain: Material, keys: BodyKeys, group: str) -> Material:
    """Return the material of a group, rotated to the axes or poling of the group.

    In an axisymmetric body, a poling vector that is not parallel to the axis of revolution rotates
    with the angle around this axis.

    Raises
    ------
    UsageError : the mesh is axisymmetric, but cylindrical material axes have another axis of
        revolution.
    """
    if group in keys.axes:
        turned = keys.axes[group].rotate_material(plain)
        if isinstance(turned.local_axes, CylindricalAxes):
            _require_mesh_axis(keys, turned.local_axes, f"axes.{group}")
        return turned
    direction = keys.poling.get(group, (0.0, 0.0, 1.0))
    if isinstance(direction, str):
        direction = PolingKeys(direction=_CYLINDRICAL_VECTORS[direction])
    if isinstance(direction, PolingKeys) and direction.direction:
        about = CylindricalAxes(direction.axis, direction.through)
        _require_mesh_axis(keys, about, f"poling.{group}")
        return replace(plain.rotate_z_axis(direction.direction), local_axes=about)
    assert isinstance(direction, tuple)
    poled = plain.rotate_z_axis(direction)
    return (
        replace(poled, local_axes=CylindricalAxes())
        if keys.axisymmetric and any(direction[:2])
        else poled
    )


def _require_mesh_axis(keys: BodyKeys, about: CylindricalAxes, where: str) -> None:
    """Reject cylindrical axes that differ from the axis of an axisymmetric mesh."""
    if keys.axisymmetric and (any(about.axis[:2]) or any(about.point[:2])):
        raise wrong(
            where,
            "in an axisymmetric mesh, cylindrical axes must be about the z axis through the origin",
            hint="delete the keys `axis` and `through`"
            if where.startswith("poling")
            else "delete the keys `z` and `origin`",
        )


def _make_boundary_conditions(
    keys: BodyKeys, groups: mesh_file.GroupedMesh, solid: Solid
) -> fe.BoundaryConditions:
    """Return supports, electrodes, ports and added masses on the mesh ``solid``."""
    electrodes = {}
    for pin, stated in keys.electrodes.items():
        names = [stated] if isinstance(stated, str) else stated
        nodes = [
            _find_electrode_nodes(keys, solid, groups, name, f"electrodes.{pin}") for name in names
        ]
        electrodes[pin] = np.unique(np.concatenate(nodes))
    shapes, faces, base = [], [], []
    for port in keys.ports:
        if port.kind == "rigid":
            faces.append(_make_rigid_face(port, groups, solid))
        elif port.kind == "base":
            base.append((port.ports[0], port.direction))
        elif port.kind == "face":
            facets = find_boundary_facets(port, groups, solid)
            shapes.append(fe.make_pressure_load(port.ports[0], solid, facets))
        else:
            force = fe.spread_force(
                _distribute_unit_force(port, groups, solid), port.direction, solid
            )
            shapes.append(fe.PortLoad(port.ports[0], force))
    return fe.BoundaryConditions(
        fixed=_find_clamped_components(keys, groups, solid),
        electrodes=electrodes,
        reference=keys.reference_electrode,
        floating=[
            _find_electrode_nodes(keys, solid, groups, name, "floating") for name in keys.floating
        ],
        shapes=shapes,
        faces=faces,
        base=base,
        damping=keys.damping,
    )


def _make_rigid_face(port: PortKeys, groups: mesh_file.GroupedMesh, solid: Solid) -> fe.RigidFace:
    """Return a rigid face of the mesh, with a port for each of its free motions."""
    where = f"ports.{port.name}"
    if solid.axisymmetric:
        raise wrong(
            where,
            "an axisymmetric body cannot have rigid faces",
            got="rigid",
            expected="mean or base",
            hint='write  kind = "mean"',
        )
    nodes = _find_facet_nodes(solid, groups.get_group(str(port.group), where, 1).members)
    unit = dict(zip(_MOTION_NAMES, np.eye(6), strict=True))
    moves = map(unit.__getitem__, port.motions)
    return fe.RigidFace(nodes, [*zip(port.ports, moves, strict=True)])


def find_boundary_facets(port: PortKeys, groups: mesh_file.GroupedMesh, solid: Solid) -> np.ndarray:
    """Find the boundary facets of an acoustic port; reject facets inside the body.

    Raises
    ------
    UsageError : a face of the group is inside the body.
    """
    where = f"ports.{port.name}"
    facets = groups.get_group(str(port.group), where, 1).members
    inside = int((solid.mesh.f2t[1, facets] >= 0).sum())
    if inside:
        raise wrong(
            where,
            "a face that radiates sound must be on the surface of the body",
            got=f"{port.group}, with {inside} of {facets.size} faces between two elements",
            expected="a group of outer faces",
        )
    return facets


def _find_facet_nodes(solid: Solid, facets: np.ndarray) -> np.ndarray:
    """Return the numbers of all mesh nodes on the ``facets``."""
    return np.unique(solid.basis(1).get_dofs(facets).flatten())


def _find_electrode_nodes(
    keys: BodyKeys, solid: Solid, groups: mesh_file.GroupedMesh, name: str, where: str
) -> np.ndarray:
    """Return the nodes of an electrode, which must touch a piezoelectric material."""
    facets = groups.get_group(name, where, 1).members
    active = np.array([m.is_piezoelectric for m in solid.materials])[solid.owner]
    sides = solid.mesh.f2t[:, facets]
    if not (active[sides] & (sides >= 0)).any():
        made_of = {solid.materials[k].name for k in solid.owner[sides[sides >= 0]]}
        raise wrong(
            where,
            "this electrode is on a material that is not piezoelectric",
            got=f"{name} on {', '.join(sorted(made_of))}",
            expected="a face of a piezoelectric group",
            hint=advise_missing_ceramic_keys(
                {
                    f"materials.{group}": item
                    for group, item in keys.materials.items()
                    if isinstance(item, dict) and "permittivity" in item
                }
            )
            or 'give the group of this face a piezoelectric material, such as "PZT-5A"',
        )
    return _find_facet_nodes(solid, facets)


def _find_clamped_components(
    keys: BodyKeys, groups: mesh_file.GroupedMesh, solid: Solid
) -> np.ndarray:
    """Return which displacement components are fixed, as a flat boolean array."""
    d, nodes = solid.component_count, solid.node_positions.shape[1]
    fixed = np.zeros((nodes, d), bool)
    letters = "xyz" if d == 3 else "xz"
    for entry in keys.fixed:
        support = SupportKeys(group=entry) if isinstance(entry, str) else entry
        group = groups.get_group(support.group, "fixed")
        members = group.members
        if group.codimension == 0:
            members = solid.nodes(members)
        elif group.codimension == 1:
            members = _find_facet_nodes(solid, members)
        for axis in set(support.axes) & set(letters):
            fixed[members, letters.index(axis)] = True
    if solid.axisymmetric:
        on_axis = solid.node_positions[0] < 1e-9 * np.ptp(solid.mesh.p)
        fixed[on_axis, 0] = True
    return fixed.ravel()


def _distribute_unit_force(
    port: PortKeys, groups: mesh_file.GroupedMesh, solid: Solid
) -> np.ndarray:
    """Return the share of a port's unit force that acts on each mesh node."""
    shares = np.zeros(solid.node_positions.shape[1])
    if port.at is not None:
        point = np.array(port.at)[solid.axis_indices]
        shares[np.argmin(np.linalg.norm(solid.node_positions.T - point, axis=1))] = 1.0
        return shares
    group = groups.get_group(str(port.group), f"ports.{port.name}")
    if group.codimension == 0:
        return compute_node_shares(solid, elements=group.members)
    if group.codimension == 1:
        return compute_node_shares(solid, facets=group.members)
    shares[group.members] = group.shares
    return shares


class Body(MeshedBody[BodyKeys]):
    """Part type ``body``: reduced piezoelectric finite-element model of a user's mesh."""

    name = "body"
    title = "the user's own mesh (piezoelectric FE, reduced)"
    discretisations = ("refine",)
    schema = BodyKeys
    source = "FE (piezoelectric, the user's mesh)"
    ports_of_files = True
    optional_pins: ClassVar[Mapping[str, str]] = {
        "NAME of an electrode": "electrodes.NAME",
        "NAME of a port": "ports.NAME",
        **OPTIONAL_HEAT_PINS,
    }

    def ports(self, part: Part[BodyKeys], scene: DeclaredScene) -> tuple[Port, ...]:
        """Return the ports of the part's model."""
        result: tuple[Port, ...] = part.keys.all_ports
        return result

    def pin_directions(
        self, part: Part[BodyKeys], scene: DeclaredScene
    ) -> Mapping[str, tuple[float, ...]]:
        """Return the unit vector of each translational port, keyed by the pin of the port."""
        result: dict[str, tuple[float, ...]] = {}
        for keys in part.keys.ports:
            if keys.kind == "face":
                continue
            if keys.kind != "rigid":
                result[keys.name] = tuple(keys.direction.tolist())
                continue
            for port, motion in zip(keys.ports, keys.motions, strict=True):
                if not motion.startswith("r"):
                    axis = np.eye(3)["xyz".index(motion)]
                    result[port.terminals[0]] = tuple(axis.tolist())
        return result

    def files(self, part: Part[BodyKeys], scene: DeclaredScene) -> tuple[str, ...]:
        """Return the paths of the mesh file and of the CSV files with poling vectors."""
        _find_poling_paths(part, scene)
        mesh_path(part, scene)
        return (part.keys.mesh, *part.keys.poling_files.values())

    def problems(self, part: Part[BodyKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from super().problems(part, scene)
        try:
            _find_poling_paths(part, scene)
        except UsageError as error:
            yield error
        yield from find_mesh_problems(part, scene)
        with suppress(UsageError):  # another check reports an invalid material
            materials = [find_material(item, k) for k, item in part.keys.materials.items()]
            yield from check_q_factor(part.name, part.keys.damping, materials)

    def notes(self, part: Part[BodyKeys], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the mesh size, the assumptions of the model and the neglected effects."""
        sides = self.compute_side_lengths(part, scene)
        yield " x ".join(map("{:.4g}".format, np.multiply(1e3, sides))) + " mm"
        yield from super().notes(part, scene)

    def compute_side_lengths(self, part: Part[BodyKeys], scene: DeclaredScene) -> list[float]:
        """Return the side lengths [m] of the mesh's bounding box."""

        def measure_sides() -> list[float]:
            """Read the side lengths [m] of the bounding box from the mesh file."""
            with name_part_in_errors(part.name):
                path = mesh_path(part, scene)
                sides = mesh_file.find_length_unit(path, part.keys.unit) * mesh_file.measure_extent(
                    path
                )
            return list(map(float, sides))

        key = {"file": hash_file(mesh_path(part, scene)), "unit": part.keys.unit}
        return load_or_build("extent", key, measure_sides, sources=self.source_modules())

    def envelope(self, part: Part[BodyKeys], scene: DeclaredScene) -> Envelope:
        """Return the bounding box of the mesh, used to estimate effects of air."""
        sides = self.compute_side_lengths(part, scene)
        if part.keys.axisymmetric:
            sides = list(filter(None, sides)) or sides[:2]
        return estimate_surface_and_air_mass(sides)

    def dimensions(self, part: Part[BodyKeys]) -> int:
        """Return the number of spatial dimensions of the mesh."""
        return 2 if part.keys.axisymmetric else 3

    def describe_support(self, part: Part[BodyKeys]) -> str:
        """Describe how the body is supported, for the list of neglected effects."""
        groups = [item if isinstance(item, str) else item.group for item in part.keys.fixed]
        return f"ideal clamp at {', '.join(groups)}" if groups else "free body"

    def make_full_model_key(self, part: Part[BodyKeys], scene: GovernedScene) -> dict[str, Any]:
        """Return the cache key of the full model, with hashes of mesh and poling files."""
        result = {
            **super().make_full_model_key(part, scene),
            "file": hash_file(mesh_path(part, scene)),
        }
        for where, path in _find_poling_paths(part, scene).items():
            result[where] = hash_file(path)
        return result

    def figures(
        self, part: Part[BodyKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Figure | FileWriter]:
        """Yield the chart of the mesh, then the charts and files of all meshed bodies."""
        curve = load_or_build(
            "outline",
            self.make_full_model_key(part, build.scene),
            lambda: draw_edges("", self.get_fe_model(part, build.scene).solid.mesh),
            classes=(Curve,),
            sources=self.source_modules(),
        )
        panel = Panel("mm", "mm", (curve,), equal=True)
        caption = f"Edges of the mesh {part.keys.mesh}."
        yield Figure(f"{part.name}_mesh", f"Mesh of {part.name}", caption, (panel,))
        yield from super().figures(part, build, waves)

    def make_fe_model(self, part: Part[BodyKeys], scene: GovernedScene) -> FiniteElementModel:
        """Build the finite-element model on the mesh from the user's file."""
        return build_fe_model(part.keys, scene.get_folder(part), part.name)


def _find_poling_paths(part: Part[BodyKeys], scene: DeclaredScene) -> dict[str, Path]:
    """Return the paths of the poling files, keyed by scene keys ``PART.poling.GROUP``."""
    result = {}
    for group, file in part.keys.poling_files.items():
        where = f"{part.name}.poling.{group}"
        result[where] = locate_file_in_folder(scene.get_folder(part), file, where)
    return result


register_part_type(Body())
