"""From a gallery name or a TOML file to a checked :class:`Scene`, with errors that say where."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from kc2spice.core.errors import UsageError, candidates, did_you_mean, unknown
from kc2spice.core.quantities import (
    clipped,
    describe_invalid,
    display_text,
    entries,
)
from kc2spice.core.untrusted_files import (
    identifier,
)
from kc2spice.scene.compose import with_joins
from kc2spice.scene.model import DEFAULT_TYPES, GROUND, Names, Part, PartType, Scene
from kc2spice.scene.overrides import override_texts, parse_override, set_key
from kc2spice.scene.parttype import part_type, type_names
from kc2spice.scene.plausible import apply_action, check_drive_levels
from kc2spice.scene.problems import check_periods, problems
from kc2spice.scene.resolve import resolve, with_governed
from kc2spice.scene.scene_file import SceneFile, open_scene
from kc2spice.scene.settings import Analysis, Frame
from kc2spice.scene.start_conditions import find_start_errors

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,47}")
_PARTS = "kc2spice scenes --parts"  # lists the part types with their keys
_GRAMMAR = ("part", "pins")  # keys of every part table


def load_scene(
    scene: Scene | str | Path | Mapping[str, Any],
    overrides: Sequence[str] | Mapping[str, Any] = (),
) -> Scene:
    """Read a scene, apply overrides in order, check it and join its parts.

    Parameters
    ----------
    scene : Scene, str, Path or mapping
        Name of a built-in scene (``kc2spice scenes`` lists them), path of a TOML file, the tables
        of such a file as a mapping, or a scene to be changed.
    overrides : sequence of str, or mapping of str to value, optional
        Texts ``dotted.key=value``, or a mapping of dotted keys to values. A value in a text is TOML
        (``80``, ``"80 V"``, ``[0, 1e5]``), a bare word or a quantity (``80 V``, ``antiparallel``).
        Numbers are in SI units. The path of a TOML file of such keys may replace a text. Entries of
        a list are counted from 0, or from its end by negative numbers:
        ``beam.layers[0].thickness``, ``disc.layers[-1].material``.

    Returns
    -------
    Scene
        Checked scene, whose numbers are in SI units.

    Raises
    ------
    UsageError : no such scene, not TOML, unknown key or part type, bad value, keys that contradict
        each other, pins that do not fit.

    Examples
    --------
    >>> import kc2spice as kc
    >>> scene = kc.load_scene("impact", ["impact.velocity=-50 cm/s"])
    >>> scene.name, scene.part("impact").keys.velocity
    ('impact', -0.5)
    """
    if isinstance(scene, Scene) and not overrides:
        return scene
    if not isinstance(scene, (Scene, str, Path, Mapping)):
        raise UsageError(
            "not a scene",
            where="scene",
            got=f"{type(scene).__name__} {scene!r}"[:120],
            expected="a name or path, a mapping with its tables, or a kc.Scene",
            hint='write for example kc.load_scene("impact")',
        )
    if isinstance(scene, Scene):
        source, data = SceneFile("scene", scene.name, "", scene.home), _copied(scene.tables)
    elif isinstance(scene, Mapping):
        source, data = SceneFile("scene", "scene", "", Path()), _copied(scene)
    else:
        source = open_scene(scene)
        data = source.parse()
    data.setdefault("name", identifier(source.stem, "scene"))
    if isinstance(overrides, str):
        raise UsageError(
            "overrides is a text, not a list of texts",
            where="overrides",
            got=repr(clipped(overrides)),
            expected='a list such as ["KEY=VALUE"], or a mapping such as {"KEY": VALUE}',
            hint=f"write overrides=[{clipped(overrides)!r}]",
        )
    if isinstance(overrides, Mapping):
        changes = [(name, value, f"{name}={value}") for name, value in overrides.items()]
    else:
        changes = [(*parse_override(text), text) for text in override_texts(overrides)]
    stated = [name for name, table in data.items() if isinstance(table, Mapping)]
    for name, value, text in changes:
        source.overrides[set_key(data, name, value, text)] = text
    _only_parts_of(data, stated, source)
    try:
        result = _scene(data, source)
        return replace(result, workspace=scene.workspace) if isinstance(scene, Scene) else result
    except UsageError as problem:
        # a file that the scene names is a place of its own, not a key
        if problem.where is not None and not Path(problem.where).is_absolute():
            problem.where = source.where(problem.where)
        raise


def _only_parts_of(data: Mapping[str, Any], stated: Sequence[str], source: SceneFile) -> None:
    """Refuse overrides of a part that the scene lacks; one with a type adds a part."""
    known = {*stated, *Frame.model_fields, *DEFAULT_TYPES}
    for name, table in data.items():
        if name in known or not isinstance(table, Mapping) or "part" in table:
            continue
        parts = [part for part in stated if part not in Frame.model_fields]
        raise UsageError(
            f"this scene has no part {name!r}",
            where=source.where(name),
            expected=f"a key of one of its parts: {candidates(name, parts)}",
            hint=did_you_mean(name, parts) or "use the name of one of these parts",
        )


def _copied(value: Any) -> Any:
    """A copy whose tables and lists may be changed."""
    if isinstance(value, Mapping):
        return {key: _copied(item) for key, item in value.items()}
    return list(map(_copied, value)) if isinstance(value, (list, tuple)) else value


def _scene(data: dict[str, Any], source: SceneFile) -> Scene:
    """The scene that ``data`` says; of errors ``where`` is a key."""
    home = source.folder
    types = {name: _type(name, table) for name, table in _part_tables(data)}
    frame = {key: data[key] for key in data if key not in types}
    scene = Scene(_validated(Frame, frame, ()), {}, home=home)
    parts = {}
    for name, kind in types.items():
        short = () if "part" in data[name] else tuple(data)
        parts[name] = _part(name, data[name], kind, home, short=short)
    analysis = None
    for part in list(parts.values()):
        for name, table in part.type.expand(part, data).items():
            if name == "analysis":
                analysis = analysis or _validated(Analysis, table, (part.name,))
                continue
            if name.lower() in map(str.lower, parts):
                expected = f"another name: {part.name} brings a part of this one along"
                raise UsageError("this name is taken", where=name, got=name, expected=expected)
            keys = {key: value for key, value in table.items() if key != "at"}
            at = table.get("at")
            place = at if isinstance(at, tuple) else (name,)
            parts[name] = _part(name, keys, _type(name, keys), home, place)
    scene = replace(scene, parts=parts, tables=_copied(data), source=source)
    if analysis is not None and "analysis" not in data:
        scene = replace(scene, frame=scene.frame.model_copy(update={"analysis": analysis}))
    scene = with_governed(scene)
    for problem in problems(scene):
        raise problem
    scene = resolve(_driven(scene))
    wild = apply_action(check_drive_levels(scene), scene.checks.plausible)
    for problem in chain(check_periods(scene), find_start_errors(scene, scene.rests), wild):
        raise problem
    return scene


def _driven(scene: Scene) -> Scene:
    """``scene``; of an ``ac`` that nothing drives with 1 V on its body's first electrical port.

    Raises
    ------
    UsageError : nothing drives it, and there is no such port or something is joined to it.
    """
    parts = scene.parts
    if scene.analysis.type != "ac" or any(part.type.drives(part, scene) for part in parts.values()):
        return scene
    exported = replace(with_joins(scene), ports="all")
    bodies = [part for part in parts.values() if part.reduced]
    electrical = ([p for p in part.type.pins(part, exported) if p.unit == "V"] for part in bodies)
    ports = [(b.name, pins[0].name) for b, pins in zip(bodies, electrical, strict=True) if pins]
    if len(ports) != 1 or ports[0][1] in parts[ports[0][0]].pins or scene.is_target(*ports[0]):
        at = f" at {', '.join(map('.'.join, ports))}" if ports else ""
        raise UsageError(
            "nothing drives this analysis",
            where="analysis.type",
            got="ac, and no source with an ac value",
            expected=f'a source with ac = "1 V"{at}',
            hint="a body whose electrical port nothing is joined to is driven by 1 V",
        )
    body = ports[0][0]
    name = Names(parts).name(body, f"{body}_drive")
    table = {"part": "source", "ac": "1 V", "pins": {"out": ".".join(ports[0])}}
    drive = _part(name, table, _type(name, table), scene.home)
    return replace(scene, parts={**parts, name: drive})


def _part_tables(data: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Top-level tables that are parts."""
    spellings: dict[str, str] = {}
    for name, table in data.items():
        if name in Frame.model_fields:
            continue
        if not isinstance(table, Mapping) and name in DEFAULT_TYPES:
            expected = f"a table, [{name}]"
            raise UsageError("not a table", where=name, got=display_text(table), expected=expected)
        if not isinstance(table, Mapping):
            raise _unknown(name, data)
        if not _NAME.fullmatch(name) or name.lower() == GROUND:
            raise UsageError(
                "not a name for a part",
                where=name,
                got=repr(clipped(name)),
                expected="a letter, then letters, digits and _, at most 48 in all; not gnd",
                hint=f"rename it, such as [{identifier(name, 'part')}]",
            )
        first = spellings.setdefault(name.lower(), name)
        if first != name:
            raise UsageError(
                "two parts whose names differ in case only, which netlists ignore",
                where=name,
                got=f"{first} and {name}",
                expected="names that differ in more than case",
                hint=f"rename one of them, such as {name}_2",
            )
        yield name, table


def _unknown(name: str, data: Mapping[str, Any]) -> UsageError:
    """The error of a key at the top that is none; perhaps it belongs below the name of a part."""
    parts = {
        n: t for n, t in data.items() if isinstance(t, Mapping) and n not in Frame.model_fields
    }
    kinds = {item: table.get("part", DEFAULT_TYPES.get(item)) for item, table in parts.items()}
    schemas = {n: kind.schema for n, k in kinds.items() if (kind := part_type(str(k))) is not None}
    part_keys: list[str] = []
    for item, schema in schemas.items():
        part_keys += [".".join((item, *key)) for key, _ in entries(schema)]
    below = f"keys of a part stand below its name: {', '.join(parts)}" if parts else None
    return UsageError(
        "unknown key",
        where=name,
        expected=f"one of {candidates(name, Frame.model_fields)}, or a table with part = TYPE",
        hint=did_you_mean(name, Frame.model_fields) or did_you_mean(name, part_keys) or below,
    )


def _type(name: str, table: Mapping[str, Any]) -> PartType:
    selected = table.get("part", DEFAULT_TYPES.get(name))
    if selected is None:
        near = did_you_mean(name, [*Frame.model_fields, *DEFAULT_TYPES])
        raise UsageError(
            "this table states no part type",
            where=name,
            expected=f"part = one of {candidates(name, type_names(), _PARTS)}",
            hint=near
            or f'add  part = "TYPE"  to [{name}]; kc2spice scenes --parts lists the types',
        )
    result = part_type(selected) if isinstance(selected, str) else None
    if result is None:
        error = unknown("unknown part type", selected, type_names(), f"{name}.part", _PARTS)
        error.hint = error.hint or (
            "a part type of your own needs kc.register_part in Python, or an installed package "
            "with an entry point in the group kc2spice.parts"
        )
        raise error
    return result


def _part(
    name: str,
    table: Mapping[str, Any],
    kind: PartType,
    home: Path,
    at: tuple[str | int, ...] = (),
    short: tuple[str, ...] = (),
) -> Part:
    """A part of its table; ``at`` is where the file has it, if not under its name. ``short`` are
    the tables of the scene where this one's name says its type, which some keys depend on."""
    pins = table.get("pins", {})
    if not isinstance(pins, Mapping) or not all(isinstance(v, str) for v in pins.values()):
        raise UsageError(
            "pins is not a table",
            where=f"{name}.pins",
            got=clipped(repr(pins)),
            expected="a table of pins, each with the pin that it joins, or gnd",
            hint='write  pins = { PIN = "PART.PIN" }',
        )
    keys = {key: value for key, value in table.items() if key not in _GRAMMAR}
    keys, context = _completed(keys, kind.schema), {"home": home, "short": short}
    checked = _validated(kind.schema, keys, at or (name,), context)
    return Part(name, kind, checked, dict(pins), at)


def _validated(
    schema: type[BaseModel],
    table: Mapping[str, Any],
    at: tuple[str | int, ...],
    context: Mapping[str, Any] | None = None,
) -> Any:
    """The table ``at`` as its ``schema``, or an error that names its invalid key."""
    try:
        return schema.model_validate(table, context=context)
    except ValidationError as error:
        path, words = describe_invalid(error, schema, at, _GRAMMAR if at else (), table)
        raise UsageError(where=".".join(map(str, path)), **words) from None


def _completed(table: Mapping[str, Any], schema: type[BaseModel]) -> dict[str, Any]:
    """``table`` whose tables have what the schema's default for them says and they do not.

    ``ring = { outer = "6 mm" }`` changes the outer diameter of the usual ring and nothing else.
    """
    result = dict(table)
    for name, field_ in schema.model_fields.items():
        default = field_.default
        if isinstance(default, BaseModel) and isinstance(result.get(name), Mapping):
            stated = {key: getattr(default, key) for key in default.model_fields_set}
            result[name] = stated | _completed(result[name], type(default))
    return result
