"""The part ``bimorph``: a layered rectangular beam or plate that bends.

The part represents unimorphs, series bimorphs and parallel bimorphs. A beam of metal alone has no
electrical pins.

The x axis runs along the length from the clamp, the y axis along the width, and the z axis upwards.
Every layer consists of quadratic hexahedra. The model therefore includes the bending of plates, the
lateral contraction at the clamp, and the electric field inside the layers. Beam theory neglects
these three effects. Electrodes cover both faces of a piezoelectric layer completely. Two faces form
one electrode if they touch the same conductor, or if they are touching faces of two piezoelectric
layers. A positive voltage at the anode contracts the layers above the middle and stretches the
layers below the middle. The voltage thereby bends the tip up.

* *series*: the anode is on top, the cathode is at the bottom, and all electrodes in between float;
* *parallel*: from the top down, the electrodes belong alternately to the anode and the cathode.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import accumulate, chain, pairwise, product
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, StringConstraints, model_validator

from kc2spice.bodies.solid_models import Block, BondedBlocks, Box, list_outer_faces
from kc2spice.core.errors import UsageError, wrong
from kc2spice.core.key_errors import validate_table
from kc2spice.core.quantities import (
    Count,
    Extent,
    Length,
    Mass,
    RefinementRule,
    Section,
    Thickness,
    Width,
    make_invalid_value_error,
)
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.body_keys import BodyMeshKeys, DampingKeys
from kc2spice.fem.materials import advise_missing_ceramic_keys, find_material
from kc2spice.parts.bodies._linear_body_keys import FieldKeys
from kc2spice.parts.bodies._meshed_bodies import (
    BondedBody,
    list_layer_materials,
    make_missing_ceramic_error,
)
from kc2spice.scene.checks import Check, RunEnergyBalance
from kc2spice.scene.part_records import NeglectedEffect
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import BuiltScene, GovernedScene, Part, Scene

# Numbers of elements along and across the beam if ``mesh.refine`` is 1.
ELEMENTS_ALONG = 20
ELEMENTS_ACROSS = 4
GRADING_RATIO = 1.6
# Largest deflection for which a linear model is used without a warning, relative to the length of a
# beam whose end can move along its axis. A beam with uniform curvature bends to an arc of a circle.
# The linear deflection w of a cantilever with the length L is too large by the fraction (w/L)^2/3.
MAX_LENGTH_SHARE = 0.1
# Largest deflection without a warning, relative to the thickness of a beam or plate whose edges
# cannot move. Stretching raises the stiffness of a clamped beam by the fraction 3/4 (w/h)^2 for the
# deflection w and the thickness h: S. D. Senturia, Microsystem Design (2001), section 10.4.
MAX_THICKNESS_SHARE = 0.2


class BimorphLayer(Section):
    """Layer of a bimorph; each layer covers the whole beam."""

    material: str | dict[str, Any] = Field(
        examples=['"steel"'],
        description="Material of this layer of the beam: a name, or a table of constants",
    )
    thickness: Thickness = Field(gt=0, description="Thickness of this layer of the beam")


class BeamMeshKeys(BodyMeshKeys):
    """Keys of a beam's mesh, which is finer in the plane of the layers than through them."""

    refine: Annotated[Count, RefinementRule(2.0, model=True, mesh=True)] = Field(
        1,
        ge=1,
        le=8,
        description=(
            "Refinement factor of the beam's mesh: number of equal parts into which each cell "
            "edge in the plane of the layers is divided. Through the thickness of each layer, "
            "the number of cells is half of the refinement factor, rounded up, because one "
            "quadratic cell can represent bending"
        ),
    )


class BimorphKeys(FieldKeys):
    """Keys of a layered beam, or of a quarter of a layered plate.

    ``support`` is *cantilever* (clamped at x = 0), *clamped* (at both ends), *simply_supported* (on
    knife edges under both ends), *free*, or *quarter*. A *quarter* is a quarter of a plate that is
    clamped along all edges. The modelled quarter of the plate is clamped at x = 0 and y = 0, and
    its other sides are mirror planes. The value of the pin ``tip`` is the upward displacement of
    the end face at x = ``length``; a beam that is clamped at this face has no pin ``tip``. The
    value of the pin ``base`` is the upward acceleration of the support. If nothing is joined to
    ``base``, the support is at rest. All displacements are relative to the support, whose pin is
    ``ground``; in the netlist of a beam at rest, this pin has the name ``base``. ``tip_mass`` is
    distributed evenly over the end face. ``points`` are additional ports on the centre line of the
    top face, each stated as its distance from the end at x = 0. For a *quarter*, ``points`` are on
    the edge that is the centre line of the whole plate.
    """

    length: Extent = Field(gt=0, description="Free length of the beam, without its clamped ends")
    width: Width = Field(gt=0, description="Width of the beam")
    layers: tuple[BimorphLayer, ...] = Field(
        examples=['[{ material = "PZT-5A", thickness = "0.2 mm" }]'],
        description="Layers of the beam from bottom to top",
        min_length=1,
    )
    wiring: Literal["series", "parallel"] | None = Field(
        None,
        description=(
            "Electrical connection of the ceramic layers. `series` (default): all layers are poled "
            "towards the middle of the beam. `parallel`: a positive voltage produces an electric "
            "field along the poling in the layers above the middle of the beam, and against the "
            "poling in the layers below. Two parallel layers are therefore both poled downwards"
        ),
    )
    tip_mass: Mass = Field(
        0.0, ge=0, description="Mass at the tip of the beam, distributed evenly over the end face"
    )
    support: Literal["cantilever", "clamped", "simply_supported", "free", "quarter"] = Field(
        "cantilever",
        description=(
            "Mechanical support of the beam: `cantilever` is clamped at one end, and `clamped` at "
            "both ends. With `quarter`, the model is not a beam, but one "
            "quarter of a rectangular plate that is clamped along all edges"
        ),
    )
    points: dict[
        Annotated[str, StringConstraints(pattern=r"^[A-Za-z][A-Za-z0-9_]{0,30}$")], Length
    ] = Field(
        default_factory=dict,
        description=(
            "Further ports on the centre line of the top face: the name of each port and its "
            "distance from the end at x = 0"
        ),
    )
    patches: Count | None = Field(
        None,
        ge=1,
        le=64,
        description=(
            "Number of surface patches along the length of the beam. The patches divide the "
            "bottom face into rectangles of equal size; the ports of the patches are patch1, "
            "patch2, …"
        ),
    )
    rows: Count | None = Field(
        None,
        ge=2,
        le=16,
        description=(
            "Number of rows of surface patches across the width of the beam; by default one row"
        ),
    )
    damping: DampingKeys = DampingKeys()
    mesh: BeamMeshKeys = BeamMeshKeys()

    @model_validator(mode="after")
    def _check_consistency(self) -> BimorphKeys:
        """Reject ``rows`` without ``patches``, and invalid names or positions of points."""
        if self.rows and self.patches is None:
            raise make_invalid_value_error(
                "rows needs the key `patches`",
                None,
                hint="add for example  patches = 10  or delete the key `rows`",
            )
        for name, x in self.points.items():
            if name in ("tip", "base", "anode", "cathode") or name.startswith("patch"):
                raise make_invalid_value_error(
                    f"points: {name} is already the name of a port",
                    None,
                    hint=f"rename the point, such as {name}_point",
                )
            if not 0 <= x <= self.length:
                raise make_invalid_value_error(
                    f"points.{name} is not on the beam",
                    None,
                    hint=f"lower points.{name} to at most {self.length:g} m",
                )
        return self


def make_bimorph_blocks(
    keys: BimorphKeys | Mapping[str, Any], where: str = "bimorph"
) -> BondedBlocks:
    """Return a bimorph as bonded blocks, with electrodes, support, ports and tip mass.

    ``mesh.refine`` divides the element size in the plane of the layers. Through the thickness, each
    layer has ``ceil(mesh.refine / 2)`` elements, because a single quadratic element already
    represents the bending of a plate.

    Raises
    ------
    UsageError : a material does not exist, or ``wiring`` is stated without a piezoelectric layer.
    """
    beam = validate_table(BimorphKeys, keys, where)
    materials = [
        find_material(layer.material, f"{where}.layers[{number}].material")
        for number, layer in enumerate(beam.layers)
    ]
    heights = [*accumulate((layer.thickness for layer in beam.layers), initial=0.0)]
    spans = [*pairwise(heights)]
    active = [k for k, one in enumerate(materials) if one.is_piezoelectric]
    if beam.wiring is not None and not active:
        raise wrong(
            "wiring",
            "the key `wiring` needs a piezoelectric layer",
            got=beam.wiring,
            hint=advise_missing_ceramic_keys(list_layer_materials(beam.layers))
            or 'delete the key `wiring`, or write  material = "PZT-5A"  for a layer',
        )
    length, width, top = beam.length, beam.width, heights[-1]

    def make_plane(height: float) -> Box:
        """Return the horizontal plane of the beam at ``height``."""
        return (0.0, length), (0.0, width), (height, height)

    def make_cross_section(x: float, y: tuple[float, float], z: tuple[float, float]) -> Box:
        """Return the rectangle at ``x`` that the intervals ``y`` and ``z`` span."""
        return (x, x), y, z

    # Electrodes are listed from the bottom up.
    # Faces on the same conductor, or touching faces of two ceramic layers, form one electrode.
    ends = [*chain.from_iterable(map(spans.__getitem__, active))]
    levels = [ends[:1], *zip(ends[1:-1:2], ends[2::2], strict=True), ends[-1:]] if active else []
    series = beam.wiring != "parallel"
    faces = [list(map(make_plane, level)) for level in levels]
    electrodes = {"anode": faces[::-2], "cathode": faces[-2::-2]}
    if series:
        electrodes = {"anode": faces[-1:], "cathode": faces[:1]}
    blocks = []
    for k, (one, span) in enumerate(zip(materials, spans, strict=True)):
        above = sum(span) / 2 >= top / 2 * (1 - 1e-9)
        # In a series bimorph, a positive voltage causes a downward field in all layers.
        # In a parallel bimorph, a positive voltage causes a downward field in every second layer.
        down = series or k not in active or (active.index(k) - len(active)) % 2
        poled = one.rotate_z_axis((0, 0, -1.0 if down == above else 1.0)) if k in active else one
        box = ((0.0, length), (0.0, width), span)
        blocks.append(Block(box, replace(poled, name=f"layers[{k}] ({one.name})")))
    full_width, end = (0.0, width), make_cross_section(length, (0.0, width), (0.0, top))
    clamp = ("xyz", make_cross_section(0.0, full_width, (0.0, top)))
    fixed = {
        "cantilever": [clamp],
        "clamped": [clamp, ("xyz", end)],
        # Only one corner of each supported edge is fixed in y, so that the width can change.
        "simply_supported": [
            ("xz", make_cross_section(0.0, full_width, (0.0, 0.0))),
            ("z", make_cross_section(length, full_width, (0.0, 0.0))),
            ("y", make_cross_section(0.0, (0.0, 0.0), (0.0, 0.0))),
            ("y", make_cross_section(length, (0.0, 0.0), (0.0, 0.0))),
        ],
        "free": [],
        "quarter": [
            clamp,
            ("xyz", ((0.0, length), (0.0, 0.0), (0.0, top))),
            ("x", end),
            ("y", ((0.0, length), (width, width), (0.0, top))),
        ],
    }[beam.support]
    clamped = beam.support in ("clamped", "quarter")
    ports = {} if clamped else {"tip": end}
    middle = (width, width) if beam.support == "quarter" else (width / 2, width / 2)
    for name, x in beam.points.items():
        ports[name] = make_cross_section(x, middle, (top, top))
    strips = pairwise(np.linspace(0, length, (beam.patches or 0) + 1).tolist())
    rows = pairwise(np.linspace(0, width, (beam.rows or 1) + 1).tolist())
    for k, (row, strip) in enumerate(product(rows, strips), 1):
        ports[f"patch{k}"] = (strip, row, (0.0, 0.0))
    return BondedBlocks(
        blocks,
        {pin: [*chain(*result)] for pin, result in electrodes.items()} if active else {},
        faces[1:-1] if series else (),
        ports,
        fixed,
        masses=[(beam.tip_mass, end)],
        faces=list_outer_faces(((0.0, length), (0.0, width), (0.0, top))),
        moved=beam.support != "free",
        grid=_make_grid(beam, heights),
        damping=beam.damping,
        where=where,
    )


def _count_cells_through_layer(refine: float) -> int:
    """Return the number of mesh cells through the thickness of each layer."""
    return math.ceil(refine / 2)


def _make_grid(beam: BimorphKeys, heights: list[float]) -> tuple[np.ndarray, ...]:
    """Return the grid lines of the mesh along, across and through the beam.

    The grid lines along the beam are denser near the clamps.
    """
    refine, rows = beam.mesh.refine, beam.rows or 1
    s = np.linspace(0, 1, ELEMENTS_ALONG * refine + 1)
    if beam.patches:  # all patches have the same number of elements along the beam
        s = np.linspace(0, 1, -(-ELEMENTS_ALONG * refine // beam.patches) * beam.patches + 1)
    elif beam.support == "cantilever":
        s = s**GRADING_RATIO
    elif beam.support == "clamped":
        s = 0.5 + 0.5 * np.sign(s - 0.5) * (1 - (1 - np.abs(2 * s - 1)) ** GRADING_RATIO)
    cells = _count_cells_through_layer(refine)
    cuts = [np.linspace(*pair, cells + 1)[:-1] for pair in pairwise(heights)]
    return (
        np.union1d(beam.length * s, list(beam.points.values())),
        np.linspace(0, beam.width, -(-ELEMENTS_ACROSS * refine // rows) * rows + 1),
        np.append(np.concatenate(cuts), heights[-1]),
    )


class Bimorph(BondedBody[BimorphKeys]):
    """Part type ``bimorph``: layered piezoelectric bending beam, reduced from 3-D FE."""

    name = "bimorph"
    title = "layered beam that bends (3-D piezoelectric FE, reduced)"
    schema = BimorphKeys
    source = "FE (piezoelectric, 3-D)"
    structure = staticmethod(make_bimorph_blocks)
    optional_pins: ClassVar[Mapping[str, str]] = {
        "NAME of a point": "points.NAME",
        "patch1, patch2, …": "patches",
        **BondedBody.optional_pins,
    }

    def describe_support(self, part: Part[BimorphKeys]) -> str:
        """Describe how the body is supported, for the list of neglected effects."""
        return f"ideal support: {part.keys.support.replace('_', ' ')}"

    def problems(self, part: Part[BimorphKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key, and for electrodes without a ceramic."""
        yield from super().problems(part, scene)
        if not part.pins.keys() & {"anode", "cathode"}:
            return
        layers = part.keys.layers
        materials = [
            find_material(item, f"{part.name}.{key}")
            for key, item in list_layer_materials(layers).items()
        ]
        if not any(one.is_piezoelectric for one in materials):
            problem = "the pins anode and cathode need a piezoelectric layer"
            yield make_missing_ceramic_error(part.name, problem, layers, materials)

    def list_neglected_effects(
        self, part: Part[BimorphKeys], scene: Scene
    ) -> Iterator[NeglectedEffect]:
        """Yield the neglected effects of the body, including large rotations."""
        yield from super().list_neglected_effects(part, scene)
        what, why = f"{part.name}: large deflection", "linear strains, small rotations"
        yield NeglectedEffect(what, why, "checked after the run")

    def estimate_mesh_growth(self, part: Part[BimorphKeys], old: float, new: float) -> float:
        """Estimate the ratio of the numbers of unknowns for two values of ``mesh.refine``."""
        return (new / old) ** 2 * _count_cells_through_layer(new) / _count_cells_through_layer(old)

    def has_mirror_planes(self, part: Part[BimorphKeys]) -> bool:
        """Return whether the model is a quarter of a plate, bounded by mirror planes."""
        return part.keys.support == "quarter"

    def checks(
        self, part: Part[BimorphKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check | RunEnergyBalance]:
        """Yield the checks of the body, and the check that its deflection is small."""
        yield from super().checks(part, build, waves)
        yield from self._check_deflection(part, build, waves)

    def _check_deflection(
        self, part: Part[BimorphKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check]:
        """Yield the check that the largest deflection is small, relative to the beam.

        The deflection of a radiating face or of a patch is the mean over its area. A free beam has
        no check, because its displacements include rigid-body motions. The deflection of a clamped
        beam with a connected part of type ``stretch`` is not checked, because this part models the
        stretching.
        """
        keys, ports = part.keys, self.used_ports(part, build.scene)
        largest = self.find_largest_deflection(part, build, waves)
        if keys.support == "free" or largest is None:
            return
        if keys.support in ("clamped", "quarter"):
            joined = chain.from_iterable(
                build.scene.list_joined_pins(part.name, port.terminals[0]) for port in ports
            )
            if any(build.scene.parts[name].type.name == "stretch" for name, _ in joined):
                return
            size = sum(layer.thickness for layer in keys.layers)
            limit, unit = MAX_THICKNESS_SHARE, "of the thickness"
            change = f"stretching stiffens it by about {75 * (largest / size) ** 2:.2g} %"
            action = "add patches and a part of type stretch, or lower the drive"
        else:
            # Both halves of a simply supported beam bend like cantilevers.
            size, unit = keys.length, "of the length"
            if keys.support == "simply_supported":
                size, unit = size / 2, "of half the length"
            limit = MAX_LENGTH_SHARE
            percent = 100 * (largest / size) ** 2 / 3
            change = f"about {percent:.2g} % of the deflection is an error of the linear model"
            action = "lower the drive"
        name = f"largest deflection of {part.name}"
        label = f"peak deflection of {part.name} / {unit.removeprefix('of ').removeprefix('the ')}"
        advice = f"{change}; {action}"
        yield Check(name, largest / size, limit, unit, advice, "warn", label=label)


register_part_type(Bimorph())
