"""The keys that a scene may have: their dotted names, units, defaults and meaning."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, get_args

from pydantic import BaseModel, BeforeValidator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from kc2spice.scene.model import Frame
from kc2spice.scene.parttype import part_types
from kc2spice.scene.short import SHORT


@dataclass(frozen=True)
class Key:
    """One key of a scene file: ``unit`` is ``""`` for plain numbers and None for what is none."""

    name: str
    unit: str | None
    default: Any
    choices: tuple[str, ...]
    doc: str


def submodel(annotation: Any) -> type[BaseModel] | None:
    """The section behind a field's annotation (``Kick`` for ``Kick | None``), if it is one."""
    for candidate in (annotation, *get_args(annotation)):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None


def _unit(field: FieldInfo) -> str | None:
    """SI unit that the validator of a number (or of each number of a list) converts to."""
    nested = [meta for arg in get_args(field.annotation) for meta in get_args(arg)[1:]]
    for meta in (*field.metadata, *nested):
        if isinstance(meta, BeforeValidator) and isinstance(meta.func, partial):
            return str(meta.func.args[0])
    return None


def _choices(annotation: Any) -> tuple[str, ...]:
    return tuple(arg for arg in get_args(annotation) if isinstance(arg, str))


def model_keys(model: type[BaseModel], prefix: str = "") -> Iterator[Key]:
    """All keys of a schema in its order, those of its tables by dotted names."""
    for name, field in model.model_fields.items():
        section = submodel(field.annotation)
        dotted = f"{prefix}{field.alias or name}"
        if section is not None:
            yield from model_keys(section, f"{dotted}.")
            continue
        default = None if field.default is PydanticUndefined else field.default
        yield Key(
            dotted, _unit(field), default, _choices(field.annotation), field.description or ""
        )


def scene_keys() -> Iterator[Key]:
    """All keys of all scenes: those of no part, then those of each part type.

    A part's keys stand under the name that needs no ``part`` key, else under the type's name.
    """
    yield from model_keys(Frame)
    short = {kind: name for name, kind in SHORT.items()}
    for name, kind in part_types().items():
        yield from model_keys(kind.schema, f"{short.get(name, name)}.")
