"""Keys of the part ``heat_body``."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field, model_validator

from kc2spice.core.domains import THERMAL
from kc2spice.core.key_actions import DeleteKey
from kc2spice.core.quantities import Length, Section, make_invalid_value_error, si
from kc2spice.parts.bodies._mesh_keys import (
    MeshKeys,
    Name,
    Point,
    reject_point_outside_section,
)
from kc2spice.rom.linear_model import Port

Area = Annotated[float, si("m2")]
FilmCoefficient = Annotated[float, si("W/(m2 K)")]
InterfaceResistance = Annotated[float, si("m2 K/W")]


class FilmKeys(Section):
    """Keys of a film, which transfers heat between faces and a fluid.

    The heat flow is proportional to the temperature difference.
    """

    group: str = Field(
        examples=['"top"'],
        description=(
            "Group of faces that transfer heat to the fluid; in a body of layers, the group "
            "top or bottom"
        ),
    )
    coefficient: FilmCoefficient = Field(
        ge=0,
        description=(
            "Heat transfer coefficient between faces and fluid; becomes a parameter of "
            "the netlist if rom.parameters contains a range for this key"
        ),
    )
    pin: Name | None = Field(
        None,
        description=(
            "Pin whose voltage represents the temperature of the fluid; by default `ambient`"
        ),
    )

    @model_validator(mode="after")
    def _require_film_coefficient(self) -> FilmKeys:
        """Require a positive heat transfer coefficient of a film whose fluid has a pin."""
        if self.pin is not None and not self.coefficient:
            raise make_invalid_value_error(
                "a film with a pin needs a coefficient greater than 0",
                None,
                hint='write for example  coefficient = "10 W/(m2 K)"',
            )
        return self


class InterfaceKeys(Section):
    """Keys of the thermal resistance of a joint between two materials."""

    between: tuple[str, str] = Field(
        examples=['["case", "chip"]'],
        description=(
            "Two mesh groups, one on each side of the joint, named as in the key `materials`"
        ),
    )
    resistance: InterfaceResistance = Field(
        gt=0,
        description=(
            "Thermal resistance of the joint between two groups, multiplied by the area of "
            "the joint"
        ),
    )


class LayerKeys(Section):
    """Keys of a layer of a heat-conducting stack, whose axis is the heat path."""

    material: str | dict[str, Any] = Field(
        examples=['"steel"'],
        description="Material of the layer: a name, or a table of thermal constants",
    )
    thickness: Length = Field(
        gt=0, description="Thickness of the layer in the direction of the heat flow"
    )
    area: Area = Field(
        gt=0, description="Cross-sectional area of the layer, through which the heat flows"
    )
    resistance: InterfaceResistance | None = Field(
        None,
        gt=0,
        description=(
            "Thermal resistance of the joint below the layer, multiplied by the area of the "
            "joint; by default 0"
        ),
    )


class HeatSourceKeys(Section):
    """Keys of a heat source: a place where heat enters the body through a pin.

    The voltage of the pin represents the mean temperature of the mesh group or point that the
    source heats.
    """

    group: str | None = Field(
        None,
        description=(
            "Mesh group of elements or faces over which the heat of the source is "
            "distributed evenly"
        ),
    )
    at: Point | None = Field(
        None,
        description=(
            "Coordinates of a point; the heat of the source enters the body at the mesh node "
            "nearest to this point"
        ),
    )

    @model_validator(mode="after")
    def _require_place(self) -> HeatSourceKeys:
        """Require exactly one of the keys ``group`` and ``at`` for a heat source."""
        if (self.group is None) == (self.at is None):
            raise make_invalid_value_error(
                "this entry needs either the key `group` or the key `at`",
                None,
                hint='add for example  group = "top"' if self.group is None else DeleteKey("at"),
            )
        return self


class HeatBodyKeys(MeshKeys):
    """Keys of a heat-conducting body from a mesh, a CAD file, or a list of layers.

    The list of layers begins at the top. A layered body has the groups ``top`` and ``bottom``
    (faces), and ``layer1``, ``layer2``, … (volumes of the layers).
    """

    layers: tuple[LayerKeys, ...] = Field(
        (),
        max_length=50,
        description=(
            "Layers of the heat-conducting body from top to bottom; can be stated instead of a mesh"
        ),
    )
    sources: dict[Name, str | HeatSourceKeys] = Field(
        default_factory=dict,
        description=(
            "Heat sources of the body: for each pin, a mesh group, or a table with a group "
            "or a point"
        ),
    )
    isothermal: dict[Name, str | tuple[str, ...]] = Field(
        default_factory=dict,
        description=(
            "Faces of uniform temperature: for each pin, a mesh group of faces, or a list of groups"
        ),
    )
    fixed: tuple[str, ...] = Field(
        (), description="Mesh groups of faces that are kept at the ambient temperature"
    )
    films: tuple[FilmKeys, ...] = Field(
        (), description="Heat transfer from faces to a fluid: one table for each group of faces"
    )
    interfaces: tuple[InterfaceKeys, ...] = Field(
        (),
        description=(
            "Joints with a thermal resistance between two mesh groups: one table for each joint"
        ),
    )

    @property
    def all_ports(self) -> tuple[Port, ...]:
        """Thermal ports of the body, in the order of its model."""
        names = [*self.isothermal, *self.sources, *self.film_pins]
        return tuple(Port(name, THERMAL.port) for name in names)

    @property
    def film_pins(self) -> Iterator[str]:
        """Names of the film pins: temperatures of fluids that exchange heat with faces."""
        return (film.pin for film in self.films if film.pin is not None)

    @property
    def has_path_to_surroundings(self) -> bool:
        """Whether a fixed face or a film connects the body to its surroundings."""
        films = (film for film in self.films if film.coefficient)
        return bool(self.fixed) or None in {film.pin for film in films}

    @model_validator(mode="after")
    def _require_consistent_keys(self) -> HeatBodyKeys:
        """Reject contradictory keys of a heat body."""
        if bool(self.layers) == bool(self.mesh):
            raise make_invalid_value_error(
                "a heat_body needs either the key `mesh` or the key `layers`",
                None,
                hint=DeleteKey("mesh") if self.mesh else 'add for example  mesh = "case.msh"',
            )
        if self.layers and (self.materials or self.interfaces or self.axisymmetric or self.groups):
            raise make_invalid_value_error(
                "layers cannot be combined with the keys `materials`, `interfaces`, `axisymmetric` "
                "or `groups`",
                None,
                hint="delete the keys `materials`, `interfaces`, `axisymmetric` and `groups`",
            )
        if self.mesh and not self.materials:
            raise make_invalid_value_error(
                "the key `mesh` needs the key `materials`",
                None,
                hint='add for example  materials = { GROUP = "copper" }  with a group of the mesh',
            )
        for pin, source in self.sources.items():
            if self.axisymmetric and isinstance(source, HeatSourceKeys):
                reject_point_outside_section(source.at, f"sources.{pin}.at")
        stray = {name for item in self.interfaces for name in item.between} - set(self.materials)
        if stray:
            raise make_invalid_value_error(
                f"interfaces contains groups without a material: {', '.join(sorted(stray))}",
                None,
                hint=f'add a material for {min(stray)}, such as  materials.{min(stray)} = "copper"',
            )
        names = Counter(port.name for port in self.all_ports)
        twice = [name for name, count in names.items() if count > 1]
        if twice:
            raise make_invalid_value_error(
                f"several pins have the same name: {', '.join(sorted(twice))}",
                None,
                hint=f"rename one of the pins {twice[0]}",
            )
        if THERMAL.reference in names:
            raise make_invalid_value_error(
                f"{THERMAL.reference} is a reserved name: the pin of the surroundings",
                None,
                hint="rename this pin, for example to outside",
            )
        if not names:
            raise make_invalid_value_error(
                "a heat_body needs a source, an isothermal face or a film with a pin",
                None,
                hint='add for example  sources = { chip = "top" }',
            )
        if not (self.has_path_to_surroundings or self.isothermal or [*self.film_pins]):
            raise make_invalid_value_error(
                "heat cannot leave the body: add the key `fixed`, `films` or `isothermal`",
                None,
                hint='add for example  fixed = ["bottom"]',
            )
        return self
