"""From a gallery name or a TOML file to a checked :class:`Scene`, with errors that say where."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError
from pydantic_core import ErrorDetails

from kc2spice.core.errors import UsageError
from kc2spice.core.foreign import identifier, read_bounded, text_of
from kc2spice.core.toml import DEEPEST, LONGEST_KEY, MAX_BYTES, parse_toml
from kc2spice.core.words import did_you_mean
from kc2spice.scene.budget import budget_keys, fill
from kc2spice.scene.checks import problems
from kc2spice.scene.compose import composed
from kc2spice.scene.keys import model_keys, scene_keys, submodel
from kc2spice.scene.model import GROUND, Frame, Part, Scene
from kc2spice.scene.parttype import PartType, part_type, type_names
from kc2spice.scene.short import SHORT

_KEY = re.compile(r"[A-Za-z_][A-Za-z0-9_]*(\.[A-Za-z_][A-Za-z0-9_]*)*")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,47}")
_ALTERNATIVES = {"rom.order": "tolerance", "rom.tolerance": "order"}  # one replaces the other
_GRAMMAR = ("part", "pins")  # keys of every part table

KeyPath = tuple[str | int, ...]


def gallery() -> dict[str, Traversable]:
    """Built-in scenes by name."""
    folder = resources.files("kc2spice") / "scenes"
    found = {item.name.removesuffix(".toml"): item for item in folder.iterdir()}
    return {name: found[name] for name in sorted(found) if found[name].name.endswith(".toml")}


def load_scene(
    name_or_path: Scene | str | Path | Mapping[str, Any],
    overrides: Sequence[str] | Mapping[str, Any] = (),
) -> Scene:
    """Read a scene, apply overrides in order, check it and join its parts.

    Parameters
    ----------
    name_or_path : gallery name, path of a TOML file, the tables themselves, or a scene.
    overrides : ``dotted.key=value`` texts, whose values are TOML (``80``, ``"80 V"``, ``[0, 1e5]``)
        or a bare word or quantity (``80 V``, ``antiparallel``), or a mapping of dotted keys to
        values; numbers are SI.

    Raises
    ------
    UsageError : no such scene, not TOML, unknown key or part type, bad value, keys that contradict
        each other, pins that do not fit.
    """
    if isinstance(name_or_path, Scene):
        if not overrides:
            return name_or_path
        source = _Source("scene", name_or_path.name, "", name_or_path.home)
        data = _copied(name_or_path.tables)
    elif isinstance(name_or_path, Mapping):
        source = _Source("scene", "scene", "", Path())
        data = _copied(name_or_path)
    else:
        source = _open(name_or_path)
        data = source.parse()
    data.setdefault("name", identifier(source.stem, "scene"))
    if isinstance(overrides, Mapping):
        for name, value in overrides.items():
            _put(data, name, value, f"{name}={value}", source)
    else:
        for override in overrides:
            _override(data, override, source)
    return _scene(data, source)


def _copied(tables: Mapping[str, Any]) -> dict[str, Any]:
    """A copy whose tables may be changed."""
    return {k: _copied(v) if isinstance(v, Mapping) else v for k, v in tables.items()}


def _scene(data: dict[str, Any], source: _Source) -> Scene:
    types = {name: _type(name, table, source) for name, table in _part_tables(data, source)}
    data = _renamed(data, types)
    for name, kind in types.items():
        if "part" not in data[name]:
            data[name] = {**kind.defaults(data[name], data), **data[name]}
    if ("error_budget",) in source.overrides:
        _drop_budgeted(data, source, budget_keys(data, types))
    tables = _copied(data)  # what the budget sets is left open in them
    data, budgeted = fill(data, types)
    frame = {key: data[key] for key in data if key not in types}
    try:
        scene = Scene(Frame.model_validate(frame), {}, home=source.folder, budgeted=budgeted)
    except ValidationError as error:
        raise _explain(_first(error), (), Frame, source) from None
    parts = {name: _part(name, data[name], kind, source) for name, kind in types.items()}
    for part in list(parts.values()):
        for name, table in part.type.expand(part, data).items():
            if name in parts:
                raise UsageError(
                    "this name is taken", where=source.where((name,)), got=name,
                    expected=f"another name: {part.name} brings a part of this one along",
                )  # fmt: skip
            own, at = dict(table), tuple(table.get("at", (name,)))
            own.pop("at", None)
            parts[name] = _part(name, own, _type(name, own, source), source, at)
    scene = replace(scene, parts=parts, tables=tables)
    if scene.frame.analysis == Frame.model_fields["analysis"].default:
        asked = [part.type.analysis(part, scene) for part in parts.values()]
        chosen = [each for each in asked if each is not None]
        if chosen:
            frame_now = scene.frame.model_copy(update={"analysis": chosen[0]})
            scene = replace(scene, frame=frame_now)
    try:
        for problem in problems(scene):
            raise problem
        return composed(scene)
    except UsageError as problem:
        if problem.where is not None:
            problem.where = source.where(tuple(str(problem.where).split(".")))
        raise


def _renamed(data: dict[str, Any], types: Mapping[str, PartType]) -> dict[str, Any]:
    """``data`` with today's names of pins and ports, in ``part.pin`` and in parts' own pins."""

    def target(value: Any) -> Any:
        if isinstance(value, Mapping):
            return {key: target(item) for key, item in value.items()}
        if isinstance(value, list):
            return [target(item) for item in value]
        name, dot, rest = value.partition(".") if isinstance(value, str) else ("", "", "")
        if not dot or name not in types:
            return value
        *path, pin = rest.split(".")
        return ".".join([name, *path, types[name].renamed(pin)])

    found = target(data)
    for name, kind in types.items():
        if isinstance(pins := found[name].get("pins"), Mapping):
            found[name]["pins"] = {kind.renamed(pin): goal for pin, goal in pins.items()}
    return found


def _part_tables(data: Mapping[str, Any], source: _Source) -> Iterator[tuple[str, Mapping]]:
    """Top-level tables that are parts."""
    taken: dict[str, str] = {}
    for name, table in data.items():
        if name in Frame.model_fields:
            continue
        if not isinstance(table, Mapping) and name in SHORT:
            raise UsageError(
                "not a table", where=source.where((name,)), got=_shown(table),
                expected=f"a table, [{name}]",
            )  # fmt: skip
        if not isinstance(table, Mapping):
            near = did_you_mean(name, Frame.model_fields)
            near = near or did_you_mean(name, [key.name for key in scene_keys()])
            raise UsageError(
                "unknown key", where=source.where((name,)), hint=near,
                expected=", ".join(Frame.model_fields) + ", or a table with part = TYPE",
            )  # fmt: skip
        if not _NAME.fullmatch(name) or name.lower() == GROUND:
            raise UsageError(
                "not a name for a part", where=source.where((name,)), got=repr(_short(name)),
                expected="a letter, then letters, digits and _, at most 48 in all; not gnd",
            )  # fmt: skip
        if name.lower() in taken:
            raise UsageError(
                "two parts whose names differ in case only", where=source.where((name,)),
                got=f"{taken[name.lower()]} and {name}", expected="netlists do not tell case apart",
            )  # fmt: skip
        taken[name.lower()] = name
        yield name, table


def _type(name: str, table: Mapping[str, Any], source: _Source) -> PartType:
    chosen = table.get("part", SHORT.get(name))
    if chosen is None:
        near = did_you_mean(name, [*Frame.model_fields, *SHORT])
        raise UsageError(
            "this table is no part of the grammar and says no part type",
            where=source.where((name,)),
            expected="part = one of " + ", ".join(type_names()),
            hint=near or f'add  part = "TYPE"  to [{name}]; see kc2spice scenes --parts',
        )
    found = part_type(chosen) if isinstance(chosen, str) else None
    if found is None:
        raise UsageError(
            "unknown part type", where=source.where((name, "part")), got=_shown(chosen),
            expected="one of " + ", ".join(type_names()),
            hint=did_you_mean(str(chosen), type_names()),
        )  # fmt: skip
    return found


def _part(
    name: str,
    table: Mapping[str, Any],
    kind: PartType,
    source: _Source,
    at: KeyPath = (),
) -> Part:
    """A part of its table; ``at`` is where the file has it, if not under its name."""
    pins = table.get("pins", {})
    if not isinstance(pins, Mapping) or not all(isinstance(v, str) for v in pins.values()):
        raise UsageError(
            "pins is no table of names", where=source.where((name, "pins")), got=_short(repr(pins)),
            expected='pins = { PIN = "part.pin" } or "gnd"',
        )  # fmt: skip
    keys = {key: value for key, value in table.items() if key not in _GRAMMAR}
    keys = _completed(keys, kind.schema)
    try:
        checked = kind.schema.model_validate(keys, context={"home": source.folder})
    except ValidationError as error:
        raise _explain(_first(error), at or (name,), kind.schema, source) from None
    return Part(name, kind, checked, dict(pins), at)


def _completed(table: Mapping[str, Any], schema: type[BaseModel]) -> dict[str, Any]:
    """``table`` whose tables have what the schema's default for them says and they do not.

    ``ring = { outer = "6 mm" }`` changes the outer diameter of the usual ring and nothing else.
    """
    found = dict(table)
    for name, field_ in schema.model_fields.items():
        usual = field_.default
        if isinstance(usual, BaseModel) and isinstance(found.get(name), Mapping):
            said = {key: getattr(usual, key) for key in usual.model_fields_set}
            found[name] = said | _completed(found[name], type(usual))
    return found


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
    _put(data, name, _toml_value(value), text, source)


def _put(data: dict[str, Any], name: str, value: Any, text: str, source: _Source) -> None:
    path = tuple(name.split("."))
    source.overrides[path] = text
    table = data
    for depth, part in enumerate(path[:-1], start=1):
        table = table.setdefault(part, {})
        if not isinstance(table, dict):
            prefix = ".".join(path[:depth])
            raise UsageError(f"{prefix} is a value, not a table", where=source.where(path))
    table.pop(_ALTERNATIVES.get(name, ""), None)
    table[path[-1]] = value


def _drop_budgeted(data: dict[str, Any], source: _Source, keys: tuple[str, ...]) -> None:
    """Drop what the file says about ``keys``, which an overriding error_budget sets."""
    for name in keys:
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


def _first(error: ValidationError) -> ErrorDetails:
    """The finding to tell: an unknown key before one that is missing, which it may stand for."""
    found = error.errors()
    return next((each for each in found if each["type"] == "extra_forbidden"), found[0])


def _explain(
    error: ErrorDetails, prefix: KeyPath, schema: type[BaseModel], source: _Source
) -> UsageError:
    """One finding of a schema in the words of a scene's author."""
    path, context = (*prefix, *error["loc"]), error.get("ctx", {})
    where, got = source.where(path), _shown(error["input"])
    match error["type"]:
        case "extra_forbidden":
            return _unknown_key(error["loc"], schema, where, prefix)
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
            return UsageError(
                "out of range",
                where=where,
                got=got,
                expected=limit + _in_unit(error["loc"], schema),
            )
        case "value_error":  # of keys that contradict each other: what is wrong with them
            found = None if isinstance(error["input"], Mapping) else got
            return UsageError(str(context["error"]), where=where, got=found)
        case _:
            return UsageError(error["msg"], where=where, got=got)


def _unknown_key(path: KeyPath, schema: type[BaseModel], where: str, prefix: KeyPath) -> UsageError:
    model: Any = schema
    for part in path[:-1]:
        if isinstance(part, str) and part in model.model_fields:
            model = submodel(model.model_fields[part].annotation) or model
    fields = [*model.model_fields, *(_GRAMMAR if prefix and len(path) == 1 else ())]
    near = did_you_mean(str(path[-1]), fields)
    if near is None:
        near = did_you_mean(str(path[-1]), [key.name for key in model_keys(schema)])
    return UsageError("unknown key", where=where, expected="one of " + ", ".join(fields), hint=near)


def _in_unit(path: KeyPath, schema: type[BaseModel]) -> str:
    names = [str(part) for part in path if isinstance(part, str)]
    unit = {key.name: key.unit for key in model_keys(schema)}.get(".".join(names))
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
