"""Parser of overrides of scene keys: strings ``KEY=VALUE`` and TOML files."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from types import MappingProxyType
from typing import Any

from kc2spice.core.errors import UsageError, did_you_mean
from kc2spice.core.toml_text import clip_text, format_toml
from kc2spice.core.untrusted_files import LONGEST_KEY, MAX_NESTING, parse_toml
from kc2spice.scene.override_origin import OverrideOrigin
from kc2spice.scene.scene_file import open_scene

_WORD_PATTERN = r"[A-Za-z_][A-Za-z0-9_]*"
_INDEX_PATTERN = r"\[-?[0-9]{1,6}\]"
_DOTTED_KEY = re.compile(
    rf"{_WORD_PATTERN}({_INDEX_PATTERN})*(\.{_WORD_PATTERN}({_INDEX_PATTERN})*)*"
)
_STRUCTURAL_KEYS = ("part", "pins")  # keys of a part that never appear in examples of overrides
_PLAIN_ARGUMENT = re.compile(r"[\w.=+:%,/-]+")  # pattern of strings that need no quotes in a shell
_SEPARATOR = re.compile(r"[.\[]")
# Tables with keys that exclude each other: an override of ``rom.order`` deletes ``rom.tolerance``.
_EXCLUSIVE_KEYS = {
    "rom": ("order", "tolerance"),
    "damping": ("ratio", "quality", "loss_factor", "per_material"),
}
_OVERRIDE_EXAMPLES = (
    "dotted.key=value, such as kick.drive.voltage=80 or beam.layers[0].thickness=0.2 mm"
)


@dataclass(frozen=True)
class Override:
    """Override of a key: the dotted key as typed, the value, and the origin for errors.

    ``folder`` is the folder of the TOML file with the override, or None for an override that is not
    in a file. ``is_from_table`` states whether the user wrote the key into a table, which also
    replaces a value that is not a table.
    """

    key: str
    value: Any
    origin: OverrideOrigin
    folder: Path | None = None
    is_from_table: bool = False


def read_overrides(
    overrides: Sequence[str] | Mapping[str, Any], example: Callable[[str], str]
) -> Iterator[Override]:
    """Yield the overrides of a list of strings, or of a mapping of keys to values.

    ``example`` is a function that returns an example of an override for a key.

    Raises
    ------
    UsageError : a string is not of the form ``KEY=VALUE``.
    """
    if isinstance(overrides, Mapping):
        for name, value in overrides.items():
            yield Override(name, value, OverrideOrigin(f"{name}={value}", is_option=False))
        return
    for text, file in _expand_files(overrides):
        name, value = _parse_override(text, example)
        folder = None if file is None else Path(file).resolve().parent
        origin = OverrideOrigin(text, is_option=True, file=file)
        yield Override(name, value, origin, folder, is_from_table=file is not None)


def split_table_of_part(override: Override, parts: Collection[str]) -> Iterator[Override]:
    """Yield one override for each key of a table of a part without the key ``part``.

    Other overrides are yielded unchanged. ``parts`` are the names of the parts of the scene.
    """
    table = override.value
    if override.key not in parts or not isinstance(table, Mapping) or "part" in table:
        yield override
        return
    for key, value in _flatten_tables(table, f"{override.key}."):
        value_text = format_toml(value) if override.origin.is_option else value
        origin = replace(override.origin, text=f"{key}={value_text}")
        yield Override(key, value, origin, override.folder, is_from_table=True)


def expand_overrides(texts: Sequence[str], scene: Mapping[str, Any]) -> list[str]:
    """Replace each TOML file name by strings ``dotted.key=value``, one for each key.

    A table that replaces another value of the tables ``scene`` becomes a single string.

    Raises
    ------
    UsageError : a file does not exist or is not TOML.
    """
    return [text for text, _ in _expand_files(texts, scene)]


def _expand_files(
    texts: Sequence[str], scene: Mapping[str, Any] = MappingProxyType({})
) -> Iterator[tuple[str, str | None]]:
    """Expand TOML files to overrides ``key=value``; yield each with its file name.

    The file name is None for an override that is not in a file. ``scene`` are tables as in
    `_flatten_tables`.
    """
    for text in texts:
        if "=" in text or not text.endswith(".toml"):
            yield text, None
            continue
        if not Path(text).is_file():
            raise _make_missing_file_error(text)
        for key, value in _flatten_tables(open_scene(text).parse_tables(), scene=scene):
            yield f"{key}={format_toml(value)}", text


def _make_missing_file_error(name: str) -> UsageError:
    """Return the error about an override file that does not exist."""
    near: list[str] = []
    with suppress(OSError, ValueError):  # the name of the folder is not valid
        near = get_close_matches(name, map(str, Path(name).parent.glob("*.toml")), 1, 0.7)
    return UsageError(
        "this file does not exist",
        where=f"--set {clip_text(name)!r}",
        expected="KEY=VALUE, or a TOML file of keys, whose name ends with .toml",
        hint=f"did you mean {near[0]!r}?" if near else f"write KEY=VALUE in place of {name}",
    )


def _flatten_tables(
    table: Mapping[str, Any], above: str = "", scene: Mapping[str, Any] = MappingProxyType({})
) -> Iterator[tuple[str, Any]]:
    """Yield the dotted keys and values of nested tables.

    A table is not flattened if the tables ``scene`` contain a text or a number of the same name.
    """
    for key, value in table.items():
        below = scene.get(key, {})
        if isinstance(below, list):
            below = {}  # an error explains that a list is not a table
        is_table = isinstance(value, Mapping) and isinstance(below, Mapping)
        if is_table and not any(map(_SEPARATOR.search, map(str, value))):
            yield from _flatten_tables(value, f"{above}{key}.", below)
        else:
            yield f"{above}{key}", value


# pattern of a mistyped override: key and value separated by a colon or a blank
_OTHER_SEPARATOR = re.compile(r"([A-Za-z_][\w.\[\]]*)\s*[:\s]\s*([^=:\s][^=]*)")


def _parse_override(text: str, example: Callable[[str], str]) -> tuple[str, Any]:
    """Return the key and the value of a string ``dotted.key=value``."""
    name, _, value = map(str.strip, text.partition("="))
    if "=" not in text and Path(name).is_file():
        raise UsageError(
            "this file is not a TOML file of keys",
            where="--set",
            got=repr(clip_text(text)),
            expected="KEY=VALUE, or a TOML file of keys",
            hint=f"write KEY=VALUE in place of {clip_text(name)}, or leave out --set",
        )
    separated = _OTHER_SEPARATOR.fullmatch(clip_text(text.strip()))
    is_path = "/" in name or get_close_matches(Path(name).suffix.lower(), [".toml"], 1, 0.8)
    # the example has no value if no part of the scene has a key of this name
    if "=" not in text and is_path and not separated and example(name) == f"{name}=VALUE":
        raise _make_missing_file_error(name)
    if not name or not value:
        advice = example(clip_text(name)) if name else f"KEY={clip_text(value) or 'VALUE'}"
        if separated:
            advice = shlex.quote("=".join(separated.groups()))
        raise UsageError(
            "the value of the key is missing" if name else "the key is missing",
            where="--set",
            got=repr(clip_text(text)),
            expected=_OVERRIDE_EXAMPLES,
            hint=f"write {advice}",
        )
    return name, parse_override_value(value)


def write_example(name: str, tables: Mapping[str, Any], keys: Sequence[str]) -> str:
    """Return an example of how to override a key, or a key in a table.

    ``name`` is the name of the key or of the table. For a table, the example overrides a key in the
    table. The example sets the key to its present value in the scene. ``tables`` are the tables of
    the scene. ``keys`` are the dotted keys of the part to which ``name`` belongs.
    """
    value: Any = tables
    for step in re.findall(rf"{_WORD_PATTERN}|{_INDEX_PATTERN}", name):
        try:
            value = value[int(step[1:-1]) if step[0] == "[" else step]
        except (KeyError, IndexError, TypeError):
            value = None
            break
    while isinstance(value, (Mapping, list)) and value:
        if isinstance(value, list):
            name, value = f"{name}[0]", value[0]
            continue
        word = next((key for key in value if key not in _STRUCTURAL_KEYS), None)
        if word is None:
            break
        name, value = f"{name}.{word}", value[word]
    if isinstance(value, (Mapping, list)) or value is None:
        similar = get_close_matches(name, keys, n=1, cutoff=0.0)
        below = [key for key in keys if key.startswith(f"{name}.")] or similar
        return f"{name if name in keys or not below else below[0]}=VALUE"
    text = f"{name}={value if isinstance(value, str) else format_toml(value)}"
    return text if _PLAIN_ARGUMENT.fullmatch(text) else f"'{text}'"


def set_key(data: dict[str, Any], override: Override) -> tuple[str, ...]:
    """Set the key of an override in nested tables, and return the path of the key.

    The path contains the indices of list entries. Missing tables are added, but list entries must
    exist. A key that the user wrote into a table also replaces a value that is not a table.
    """
    name, where = override.key, str(override.origin)
    steps = re.findall(rf"{_WORD_PATTERN}|{_INDEX_PATTERN}", name)
    long = len(steps) > MAX_NESTING or max(map(len, steps), default=0) > LONGEST_KEY
    if long or not _DOTTED_KEY.fullmatch(name):
        raise UsageError(
            "this text is not the name of a key",
            where=where,
            got=repr(clip_text(name)),
            expected=_OVERRIDE_EXAMPLES,
            hint="write PART.KEY=VALUE, with the names of a part and of its key",
        )
    path: list[str] = []
    so_far, near = "", None
    holder: Any = data
    key: str | int = ""
    for step in steps:
        key = _find_key(holder, step, so_far, where, near)
        path.append(str(key))
        so_far += step if step[0] == "[" or not so_far else f".{step}"
        if len(path) < len(steps):
            near = _suggest_list(holder, str(key))
            if isinstance(holder, dict):
                is_table = isinstance(holder.setdefault(key, {}), (dict, list))
                if override.is_from_table and not is_table:
                    holder[key] = {}
            holder = holder[key]
    holder[key] = override.value
    return tuple(path)


def delete_excluded_keys(
    data: dict[str, Any], path: tuple[str, ...], value: Any
) -> dict[tuple[str, ...], Any]:
    """Delete the keys that a new value of a key excludes; return them by their paths.

    ``path`` is the path of the key, such as ``("rom", "order")``. The value False excludes no key.
    """
    names = _EXCLUSIVE_KEYS.get(path[-2], ()) if len(path) > 1 else ()
    if path[-1] not in names or value is False:
        return {}
    holder: Any = data
    for step in path[:-1]:
        holder = holder[int(step) if isinstance(holder, list) else step]
    excluded = [name for name in names if name in holder and name != path[-1]]
    return {(*path[:-1], name): holder.pop(name) for name in excluded}


def _suggest_list(holder: Any, key: str) -> str | None:
    """Suggest a list in the table ``holder`` with a name similar to an unknown key."""
    table = holder if isinstance(holder, dict) else {}
    return did_you_mean(key, [name for name, value in table.items() if isinstance(value, list)])


def _find_key(holder: Any, step: str, so_far: str, where: str, suggestion: str | None) -> str | int:
    """Return the table key or list index that one step of a dotted key denotes.

    ``so_far`` is the part of the dotted key before ``step``, for example ``disc.layers`` before
    ``[0]``. ``holder`` is the table, list or value that the scene contains at the dotted key
    ``so_far``. ``suggestion`` is a hint about a list with a similar name.

    Raises
    ------
    UsageError : ``holder`` does not contain the key or the list entry ``step``.
    """
    if step[0] != "[":
        if isinstance(holder, dict):
            return step
        if isinstance(holder, list):
            raise UsageError(
                f"{so_far} is a list, not a table",
                where=where,
                hint=f"name an entry, such as {so_far}[0].{step}",
            )
        hint = f"write {so_far}=VALUE"
        if isinstance(holder, str) and re.search(r"\.material$|\.materials\.\w+$", so_far):
            hint = f"set {so_far}={{ like = {format_toml(holder)} }} before this key"
        raise UsageError(f"{so_far} is a value, not a table", where=where, hint=hint)
    if not isinstance(holder, list):
        raise UsageError(
            f"{so_far} is not a list in this scene",
            where=where,
            hint=suggestion or f"state the whole list: {so_far}=[ … ]",
        )
    index, count = int(step[1:-1]), len(holder)
    if not -count <= index < count:
        expected = f"{so_far}[0] … {so_far}[{count - 1}]" if count else "a list with entries"
        raise UsageError(
            "the list has no such entry",
            where=where,
            got=so_far + step,
            expected=expected,
            hint=f"write {so_far}[{count - 1}] for the last entry"
            if count
            else f"set {so_far}=[ … ]",
        )
    return index % count


def parse_override_value(text: str) -> Any:
    """Parse the string VALUE of an override ``key=VALUE`` as TOML.

    A string that is not TOML, such as a bare word or a number with a unit, is returned unchanged.
    """
    try:
        table = parse_toml(f"value = {text}")
    except ValueError:
        return text
    return table["value"] if set(table) == {"value"} else text
