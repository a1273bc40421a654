"""Advice in errors about the tables, keys and part types of a scene."""

from __future__ import annotations

import shlex
from collections.abc import Mapping, Sequence
from difflib import get_close_matches
from typing import Any

from kc2spice.core.domains import QUANTITIES
from kc2spice.core.errors import UsageError, did_you_mean, list_candidates, normalise_word, unknown
from kc2spice.core.key_actions import DeleteKey, Hint, SetKey
from kc2spice.core.key_errors import UNKNOWN_KEY
from kc2spice.core.schemas import list_keys
from kc2spice.core.synonyms_from_other_programs import PART_TYPE_SYNONYMS
from kc2spice.core.toml_text import format_toml
from kc2spice.scene.catalogue import CataloguePart, find_part
from kc2spice.scene.keys import KeyDescription, list_part_keys, list_schema_keys
from kc2spice.scene.parttype import find_part_type, list_type_names
from kc2spice.scene.scene_classes import DEFAULT_TYPES, NameAllocator, PartType, Scene
from kc2spice.scene.settings import Analysis, SceneKeys

PARTS_COMMAND = "kc2spice scenes --parts"  # command that lists the part types


def make_unknown_key_error(name: str, data: Mapping[str, Any]) -> UsageError:
    """Return the error about an unknown key at the top level of a scene."""
    delete: Hint = DeleteKey(name, end="; kc2spice scenes --keys lists all keys")
    if isinstance(data[name], list):
        delete = 'write a table for each part: [NAME] with part = "TYPE"'
    return UsageError(
        UNKNOWN_KEY,
        where=name,
        expected=f"one of {list_candidates(name, SceneKeys.model_fields)}, "
        "or a table with part = TYPE",
        hint=did_you_mean(name, SceneKeys.model_fields)
        or (_advise_key_in_table(name, data, "analysis") if name in Analysis.model_fields else None)
        or (DeleteKey(name, end=": ngspice computes at 27 °C") if name.startswith("temp") else None)
        or _suggest_key_of_part(name, data)
        or delete,
    )


def advise_top_level_key(
    path: Sequence[str | int], table: object, hint: Hint | None
) -> Hint | None:
    """Return the hint to move a key of a part to the top level, or else ``hint``.

    ``path`` leads from ``table`` to an invalid key. ``hint`` is the hint of the error about this
    key. The result differs from ``hint`` only if ``hint`` proposes to delete a key that is valid at
    the top level.
    """
    key = str(path[-1]) if path else ""
    if not isinstance(hint, DeleteKey) or hint.key != key or key not in SceneKeys.model_fields:
        return hint
    for step in path:
        if not isinstance(table, Mapping) or step not in table:
            return hint
        table = table[step]
    top = "the scene file above its first table"
    return SetKey("", key, format_toml(table), place=top, begin="move the key: ")


def _suggest_key_of_part(name: str, data: Mapping[str, Any]) -> SetKey | None:
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


def _advise_key_in_table(key: str, data: Mapping[str, Any], table: str) -> SetKey:
    """Return the hint to write a key and its value into a table of the scene.

    ``data`` contains the value of the key, and the tables of the scene.
    """
    holder: Any = data
    for step in table.split("."):
        holder = holder.get(step) if isinstance(holder, Mapping) else None
    if isinstance(holder, list):
        return SetKey(f"{table}[0]", key, format_toml(data[key]), place=f"[[{table}]]")
    return SetKey(table, key, format_toml(data[key]))


def _get_stated_type(name: str, table: object) -> PartType | None:
    """Return the part type that a table states, or None if the table states no valid type."""
    if not isinstance(table, Mapping):
        return None
    return find_part_type(str(table.get("part", DEFAULT_TYPES.get(name))))


def list_keys_of_table(name: str, table: Mapping[str, Any]) -> list[str]:
    """Return the dotted keys of a part; none if the part type is unknown."""
    kind = _get_stated_type(name, table)
    keys = () if kind is None else list_keys(kind.schema)
    return [".".join((name, *path)) for path, _ in keys]


def suggest_part_type(typed: object) -> str | None:
    """Suggest the part type that is named ``typed`` in other programs."""
    kind = PART_TYPE_SYNONYMS.get(normalise_word(str(typed)))
    return f'write  part = "{kind}"' if kind in list_type_names() else None


def advise_material_in_layer(table: Mapping[str, Any]) -> str:
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


def suggest_catalogue_keys(data: Mapping[str, Any], error: UsageError) -> str | None:
    """Suggest the keys of a catalogue part for a table with only a part number.

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


def advise_drive(scene: Scene, ports: Sequence[tuple[str, str]]) -> Hint:
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
        return SetKey(source.name, "ac", f'"1 {getattr(source.keys, "unit", "V")}"')
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
