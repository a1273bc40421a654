"""Functions that load and check scenes from names, TOML files or mappings."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel, ValidationError

from kc2spice.core.argument_and_option_names import check_arguments
from kc2spice.core.errors import UsageError, did_you_mean, list_candidates
from kc2spice.core.key_actions import SetKey, SweepKey
from kc2spice.core.key_errors import describe_invalid_key
from kc2spice.core.toml_text import clip_text, display_text
from kc2spice.core.untrusted_files import make_identifier
from kc2spice.core.user_warnings import collect_warnings, warn_user
from kc2spice.scene.key_checks import check_periods, check_scene
from kc2spice.scene.net_formation import add_default_joins, warn_of_short_circuits
from kc2spice.scene.override_advice import (
    advise_dict_entry,
    advise_override,
    check_override_targets,
    explain_replaced_type,
    warn_of_replaced_keys,
    write_override_example,
)
from kc2spice.scene.override_origin import OverrideOrigin
from kc2spice.scene.overrides import (
    Override,
    delete_excluded_keys,
    read_overrides,
    set_key,
    split_table_of_part,
)
from kc2spice.scene.part_method_calls import add_part_records, resolve
from kc2spice.scene.parttype import find_part_type, list_type_names
from kc2spice.scene.plausibility import apply_check_action, check_drive_levels
from kc2spice.scene.scene_classes import DEFAULT_TYPES, GROUND, NameAllocator, Part, PartType, Scene
from kc2spice.scene.scene_file import SceneFile, open_scene
from kc2spice.scene.settings import Analysis, SceneKeys
from kc2spice.scene.start_conditions import find_start_errors
from kc2spice.scene.table_advice import (
    PARTS_COMMAND,
    advise_drive,
    advise_material_in_layer,
    advise_top_level_key,
    make_unknown_key_error,
    make_unknown_type_error,
    suggest_catalogue_keys,
    suggest_part_type,
)

_PART_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,47}")
STRUCTURAL_KEYS = ("part", "pins")  # keys that every table of a part may contain
# line number at the end of a file position such as amp.lib:4
_LINE_NUMBER_SUFFIX = re.compile(r"[^.]:\d+$")


@check_arguments
def load_scene(
    scene: Scene | str | Path | Mapping[str, Any],
    overrides: Sequence[str] | Mapping[str, Any] = (),
) -> Scene:
    """Read a scene, apply overrides in order, check the scene and join its parts.

    Parameters
    ----------
    scene : Scene, str, Path or mapping
        Name of a built-in scene (``kc2spice scenes`` lists them), path of a TOML file, the tables
        of such a file as a mapping, or a scene to be changed.
    overrides : sequence of str, or mapping of str to value, optional
        Strings ``dotted.key=value``, or a mapping of dotted keys to values. In a string
        ``dotted.key=value``, the value is a TOML value (``80``, ``"80 V"``, ``[0, 1e5]``), a
        quantity (``80 V``) or a word (``antiparallel``). Numbers are in SI units. A string may also
        be the path of a TOML file that contains dotted keys and values. A table of a part without
        the key ``part`` changes only the keys in the table. List entries are counted from 0;
        negative numbers count from the end of the list: ``beam.layers[0].thickness``,
        ``disc.layers[-1].material``.

    Returns
    -------
    Scene
        Checked scene, whose numbers are in SI units.

    Raises
    ------
    UsageError : the scene does not exist or is not TOML, a key or part type is unknown, a value is
        invalid, keys contradict each other, or pins do not match.

    Examples
    --------
    >>> import kc2spice as kc
    >>> scene = kc.load_scene("impact", ["impact.velocity=-50 cm/s"])
    >>> scene.name, scene.get_part("impact").keys.velocity
    ('impact', -0.5)
    """
    if isinstance(scene, Scene) and not overrides:
        return scene
    if not isinstance(scene, (Scene, str, Path, Mapping)):
        raise UsageError(
            "this object is not a scene",
            where="scene",
            got=f"{type(scene).__name__} {scene!r}"[:120],
            expected="a name or path, a mapping with its tables, or a kc.Scene",
            hint='write for example kc.load_scene("impact")',
        )
    if isinstance(scene, Scene):
        source, data = SceneFile("scene", scene.name, "", scene.home), _copy_tables(scene.tables)
        if isinstance(scene.source, SceneFile):
            source.override_folders.update(scene.source.override_folders)
    elif isinstance(scene, Mapping):
        source, data = SceneFile("scene", "scene", "", Path()), _copy_tables(scene)
    else:
        source = open_scene(scene)
        data = source.parse_tables()
    data.setdefault("name", make_identifier(source.stem, "scene"))
    if isinstance(overrides, str):
        raise UsageError(
            "overrides is a string, not a list of strings",
            where="overrides",
            got=repr(clip_text(overrides)),
            expected='a list such as ["KEY=VALUE"], or a mapping such as {"KEY": VALUE}',
            hint=f"write overrides=[{clip_text(overrides)!r}]",
        )
    tables = {name: table for name, table in data.items() if isinstance(table, Mapping)}

    parts = tables.keys() - SceneKeys.model_fields.keys()
    stated = [
        single
        for override in read_overrides(overrides, partial(write_override_example, tables))
        for single in split_table_of_part(override, parts)
    ]
    # the tables and the file before the overrides, to find the override that causes an error
    find_error_without = partial(
        _find_error_without,
        stated=stated,
        tables=_copy_tables(data),
        source=replace(source, overrides={}, override_folders=dict(source.override_folders)),
    )
    with collect_warnings() as notes:  # an error is more important than these warnings
        for override in stated:
            _apply_override(data, source, override)
    check_override_targets(data, tables, source)
    try:
        result = _make_scene(data, source)
        for note in notes:
            warn_user(note)
        return replace(result, workspace=scene.workspace) if isinstance(scene, Scene) else result
    except UsageError as problem:
        # an absolute path, or a line of a netlist, is not a key of the scene file
        where = problem.where
        if (
            where is not None
            and not Path(where).is_absolute()
            and not _LINE_NUMBER_SUFFIX.search(where)
        ):
            advice = _suggest_probed_result(data, source, problem)
            if (hint := advice or suggest_catalogue_keys(data, problem)) is not None:
                problem.hint = hint
            if isinstance(problem.action, SweepKey) and isinstance(scene, (str, Path)):
                problem.hint = replace(problem.action, scene=str(scene))
            list_pins = partial(_list_pins_of_table, home=source.base_folder)
            if not explain_replaced_type(data, source, problem, list_pins):
                advise_override(source, problem, find_error_without)
                if isinstance(scene, Mapping):
                    advise_dict_entry(problem)
                problem.where = source.locate_key(where)
        raise


def _apply_override(data: dict[str, Any], source: SceneFile, override: Override) -> None:
    """Set the key of an override in the tables ``data``, and delete the keys that it excludes."""
    override = replace(override, value=_copy_tables(override.value))
    path = set_key(data, override)
    deleted = delete_excluded_keys(data, path, override.value)
    warn_of_replaced_keys(source, path, override.value, deleted, override.origin)
    for key in deleted:
        source.overrides.pop(key, None)
    source.set_override(path, override.value, override.origin, override.folder)


def _find_error_without(
    origin: OverrideOrigin,
    stated: Sequence[Override],
    tables: Mapping[str, Any],
    source: SceneFile,
) -> Exception | None:
    """Return the error of a scene without the override of this origin, or None.

    ``stated`` are all overrides. ``tables`` and ``source`` are the tables and the file of the scene
    without overrides.
    """
    data = _copy_tables(tables)
    file = replace(source, overrides={}, override_folders=dict(source.override_folders))
    try:
        with collect_warnings():  # a scene that the user did not state issues no warnings
            for override in stated:
                if override.origin != origin:
                    _apply_override(data, file, override)
            _make_scene(data, file)
    # The only effect of an unexpected exception is that the user's error names no override.
    except Exception as error:
        return error
    return None


def _copy_tables(value: Any) -> Any:
    """Return a deep copy of tables and lists."""
    if isinstance(value, Mapping):
        return {key: _copy_tables(item) for key, item in value.items()}
    return list(map(_copy_tables, value)) if isinstance(value, (list, tuple)) else value


def _make_scene(data: dict[str, Any], source: SceneFile) -> Scene:
    """Return the checked and resolved scene that the tables ``data`` describe."""
    types = {name: _find_part_type(name, table) for name, table in _list_part_tables(data)}
    frame = {key: data[key] for key in data if key not in types}
    scene = Scene(_validate_table(SceneKeys, frame, ()), {}, home=source.folder)
    parts, analysis = _make_parts(data, types, source)
    scene = replace(scene, parts=parts, tables=_copy_tables(data), source=source)
    if analysis is not None and "analysis" not in data:
        scene = replace(scene, frame=scene.frame.model_copy(update={"analysis": analysis}))
    scene = add_part_records(scene)
    for problem in check_scene(scene):
        raise problem
    scene = resolve(_add_default_drive(scene))
    warn_of_short_circuits(scene)
    implausible = apply_check_action(check_drive_levels(scene), scene.checks.plausible)
    start_errors = find_start_errors(scene, scene.equilibrium_conditions)
    for problem in chain(check_periods(scene), start_errors, implausible):
        raise problem
    return scene


def _suggest_probed_result(
    data: Mapping[str, Any], source: SceneFile, error: UsageError
) -> SetKey | None:
    """Suggest a result for a probe without the key ``of``; None for other errors."""
    probe = re.fullmatch(r"probes\.(\w+)\.of", error.where or "")
    if probe is None or not error.message.endswith("is missing"):
        return None
    # imported here, because only the error about a missing key ``of`` lists the results of a scene
    from kc2spice.scene.probed_results import list_all_results

    with suppress(UsageError):
        scene = _make_scene({key: data[key] for key in data if key != "probes"}, source)
        results = list_all_results(scene)
        same = [name for name in results if name.partition(".")[2][:1] in probe[1]]
        for result in [*same, *results][:1]:
            table = f"probes.{probe[1]}"
            return SetKey(table, "of", f'"{result}"', verb="add", place=table)
    return None


def _make_parts(
    data: Mapping[str, Any], types: Mapping[str, PartType], source: SceneFile
) -> tuple[dict[str, Part], Analysis | None]:
    """Make all parts of a scene; also return an analysis that a part generates."""

    def make_part(
        name: str,
        table: Mapping[str, Any],
        kind: PartType,
        at: tuple[str | int, ...] = (),
        **options: Any,
    ) -> Part:
        """Make a part, and set the folder of the files that it reads.

        If an override file sets keys of the part, file names are relative to the folder of the
        override file. Otherwise, file names are relative to the folder of the scene.
        """
        folder = source.find_override_folder(tuple(map(str, at or (name,))))
        part = _make_part(name, table, kind, folder or source.folder, at, **options)
        keys = frozenset(path[1] for path in source.overrides if path[0] == name and path[1:])
        return replace(part, folder=folder, overridden_keys=keys)

    parts = {}
    for name, kind in types.items():
        short = () if "part" in data[name] else tuple(data)
        parts[name] = make_part(name, data[name], kind, short=short, tables=data)
    analysis = None
    for part in list(parts.values()):
        for name, table in part.type.generate_tables(part, data).items():
            if name == "analysis":
                analysis = analysis or _validate_table(Analysis, table, (part.name,))
                continue
            if name.lower() in map(str.lower, parts):
                raise UsageError(
                    "this name is already used",
                    where=name,
                    got=name,
                    expected=f"a name other than {name}, which {part.name} adds to the scene",
                    hint=f"rename your part {name}",
                )
            keys = dict(table)
            at = keys.pop("at", None)
            place = at if isinstance(at, tuple) else (name,)
            parts[name] = make_part(name, keys, _find_part_type(name, keys), place)
    return parts, analysis


def _add_default_drive(scene: Scene) -> Scene:
    """Return the scene; add a 1 V source if no part drives its ``ac`` analysis.

    Raises
    ------
    UsageError : nothing drives the scene, and the number of free electrical ports is not one.
    """
    parts = scene.parts
    if scene.analysis.type != "ac" or any(
        part.type.has_ac_source(part, scene) for part in parts.values()
    ):
        return scene
    exported = replace(add_default_joins(scene), ports="all")
    ports = []
    for body in scene.bodies:
        for pin in body.type.pins(body, exported):
            if pin.unit == "V":
                ports.append((body.name, pin.name))
                break  # the first electrical port of each body
    if len(ports) != 1 or ports[0][1] in parts[ports[0][0]].pins or scene.is_target(*ports[0]):
        at = f" at {', '.join(map('.'.join, ports))}" if ports else ""
        raise UsageError(
            "the ac analysis has no source",
            where="analysis.type",
            got="ac, and no source with an ac value",
            expected=f'a source with ac = "1 V"{at}',
            hint=advise_drive(exported, ports),
        )
    driven = ports[0][0]
    name = NameAllocator(parts).allocate_name(driven, f"{driven}_drive")
    table = {"part": "source", "ac": "1 V", "pins": {"out": ".".join(ports[0])}}
    drive = _make_part(name, table, _find_part_type(name, table), scene.home)
    return replace(scene, parts={**parts, name: drive})


def _list_part_tables(data: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the name and the table of each part of a scene."""
    spellings: dict[str, str] = {}
    for name, table in data.items():
        if name in SceneKeys.model_fields:
            continue
        if not isinstance(table, Mapping) and name in DEFAULT_TYPES:
            raise UsageError(
                "this value is not a table",
                where=name,
                got=display_text(table),
                expected=f"a table, [{name}]",
                hint=f"write  [{name}]  and below it the keys of the part",
            )
        if not isinstance(table, Mapping):
            raise make_unknown_key_error(name, data)
        if not _PART_NAME.fullmatch(name) or name.lower() == GROUND:
            raise UsageError(
                "this name of a part is not valid",
                where=name,
                got=repr(clip_text(name)),
                expected="a letter, then letters, digits and _, at most 48 in all; not gnd",
                hint=f"rename it, such as [{make_identifier(name, 'part')}]",
            )
        first = spellings.setdefault(name.lower(), name)
        if first != name:
            raise UsageError(
                "the names of two parts differ in letter case only",
                where=name,
                got=f"{first} and {name}",
                expected="names that differ in more than letter case",
                hint=f"rename one of them, such as {name}_2",
            )
        yield name, table


def _find_part_type(name: str, table: Mapping[str, Any]) -> PartType:
    """Return the part type that the key ``part`` or the name of a table determines."""
    selected = table.get("part", DEFAULT_TYPES.get(name))
    if selected is None:
        near = did_you_mean(name, [*SceneKeys.model_fields, *DEFAULT_TYPES])
        for key in ("type", "kind", "parttype", "Part"):
            if isinstance(table.get(key), str) and find_part_type(table[key].lower()) is not None:
                near = f'write  part = "{table[key].lower()}"  in place of {key} = "{table[key]}"'
        if name.lower() in ("material", "materials"):
            raise UsageError(
                "a scene cannot contain a table of materials",
                where=name,
                expected="the constants of a material in the key `material` of a part or a layer",
                hint=advise_material_in_layer(table),
            )
        raise UsageError(
            "the key `part` is missing in this table",
            where=name,
            expected=f"part = one of {list_candidates(name, list_type_names(), PARTS_COMMAND)}",
            hint=near
            or SetKey(name, "part", '"TYPE"', verb="add", end=f"; {PARTS_COMMAND} lists the types"),
        )
    result = find_part_type(selected) if isinstance(selected, str) else None
    if result is None:
        advice = (
            f"run {PARTS_COMMAND}, which lists all types; "
            "docs/how-to/own_part.md describes types of your own"
        )
        raise make_unknown_type_error(
            selected, f"{name}.part", suggest_part_type(selected) or advice
        )
    return result


def _make_part(
    name: str,
    table: Mapping[str, Any],
    kind: PartType,
    home: Path,
    at: tuple[str | int, ...] = (),
    short: tuple[str, ...] = (),
    tables: Mapping[str, Any] = MappingProxyType({}),
) -> Part:
    """Make the part that a table of the scene describes.

    ``at`` is the path of the table in the file, by default ``(name,)``. If the name of the part's
    table implies the part type, ``short`` contains the names of all tables of the scene. If the key
    ``part`` states the part type, ``short`` is empty. The defaults of a part may depend on the
    names in ``short``. For example, a table ``harmonic`` removes the default pulse of a stack.
    ``tables`` are all tables of the scene; errors suggest pins from ``tables``.
    """
    pins = table.get("pins", {})
    if not isinstance(pins, Mapping) or not all(isinstance(v, str) for v in pins.values()):
        raise _make_pins_error(name, table, kind, home, tables)
    keys = _complete_tables(table, kind.schema)
    for key in STRUCTURAL_KEYS:
        keys.pop(key, None)
    checked = _validate_table(kind.schema, keys, at or (name,), {"home": home, "short": short})
    return Part(name, kind, checked, dict(pins), at)


def _list_pins(name: str, table: Mapping[str, Any], kind: PartType, home: Path) -> list[str]:
    """Return the names of the pins that a part has in a scene without other parts.

    The result is empty if the pins depend on other parts.
    """
    # If the pins cannot be listed, the error message for the user merely contains no suggestion.
    with suppress(Exception):
        part = _make_part(name, {**table, "pins": {}}, kind, home)
        alone = Scene(SceneKeys(name=name), {name: part}, home=home)
        return [pin.name for pin in kind.pins(part, replace(alone, ports="all"))]
    return []


def _list_pins_of_table(name: str, table: Mapping[str, Any], home: Path) -> list[str]:
    """Return the names of the pins of a part whose type the table states, as in `_list_pins`."""
    return _list_pins(name, table, _find_part_type(name, table), home)


def _suggest_target(name: str, tables: Mapping[str, Any], home: Path) -> str:
    """Suggest a target for a pin: the first pin of another part, or ``gnd``."""
    for other, table in tables.items():
        if other != name and other not in SceneKeys.model_fields and isinstance(table, Mapping):
            with suppress(UsageError):
                for pin in _list_pins(other, table, _find_part_type(other, table), home):
                    return f"{other}.{pin}"
    return GROUND


def _make_pins_error(
    name: str, table: Mapping[str, Any], kind: PartType, home: Path, tables: Mapping[str, Any]
) -> UsageError:
    """Return the error about a key ``pins`` that is not a table of strings.

    The error suggests pins of the part.
    """
    pins = table["pins"]
    known = _list_pins(name, table, kind, home) or ["PIN"]
    if isinstance(pins, Mapping):
        wrong_pin = next(pin for pin in pins if not isinstance(pins[pin], str))
        stated = pins[wrong_pin]
        targets = stated if isinstance(stated, (list, tuple)) else [stated]
        names = [item for item in targets if isinstance(item, str)]
        # 0 is the ground node of netlists
        names += [GROUND if 0 in targets else _suggest_target(name, tables, home)]
        target = names[0]
        return UsageError(
            f"the pin {wrong_pin} must be connected to exactly one pin",
            where=f"{name}.pins.{wrong_pin}",
            got=display_text(stated),
            expected="the name of one other pin, or gnd",
            hint=f'write  {wrong_pin} = "{target}"'
            + (f", and connect the other pins to {name}.{wrong_pin}" if len(targets) > 1 else ""),
        )
    targets = pins if isinstance(pins, (list, tuple)) else [pins]
    stated = [item for item in targets if isinstance(item, str)]
    stated = stated or [_suggest_target(name, tables, home)]
    joins = ", ".join(f'{pin} = "{target}"' for pin, target in zip(known, stated, strict=False))
    return UsageError(
        "pins is not a table",
        where=f"{name}.pins",
        got=display_text(pins),
        expected=f"a table that connects pins of a {kind.name}: {list_candidates('', known)}",
        hint=f"write  pins = {{ {joins} }}",
    )


def _validate_table(
    schema: type[BaseModel],
    table: Mapping[str, Any],
    at: tuple[str | int, ...],
    context: Mapping[str, Any] | None = None,
) -> Any:
    """Check a table, and convert the table to an instance of its schema class.

    ``at`` is the path of the table in the file.

    Raises
    ------
    UsageError : a key is invalid.
    """
    try:
        return schema.model_validate(table, context=context)
    except ValidationError as error:
        path, details = describe_invalid_key(
            error, schema, at, STRUCTURAL_KEYS if at else (), table
        )
        details["hint"] = advise_top_level_key(path[len(at) :], table, details["hint"])
        raise UsageError(where=".".join(map(str, path)), **details) from None


def _complete_tables(table: Mapping[str, Any], schema: type[BaseModel]) -> dict[str, Any]:
    """Return a copy of ``table`` with defaults for missing keys of inner tables.

    For example, ``ring = { outer = "6 mm" }`` changes only the outer diameter of the default ring.
    """
    result = dict(table)
    for name, field_ in schema.model_fields.items():
        default = field_.default
        if isinstance(default, BaseModel) and isinstance(result.get(name), Mapping):
            stated = {key: getattr(default, key) for key in default.model_fields_set}
            result[name] = stated | _complete_tables(result[name], type(default))
    return result
