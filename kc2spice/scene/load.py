"""Functions that load and check scenes from names, TOML files or mappings."""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from difflib import get_close_matches
from functools import partial
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any

from pydantic import BaseModel, ValidationError

from kc2spice.core.argument_and_option_names import check_arguments
from kc2spice.core.domains import QUANTITIES
from kc2spice.core.errors import UsageError, did_you_mean, list_candidates, normalise_word, unknown
from kc2spice.core.key_errors import UNKNOWN_KEY, describe_invalid_key
from kc2spice.core.schemas import list_keys
from kc2spice.core.synonyms_from_other_programs import PART_TYPE_SYNONYMS
from kc2spice.core.toml_text import clip_text, display_text, format_toml
from kc2spice.core.untrusted_files import make_identifier, parse_toml
from kc2spice.core.user_warnings import warn_user
from kc2spice.scene.catalogue import CataloguePart, find_part
from kc2spice.scene.key_checks import check_periods, check_scene
from kc2spice.scene.keys import KeyDescription, list_part_keys, list_schema_keys
from kc2spice.scene.net_formation import add_default_joins, warn_of_short_circuits
from kc2spice.scene.overrides import (
    EXCLUSIVE_KEYS,
    is_option,
    read_overrides,
    set_key,
    write_example,
)
from kc2spice.scene.part_method_calls import add_part_records, resolve
from kc2spice.scene.parttype import find_part_type, list_type_names
from kc2spice.scene.plausibility import apply_check_action, check_drive_levels
from kc2spice.scene.scene_classes import DEFAULT_TYPES, GROUND, NameAllocator, Part, PartType, Scene
from kc2spice.scene.scene_file import SceneFile, open_scene
from kc2spice.scene.settings import Analysis, SceneKeys
from kc2spice.scene.start_conditions import find_start_errors

_PART_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,47}")
PARTS_COMMAND = "kc2spice scenes --parts"  # command that lists the part types
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
        be the path of a TOML file that contains dotted keys and values. List entries are counted
        from 0; negative numbers count from the end of the list: ``beam.layers[0].thickness``,
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

    typed = dict[tuple[str, ...], str]()  # origins of overrides that are not in a file
    for name, value, place, folder in list(
        read_overrides(overrides, partial(_write_override_example, tables))
    ):
        path = set_key(data, name, value, place)
        source.set_override(path, value, place, folder)
        if folder is None:
            _warn_of_replaced_overrides(typed, path, name, place)
            typed[path] = place
    _require_known_parts(data, tables, source)
    try:
        result = _make_scene(data, source)
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
            problem.hint = advice or _suggest_catalogue_keys(data, problem) or problem.hint
            if not _explain_replaced_type(data, source, problem):
                _advise_override(source, problem)
                if isinstance(scene, Mapping):
                    _advise_python_key(problem)
                problem.where = source.locate_key(where)
        raise


def _warn_of_replaced_overrides(
    typed: Mapping[tuple[str, ...], str], path: tuple[str, ...], name: str, place: str
) -> None:
    """Warn about each earlier override that a later override of key ``name`` replaces.

    ``typed`` contains the origins of the earlier overrides, keyed by path. ``path`` and ``place``
    are the path and the origin of the later override.
    """
    excluded = (*path[:-1], EXCLUSIVE_KEYS.get(name, ""))
    for other, earlier in typed.items():
        if other in (path, excluded):
            texts = [text.removeprefix("--set ") for text in (earlier, place)]
            warn_user(f"{texts[0]} has no effect, because {texts[1]} replaces it")


def _explain_replaced_type(data: Mapping[str, Any], source: SceneFile, problem: UsageError) -> bool:
    """Explain a key error if an override that replaced the part type caused it.

    Return False, and leave the error unchanged, if no override replaces the type of the part. Also
    return False if an override sets the key that the error is about.
    """
    where = str(problem.where)
    name, _, key = where.partition(".")
    origin = source.overrides.get((name, "part"))
    table = data.get(name)
    if origin is None or not isinstance(table, Mapping) or source.find_override(where):
        return False
    if key.partition(".")[0] not in table:
        return False
    changed: dict[str, Any] = {}
    for path in source.overrides:
        if path[0] == name and len(path) > 1:
            changed[path[1]] = table[path[1]]
        if path in source.override_folders and len(path) == 2:
            file = source.override_folders[path] / str(table[path[1]])
            changed[path[1]] = os.path.relpath(file, source.base_folder)
    text = f"{name}={format_toml(changed)}"
    problem.got = f"{where} of {source.label}: {problem.message}"
    problem.message = f"the key `{where}` of the scene does not fit the new part type"
    problem.expected = f"a table {name} with keys of part = {table['part']!r} only"
    problem.hint = (
        f"replace the whole table: add  --set {shlex.quote(text)}"
        if is_option(origin)
        else f"replace the whole table: add  {name!r}: {changed!r}  to the overrides"
    )
    problem.where = origin
    return True


# pattern of a hint that sets a key of a table, such as: add  stop = "1 ms"  to [analysis]
_KEY_HINT = re.compile(r"(?:add|write)  (\w+) = (.+?)  (?:to|in) \[(\[?)([\w.]+)\]+(.*)")

# pattern of a hint that states a fraction, such as: for 5 %, write  tolerance = 0.05  in [rom]
_FRACTION_HINT = re.compile(r"(for \S+ %), write  \w+ = (\S+)(?:  in \[[\w.]+\])?")

# pattern of a hint that deletes a key, such as: delete the key `back`
_DELETE_HINT = re.compile(r"delete (?:the key )?`?(\w+)`?(?: of \[\w+\])?(?=$|;)")

# pattern of a hint that changes one key, such as: raise pulse.period to 1 ms
_OTHER_KEY_HINT = re.compile(r"(?:raise|lower) ([\w.]+) (?:to|above|below) .+")
# Smallest number of letters in a key that is searched for in an error message. Shorter keys could
# be ordinary words, such as `of`.
_SHORTEST_KEY = 4


def _find_override_named_in_error(source: SceneFile, problem: UsageError) -> str | None:
    """Find the origin of the override whose key the error names, or return None.

    The override must change a key of the table in which the error occurs.
    """
    if problem.message == UNKNOWN_KEY:  # the error lists keys that need no change
        return None
    table = str(problem.where).partition(".")[0]
    texts = problem.message, str(problem.got), problem.expected or "", problem.hint or ""
    words = set(re.findall(r"\w+", " ".join(texts)))
    for path, origin in source.overrides.items():
        is_key = path[0] == table and len(path) > 1 and len(path[-1]) >= _SHORTEST_KEY
        if is_key and path[-1] in words:
            return origin
    return None


def _advise_either(origin: str, hint: str | None) -> str:
    """Advise to change an override, or to do what another hint states."""
    override = origin.removeprefix("overrides ")
    change = f"change {override}" + (" in the overrides" if override != origin else "")
    return f"{change}, or {hint}" if hint else change


def _advise_override(source: SceneFile, problem: UsageError) -> None:
    """Advise an override in place of a change of the file, if an override caused an error."""
    where, hint = str(problem.where), problem.hint or ""
    origin = source.find_override(where)
    if origin is None:
        if (other := _find_override_named_in_error(source, problem)) is not None:
            problem.hint = _advise_either(other, problem.hint)
    elif changed := _OTHER_KEY_HINT.fullmatch(hint):
        table = f"{where.partition('.')[0]}."
        if not source.overrides_key(table + changed[1].removeprefix(table)):
            problem.hint = _advise_either(origin, hint)
    elif deleted := _DELETE_HINT.match(hint):
        same_key = deleted[1] == where.rpartition(".")[2]
        if same_key and is_option(origin) and source.overrides_key(where):
            problem.hint = f"leave out {origin}{hint[deleted.end() :]}"
    elif fraction := _FRACTION_HINT.fullmatch(hint):
        problem.hint = f"{fraction[1]}, write  {_write_override(where, fraction[2], origin)}"
    elif stated := _KEY_HINT.fullmatch(hint):
        key, value, is_list, table, end = stated.groups()
        path = f"{table}[0].{key}" if is_list else f"{table}.{key}"
        verb = "write" if source.overrides_key(path) else "add"
        if verb == "add" and problem.message == UNKNOWN_KEY and is_option(origin):
            verb, end = "write", f"{end}  in place of {origin}"
        problem.hint = f"{verb}  {_write_override(path, value, origin)}{end}"


def _write_override(key: str, value: str, origin: str) -> str:
    """Write an override of a key in the form of another override, whose origin is given.

    ``value`` is TOML text. The form is an option ``--set`` or an entry of a Python mapping.
    """
    if not is_option(origin):
        return f"'{key}': {value}  in the overrides"
    text = value[1:-1] if re.fullmatch(r'"[^"]*"', value) else value
    return f"--set {shlex.quote(f'{key}={text}')}"


# pattern of a hint that adds a key to a table, such as: add  layers = []  to disc
_ADD_HINT = re.compile(r"add  (\w+) = (.+)  to (?:\[([\w.]+)\]|([\w.\[\]]+))")


def _advise_python_key(problem: UsageError) -> None:
    """Write the hint that adds a missing TOML key as an entry of a Python mapping."""
    hint = _ADD_HINT.fullmatch(problem.hint or "")
    if hint is None or not problem.message.endswith("is missing"):
        return
    key, text, header, table = hint.groups()
    with suppress(ValueError, UsageError):
        value = parse_toml(f"value = {text}")["value"]
        problem.hint = f"add  {key!r}: {value!r}  to the dict {header or table}"


def _write_override_example(tables: Mapping[str, Any], key: str) -> str:
    """Return an example of an override of ``key``, with the value in the scene."""
    part = key.partition(".")[0]
    keys = _list_part_keys(part, tables[part]) if part in tables else []
    return write_example(key, tables, keys)


def _require_known_parts(
    data: Mapping[str, Any], tables: Mapping[str, Any], source: SceneFile
) -> None:
    """Reject an override of a whole part, and overrides of keys of an unknown part.

    An override that contains a part type adds a part. ``tables`` are the tables of the scene
    without overrides, ``data`` the tables with overrides.
    """
    known = {*tables, *SceneKeys.model_fields, *DEFAULT_TYPES}
    parts = [part for part in tables if part not in SceneKeys.model_fields]
    for name, table in data.items():
        if name in parts and not isinstance(table, Mapping):
            keys = _list_part_keys(name, tables[name])
            raise UsageError(
                f"{name} is a part of this scene, not a key",
                where=source.locate_key(name),
                expected=f"a key of {name}: {list_candidates(name, keys)}",
                hint=f"write {write_example(name, tables, keys)}",
            )
        if name in known or not isinstance(table, Mapping) or "part" in table:
            continue
        raise UsageError(
            f"this scene has no part {name!r}",
            where=source.locate_key(name),
            expected=f"a key of one of its parts: {list_candidates(name, parts)}",
            hint=did_you_mean(name, parts) or _suggest_part(name, table, tables, parts),
        )


def _suggest_part(
    name: str, keys: Mapping[str, Any], tables: Mapping[str, Any], parts: Sequence[str]
) -> str:
    """Suggest a part that has the key ``name`` or the first of the given ``keys``."""
    word = next(iter(keys), "")
    for path in (f"{name}.{word}", word):
        for part in parts:
            if f"{part}.{path}" in _list_part_keys(part, tables[part]):
                return f"write {part}.{path}"
    return "use the name of one of these parts"


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
) -> str | None:
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
            return f'add  of = "{result}"  to probes.{probe[1]}'
    return None


def _suggest_catalogue_keys(data: Mapping[str, Any], error: UsageError) -> str | None:
    """Suggest the keys of a catalogue part for a table that states only its number.

    Return None for errors that are not about missing keys.
    """
    if not error.message.endswith(("is missing", "do not fully determine the circuit")):
        return None
    table = data.get((error.where or "").partition(".")[0])
    number = table.get("number") if isinstance(table, Mapping) else None
    sold = find_part(number) if isinstance(number, str) else None
    return None if sold is None else _advise_catalogue_keys(sold)


def _advise_catalogue_keys(sold: CataloguePart) -> str:
    """Return the advice to write the keys that ``kc2spice parts`` prints for a part."""
    return (
        f'write  part = "{sold.kind}"  and the keys that the command  '
        f"kc2spice parts {shlex.quote(sold.number)}  prints"
    )


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
            hint=_advise_drive(exported, ports),
        )
    driven = ports[0][0]
    name = NameAllocator(parts).allocate_name(driven, f"{driven}_drive")
    table = {"part": "source", "ac": "1 V", "pins": {"out": ".".join(ports[0])}}
    drive = _make_part(name, table, _find_part_type(name, table), scene.home)
    return replace(scene, parts={**parts, name: drive})


def _advise_drive(scene: Scene, ports: Sequence[tuple[str, str]]) -> str:
    """Return a hint that adds an amplitude, or a source, for the ``ac`` analysis.

    If the scene has sources, the hint adds an amplitude to one source, preferably to a source at
    one of the ``ports``. Otherwise, the hint contains a table for a source that drives the first of
    the ``ports``. If ``ports`` is empty, the source drives the first pin of the scene that carries
    a flow, such as a force or a current.
    """
    sources = scene.list_parts("source")
    targets = {target for port in ports for target in scene.parts[port[0]].pins.values()}
    near = [source for source in sources if f"{source.name}.out" in targets]
    near += [source for source in sources if {*map(".".join, ports)} & {*source.pins.values()}]
    if sources:
        source = (near or sources)[0]
        return f'write  ac = "1 {getattr(source.keys, "unit", "V")}"  in [{source.name}]'
    name = NameAllocator(scene.parts).allocate_name("drive", "drive")
    for part in scene.parts.values():
        for pin in part.type.pins(part, scene):
            domain = pin.domain
            through = None if domain is None else domain.through
            if through is None or (ports and (part.name, pin.name) not in ports):
                continue
            kind = "voltage" if pin.unit == "V" else through.name
            if kind in QUANTITIES:
                unit = QUANTITIES[kind][0].get_quantity(QUANTITIES[kind][1]).unit
                keys = "" if kind == "voltage" else f'kind = "{kind}", '
                return (
                    f'add [{name}] with part = "source", {keys}ac = "1 {unit}" and '
                    f'pins = {{ out = "{part.name}.{pin.name}" }}'
                )
    return 'add a part with part = "source" and ac = "1 V"'


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
            raise _make_unknown_key_error(name, data)
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


def _make_unknown_key_error(name: str, data: Mapping[str, Any]) -> UsageError:
    """Return the error about an unknown key at the top level of a scene."""
    delete = f"delete {name}; kc2spice scenes --keys lists all keys"
    if isinstance(data[name], list):
        delete = 'write a table for each part: [NAME] with part = "TYPE"'
    return UsageError(
        UNKNOWN_KEY,
        where=name,
        expected=f"one of {list_candidates(name, SceneKeys.model_fields)}, "
        "or a table with part = TYPE",
        hint=did_you_mean(name, SceneKeys.model_fields)
        or (_advise_key_in_table(name, data, "analysis") if name in Analysis.model_fields else None)
        or (f"delete {name}: ngspice computes at 27 °C" if name.startswith("temp") else None)
        or _suggest_key_of_part(name, data)
        or delete,
    )


def _suggest_key_of_part(name: str, data: Mapping[str, Any]) -> str | None:
    """Suggest to write a key into the first table that has a key of this name.

    If the key has choices, the suggested value is the choice that is most similar to the typed
    value. The result is None if no part has a key with a similar name.
    """
    keys = dict[str, KeyDescription]()
    for part, table in data.items():
        kind = _get_stated_type(part, table) if part not in SceneKeys.model_fields else None
        if kind is not None:
            keys |= {f"{part}.{key.name}": key for key in list_part_keys(kind.schema)}
    keys |= {key.name: key for key in list_schema_keys(SceneKeys) if key.name.count(".") == 1}
    same = [key for key in keys if key.rpartition(".")[2] == name]
    similar = get_close_matches(name, {key.rpartition(".")[2]: key for key in keys}, 1, 0.7)
    same = same or [key for key in keys if key.rpartition(".")[2] in similar]
    if not same:
        return None

    def rank_key(key: str) -> tuple[bool, int]:
        """Return the rank of a dotted key; the hint contains the key with the lowest rank.

        Keys outside of the list ``layers`` have lower ranks than keys in the list. If neither key
        or both keys are in the list, the key with fewer dots has the lower rank.
        """
        return ".layers." in key, key.count(".")

    path = min(same, key=rank_key)
    value, choices = data[name], keys[path].choices
    if isinstance(value, str) and choices and value not in choices:
        value = next(iter(get_close_matches(value, choices, 1)), choices[0])
    table, _, key = path.rpartition(".")
    return _advise_key_in_table(key, {**data, key: value}, table)


def _advise_key_in_table(key: str, data: Mapping[str, Any], table: str) -> str:
    """Return the hint to write a key and its value into a table of the scene.

    ``data`` contains the value of the key, and the tables of the scene.
    """
    holder: Any = data
    for step in table.split("."):
        holder = holder.get(step) if isinstance(holder, Mapping) else None
    header = f"[[{table}]]" if isinstance(holder, list) else f"[{table}]"
    return f"write  {key} = {format_toml(data[key])}  in {header}"


def _get_stated_type(name: str, table: object) -> PartType | None:
    """Return the part type that a table states, or None if the table states no valid type."""
    if not isinstance(table, Mapping):
        return None
    return find_part_type(str(table.get("part", DEFAULT_TYPES.get(name))))


def _list_part_keys(name: str, table: Mapping[str, Any]) -> list[str]:
    """Return the dotted keys of a part; none if the part type is unknown."""
    kind = _get_stated_type(name, table)
    keys = () if kind is None else list_keys(kind.schema)
    return [".".join((name, *path)) for path, _ in keys]


def _suggest_part_type(typed: object) -> str | None:
    """Suggest the part type that is named ``typed`` in other programs."""
    kind = PART_TYPE_SYNONYMS.get(normalise_word(str(typed)))
    return f'write  part = "{kind}"' if kind in list_type_names() else None


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
                hint=_advise_material_in_layer(table),
            )
        raise UsageError(
            "the key `part` is missing in this table",
            where=name,
            expected=f"part = one of {list_candidates(name, list_type_names(), PARTS_COMMAND)}",
            hint=near
            or f'add  part = "TYPE"  to [{name}]; kc2spice scenes --parts lists the types',
        )
    result = find_part_type(selected) if isinstance(selected, str) else None
    if result is None:
        advice = (
            f"run {PARTS_COMMAND}, which lists all types; "
            "docs/how-to/own_part.md describes types of your own"
        )
        raise make_unknown_type_error(
            selected, f"{name}.part", _suggest_part_type(selected) or advice
        )
    return result


def _advise_material_in_layer(table: Mapping[str, Any]) -> str:
    """Advise to move the constants of a material into the table of a layer or part."""
    inner = next((item for item in table.values() if isinstance(item, Mapping)), table)
    constants = format_toml(dict(inner)) if inner else '{ like = "steel" }'
    return (
        f"delete this table, and write  material = {constants}  in the layer or part that is made "
        "of this material; docs/how-to/own_material.md lists the keys"
    )


def make_unknown_type_error(selected: object, where: str, advice: str) -> UsageError:
    """Make the error for a text that is not the name of a part type.

    If the text is a part number of the catalogue, the error names the part type to use instead, and
    the command that prints its keys. ``advice`` is the hint of the error message if no part type
    has a similar name.
    """
    sold = find_part(selected) if isinstance(selected, str) else None
    if sold is None:
        message, names = "this part type does not exist", list_type_names()
        return unknown(message, selected, names, where, PARTS_COMMAND, advice=advice)
    return UsageError(
        "this text is a part number, not a part type",
        where=where,
        got=repr(selected),
        expected=f"the part type {sold.kind}, with the keys of {sold.number}",
        hint=_advise_catalogue_keys(sold),
    )


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
