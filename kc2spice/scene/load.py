"""From a gallery name or a TOML file to a checked :class:`Scene`, with errors that say where."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from importlib.resources.abc import Traversable
from itertools import chain
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from kc2spice.core.errors import UsageError
from kc2spice.core.findings import KeyPath, clipped, dotted, entries, shown, told
from kc2spice.core.foreign import (
    DEEPEST,
    LONGEST_KEY,
    MAX_BYTES,
    identifier,
    parse_toml,
    read_bounded,
    text_of,
)
from kc2spice.core.words import did_you_mean
from kc2spice.scene.checks import problems
from kc2spice.scene.compose import allocated, composed
from kc2spice.scene.model import GROUND, Frame, Part, Scene
from kc2spice.scene.parttype import Build, PartType, part_type, type_names
from kc2spice.scene.plausible import drives, judged
from kc2spice.scene.rest import without_equilibrium, without_finite_force
from kc2spice.scene.short import SHORT

_WORD, _INDEX = r"[A-Za-z_][A-Za-z0-9_]*", r"\[-?[0-9]{1,6}\]"
_KEY = re.compile(rf"{_WORD}({_INDEX})*(\.{_WORD}({_INDEX})*)*")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,47}")
_ALTERNATIVES = {"rom.order": "tolerance", "rom.tolerance": "order"}  # one replaces the other
_GRAMMAR = ("part", "pins")  # keys of every part table


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
        values; numbers are SI. An entry of a list is counted from 0, from its end by negative
        numbers: ``beam.layers[0].thickness``, ``disc.layers[-1].material``.

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
    """A copy whose tables and lists may be changed."""

    def copy(value: Any) -> Any:
        if isinstance(value, Mapping):
            return _copied(value)
        return [copy(item) for item in value] if isinstance(value, (list, tuple)) else value

    return {key: copy(value) for key, value in tables.items()}


def _scene(data: dict[str, Any], source: _Source) -> Scene:
    types = {name: _type(name, table, source) for name, table in _part_tables(data, source)}
    tables = _copied(data)
    frame = {key: data[key] for key in data if key not in types}
    try:
        scene = Scene(Frame.model_validate(frame), {}, home=source.folder)
    except ValidationError as error:
        raise source.refusal(error, Frame) from None
    parts = {}
    for name, kind in types.items():
        short = () if "part" in data[name] else tuple(data)
        parts[name] = _part(name, data[name], kind, source, short=short)
    for part in list(parts.values()):
        for name, table in part.type.expand(part, data).items():
            if name.lower() in map(str.lower, parts):
                expected = f"another name: {part.name} brings a part of this one along"
                raise source.error((name,), "this name is taken", name, expected)
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
        scene = composed(_driven(scene, source))
        wild = judged(drives(scene), scene.checks.plausible)
        build = Build(scene, {})
        for problem in chain(without_equilibrium(build), without_finite_force(build), wild):
            raise problem
        return scene
    except UsageError as problem:
        if problem.where is not None:
            words = str(problem.where).split(".")
            problem.where = source.where(tuple(int(w) if w.isdigit() else w for w in words))
        raise


def _driven(scene: Scene, source: _Source) -> Scene:
    """``scene``; of an ``ac`` that nothing drives with 1 V on its body's first electrical port.

    Raises
    ------
    UsageError : nothing drives it, and there is no such port or something is joined to it.
    """
    parts = scene.parts
    if scene.analysis.type != "ac" or any(p.type.excites(p, scene) for p in parts.values()):
        return scene
    whole = replace(scene, ports="all")
    bodies = (part for part in parts.values() if part.type.reduced)
    electrical = (
        [f"{part.name}.{pin.name}" for pin in part.type.pins(part, whole) if pin.unit == "V"]
        for part in bodies
    )
    ports = [found[0] for found in electrical if found]
    free = [port for port in ports if not _joined(port, scene)]
    if len(ports) != 1 or not free:
        raise UsageError(
            "nothing drives this analysis",
            where="analysis.type",
            got="ac, and no source with an ac value",
            expected='a source with ac = "1 V"' + (f" at {', '.join(ports)}" if ports else ""),
            hint="a body whose electrical port nothing is joined to is driven by 1 V",
        )
    body = free[0].partition(".")[0]
    name = allocated([(body, f"{body}_drive")], {each.lower() for each in parts})[body]
    table = {"part": "source", "ac": "1 V", "pins": {"out": free[0]}}
    drive = _part(name, table, _type(name, table, source), source, (name,))
    return replace(scene, parts={**parts, name: drive})


def _joined(port: str, scene: Scene) -> bool:
    """Whether the scene joins the port ``"part.pin"`` to anything."""
    part, _, pin = port.partition(".")
    return pin in scene.parts[part].pins or scene.named(part, pin)


def _part_tables(data: Mapping[str, Any], source: _Source) -> Iterator[tuple[str, Mapping]]:
    """Top-level tables that are parts."""
    taken: dict[str, str] = {}
    for name, table in data.items():
        if name in Frame.model_fields:
            continue
        if not isinstance(table, Mapping) and name in SHORT:
            raise source.error((name,), "not a table", shown(table), f"a table, [{name}]")
        if not isinstance(table, Mapping):
            parts = [each for each in data if isinstance(data[each], Mapping)]
            parts = [each for each in parts if each not in Frame.model_fields]
            own = (dotted((each, *key)) for each in parts for key in _keys(each, data[each]))
            near = did_you_mean(name, Frame.model_fields) or did_you_mean(name, own)
            expected = ", ".join(Frame.model_fields) + ", or a table with part = TYPE"
            hint = f"keys of a part stand below its name: {', '.join(parts)}" if parts else None
            raise source.error((name,), "unknown key", None, expected, near or hint)
        if not _NAME.fullmatch(name) or name.lower() == GROUND:
            expected = "a letter, then letters, digits and _, at most 48 in all; not gnd"
            raise source.error((name,), "not a name for a part", repr(clipped(name)), expected)
        first = taken.setdefault(name.lower(), name)
        if first != name:
            raise source.error(
                (name,),
                "two parts whose names differ in case only",
                f"{first} and {name}",
                "netlists do not tell case apart",
            )
        yield name, table


def _keys(name: str, table: Mapping[str, Any]) -> Iterator[tuple[str, ...]]:
    """Keys that the table of a part may have."""
    kind = table.get("part", SHORT.get(name))
    found = part_type(kind) if isinstance(kind, str) else None
    return (path for path, _ in entries(found.schema)) if found else iter(())


def _type(name: str, table: Mapping[str, Any], source: _Source) -> PartType:
    chosen = table.get("part", SHORT.get(name))
    if chosen is None:
        near = did_you_mean(name, [*Frame.model_fields, *SHORT])
        raise source.error(
            (name,),
            "this table is no part of the grammar and says no part type",
            expected="part = one of " + ", ".join(type_names()),
            hint=near or f'add  part = "TYPE"  to [{name}]; see kc2spice scenes --parts',
        )
    found = part_type(chosen) if isinstance(chosen, str) else None
    if found is None:
        names = type_names()
        expected, near = "one of " + ", ".join(names), did_you_mean(str(chosen), names)
        raise source.error((name, "part"), "unknown part type", shown(chosen), expected, near)
    return found


def _part(
    name: str,
    table: Mapping[str, Any],
    kind: PartType,
    source: _Source,
    at: KeyPath = (),
    short: tuple[str, ...] = (),
) -> Part:
    """A part of its table; ``at`` is where the file has it, if not under its name. ``short`` are
    the tables of the scene where this one's name says its type, which some keys depend on."""
    pins = table.get("pins", {})
    if not isinstance(pins, Mapping) or not all(isinstance(v, str) for v in pins.values()):
        expected = 'pins = { PIN = "part.pin" } or "gnd"'
        message = "pins is no table of names"
        raise source.error((name, "pins"), message, clipped(repr(pins)), expected)
    keys = {key: value for key, value in table.items() if key not in _GRAMMAR}
    keys = _completed(keys, kind.schema)
    try:
        checked = kind.schema.model_validate(keys, context={"home": source.folder, "short": short})
    except ValidationError as error:
        raise source.refusal(error, kind.schema, at or (name,)) from None
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
                "not valid TOML", where=self.label, got=clipped(str(error)), hint=hint
            ) from None

    def where(self, path: KeyPath) -> str:
        names = tuple(str(part) for part in path)
        for key, text in self.overrides.items():
            if key[: len(names)] == names or names[: len(key)] == key:
                return f"--set {clipped(text)!r}"
        line = _line_of(self.text, names)
        place = self.label if line is None else f"{self.label}, line {line}"
        return f"{place}, key {dotted(path)}"

    def error(
        self,
        path: KeyPath,
        message: str,
        got: object = None,
        expected: str | None = None,
        hint: str | None = None,
    ) -> UsageError:
        """The error of a key."""
        return UsageError(message, where=self.where(path), got=got, expected=expected, hint=hint)

    def refusal(
        self, error: ValidationError, schema: type[BaseModel], at: KeyPath = ()
    ) -> UsageError:
        """What the ``schema`` of the table ``at`` finds wrong with it."""
        path, words = told(error, schema, at, _GRAMMAR if at else ())
        return UsageError(where=self.where(path), **words)


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
        folder = Path.cwd() if path.parent == Path() else path.parent  # Path() is: no folder
        return _Source(str(path), path.stem, text_of(content), folder)
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
    if not equals or not value:
        raise _no_override(text)
    _put(data, name, override_value(value), text, source)


def _no_override(text: str) -> UsageError:
    example = "dotted.key=value, such as kick.drive.voltage=80 or beam.layers[0].thickness=0.2 mm"
    return UsageError("not an override", where="--set", got=repr(clipped(text)), expected=example)


def _put(data: dict[str, Any], name: str, value: Any, text: str, source: _Source) -> None:
    """Set the key ``name``; tables on the way are made, entries of lists must be there."""
    steps = re.findall(rf"{_WORD}|{_INDEX}", name)
    long = len(steps) > DEEPEST or max(map(len, steps), default=0) > LONGEST_KEY
    if long or not _KEY.fullmatch(name):
        raise _no_override(text)
    path: list[str] = []  # as the schema has it: entries of lists counted from their beginning
    where, so_far = f"--set {clipped(text)!r}", ""
    holder: Any = data
    key: str | int = ""
    for step in steps:
        key = _place(holder, step, so_far, where)
        path.append(str(key))
        so_far += step if step[0] == "[" or not so_far else f".{step}"
        if len(path) < len(steps):
            holder = holder.setdefault(key, {}) if isinstance(holder, dict) else holder[key]
    source.overrides[tuple(path)] = text
    if isinstance(holder, dict):
        holder.pop(_ALTERNATIVES.get(name, ""), None)
    holder[key] = value


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
    """What stands behind ``key=``: a TOML value, or the text itself where it is none.

    Such texts are bare words and numbers with a unit.
    """
    try:
        table = parse_toml(f"value = {text}")
    except ValueError:
        return text
    return table["value"] if set(table) == {"value"} else text


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
