"""Checking a table against a schema, with an error that names the key."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import ValidationError

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Section

Schema = TypeVar("Schema", bound=Section)


def validated(schema: type[Schema], table: Mapping[str, Any] | Schema, where: str) -> Schema:
    """``table`` as a ``schema``; one that is already passes unchanged.

    Raises
    ------
    UsageError : a key is unknown, missing, of the wrong unit, or contradicts another.
    """
    if isinstance(table, schema):
        return table
    try:
        return schema.model_validate(dict(table))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise UsageError(
            first["msg"].removeprefix("Value error, "),
            where=f"{where}.{key}" if key else where,
            got=None if first["type"] == "missing" or not key else first["input"],
            expected=first.get("ctx", {}).get("expected"),
            hint=f"keys: {', '.join(schema.model_fields)}",
        ) from None
