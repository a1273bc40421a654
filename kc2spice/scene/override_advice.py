"""Advice about overrides in errors about the keys of a scene.

An error about a key proposes a change of the scene file. If an override caused the error, the
functions of this module write the proposal in the form in which the user typed the override.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeAlias

from kc2spice.core.errors import UsageError, did_you_mean, list_candidates
from kc2spice.core.key_actions import ChangeKey, DeleteKey, SetKey, SweepKey
from kc2spice.core.key_errors import UNKNOWN_KEY
from kc2spice.core.toml_text import format_toml
from kc2spice.core.user_warnings import warn_user
from kc2spice.scene.override_origin import OverrideOrigin
from kc2spice.scene.overrides import write_example
from kc2spice.scene.scene_classes import DEFAULT_TYPES
from kc2spice.scene.scene_file import SceneFile, list_paths
from kc2spice.scene.settings import SceneKeys
from kc2spice.scene.table_advice import list_keys_of_table

FindError: TypeAlias = Callable[[OverrideOrigin], Exception | None]
ListPins: TypeAlias = Callable[[str, Mapping[str, Any]], Sequence[str]]
# Largest number of overrides that are left out one by one to find the cause of an error.
_MAX_TRIALS = 20


def warn_of_replaced_keys(
    source: SceneFile,
    path: tuple[str, ...],
    value: Any,
    deleted: Mapping[tuple[str, ...], Any],
    origin: OverrideOrigin,
) -> None:
    """Warn about the earlier overrides and the scene keys that an override replaces.

    The override sets the key at ``path`` to ``value``. ``deleted`` contains the deleted values of
    the keys that the override excludes. An option ``--set`` may replace a key of an override file
    without a warning. A table may restate the keys of earlier overrides without a warning.
    """
    later = str(origin).removeprefix("--set ")
    below = set(list_paths(path, value)) - {path}
    for other, earlier in source.overrides.items():
        is_lost = other[: len(path)] == path and other not in below
        if (is_lost or other in deleted) and (earlier.file is None or origin.file is not None):
            text = str(earlier).removeprefix("--set ")
            warn_user(f"{text} has no effect, because {later} replaces it")
    for other, value in deleted.items():
        key = ".".join(other)
        if source.find_override(key) is None:
            warn_user(f"{later} replaces {key} = {format_toml(value)} of the scene")


def explain_replaced_type(
    data: Mapping[str, Any], source: SceneFile, problem: UsageError, list_pins: ListPins
) -> bool:
    """Explain a key error if an override that replaced the part type caused it.

    Return False, and leave the error unchanged, if no override replaces the type of the part. Also
    return False if an override sets the key that the error is about. ``list_pins`` returns the
    names of the pins of a part with the given name and table.
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
    if isinstance(pins := table.get("pins"), Mapping):
        known = list_pins(name, changed) or list(pins)
        changed["pins"] = {pin: target for pin, target in pins.items() if pin in known}
    text = f"{name}={format_toml(changed)}"
    problem.got = f"{where} of {source.label}: {problem.message}"
    problem.message = f"the key `{where}` of the scene does not fit the new part type"
    problem.expected = f"a table {name} with keys of part = {table['part']!r} only"
    problem.hint = (
        f"replace the whole table: add  --set {shlex.quote(text)}"
        if origin.is_option
        else f"replace the whole table: add  {name!r}: {changed!r}  to the overrides"
    )
    problem.where = str(origin)
    return True


def advise_override(source: SceneFile, problem: UsageError, find_error_without: FindError) -> None:
    """Advise an override in place of a change of the file, if an override caused an error.

    ``find_error_without`` returns the error of the scene without one override, or None.
    """
    where, action = str(problem.where), problem.action
    origin = source.find_override(where)
    if isinstance(action, SweepKey):
        if origin is not None and not origin.is_option:
            problem.hint = action.write_as_call()
    elif origin is None:
        cause = _find_cause(source, problem, find_error_without)
        if cause is not None:
            hint = _write_override(source, action, cause) if isinstance(action, SetKey) else None
            problem.hint = _advise_either(cause, hint or problem.hint)
    elif isinstance(action, ChangeKey):
        table = f"{where.partition('.')[0]}."
        if not source.overrides_key(table + action.key.removeprefix(table)):
            problem.hint = _advise_either(origin, problem.hint)
    elif isinstance(action, DeleteKey):
        path = where if where.rpartition(".")[2] == action.key else f"{where}.{action.key}"
        origin = source.overrides.get(tuple(path.split(".")))
        if origin is not None:
            problem.hint = _write_deletion(path, action, origin)
    elif isinstance(action, SetKey):
        typed = str(origin) if origin.is_option else origin.quoted_text
        end = f"  in place of {typed}"
        replaces = problem.message == UNKNOWN_KEY and not _is_overridden(source, action)
        problem.hint = _write_override(source, action, origin, end if replaces else "")


def _find_cause(
    source: SceneFile, problem: UsageError, find_error_without: FindError
) -> OverrideOrigin | None:
    """Find the override that causes an error at a key of the scene file, or return None.

    Without this override, the scene has no error. An override of a key in the faulty table is also
    returned if the scene without this override has an error at another key.
    """
    table = str(problem.where).partition(".")[0]
    for path in sorted(source.overrides, key=lambda path: path[0] != table)[:_MAX_TRIALS]:
        error = find_error_without(source.overrides[path])
        elsewhere = isinstance(error, UsageError) and error.where != problem.where
        if error is None or (elsewhere and path[0] == table):
            return source.overrides[path]
    return None


def _advise_either(origin: OverrideOrigin, hint: str | None) -> str:
    """Advise to change an override, or to do what another hint states."""
    change = origin.advise_change()
    return f"{change}, or {hint}" if hint else change


def _is_overridden(source: SceneFile, action: SetKey) -> bool:
    """Return whether an override sets the key that an action would set."""
    return tuple(re.findall(r"\w+", action.path)) in source.overrides


def _write_override(
    source: SceneFile, action: SetKey, origin: OverrideOrigin, end: str = ""
) -> str:
    """Write an action as an option ``--set``, or as an entry of ``overrides``.

    ``origin`` is the origin of a user's override, and determines the form of the result.
    """
    verb = "write" if end or _is_overridden(source, action) else "add"
    write = action.write_as_option if origin.is_option else action.write_as_override
    return write(verb, end)


def _write_deletion(path: str, action: DeleteKey, origin: OverrideOrigin) -> str:
    """Write the deletion of a key as the removal of the override that sets the key."""
    if origin.file is not None:
        return str(DeleteKey(path, place=origin.file, end=action.end))
    if origin.is_option:
        return action.write_as_option(str(origin))
    return action.write_as_override(origin.quoted_text)


def advise_dict_entry(problem: UsageError) -> None:
    """Advise a dict entry or a Python call in place of a change of a TOML key."""
    if isinstance(problem.action, SetKey):
        problem.hint = problem.action.write_as_dict_entry()
    elif isinstance(problem.action, SweepKey):
        problem.hint = problem.action.write_as_call()


def write_override_example(tables: Mapping[str, Any], key: str) -> str:
    """Return an example of an override of ``key``, with the value in the scene."""
    part = key.partition(".")[0]
    keys = list_keys_of_table(part, tables[part]) if part in tables else []
    return write_example(key, tables, keys)


def check_override_targets(
    data: Mapping[str, Any], tables: Mapping[str, Any], source: SceneFile
) -> None:
    """Reject overrides of whole parts, and of keys of parts that do not exist.

    An override that contains a part type adds a part. ``tables`` are the tables of the scene
    without overrides, ``data`` the tables with overrides.
    """
    known = {*tables, *SceneKeys.model_fields, *DEFAULT_TYPES}
    parts = [part for part in tables if part not in SceneKeys.model_fields]
    for name, table in data.items():
        if name in parts and not isinstance(table, Mapping):
            keys = list_keys_of_table(name, tables[name])
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
            if f"{part}.{path}" in list_keys_of_table(part, tables[part]):
                return f"write {part}.{path}"
    return "use the name of one of these parts"
