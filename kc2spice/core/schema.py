"""Checking a table against a schema, with an error that names the key."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ValidationError

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Section

Schema = TypeVar("Schema", bound=Section)


def validated(
    schema: type[Schema],
    table: Mapping[str, Any] | Schema,
    where: str,
    context: Mapping[str, Any] | None = None,
) -> Schema:
    """``table`` as a ``schema``; one that is already passes unchanged.

    ``where`` is a key, or ends in a colon and is a file; validators see the ``context``.

    Raises
    ------
    UsageError : a key is unknown, missing, of the wrong unit, or contradicts another.
    """
    if isinstance(table, schema):
        return table
    try:
        return schema.model_validate(
            dict(table) if isinstance(table, Mapping) else table, context=context
        )
    except ValidationError as error:
        found = error.errors()
        first = next((each for each in found if each["type"] == "extra_forbidden"), found[0])
        key = "".join(f"[{k}]" if isinstance(k, int) else f".{k}" for k in first["loc"])
        key = key.removeprefix(".")
        inside = f"{where} {key}" if where.endswith(":") else f"{where}.{key}"
        raise UsageError(
            first["msg"].removeprefix("Value error, "),
            where=inside if key else where.removesuffix(":"),
            got=None if first["type"] == "missing" or not key else str(first["input"])[:200],
            expected=first.get("ctx", {}).get("expected"),
            hint=f"keys: {', '.join(_table(schema, first['loc']).model_fields)}",
        ) from None


def _table(schema: type[BaseModel], location: Sequence[int | str]) -> type[BaseModel]:
    """The innermost schema on the way to ``location``."""
    for step in location[:-1]:
        if step in schema.model_fields:
            schema = next(_schemas(schema.model_fields[str(step)].annotation), schema)
    return schema


def _schemas(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for inner in get_args(annotation):
        yield from _schemas(inner)
