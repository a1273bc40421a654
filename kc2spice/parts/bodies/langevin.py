"""The part ``langevin``: a bolted ultrasonic transducer with ceramic rings.

The ceramic rings have alternating poling directions. Touching pieces are bonded. The bolt is bonded
to both masses along its thread, but not to the rings. The electrical pins are ``anode`` and
``cathode``; both masses are connected to the cathode. The mechanical ports ``front`` and ``back``
are the mean axial displacements of the two end faces, positive towards the front. The model
neglects the effect of the preload on the ceramic, the compliance of the contacts between pieces,
and the metal of the electrodes.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from kc2spice.bodies.solid_models import (
    BACK_FACE,
    FRONT_FACE,
    Block,
    BondedBlocks,
    Box,
    RadiatingFace,
)
from kc2spice.core.errors import wrong
from kc2spice.core.key_actions import ChangeKey, Hint
from kc2spice.core.key_errors import validate_table
from kc2spice.core.quantities import (
    Count,
    Extent,
    Length,
    QFactor,
    Section,
    Thickness,
    Width,
    make_invalid_value_error,
)
from kc2spice.fem.body_keys import BodyMeshKeys, DampingKeys
from kc2spice.fem.materials import advise_missing_ceramic_keys, find_material
from kc2spice.parts.bodies._linear_body_keys import FieldKeys
from kc2spice.parts.bodies._meshed_bodies import BondedBody
from kc2spice.parts.bodies._neglected_effects import NOT_ESTIMATED_TEXT
from kc2spice.scene.part_records import NeglectedEffect
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import Part, Scene

_RADIAL_CELLS = 8  # number of mesh cells along the largest radius, for ``mesh.refine = 1``


class PieceKeys(Section):
    """Keys common to all pieces of the transducer."""

    material: str | dict[str, Any] = Field(
        examples=['"steel"'],
        description="Material of this piece of the transducer: a name, or a table of constants",
    )
    quality: QFactor | None = Field(
        None,
        gt=0,
        description=(
            "Mechanical Q factor of this piece of the transducer, used if "
            "damping.per_material is true"
        ),
    )


class CylinderKeys(PieceKeys):
    """Keys of a cylindrical section of the front or back mass."""

    diameter: Width = Field(
        gt=0, description="Outer diameter of a cylindrical section of the front or back mass"
    )
    length: Extent = Field(
        gt=0,
        description="Length of a cylindrical section of the front or back mass along the axis",
    )


class RingStackKeys(PieceKeys):
    """Keys of a stack of equal ceramic rings with an even number of rings.

    The number of rings is even, so that both masses are connected to the cathode.
    """

    outer: Width = Field(gt=0, description="Outer diameter of the ceramic rings")
    inner: Length = Field(gt=0, description="Diameter of the bore of the ceramic rings")
    thickness: Thickness = Field(gt=0, description="Thickness of one ceramic ring")
    count: Count = Field(
        2,
        ge=2,
        le=20,
        description="Number of ceramic rings in the transducer; must be an even number",
    )

    @model_validator(mode="after")
    def _require_valid_rings(self) -> RingStackKeys:
        """Reject an odd number of rings, and an inner diameter above the outer diameter."""
        if self.count % 2:
            raise make_invalid_value_error(
                "the number of rings is odd, so the bolt short-circuits anode and cathode",
                None,
                hint=f"write count = {self.count + 1}",
            )
        if self.inner >= self.outer:
            raise make_invalid_value_error(
                "the inner diameter is not smaller than the outer diameter",
                None,
                hint=f"reduce `inner` to less than {self.outer:g} m, or swap `inner` and `outer`",
            )
        return self


class BoltKeys(PieceKeys):
    """Keys of the bolt, which passes through the back mass and ends in the front mass.

    ``depth`` is the length of the bolt inside the front mass. The head of the bolt, if it has one,
    is at the free end of the back mass.
    """

    diameter: Width = Field(gt=0, description="Diameter of the shank of the bolt")
    depth: Width | None = Field(
        None,
        gt=0,
        description=(
            "Length of the bolt inside the front mass; by default the length of the front "
            "cylinder next to the ceramic rings"
        ),
    )
    head_diameter: Length | None = Field(
        None, gt=0, description="Diameter of the bolt's head; requires the key `head_length`"
    )
    head_length: Length | None = Field(
        None, gt=0, description="Length of the bolt's head; requires the key `head_diameter`"
    )

    @model_validator(mode="after")
    def _require_complete_head(self) -> BoltKeys:
        """Reject a bolt head with only one of the keys for diameter and length."""
        if (self.head_diameter is None) != (self.head_length is None):
            raise make_invalid_value_error(
                "head_diameter and head_length must be used together",
                None,
                hint="add the missing one of the two keys",
            )
        return self


class LangevinKeys(FieldKeys):
    """Keys of a bolted transducer; each end mass is a list of cylindrical sections.

    The sections of an end mass are listed from the rings outwards.
    """

    front: tuple[CylinderKeys, ...] = Field(
        examples=['[{ material = "aluminium", diameter = "20 mm", length = "20 mm" }]'],
        min_length=1,
    )
    back: tuple[CylinderKeys, ...] = Field(
        examples=['[{ material = "steel", diameter = "20 mm", length = "20 mm" }]'], min_length=1
    )
    rings: RingStackKeys
    bolt: BoltKeys
    support: Literal["free", "back"] = Field(
        "free",
        description="Mechanical support of the transducer: free, or clamped at the back face",
    )
    damping: DampingKeys = DampingKeys()
    mesh: BodyMeshKeys = BodyMeshKeys()

    @model_validator(mode="after")
    def _require_fitting_pieces(self) -> LangevinKeys:
        """Reject pieces of a bolted transducer that do not fit together."""
        bolt, inner, masses = self.bolt, self.rings.inner, (*self.front, *self.back)
        depth, head = bolt.depth or self.front[0].length, bolt.head_diameter or math.inf
        wrong = {
            "bolt.diameter: the bolt does not pass through the rings": bolt.diameter >= inner,
            "bolt.diameter: the bolt is thicker than a mass": bolt.diameter
            >= min(step.diameter for step in masses),
            "bolt.depth: the bolt reaches through the front mass": depth
            > sum(step.length for step in self.front) * (1 + 1e-9),
            "rings.inner: a mass falls through the rings": inner
            >= min(self.front[0].diameter, self.back[0].diameter),
            "bolt.head_diameter: the head is no wider than the bolt": head <= bolt.diameter,
        }
        for problem, applies in wrong.items():
            if applies:
                key = problem.partition(":")[0]
                action = "lower" if key in ("bolt.depth", "rings.inner") else "correct"
                hint: Hint = f"{action} {key}"
                if problem.startswith("bolt.diameter"):
                    limit = min(inner, *(m.diameter for m in masses))
                    hint = ChangeKey("lower", key, "below", f"{limit:g} m")
                elif key == "bolt.head_diameter":
                    hint = ChangeKey("raise", key, "above", f"{bolt.diameter:g} m")
                raise make_invalid_value_error(problem, None, hint=hint)
        return self


def make_langevin_blocks(
    keys: LangevinKeys | Mapping[str, Any], where: str = "langevin"
) -> BondedBlocks:
    """Return the blocks of a bolted transducer with electrodes, support and ports.

    Raises
    ------
    UsageError : a key is invalid, or the pieces of the transducer do not fit together.
    """
    body = validate_table(LangevinKeys, keys, where)
    pieces, rings = _make_blocks(body, where), body.rings
    boxes = np.array([piece.box for piece in pieces])
    bottom, top = float(boxes[:, 1].min()), float(boxes[:, 1].max())
    under = (body.bolt.head_diameter or body.back[-1].diameter) / 2
    back: Box = ((0.0, under), (bottom, bottom))
    ports: dict[str, Box] = {"front": ((0.0, body.front[-1].diameter / 2), (top, top))}
    fixed = body.support == "back"
    faces = {FRONT_FACE: RadiatingFace(ports["front"], upward=True)}
    if not fixed:
        faces[BACK_FACE] = RadiatingFace(back, upward=False)
    across = (rings.inner / 2, rings.outer / 2)
    planes = [(across, (i * rings.thickness,) * 2) for i in range(rings.count + 1)]
    return BondedBlocks(
        pieces,
        {"anode": planes[1::2], "cathode": planes[::2]},
        ports=ports if fixed else ports | {"back": back},
        fixed=[("xz", back)] if fixed else (),
        faces=faces,
        size=float(boxes[:, 0, 1].max()) / _RADIAL_CELLS,
        refine=body.mesh.refine,
        damping=body.damping,
        where=where,
    )


def _make_blocks(body: LangevinKeys, where: str) -> list[Block]:
    """Return the blocks of a bolted transducer: rings, front mass, back mass and bolt."""
    result: list[Block] = []

    def add_block(
        piece: PieceKeys, key: str, radii: tuple[float, float], low: float, high: float, up: int = 1
    ) -> None:
        """Add a block that lies between two heights and has a poling direction.

        ``up`` is the sign of the poling along z.
        """
        one = find_material(piece.material, f"{where}.{key}.material")
        quality = piece.quality or one.quality
        poled = replace(one.rotate_z_axis((0, 0, up)), name=f"{key} ({one.name})", quality=quality)
        result.append(Block((radii, (low, high)), poled))

    rings, bolt = body.rings, body.bolt
    core, ring = bolt.diameter / 2, (rings.inner / 2, rings.outer / 2)
    for i in range(rings.count):
        add_block(
            rings, f"rings[{i}]", ring, i * rings.thickness, (i + 1) * rings.thickness, (-1) ** i
        )
    if not result[0].material.is_piezoelectric:
        raise wrong(
            f"{where}.rings.material",
            "the rings are not piezoelectric",
            got=result[0].material.name,
            expected="a piezoelectric material",
            hint=advise_missing_ceramic_keys({"rings.material": rings.material})
            or 'write  material = "PZT-4"  for the rings',
        )
    height = rings.count * rings.thickness
    thread = height + (bolt.depth or body.front[0].length)
    for i, step in enumerate(body.front):
        add_block(step, f"front[{i}]", (0.0, step.diameter / 2), height, height + step.length)
        height += step.length
    height = 0.0
    for i, step in enumerate(body.back):
        add_block(step, f"back[{i}]", (0.0, step.diameter / 2), height - step.length, height)
        height -= step.length
    add_block(bolt, "bolt", (0.0, core), height, thread)
    if bolt.head_diameter is not None and bolt.head_length is not None:
        add_block(bolt, "bolt", (0.0, bolt.head_diameter / 2), height - bolt.head_length, height)
    return result


class Langevin(BondedBody[LangevinKeys]):
    """Part type ``langevin``: bolted sandwich transducer."""

    name = "langevin"
    title = "bolted sandwich transducer (axisymmetric piezoelectric FE, reduced)"
    schema = LangevinKeys
    example = """
[langevin]
part = "langevin"
front = [{ material = "aluminium", diameter = "20 mm", length = "30 mm" }]
back = [{ material = "steel", diameter = "20 mm", length = "20 mm" }]
rings = { material = "PZT-8", outer = "20 mm", inner = "8 mm", thickness = "3 mm" }
bolt = { material = "steel", diameter = "6 mm" }
pins = { anode = "drive.out" }

[drive]
part = "source"
ac = "1 V"

[analysis]
type = "ac"
start = "10 kHz"
stop = "100 kHz"
"""
    source = "FE (piezoelectric, axisymmetric)"
    structure = staticmethod(make_langevin_blocks)

    def describe_support(self, part: Part[LangevinKeys]) -> str:
        """Describe how the body is supported, for the list of neglected effects."""
        return f"ideal support: {part.keys.support.replace('_', ' ')}"

    def list_neglected_effects(
        self, part: Part[LangevinKeys], scene: Scene
    ) -> Iterator[NeglectedEffect]:
        """Yield the neglected effects, such as the preload of the bolt."""
        yield from super().list_neglected_effects(part, scene)
        why = "the pieces are bonded and free of stress at rest"
        yield NeglectedEffect(
            f"{part.name}: preload of the bolt, compliance of joints", why, NOT_ESTIMATED_TEXT
        )


register_part_type(Langevin())
