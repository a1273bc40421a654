"""Errors about TOML files, with the faulty line and a suggested correction.

The parser reports the position at which the parser stopped, which is seldom the position of the
mistake. Each function ``_repair_…`` proposes repaired lines for one kind of mistake.
:func:`make_toml_error` suggests the first repair that makes the parser stop at a later position.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from kc2spice.core.errors import UsageError
from kc2spice.core.files import RESULT_FILE
from kc2spice.core.other_file_formats import (
    HEAD_BYTES,
    NETLIST,
    advise_netlist_part,
    identify_format,
    make_other_format_error,
)
from kc2spice.core.unit_spelling import suggest_spelling
from kc2spice.core.units import parse_quantity
from kc2spice.core.untrusted_files import (
    LONGEST_KEY,
    MAX_NESTING,
    MAX_TEXT_BYTES,
    make_identifier,
    parse_toml,
    split_lines,
)

# Largest number of lines between an opening bracket and the line at which the parser stops.
MAX_BRACKET_LINES = 40
MAX_LINE_LENGTH = 500  # number of characters of a line that are searched for mistakes
_STRING = re.compile(r"\"(?:[^\"\\]|\\.)*\"|'[^']*'")
_BARE_VALUE = re.compile(r"(?<=[=,\[])\s*([^\"'\[\]{},=#\s][^\"'\[\]{},=#]*?)\s*(?=[,\]}#]|$)")
_WRONG_ASSIGNMENT = re.compile(r"(\s*[\w.\-]+)\s*(==|:=|:)\s*")  # groups: key, wrong sign
# Each typographic quotation mark, double or single, is replaced by ``"``.
_PLAIN_QUOTES = str.maketrans(
    dict.fromkeys("\u201c\u201d\u201e\u201f\u00ab\u00bb\u2018\u2019\u201a", '"')
)
# absolute Windows path of a file between double quotes
_WINDOWS_PATH = re.compile(r'"([A-Za-z]:\\|\\\\)[^"]*?([^"\\/]+\.\w+)"')
_HEADER = re.compile(r"\s*(\[+)([\w.\-\"' ]+)\]*\s*(?:#.*)?")


@dataclass(frozen=True)
class _Repair:
    """Repair of one line of a TOML file: the problem, the new line and the advice.

    ``number`` is the number of the repaired line, counted from 1. ``line`` is the new text of the
    repaired line.
    """

    problem: str
    number: int
    line: str
    action: str


# Function that returns the SI unit of a key, from the lines of a file, a line number and the key.
UnitFinder: TypeAlias = Callable[[Sequence[str], int, str], str | None]


def parse_toml_file(
    text: str, label: str, lists: Collection[str] = (), find_unit: UnitFinder | None = None
) -> dict[str, Any]:
    """Parse the text of a TOML file; raise an error that suggests a correction.

    Return the tables of the text. Error messages state ``label`` as the name of the file. ``lists``
    contains the keys of the file that are lists of tables, such as ``[[ports]]``. ``find_unit``
    returns the unit of a key whose value has no quotes.

    Raises
    ------
    UsageError : the text is not TOML; the message quotes the line and proposes a correction.
    """
    try:
        return parse_toml(text)
    except ValueError as error:
        raise make_toml_error(text, error, label, lists, find_unit) from None


def make_toml_error(
    text: str,
    error: ValueError,
    label: str,
    lists: Collection[str] = (),
    find_unit: UnitFinder | None = None,
) -> UsageError:
    """Make the error for text that the TOML parser rejected, with a suggested repair.

    Parameters
    ----------
    text : content of the file.
    error : the exception of :func:`kc2spice.core.untrusted_files.parse_toml`.
    label : name of the file.
    lists : keys of the file that are lists of tables.
    find_unit : function that returns the SI unit of a key, for a value without quotes.
    """
    number = _find_line_number(text, str(error))
    if number is None:  # the errors "too long" and "nested too deeply" have no line number
        return UsageError(
            "this TOML text exceeds a limit on length or nesting",
            where=label,
            got=str(error),
            expected=f"at most {MAX_TEXT_BYTES} characters, keys of at most {LONGEST_KEY} "
            f"characters, and tables and arrays nested at most {MAX_NESTING} deep",
            hint=f"shorten {label} until it is within these limits",
        )
    if (format_error := _make_other_format_error(text, label)) is not None:
        return format_error
    # Only the beginning of a long line is searched, because the time grows with the square of the
    # length.
    lines = [line[:MAX_LINE_LENGTH] for line in split_lines(text)] or [""]
    number = min(number, len(lines))
    error_by_pattern = _make_duplicate_error(
        lines, number, str(error), label
    ) or _make_inline_table_error(lines, number, label)
    error_by_pattern = error_by_pattern or _make_incomplete_error(lines, number, label)
    if error_by_pattern is not None:
        return error_by_pattern
    reached = _find_error_position(text, str(error))
    for repair in _propose_repairs(lines, number, lists, find_unit):
        if _measure_parser_position(lines, repair) > reached:
            return UsageError(
                repair.problem,
                where=f"{label}, line {repair.number}",
                got=_quote_line(lines, repair.number),
                hint=repair.action,
            )
    return UsageError(
        "this text is not valid TOML",
        where=f"{label}, line {number}",
        got=_quote_line(lines, number),
        expected='[TABLE], or KEY = VALUE with text between double quotes, such as "1 kOhm"',
        hint=f"write line {number} in one of these two forms",
    )


EXPECTED_SCENE_FILE = "a TOML file with a table for each part"
# Line of a table: at least two numbers, separated by commas, semicolons, blanks or tabs.
_ROW_OF_NUMBERS = re.compile(
    r"\s*[-+]?[\d.]+(?:[eE][-+]?\d+)?(?:[ \t,;]+[-+]?[\d.]+(?:[eE][-+]?\d+)?)+\s*"
)
_NETLIST_CARD = re.compile(r"(?im)^\.(tran|ac|dc|op|end|ends|subckt|model|include|lib)\b")
# File extensions of other formats, with the name of the format and the advised action.
_OTHER_FORMATS = {
    ".json": ("JSON", "write each object as a table [NAME], and each entry as  KEY = VALUE"),
    ".yaml": ("YAML", "write each block as a table [NAME], and each entry as  KEY = VALUE"),
    ".yml": ("YAML", "write each block as a table [NAME], and each entry as  KEY = VALUE"),
    ".py": ("a Python program", "run it with  python FILE"),
}


def _make_other_format_error(text: str, label: str) -> UsageError | None:
    """Make the error for a file in a known non-TOML format; None for any other file."""
    name, action = _OTHER_FORMATS.get(Path(label).suffix.lower(), ("", ""))
    action = action.replace("FILE", label)
    if not name and not label.endswith(".toml") and _NETLIST_CARD.search(text):
        name, action = NETLIST, advise_netlist_part(label)
        if re.search(r"(?im)^\.subckt\b", text) is None:
            name = f"{NETLIST} without .subckt"
            subcircuit = make_identifier(Path(label).stem, "circuit")
            action = (
                f"in {label}, put the circuit between  .subckt {subcircuit} NODE1 NODE2 ref  and  "
                f".ends, without title, analysis and .end lines; name its reference node `ref`; "
                f"then {action}"
            )
    if not name and not label.endswith(".toml"):
        other = identify_format(text[:HEAD_BYTES].encode(), Path(label).suffix)
        if other is not None:
            return make_other_format_error(Path(label), other, "scene", EXPECTED_SCENE_FILE)
    if not name and _is_table_of_numbers(text):
        name = "a table of numbers"
        action = f"kc2spice reduce {label}  reads a table of measured values"
    if not name:
        return None
    if name == "JSON" and Path(label).name == RESULT_FILE and (scene := _find_result_scene(text)):
        return UsageError(
            "this file contains the results of a run, not a scene",
            where=label,
            expected=EXPECTED_SCENE_FILE,
            hint=f"write the name or the TOML file of the scene {scene} in place of {label}",
        )
    return UsageError(
        f"this file is {name}, not a scene",
        where=label,
        expected=EXPECTED_SCENE_FILE,
        hint=action,
    )


def _find_result_scene(text: str) -> str:
    """Return the name of the scene in the text of ``result.json``, or an empty text."""
    try:
        record = json.loads(text)
    except (ValueError, RecursionError):
        return ""
    name = record.get("scene") if isinstance(record, dict) else None
    return name if isinstance(name, str) and name.isprintable() else ""


def _is_table_of_numbers(text: str) -> bool:
    """Return whether the last lines of a text are rows of numbers."""
    rows = [line for line in split_lines(text.rstrip()) if line.strip()][-2:]
    short = all(len(line) <= MAX_LINE_LENGTH for line in rows)
    return len(rows) > 1 and short and all(map(_ROW_OF_NUMBERS.fullmatch, rows))


def _parse_header(line: str) -> tuple[str, str]:
    """Return the opening brackets and the name in the header line of a TOML table.

    For a line that is no table header, both returned texts are empty.
    """
    header = _HEADER.fullmatch(line) if len(line) <= MAX_LINE_LENGTH else None
    return ("", "") if header is None else (header[1], header[2].strip())


def _quote_line(lines: Sequence[str], number: int) -> str:
    """Return a line of a file for an error message, cut after 120 characters."""
    line = lines[number - 1].strip() if number <= len(lines) else ""
    return line if len(line) <= 120 else line[:120] + " …"


def _find_error_position(text: str, message: str) -> tuple[float, float]:
    """Find line and column of a TOML error from the message of the parser."""
    if match := re.search(r"at line (\d+), column (\d+)\)", message):
        return float(match[1]), float(match[2])
    return math.inf, 0.0


def _find_line_number(text: str, message: str) -> int | None:
    """Find the line number of a TOML error in the parser's message; None if absent."""
    if match := re.search(r"at line (\d+), column", message):
        return int(match[1])
    if "end of document" in message:
        return max(1, len(split_lines(text.rstrip())))
    return None


def _measure_parser_position(lines: Sequence[str], repair: _Repair) -> tuple[float, float]:
    """Return the line and the column at which the parser stops in a repaired text."""
    changed = [*lines[: repair.number - 1], repair.line, *lines[repair.number :]]
    text = "\n".join(changed) + "\n"
    try:
        parse_toml(text)
    except ValueError as error:
        line, column = _find_error_position(text, str(error))
        # a repair shifts the columns of the repaired line
        return (line, column) if line > repair.number else (0.0, column)
    return math.inf, math.inf


def _mask_strings(line: str) -> str:
    """Mask the strings and the comment of a line, without changing its length."""
    masked = _STRING.sub(lambda found: '"' + "_" * (len(found[0]) - 2) + '"', line)
    comment = masked.find("#")
    return masked if comment < 0 else masked[:comment] + " " * (len(masked) - comment)


def _guess_value(value: str) -> str:
    """Guess the TOML value that the user meant by a text that is not valid TOML."""
    if value.lower() in ("true", "false"):
        return value.lower()
    try:
        return repr(float(value))
    except ValueError:
        return f'"{value}"'


def _is_quantity(text: str, unit: str) -> bool:
    """Return whether a text is a valid quantity in a unit."""
    try:
        parse_quantity(text, unit)
    except ValueError:
        return False
    return True


def _is_value(text: str) -> bool:
    """Return whether a text is a valid TOML value."""
    try:
        return set(parse_toml(f"x = {text}")) == {"x"}
    except ValueError:
        return False


def _suggest_line(line: str) -> str:
    """Return the hint to write the corrected line."""
    return f"write  {line.strip()}"


def _repair_quotes(
    lines: Sequence[str], number: int, find_unit: UnitFinder | None
) -> Iterator[_Repair]:
    """Yield repairs of values that are not valid TOML, such as strings without quotes."""
    line = lines[number - 1]
    bare = [m for m in _BARE_VALUE.finditer(_mask_strings(line)) if not _is_value(m[1])]
    repaired = line
    for match in reversed(bare):
        start, end = match.span(1)
        value = line[start:end]
        guess = _guess_value(value)
        key = re.search(r"([\w-]+)\s*=\s*$", line[:start])
        unit = find_unit(lines, number, key[1]) if find_unit and key else None
        spelling = re.search('"[^"]+"', (unit and suggest_spelling(value, unit)) or "")
        if spelling and guess.startswith('"') and not _is_quantity(value, str(unit)):
            guess = spelling[0]
        repaired = repaired[:start] + guess + repaired[end:]
    if bare:
        quoted = '"' in "".join(_guess_value(match[1]) for match in bare)
        problem = "this text has no quotes" if quoted else "this value is not valid TOML"
        yield _Repair(problem, number, repaired, _suggest_line(repaired))


def _find_unmatched_quote(line: str) -> str:
    """Return the unpaired quotation mark of a line, either ``"`` or ``'``.

    The result is empty if no mark is unpaired, or if both kinds of marks are unpaired.
    """
    masked = _STRING.sub(lambda found: "_" * len(found[0]), line)
    lone = [mark for mark in "\"'" if masked.count(mark) == 1]
    return lone[0] if len(lone) == 1 else ""


def _repair_unmatched_quote(lines: Sequence[str], number: int) -> Iterator[_Repair]:
    """Yield repairs of a missing opening or closing quotation mark."""
    # If a closing quote is missing, the parser stops at the next apostrophe or at the end of the
    # file.
    above = (at for at, line in enumerate(lines[:number], start=1) if _find_unmatched_quote(line))
    for at in (number, next(above, number)):
        line = lines[at - 1]
        mark = _find_unmatched_quote(line)
        if not mark:
            continue
        opening = re.sub(rf"=(\s*)([^{mark}=]+{mark}\s*)$", rf"=\1{mark}\2", line)
        if opening != line:
            yield _Repair("missing opening quote", at, opening, _suggest_line(opening))
        body = line.rstrip()
        inside = body.rstrip(" ]},")
        for closing in (inside + mark + body[len(inside) :], body + mark):
            yield _Repair("missing closing quote", at, closing, _suggest_line(closing))


def _repair_header(lines: Sequence[str], number: int, lists: Collection[str]) -> Iterator[_Repair]:
    """Yield repairs of a table header whose brackets do not match.

    ``lists`` contains the keys of the file that are lists of tables.
    """
    brackets, name = _parse_header(lines[number - 1])
    if not name:
        return
    if re.search(r"\s", name) and not re.search("[\"']", name):
        plain = ".".join(make_identifier(word, "part") for word in re.split(r"\s*\.\s*", name))
        header = f"{brackets}{plain}{']' * len(brackets)}"
        problem = "the name of this table contains a blank"
        yield _Repair(problem, number, header, _suggest_line(header))
    is_list = name in lists or (brackets == "[[" and "." in name)
    header = f"[[{name}]]" if is_list else f"[{name}]"
    yield _Repair("the brackets of a table do not match", number, header, _suggest_line(header))


def _repair_brackets(lines: Sequence[str], number: int) -> Iterator[_Repair]:
    """Yield repairs of a list or table whose closing bracket is missing."""
    for opening in range(number, max(0, number - MAX_BRACKET_LINES), -1):
        masked = _mask_strings(lines[opening - 1])
        for left, right in ("{}", "[]"):
            if masked.count(left) <= masked.count(right) or "=" not in masked:
                continue
            for at in range(opening, number + 1):
                line = lines[at - 1]
                body = line[: len(_mask_strings(line).rstrip())]
                closed = f"{body.rstrip(',')} {right}{line[len(body) :]}"
                action = f"add {right} at the end of line {at}: {closed.strip()}"
                yield _Repair(f"{left} without its {right}", at, closed, action)
            return


def _repair_backslash(lines: Sequence[str], number: int) -> Iterator[_Repair]:
    """Yield repairs of backslashes that begin no escape sequence, as in Windows paths."""
    line = lines[number - 1]
    plain = re.sub(r'"([^"\']*)"', r"'\1'", line)
    if found := _WINDOWS_PATH.search(line):
        name = found[2]
        copied = f'{line[: found.start()]}"{name}"{line[found.end() :]}'
        action = f"copy {name} into the folder of this file, and {_suggest_line(copied)}"
        yield _Repair("this path is not in the folder of this file", number, copied, action)
    if "\\" in line and plain != line:
        yield _Repair("a backslash between double quotes", number, plain, _suggest_line(plain))


def _repair_separator(lines: Sequence[str], number: int) -> Iterator[_Repair]:
    """Yield the repair of a semicolon between the keys of an inline table."""
    line = lines[number - 1]
    masked = _mask_strings(line)
    if ";" in masked:
        repaired = "".join("," if m == ";" else c for c, m in zip(line, masked, strict=True))
        yield _Repair("a comma separates keys, not a semicolon", number, repaired,
                      _suggest_line(repaired))  # fmt: skip


def _repair_round_brackets(lines: Sequence[str], number: int) -> Iterator[_Repair]:
    """Yield the repair of a list in round brackets."""
    for at in range(number, max(0, number - MAX_BRACKET_LINES), -1):
        masked = _mask_strings(lines[at - 1])
        if re.search(r"=\s*\(", masked):
            start = masked.index("(", masked.index("="))
            line = f"{lines[at - 1][:start]}[{lines[at - 1][start + 1 :]}"
            end = masked.rfind(")")
            line = f"{line[:end]}]{line[end + 1 :]}" if end > start else line
            yield _Repair("a list is between [ and ], not ( and )", at, line, _suggest_line(line))
            return


def _repair_typographic_quotes(lines: Sequence[str], number: int) -> Iterator[_Repair]:
    """Yield the repair of typographic quotes, which word processors insert."""
    line = lines[number - 1]
    plain = line.translate(_PLAIN_QUOTES)
    if plain != line:
        problem = "typographic quotes are not quotes in TOML"
        yield _Repair(problem, number, plain, _suggest_line(plain))


def _repair_assignment(lines: Sequence[str], number: int) -> Iterator[_Repair]:
    """Yield the repair of ``==``, ``:=`` or a colon between key and value."""
    line = lines[number - 1]
    if match := _WRONG_ASSIGNMENT.match(line):
        repaired = f"{match[1]} = {line[match.end() :]}"
        problem = f"'{match[2]}' stands between key and value in place of '='"
        yield _Repair(problem, number, repaired, _suggest_line(repaired))


# A colon after a key of an inline table, with the blanks around the colon.
_COLON_OF_KEY = re.compile(r"[{,]\s*[\w.-]+(\s*:\s*)")


def _repair_inner_colon(lines: Sequence[str], number: int) -> Iterator[_Repair]:
    """Yield the repair of a colon between key and value inside an inline table."""
    line = lines[number - 1]
    repaired = line
    for colon in reversed(list(_COLON_OF_KEY.finditer(_mask_strings(line)))):
        repaired = f"{repaired[: colon.start(1)]} = {repaired[colon.end(1) :]}"
    if repaired != line:
        problem = "':' stands between key and value in place of '='"
        yield _Repair(problem, number, repaired, _suggest_line(repaired))


def _repair_comment(lines: Sequence[str], number: int) -> Iterator[_Repair]:
    """Yield the repair of a comment that begins with ``//``, ``;`` or ``--``."""
    line = lines[number - 1]
    masked = _mask_strings(line)
    for mark in ("//", ";", "--"):
        if (at := masked.find(mark)) >= 0:
            repaired = f"{line[:at]}#{line[at + len(mark) :]}"
            problem = f"a comment begins with #, not with {mark}"
            yield _Repair(problem, number, repaired, _suggest_line(repaired))


# Number with a decimal comma after an equals sign, and a unit without quotes, if any.
_DECIMAL_COMMA = re.compile(
    r"(?<==)(\s*)([-+]?\d+),(\d+(?:[eE][-+]?\d+)?)(?:\s*([A-Za-zµΩ%][^,\[\]{}\"'#]*?))?"
    r"(?=\s*(?:$|[,\]}#]))"
)


def _repair_decimal_comma(lines: Sequence[str], number: int) -> Iterator[_Repair]:
    """Yield the repair of a number with a comma in place of the decimal point."""
    line = lines[number - 1]
    if match := _DECIMAL_COMMA.search(_mask_strings(line).rstrip()):
        space, integer, digits, unit = match.groups()
        value = f'"{integer}.{digits} {unit}"' if unit else f"{integer}.{digits}"
        repaired = f"{line[: match.start()]}{space}{value}{line[match.end() :]}"
        yield _Repair("a comma in a number", number, repaired, _suggest_line(repaired))


def _propose_repairs(
    lines: Sequence[str], number: int, lists: Collection[str], find_unit: UnitFinder | None
) -> Iterator[_Repair]:
    """Yield all possible repairs of a line, beginning with the most specific mistakes."""
    yield from _repair_header(lines, number, lists)
    yield from _repair_decimal_comma(lines, number)
    yield from _repair_typographic_quotes(lines, number)
    yield from _repair_assignment(lines, number)
    yield from _repair_inner_colon(lines, number)
    yield from _repair_round_brackets(lines, number)
    yield from _repair_separator(lines, number)
    yield from _repair_comment(lines, number)
    yield from _repair_quotes(lines, number, find_unit)
    yield from _repair_unmatched_quote(lines, number)
    yield from _repair_brackets(lines, number)
    yield from _repair_backslash(lines, number)


_ASSIGNMENT_START = re.compile(r"\s*([\w.-]+)\s*=\s*(\{?)\s*(#.*)?$")


def _make_incomplete_error(lines: Sequence[str], number: int, label: str) -> UsageError | None:
    """Make the error for a key without value, or for a list without square brackets."""
    for place in (number, number - 1):
        start = _ASSIGNMENT_START.match(lines[place - 1]) if 0 < place <= len(lines) else None
        if start is None:
            continue
        if not start[2]:
            problem, hint = "the value of this key is missing", f"write a value after {start[1]} ="
        elif place < len(lines) and lines[place].lstrip().startswith("{"):
            problem = "a list of tables needs square brackets"
            hint = f"write  {start[1]} = [  in line {place}, and  ]  in place of the last }}"
        else:
            continue
        got = _quote_line(lines, place)
        return UsageError(problem, where=f"{label}, line {place}", got=got, hint=hint)
    return None


def _make_inline_table_error(lines: Sequence[str], number: int, label: str) -> UsageError | None:
    """Make the error for an inline table { } that extends over several lines."""
    if not 1 <= number <= len(lines) or "=" not in lines[number - 1]:
        return None
    if _mask_strings(lines[number - 1]).rstrip()[-1:] not in ("{", ","):
        return None
    joined = ""
    for line in lines[number - 1 : number + MAX_BRACKET_LINES]:
        joined += " " + line[: len(_mask_strings(line).rstrip())].strip()
        masked = _mask_strings(joined)
        if masked.count("{") == masked.count("}"):
            break
    joined = re.sub(r",\s*}", " }", joined.strip())
    if len(joined) > MAX_LINE_LENGTH or not _is_value(joined.partition("=")[2]):
        return None
    return UsageError(
        "a table between { and } must be on one line",
        where=f"{label}, line {number}",
        got=_quote_line(lines, number),
        hint=_suggest_line(joined),
    )


def _make_duplicate_error(
    lines: Sequence[str], number: int, message: str, label: str
) -> UsageError | None:
    """Make the error for a table or key that a TOML file contains twice."""
    is_duplicate = "Cannot declare" in message or "Cannot overwrite" in message
    if not is_duplicate:
        return None
    line = _quote_line(lines, number)
    _, header = _parse_header(line)
    name = f"[{header}]" if header else line.partition("=")[0].strip()
    first = _find_earlier_definition(lines, number, name)
    kind = "table" if header else "key"
    action = f"rename the second {name} (line {number}), or delete it with its keys"
    if not header:
        action = f"delete line {number}" if first is None else f"delete line {first} or {number}"
    return UsageError(
        f"the {kind} {name} occurs twice"
        if first is None
        else f"line {first} already contains the {kind} {name}",
        where=f"{label}, line {number}",
        got=line,
        hint=action,
    )


def _find_earlier_definition(lines: Sequence[str], number: int, name: str) -> int | None:
    """Find the earlier definition of a table or key in a TOML file: its line number.

    ``name`` is the header of a table, or a key of the table that contains line ``number``.
    """
    for at in range(number - 1, 0, -1):
        line = lines[at - 1].strip()
        _, header = _parse_header(line)
        defined_name = f"[{header}]" if header else line.partition("=")[0].strip()
        if defined_name == name:
            return at
        if header and not name.startswith("["):
            return None
    return None
