"""The keys that a scene may have: their dotted names, units, defaults and meaning."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any, get_args

from pydantic import BaseModel, BeforeValidator
from pydantic.fields import FieldInfo
from pydantic_core import PydanticUndefined

from kc2spice.scene.schema import Scene

LONGEST = 200  # characters of a word that is compared with others


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


def scene_keys(model: type[BaseModel] = Scene, prefix: str = "") -> Iterator[Key]:
    """All keys in the order of the schema."""
    for name, field in model.model_fields.items():
        section = submodel(field.annotation)
        dotted = f"{prefix}{name}"
        if section is not None:
            yield from scene_keys(section, f"{dotted}.")
            continue
        default = None if field.default is PydanticUndefined else field.default
        yield Key(
            dotted, _unit(field), default, _choices(field.annotation), field.description or ""
        )


def did_you_mean(word: str, choices: Iterable[str]) -> str | None:
    """``did you mean 'x'?`` for a near miss; of dotted keys only the last parts are compared."""
    if len(word) > LONGEST:
        return None  # comparing takes time with the square of the length
    leaves: dict[str, str] = {}
    for choice in choices:
        leaves.setdefault(choice.rpartition(".")[2], choice)
    near = difflib.get_close_matches(word.rpartition(".")[2], leaves, n=1, cutoff=0.7)
    return f"did you mean {leaves[near[0]]!r}?" if near else None
