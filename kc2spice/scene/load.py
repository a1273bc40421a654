"""From a gallery name or a TOML file to a checked :class:`Scene`, with errors that say where."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from pydantic_core import ErrorDetails

from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import read_bounded, text_of
from kc2spice.core.toml import DEEPEST, LONGEST_KEY, MAX_BYTES, parse_toml
from kc2spice.scene.checks import problems
from kc2spice.scene.division import KEYS
from kc2spice.scene.keys import did_you_mean, scene_keys, submodel
from kc2spice.scene.schema import Scene

_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_][A-Za-z0-9_]*)*")
_ALTERNATIVES = {"rom.order": "tolerance", "rom.tolerance": "order"}  # one replaces the other

KeyPath = tuple[str | int, ...]


def gallery() -> dict[str, Traversable]:
    """Built-in scenes by name."""
    folder = resources.files("kc2spice") / "scenes"
    found = {item.name.removesuffix(".toml"): item for item in folder.iterdir()}
    return {name: found[name] for name in sorted(found) if found[name].name.endswith(".toml")}


def load_scene(name_or_path: str | Path, overrides: Sequence[str] = ()) -> Scene:
    """Read a scene, apply ``dotted.key=value`` overrides in order, check it.

    A value is TOML (``80``, ``"80 V"``, ``[0, 1e5]``) or a bare word or quantity (``80 V``,
    ``antiparallel``); numbers are SI.

    Raises
    ------
    UsageError : no such scene, not TOML, unknown key, bad value, keys that contradict each other.
    """
    source = _open(name_or_path)
    data = source.parse()
    data.setdefault("name", source.stem)
    for override in overrides:
        _override(data, override, source)
    if ("error_budget",) in source.overrides:
        _make_way(data, source)
    try:
        scene = Scene.model_validate(data)
    except ValidationError as error:
        raise _explain(error.errors()[0], source) from None
    for problem in problems(scene):
        key = tuple(str(problem.where).split("."))
        problem.where = source.where(key)
        raise problem
    if scene.include:
        scene._home = source.folder
    return scene


@dataclass(frozen=True)
class _Source:
    """Text of a scene with the overrides on top of it, to say where a key was set."""

    label: str
    stem: str
    text: str
    folder: Path
    overrides: dict[tuple[str, ...], str] = field(default_factory=dict)

    def parse(self) -> dict[str, Any]:
        try:
            return parse_toml(self.text)
        except ValueError as error:
            hint = "strings, quantities with units among them, stand in double quotes"
            raise UsageError(
                "not valid TOML", where=self.label, got=_short(str(error)), hint=hint
            ) from None

    def where(self, path: KeyPath) -> str:
        names = tuple(str(part) for part in path)
        for key, text in self.overrides.items():
            if key[: len(names)] == names or names[: len(key)] == key:
                return f"--set {_short(text)!r}"
        line = _line_of(self.text, names)
        place = self.label if line is None else f"{self.label}, line {line}"
        return f"{place}, key {_dotted(path)}"


def _open(name_or_path: str | Path) -> _Source:
    scenes = gallery()
    if str(name_or_path) in scenes:
        name = str(name_or_path)
        text = scenes[name].read_text(encoding="utf-8")
        return _Source(f"scene {name}", name, text, Path(str(scenes[name])).parent)
    path = Path(name_or_path)
    try:
        content = read_bounded(path, MAX_BYTES)
    except (OSError, ValueError) as error:
        raise _not_found(name_or_path, list(scenes), error) from None
    try:
        return _Source(str(path), path.stem, text_of(content), path.parent)
    except UnicodeDecodeError:
        raise UsageError("not a text file", where=str(path), expected="TOML in UTF-8") from None


def _not_found(name: str | Path, scenes: list[str], error: Exception) -> UsageError:
    if isinstance(error, (FileNotFoundError, IsADirectoryError)):
        hint = did_you_mean(str(name), scenes) or "see 'kc2spice scenes' for the gallery"
        expected = "a TOML file, or one of " + ", ".join(scenes)
        return UsageError("no such scene", got=repr(str(name)), expected=expected, hint=hint)
    reason = getattr(error, "strerror", None) or str(error)
    return UsageError(f"cannot be read: {reason}", where=str(name))


def _override(data: dict[str, Any], text: str, source: _Source) -> None:
    """Put one ``dotted.key=value`` into ``data``."""
    name, equals, value = (part.strip() for part in text.partition("="))
    path = tuple(name.split("."))
    long = len(path) > DEEPEST or len(max(path, key=len)) > LONGEST_KEY
    if not equals or not value or long or not _KEY.fullmatch(name):
        example = "dotted.key=value, such as kick.drive.voltage=80"
        raise UsageError("not an override", where="--set", got=repr(_short(text)), expected=example)
    source.overrides[path] = text
    table = data
    for depth, part in enumerate(path[:-1], start=1):
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            prefix = ".".join(path[:depth])
            raise UsageError(f"{prefix} is a value, not a table", where=source.where(path))
    table.pop(_ALTERNATIVES.get(name, ""), None)
    table[path[-1]] = _toml_value(value)


def _make_way(data: dict[str, Any], source: _Source) -> None:
    """Drop what the file says about keys that an overriding error_budget sets."""
    for name in (name for names in KEYS.values() for name in names):
        section, key = name.split(".")
        if (section, key) not in source.overrides and isinstance(data.get(section), dict):
            data[section].pop(key, None)


def _toml_value(text: str) -> Any:
    """A TOML value, or the text itself where it is none: a bare word or a number with a unit."""
    try:
        table = parse_toml(f"value = {text}")
    except ValueError:
        return text
    return table["value"] if set(table) == {"value"} else text


def _explain(error: ErrorDetails, source: _Source) -> UsageError:
    """One finding of the schema in the words of a scene's author."""
    path, context = error["loc"], error.get("ctx", {})
    where, got = source.where(path), _shown(error["input"])
    match error["type"]:
        case "extra_forbidden":
            return _unknown_key(path, where)
        case "missing":
            return UsageError(f"{_dotted(path)} is missing", where=where)
        case "string_pattern_mismatch":
            expected = "a letter, then letters, digits and _, at most 64 in all"
            if path[0] in (
                "title",
                "include",
            ):  # it ends up in the netlist, where a line is a command
                expected = "one line of text without control characters"
            return UsageError("not allowed", where=where, got=got, expected=expected)
        case "quantity":
            return UsageError(context["reason"], where=where, got=got, expected=context["expected"])
        case "literal_error":
            choices = re.findall(r"'?(\w+)'?(?:, | or |$)", context["expected"])
            hint = did_you_mean(str(error["input"]), choices)
            expected = f"one of {', '.join(choices)}"
            return UsageError("no such choice", where=where, got=got, expected=expected, hint=hint)
        case "int_type":
            expected = "a whole number, without quotes"
            return UsageError("not a whole number", where=where, got=got, expected=expected)
        case "model_type":
            expected = f"a table, [{_dotted(path)}]"
            return UsageError("not a table", where=where, got=got, expected=expected)
        case "greater_than" | "greater_than_equal" | "less_than" | "less_than_equal":
            sign = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
            limit = ", ".join(f"{sign[key]} {bound:g}" for key, bound in context.items())
            return UsageError("out of range", where=where, got=got, expected=limit + _in_unit(path))
        case _:
            return UsageError(error["msg"], where=where, got=got)


def _unknown_key(path: KeyPath, where: str) -> UsageError:
    model: Any = Scene
    for part in path[:-1]:
        model = submodel(model.model_fields[str(part)].annotation)
    fields = list(model.model_fields)
    near = did_you_mean(str(path[-1]), fields)
    if near is None:
        near = did_you_mean(_dotted(path), [key.name for key in scene_keys()])
    return UsageError("unknown key", where=where, expected="one of " + ", ".join(fields), hint=near)


def _in_unit(path: KeyPath) -> str:
    names = [str(part) for part in path if isinstance(part, str)]
    unit = {key.name: key.unit for key in scene_keys()}.get(".".join(names))
    return f" {unit}" if unit else ""


def _dotted(path: KeyPath) -> str:
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".")


def _shown(value: Any) -> str:
    """``repr``, or what can be said of a number of more digits than Python prints."""
    try:
        return _short(repr(value))
    except ValueError:
        return f"a {type(value).__name__} that is too long to print"


def _short(text: str, limit: int = 120) -> str:
    return text if len(text) <= limit else text[:limit] + " …"


def _line_of(text: str, path: tuple[str, ...]) -> int | None:
    """Line that sets ``path`` or, failing that, the longest part of it; for messages only."""
    table: tuple[str, ...] = ()
    best: tuple[int, int | None] = (0, None)
    for number, line in enumerate(text.splitlines(), start=1):
        line = line.strip()
        key = re.match(r"([\w.]+)\s*=", line)
        if line.startswith("["):
            header = line.partition("]")[0].lstrip("[")
            table = names = tuple(part.strip() for part in header.split("."))
        elif key:
            names = table + tuple(key[1].split("."))
        else:
            continue
        if names == path[: len(names)] and len(names) > best[0]:
            best = (len(names), number)
    return best[1]
