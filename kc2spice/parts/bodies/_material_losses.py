"""Losses that the materials of a body state, and whether the model of the body uses them.

The tables of materials, and some pieces of bodies, state a Q factor and a loss tangent. A model
uses these values only if the key ``damping.per_material`` of the body is true.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from pydantic import BaseModel

from kc2spice.core.errors import UsageError
from kc2spice.fem.body_keys import DampingKeys
from kc2spice.fem.materials import Material, find_material, find_stated_losses
from kc2spice.scene.part_records import NeglectedEffect
from kc2spice.scene.plausibility import UnusualValueError


@dataclass(frozen=True)
class StatedMaterial:
    """Material in the keys of a body: its dotted key, its name or table, and its constants.

    Some pieces of bodies, such as layers, have a key ``quality`` beside the key ``material``.
    ``piece_quality`` contains the dotted name and the value of this key, or is None without it.
    """

    key: str
    name_or_table: str | Mapping[str, Any]
    material: Material
    piece_quality: tuple[str, float] | None = None

    @property
    def own_losses(self) -> dict[str, Any]:
        """Loss values that the scene states for this material, keyed by dotted key."""
        result = {
            f"{self.key}.{name}": x for name, x in find_stated_losses(self.name_or_table).items()
        }
        return result | dict([self.piece_quality] if self.piece_quality else [])


def list_stated_materials(keys: BaseModel, base: str = "") -> Iterator[StatedMaterial]:
    """Yield the materials in the keys of a body.

    ``base`` is the name of the built-in material that supplies the missing values of a table.

    Raises
    ------
    UsageError : a material does not exist, or its table is invalid.
    """

    def read(key: str, name_or_table: Any, piece: Any = None) -> StatedMaterial:
        """Read the material at a dotted key, and the Q factor in the same table."""
        full = name_or_table
        if base and isinstance(name_or_table, Mapping):
            full = {"like": base, **name_or_table}
        quality = getattr(piece, "quality", None)
        piece_key = f"{key.removesuffix('material')}quality"
        stated = None if quality is None else (piece_key, quality)
        return StatedMaterial(key, name_or_table, find_material(full, key), stated)

    def walk(value: Any, key: str) -> Iterator[StatedMaterial]:
        """Yield the materials inside the value of a dotted key."""
        if isinstance(value, list | tuple):
            for number, item in enumerate(value):
                yield from walk(item, f"{key}[{number}]")
        if not isinstance(value, BaseModel):
            return
        for name in type(value).model_fields:
            item, inner = getattr(value, name), f"{key}.{name}" if key else name
            if name == "material" and item is not None:
                yield read(inner, item, value)
            elif name == "materials" and isinstance(item, Mapping):
                for group, name_or_table in item.items():
                    yield read(f"{inner}.{group}", name_or_table)
            else:
                yield from walk(item, inner)

    yield from walk(keys, "")


def find_largest_tangent(keys: BaseModel, base: str = "") -> float:
    """Return the largest loss tangent of the piezoelectric materials of a body, or 0."""
    materials = (item.material for item in list_stated_materials(keys, base))
    return max((m.loss_tangent or 0.0 for m in materials if m.is_piezoelectric), default=0.0)


def find_unused_losses(
    name: str, keys: BaseModel, damping: DampingKeys, base: str = ""
) -> Iterator[UsageError]:
    """Yield a warning for each loss of a material that the scene states and no model uses."""
    stated = [*list_stated_materials(keys, base)]
    complete = all(
        item.piece_quality is not None or item.material.quality is not None for item in stated
    )
    for item in stated:
        for key, value in item.own_losses.items():
            dielectric = key.endswith(".loss_tangent")
            reason = "`damping` sets the loss of the whole body"
            hint = f"write  {name}.damping = {{ per_material = true }}"
            if not complete:
                hint += ", and a `quality` for every material"
            if dielectric and not item.material.is_piezoelectric:
                reason = "the model contains the electric field only in piezoelectric materials"
                hint = f"delete {name}.{key}"
            elif dielectric and damping.loss_tangent == item.material.loss_tangent:
                continue
            elif dielectric and damping.loss_tangent is not None:
                reason = "`damping.loss_tangent` sets the loss tangent of the whole body"
                hint = f"delete {name}.{key}"
            elif dielectric and not damping.per_material and not complete:
                # the table may state a text such as "3 %", but the hint contains a number
                hint = f"write  {name}.damping.loss_tangent = {item.material.loss_tangent}"
            elif damping.per_material:
                continue
            yield UnusualValueError(
                f"not used, because {reason}", where=f"{name}.{key}", got=str(value), hint=hint
            )


def list_neglected_losses(
    name: str, keys: BaseModel, damping: DampingKeys, base: str = ""
) -> Iterator[NeglectedEffect]:
    """Yield each dielectric loss that the model of a body neglects although the scene needs it.

    With losses per material, the scene needs the loss tangent of every piezoelectric material.
    Otherwise, the scene needs the loss tangents that its own tables of materials state.
    """
    for item in list_stated_materials(keys, base):
        tangent = item.material.loss_tangent
        if not item.material.is_piezoelectric or damping.loss_tangent is not None:
            continue
        built_in = isinstance(item.name_or_table, str)
        effect = f"{name}: dielectric loss of {item.name_or_table if built_in else item.key}"
        if damping.per_material and tangent is None:
            yield NeglectedEffect(effect, "its loss_tangent is not known", "not estimated")
        elif not damping.per_material and f"{item.key}.loss_tangent" in item.own_losses:
            why = "damping.loss_tangent is not stated"
            yield NeglectedEffect(effect, why, f"a loss tangent of {tangent:g}")


def describe_unused_loss_tangents(
    keys: BaseModel, damping: DampingKeys, base: str = ""
) -> Iterator[str]:
    """Yield a note if a model neglects the loss tangents of its built-in materials."""
    known = dict[str, float]()
    for item in list_stated_materials(keys, base):
        tangent, is_built_in = item.material.loss_tangent, isinstance(item.name_or_table, str)
        if is_built_in and item.material.is_piezoelectric and tangent:
            known[str(item.name_or_table)] = tangent
    if known and damping.loss_tangent is None and not damping.per_material:
        texts = ", ".join(f"{tangent:g} of {material}" for material, tangent in known.items())
        yield f"no dielectric loss, because damping.loss_tangent is not stated ({texts})"
