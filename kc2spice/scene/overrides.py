"""Overrides of the keys of a scene: texts ``KEY=VALUE``, and TOML files of keys."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import clipped
from kc2spice.core.untrusted_files import DEEPEST, LONGEST_KEY, parse_toml
from kc2spice.scene.scene_file import open_scene

_WORD, _INDEX = r"[A-Za-z_][A-Za-z0-9_]*", r"\[-?[0-9]{1,6}\]"
_KEY = re.compile(rf"{_WORD}({_INDEX})*(\.{_WORD}({_INDEX})*)*")
_ALTERNATIVES = {"rom.order": "tolerance", "rom.tolerance": "order"}  # one replaces the other
_OVERRIDE = "dotted.key=value, such as kick.drive.voltage=80 or beam.layers[0].thickness=0.2 mm"


def override_texts(texts: Sequence[str]) -> list[str]:
    """Overrides, each ``dotted.key=value``; a TOML file gives all that it has.

    Raises
    ------
    UsageError : a file that is not there, or not TOML.
    """
    result: list[str] = []
    for text in texts:
        plain = "=" in text or not text.endswith(".toml")
        result += (
            [text] if plain else [f"{k}={toml(v)}" for k, v in _flat(open_scene(text).parse())]
        )
    return result


def _flat(table: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of tables in tables; one whose own keys are dotted is a value."""
    for key, value in table.items():
        if isinstance(value, Mapping) and not any(re.search(r"[.\[]", name) for name in value):
            yield from _flat(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def toml(value: Any) -> str:
    """A value as the text that a scene file would have for it, to the last bit."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(v)}" for key, v in value.items()) + "}"
    if hasattr(value, "tolist"):  # a numpy array or number
        return toml(value.tolist())
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml, value)) + "]"
    return repr(value) if isinstance(value, float) else json.dumps(value, default=str)


def parse_override(text: str) -> tuple[str, Any]:
    """Key and value of ``dotted.key=value``."""
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not value:
        raise _no_override(text)
    return name, override_value(value)


def _no_override(text: str) -> UsageError:
    name, equals, _ = text.partition("=")
    hint = None if equals else f"write {clipped(name)}=VALUE"
    return UsageError(
        "not an override",
        where="--set",
        got=repr(clipped(text)),
        expected=_OVERRIDE,
        hint=hint,
    )


def set_key(data: dict[str, Any], name: str, value: Any, text: str) -> tuple[str, ...]:
    """Set the key ``name`` and return its path, in which entries of lists are counted from their
    beginning; tables on the way are made, entries of lists must be there."""
    steps = re.findall(rf"{_WORD}|{_INDEX}", name)
    long = len(steps) > DEEPEST or max(map(len, steps), default=0) > LONGEST_KEY
    if long or not _KEY.fullmatch(name):
        raise _no_override(text)
    path: list[str] = []
    where, so_far = f"--set {clipped(text)!r}", ""
    holder: Any = data
    key: str | int = ""
    for step in steps:
        key = _place(holder, step, so_far, where)
        path.append(str(key))
        so_far += step if step[0] == "[" or not so_far else f".{step}"
        if len(path) < len(steps):
            holder = holder.setdefault(key, {}) if isinstance(holder, dict) else holder[key]
    if isinstance(holder, dict):
        holder.pop(_ALTERNATIVES.get(name, ""), None)
    holder[key] = value
    return tuple(path)


def _place(holder: Any, step: str, so_far: str, where: str) -> str | int:
    """Key of a table, or number from the beginning of a list, for a name or ``[index]``.

    Raises
    ------
    UsageError : ``holder``, which the key ``so_far`` names, is not that or has no such entry.
    """
    if step[0] != "[":
        if isinstance(holder, dict):
            return step
        entries = f"its entries are {so_far}[0], …" if isinstance(holder, list) else None
        raise UsageError(f"{so_far} is a value, not a table", where=where, hint=entries)
    if not isinstance(holder, list):
        hint = f"give all of it: {so_far} = [ … ]"
        raise UsageError(f"{so_far} is no list in this scene", where=where, hint=hint)
    index, count = int(step[1:-1]), len(holder)
    if not -count <= index < count:
        expected = f"{so_far}[0] … {so_far}[{count - 1}]" if count else "a list with entries"
        raise UsageError("no such entry", where=where, got=so_far + step, expected=expected)
    return index % count


def override_value(text: str) -> Any:
    """Parse the value of ``key=VALUE``.

    It is a TOML value. Other texts, bare words and numbers with a unit, are returned unchanged.
    """
    try:
        table = parse_toml(f"value = {text}")
    except ValueError:
        return text
    return table["value"] if set(table) == {"value"} else text
