"""Piezoelectric and elastic materials from the built-in library or a scene.

Interface::

    pzt = find_material("PZT-5A")            # Material from the library
    find_material({"density": 8530, "youngs_modulus": "100 GPa", "poisson_ratio": 0.35})
    find_material({"like": "PZT-5A", "quality": 90})
    pzt.rotate_z_axis((0, 0, -1))            # material poled along -z of the body
    pzt.C, pzt.e, pzt.eps_S                  # (6, 6) Pa, (3, 6) C/m^2, (3, 3) F/m

The tensor components are in Voigt order xx yy zz yz xz xy, with engineering shear strains. Every
:class:`Material` has constants in the stress-charge form of IEEE Std 176-1987: stiffness at
constant electric field, and permittivity at constant strain. The stress T and the electric
displacement D depend on the strain S and the electric field E:

    T = C S - e' E,   D = e S + eps_S E.

A table in strain-charge form contains the compliance s, the coupling d and the permittivity eps_T
at constant stress. The stress-charge form follows from the strain-charge form by

    C = s^-1,   e = d C,   eps_S = eps_T - e C^-1 e'.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from itertools import chain
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, TypeAlias

import numpy as np
from pydantic import BeforeValidator, Field, model_validator
from pydantic_core import PydanticCustomError

from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import (
    UsageError,
    did_you_mean,
    list_candidates,
    name_part_in_errors,
    wrong,
)
from kc2spice.core.key_actions import DeleteKey
from kc2spice.core.key_errors import validate_table
from kc2spice.core.quantities import (
    EPSILON_0,
    Density,
    Pressure,
    QFactor,
    Ratio,
    Section,
    convert_quantity,
    make_invalid_value_error,
    si,
)
from kc2spice.fem.material_limits import (
    reject_excessive_coupling,
    reject_implausible_coupling,
    reject_implausible_permittivity,
    reject_implausible_stiffness,
    reject_mixed_elastic_units,
)

TENSOR_ROUNDING = 1e-12  # largest rounding error of a tensor, relative to its largest component

# Symmetry classes in _FREE_COMPONENTS, keyed by the point groups with the same free components.
# Data sheets state a point group, such as "32" for quartz and "6mm" for poled ceramics.
# The point group 3m is not in this table, because its piezoelectric components differ from point
# group 32.
_POINT_GROUPS = {
    "6mm": "hexagonal", "∞m": "hexagonal", "∞mm": "hexagonal", "inf m": "hexagonal",
    "32": "trigonal", "mm2": "orthotropic", "mmm": "orthotropic", "m3m": "cubic", "-43m": "cubic",
    "43m": "cubic",
}  # fmt: skip
Symmetry: TypeAlias = Annotated[
    Literal["isotropic", "cubic", "hexagonal", "trigonal", "orthotropic"],
    BeforeValidator(lambda name: _POINT_GROUPS.get(name, name) if isinstance(name, str) else name),
]

# Free components of stiffness and coupling in each symmetry class.
# The text "14=-24=56" means that component 56 equals component 14, and that component 24 is the
# negative of component 14.
_FREE_COMPONENTS = {
    "cubic": ("11=22=33 12=13=23 44=55=66", "14=25=36"),
    "hexagonal": ("11=22 12 13=23 33 44=55 66", "31=32 33 15=24"),
    "trigonal": ("11=22 12 13=23 14=-24=56 33 44=55 66", "11=-12=-26 14=-25"),
    "orthotropic": ("11 12 13 22 23 33 44 55 66", "31 32 33 15 24"),
}
_SYMMETRIES_WITH_DERIVED_66 = ("hexagonal", "trigonal")  # c66 = (c11 - c12)/2, s66 = 2 (s11 - s12)
# Alternative forms of the elasticity and of the coupling. Each form consists of one or more keys.
# A table that contains a key of one form inherits no keys of the alternative forms.
_ALTERNATIVE_KEYS = (
    (("youngs_modulus", "poisson_ratio", "shear_modulus"), ("stiffness",), ("compliance",)),
    (("stress_coupling",), ("strain_coupling",)),
)


@dataclass(frozen=True)
class CylindricalAxes:
    """Cylindrical axes (radial, hoop, axial) about an axis through a point.

    The coordinates of ``point`` are in metres.
    """

    axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def compute_rotations(self, places: np.ndarray, elements: np.ndarray) -> np.ndarray:
        """Return the rotation matrices to the cylindrical axes at several points.

        The matrices have the shape (n, 3, 3), and ``places`` has the shape (n, 3). The columns of
        each matrix are the radial, hoop and axial unit vectors.
        """
        axial = np.asarray(self.axis, float) / np.linalg.norm(self.axis)
        arm = places - np.asarray(self.point)
        arm = arm - np.outer(arm @ axial, axial)
        size = np.linalg.norm(arm, axis=1, keepdims=True)
        # for points on the axis, any direction perpendicular to the axis counts as radial
        other = np.cross(axial, np.eye(3)[np.abs(axial).argmin()])
        radial = np.where(size > 0, arm, other / np.linalg.norm(other))
        radial = radial / np.where(size > 0, size, 1.0)
        hoop = np.cross(axial, radial)
        return np.stack([radial, hoop, np.broadcast_to(axial, radial.shape)], axis=-1)


@dataclass(frozen=True, eq=False)
class ElementAxes(EqualByContent):
    """Material axes of each element of a mesh.

    For each element, the columns of a matrix in ``rotations`` (elements, 3, 3) are the material
    axes.
    """

    rotations: np.ndarray

    def compute_rotations(self, places: np.ndarray, elements: np.ndarray) -> np.ndarray:
        """Return the rotation matrices to the material axes of n elements.

        The returned array has the shape (n, 3, 3).
        """
        return np.asarray(self.rotations[elements])


@dataclass(frozen=True, eq=False, repr=False)
class Material(EqualByContent):
    """Linear elastic or piezoelectric material in stress-charge form.

    All tensors are in the axes of the body, or in ``local_axes``.

    Attributes
    ----------
    name : name in the library, or the name that the user chose.
    density : mass density [kg/m^3].
    C : (6, 6) stiffness at constant electric field [Pa], in Voigt order xx yy zz yz xz xy.
    e : (3, 6) piezoelectric stress coefficients [C/m^2], zero for materials without
        piezoelectricity.
    eps_S : (3, 3) permittivity at constant strain [F/m], by default the permittivity of vacuum.
    conductor : whether the electric field is zero in the material; faces between the material and
        insulators are then electrodes.
    quality, loss_tangent : mechanical Q factor and dielectric loss tangent, None if unknown.
    tensile_strength : largest principal stress [Pa] that the material withstands, None if unknown.
    depoling_field, breakdown_field : largest permitted electric field [V/m] opposite to the poling,
        and in any direction; None if unknown.
    residual_stress : (3,) normal stresses [Pa] along x, y and z in the body at rest. The residual
        stresses are in equilibrium with the forces of the supports.
    axis : (3,) unit vector along the z axis of the material, in the axes of the body. In ceramics,
        z is the direction of poling.
    dielectric : whether the model includes the electric field in the material, even without
        piezoelectricity.
    local_axes : material axes that depend on the position, for example radial, hoop and axial
        directions; None for the axes of the body.
    """

    name: str
    density: float
    C: np.ndarray
    e: np.ndarray
    eps_S: np.ndarray
    conductor: bool = False
    quality: float | None = None
    loss_tangent: float | None = None
    tensile_strength: float | None = None
    depoling_field: float | None = None
    breakdown_field: float | None = None
    axis: np.ndarray = field(default_factory=lambda: np.array([0.0, 0.0, 1.0]))
    dielectric: bool = False
    residual_stress: tuple[float, float, float] = (0.0, 0.0, 0.0)
    local_axes: CylindricalAxes | ElementAxes | None = None

    def __repr__(self) -> str:
        kind = "piezoelectric" if self.is_piezoelectric else "elastic"
        return f"Material({self.name!r}, {kind}, {self.density:g} kg/m3)"

    @property
    def is_piezoelectric(self) -> bool:
        """Whether stress and electric field are coupled."""
        return bool(np.any(self.e))

    @property
    def slowest_wave_speed(self) -> float:
        """Lower limit [m/s] of the speeds of all waves in the material.

        The limit is ``sqrt(c / rho)``, where c is the smallest eigenvalue of the stiffness matrix,
        and rho is the density. For an isotropic material, the limit is the speed of shear waves.
        """
        return float(np.sqrt(np.linalg.eigvalsh(self.C)[0] / self.density))

    @property
    def is_isotropic_about_z(self) -> bool:
        """Whether the material is isotropic about z.

        A material counts as isotropic if rotations by 30 and 45 degrees about z change each tensor
        by at most 2 % of its largest component.
        """
        for angle in (np.pi / 6, np.pi / 4):
            c, s = np.cos(angle), np.sin(angle)
            rotated = self.rotate(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1.0]]))
            for name in ("C", "e", "eps_S"):
                tensor = getattr(self, name)
                limit = 0.02 * np.abs(tensor).max()
                if not np.allclose(tensor, getattr(rotated, name), rtol=0, atol=limit):
                    return False
        return True

    @property
    def has_out_of_plane_coupling(self) -> bool:
        """Whether motion in the x-z plane causes motion or polarisation out of this plane.

        Coupling out of the plane exists if reflection in the x-z plane changes the sign of a
        nonzero tensor component.
        """
        out, within, C, e = [3, 5], [0, 1, 2, 4], np.abs(self.C), np.abs(self.e)
        elastic = C[np.ix_(out, within)].max() > TENSOR_ROUNDING * C.max()
        return bool(elastic or e[np.ix_([0, 2], out)].max() > TENSOR_ROUNDING * e.max())

    def compute_tensors(
        self, places: np.ndarray, elements: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Compute stiffness, coupling and permittivity at n places.

        The returned tensors are in the axes of the body. The stiffness has the shape (n, 6, 6), the
        coupling (n, 3, 6), and the permittivity (n, 3, 3). Point i of ``places`` (n, 3) [m] lies in
        the element with the number ``elements[i]``. Without :attr:`local_axes`, the tensors are the
        same everywhere, and n = 1.
        """
        if self.local_axes is None:
            return self.C[None], self.e[None], self.eps_S[None]
        R = self.local_axes.compute_rotations(places, elements)
        M, back = compute_bond_matrix(R), R.transpose(0, 2, 1)
        turned = M.transpose(0, 2, 1)
        return M @ self.C @ turned, R @ self.e @ turned, R @ self.eps_S @ back

    @property
    def eps_T(self) -> np.ndarray:
        """Permittivity (3, 3) at constant stress [F/m]."""
        return self.eps_S + self.e @ np.linalg.solve(self.C, self.e.T)

    @property
    def indentation_modulus(self) -> float:
        """Indentation modulus [Pa] of a half-space along z, for zero electric field.

        The material must be isotropic about z. For a fully isotropic material with Young's modulus
        E and Poisson's ratio nu, the indentation modulus is E / (1 - nu^2). Source: Delafargue and
        Ulm, Int. J. Solids Structures 41 (2004), eq. 13.
        """
        c11, c13, c33, c44 = self.C[0, 0], self.C[0, 2], self.C[2, 2], self.C[3, 3]
        mean = np.sqrt(c11 * c33)
        slender = (mean**2 - c13**2) / c11
        return float(2 * np.sqrt(slender / (1 / c44 + 2 / (mean + c13))))

    @property
    def d(self) -> np.ndarray:
        """Piezoelectric strain coefficients (3, 6) [C/N] = [m/V]."""
        return np.linalg.solve(self.C, self.e.T).T

    def rotate(self, R: np.ndarray) -> Material:
        """Return the material rotated by ``R`` (3, 3).

        After the rotation, axis i of the material points along ``R[:, i]``. With Bond's matrix M(R)
        for stress, the rotated tensors are ``M C M'``, ``R e M'`` and ``R eps R'`` (B. A. Auld,
        Acoustic Fields and Waves in Solids, 1973, section 3.D).
        """
        M = compute_bond_matrix(R)
        return replace(
            self,
            C=M @ self.C @ M.T,
            e=R @ self.e @ M.T,
            eps_S=R @ self.eps_S @ R.T,
            axis=R @ self.axis,
        )

    def rotate_z_axis(self, direction: Sequence[float]) -> Material:
        """Return the material with its z axis rotated to another direction.

        In ceramics, z is the direction of poling. The material is rotated by the smallest possible
        angle. If the direction is -z, the material is rotated by 180 degrees about x.
        """
        return self.rotate(compute_poling_rotation(direction))


def compute_poling_rotation(direction: Sequence[float] | np.ndarray) -> np.ndarray:
    """Compute the rotation matrix from z to a direction by the smallest angle.

    The matrix has the shape (3, 3). If the direction is -z, the rotation is 180 degrees about x.
    """
    n = np.asarray(direction, float) / np.linalg.norm(direction)
    if n[2] < -1 + 1e-14:
        return np.diag([1.0, -1.0, -1.0])
    K = np.array([[0, 0, n[0]], [0, 0, n[1]], [-n[0], -n[1], 0.0]])  # Rodrigues' formula
    return np.asarray(np.eye(3) + K + K @ K / (1 + n[2]))


_VOIGT_PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))


def compute_bond_matrix(R: np.ndarray) -> np.ndarray:
    """Return Bond matrices, which rotate Voigt stresses, for rotation matrices R.

    M has the shape (…, 6, 6), and R has the shape (…, 3, 3). The matrix M rotates the Voigt vector
    of a stress. Column J of M is the Voigt vector of ``R T_J R'``, where T_J is the symmetric
    tensor whose Voigt vector is the unit vector J.
    """
    M = np.empty((*R.shape[:-2], 6, 6))
    for J, (k, l) in enumerate(_VOIGT_PAIRS):
        unit = np.zeros((3, 3))
        unit[k, l] = unit[l, k] = 1.0
        turned = R @ unit @ np.swapaxes(R, -1, -2)
        for row, (i, j) in enumerate(_VOIGT_PAIRS):
            M[..., row, J] = turned[..., i, j]
    return M


def _make_component_validator(unit: str) -> BeforeValidator:
    """Return a validator for a tensor of named components or nested lists.

    The validator converts each component to a number in ``unit``.
    """
    return BeforeValidator(partial(_convert_to_unit, unit))


def _convert_to_unit(unit: str, value: object) -> object:
    """Convert all quantities in a nested mapping or list to numbers in one unit."""
    if isinstance(value, Mapping):
        return {str(key): _convert_to_unit(unit, item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return list(map(partial(_convert_to_unit, unit), value))
    try:
        return convert_quantity(value, unit)
    except UsageError as error:
        raise make_invalid_value_error(
            error.message, error.expected, hint=error.next_action
        ) from None


_Tensor: TypeAlias = dict[str, float] | list[list[float]]
_Modulus: TypeAlias = float | list[float]


_ELASTIC_KEYS = ("youngs_modulus", "stiffness", "compliance")


# hints for keys that users and other programs write in place of the key ``like`` of a material
BASE_KEY_HINTS = {
    word: f"write `like` in place of `{word}`"
    for word in ("base", "from", "material", "name", "parent", "inherits", "copy", "based_on")
}


def make_unknown_base_error(name: str, known: Sequence[str]) -> PydanticCustomError:
    """Make the error for a key ``like`` that names an unknown material."""
    expected = f"one of {list_candidates(name, known, 'docs/reference/materials.md')}"
    hint = did_you_mean(name, known) or f'write for example  like = "{known[0]}"'
    return make_invalid_value_error("this material does not exist", expected, "like", hint)


class MaterialTable(Section):
    """Table of constants of a material, in a scene or in the library.

    :meth:`build_material` makes the tensors from the constants. The elasticity is stated in one of
    these forms: * ``youngs_modulus`` and ``poisson_ratio`` for an isotropic material. For an
    orthotropic material, ``youngs_modulus`` contains three values, ``poisson_ratio`` contains
    ``nu_xy``, ``nu_yz`` and ``nu_xz``, and ``shear_modulus`` is also stated.
    * ``stiffness``: components such as ``c11`` with a ``symmetry``, or a 6 by 6 list.
    * ``compliance``: components such as ``s11`` with a ``symmetry``, or a 6 by 6 list.

    Either ``stress_coupling`` (such as ``e31``) or ``strain_coupling`` (such as ``d31``) contains
    the piezoelectric constants, as named components or as a 3 by 6 list. The relative
    ``permittivity`` has the components ``eps11``, ``eps22`` and ``eps33``, or is a 3 by 3 list. In
    the table of a piezoelectric material, the key ``permittivity_at`` must state whether the
    permittivity was measured at constant ``stress`` or ``strain``. A table with the key ``like``
    may omit constants. The omitted constants are taken from the built-in material that ``like``
    names.
    """

    unsupported_key_hints: ClassVar[Mapping[str, str]] = BASE_KEY_HINTS

    like: str | None = Field(
        None,
        description="Name of a built-in material that supplies every value missing in this table",
    )
    density: Density = Field(gt=0, description="Mass density of the material")
    symmetry: Symmetry | None = Field(
        None, description="Crystal symmetry of the material, or its point group such as 6mm or 32"
    )
    youngs_modulus: Annotated[_Modulus, _make_component_validator("Pa")] | None = Field(
        None,
        description=(
            "Young's modulus of the material: one value, or three values along x, y and z"
        ),
    )
    poisson_ratio: Annotated[float | dict[str, float], _make_component_validator("")] | None = (
        Field(
            None,
            description=(
                "Poisson's ratio of the material: one value, or the three ratios nu_xy, nu_yz "
                "and nu_xz"
            ),
        )
    )
    shear_modulus: Annotated[dict[str, float], _make_component_validator("Pa")] | None = Field(
        None,
        description=(
            "Shear moduli g_yz, g_xz and g_xy of an orthotropic material, required if three "
            "Young's moduli are stated"
        ),
    )
    stiffness: Annotated[_Tensor, _make_component_validator("Pa")] | None = Field(
        None, description="Elastic stiffness components c11, c12, … at constant electric field"
    )
    compliance: Annotated[_Tensor, _make_component_validator("1/Pa")] | None = Field(
        None, description="Elastic compliance components s11, s12, … at constant electric field"
    )
    stress_coupling: Annotated[_Tensor, _make_component_validator("C/m2")] | None = Field(
        None,
        description="Piezoelectric stress coefficients e31, e33, … (stress per electric field)",
    )
    strain_coupling: Annotated[_Tensor, _make_component_validator("C/N")] | None = Field(
        None,
        description="Piezoelectric strain coefficients d31, d33, … (strain per electric field)",
    )
    permittivity: Annotated[_Tensor, _make_component_validator("")] | None = Field(
        None, description="Relative permittivity components eps11, eps22 and eps33"
    )
    permittivity_at: Literal["stress", "strain"] | None = Field(
        None,
        description=(
            "Quantity that was constant while the permittivity was measured: stress, as in "
            "most data sheets, or strain"
        ),
    )
    conductor: bool = Field(
        False,
        description=(
            "Whether the material is an electrical conductor, so that its faces can be electrodes"
        ),
    )
    quality: QFactor | None = Field(
        None,
        gt=0,
        description="Mechanical Q factor of the material, used if damping.per_material is true",
    )
    loss_tangent: Ratio | None = Field(
        None,
        ge=0,
        description=(
            "Dielectric loss tangent of the material, used if damping.per_material is true"
        ),
    )
    tensile_strength: Pressure | None = Field(
        None, gt=0, description="Largest principal stress that the material withstands"
    )
    depoling_field: Annotated[float, si("V/m")] | None = Field(
        None,
        gt=0,
        description=(
            "Largest electric field that the material withstands in the direction opposite "
            "to its poling"
        ),
    )
    breakdown_field: Annotated[float, si("V/m")] | None = Field(
        None,
        gt=0,
        description="Largest electric field that the material withstands in any direction",
    )
    residual_stress: tuple[Pressure, Pressure, Pressure] | None = Field(
        None,
        description=(
            "Residual normal stresses along x, y and z in the body at rest; the forces of "
            "the supports balance these stresses"
        ),
    )
    source: str = Field(
        "", description="Literature reference for all values of this material table"
    )
    sources: dict[str, str] = Field(
        default_factory=dict,
        description=(
            "Literature references for single properties, each under the key of the property"
        ),
    )

    @model_validator(mode="before")
    @classmethod
    def _inherit_constants(cls, data: Any) -> Any:
        """Add missing constants from the built-in material that the key ``like`` names."""
        if not isinstance(data, Mapping) or "like" not in data:
            return data
        if str(data["like"]) not in _load_tables():
            raise make_unknown_base_error(str(data["like"]), list(_load_tables()))
        base = dict(_load_tables()[data["like"]])
        for forms in _ALTERNATIVE_KEYS:
            if set(chain.from_iterable(forms)).isdisjoint(data):
                continue
            for keys in forms:
                for key in keys if set(keys).isdisjoint(data) else ():
                    base.pop(key, None)
        result = base | dict(data)
        for key in set(base) & set(data):
            if isinstance(base[key], dict) and isinstance(data[key], Mapping):
                result[key] = base[key] | data[key]
        return result

    @model_validator(mode="after")
    def _require_consistent_keys(self) -> MaterialTable:
        """Reject contradictory keys of a material."""
        elastic = [self.youngs_modulus, self.stiffness, self.compliance]
        if elastic.count(None) != 2:
            stated = [key for key in _ELASTIC_KEYS if getattr(self, key) is not None]
            hint = 'add  youngs_modulus = "100 GPa"  and  poisson_ratio = 0.3'
            if stated:
                hint = f"delete {' and '.join(stated[1:])}"
            raise make_invalid_value_error(
                "the material needs exactly one of youngs_modulus, stiffness, compliance",
                None,
                hint=hint,
            )
        if self.stress_coupling is not None and self.strain_coupling is not None:
            raise make_invalid_value_error(
                "stress_coupling and strain_coupling cannot be combined",
                None,
                hint="delete the key `strain_coupling`, because both contain the same constants",
            )
        coupled = self.stress_coupling is not None or self.strain_coupling is not None
        if coupled and (self.permittivity is None or self.permittivity_at is None):
            missing = "permittivity_at" if self.permittivity is not None else "permittivity"
            line = 'permittivity_at = "stress"' if self.permittivity is not None else (
                "permittivity = { eps11 = 1700, eps33 = 1800 }"
            )  # fmt: skip
            raise make_invalid_value_error(
                f"the key `{missing}` of this piezoelectric material is missing",
                None,
                hint=f"add  {line}  with the values of the data sheet",
            )
        if coupled and self.conductor:
            raise make_invalid_value_error(
                "a material with conductor = true cannot have piezoelectric constants",
                None,
                hint=DeleteKey("conductor"),
            )
        unknown = set(self.sources) - set(type(self).model_fields)
        if unknown:
            raise make_invalid_value_error(
                f"sources contains unknown keys: {', '.join(sorted(unknown))}",
                None,
                hint=did_you_mean(min(unknown), type(self).model_fields)
                or f"delete {min(unknown)} from sources",
            )
        return self

    def build_material(self, name: str) -> Material:
        """Build the material from this table, with tensors in stress-charge form.

        Raises
        ------
        UsageError : components are missing or unknown, a value is implausible and probably in a
            wrong unit, or a tensor is not positive definite.
        """
        C, e = self._build_stiffness(), np.zeros((3, 6))
        for key in ("stress_coupling", "strain_coupling"):
            if getattr(self, key) is not None:
                reject_implausible_coupling(key, getattr(self, key))
        if self.stress_coupling is not None:
            e = self._build_tensor("stress_coupling", "e")
        elif self.strain_coupling is not None:
            e = self._build_tensor("strain_coupling", "d") @ C
        eps, coupled = EPSILON_0 * self._build_permittivity(), e @ np.linalg.solve(C, e.T)
        key = "stress_coupling" if self.strain_coupling is None else "strain_coupling"
        at_stress = self.permittivity_at == "stress"
        eps_T = eps if at_stress else eps + coupled
        reject_excessive_coupling(coupled, eps_T, key, self.permittivity_at)
        eps = eps - coupled if at_stress else eps
        _require_positive_definite(eps, "permittivity at constant strain")
        stated = {}
        for key in set(type(self).model_fields) & set(Material.__dataclass_fields__):
            if getattr(self, key) is not None:
                stated[key] = getattr(self, key)
        return Material(name=name, C=C, e=e, eps_S=eps, **stated)

    def _build_stiffness(self) -> np.ndarray:
        """Build the stiffness matrix (6, 6) [Pa] from stiffness, compliance or moduli."""
        key = next(key for key in _ELASTIC_KEYS if getattr(self, key) is not None)
        values = getattr(self, key)
        if isinstance(values, list) and self.shear_modulus is not None:
            axes = dict(zip("xyz", values, strict=False))
            moduli = {f"youngs_modulus.{axis}": value for axis, value in axes.items()}
            reject_mixed_elastic_units(key, moduli | self.shear_modulus)
        else:
            reject_mixed_elastic_units(key, values)
        if self.stiffness is not None:
            C = self._build_tensor("stiffness", "c")
        else:
            s = (
                self._compute_engineering_compliance()
                if self.compliance is None
                else self._build_tensor("compliance", "s")
            )
            _require_positive_definite(s, key)
            C = np.linalg.inv(s)
        _require_positive_definite(C, "stiffness")
        largest = float(np.diag(C).max())
        reject_implausible_stiffness(largest, key, values)
        _reject_implausible_density(self.density, largest)
        return (C + C.T) / 2

    def _compute_engineering_compliance(self) -> np.ndarray:
        """Compute the compliance (6, 6) from the moduli and Poisson's ratios.

        Poisson's ratio is ``nu_ij = -S_jj/S_ii``, where S_ii and S_jj are the strains along i and j
        that a stress along i causes.
        """
        E_keys, nu, G = self.youngs_modulus, self.poisson_ratio, self.shear_modulus
        ratios, planes = ("nu_xy", "nu_xz", "nu_yz"), ("g_yz", "g_xz", "g_xy")
        if isinstance(E_keys, float) and isinstance(nu, float) and G is None:
            shear = E_keys / (2 * (1 + nu)) if nu > -1 else np.nan
            E, n, g = [E_keys] * 3, [nu] * 3, [shear] * 3
        elif (
            isinstance(E_keys, list)
            and len(E_keys) == 3
            and isinstance(nu, dict)
            and isinstance(G, dict)
            and (set(nu), set(G)) == (set(ratios), set(planes))
        ):
            E, n, g = E_keys, list(map(nu.__getitem__, ratios)), list(map(G.__getitem__, planes))
        else:
            expected = f"three youngs_modulus, poisson_ratio {' '.join(ratios)}, "
            expected += f"shear_modulus {' '.join(planes)}"
            hint = "for an isotropic material, delete shear_modulus"
            if isinstance(E_keys, float) and nu is None and G is None:
                hint = "add  poisson_ratio = 0.3"
            values = {"youngs_modulus": E_keys, "poisson_ratio": nu, "shear_modulus": G}
            stated = (f"{key} = {value}" for key, value in values.items() if value is not None)
            raise UsageError(
                "these moduli do not define an elastic material",
                got=", ".join(stated),
                expected=f"one youngs_modulus and one poisson_ratio, or {expected}",
                hint=hint,
            )
        if isinstance(nu, float) and not -1 < nu < 0.5:
            raise wrong(
                "poisson_ratio",
                "the Poisson ratio of this material is out of range",
                got=f"{nu:g}",
                expected="above -1 and below 0.5",
                hint="for metals and ceramics, write for example 0.3",
            )
        if min(E) <= 0 or not min(g) > 0:
            hint = "remove the minus sign" if min(E) < 0 else "write values above zero"
            got = ", ".join(f"{modulus:g} Pa" for modulus in dict.fromkeys([*E, *g]))
            raise UsageError(
                "an elastic modulus is not positive",
                got=got,
                expected="moduli above zero, and a poisson_ratio above -1",
                hint=hint,
            )
        s = np.diag(1 / np.array([*E, *g]))
        s[0, 1:3], s[1, 2] = -np.array(n[:2]) / E[0], -n[2] / E[1]
        return np.triu(s) + np.triu(s, 1).T

    def _build_permittivity(self) -> np.ndarray:
        """Build the relative permittivity (3, 3) from a matrix or from components."""
        values, names = self.permittivity, ("eps11", "eps22", "eps33")
        if values is None:
            return np.eye(3)
        if isinstance(values, list):
            matrix = _convert_to_matrix(values, (3, 3), "permittivity")
            reject_implausible_permittivity(values)
            return matrix
        if "eps11" not in values or set(values) - set(names):
            raise wrong(
                "permittivity",
                "these keys are not the components of a permittivity",
                got=", ".join(values),
                expected="eps11, and also eps22 or eps33 if its value differs from eps11",
                hint="write  permittivity = { eps11 = VALUE, eps33 = VALUE }",
            )
        reject_implausible_permittivity(values)
        first = values["eps11"]
        return np.diag([first, values.get("eps22", first), values.get("eps33", first)])

    def _build_tensor(self, key: str, letter: str) -> np.ndarray:
        """Build one tensor of the table from lists or from named components.

        The names of components begin with ``letter``: ``c`` for stiffness (6, 6), ``s`` for
        compliance (6, 6), and ``e`` or ``d`` for coupling (3, 6).
        """
        values, elastic = getattr(self, key), letter in "cs"
        shape = (6, 6) if elastic else (3, 6)
        if isinstance(values, list):
            return _convert_to_matrix(values, shape, key)
        if self.symmetry not in _FREE_COMPONENTS:
            raise wrong(
                key,
                "named components of a tensor need the key `symmetry`",
                got=self.symmetry,
                expected=f"symmetry = {', '.join(_FREE_COMPONENTS)}, or a full matrix",
                hint='add  symmetry = "6mm"  for a poled ceramic',
            )
        first, second, last = f"{letter}11", f"{letter}12", f"{letter}66"
        if (
            elastic
            and self.symmetry in _SYMMETRIES_WITH_DERIVED_66
            and {first, second} <= set(values)
        ):
            factor = 0.5 if letter == "c" else 2.0
            values = {last: factor * (values[first] - values[second]), **values}
        free = _FREE_COMPONENTS[self.symmetry][0 if elastic else 1]
        groups = [group.split("=") for group in free.split()]
        required = {letter + group[0] for group in groups}
        if set(values) != required:
            problem, expected = (
                "these components do not match the symmetry",
                ", ".join(sorted(required)),
            )
            missing, more = sorted(required - set(values)), sorted(set(values) - required)
            actions = [f"add {', '.join(missing)}"] if missing else []
            actions += [f"delete {', '.join(more)}"] if more else []
            got, hint = ", ".join(sorted(values)), " and ".join(actions)
            raise UsageError(problem, where=key, got=got, expected=expected, hint=hint)
        matrix = np.zeros(shape)
        for group in groups:
            for place in group:
                row, column = int(place[-2]) - 1, int(place[-1]) - 1
                matrix[row, column] = values[letter + group[0]] * (-1 if place[0] == "-" else 1)
        # with engineering shear strains, s56 = 2 s14 and d26 = -2 d11
        if self.symmetry == "trigonal" and letter in "sd":
            matrix[4 if elastic else 1, 5] *= 2
        return np.triu(matrix) + np.triu(matrix, 1).T if elastic else matrix


def _convert_to_matrix(rows: list[list[float]], shape: tuple[int, int], key: str) -> np.ndarray:
    """Convert the rows of a tensor to a matrix, and check its shape.

    A matrix with another shape is rejected, and so is a square matrix that is not symmetric.
    """
    if list(map(len, rows)) != [shape[1]] * shape[0]:
        expected = f"{shape[0]} rows of {shape[1]} numbers"
        raise UsageError(
            "the matrix has a wrong number of entries",
            where=key,
            got=f"rows of {', '.join(map(str, map(len, rows[:8])))} numbers",
            expected=expected,
            hint=f"write {expected}, as [[…], …]",
        )
    matrix = np.array(rows)
    if shape[0] == shape[1] and not np.allclose(matrix, matrix.T, rtol=1e-6):
        row, column = map(int, np.argwhere(~np.isclose(matrix, matrix.T, rtol=1e-6))[0])
        place = f"row {row + 1}, column {column + 1}"
        raise UsageError(
            "this matrix is not symmetric",
            where=key,
            got=(
                f"{matrix[row, column]:g} in {place}, and {matrix[column, row]:g} on the other side"
            ),
            expected="equal entries on both sides of the diagonal",
            hint=f"write {matrix[column, row]:g} in {place}",
        )
    return matrix


MAX_SOLID_DENSITY = 22_600.0  # kg/m3, density of osmium, the densest solid
MAX_WAVE_SPEED = 30e3  # m/s, above the wave speed of 18 km/s in diamond, the highest of all solids


def _reject_implausible_density(density: float, stiffness: float) -> None:
    """Reject a density that is probably in a wrong unit.

    A density is rejected if it exceeds the density of every solid, or if the wave speed in the
    material exceeds ``MAX_WAVE_SPEED``. The wave speed is the square root of ``stiffness /
    density``.
    """
    speed = float(np.sqrt(stiffness / density))
    if density > MAX_SOLID_DENSITY:
        problem, limit = "this density exceeds the density of every solid", MAX_SOLID_DENSITY
        expected, factor = f"at most {limit:g} kg/m3", 1e-3
    elif speed > MAX_WAVE_SPEED:
        problem = f"this density is too low: the wave speed would be {speed / 1e3:.3g} km/s"
        expected, factor = f"at least {stiffness / MAX_WAVE_SPEED**2:.3g} kg/m3", 1e3
    else:
        return
    hint = f'write  density = "{factor * density:g} kg/m3"  if the value is in '
    hint += "g/cm3" if factor > 1 else "g/m3"
    raise wrong("density", problem, got=f"{density:g} kg/m3", expected=expected, hint=hint)


def _require_positive_definite(matrix: np.ndarray, key: str, hint: str | None = None) -> None:
    """Reject a matrix that is not positive definite.

    The check scales the diagonal entries of the matrix to one.
    """
    diagonal = np.diag(matrix)
    smallest = float(diagonal.min())
    if smallest > 0:
        scale = 1 / np.sqrt(diagonal)
        smallest = float(np.linalg.eigvalsh(matrix * np.outer(scale, scale))[0])
    if not smallest > 1e-9:
        raise wrong(
            key,
            "the matrix of this material is not positive definite",
            got=f"smallest eigenvalue {smallest:g}",
            expected="greater than 0",
            hint=hint,
        )


@cache
def _load_tables() -> dict[str, dict[str, Any]]:
    """Return the material tables of the library file, keyed by name."""
    return tomllib.loads((Path(__file__).parent / "materials.toml").read_text("utf-8"))


@cache
def _list_library_names() -> dict[str, str]:
    """Return the names of the built-in materials, keyed by the name in lower case."""
    return dict(zip(map(str.lower, _load_tables()), _load_tables(), strict=True))


@cache
def _load_material(name: str) -> Material:
    """Return the built-in material with a given name."""
    return MaterialTable.model_validate(_load_tables()[name]).build_material(name)


# Each key that a piezoelectric ceramic needs in its TOML table, with an example line for this key.
# The example values are those of PZT-5A.
_CERAMIC_LINES = {
    "symmetry": 'symmetry = "6mm"',
    "strain_coupling": "strain_coupling = { d31 = -171e-12, d33 = 374e-12, d15 = 584e-12 }",
    "permittivity": "permittivity = { eps11 = 1730, eps33 = 1700 }",
    "permittivity_at": 'permittivity_at = "stress"',
}


def advise_missing_ceramic_keys(materials: Mapping[str, str | Mapping[str, Any]]) -> str | None:
    """Return the hint that lists missing keys of a ceramic, or None.

    ``materials`` contains the name or the table of each material of a body, by the key of the
    material. No material of the body is piezoelectric. The hint belongs to the first table with a
    permittivity, or otherwise to the first table of an insulator. Without such a table, the result
    is None.
    """
    tables = {
        key: item
        for key, item in materials.items()
        if isinstance(item, Mapping) and not item.get("conductor") and "like" not in item
    }
    if not tables:
        return None
    key = next((key for key, item in tables.items() if "permittivity" in item), next(iter(tables)))
    missing = [line for name, line in _CERAMIC_LINES.items() if name not in tables[key]]
    return f"add to {key}:  {', '.join(missing)}  with the values of the data sheet"


def find_material(
    name_or_table: str | Mapping[str, Any] | Material, where: str = "material"
) -> Material:
    """Return the built-in material with a name, or build the material of a table.

    Names of built-in materials may be written in upper or lower case.

    Raises
    ------
    UsageError : the name does not exist, or the table does not describe a material.
    """
    if isinstance(name_or_table, Material):
        return name_or_table
    if isinstance(name_or_table, Mapping):
        table = validate_table(MaterialTable, name_or_table, where)
        with name_part_in_errors(where):
            return table.build_material(where.rsplit(".", 1)[-1])
    if name_or_table.lower() not in _list_library_names():
        names = list(_load_tables())
        hint = did_you_mean(name_or_table, names)
        hint = hint or 'write a table: { density = …, youngs_modulus = "… GPa", poisson_ratio = … }'
        raise wrong(
            where,
            "this material does not exist",
            got=repr(name_or_table),
            expected=(
                f"one of {list_candidates(name_or_table, names, 'docs/reference/materials.md')}"
            ),
            hint=hint,
        )
    return _load_material(_list_library_names()[name_or_table.lower()])


def find_stated_losses(name_or_table: str | Mapping[str, Any] | None) -> dict[str, Any]:
    """Return the Q factor and the loss tangent that a material table itself states."""
    table = name_or_table if isinstance(name_or_table, Mapping) else {}
    return {name: table[name] for name in ("quality", "loss_tangent") if table.get(name)}
