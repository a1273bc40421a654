"""Types of the keys of a scene: numbers with units, and tables with a schema.

Errors contain the name of the key in the user's spelling.

The text ``"0.5 mm"`` becomes the number ``5e-4``. All factors of units are powers of ten, so the
program only shifts the decimal exponent. The number is rounded once, when it becomes a float: ``"50
um"`` equals ``50e-6`` exactly.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from functools import partial
from numbers import Real
from typing import Annotated, Any, ClassVar, Literal, TypeVar, get_args, get_origin

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    PlainValidator,
    Strict,
    ValidationError,
)
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails, PydanticCustomError

from kc2spice.core.domains import QUANTITIES
from kc2spice.core.errors import UsageError, did_you_mean, list_candidates
from kc2spice.core.prefix import format_quantity
from kc2spice.core.untrusted_files import make_identifier

AIR_DENSITY = 1.204  # kg/m3 at 20 °C and 1013 hPa
SOUND_SPEED = 343.2  # m/s in dry air at 20 °C

KeyPath = tuple[str | int, ...]
# Steps of a pydantic path that name a member of a union, such as ``dict[str,float]``, not a key.
_UNION_MEMBER = re.compile(r"\]$|^(float|int|str|bool)$|^[A-Z]\w*Keys$")


def describe_invalid(
    error: ValidationError,
    schema: type[BaseModel],
    at: KeyPath = (),
    also: Sequence[str] = (),
    table: object = None,
) -> tuple[KeyPath, dict[str, Any]]:
    """Return the path of the first invalid key, and its message, got, expected and hint.

    An unknown key is reported before a missing key, because the unknown key may be a misspelling of
    the missing key. ``at`` is the path of the table, ``also`` are accepted keys in addition to the
    keys of the ``schema``, and ``table`` is the table as typed.
    """
    every = error.errors()
    result = next((item for item in every if item["type"] == "extra_forbidden"), every[0])
    result = _select_union_member(every, result, table)
    missing = [str(item["loc"][-1]) for item in every if item["type"] == "missing"
               and item["loc"][:-1] == result["loc"][:-1]]  # fmt: skip
    path = tuple(step for step in result["loc"] if not _UNION_MEMBER.search(str(step)))
    typed = _find_typed_value(table, path, result["input"])
    # the validator of a table has named the invalid key
    if key := result.get("ctx", {}).get("key"):
        below = tuple(int(step) if step.isdecimal() else step for step in key.split("."))
        path, typed = (*path, *below), _find_typed_value(typed, below, None)
    full_path, kind = (*at, *path), result["type"]
    message, expected, hint = _explain_invalid(result, schema, full_path, also, missing)
    if kind == "missing" and path and isinstance(path[-1], int):  # an entry of a list
        full_path, typed = full_path[:-1], _find_typed_value(table, path[:-1], ())
        message, expected, hint = _explain_short_list(full_path, typed, len(missing))
        return full_path, {
            "message": message, "got": display_text(typed), "expected": expected, "hint": hint
        }  # fmt: skip
    # if two keys contradict each other, the message contains the reason, and no value is quoted
    reason_only = kind == "value_error" or (kind == "quantity" and expected is None)
    contradicts = reason_only and isinstance(typed, Mapping)
    got = None if contradicts or kind in ("extra_forbidden", "missing") else display_text(typed)
    return full_path, {"message": message, "got": got, "expected": expected, "hint": hint}


def _select_union_member(
    every: Sequence[ErrorDetails], first: ErrorDetails, table: object
) -> ErrorDetails:
    """Return the error of the type that is most similar to the value, if there are several types.

    A text is compared with choices, a list with lists and a table with tables.
    """
    place = next((k for k, step in enumerate(first["loc"]) if _is_union_member(step)), None)
    if place is None:
        return first
    stem = first["loc"][:place]
    typed = _find_typed_value(table, stem, None)
    for item in every:
        if item["loc"][:place] == stem and len(item["loc"]) > place:
            member = str(item["loc"][place])
            if isinstance(typed, str) and member.startswith("literal"):
                return item
            if isinstance(typed, (list, tuple)) and member.startswith(("tuple", "list")):
                return item
            if isinstance(typed, Mapping) and re.search(r"Keys\]?$", member):
                return item
    return first


def _is_union_member(step: str | int) -> bool:
    """Return whether a step of a pydantic path names a type instead of a key."""
    return bool(_UNION_MEMBER.search(str(step)))


def _find_typed_value(table: object, path: KeyPath, converted: Any) -> Any:
    """Return the value at ``path`` of a table as typed; otherwise the ``converted`` value."""
    if isinstance(converted, Mapping):
        return converted
    for step in path:
        if not isinstance(table, (Mapping, list, tuple)):
            return converted
        try:
            table = table[step]  # type: ignore[index]
        except (KeyError, IndexError, TypeError):
            return converted
    return table


def _explain_invalid(
    details: ErrorDetails,
    schema: type[BaseModel],
    full_path: KeyPath,
    also: Sequence[str],
    missing: Sequence[str] = (),
) -> tuple[str, str | None, str | None]:
    """Return message, expected and hint of a validation error.

    ``missing`` are the required keys that the table of an unknown key lacks.
    """
    path, context = details["loc"], details.get("ctx", {})
    match details["type"]:
        case "extra_forbidden":
            table_schema = _find_schema(schema, path)
            fields = [*table_schema.model_fields, *(also if len(path) == 1 else ())]
            word, every = str(path[-1]), (join_path(item) for item, _ in list_keys(schema))
            elsewhere = (item for item in every if item.rpartition(".")[2] == word)
            near = did_you_mean(word, fields) or did_you_mean(word, elsewhere)
            near = (
                _list_replacement_hints(table_schema).get(word)
                or _suggest_key(word, fields)
                or near
                or _suggest_synonym(word, fields)
                or _suggest_described_key(word, table_schema)
            )
            return (
                "unknown key",
                "one of " + list_candidates(word, fields, _help_command(schema)),
                near or _replace_unknown_key(word, missing),
            )
        case "missing":
            return (
                f"{join_path(full_path)} is missing",
                *_explain_missing(schema, path, full_path),
            )
        case "string_pattern_mismatch":
            pattern, typed = str(context["pattern"]), details["input"]
            expected = "a letter, then letters, digits and _, at most 64 in all"
            hint = f"write it without other characters: {make_identifier(str(typed), 'name')}"
            if pattern == "^[xyz]{1,3}$":
                expected, hint = "one to three of the letters x, y and z", 'for example "z"'
            elif letters := re.fullmatch(r"\^\[([A-Z]+)\]\$", pattern):
                expected, hint = f"one of {', '.join(letters[1])}", f'for example "{letters[1][0]}"'
            if full_path[0] in (
                "title",
                "include",
                # a line break in this text would begin a new statement of the netlist
            ):
                expected = "one line of text without control characters"
                hint = "delete line breaks and control characters from it"
            return "this text is not allowed", expected, hint
        case "quantity":
            return context["reason"], context["expected"], context.get("hint")
        case "literal_error":
            choices = re.findall(r"'?(\w+)'?(?:, | or |$)", context["expected"])
            word = str(details["input"])
            near = did_you_mean(word, choices)
            if (meaning := _CHOICE_SYNONYMS.get(_plain_word(word))) in choices:
                near = f'write  {full_path[-1]} = "{meaning}"'
            listed = list_candidates(details["input"], choices, _help_command(schema))
            vector = _AXIS_VECTORS.get(_plain_word(word))
            # a choice or a vector
            if vector and any(_is_union_member(step) for step in path) and "x" not in choices:
                vector = vector.replace("1", "-1") if word.strip().startswith("-") else vector
                near = f"write  {full_path[-1]} = {vector}"
            near = near or f"for example  {_write_assignment(full_path, _quote(choices[0]))}"
            return "this value is not one of the choices", f"one of {listed}", near
        case "float_type" | "float_parsing":
            return (
                "not a number",
                "a number",
                f"write for example  {_write_assignment(full_path, '1.0')}",
            )
        case "string_type":
            return "not a text", "a text in quotes", f'for example  {full_path[-1]} = "NAME"'
        case "int_type":
            typed = details["input"]
            if isinstance(typed, float) and math.isfinite(typed) and abs(typed) < 1e9:
                hint = f"write  {full_path[-1]} = {max(round(typed), 1)}"
            else:
                hint = f"for example  {full_path[-1]} = 10"
            return "not a whole number", "a whole number, without quotes", hint
        case "dict_type" if isinstance(details["input"], (list, tuple)):
            return (
                "a list, not tables by name",
                f"[{join_path(full_path)}.NAME] for each of them",
                f"write  {full_path[-1]} = {{ NAME = … }}  with a name for each entry",
            )
        case "model_type" | "dict_type":
            entry = not full_path or isinstance(full_path[-1], int)  # the value is a list entry
            form = "{ KEY = VALUE, … }" if entry else f"[{join_path(full_path)}]"
            hint = f"write a table {form} with its keys"
            text_key = _find_choice_key(schema, path, details["input"])
            if text_key is not None and len(full_path) == 1:
                hint = f'write  [{full_path[0]}]  and below it  {text_key} = "{details["input"]}"'
            if not isinstance(details["input"], (Mapping, list)) and len(full_path) > 1:
                hint = f"write  {full_path[-1]} = {{ KEY = VALUE }}  with the keys of this table"
                if isinstance(full_path[-1], int):
                    example = _write_entry(_find_schema(schema, (*path, "")), details["input"])
                    hint = f"write  {_write_assignment(full_path, example)}"
                elif isinstance(details["input"], str) and (key := _find_text_key(schema, path)):
                    hint = f'write  {full_path[-1]} = {{ {key} = "{details["input"]}" }}'
                elif key := _find_value_key(schema, path, details["input"]):
                    value = _format_toml(details["input"])
                    hint = f"write  {full_path[-1]} = {{ {key} = {value} }}"
            return "not a table", f"a table, {form}", hint
        case "tuple_type" | "list_type":
            entered = details["input"]
            keys = (
                ", ".join(f"{key} = …" for key in entered) if isinstance(entered, Mapping) else None
            )
            one = (
                " … " if keys is None else f"{{ {keys} }}"
            )  # the user wrote a table, but the schema requires a list of tables
            example = f"[{one}]"
            if isinstance(entered, str) and entered in _AXIS_VECTORS:
                example = _AXIS_VECTORS[entered]
            elif isinstance(entered, (int, float, str)) and full_path[-1] == "band":
                example = f"[0, {_format_entries([entered])[1:-1]}]"  # a band begins at 0 Hz
            elif isinstance(entered, str) and isinstance(full_path[-1], str):
                example = f'["{entered}"]'
            hint = f"write  {_write_assignment(full_path, example)}" if keys is None else (
                f"write one table for each entry:  {full_path[-1]} = [{_format_toml(entered)}]"
            )  # fmt: skip
            return "not a list", f"a list, {_write_assignment(full_path, f'[{one}]')}", hint
        case "too_short" | "too_long" as kind:
            too_short = kind == "too_short"
            count = context["min_length" if too_short else "max_length"]
            bound = f"{'least' if too_short else 'most'} {count} entr{'y' if count == 1 else 'ies'}"
            return (
                f"too {'few' if too_short else 'many'} entries",
                f"a list of at {bound}",
                _advise_length(full_path, details["input"], count, too_short),
            )
        case "greater_than" | "greater_than_equal" | "less_than" | "less_than_equal":
            sign = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
            limit = ", ".join(f"{sign[key]} {bound:g}" for key, bound in context.items())
            unit = _find_unit(schema, path)
            hint = _suggest_value(join_path(full_path), details["input"], context, unit or "")
            return "out of range", f"{limit} {unit or ''}".rstrip(), hint
        case "value_error":
            return str(context["error"]), None, None
    return details["msg"], context.get("expected"), None


def _explain_short_list(path: KeyPath, typed: object, lacking: int) -> tuple[str, str, str]:
    """Return message, expectation and hint for a list that lacks its last entries."""
    entries = list(typed) if isinstance(typed, (list, tuple)) else []
    numeric = all(isinstance(item, (int, float)) for item in entries)
    count, pad = len(entries) + lacking, 0 if numeric else "VALUE"
    added = [pad] * lacking
    # a band begins at 0 Hz, other lists end with the missing entries
    completed = [*added, *entries] if path[-1] == "band" else [*entries, *added]
    full = _format_entries(completed).replace('"VALUE"', "VALUE")
    return (
        "too few entries",
        f"a list of {count} entries",
        f"write  {_write_assignment(path, full)}",
    )


def _format_entries(entries: Iterable[object]) -> str:
    """Format a list as in a scene file."""
    return _format_toml(list(entries)).replace("'", '"')


def _write_assignment(path: KeyPath, value: str) -> str:
    """Return text for a hint that sets the key at ``path`` to ``value``.

    >>> _write_assignment(("u", "axis"), "[0, 0, 1]")
    'axis = [0, 0, 1]'
    >>> _write_assignment(("u", "axis", 2), "1.0")
    '1.0  as entry 3 of axis'
    """
    last = path[-1]
    if not isinstance(last, int):
        return f"{last} = {value}"
    names = [step for step in path if not isinstance(step, int)]
    return f"{value}  as entry {last + 1} of {names[-1]}"


# Directions of coordinate axes as lists.
_AXIS_VECTORS = {"x": "[1, 0, 0]", "y": "[0, 1, 0]", "z": "[0, 0, 1]"}


def _suggest_value(key: str, value: object, limits: Mapping[str, float], unit: str) -> str:
    """Suggest a value of ``key`` within the limits of its schema."""
    (kind, bound), *_ = limits.items()
    lower = kind in ("gt", "ge")
    if lower and isinstance(value, (int, float)) and value < 0 and -value > bound:
        return "remove the minus sign"
    preposition = {"gt": "above", "lt": "below"}.get(kind, "to")
    return f"{'raise' if lower else 'lower'} {key} {preposition} {bound:g} {unit}".rstrip()


# Values of required keys that are neither quantities nor choices.
_KEY_EXAMPLES = {
    "layers": '[{ material = "PZT-5A", diameter = "20 mm", thickness = "0.2 mm" }]',
    "materials": '{ GROUP = "steel" }  with a group of the mesh',
    "material": '"steel"',
    "mesh": '"part.msh"',
    "name": '"tip"',
    "group": '"top"',
    "between": '["case", "chip"]',
    "fingers": "50",
    "turns": "100",
    "a": '"PART.PIN"',
    "of": '"PART.RESULT"',
    "front": '[{ material = "aluminium", diameter = "20 mm", length = "20 mm" }]',
    "back": '[{ material = "steel", diameter = "20 mm", length = "20 mm" }]',
    "file": '"FILE"',
    "subckt": '"NAME"',
    "default": "1.0",
    "low": "0.5",
    "high": "2.0",
    "factor": '"t/1.5"',
}


def _replace_unknown_key(word: str, missing: Sequence[str]) -> str:
    """Suggest the only missing key of a table in place of an unknown key."""
    if len(missing) == 1:
        return f"write {missing[0]} in place of {word}, because the key {missing[0]} is missing"
    return f"delete {word}"


# Words of other programs for choices of a key, without blanks and signs.
_CHOICE_SYNONYMS = {
    "average": "mean",
    "avg": "mean",
    "maximum": "max",
    "peak": "max",
    "minimum": "min",
    "pp": "peak_to_peak",
    "p2p": "peak_to_peak",
    "pkpk": "peak_to_peak",
    "peakpeak": "peak_to_peak",
    "last": "final",
    "end": "final",
    "splmax": "spl",
    "modal": "ac",
    "eigenfrequency": "ac",
    "eigenmodes": "ac",
    "sp": "ac",
    "smallsignal": "ac",
    "octave": "log",
    "oct": "log",
    "tran": "transient",
    "time": "transient",
    "timedomain": "transient",
    "frequency": "ac",
    "harmonic": "ac",
    "sweep": "ac",
    "static": "op",
    "dcop": "op",
    "lin": "linear",
    "logarithmic": "log",
    "dec": "log",
    "decade": "log",
    "gear2": "gear",
    "trapezoidal": "trap",
    "clamp": "clamped",
    "over": "above",
    "top": "above",
    "power": "heat_flow",
    "heatpower": "heat_flow",
    "soundpressure": "pressure",
    "flow": "volume_velocity",
    "volumeflow": "volume_velocity",
    "position": "displacement",
    "moment": "torque",
    "v": "voltage",
    "i": "current",
    "under": "below",
    "bottom": "below",
    "fixed": "clamped",
    "simplysupported": "simply_supported",
    "pinned": "simply_supported",
    "hinged": "simply_supported",
    "unsupported": "free",
}


def _plain_word(word: str) -> str:
    """Return the letters and digits of a word in lower case."""
    return "".join(filter(str.isalnum, word.lower()))


# Common names of quantities, the keys that scenes use in their place, and the relation of both.
_REPLACED_NAMES = {
    "radius": ("diameter", "use the key diameter, which is twice the radius"),
    "diameter": ("radius", "use the key radius, which is half the diameter"),
    "height": ("thickness", "did you mean 'thickness'?"),
    "thickness": ("height", "did you mean 'height'?"),
    "q": ("quality", "did you mean 'quality'?"),
    "zeta": ("ratio", "did you mean 'ratio'?"),
}


def _suggest_key(word: str, fields: Sequence[str]) -> str | None:
    """Suggest the key that scenes use in place of the common name ``word``."""
    key, hint = _REPLACED_NAMES.get(word.lower(), ("", ""))
    return hint if key in fields else None


# Keys of other programs, and keys of this program with the same meaning.
_KEY_SYNONYMS = {
    "peak": ("amplitude", "high", "voltage"),
    "amp": ("amplitude",),
    "ampl": ("amplitude",),
    "magnitude": ("amplitude", "ac"),
    "f": ("frequency",),
    "freq": ("frequency",),
    "ohm": ("resistance",),
    "ohms": ("resistance",),
    "r": ("resistance",),
    "c": ("capacitance",),
    "farad": ("capacitance",),
    "l": ("inductance",),
    "k": ("stiffness",),
    "value": ("resistance", "capacitance", "inductance", "stiffness", "mass", "damping", "dc"),
    "v": ("voltage", "dc", "velocity"),
    "volts": ("voltage", "dc"),
    "voltage": ("dc", "high", "amplitude"),
    "current": ("dc",),
    "m": ("mass",),
    "weight": ("mass",),
    "rho": ("density",),
    "e": ("youngs_modulus",),
    "modulus": ("youngs_modulus",),
    "nu": ("poisson_ratio",),
    "delay": ("start",),
    "td": ("start",),
    "v1": ("low",),
    "v2": ("high",),
    "tr": ("edge",),
    "tf": ("edge",),
    "rise": ("edge",),
    "fall": ("edge",),
    "risetime": ("edge",),
    "falltime": ("edge",),
    "pw": ("width",),
    "ton": ("width",),
    "per": ("period",),
    "ncycles": ("count",),
    "duration": ("stop", "width"),
    "end": ("stop",),
    "tstop": ("stop",),
    "fstop": ("stop",),
    "fstart": ("start",),
    "npoints": ("points",),
    "model": ("subckt",),
    "subcircuit": ("subckt",),
    "lib": ("file",),
    "library": ("file",),
    "path": ("file", "mesh"),
    "filename": ("file", "mesh"),
    "result": ("of",),
    "signal": ("of",),
    "function": ("take",),
    "boundary": ("support",),
    "clamped": ("support", "fixed"),
    "bc": ("support", "fixed"),
}


def _suggest_described_key(word: str, table: type[BaseModel]) -> str | None:
    """Suggest the key whose description contains ``word`` as its name in SPICE."""
    described = re.compile(rf"\b{re.escape(word)} of the SPICE model", re.IGNORECASE)
    for name, field in table.model_fields.items():
        if described.search(field.description or ""):
            return f"write {name} in place of {word}"
    return None


def _suggest_synonym(word: str, fields: Sequence[str]) -> str | None:
    """Suggest the key of the table with the meaning of a key of another program."""
    keys = _KEY_SYNONYMS.get(_plain_word(word), ())
    fitting = next((key for key in keys if key in fields), None)
    return fitting and f"write {fitting} in place of {word}"


def _list_replacement_hints(table: type[BaseModel]) -> Mapping[str, str]:
    """Return the hint for each unsupported key of a table, with the key to use in its place."""
    return getattr(table, "unsupported_key_hints", {})


def _explain_missing(
    schema: type[BaseModel], path: KeyPath, full_path: KeyPath
) -> tuple[str | None, str | None]:
    """Return the accepted values of a missing key, and the line to add to the file."""
    unit = _find_unit(schema, path)
    table = join_path(full_path[:-1])
    value = f'"{_suggest_quantity(schema, path, unit)}"' if unit else "VALUE"
    field, listed = _find_field(schema, path), None
    if not unit and field is not None:
        choices = get_args(field.annotation) if get_origin(field.annotation) is Literal else ()
        value = f'"{choices[0]}"' if choices else _KEY_EXAMPLES.get(str(path[-1]), value)
        if choices:
            listed = f"one of {list_candidates('', map(str, choices))}"
    place = f"  to {table}" if table else ""
    expected = f"a number in {unit}, or a string with a unit such as {value}" if unit else listed
    return expected, f"add  {full_path[-1]} = {value}{place}"


def _suggest_quantity(schema: type[BaseModel], path: KeyPath, unit: str) -> str:
    """Return a plausible value of the key at ``path``: a power of ten within its range."""
    field = _find_field(schema, path)
    plausible = None if field is None else plausible_range_of(field)
    if plausible is None:
        return f"1 {unit}"
    middle = 10.0 ** round(math.log10(math.sqrt(plausible.low * plausible.high)))
    return format_quantity(middle, plausible.unit).replace("µ", "u")


def _find_field(schema: type[BaseModel], path: KeyPath) -> FieldInfo | None:
    """Return the field of the key at ``path``; numbers of list entries are ignored."""
    names = tuple(step for step in path if isinstance(step, str))
    return dict(list_keys(schema)).get(names)


def _write_entry(schema: type[BaseModel], typed: object) -> str:
    """Write an example of a table with the required keys; a text is the value of its first text."""
    entries, text = [], typed if isinstance(typed, str) else None
    for name, field in schema.model_fields.items():
        if not field.is_required():
            continue
        unit = find_unit(field)
        value = f'"{_suggest_quantity(schema, (name,), unit)}"' if unit else (
            _KEY_EXAMPLES.get(name, "VALUE")
        )  # fmt: skip
        if text is not None and not unit:
            value, text = f'"{text}"', None
        entries.append(f"{name} = {value}")
    return f"{{ {', '.join(entries) or 'KEY = VALUE'} }}"


def _find_text_key(schema: type[BaseModel], path: KeyPath) -> str | None:
    """Return the only required key of the table at ``path`` if its value is a text."""
    fields = _find_schema(schema, (*path, "")).model_fields
    required = [name for name, field in fields.items() if field.is_required()]
    if len(required) == 1 and fields[required[0]].annotation is str:
        return required[0]
    return None


def _find_choice_key(schema: type[BaseModel], path: KeyPath, value: object) -> str | None:
    """Return the key of the table at ``path`` one of whose choices is ``value``."""
    for name, field in _find_schema(schema, (*path, "")).model_fields.items():
        if get_origin(field.annotation) is Literal and value in get_args(field.annotation):
            return name
    return None


def _find_value_key(schema: type[BaseModel], path: KeyPath, value: object) -> str | None:
    """Return the key of the table at ``path`` that a number or quantity most likely states."""
    table = _find_schema(schema, (*path, ""))
    if isinstance(value, (int, float)) and {"quality", "ratio"} <= set(table.model_fields):
        return "quality" if value > 1 else "ratio"
    for name, field in table.model_fields.items():
        unit = find_unit(field)
        if unit is not None:
            with contextlib.suppress(UsageError):
                quantity(value, unit)
                return name
    return None


def _find_unit(schema: type[BaseModel], path: KeyPath) -> str | None:
    """Return the SI unit of the key at ``path``; None for a key without a unit."""
    field = _find_field(schema, path)
    return None if field is None else find_unit(field)


def _help_command(schema: type[BaseModel]) -> str | None:
    """Return the command or page that lists all keys of a table."""
    return getattr(schema, "help_command", None)


def _quote(text: str) -> str:
    return f'"{text}"'


def _advise_length(path: KeyPath, entries: object, count: int, too_short: bool) -> str:
    """Advise how to give a list an accepted number of entries."""
    if too_short or not isinstance(entries, (list, tuple)):
        word = "entry" if count == 1 else "entries"
        return f"add entries, so that the list has at least {count} {word}"
    shorter = _format_entries(entries[:count])
    if len(shorter) > 60:
        return f"delete {len(entries) - count} of the {len(entries)} entries"
    return f"write for example  {_write_assignment(path, shorter)}"


def _find_inner_section(annotation: Any) -> type[BaseModel] | None:
    """Return the first section class inside of an annotation, at any depth."""
    found = find_section(annotation)
    inner = map(_find_inner_section, get_args(annotation)) if found is None else ()
    return found or next(filter(None, inner), None)


def _find_schema(schema: type[BaseModel], path: KeyPath) -> type[BaseModel]:
    """Return the innermost schema that contains ``path``."""
    for step in path[:-1]:
        if step in schema.model_fields:
            schema = _find_inner_section(schema.model_fields[str(step)].annotation) or schema
    return schema


def list_keys(schema: type[BaseModel]) -> Iterator[tuple[tuple[str, ...], FieldInfo]]:
    """Yield all keys of a schema in order; the keys of a subtable follow its name."""
    for name, field in schema.model_fields.items():
        section, path = find_section(field.annotation), (field.alias or name,)
        if section is None:
            yield path, field
            continue
        for below, item in list_keys(section):
            yield path + below, item


def find_section(annotation: Any) -> type[BaseModel] | None:
    """Return the section class in a field's annotation, as ``Kick`` for ``Kick | None``.

    The result is None if the annotation contains no section class.
    """
    for candidate in (annotation, *get_args(annotation)):
        if isinstance(candidate, type) and issubclass(candidate, BaseModel):
            return candidate
    return None


def _field_metadata(field: FieldInfo) -> Iterator[Any]:
    """Yield the metadata of a field and of the elements of a list."""
    yield from field.metadata
    for argument in get_args(field.annotation):
        yield from get_args(argument)[1:]


def find_unit(field: FieldInfo) -> str | None:
    """Return the SI unit of a numeric field; None for a field without a unit.

    In a list of numbers, all numbers have this unit.
    """
    for meta in _field_metadata(field):
        if isinstance(meta, BeforeValidator) and isinstance(meta.func, partial):
            return str(meta.func.args[0])
    return None


def plausible_range_of(field: FieldInfo) -> Plausible | None:
    """Return the range of plausible values of a key; None for a key without such a range."""
    return next((meta for meta in _field_metadata(field) if isinstance(meta, Plausible)), None)


def join_path(path: KeyPath) -> str:
    """Join the words and numbers of a path, such as ``layers[0].thickness``."""
    text = "".join(f"[{part}]" if isinstance(part, int) else f".{part}" for part in path)
    return text.removeprefix(".")


def display_text(value: Any) -> str:
    """Format a value as TOML; a number with too many digits is described in words."""
    try:
        return clip_text(_format_toml(value))
    except ValueError:
        return f"a {type(value).__name__} that is too long to print"


def _format_toml(value: Any) -> str:
    """Format tables and lists as in a scene file, and other values by ``repr``."""
    if isinstance(value, Mapping):
        return (
            "{ " + ", ".join(f"{key} = {_format_toml(item)}" for key, item in value.items()) + " }"
        )
    if isinstance(value, list):
        return "[" + ", ".join(map(_format_toml, value)) + "]"
    return repr(value)


def clip_text(text: str) -> str:
    """Cut a text after 120 characters."""
    return text if len(text) <= 120 else text[:120] + " …"


EPSILON_0 = 8.8541878188e-12  # F/m, CODATA 2022; scipy.constants takes long to load
MU_0 = 4e-7 * math.pi  # H/m

BOLTZMANN = 1.380649e-23  # J/K, exact (SI, 2019)
DEFAULT_TEMPERATURE = 300.15  # K, default temperature of a simulation (27 °C in SPICE)
ELEMENTARY_CHARGE = 1.602176634e-19  # C, exact (SI, 2019)

_PREFIX = {
    "f": -15, "p": -12, "n": -9, "u": -6, "µ": -6, "μ": -6, "m": -3, "c": -2,
    "k": 3, "M": 6, "G": 9, "T": 12,
}  # fmt: skip


# Power of ten of each unit, and the exponents of the base units kg, m, s, A, K in the unit.
_UNITS = {
    "g": (-3, 1, 0, 0, 0, 0), "m": (0, 0, 1, 0, 0, 0), "s": (0, 0, 0, 1, 0, 0),
    "A": (0, 0, 0, 0, 1, 0), "K": (0, 0, 0, 0, 0, 1), "1": (0, 0, 0, 0, 0, 0),
    "rad": (0, 0, 0, 0, 0, 0),
    "%": (-2, 0, 0, 0, 0, 0), "Hz": (0, 0, 0, -1, 0, 0), "N": (0, 1, 1, -2, 0, 0),
    "Pa": (0, 1, -1, -2, 0, 0), "J": (0, 1, 2, -2, 0, 0), "W": (0, 1, 2, -3, 0, 0),
    "C": (0, 0, 0, 1, 1, 0), "V": (0, 1, 2, -3, -1, 0), "Ohm": (0, 1, 2, -3, -2, 0),
    "F": (0, -1, -2, 4, 2, 0), "H": (0, 1, 2, -2, -2, 0), "Wb": (0, 1, 2, -2, -1, 0),
    "T": (0, 1, 0, -2, -1, 0), "l": (-3, 0, 3, 0, 0, 0), "L": (-3, 0, 3, 0, 0, 0),
}  # fmt: skip
# Symbols of units, keyed by the name of the unit in the singular.
_UNIT_WORDS = {
    "gram": "g", "kilogram": "kg", "metre": "m", "meter": "m", "millimetre": "mm",
    "millimeter": "mm", "micrometer": "um", "micron": "um", "second": "s", "sec": "s", "volt": "V",
    "ampere": "A", "amp": "A", "ohm": "Ohm", "farad": "F", "henry": "H", "newton": "N",
    "pascal": "Pa", "watt": "W", "joule": "J", "kelvin": "K", "tesla": "T", "hertz": "Hz",
    "percent": "%", "liter": "l", "litre": "l", "milliliter": "ml", "millilitre": "ml",
    "kilohm": "kOhm", "kiloohm": "kOhm", "megohm": "MOhm", "microfarad": "uF", "nanofarad": "nF",
    "picofarad": "pF", "kilohertz": "kHz", "megahertz": "MHz", "millisecond": "ms",
    "microsecond": "us", "millivolt": "mV", "kilovolt": "kV", "milliampere": "mA",
}  # fmt: skip
_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d{1,4})?)\s*(.*?)\s*", re.DOTALL)
# Units outside of the SI, with their value and SI unit. Values of NIST SP 811, appendix B.
_FOREIGN_UNITS = {
    "in": (0.0254, "m"), "inch": (0.0254, "m"), '"': (0.0254, "m"), "mil": (2.54e-5, "m"),
    "thou": (2.54e-5, "m"), "ft": (0.3048, "m"), "Å": (1e-10, "m"), "micron": (1e-6, "m"),
    "lb": (0.45359237, "kg"), "oz": (0.028349523125, "kg"), "t": (1e3, "kg"),
    "g": (9.80665, "m/s2"), "g0": (9.80665, "m/s2"), "G": (9.80665, "m/s2"),
    "gal": (0.01, "m/s2"), "lbf": (4.4482216152605, "N"), "kgf": (9.80665, "N"),
    "gf": (9.80665e-3, "N"), "dyn": (1e-5, "N"), "bar": (1e5, "Pa"), "mbar": (100.0, "Pa"),
    "atm": (101325.0, "Pa"), "psi": (6894.757293168, "Pa"), "torr": (133.322368, "Pa"),
    "mmHg": (133.322387, "Pa"), "gauss": (1e-4, "T"), "Gs": (1e-4, "T"),
    "min": (60.0, "s"), "h": (3600.0, "s"), "ms-1": (1.0, "m/s"), "km/h": (1 / 3.6, "m/s"),
    "mph": (0.44704, "m/s"), "rpm": (1 / 60, "Hz"), "u/min": (1 / 60, "Hz"),
    "Wh": (3600.0, "J"), "kWh": (3.6e6, "J"), "cal": (4.184, "J"), "eV": (1.602176634e-19, "J"),
    "hp": (745.699871582, "W"), "Ah": (3600.0, "C"), "mAh": (3.6, "C"),
    "g/cm3": (1e3, "kg/m3"), "g/cc": (1e3, "kg/m3"), "cc": (1e-6, "m3"), "ppm": (1e-6, ""),
}  # fmt: skip
_FACTOR = re.compile(r"([A-Za-zµμ%]+|1)\^?([1-9]?)")
_UNIT_SPELLINGS = str.maketrans(
    {"\u2126": "Ohm", "Ω": "Ohm", "²": "2", "³": "3", "·": " ", "*": " "}
)
# largest number of characters of a quantity with its unit
_MAX_QUANTITY_LENGTH = 200


def _look_up_unit(text: str) -> tuple[int, ...] | None:
    """Look up a unit with or without prefix.

    A unit without prefix has precedence: ``m`` means metre, ``T`` tesla.
    """
    if text in _UNITS:
        return _UNITS[text]
    unit, shift = _UNITS.get(text[1:]), _PREFIX.get(text[:1])
    return None if unit is None or shift is None else (unit[0] + shift, *unit[1:])


def _parse_unit(text: str) -> tuple[int, ...] | None:
    """Parse a unit such as ``"A/(m s)"``; return None for other text.

    A unit is a product of factors, or a quotient of two products. Blanks separate the factors. Each
    factor may have a one-digit exponent.
    """
    top, slash, bottom = text.translate(_UNIT_SPELLINGS).partition("/")
    if slash and not bottom.strip():
        return None
    below = bottom.strip().removeprefix("(").removesuffix(")")
    result = [0] * 6
    for product, sign in ((top, 1), (below, -1)):
        for factor in product.split():
            match = _FACTOR.fullmatch(factor)
            unit = _look_up_unit(match[1]) if match else None
            if match is None or unit is None or (factor == "1" and factor != product.strip()):
                return None
            power = sign * int(match[2] or 1)
            result = [a + power * b for a, b in zip(result, unit, strict=True)]
    return tuple(result)


def _parse_quantity(text: str, si: str) -> float:
    """Convert a text with a number and a unit to ``si``; errors are ValueErrors."""
    match = _NUMBER.fullmatch(text) if len(text) <= _MAX_QUANTITY_LENGTH else None
    if match is not None and match[2].startswith(","):
        raise ValueError("a comma in a number")
    if match is None:
        raise ValueError("not a quantity")
    if not match[2] and si:
        raise ValueError("a quantity between quotes needs a unit")
    unit, target = _parse_unit(match[2]), _parse_unit(si)
    assert target is not None, f"{si!r} is not a unit"
    if unit is None:
        raise ValueError(f"unknown unit {match[2]!r}")
    if unit[1:] != target[1:]:
        raise ValueError(f"wrong unit {match[2]!r}")
    return float(Decimal(match[1]).scaleb(unit[0] - target[0]))


def quantity(value: object, si: str, *, where: str | None = None) -> float:
    """Convert ``value`` to the SI unit ``si``, which is ``""`` for a plain number.

    A number is returned unchanged. A string is a number with a unit (``"100 V"``, ``"25 us"``);
    plain numbers may have the unit ``%``.

    A number is taken as SI already; a string is a number with a unit (``"100 V"``, ``"25 us"``).

    Raises
    ------
    UsageError : the value is not a finite number, or its unit has a wrong dimension.
    """
    expected = f'a number in {si}, or a string with a unit such as "1 {si}"'
    try:
        if isinstance(value, str):
            result = _parse_quantity(value, si)
        elif isinstance(value, Real) and not isinstance(value, bool):
            result = float(value)
        else:
            raise ValueError("not a quantity")
        if not math.isfinite(result):
            raise ValueError("this value is not a finite number")
    except (ValueError, OverflowError) as error:
        got = (
            repr(value)
            if len(repr(value)) <= _MAX_QUANTITY_LENGTH
            else repr(value)[:_MAX_QUANTITY_LENGTH] + " ..."
        )
        message = (
            "this value is not a finite number" if isinstance(error, OverflowError) else str(error)
        )
        expected = expected if si else "a plain number"
        hint = _suggest_spelling(value, si)
        raise UsageError(message, where=where, got=got, expected=expected, hint=hint) from None
    return result


# a range such as 1 g:2 g:5, or a list such as 1 g,2 g
_SEVERAL_VALUES = re.compile(r"\s*([-+]?[\d.]+\s*[A-Za-z%/]*)\s*:\s*[-+]?\d|"
                             r"\s*([-+]?[\d.]+\s*[A-Za-z%/]+)\s*,\s*[-+]?\d")  # fmt: skip


def _abbreviate_prefix(match: re.Match[str]) -> str:
    """Return the symbol of a prefix in words."""
    return "u" if match[1] == "micro" else match[1][0]


def _suggest_spelling(value: object, si: str) -> str | None:
    """Suggest a correction of a decimal comma, or of a missing or misspelt unit."""
    from difflib import get_close_matches  # imported here, because most values need no correction

    if isinstance(value, (list, tuple)) and len(value) == 1:
        inner = f'"{value[0]}"' if isinstance(value[0], str) else f"{value[0]}"
        return f"write the value without brackets: {inner}"
    if not isinstance(value, str):
        return f'write a number with its unit, such as "1 {si}"' if si else "write a number"
    if len(value) > _MAX_QUANTITY_LENGTH:
        return f"write a number of at most {_MAX_QUANTITY_LENGTH} characters"
    if several := _SEVERAL_VALUES.match(value):
        first = (several[1] or several[2]).strip()
        return f'write one value, such as  "{first}"; kc2spice sweep accepts a range or a list'
    begun = _NUMBER.fullmatch(value.rstrip())
    word = "" if begun is None or _parse_unit(begun[2]) else begun[2].lower().removesuffix("s")
    if begun is not None and (symbol := _UNIT_WORDS.get(word)):
        with contextlib.suppress(ValueError):
            _parse_quantity(f"{begun[1]} {symbol}", si)
            return f'write  "{begun[1]} {symbol}"'
    if begun is not None and (celsius := re.search("°C|℃|degC", begun[2])):
        if begun[2] == celsius[0]:
            rise = "the difference from the ambient temperature in K"
            return f'write {rise}, such as  "{begun[1]} K"  for a rise of {begun[1]} °C'
        text = f"{begun[1]} {begun[2].replace(celsius[0], 'K')}"
        with contextlib.suppress(ValueError):
            _parse_quantity(text, si)
            return f'write  "{text}"'
    # a prefix in place of the decimal point, as on drawings of circuits: 4k7
    if split := re.fullmatch(r"(\d+)([pnumkMGRΩ])(\d+)", value.strip()):
        prefix = "" if split[2] in "RΩ" else split[2]
        return f'write  "{split[1]}.{split[3]} {prefix}{si}"'
    # a unit with wrong letter case, and its prefix as typed
    if begun is not None and si and begun[2].lower().endswith(si.lower()):
        prefix = begun[2][: -len(si)]
        prefix = "M" if (prefix, si) == ("m", "Hz") else prefix  # mhz means megahertz
        text = f"{begun[1]} {prefix}{si}"
        with contextlib.suppress(ValueError):
            _parse_quantity(text, si)
            return f'write  "{text}"'
    power = re.fullmatch(r"(m)([23])", si)
    length = begun is not None and _parse_unit(begun[2])
    if begun is not None and power and length and length == _parse_unit(f"{begun[2][:-1]}m"):
        return f'write  "{begun[1]} {begun[2]}{power[2]}"'  # a length in place of an area
    if begun is not None:
        factor, foreign = _FOREIGN_UNITS.get(begun[2], (0.0, ""))
        if factor and foreign == si:
            converted = float(f"{factor * float(begun[1]):.6g}")
            return f'write  "{f"{converted:.12g} {si}".strip()}"'
    if begun is not None and begun[2] and si.startswith((f"{begun[2]}/", f"{begun[2]} ")):
        return f'write  "{begun[1]} {si}"'
    for text in (value.replace(",", ".", 1), f"{value.rstrip()}{si}", f"{value.rstrip()} {si}"):
        with contextlib.suppress(ValueError):
            if not math.isfinite(_parse_quantity(text, si)):
                return f"write a number of at most 1e300 {si}".rstrip()
            number, unit = _NUMBER.fullmatch(text).groups()  # type: ignore[union-attr]
            advice = f'write  "{f"{number} {unit}".strip()}"'
            if begun is not None and not begun[2] and si in _UNITS:  # no unit and no prefix
                advice += f'  or, with a prefix,  "{number} m{si}"'
            return advice
    if begun is None:
        return f'write a number with its unit, such as "1 {si}"' if si else "write a number"
    if _parse_unit(begun[2]) is not None:
        return f'write  "{begun[1]} {si}"  if the value is in {si}' if si else f"write {begun[1]}"
    units = [f"{prefix}{si}" for prefix in ("", *_PREFIX)]
    lower = {unit.lower(): unit for unit in reversed(units)}
    # a prefix in words or in another letter case: 1 micro F, 1 KOhm
    typed = re.sub(r"^(micro|milli|kilo|nano|pico)\s*", _abbreviate_prefix, begun[2]).lower()
    near = [lower[typed]] if typed in lower else get_close_matches(begun[2], units, 1, 0.7)
    if not near:  # another letter case: kh for kHz
        near = [lower[unit] for unit in get_close_matches(begun[2].lower(), lower, 1, 0.7)]
    if near or not si:
        return f'write  "{begun[1]} {near[0]}"' if near else f"write {begun[1]}"
    return f'write  "{begun[1]} {si}"  if the value is in {si}'


def invalid_value_error(
    reason: str, expected: str | None, key: str | None = None, hint: str | None = None
) -> PydanticCustomError:
    """Make the error of a validator for an invalid value, or for an invalid ``key`` of a table."""
    context = {"reason": reason, "expected": expected, "key": key, "hint": hint}
    return PydanticCustomError("quantity", "{reason}", context)


def _parse_number(si: str, value: object) -> float:
    """Convert a number or a quantity with a unit to the unit ``si``."""
    try:
        return quantity(value, si)
    except UsageError as error:
        raise invalid_value_error(error.message, error.expected, hint=error.hint) from None


def _parse_number_with_unit(si: str, value: object) -> float:
    """Convert a quantity to the unit ``si``; a number without a unit causes an error."""
    if not isinstance(value, str):
        hint = f'write for example  "{value} {si}"'
        expected = f'a string such as "1 {si}"'
        raise invalid_value_error("the unit of this value is missing", expected, hint=hint)
    return _parse_number(si, value)


def _require_ring_radii(value: object) -> object:
    """Raise an error if the radii of the contact rings are not valid."""
    if value in ("needed", "all") or (type(value) is int and value >= 1):
        return value
    raise invalid_value_error(
        "this value is not one of the choices",
        "needed, all, or a whole number from 1 on",
        hint='write  "needed"',
    )


class ScalePlace(float):
    """Position on the scale of an analysis; ``unit`` is empty for a text without a unit."""

    unit: str = ""


# Units of the range of an analysis: time, frequency, and all quantities that a source can prescribe
# in a dc sweep.
SCALE_UNITS = ("Hz", "s", *dict.fromkeys(d.quantity(side).unit for d, side in QUANTITIES.values()))


def _parse_place(value: object) -> ScalePlace:
    """Parse a position on the scale of an analysis."""
    if isinstance(value, ScalePlace):
        return value
    for unit in SCALE_UNITS:
        try:
            result = ScalePlace(quantity(value, unit))
        except UsageError:
            continue
        result.unit = unit if isinstance(value, str) else ""
        return result
    hint = 'write a number with its unit, such as  "46 Hz"  or  "2 ms"'
    if isinstance(value, str):
        corrections = (_suggest_spelling(value, unit) for unit in ("Hz", "s"))
        hint = next((item for item in corrections if item and "if the value" not in item), hint)
    raise invalid_value_error(
        "this value is not a time or frequency", 'such as "46 Hz" or "2 ms"', hint=hint
    )


def _parse_mounting(value: object) -> object:
    """Parse the mounting of a body: a name or a stiffness."""
    known = ("roller", "glued", "free")
    try:
        if value in known or 0 < quantity(value, "N/m3") < float("inf"):
            return value if value in known else quantity(value, "N/m3")
    except UsageError:
        pass
    above_zero = 'or a stiffness per area above zero such as "1e14 N/m3"'
    hint = did_you_mean(str(value), known) or 'write for example  "glued"'
    expected = f"{', '.join(known)}, {above_zero}"
    raise invalid_value_error("this mounting does not exist", expected, hint=hint)


def si(unit: str) -> BeforeValidator:
    """Return the type of a key with a number in ``unit``.

    Raises
    ------
    UsageError : ``unit`` is not a product or a quotient of SI units.
    """
    if _parse_unit(unit) is None:
        raise UsageError(
            "this text is not a unit",
            where="si",
            got=repr(unit),
            expected='products and quotients of SI units, such as "N s2/m2"',
        )
    return BeforeValidator(partial(_parse_number, unit))


@dataclass(frozen=True)
class Plausible:
    """Range of plausible values of a key, as metadata of its type.

    Plausible values are between ``low`` and ``high`` in ``unit``, and ``why`` states the reason.
    Zero is accepted, for example for a tip without mass.
    """

    unit: str
    low: float
    high: float
    why: str


Length = Annotated[float, si("m")]
# Plausible dimensions of manufactured parts: layers and plates, width of a device, length of a
# device.
Thickness = Annotated[
    Length, Plausible("m", 1e-7, 0.03, "films begin at 0.1 um, plates end at 3 cm")
]
Width = Annotated[Length, Plausible("m", 1e-6, 0.5, "transducers are 1 um to half a metre wide")]
Extent = Annotated[Length, Plausible("m", 1e-6, 1.0, "transducers are 1 um to a metre long")]
Time = Annotated[float, si("s")]
Frequency = Annotated[float, si("Hz")]
Voltage = Annotated[float, si("V")]
Current = Annotated[float, si("A")]
Velocity = Annotated[float, si("m/s")]
Acceleration = Annotated[float, si("m/s2")]
Stiffness = Annotated[float, si("N/m")]
Density = Annotated[float, si("kg/m3")]
Pressure = Annotated[float, si("Pa")]
FluxDensity = Annotated[float, si("T")]
Resistivity = Annotated[float, si("Ohm m")]
Rate = Annotated[float, si("1/s")]
Resistance = Annotated[float, si("Ohm")]
PLAUSIBLE_CAPACITANCE = Plausible(
    "F", 1e-21, 1e5, "the largest capacitors have thousands of farads"
)
PLAUSIBLE_INDUCTANCE = Plausible("H", 1e-15, 1e5, "the largest coils have thousands of henries")
Capacitance = Annotated[float, si("F"), PLAUSIBLE_CAPACITANCE]
Inductance = Annotated[float, si("H"), PLAUSIBLE_INDUCTANCE]
PLAUSIBLE_MASS = Plausible(
    "kg", 1e-18, 1e3, "no transducer moves less than a femtogram or more than a ton"
)
Mass = Annotated[float, si("kg"), PLAUSIBLE_MASS]
MechanicalDamping = Annotated[float, si("N s/m")]
Charge = Annotated[float, si("C")]
Slew = Annotated[float, si("V/s")]
Ratio = Annotated[float, si("")]
Count = Annotated[int, Strict()]
Place = Annotated[float, PlainValidator(_parse_place)]
Rings = Annotated[Literal["needed", "all"] | int, BeforeValidator(_require_ring_radii)]
Mounting = Annotated[Literal["roller", "glued", "free"] | float, BeforeValidator(_parse_mounting)]
GateLength = Annotated[float, BeforeValidator(partial(_parse_number_with_unit, "m"))]
GateTime = Annotated[float, BeforeValidator(partial(_parse_number_with_unit, "s"))]


@dataclass(frozen=True)
class RefinementRule:
    """Rule that refines a key which trades computing time for accuracy.

    One refinement step multiplies the value of the key by ``factor``. If ``spaces`` is true, the
    key is a number of points, and the number of intervals between the points is multiplied. Below
    the value ``finest``, rounding errors dominate. ``model`` marks a key that does not change the
    time of the simulator. ``mesh`` marks a key for the fineness of a mesh or of rings, whose error
    the part estimates. The rule applies only if the keys in ``when`` have the values in ``when``.
    """

    factor: float
    spaces: bool = False
    finest: float = 0.0
    model: bool = False
    mesh: bool = False
    when: tuple[tuple[str, object], ...] = ()

    def refine(self, value: float, steps: float) -> float:
        """Return ``value`` after a number of refinement ``steps``.

        The result is rounded to six digits or to an integer.
        """
        factor = self.factor**steps
        if not isinstance(value, int):
            return float(f"{factor * value:.6g}")
        return round(factor * (value - 1)) + 1 if self.spaces else round(factor * value)


class Section(BaseModel):
    """Base class of tables of a scene file, which rejects unknown keys and later changes."""

    model_config = ConfigDict(extra="forbid", frozen=True, validate_default=True, defer_build=True)
    help_command: ClassVar[str] = "kc2spice scenes --keys"  # lists all keys
    unsupported_key_hints: ClassVar[Mapping[str, str]] = {}  # by name of key


Schema = TypeVar("Schema", bound=Section)


def validate(
    schema: type[Schema],
    table: Mapping[str, Any] | Schema,
    where: str,
    context: Mapping[str, Any] | None = None,
) -> Schema:
    """Convert a table to an instance of ``schema``; return an instance unchanged.

    ``where`` names the table in errors: a key, or a file name with a final colon. The validators of
    the schema receive ``context``.

    Raises
    ------
    UsageError : a key is unknown or missing, has a wrong unit, or contradicts another key.
    """
    if isinstance(table, schema):
        return table
    plain = dict(table) if isinstance(table, Mapping) else table
    try:
        return schema.model_validate(plain, context=context)
    except ValidationError as error:
        path, words = describe_invalid(error, schema, table=plain)
        inside = f"{where} " if where.endswith(":") else f"{where}."
        place = inside + join_path(path) if path else where.removesuffix(":")
        raise UsageError(where=place, **words) from None
