"""Thermal constants of materials: conductivity, specific heat and density.

The file ``thermal_materials.toml`` contains the constants of the built-in materials and their
sources. If the file states no density for a material, the density of the mechanical material with
the same name applies.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field, model_validator

from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import UsageError, did_you_mean, list_candidates, wrong
from kc2spice.core.key_errors import validate_table
from kc2spice.core.quantities import Density, Section, make_invalid_value_error, si
from kc2spice.fem.materials import BASE_KEY_HINTS, find_material, make_unknown_base_error

Conductivity = Annotated[float, si("W/(m K)")]
SpecificHeat = Annotated[float, si("J/(kg K)")]


@dataclass(frozen=True, eq=False)
class ThermalMaterial(EqualByContent):
    """Thermal constants of one material.

    Attributes
    ----------
    name : name of the built-in material, or name of the mesh group.
    density : mass density [kg/m^3].
    specific_heat : specific heat at constant pressure [J/(kg K)].
    conductivity : (3,) thermal conductivities [W/(m K)] along x, y and z. In a body of revolution,
        x, y and z are the radial, hoop and axial directions.
    """

    name: str
    density: float
    specific_heat: float
    conductivity: np.ndarray

    @property
    def capacity(self) -> float:
        """Heat capacity per volume [J/(m^3 K)]."""
        return self.density * self.specific_heat


class ThermalMaterialTable(Section):
    """Table of thermal constants of a material, in a scene or in the library.

    A table with the key ``like`` may omit constants. The omitted constants are taken from the
    built-in material that ``like`` names.
    """

    unsupported_key_hints: ClassVar[Mapping[str, str]] = BASE_KEY_HINTS

    like: str | None = Field(
        None,
        description="Name of a built-in material that supplies every value missing in this table",
    )
    density: Density = Field(gt=0, description="Mass density of the material")
    specific_heat: SpecificHeat = Field(gt=0, description="Specific heat capacity of the material")
    conductivity: Conductivity | tuple[Conductivity, Conductivity, Conductivity] = Field(
        description=(
            "Thermal conductivity of the material: one value, or three values along x, y and z"
        )
    )
    resistance_coefficient: Annotated[float, si("1/K")] | None = Field(
        None,
        description=(
            "Temperature coefficient of the electrical resistance: relative change for each "
            "kelvin, referred to 20 degrees Celsius"
        ),
    )
    source: str = Field(
        "", description="Literature reference for all values of this material table"
    )

    @model_validator(mode="before")
    @classmethod
    def _inherit_constants(cls, data: Any) -> Any:
        """Add missing constants from the built-in material that the key ``like`` names."""
        if not isinstance(data, Mapping) or not isinstance(data.get("like"), str):
            return data
        name = list_thermal_names().get(data["like"].lower())
        if name is None:
            raise make_unknown_base_error(data["like"], list(load_thermal_library()))
        return dict(load_thermal_library()[name]) | dict(data)

    @model_validator(mode="after")
    def _require_positive_conductivity(self) -> ThermalMaterialTable:
        """Reject a thermal conductivity that is not positive."""
        if np.min(self.conductivity) <= 0:
            raise make_invalid_value_error(
                "conductivity must be greater than 0",
                None,
                hint='write for example  conductivity = "15 W/(m K)"',
            )
        return self

    def build_material(self, name: str) -> ThermalMaterial:
        """Build the thermal material from the constants of the table."""
        conductivity = np.broadcast_to(np.asarray(self.conductivity, float), 3).copy()
        return ThermalMaterial(name, self.density, self.specific_heat, conductivity)


@cache
def _load_tables() -> Mapping[str, dict[str, Any]]:
    """Return the material tables of the library file, keyed by name.

    Some of these tables contain no density.
    """
    path = Path(__file__).parent / "thermal_materials.toml"
    return tomllib.loads(path.read_text("utf-8"))


@cache
def load_thermal_library() -> Mapping[str, Mapping[str, Any]]:
    """Return the material tables of the library, including densities, keyed by name."""
    result = {}
    for name, table in _load_tables().items():
        density = {} if "density" in table else {"density": find_material(name).density}
        result[name] = density | table
    return result


@cache
def list_thermal_names() -> Mapping[str, str]:
    """Return the names of the built-in materials, keyed by the name in lower case."""
    return {name.lower(): name for name in _load_tables()}


def find_thermal_material(
    name_or_table: str | Mapping[str, Any], where: str = "material"
) -> ThermalMaterial:
    """Return the built-in material with a name, or build the material of a table.

    Names of built-in materials may be written in upper or lower case.

    Raises
    ------
    UsageError : the name does not exist, or the table does not describe a material.

    Examples
    --------
    >>> copper = find_thermal_material("copper")
    >>> print(copper.conductivity[0], round(copper.capacity))
    401.0 3439205
    """
    if isinstance(name_or_table, Mapping):
        return validate_table(ThermalMaterialTable, name_or_table, where).build_material(
            where.rpartition(".")[2]
        )
    name = list_thermal_names().get(name_or_table.lower())
    if name is None:
        raise _make_unknown_material_error(name_or_table, where)
    return ThermalMaterialTable.model_validate(load_thermal_library()[name]).build_material(name)


def find_resistance_coefficient(name: str) -> float:
    """Return the temperature coefficient [1/K] of a metal's electrical resistance.

    Raises
    ------
    UsageError : the library contains no metal ``name`` with a temperature coefficient.

    Examples
    --------
    >>> find_resistance_coefficient("copper")
    0.00393
    """
    table = _load_tables().get(list_thermal_names().get(name.lower(), ""), {})
    if "resistance_coefficient" not in table:
        raise _make_unknown_material_error(name, "material of a conductor")
    return float(table["resistance_coefficient"])


def _make_unknown_material_error(name: str, where: str) -> UsageError:
    """Return the error for a material that the thermal library does not contain."""
    names = list(_load_tables())
    hint = did_you_mean(name, names)
    hint = hint or 'write a table: { density = …, conductivity = "… W/(m K)", specific_heat = … }'
    return wrong(
        where,
        "this material does not exist, or has no thermal constants",
        got=repr(name),
        expected=f"one of {list_candidates(name, names, 'docs/reference/thermal_materials.md')}",
        hint=hint,
    )
