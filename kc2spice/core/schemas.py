"""Paths, units and ranges of plausible values of the keys in a table's schema."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, BeforeValidator
from pydantic.fields import FieldInfo

from kc2spice.core.quantities import PlausibleRange, UsualRange

KeyPath = tuple[str | int, ...]
T = TypeVar("T")


def list_keys(schema: type[BaseModel]) -> Iterator[tuple[tuple[str, ...], FieldInfo]]:
    """Yield the path and the field of each key in a schema, including subtables."""
    for name, field in schema.model_fields.items():
        section, path = find_section(field.annotation), (field.alias or name,)
        if section is None:
            yield path, field
            continue
        for below, item in list_keys(section):
            yield path + below, item


def find_section(annotation: Any) -> type[BaseModel] | None:
    """Find the section class, which declares a key table, in a type annotation.

    The result is None if the type annotation contains no section class.
    """
    for candidate in (annotation, *get_args(annotation)):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None


def _list_field_metadata(field: FieldInfo) -> Iterator[Any]:
    """Yield the metadata of a schema field, and of its element type for a list."""
    yield from field.metadata
    for argument in get_args(field.annotation):
        yield from get_args(argument)[1:]


def find_unit(field: FieldInfo) -> str | None:
    """Return the SI unit of a numeric field; None for a field without a unit.

    All numbers of a list have the same unit.
    """
    for meta in _list_field_metadata(field):
        if isinstance(meta, BeforeValidator) and isinstance(meta.func, partial):
            return str(meta.func.args[0])
    return None


def get_plausible_range(field: FieldInfo) -> PlausibleRange | None:
    """Return the range of plausible values of a schema field; None if it has no range."""
    return _find_metadata(field, PlausibleRange)


def get_usual_range(field: FieldInfo) -> UsualRange | None:
    """Return the range of usual values of a schema field; None if it has no range."""
    return _find_metadata(field, UsualRange)


def _find_metadata(field: FieldInfo, kind: type[T]) -> T | None:
    """Find the first metadata of a schema field that is an instance of ``kind``."""
    return next((meta for meta in _list_field_metadata(field) if isinstance(meta, kind)), None)


def join_path(path: KeyPath) -> str:
    """Join keys and list indices to a text such as ``layers[0].thickness``."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".")
