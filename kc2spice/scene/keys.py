"""Lists of the keys of scenes and part types, with units, defaults and choices."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import chain
from types import NoneType
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from kc2spice.core.schemas import find_section, find_unit, list_keys
from kc2spice.scene.parttype import load_part_types
from kc2spice.scene.scene_classes import DEFAULT_TABLES, Scene
from kc2spice.scene.settings import ProbeKeys, SceneKeys

# Keys and tables of many part types, which are listed last.
GENERAL_KEYS = ("damping", "rated_voltage", "number", "fields", "mesh", "rom")


@dataclass(frozen=True)
class KeyDescription:
    """Description of a key of a scene file.

    ``unit`` is ``""`` for plain numbers, and None for values other than numbers. ``integer`` marks
    whole numbers, and ``mixed`` marks numbers whose unit depends on other keys. If ``required`` is
    true, the key must be stated in every table to which the key belongs. If ``of_netlist`` is true,
    the key is a parameter of a netlist, whose values may have suffixes of SPICE, as in ``3.3m``.
    """

    name: str
    unit: str | None
    default: Any
    choices: tuple[str, ...]
    doc: str
    integer: bool = False
    mixed: bool = False
    required: bool = False
    of_netlist: bool = False


def _list_annotation_types(annotation: Any) -> Iterator[Any]:
    """Yield the types and the literal choices in a type annotation."""
    arguments = get_args(annotation)
    return (
        chain.from_iterable(map(_list_annotation_types, arguments))
        if arguments
        else iter((annotation,))
    )


def list_schema_keys(model: type[BaseModel], prefix: str = "") -> Iterator[KeyDescription]:
    """Yield all keys of a schema in order, with dotted names for keys of subtables."""
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
        yield KeyDescription(
            name, find_unit(field), default, choices, doc, integer, mixed, field.is_required()
        )


def list_part_keys(model: type[BaseModel]) -> list[KeyDescription]:
    """Return all keys of a part type, in the order of their importance.

    Required tables and keys are first, and :data:`GENERAL_KEYS` of many part types are last. The
    returned list includes tables that have a description of their own, such as ``layers``. The
    returned list also includes keys whose value may be a table, such as ``fluid``.
    """
    keys = [*_list_described_tables(model), *list_schema_keys(model)]
    required = {key.alias or name for name, key in model.model_fields.items() if key.is_required()}
    names = {(field.alias or name): k for k, (name, field) in enumerate(model.model_fields.items())}

    def rank_key(key: KeyDescription) -> tuple[bool, int, int, bool, bool]:
        """Rank a part's key for sorting: by its table, then by its place in the table."""
        table, _, below = key.name.partition(".")
        general = GENERAL_KEYS.index(table) if table in GENERAL_KEYS else -1
        # a required key of a table inside another table does not count as needed
        needed = key.required and "." not in below
        return table not in required, general, names[table], bool(below), not needed

    return sorted(keys, key=rank_key)


def _list_described_tables(model: type[BaseModel]) -> Iterator[KeyDescription]:
    """Yield the tables of a schema that have a description of their own."""
    for name, field in model.model_fields.items():
        if find_section(field.annotation) is not None and field.description:
            kinds = dict.fromkeys(_list_annotation_types(field.annotation))
            words = tuple(kind for kind in kinds if isinstance(kind, str))
            default = _find_default(field) if words else None
            yield KeyDescription(
                field.alias or name, None, default, words, field.description,
                required=field.is_required(),
            )  # fmt: skip


def _find_default(field: FieldInfo) -> Any:
    """Return the default of a key, or None if the key is required."""
    if field.is_required():
        return None
    return field.get_default(call_default_factory=True, validated_data={})


def list_all_keys() -> Iterator[KeyDescription]:
    """Yield all keys of scenes: keys outside of parts, then keys of part types.

    The keys of a part type have the name of the part type as prefix. If a table name, such as
    ``kick``, selects a part type without the key ``part``, the prefix of the type's keys is this
    table name.
    """
    yield from list_schema_keys(SceneKeys)
    for name, kind in load_part_types().items():
        yield from list_schema_keys(kind.schema, f"{DEFAULT_TABLES.get(name, name)}.")


def list_scene_keys(scene: Scene) -> dict[str, KeyDescription]:
    """List the keys of one scene: their descriptions, keyed by dotted name."""
    result = [key for key in list_schema_keys(SceneKeys) if not key.name.startswith("probes.")]
    for name in scene.probes:
        result += list_schema_keys(ProbeKeys, f"probes.{name}.")
    for part in scene.parts.values():
        if part.at != (part.name,):  # a part with the path (name,) is generated by another part
            part_keys = list_schema_keys(type(part.keys), f"{part.key_prefix}.")
            result += [_apply_part_unit(key, getattr(part.keys, "unit", None)) for key in part_keys]
    return {key.name: key for key in result}


def _apply_part_unit(key: KeyDescription, unit: Any) -> KeyDescription:
    """Give a key description the part's unit, if the key takes its unit from the part."""
    follows = key.unit is None and not key.integer and not key.choices and key.mixed
    return replace(key, unit=unit if isinstance(unit, str) else "") if follows else key
