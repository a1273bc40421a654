"""Lists of the keys of scenes and part types, with units, defaults and choices."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain
from types import NoneType
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from kc2spice.core.schemas import find_unit, list_keys
from kc2spice.scene.model import DEFAULT_TABLES, Scene
from kc2spice.scene.parttype import load_part_types
from kc2spice.scene.settings import ProbeKeys, SceneKeys


@dataclass(frozen=True)
class KeyDescription:
    """Description of a key of a scene file.

    ``unit`` is ``""`` for plain numbers, and None for values other than numbers. ``integer`` marks
    whole numbers, and ``mixed`` marks numbers whose unit depends on other keys.
    """

    name: str
    unit: str | None
    default: Any
    choices: tuple[str, ...]
    doc: str
    integer: bool = False
    mixed: bool = False


def _list_annotation_types(annotation: Any) -> Iterator[Any]:
    """Yield the types and the literal choices in an annotation."""
    arguments = get_args(annotation)
    return (
        chain.from_iterable(map(_list_annotation_types, arguments))
        if arguments
        else iter((annotation,))
    )


def list_schema_keys(model: type[BaseModel], prefix: str = "") -> Iterator[KeyDescription]:
    """Yield all keys of a schema in order, with dotted names for the keys of subtables."""
    for path, field in list_keys(model):
        default = _find_default(field)
        doc, kinds = (
            field.description or "",
            dict.fromkeys(_list_annotation_types(field.annotation)),
        )
        words = tuple(kind for kind in kinds if isinstance(kind, str))
        choices = words if kinds.keys() <= {*words, NoneType} else ()
        integer = int in kinds or int in map(type, kinds)
        mixed = {float, str} <= kinds.keys()
        name = prefix + ".".join(path)
        yield KeyDescription(name, find_unit(field), default, choices, doc, integer, mixed)


def _find_default(field: FieldInfo) -> Any:
    """Return the default of a key; None if the key is required."""
    if field.is_required():
        return None
    return field.get_default(call_default_factory=True, validated_data={})


def list_all_keys() -> Iterator[KeyDescription]:
    """Yield all keys that scenes may contain: keys outside of parts, then keys of part types.

    The prefix of the keys of a part type is the name of the part type, or the name of the table
    that needs no key ``part``.
    """
    yield from list_schema_keys(SceneKeys)
    for name, kind in load_part_types().items():
        yield from list_schema_keys(kind.schema, f"{DEFAULT_TABLES.get(name, name)}.")


def list_scene_keys(scene: Scene) -> dict[str, KeyDescription]:
    """Return the keys of one scene, keyed by dotted name."""
    result = [key for key in list_schema_keys(SceneKeys) if not key.name.startswith("probes.")]
    for name in scene.probes:
        result += list_schema_keys(ProbeKeys, f"probes.{name}.")
    for part in scene.parts.values():
        if part.at != (part.name,):  # another part generates this part
            part_keys = list_schema_keys(type(part.keys), f"{part.key_prefix}.")
            result += [
                _with_unit_of_part(key, getattr(part.keys, "unit", None)) for key in part_keys
            ]
    return {key.name: key for key in result}


def _with_unit_of_part(key: KeyDescription, unit: Any) -> KeyDescription:
    """Return ``key`` with the unit that other keys of its part determine, if any."""
    follows = key.unit is None and not key.integer and not key.choices and key.mixed
    return replace(key, unit=unit if isinstance(unit, str) else "") if follows else key
