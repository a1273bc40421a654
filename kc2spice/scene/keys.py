"""Scenes and part types as a reference: keys with units, defaults and meaning, pins, examples."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, replace
from types import NoneType
from typing import Any, get_args

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from kc2spice.core.quantities import entries, unit_of
from kc2spice.core.untrusted_files import parse_toml
from kc2spice.scene.load import load_scene
from kc2spice.scene.model import DEFAULT_TABLES, Part, Scene, Terminal
from kc2spice.scene.parttype import part_types
from kc2spice.scene.scene_file import list_gallery
from kc2spice.scene.settings import Frame, Probe


@dataclass(frozen=True)
class Key:
    """One key of a scene file: ``unit`` is ``""`` for plain numbers and None for what is none.

    ``integer`` marks whole numbers, ``mixed`` numbers whose unit follows from other keys.
    """

    name: str
    unit: str | None
    default: Any
    choices: tuple[str, ...]
    doc: str
    integer: bool = False
    mixed: bool = False


def _kinds(annotation: Any) -> Iterator[Any]:
    """Types and choices that an annotation is made of."""
    inner = get_args(annotation)
    yield from (kind for arg in inner for kind in _kinds(arg)) if inner else (annotation,)


def model_keys(model: type[BaseModel], prefix: str = "") -> Iterator[Key]:
    """All keys of a schema in its order, those of its tables by dotted names."""
    for path, field in entries(model):
        default = _default(field)
        doc, kinds = field.description or "", dict.fromkeys(_kinds(field.annotation))
        words = tuple(kind for kind in kinds if isinstance(kind, str))
        choices = words if kinds.keys() <= {*words, NoneType} else ()
        integer, mixed = (
            any(k is int or type(k) is int for k in kinds),
            {float, str} <= kinds.keys(),
        )
        name = prefix + ".".join(path)
        yield Key(name, unit_of(field), default, choices, doc, integer, mixed)


def _default(field: FieldInfo) -> Any:
    """Default of a key, None if it has none. Keys that it follows from have their defaults."""
    if field.is_required():
        return None
    return field.get_default(call_default_factory=True, validated_data={})


def scene_keys() -> Iterator[Key]:
    """All keys of all scenes: those of no part, then those of each part type.

    A part's keys stand under the name that needs no ``part`` key, else under the type's name.
    """
    yield from model_keys(Frame)
    for name, kind in part_types().items():
        yield from model_keys(kind.schema, f"{DEFAULT_TABLES.get(name, name)}.")


def keys_of(scene: Scene) -> dict[str, Key]:
    """All keys of one scene by their dotted names, those of its parts under the parts' names."""
    result = [key for key in model_keys(Frame) if not key.name.startswith("probes.")]
    for name in scene.probes:
        result += model_keys(Probe, f"probes.{name}.")
    for part in scene.parts.values():
        if part.at != (part.name,):  # else another part's keys say all
            part_keys = model_keys(type(part.keys), f"{part.key_prefix}.")
            result += [_with_unit(key, getattr(part.keys, "unit", None)) for key in part_keys]
    return {key.name: key for key in result}


def _with_unit(key: Key, unit: Any) -> Key:
    """``key``, in the unit of its part if it is a number or text whose unit follows from others."""
    follows = key.unit is None and not key.integer and not key.choices and key.mixed
    return replace(key, unit=unit if isinstance(unit, str) else "") if follows else key


@dataclass(frozen=True)
class PartDoc:
    """One part type; ``scene`` is the built-in scene that pins and example are from, if any."""

    name: str
    title: str
    doc: str
    pins: tuple[Terminal, ...]
    keys: tuple[Key, ...]
    example: str
    scene: str | None
    short_for: tuple[str, ...]


def part_docs() -> Iterator[PartDoc]:
    """All part types in the order of their names."""
    examples = _in_gallery()
    for name, kind in part_types().items():
        scene_name: str | None = None
        pins: tuple[Terminal, ...] = ()
        example = kind.example
        if example:
            scene = load_scene({"name": "example", **parse_toml(example)})
            pins = kind.pins(scene.of(name)[0], replace(scene, ports="all"))
        elif name in examples:
            scene_name, part, scene = examples[name]
            pins = kind.pins(part, replace(scene, ports="all"))
            tables = list_gallery()[scene_name].read_text().split("\n\n")
            heading = rf"(#.*\n)*\[{part.name}[].]"
            example = "\n\n".join(table for table in tables if re.match(heading, table))
        yield PartDoc(
            name,
            kind.title,
            " ".join((kind.schema.__doc__ or "").split()),
            pins,
            tuple(model_keys(kind.schema)),
            example.strip(),
            scene_name,
            (DEFAULT_TABLES[name],) if name in DEFAULT_TABLES else (),
        )


def _in_gallery() -> dict[str, tuple[str, Part, Scene]]:
    """The first built-in scene with a part of each type."""
    result: dict[str, tuple[str, Part, Scene]] = {}
    for name in list_gallery():
        scene = load_scene(name)
        for part in scene.parts.values():
            result.setdefault(part.type.name, (name, part, scene))
    return result
