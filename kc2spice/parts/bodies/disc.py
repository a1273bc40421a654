"""The part ``disc``: a stack of circular layers with electrodes, such as a buzzer.

    layers = [                                  # from the bottom up
      { material = "brass", diameter = "20 mm", thickness = "0.2 mm" },
      { material = "PZT-5A", diameter = "14 mm", thickness = "0.22 mm", electrodes = "12.8 mm" },
    ]
    support = "free"                            # clamped, simply_supported, { node = "13 mm" }

The electrical pins are ``anode``, ``cathode`` and, with a feedback electrode, ``feedback``. The
acoustic ports are ``front_face`` with all surfaces that point upwards, and ``back_face`` with all
surfaces that point downwards. The mechanical port ``centre`` is the mean upward displacement of a
small patch on top. The model neglects silver, solder, wires and air; it includes glue only as a
layer.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import replace
from itertools import accumulate, chain, pairwise
from typing import Any, ClassVar, Literal

from pydantic import Field, model_validator

from kc2spice.bodies.solid_models import Block, BondedBlocks, Box, list_outer_faces
from kc2spice.bodies.undamped_models import FiniteElementModel
from kc2spice.core.errors import UsageError, wrong
from kc2spice.core.key_actions import ChangeKey
from kc2spice.core.key_errors import validate_table
from kc2spice.core.quantities import (
    Length,
    Section,
    Thickness,
    UnlimitedQFactor,
    Width,
    make_invalid_value_error,
)
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.body_keys import BodyMeshKeys, DampingKeys
from kc2spice.fem.materials import advise_missing_ceramic_keys, find_material
from kc2spice.parts.bodies._linear_body_keys import FieldKeys
from kc2spice.parts.bodies._meshed_bodies import BondedBody, make_missing_ceramic_error
from kc2spice.scene.checks import Check, RunEnergyBalance
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.plausibility import MAX_OVERHANG
from kc2spice.scene.scene_classes import BuiltScene, GovernedScene, Part

# Stretching raises the stiffness of a disc by the fraction A (w/h)^2 for the deflection w and the
# thickness h. The factor A is 0.471 for a clamped rim, and 0.262 for a simply supported rim that
# can move radially: S. P. Timoshenko and S. Woinowsky-Krieger, Theory of Plates and Shells (1959),
# table 82.
_CLAMPED_STRETCHING, _SUPPORTED_STRETCHING = 0.471, 0.262
# A check warns if stretching raises the stiffness of a disc by more than the fraction
# MAX_STRETCHING.
MAX_STRETCHING = 0.02
# Number of mesh cells along the largest radius or half the height, for ``mesh.refine = 1``.
_RADIAL_CELLS = 20


class FeedbackKeys(Section):
    """Keys of the feedback electrode of a self-oscillating buzzer.

    The feedback electrode, a ring or disc inside the top electrode, drives the input of the
    oscillator.

    In data sheets, the feedback electrode has the shape of a tongue. The model contains a ring of
    the same area instead, because only the area matters.
    """

    inner: Length = Field(
        0.0,
        ge=0,
        description="Inner diameter of the feedback electrode; 0 for an electrode without a hole",
    )
    outer: Width = Field(gt=0, description="Outer diameter of the feedback electrode")
    gap: Length = Field(
        0.5e-3,
        gt=0,
        description="Width of the gap between the feedback electrode and the main electrode",
    )


class DiscLayer(Section):
    """Circular layer of a disc.

    On the faces that touch no metal layer, the electrodes have the diameter ``electrodes``.
    """

    material: str | dict[str, Any] = Field(
        examples=['"steel"'],
        description="Material of the layer of the disc: a name, or a table of constants",
    )
    diameter: Width = Field(gt=0, description="Outer diameter of one layer of the disc")
    thickness: Thickness = Field(gt=0, description="Thickness of one layer of the disc")
    electrodes: Length | None = Field(
        None,
        gt=0,
        description=(
            "Diameter of the electrodes on the faces of the layer; by default the diameter "
            "of the layer"
        ),
    )
    feedback: FeedbackKeys | None = None
    poling: Literal["up", "down"] = Field(
        "up", description="Poling direction of a ceramic layer of the disc"
    )
    quality: UnlimitedQFactor | None = Field(
        None,
        gt=0,
        description="Mechanical Q factor of the layer, used if damping.per_material is true",
    )

    @property
    def electrode_diameter(self) -> float:
        """Diameter [m] of the layer's electrodes."""
        return self.electrodes or self.diameter

    @model_validator(mode="after")
    def _require_fitting_feedback(self) -> DiscLayer:
        """Reject a feedback electrode that does not fit on the layer."""
        ring = self.feedback
        largest = min(self.electrode_diameter, self.diameter)
        if ring is not None:
            inner, outer = ring.inner / 2 - ring.gap, ring.outer / 2 + ring.gap
            filled = inner <= 0 and outer >= largest / 2
            if filled or not ring.inner < ring.outer <= largest:
                raise make_invalid_value_error(
                    (
                        "the feedback electrode does not fit: inner must be less than outer, and "
                        f"outer at most {format_quantity(largest, 'm')}, and a part of the main "
                        "electrode must remain"
                    ),
                    None,
                    hint=ChangeKey(
                        "lower", "feedback.outer", "below", format_quantity(largest, "m")
                    ),
                )
        return self


class KnifeEdgeSupport(Section):
    """Keys of a knife-edge ring that supports a disc from below."""

    node: Length = Field(
        gt=0, description="Diameter of the knife-edge ring on which the disc rests"
    )


class DiscKeys(FieldKeys):
    """Keys of a disc: its layers, support, wiring, damping and mesh.

    The value of the pin ``centre`` is the mean upward displacement of a patch on top. If the pin
    ``base`` of a supported disc is joined, its value is the upward acceleration of the support, and
    all displacements are relative to the support. Without a join, the support is at rest, and
    ``base`` is the reference pin of displacements.

    ``wiring`` only has an effect with at least two ceramic layers. With ``parallel``, the lowest
    electrode and every second electrode above it are connected to the cathode. With ``series``,
    only the lowest and the highest electrode are connected, and the electrodes in between float.
    """

    layers: tuple[DiscLayer, ...] = Field(
        examples=['[{ material = "PZT-5A", diameter = "20 mm", thickness = "0.2 mm" }]'],
        description="Layers of the disc from bottom to top",
        min_length=1,
    )
    support: Literal["free", "clamped", "simply_supported"] | KnifeEdgeSupport = Field(
        "free",
        description=(
            "Support of the disc: free, clamped or simply supported at the rim, or a table with "
            "the key `node` for a knife-edge ring"
        ),
    )
    wiring: Literal["parallel", "series"] = Field(
        "parallel", description="Electrical connection of two or more ceramic layers of the disc"
    )
    centre: Length | None = Field(
        None,
        gt=0,
        description=(
            "Diameter of the central patch on which the port `centre` acts. Default: a diameter "
            "equal to the thickness of the disc at its centre"
        ),
    )
    damping: DampingKeys = DampingKeys()
    mesh: BodyMeshKeys = BodyMeshKeys()

    @property
    def largest_diameter(self) -> float:
        """Diameter [m] of the widest layer."""
        return max(layer.diameter for layer in self.layers)

    @model_validator(mode="after")
    def _require_fitting_electrodes(self) -> DiscKeys:
        """Reject electrodes that are larger than their layer."""
        for i, layer in enumerate(self.layers):
            if layer.electrode_diameter <= layer.diameter * (1 + 1e-9):
                continue
            diameter = format_quantity(layer.diameter, "m")
            plate = self._find_plate_diameter()
            if plate is not None and layer.diameter > MAX_OVERHANG * plate:
                size = format_quantity(plate, "m")
                raise make_invalid_value_error(
                    f"this layer is wider than its plate, whose diameter is {size}, and its "
                    f"electrodes, {format_quantity(layer.electrode_diameter, 'm')}, are larger "
                    "than the layer",
                    f"a diameter of at most {size}, with electrodes of at most this diameter",
                    key=f"layers.{i}.diameter",
                    hint=f'write  diameter = "{size}"  and  electrodes = "{size}"  in this layer',
                )
            raise make_invalid_value_error(
                f"the electrodes are larger than their layer, whose diameter is {diameter}",
                f"at most {diameter}",
                key=f"layers.{i}.electrodes",
                hint=f"lower layers[{i}].electrodes to {diameter}",
            )
        return self

    def _find_plate_diameter(self) -> float | None:
        """Return the diameter [m] of the widest layer without piezoelectricity, or None."""
        diameters = []
        for layer in self.layers:
            with suppress(UsageError):  # another check reports an invalid material
                if not find_material(layer.material).is_piezoelectric:
                    diameters.append(layer.diameter)
        return max(diameters, default=None)

    @model_validator(mode="after")
    def _require_fitting_support(self) -> DiscKeys:
        """Reject a support or a centre port that is larger than the disc."""
        widest = format_quantity(self.largest_diameter, "m")
        top = self.layers[-1].diameter
        top_text = format_quantity(top, "m")
        if isinstance(self.support, KnifeEdgeSupport) and self.support.node > self.largest_diameter:
            raise make_invalid_value_error(
                f"support: the nodal circle is outside of the body, whose diameter is {widest}",
                None,
                hint=f"lower the key `support.node` below {widest}",
            )
        if self.centre is not None and self.centre > top * (1 + 1e-9):
            raise make_invalid_value_error(
                f"centre: the port is wider than the top layer, whose diameter is {top_text}",
                None,
                hint=f"lower the key `centre` to at most {top_text}",
            )
        return self


def make_disc_blocks(keys: DiscKeys | Mapping[str, Any], where: str = "disc") -> BondedBlocks:
    """Make the blocks of a disc: bonded layers with electrodes, support and ports.

    Raises
    ------
    UsageError : a key is invalid, or an electrode or support does not fit the layers.
    """
    disc = validate_table(DiscKeys, keys, where)
    pieces = _make_blocks(disc, where)
    conductors, series = _list_electrodes(disc, pieces, where), disc.wiring == "series"
    electrodes = {"anode": [*chain(*conductors[1::2])], "cathode": [*chain(*conductors[::2])]}
    if series:
        electrodes = {"anode": conductors[-1], "cathode": conductors[0]}
    for layer, piece in zip(disc.layers, pieces, strict=True):
        if layer.feedback is not None:
            ring = _make_ring(layer.feedback.inner / 2, layer.feedback.outer / 2, piece.box[1][1])
            electrodes.setdefault("feedback", []).append(ring)
    top, across = pieces[-1].box[1][1], disc.largest_diameter
    patch = disc.centre or min(top, disc.layers[-1].diameter)
    return BondedBlocks(
        pieces,
        electrodes,
        conductors[1:-1] if series else (),
        {"centre": _make_ring(0.0, patch / 2, top)},
        _make_supports(disc, pieces, across / 2),
        faces=list_outer_faces(((0.0, across / 2), (0.0, top))),
        moved=disc.support != "free",
        size=max(top, across) / (2 * _RADIAL_CELLS),
        refine=disc.mesh.refine,
        damping=disc.damping,
        where=where,
    )


def _make_ring(inner: float, outer: float, height: float) -> Box:
    """Return a horizontal circular ring between two radii at ``height``."""
    return (inner, outer), (height, height)


def _make_blocks(disc: DiscKeys, where: str) -> list[Block]:
    """Return one bonded block for each layer, with its poled material, bottom to top."""
    result = []
    ends = pairwise(accumulate((layer.thickness for layer in disc.layers), initial=0.0))
    materials = [
        find_material(layer.material, f"{where}.layers.{i}.material")
        for i, layer in enumerate(disc.layers)
    ]
    if not any(one.is_piezoelectric for one in materials):
        problem = "the disc has no piezoelectric layer"
        raise make_missing_ceramic_error(where, problem, disc.layers, materials)
    for i, (layer, one, span) in enumerate(zip(disc.layers, materials, ends, strict=True)):
        here = f"{where}.layers.{i}"
        if layer.electrodes is not None and not one.is_piezoelectric:
            raise wrong(
                here,
                "an electrode on a material that is not piezoelectric",
                got=one.name,
                expected="a piezoelectric material",
                hint=advise_missing_ceramic_keys({f"layers[{i}].material": layer.material})
                or "delete the key `electrodes` of this layer",
            )
        poled = one.rotate_z_axis((0, 0, 1 if layer.poling == "up" else -1))
        quality = layer.quality or one.quality
        poled = replace(poled, name=f"layers[{i}] ({one.name})", quality=quality)
        result.append(Block(((0.0, layer.diameter / 2), span), poled))
    return result


def _list_electrodes(disc: DiscKeys, pieces: list[Block], where: str) -> list[list[Box]]:
    """Return the faces of each electrode, from the lowest electrode to the highest.

    All faces that touch the same metal layer form one electrode.
    """
    result: list[list[Box]] = []
    last_metal: int | None = None
    heights = [0.0, *(piece.box[1][1] for piece in pieces)]
    for i, height in enumerate(heights):
        ceramic, metal = [], []
        for k in range(max(i - 1, 0), min(i + 1, len(pieces))):
            if pieces[k].material.is_piezoelectric:
                ceramic.append(k)
            if pieces[k].material.conductor:
                metal.append(k)
        if not ceramic:
            continue
        if not metal:
            result.append(_list_electrode_faces(disc, ceramic, height, i - 1, where))
            continue
        radius = min(pieces[ceramic[0]].box[0][1], pieces[metal[0]].box[0][1])
        if metal[0] != last_metal:
            result.append([])
        result[-1].append(_make_ring(0.0, radius, height))
        last_metal = metal[0]
    return result


def _list_electrode_faces(
    disc: DiscKeys, ceramic: list[int], height: float, below: int, where: str
) -> list[Box]:
    """Return the faces of an electrode that is on ceramic and touches no metal layer.

    The feedback electrode and its gap are cut out of the electrode.
    """
    layers = [disc.layers[k] for k in ceramic]
    diameters = {layer.electrode_diameter for layer in layers}
    if len(diameters) > 1 and all(layer.electrodes for layer in layers):
        got = " and ".join(map("{:g} m".format, sorted(diameters)))
        where = f"{where}.layers.{ceramic[-1]}.electrodes"
        raise wrong(
            where,
            "two layers state different diameters of the electrode between them",
            got=got,
            expected="one diameter",
            hint="state electrodes in one of the two layers",
        )
    radius = min(diameters) / 2
    ring = disc.layers[below].feedback if below in ceramic else None
    if ring is None:
        return [_make_ring(0.0, radius, height)]
    inner, outer = ring.inner / 2 - ring.gap, ring.outer / 2 + ring.gap
    return [
        _make_ring(*pair, height) for pair in ((0.0, inner), (outer, radius)) if pair[0] < pair[1]
    ]


def _make_supports(disc: DiscKeys, pieces: list[Block], radius: float) -> list[tuple[str, Box]]:
    """Return the supported faces or circles, each with its fixed axes."""
    if disc.support == "free":
        return []
    if isinstance(disc.support, KnifeEdgeSupport):
        r = disc.support.node / 2
        lowest = next(piece.box[1][0] for piece in pieces if piece.box[0][1] >= r)
        return [("z", _make_ring(r, r, lowest))]
    rim = [piece.box[1] for piece in pieces if piece.box[0][1] >= radius * (1 - 1e-9)]
    z = rim[0][0], rim[-1][1]
    if disc.support == "clamped":
        return [("xz", ((radius, radius), z))]
    return [("z", _make_ring(radius, radius, sum(z) / 2))]


class Disc(BondedBody[DiscKeys]):
    """Part type ``disc``: layered disc with electrodes, such as a buzzer."""

    name = "disc"
    title = "circular layers with electrodes (axisymmetric piezoelectric FE, reduced)"
    schema = DiscKeys
    source = "FE (piezoelectric, axisymmetric)"
    base_is_optional = True
    structure = staticmethod(make_disc_blocks)
    optional_pins: ClassVar[Mapping[str, str]] = {
        "feedback": "layers.feedback",
        **BondedBody.optional_pins,
    }

    def describe_support(self, part: Part[DiscKeys]) -> str:
        """Describe how the body is supported, for the list of neglected effects."""
        support = part.keys.support
        if isinstance(support, KnifeEdgeSupport):
            return f"ideal knife edge, diameter {format_quantity(support.node, 'm')}"
        return f"ideal support: {support.replace('_', ' ')}"

    def make_models_on_rings(
        self,
        part: Part[DiscKeys],
        scene: GovernedScene,
        node: float | None,
        changes: Iterable[float],
    ) -> dict[float, FiniteElementModel]:
        """Return full models on supporting rings, keyed by the diameter [m] of the ring."""
        keys, used = part.keys, self.select_used_ports(part, scene)
        diameters = {"free": node, "simply_supported": keys.largest_diameter, "clamped": None}
        support = keys.support
        diameter = support.node if isinstance(support, KnifeEdgeSupport) else diameters[support]
        devices = dict[float, FiniteElementModel]()
        if diameter is None:
            return devices
        for change in changes:
            ring = diameter * (1 + change)
            if ring <= keys.largest_diameter:
                body = make_disc_blocks(
                    keys.model_copy(update={"support": KnifeEdgeSupport(node=ring)}), part.name
                )
                body = replace(body, faces=used.faces, moved=used.moved)
                devices[ring] = body.build_fe_model()
        return devices

    def checks(
        self, part: Part[DiscKeys], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check | RunEnergyBalance]:
        """Yield the checks of the body, and the check that its deflection is small.

        A free disc has no check, because its displacements include rigid-body motions.
        """
        yield from super().checks(part, build, waves)
        largest = self.find_largest_deflection(part, build, waves)
        if part.keys.support == "free" or largest is None:
            return
        clamped = part.keys.support == "clamped"
        factor = _CLAMPED_STRETCHING if clamped else _SUPPORTED_STRETCHING
        share = largest / sum(layer.thickness for layer in part.keys.layers)
        advice = (
            f"stretching, which the linear model neglects, stiffens the disc by about "
            f"{100 * factor * share**2:.2g} %; lower the drive"
        )
        name = f"largest deflection of {part.name}"
        label = f"peak deflection of {part.name} / thickness"
        limit = math.sqrt(MAX_STRETCHING / factor)
        yield Check(name, share, limit, "of the thickness", advice, "warn", label=label)

    def is_clamped(self, part: Part[DiscKeys]) -> bool:
        """Return whether the rim is clamped, so that air cannot flow around the body.

        Every support except ``free`` counts as clamped.
        """
        return part.keys.support != "free"


register_part_type(Disc())
