"""Errors about TOML tables that do not match their schema, with one remedy each."""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, TypeAlias, TypeVar, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from pydantic_core import ErrorDetails

from kc2spice.core.errors import UsageError, did_you_mean, list_candidates, normalise_word
from kc2spice.core.key_actions import ChangeKey, DeleteKey, Hint, Preposition, SetKey, SweepKey
from kc2spice.core.quantities import ONE_VALUE, Section, convert_quantity
from kc2spice.core.schemas import (
    KeyPath,
    find_section,
    find_unit,
    get_plausible_range,
    join_path,
    list_keys,
)
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.synonyms_from_other_programs import (
    CHOICE_SYNONYMS,
    KEY_SYNONYMS,
    OTHER_MEANINGS,
    REPLACED_KEYS,
)
from kc2spice.core.toml_text import display_text, format_toml, quote_value
from kc2spice.core.unit_spelling import convert_percentage, is_list_of_quantities
from kc2spice.core.untrusted_files import make_identifier

Schema = TypeVar("Schema", bound=Section)
Explanation: TypeAlias = tuple[str, str | None, Hint | None]  # message, expected and hint

# Steps of a pydantic path that name a member of a union, such as ``dict[str,float]``, not a key.
_UNION_MEMBER = re.compile(r"\]$|^(float|int|str|bool)$|^[A-Z]\w*Keys$")
# Unit vectors of the coordinate axes x, y and z, as TOML lists.
_AXIS_VECTORS = {"x": "[1, 0, 0]", "y": "[0, 1, 0]", "z": "[0, 0, 1]"}
# pydantic errors about a value that is not a number
_NUMBER_ERRORS = ("float_type", "float_parsing", "int_type", "int_parsing")
# message about a number that exceeds a limit of its key
OUT_OF_RANGE = "out of range"
UNKNOWN_KEY = "unknown key"  # message about a key that its table may not contain
# A limit of a key is extreme if it differs from the usual value by more than this factor.
USEFUL_RATIO = 1e3
_PREPOSITIONS: dict[str, Preposition] = {
    "gt": "above", "ge": "to", "lt": "below", "le": "to"
}  # fmt: skip
_LIMIT_SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}
# Keys whose text must be one line, because a line break would begin a statement of the netlist.
_SINGLE_LINE_KEYS = ("title", "include")


@dataclass(frozen=True)
class _InvalidValue:
    """One invalid value in a table: the pydantic error, the schema and the key.

    ``path`` is the key in the scene. ``also`` are accepted keys in addition to the keys of
    ``schema``. ``missing`` contains the required keys that are absent from the table with the
    invalid key.
    """

    details: ErrorDetails
    schema: type[BaseModel]
    path: KeyPath
    also: Sequence[str]
    missing: Sequence[str]

    @property
    def schema_path(self) -> KeyPath:
        """Path of the invalid value in the schema, including the names of union members."""
        return self.details["loc"]

    @property
    def value(self) -> Any:
        """Invalid value, as pydantic received it."""
        return self.details["input"]

    @property
    def context(self) -> Mapping[str, Any]:
        """Additional data of the validation error, such as the limits of a number."""
        return self.details.get("ctx", {})

    def write_assignment(self, value: str) -> str:
        """Write the assignment ``KEY = VALUE`` of a value to the invalid key, for a hint."""
        return _write_assignment(self.path, value)


def describe_invalid_key(
    error: ValidationError,
    schema: type[BaseModel],
    at: KeyPath = (),
    also: Sequence[str] = (),
    table: object = None,
) -> tuple[KeyPath, dict[str, Any]]:
    """Return the path of the first invalid key, and the texts that explain its error.

    An unknown key is reported before a missing key, because the unknown key may be a misspelling of
    the missing key. ``at`` is the path of the table, ``also`` are accepted keys in addition to the
    keys of the ``schema``, and ``table`` is the table as typed.
    """
    all_errors = error.errors()
    result = next((item for item in all_errors if item["type"] == "extra_forbidden"), all_errors[0])
    result = _select_union_member(all_errors, result, table)
    missing = [str(item["loc"][-1]) for item in all_errors if item["type"] == "missing"
               and item["loc"][:-1] == result["loc"][:-1]]  # fmt: skip
    path = tuple(step for step in result["loc"] if not _UNION_MEMBER.search(str(step)))
    typed = _find_typed_value(table, path, result["input"])
    table_path = (*at, *path)
    # if the validator of a table found the error, the context contains the invalid key
    if key := result.get("ctx", {}).get("key"):
        below = tuple(int(step) if step.isdecimal() else step for step in key.split("."))
        path, typed = (*path, *below), _find_typed_value(typed, below, None)
    full_path, kind = (*at, *path), result["type"]
    message, expected, hint = _explain(_InvalidValue(result, schema, full_path, also, missing))
    if kind == "missing" and path and isinstance(path[-1], int):  # a list has too few entries
        full_path, typed = full_path[:-1], _find_typed_value(table, path[:-1], ())
        message, expected, hint = _explain_short_list(full_path, typed, len(missing))
        return full_path, {
            "message": message, "got": display_text(typed), "expected": expected, "hint": hint
        }  # fmt: skip
    if isinstance(hint, SetKey) and not hint.table and kind == "quantity":
        # the validator of a table does not know the name of the table
        table_name = join_path(table_path)
        hint = replace(hint, table=table_name, place=None if table_name else "")
    is_one_number = message == ONE_VALUE or kind in _NUMBER_ERRORS
    if is_one_number and is_list_of_quantities(typed):
        message, hint = ONE_VALUE, SweepKey(join_path(full_path), tuple(typed))
    # if two keys contradict each other, the message contains the reason, and no value is quoted
    reason_only = kind == "value_error" or (kind == "quantity" and expected is None)
    contradicts = reason_only and isinstance(typed, Mapping)
    got = None if contradicts or kind in ("extra_forbidden", "missing") else display_text(typed)
    return full_path, {"message": message, "got": got, "expected": expected, "hint": hint}


def validate_table(
    schema: type[Schema],
    table: Mapping[str, Any] | Schema,
    where: str,
    context: Mapping[str, Any] | None = None,
) -> Schema:
    """Validate a TOML table by its schema, and return an instance of the schema.

    An instance of the schema is returned unchanged. ``where`` names the table in errors: a key, or
    a file name with a final colon. The validators of the schema receive ``context``.

    Raises
    ------
    UsageError : a key is unknown or missing, has a wrong unit, or contradicts another key.
    """
    if isinstance(table, schema):
        return table
    typed = dict(table) if isinstance(table, Mapping) else table
    try:
        return schema.model_validate(typed, context=context)
    except ValidationError as error:
        path, words = describe_invalid_key(error, schema, table=typed)
        inside = f"{where} " if where.endswith(":") else f"{where}."
        location = inside + join_path(path) if path else where.removesuffix(":")
        raise UsageError(where=location, **words) from None


def _select_union_member(
    all_errors: Sequence[ErrorDetails], first: ErrorDetails, table: object
) -> ErrorDetails:
    """Select the pydantic error of the union member that is most similar to the value.

    A string is compared with choices, a list with lists and a table with tables.
    """
    position = next((k for k, step in enumerate(first["loc"]) if _is_union_member(step)), None)
    if position is None:
        return first
    stem = first["loc"][:position]
    typed = _find_typed_value(table, stem, None)
    for item in all_errors:
        if item["loc"][:position] == stem and len(item["loc"]) > position:
            member = str(item["loc"][position])
            if isinstance(typed, str) and member.startswith("literal"):
                return item
            if isinstance(typed, (list, tuple)) and member.startswith(("tuple", "list")):
                return item
            if isinstance(typed, Mapping) and re.search(r"Keys\]?$", member):
                return item
    return first


def _is_union_member(step: str | int) -> bool:
    """Return whether a step of a pydantic error path names a union member, not a key."""
    return bool(_UNION_MEMBER.search(str(step)))


def _find_typed_value(table: object, path: KeyPath, converted: Any) -> Any:
    """Return the value at a path as the user typed it.

    If ``table`` lacks this path, ``converted`` is returned.
    """
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


def _explain(invalid: _InvalidValue) -> Explanation:
    """Explain a validation error by a message, the accepted values and a hint."""
    explain = _EXPLANATIONS.get(invalid.details["type"])
    if explain is None:
        return invalid.details["msg"], invalid.context.get("expected"), None
    return explain(invalid)


# --- unknown and missing keys ---


def _explain_unknown_key(invalid: _InvalidValue) -> Explanation:
    """Explain the error for an unknown key, with the most similar known key."""
    path, schema = invalid.schema_path, invalid.schema
    table = _find_schema(schema, path)
    fields = [*table.model_fields, *(invalid.also if len(path) == 1 else ())]
    word, names = str(path[-1]), [step for step in path[:-1] if isinstance(step, str)]
    all_keys = (join_path(item) for item, _ in list_keys(schema) if [*item[: len(names)]] == names)
    elsewhere = (item for item in all_keys if item.rpartition(".")[2] == word)
    hint: Hint = (
        _list_replacement_hints(table).get(word)
        or _suggest_key(word, fields)
        or did_you_mean(word, fields)
        or did_you_mean(word, elsewhere)
        or _suggest_synonym(word, fields)
        or _suggest_described_key(word, table)
        or _suggest_key_replacement(word, invalid.missing)
    )
    return UNKNOWN_KEY, "one of " + list_candidates(word, fields, _get_help_command(schema)), hint


def _explain_missing_key(invalid: _InvalidValue) -> Explanation:
    """Explain the error that a required key is missing."""
    message = f"{join_path(invalid.path)} is missing"
    return message, *_explain_missing(invalid.schema, invalid.schema_path, invalid.path)


def _suggest_key_replacement(word: str, missing: Sequence[str]) -> Hint:
    """Suggest that the user replaces an unknown key by the missing key, or deletes it."""
    if len(missing) == 1:
        return f"write {missing[0]} in place of {word}, because the key `{missing[0]}` is missing"
    return DeleteKey(word)


def _suggest_key(word: str, fields: Sequence[str]) -> str | None:
    """Return the hint to write a scene key, such as ``quality``, in place of ``q``."""
    key, hint = REPLACED_KEYS.get(word.lower(), ("", ""))
    return hint if key in fields else None


def _suggest_described_key(word: str, table: type[BaseModel]) -> str | None:
    """Suggest the key whose description contains a parameter name of the SPICE model."""
    described = re.compile(rf"\b{re.escape(word)} of the SPICE model", re.IGNORECASE)
    for name, field in table.model_fields.items():
        if described.search(field.description or ""):
            return f"write {name} in place of {word}"
    return None


def _suggest_synonym(word: str, fields: Sequence[str]) -> str | None:
    """Suggest the key that corresponds to a name in another program."""
    keys = KEY_SYNONYMS.get(normalise_word(word), ())
    fitting = next((key for key in keys if key in fields), None)
    return fitting and f"write {fitting} in place of {word}"


def _list_replacement_hints(table: type[BaseModel]) -> Mapping[str, str]:
    """Return a hint for each unsupported key of a table, keyed by the key's name."""
    return getattr(table, "unsupported_key_hints", {})


def _explain_missing(
    schema: type[BaseModel], path: KeyPath, full_path: KeyPath
) -> tuple[str | None, SetKey]:
    """Return the accepted values of a missing key, and the hint to add the key."""
    unit = _find_unit(schema, path)
    table = join_path(full_path[:-1])
    value = f'"{_suggest_quantity(schema, path, unit)}"' if unit else "VALUE"
    # _find_field finds no key whose value is a table
    table_fields = _find_schema(schema, path).model_fields
    field, listed = _find_field(schema, path) or table_fields.get(str(path[-1])), None
    if not unit and field is not None:
        choices = get_args(field.annotation) if get_origin(field.annotation) is Literal else ()
        value = f'"{choices[0]}"' if choices else _write_example(field)
        if choices:
            listed = f"one of {list_candidates('', map(str, choices))}"
    expected = f"a number in {unit}, or a string with a unit such as {value}" if unit else listed
    return expected, SetKey(table, str(full_path[-1]), value, verb="add", place=table)


def _suggest_quantity(schema: type[BaseModel], path: KeyPath, unit: str) -> str:
    """Return a plausible value of a key as text, such as ``1 mm``."""
    field = _find_field(schema, path)
    plausible = None if field is None else get_plausible_range(field)
    if plausible is None:
        return f"1 {unit}"
    middle = 10.0 ** round(math.log10(math.sqrt(plausible.low * plausible.high)))
    return format_quantity(middle, plausible.unit).replace("µ", "u")


# --- texts, choices and numbers ---


def _explain_pattern(invalid: _InvalidValue) -> Explanation:
    """Explain the error that a string contains characters that are not allowed."""
    pattern, name = str(invalid.context["pattern"]), make_identifier(str(invalid.value), "name")
    expected = "a letter, then letters, digits and _, at most 64 in all"
    hint = f"replace the characters that are not allowed, for example  {name}"
    if pattern == "^[xyz]{1,3}$":
        expected, hint = "one to three of the letters x, y and z", 'for example "z"'
    elif letters := re.fullmatch(r"\^\[([A-Z]+)\]\$", pattern):
        expected, hint = f"one of {', '.join(letters[1])}", f'for example "{letters[1][0]}"'
    if invalid.path[0] in _SINGLE_LINE_KEYS:
        expected = "one line of text without control characters"
        hint = "delete line breaks and control characters from the text"
    return "this text is not allowed", expected, hint


def _explain_quantity(invalid: _InvalidValue) -> Explanation:
    """Explain an error of type ``quantity``, which contains its own reason and hint."""
    return invalid.context["reason"], invalid.context["expected"], invalid.context.get("hint")


def _explain_choice(invalid: _InvalidValue) -> Explanation:
    """Explain the error that a value is not one of the choices of its key."""
    choices = re.findall(r"'?(\w+)'?(?:, | or |$)", invalid.context["expected"])
    word, key = str(invalid.value), invalid.path[-1]
    hint = did_you_mean(word, choices)
    if (meaning := CHOICE_SYNONYMS.get(normalise_word(word))) in choices:
        hint = f'write  {key} = "{meaning}"'
        other, both, one = OTHER_MEANINGS.get(str(meaning), ("", "", ""))
        if other in choices:
            hint += f'  for {both}, or  {key} = "{other}"  for {one}'
    vector = _AXIS_VECTORS.get(normalise_word(word))
    # the key accepts a choice or a vector
    if vector and any(map(_is_union_member, invalid.schema_path)) and "x" not in choices:
        vector = vector.replace("1", "-1") if word.strip().startswith("-") else vector
        hint = f"write  {key} = {vector}"
    example = f'"{choices[0]}"'
    hint = hint or f"for example  {invalid.write_assignment(example)}"
    # the first listed choices resemble this word
    similar = meaning if meaning in choices else invalid.value
    listed = list_candidates(similar, choices, _get_help_command(invalid.schema))
    return "this value is not one of the choices", f"one of {listed}", hint


def _explain_number(invalid: _InvalidValue) -> Explanation:
    """Explain the error that a value is not a number."""
    return "not a number", "a number", f"write for example  {invalid.write_assignment('1.0')}"


def _explain_non_text(invalid: _InvalidValue) -> Explanation:
    """Explain the error that a value is not a text."""
    return "not a text", "a text in quotes", f'for example  {invalid.path[-1]} = "NAME"'


def _explain_whole_number(invalid: _InvalidValue) -> Explanation:
    """Explain the error that a value is not a whole number."""
    key, value = invalid.path[-1], invalid.value
    hint = f"for example  {key} = 10"
    if isinstance(value, float) and math.isfinite(value) and abs(value) < 1e9:
        hint = f"write  {key} = {max(round(value), 1)}"
    return "not a whole number", "a whole number, without quotes", hint


def _explain_boolean(invalid: _InvalidValue) -> Explanation:
    """Explain the error that a value is neither true nor false."""
    return "not true or false", "true or false, without quotes", f"write  {invalid.path[-1]} = true"


def _explain_limit(invalid: _InvalidValue) -> Explanation:
    """Explain the error that a number exceeds a limit of its key."""
    limit = ", ".join(f"{_LIMIT_SIGNS[key]} {bound:g}" for key, bound in invalid.context.items())
    unit = _find_unit(invalid.schema, invalid.schema_path) or ""
    usual = _find_default_number(invalid.schema, invalid.schema_path)
    hint = _suggest_fraction(invalid) or _suggest_value(
        invalid.path, invalid.value, invalid.context, unit, usual
    )
    return OUT_OF_RANGE, f"{limit} {unit}".rstrip(), hint


def _explain_reason(invalid: _InvalidValue) -> Explanation:
    """Explain an error by the message of the ``ValueError`` that a validator raised."""
    return str(invalid.context["error"]), None, None


def _find_default_number(schema: type[BaseModel], path: KeyPath) -> float | None:
    """Return the default value of a key if the default value is a number, otherwise None."""
    table = _find_schema(schema, path)
    field = table.model_fields.get(str(path[-1]))
    value = None if field is None else field.default
    with contextlib.suppress(ValidationError):  # the table has required keys
        value = getattr(table(), str(path[-1]), value)
    return value if isinstance(value, (int, float)) and not isinstance(value, bool) else None


def _is_extreme(bound: float, usual: float, lower: bool) -> bool:
    """Return whether a limit is so far from the usual value that the limit is of no use."""
    return 0 < bound < usual / USEFUL_RATIO if lower else bound > usual * USEFUL_RATIO > 0


def _suggest_fraction(invalid: _InvalidValue) -> Hint | None:
    """Suggest the fraction that the user meant by a percentage, such as 0.05 for 5 %.

    The result is None if the key is no fraction, or if the key is usually stated in ppm.
    """
    field, value = _find_field(invalid.schema, invalid.schema_path), invalid.value
    bound = next((invalid.context[kind] for kind in ("lt", "le") if kind in invalid.context), None)
    in_ppm = field is not None and any("e-6" in str(item) for item in field.examples or ())
    if bound is None or bound > 1 or in_ppm or (field is not None and find_unit(field)):
        return None
    fraction = convert_percentage(value)
    if fraction is None or fraction >= bound:
        return None
    return _make_assignment(invalid.path, f"{fraction:g}", begin=f"for {value:g} %, ")


def _suggest_value(
    path: KeyPath, value: object, limits: Mapping[str, float], unit: str, usual: float | None
) -> Hint:
    """Advise how to change the value of a key, so that it satisfies the key's limits.

    ``usual`` is the default value of the key, or None without a default. The advice proposes the
    default value if the exceeded limit is extreme.
    """
    (kind, bound), *_ = limits.items()
    lower = kind in ("gt", "ge")
    if lower and isinstance(value, (int, float)) and value < 0 and -value > bound:
        return "remove the minus sign"
    if usual is not None and _is_extreme(bound, usual, lower):
        written = format_toml(f"{usual:g} {unit}" if unit else usual)
        return _make_assignment(path, written)
    limit = f"{bound:g} {unit}".rstrip()
    return ChangeKey("raise" if lower else "lower", join_path(path), _PREPOSITIONS[kind], limit)


# --- tables and lists ---


def _explain_table(invalid: _InvalidValue) -> Explanation:
    """Explain the error that a value is not a table, or not a mapping of named tables."""
    path, value = invalid.path, invalid.value
    if invalid.details["type"] == "dict_type" and isinstance(value, (list, tuple)):
        hint = f"write  {path[-1]} = {{ NAME = … }}  with a name for each entry"
        return "a list, not tables by name", f"[{join_path(path)}.NAME] for each of them", hint
    is_entry = not path or isinstance(path[-1], int)  # the value is a list entry
    form = "{ KEY = VALUE, … }" if is_entry else f"[{join_path(path)}]"
    return "not a table", f"a table, {form}", _suggest_table(invalid, form)


def _suggest_table(invalid: _InvalidValue, form: str) -> str:
    """Suggest to write a table that contains the user's value under a likely key."""
    schema, place, path, value = invalid.schema, invalid.schema_path, invalid.path, invalid.value
    if isinstance(value, (Mapping, list)) or len(path) <= 1:
        key = _find_choice_key(schema, place, value)
        if key is not None and len(path) == 1:
            return f'write  [{path[0]}]  and below it  {key} = "{value}"'
        return f"write a table {form} with its keys"
    if isinstance(path[-1], int):
        entry = _write_entry(_find_schema(schema, (*place, "")), value)
        return f"write  {invalid.write_assignment(entry)}"
    if isinstance(value, str) and (key := _find_text_key(schema, place)):
        return f'write  {path[-1]} = {{ {key} = "{value}" }}'
    if key := _find_value_key(schema, place, value):
        return f"write  {path[-1]} = {{ {key} = {quote_value(value)} }}"
    return f"write  {path[-1]} = {{ KEY = VALUE }}  with the keys of this table"


def _explain_list(invalid: _InvalidValue) -> Explanation:
    """Explain the error that a value is not a list."""
    value, key = invalid.value, invalid.path[-1]
    if isinstance(value, Mapping):  # a table in place of a list of tables
        keys = ", ".join(f"{name} = …" for name in value)
        hint = f"write one table for each entry:  {key} = [{quote_value(value)}]"
        return "not a list", f"a list, {invalid.write_assignment(f'[{{ {keys} }}]')}", hint
    example = "[ … ]"
    if isinstance(value, str) and value in _AXIS_VECTORS:
        example = _AXIS_VECTORS[value]
    elif isinstance(value, (int, float, str)) and key == "band":
        example = f"[0, {format_toml(value)}]"  # the lowest frequency of the proposed band is 0 Hz
    elif isinstance(value, str) and isinstance(key, str):
        example = f'["{value}"]'
    return (
        "not a list",
        f"a list, {invalid.write_assignment('[ … ]')}",
        f"write  {invalid.write_assignment(example)}",
    )


def _explain_list_length(invalid: _InvalidValue) -> Explanation:
    """Explain the error that a list has too few or too many entries."""
    too_short = invalid.details["type"] == "too_short"
    count = invalid.context["min_length" if too_short else "max_length"]
    bound = f"{'least' if too_short else 'most'} {count} entr{'y' if count == 1 else 'ies'}"
    hint = _advise_length(invalid.path, invalid.value, count, too_short)
    return f"too {'few' if too_short else 'many'} entries", f"a list of at {bound}", hint


def _explain_short_list(path: KeyPath, typed: object, lacking: int) -> tuple[str, str, str]:
    """Explain the error that a list lacks some of its entries."""
    entries = list(typed) if isinstance(typed, (list, tuple)) else []
    numeric = all(isinstance(item, (int, float)) for item in entries)
    count, pad = len(entries) + lacking, 0 if numeric else "VALUE"
    added = [pad] * lacking
    # the hint adds 0 Hz at the start of a band, and adds entries at the end of any other list
    completed = [*added, *entries] if path[-1] == "band" else [*entries, *added]
    full = format_toml(completed).replace('"VALUE"', "VALUE")
    return (
        "too few entries",
        f"a list of {count} entries",
        f"write  {_write_assignment(path, full)}",
    )


def _advise_length(path: KeyPath, entries: object, count: int, too_short: bool) -> str:
    """Advise how to bring the number of entries of a list to an accepted number."""
    if too_short or not isinstance(entries, (list, tuple)):
        word = "entry" if count == 1 else "entries"
        return f"add entries, so that the list has at least {count} {word}"
    shorter = format_toml(entries[:count])
    if len(shorter) > 60:
        return f"delete {len(entries) - count} of the {len(entries)} entries"
    return f"write for example  {_write_assignment(path, shorter)}"


def _write_assignment(path: KeyPath, value: str) -> str:
    """Return the text that sets a key or a list entry to a value, for a hint.

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


def _make_assignment(path: KeyPath, value: str, begin: str = "") -> Hint:
    """Propose to set a key to a value; name the table if the table has a header.

    >>> print(_make_assignment(("disc", "rom", "tolerance"), "0.05"))
    write  tolerance = 0.05  in [disc.rom]
    """
    if not isinstance(path[-1], str):
        return f"{begin}write  {_write_assignment(path, value)}"
    has_header = len(path) > 1 and all(isinstance(step, str) for step in path)
    table = join_path(path[:-1])
    return SetKey(table, path[-1], value, place=None if has_header else "", begin=begin)


def _write_entry(schema: type[BaseModel], typed: object) -> str:
    """Write an example of an inline table with all required keys of its schema.

    If ``typed`` is a string, it becomes the value of the first required key that has no unit.
    """
    entries, text = [], typed if isinstance(typed, str) else None
    for name, field in schema.model_fields.items():
        if not field.is_required():
            continue
        unit = find_unit(field)
        value = f'"{_suggest_quantity(schema, (name,), unit)}"' if unit else _format_example(field)
        if text is not None and not unit:
            value, text = f'"{text}"', None
        entries.append(f"{name} = {value}")
    return f"{{ {', '.join(entries) or 'KEY = VALUE'} }}"


def _find_text_key(schema: type[BaseModel], path: KeyPath) -> str | None:
    """Return the only required key of a table, if the value of this key is a string."""
    fields = _find_schema(schema, (*path, "")).model_fields
    required = [name for name, field in fields.items() if field.is_required()]
    if len(required) == 1 and fields[required[0]].annotation is str:
        return required[0]
    return None


def _find_choice_key(schema: type[BaseModel], path: KeyPath, value: object) -> str | None:
    """Return the key for which the typed value is a permitted choice, otherwise None.

    Only the keys of the table at ``path`` are searched.
    """
    for name, field in _find_schema(schema, (*path, "")).model_fields.items():
        if get_origin(field.annotation) is Literal and value in get_args(field.annotation):
            return name
    return None


def _find_value_key(schema: type[BaseModel], path: KeyPath, value: object) -> str | None:
    """Return the key of a table to which the typed value most likely belongs."""
    table = _find_schema(schema, (*path, ""))
    if isinstance(value, (int, float)) and {"quality", "ratio"} <= set(table.model_fields):
        return "quality" if value > 1 else "ratio"
    for name, field in table.model_fields.items():
        unit = find_unit(field)
        if unit is not None:
            with contextlib.suppress(UsageError):
                convert_quantity(value, unit)
                return name
    return None


# --- schemas ---


def _find_field(schema: type[BaseModel], path: KeyPath) -> FieldInfo | None:
    """Find the schema field of a key; ignore list indices in the path of the key."""
    names = tuple(step for step in path if isinstance(step, str))
    return dict(list_keys(schema)).get(names)


def _format_example(field: FieldInfo) -> str:
    """Return the example value of a key as TOML text, or ``VALUE``."""
    return str(field.examples[0]) if field.examples else "VALUE"


def _write_example(field: FieldInfo) -> str:
    """Write an example of a key as TOML: a value, a table, or a list of one table."""
    section = None if field.examples else _find_inner_section(field.annotation)
    if section is None:
        return _format_example(field)
    entry = _write_entry(section, None)
    return f"[{entry}]" if get_origin(field.annotation) in (tuple, list) else entry


def _find_unit(schema: type[BaseModel], path: KeyPath) -> str | None:
    """Return the SI unit of the key at ``path``; None for a key without a unit."""
    field = _find_field(schema, path)
    return None if field is None else find_unit(field)


def _get_help_command(schema: type[BaseModel]) -> str | None:
    """Return the command or the document that lists all keys of a table."""
    return getattr(schema, "help_command", None)


def _find_inner_section(annotation: Any) -> type[BaseModel] | None:
    """Find in a nested type annotation the first class that declares a TOML section."""
    section = find_section(annotation)
    inner = map(_find_inner_section, get_args(annotation)) if section is None else ()
    return section or next(filter(None, inner), None)


def _find_schema(schema: type[BaseModel], path: KeyPath) -> type[BaseModel]:
    """Find the schema of the innermost table that contains a key path."""
    for step in path[:-1]:
        if step in schema.model_fields:
            schema = _find_inner_section(schema.model_fields[str(step)].annotation) or schema
    return schema


# Functions that explain errors, keyed by the type of the error in pydantic.
_EXPLANATIONS: Mapping[str, Callable[[_InvalidValue], Explanation]] = {
    "extra_forbidden": _explain_unknown_key,
    "missing": _explain_missing_key,
    "string_pattern_mismatch": _explain_pattern,
    "quantity": _explain_quantity,
    "literal_error": _explain_choice,
    "float_type": _explain_number,
    "float_parsing": _explain_number,
    "string_type": _explain_non_text,
    "int_type": _explain_whole_number,
    "bool_type": _explain_boolean,
    "bool_parsing": _explain_boolean,
    "dict_type": _explain_table,
    "model_type": _explain_table,
    "tuple_type": _explain_list,
    "list_type": _explain_list,
    "too_short": _explain_list_length,
    "too_long": _explain_list_length,
    "greater_than": _explain_limit,
    "greater_than_equal": _explain_limit,
    "less_than": _explain_limit,
    "less_than_equal": _explain_limit,
    "value_error": _explain_reason,
}
