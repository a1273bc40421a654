"""What pydantic finds wrong with a table, in the words of its author."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any, get_args

from pydantic import BaseModel, BeforeValidator, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from kc2spice.core.errors import did_you_mean

KeyPath = tuple[str | int, ...]


def told(
    error: ValidationError, schema: type[BaseModel], at: KeyPath = (), also: Sequence[str] = ()
) -> tuple[KeyPath, dict[str, Any]]:
    """The path of the one finding to tell, and its message, got, expected and hint.

    An unknown key comes before one that is missing, which it may stand for. ``at`` is where the
    table stands, ``also`` are keys that it may have beside those of the ``schema``.
    """
    every = error.errors()
    found = next((each for each in every if each["type"] == "extra_forbidden"), every[0])
    message, expected, hint = _words(found, schema, (*at, *found["loc"]), also)
    silent = found["type"] in ("extra_forbidden", "missing") or _contradicts(found)
    got = None if silent else shown(found["input"])
    return (*at, *found["loc"]), {
        "message": message,
        "got": got,
        "expected": expected,
        "hint": hint,
    }


def _contradicts(found: ErrorDetails) -> bool:
    """Whether it is about keys that contradict each other: the message says what is wrong."""
    return found["type"] == "value_error" and isinstance(found["input"], Mapping)


def _words(
    found: ErrorDetails, schema: type[BaseModel], whole: KeyPath, also: Sequence[str]
) -> tuple[str, str | None, str | None]:
    path, context = found["loc"], found.get("ctx", {})
    match found["type"]:
        case "extra_forbidden":
            fields = [*_table(schema, path).model_fields, *(also if len(path) == 1 else ())]
            word, every = str(path[-1]), (dotted(each) for each, _ in entries(schema))
            near = did_you_mean(word, fields) or did_you_mean(word, every)
            return "unknown key", "one of " + ", ".join(fields), near
        case "missing":
            return f"{dotted(whole)} is missing", None, None
        case "string_pattern_mismatch":
            expected = "a letter, then letters, digits and _, at most 64 in all"
            if whole[0] in ("title", "include"):  # it ends up in the netlist: a line is a command
                expected = "one line of text without control characters"
            return "not allowed", expected, None
        case "quantity":
            return context["reason"], context["expected"], None
        case "literal_error":
            choices = re.findall(r"'?(\w+)'?(?:, | or |$)", context["expected"])
            near = did_you_mean(str(found["input"]), choices)
            return "no such choice", f"one of {', '.join(choices)}", near
        case "int_type":
            return "not a whole number", "a whole number, without quotes", None
        case "model_type" | "dict_type":
            entry = not whole or isinstance(whole[-1], int)  # of a list
            table = "{ KEY = VALUE, … }" if entry else f"[{dotted(whole)}]"
            return "not a table", f"a table, {table}", None
        case "tuple_type" | "list_type":
            return "not a list", f"a list, {whole[-1]} = [{_entry(found['input'])}]", None
        case "too_short" | "too_long" as kind:
            few = kind == "too_short"
            count = context["min_length" if few else "max_length"]
            bound = f"{'least' if few else 'most'} {count} entr{'y' if count == 1 else 'ies'}"
            return f"too {'few' if few else 'many'} entries", f"a list of at {bound}", None
        case "greater_than" | "greater_than_equal" | "less_than" | "less_than_equal":
            sign = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
            limit = ", ".join(f"{sign[key]} {bound:g}" for key, bound in context.items())
            names = tuple(part for part in path if isinstance(part, str))
            unit = next((unit_of(field) for each, field in entries(schema) if each == names), None)
            return "out of range", f"{limit} {unit or ''}".rstrip(), None
        case "value_error":
            return str(context["error"]), None, None
    return found["msg"], context.get("expected"), None


def _table(schema: type[BaseModel], path: KeyPath) -> type[BaseModel]:
    """The innermost schema on the way to ``path``."""
    for step in path[:-1]:
        if step in schema.model_fields:
            schema = submodel(schema.model_fields[str(step)].annotation) or schema
    return schema


def entries(schema: type[BaseModel]) -> Iterator[tuple[tuple[str, ...], FieldInfo]]:
    """All keys of a schema in its order, those of its tables behind their names."""
    for name, field in schema.model_fields.items():
        section, own = submodel(field.annotation), (field.alias or name,)
        if section is None:
            yield own, field
        else:
            yield from ((own + below, each) for below, each in entries(section))


def submodel(annotation: Any) -> type[BaseModel] | None:
    """The section behind a field's annotation (``Kick`` for ``Kick | None``), if it is one."""
    for candidate in (annotation, *get_args(annotation)):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None


def unit_of(field: FieldInfo) -> str | None:
    """SI unit that the validator of a number (or of each number of a list) converts to."""
    nested = [meta for arg in get_args(field.annotation) for meta in get_args(arg)[1:]]
    for meta in (*field.metadata, *nested):
        if isinstance(meta, BeforeValidator) and isinstance(meta.func, partial):
            return str(meta.func.args[0])
    return None


def _entry(value: Any) -> str:
    """How one entry of a list is written that stands there without its brackets."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = …" for key in value) + " }"
    return " … "


def dotted(path: KeyPath) -> str:
    """``layers[0].thickness`` of its words and numbers."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".")


def shown(value: Any) -> str:
    """``repr``, or what can be said of a number of more digits than Python prints."""
    try:
        return clipped(repr(value))
    except ValueError:
        return f"a {type(value).__name__} that is too long to print"


def clipped(text: str, limit: int = 120) -> str:
    """At most so many characters of a text."""
    return text if len(text) <= limit else text[:limit] + " …"
