"""Parser of tables in text files: rows of numbers with titles above the rows.

The input is the text of a file, and the output is a list of :class:`TextTable`. The longest table
is the first in the list. Semicolons, tabs, commas or blanks separate the fields of a line. A comma
within a number is a decimal comma, or a thousands separator if the table also contains decimal
points. Blocks of the same table are merged. The module
:mod:`kc2spice.bodies.readers.complex_response` interprets the tables.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import chain, compress, filterfalse, groupby, repeat
from operator import attrgetter, itemgetter

import numpy as np

from kc2spice.bodies.readers.column_kinds import (
    COMPLEX_FORMATS,
    TRACE_COLUMN,
    TRACE_FORMAT,
    TRACE_NAME,
    TRACE_PARAMETERS,
    TRACE_SCALE,
    TWO_PARTS,
)
from kc2spice.bodies.readers.column_titles import (
    COMMENT_MARKS,
    is_abscissa,
    is_frequency,
    parse_units,
)
from kc2spice.core.equality import EqualByContent
from kc2spice.core.untrusted_files import split_lines

_REAL_PATTERN = r"(\d+\.?\d*|\.\d+)([eEdD][-+]?\d{1,3})?"
_NUMBER_PATTERN = re.compile(rf"[-+]?{_REAL_PATTERN}")
_COMPLEX_PATTERN = re.compile(rf"\(?([-+]?{_REAL_PATTERN})?[-+]?{_REAL_PATTERN}[ij]\)?")
_GROUPED_PATTERN = re.compile(
    r"[-+]?\d{1,3}([,' \u00a0\u202f])\d{3}(\1\d{3})*(\.\d*)?([eE][-+]?\d{1,3})?"
)
SEPARATORS = (";", "\t", ",")  # characters other than blanks that may separate fields
# Pattern of a field that contains a comma, in a text with one field on each line.
_LINE_WITH_COMMA = re.compile(".*,.*")
MIN_COLUMNS = 2  # smallest number of columns of a table
MIN_ROWS = 2  # smallest number of rows of a table
# largest number of lines of a file: five times the largest number of frequencies
MAX_LINES = 100_000
MAX_COLUMNS = 200  # largest number of fields of a line
MAX_LINE_LENGTH = 4000  # largest number of characters of a row or of a line of titles
COMMENT_LINES = 300  # number of lines above a table in which units are searched
TITLE_LINES = 40  # number of lines above a table in which titles are searched
# largest share of a table's rows that may be omitted because they contain a word or are incomplete
MAX_OMITTED_SHARE = 0.05
MAX_HEADER_LENGTH = 80  # largest number of characters of a header that an error quotes
MAX_PHASE_DEGREES = 180.0  # largest magnitude of a phase [degrees]


class EmptyFileError(ValueError):
    """Error for a file without any text.

    ``advice`` is the hint of the error message.
    """

    advice = "export the measurement again"


class ShortTableError(ValueError):
    """Error for a text that has too few rows of numbers to form a table.

    ``advice`` is the hint of the error message.
    """

    advice = (
        "export one row of numbers for each point, under a header line such as  "
        "frequency_hz,real_ohm,imag_ohm"
    )


class FaultyRowsError(ValueError):
    """Error for a table in which too many rows contain words or are incomplete.

    ``advice`` is the hint of the error message.
    """

    advice = "measure these points again, or delete these rows from the file"


class AmbiguousCommaError(ValueError):
    """Error for a table in which a comma separates both fields and decimals.

    ``advice`` is the hint of the error message.
    """

    advice = "export the file with decimal points, or with semicolons between the columns"


@dataclass(frozen=True, eq=False)
class TextTable(EqualByContent):
    """Table in a text file: columns of numbers with titles.

    ``titles`` is None if no line above the numbers contains as many titles as there are columns.
    ``numbers`` contains an array of shape (n,) for each column. ``lines`` contains the numbers of
    the first and the last line of the table, counted from 1. ``header`` is the last line above the
    numbers, and ``comments`` are all lines above the numbers. ``notes`` are assumptions of the
    parser.
    """

    titles: tuple[str, ...] | None
    numbers: tuple[np.ndarray, ...]
    lines: tuple[int, int]
    header: str = ""
    comments: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def row_count(self) -> int:
        """Number of rows of the table."""
        return len(self.numbers[0])

    @property
    def line_range(self) -> str:
        """First and last line number of the table as a string, for messages."""
        return f"lines {self.lines[0]} to {self.lines[1]}"


def read_tables(text: str) -> list[TextTable]:
    """Read all tables in the text of a file; the longest table is the first.

    Blocks with the same frequencies are merged to one table.

    Raises
    ------
    ValueError : the text contains no table, has too many lines, contains a comma that may separate
        thousands or decimals, or has too many rows with words or missing columns.
    """
    count = max(text.count("\n"), text.count("\r"))
    if count > MAX_LINES:
        raise ValueError(f"the file has {count} lines, more than {MAX_LINES}")
    lines = split_lines(text)
    runs, separator, most = list[_LineRange](), None, 0
    for candidate in (*SEPARATORS, None):
        trial = list(_find_numeric_line_ranges(lines, candidate))
        rows = max(map(attrgetter("rows"), trial), default=0)
        if rows > most:
            runs, separator, most = trial, candidate, rows
    if not runs:
        first = next(filter(None, map(str.strip, lines)), "")
        if not first:
            raise EmptyFileError("the file is empty")
        place = f" below the first line {first[:40]!r}"
        problem = "there are too few rows of numbers"
        raise ShortTableError(f"{problem}{place}{_describe_non_number(lines)}")
    tables, end = list[TextTable](), 0
    for run in runs:
        table = _build_table(lines, run, end, separator)
        end = run.last
        before = tables[-1] if tables else None
        if table.titles is None and before and len(before.numbers) == len(table.numbers):
            tables[-1] = _append_block(before, table)
        else:
            tables.append(table)
    return sorted(_merge_tables(tables), key=lambda table: -table.row_count)


# --- rows of numbers ------------------------------------------------------------------------------


@dataclass(frozen=True)
class _LineRange:
    """Range of lines that have equal numbers of fields and form a table.

    ``first`` is the index of the first line, and ``last`` the index after the last line. ``rows``
    is the number of lines that contain only numbers, and ``width`` is the number of fields.
    """

    first: int
    last: int
    rows: int
    width: int


def _split_fields(line: str, separator: str | None) -> list[str]:
    """Split a line into fields; remove quotation marks, and empty fields at the end.

    If ``separator`` is None, blanks separate the fields.
    """
    if separator is None:
        return line.split()
    fields = list(map(str.strip, next(csv.reader([line.strip()], delimiter=separator), [])))
    while fields and not fields[-1]:
        fields.pop()
    return fields


def _is_number(word: str) -> bool:
    """Return whether a word is a real or complex number.

    The number may have a decimal comma, or separators of thousands.
    """
    plain = word.replace(",", ".", 1).replace("\u2212", "-")
    return bool(
        _NUMBER_PATTERN.fullmatch(plain)
        or _GROUPED_PATTERN.fullmatch(word)
        or _COMPLEX_PATTERN.fullmatch(plain)
    )


def _count_fields(line: str, separator: str | None) -> tuple[int, bool]:
    """Return the number of fields in a line, and whether all fields are numbers.

    Return the number of fields, and whether all fields are numbers. The returned number of fields
    is 0 if the line is not a row of a table, and -1 if the line is blank.
    """
    if not line.strip():
        return -1, False
    if len(line) > MAX_LINE_LENGTH or (separator is not None and separator not in line):
        return 0, False
    fields = _split_fields(line, separator)
    if not MIN_COLUMNS <= len(fields) <= MAX_COLUMNS:
        return 0, False
    index = 1 if fields[0] == "" else 0  # the index column of a table may be empty
    if not _is_number(fields[index]):
        return 0, False
    return len(fields), all(map(_is_number, fields))


def _find_numeric_line_ranges(lines: list[str], separator: str | None) -> Iterator[_LineRange]:
    """Yield each range of numeric lines that have equal numbers of fields.

    A few rows in a range may contain words, or may be incomplete.
    """
    kinds = [_count_fields(line, separator) for line in lines]
    # blank lines do not end a table
    filled = [k for k, (width, _) in enumerate(kinds) if width >= 0]
    _join_rows_around_words(lines, separator, filled, kinds)
    _join_rows_around_incomplete_rows(filled, kinds)
    for width, group in groupby(filled, key=lambda k: kinds[k][0]):
        run = list(group)
        numeric_rows = sum(kinds[k][1] for k in run)
        if width > 0 and numeric_rows >= MIN_ROWS:
            yield _LineRange(run[0], run[-1] + 1, numeric_rows, width)


def _join_rows_around_words(
    lines: list[str], separator: str | None, filled: list[int], kinds: list[tuple[int, bool]]
) -> None:
    """Join the table rows around each line of one repeated word, such as ``OVL,OVL``.

    A line of one repeated word is counted as a row of the table. The line must be below a row with
    the same number of fields. Such lines must be above another row, or at the end of the file. A
    last line with a single number is also counted as a row, because the file may be truncated. The
    function changes the entries of ``kinds`` for all these lines.
    """
    above, waiting = 0, list[int]()
    for k in filled:
        width = kinds[k][0]
        if width == 0 and above:
            fields = _split_fields(lines[k], separator)
            cut = k == filled[-1] and len(fields) == 1 and _is_number(fields[0])
            if cut or (len(fields) == above and len(set(fields)) == 1):
                waiting.append(k)
                continue
        if width == above:
            for row in waiting:
                kinds[row] = (above, False)
        above, waiting = width, []
    for row in waiting:
        kinds[row] = (above, False)


def _join_rows_around_incomplete_rows(filled: list[int], kinds: list[tuple[int, bool]]) -> None:
    """Join the table rows around incomplete rows, if only few rows are incomplete.

    The length of a row is its number of fields. A row is incomplete if its length differs from the
    most common length in its table. Incomplete rows are counted as rows of the table. The function
    changes the entries of ``kinds`` for the incomplete rows.
    """
    for is_row, group in groupby(filled, key=lambda k: kinds[k][0] > 0):
        if not is_row:
            continue
        block = list(group)
        widths = Counter(kinds[k][0] for k in block)
        ((width, _),) = widths.most_common(1)
        first = next(place for place, k in enumerate(block) if kinds[k][0] == width)
        other = [k for k in block[first:] if kinds[k][0] != width]
        if len(other) <= max(1, MAX_OMITTED_SHARE * len(block[first:])):
            for k in other:
                kinds[k] = (width, False)


def _describe_non_number(lines: list[str]) -> str:
    """Describe the first row that contains a word instead of a number, for messages.

    Return an empty string if no row contains a word. The description is a part of an error message.
    """
    for k, line in enumerate(lines):
        for separator in (*SEPARATORS, None):
            width, numeric = _count_fields(line, separator)
            if width > 0 and not numeric:
                word = next(filterfalse(_is_number, _split_fields(line, separator)))
                return f"; line {k + 1}, {line.strip()[:40]!r}: {word[:20]!r} is not a number"
    return ""


def _build_table(lines: list[str], run: _LineRange, end: int, separator: str | None) -> TextTable:
    """Make a table from a range of lines, with titles from the lines above it.

    The titles of the table are searched in the lines after the index ``end``, where the previous
    table ends.
    """
    short = (
        line[:MAX_LINE_LENGTH] for line in lines[max(end, run.first - COMMENT_LINES) : run.first]
    )
    above = [line for line in short if line.strip().strip(COMMENT_MARKS)]
    filled = [k for k in range(run.first, run.last) if lines[k].strip()]
    rows = [_split_fields(lines[k], separator) for k in filled]
    index = list(map(itemgetter(0), rows)) == list(map(str, range(len(rows))))
    titles = _find_titles(above, separator, run.width, index)
    if titles is None and separator == ",":
        _reject_ambiguous_commas(above, rows, run.width)
    names = titles or tuple(map("column {}".format, range(1, run.width + 1)))
    complete = [len(row) == run.width and all(map(_is_number, row)) for row in rows]
    notes = _describe_omitted_rows(rows, complete, names, filled)
    rows = list(compress(rows, complete))
    columns = zip(*rows, strict=True)
    numbers = list(map(_parse_column, columns, repeat(rows), names))
    stated = _find_format(above)
    if TRACE_SCALE.fullmatch(stated):
        stated = _find_trace_quantity(lines[: run.first]) or stated
    if titles and stated:
        titles, numbers, more = _rename_trace_columns(titles, numbers, stated)
        notes += more
    header = above[-1].strip().lstrip(COMMENT_MARKS) if above else ""
    place = filled[0] + 1, filled[-1] + 1
    return TextTable(titles, tuple(numbers), place, header, tuple(above), tuple(notes))


def _describe_omitted_rows(
    rows: list[list[str]], complete: list[bool], names: Sequence[str], lines: list[int]
) -> list[str]:
    """Describe rows that are omitted because they contain words or are incomplete.

    ``lines`` are the line numbers of the rows, counted from 0.

    Raises
    ------
    FaultyRowsError : too many rows contain a word or are incomplete.
    """
    if all(complete):
        return []
    first = complete.index(False)
    count, row = complete.count(False), rows[first]
    text = f"line {lines[first] + 1} has {len(row)} of {len(names)} columns"
    if len(row) == len(names):
        column = list(map(_is_number, row)).index(False)
        name = names[column].strip()
        text = f"line {lines[first] + 1}: {row[column][:20]!r} in column {name!r} is not a number"
    if count > max(1, MAX_OMITTED_SHARE * len(rows)):
        raise FaultyRowsError(
            f"{text}; {count} of {len(rows)} rows have a fault, more than "
            f"{100 * MAX_OMITTED_SHARE:g} %"
        )
    return [f"{text}: {count} of {len(rows)} rows left out"]


def _reject_ambiguous_commas(above: list[str], rows: list[list[str]], width: int) -> None:
    """Reject a table in which a comma separates both fields and decimals.

    In such a table, the rows have up to twice as many fields as the titles ``above`` them.

    Raises
    ------
    AmbiguousCommaError : the table has fewer column titles than fields in a row, and contains no
        decimal point.
    """
    if any("." in field for field in chain.from_iterable(rows)):
        return
    for line in above[-TITLE_LINES:]:
        titles = _split_fields(line.strip().lstrip(COMMENT_MARKS), ",")
        if len(titles) < width <= 2 * len(titles) and any(map(is_abscissa, titles)):
            raise AmbiguousCommaError(
                f"the comma separates the {len(titles)} columns, and it is also the decimal "
                f"character: {','.join(rows[0])[:40]!r}"
            )


# --- titles ---------------------------------------------------------------------------------------


def _find_titles(
    above: list[str], separator: str | None, columns: int, index: bool
) -> tuple[str, ...] | None:
    """Find the titles of a table in the lines above the table.

    ``columns`` is the number of columns. Of all lines above the table, the nearest line with the
    title of a frequency or time column contains the titles of all columns. If no line above the
    table contains the title of a frequency or time column, the last line above the table contains
    the titles. A line of units may follow the titles. If ``index`` is true, the first column
    contains row numbers and may have no title. Return None if there are no titles.
    """
    below: list[str] | None = None
    for line in reversed(above[-TITLE_LINES:]):
        names = _split_titles(line.strip().lstrip(COMMENT_MARKS), separator, columns, index)
        if names is not None and any(map(is_abscissa, names)):
            if below and all(map(_is_unit, below)):
                pairs = zip(names, below, strict=True)
                return tuple(f"{name} ({unit.strip('()[]')})" for name, unit in pairs)
            return tuple(names)
        below = names
    last = above[-1].strip().lstrip(COMMENT_MARKS) if above else ""
    names = _split_titles(last, separator, columns, index)
    return None if names is None else tuple(names)


def _is_unit(word: str) -> bool:
    """Return whether a word is a unit."""
    try:
        return bool(parse_units(word.strip("()[]")))
    except ValueError:
        return True


def _split_titles(line: str, separator: str | None, columns: int, index: bool) -> list[str] | None:
    """Split a line into one title for each column.

    ``columns`` is the number of columns. Return None if no separator yields one title for each
    column. If ``index`` is true, the title of the first column may be missing.
    """
    splits = [_split_fields(line, separator)]
    if separator is None:  # blanks also separate the words of a single title
        splits += map(partial(_split_fields, line), SEPARATORS)
        splits.append(re.findall(r"[^\s()\[\]][^()\[\]]*[(\[][^()\[\]]*[)\]]", line))
    # several blanks may separate titles, even if another character separates the numbers
    spaced = re.split(r"\s{2,}", line.strip().strip('"').strip())
    if any(map(is_frequency, spaced)):
        splits.append(spaced)
    by_length = {len(fields): fields for fields in reversed(splits)}
    if columns not in by_length and index:
        short = by_length.get(columns - 1)
        return short and ["", *short]
    return by_length.get(columns)


def _find_format(above: list[str]) -> str:
    """Find the quantity, such as ``|Z|``, in the last ``FORMAT`` line above a table.

    An example of a ``FORMAT`` line is ``FORMAT: |Z|``. Return an empty string if there is no
    ``FORMAT`` line.
    """
    return _find_last_match(TRACE_FORMAT, above)


def _find_trace_quantity(above: list[str]) -> str:
    """Find the quantity of the last trace in a ``MEASURE PARAMETER`` line.

    Return an empty string if there is no line ``MEASURE PARAMETER``.
    """
    match = TWO_PARTS.fullmatch(_find_last_match(TRACE_PARAMETERS, above))
    trace = _find_last_match(TRACE_NAME, above).upper()
    if match is None or not trace:
        return ""
    part = match["a" if trace == "A" else "b"] or match["first" if trace == "A" else "second"]
    return f"{match['of']} {part}" if match["of"] else part


def _find_last_match(pattern: re.Pattern[str], lines: list[str]) -> str:
    """Return the text that a pattern captures in the last matching line.

    Return an empty string if no line matches the pattern.
    """
    for line in reversed(lines):
        if match := pattern.fullmatch(line[:MAX_HEADER_LENGTH].strip().strip('"')):
            return match[1]
    return ""


def _rename_trace_columns(
    titles: tuple[str, ...], numbers: list[np.ndarray], stated: str
) -> tuple[tuple[str, ...], list[np.ndarray], list[str]]:
    """Rename the trace columns of a table after the quantity in its ``FORMAT`` line.

    ``stated`` is the quantity in the ``FORMAT`` line. If the quantity is real, the second column of
    the trace must be zero. If the quantity is |Z| or |Y|, the second column may be the phase.
    Return the titles, the numbers, and notes on assumptions.

    Raises
    ------
    ValueError : the second column is neither zero nor a phase.
    """
    places = [k for k, title in enumerate(titles) if TRACE_COLUMN.fullmatch(title.strip())]
    if not places:
        return titles, numbers, []
    names = list(titles)
    first, *others = places
    pair = COMPLEX_FORMATS.get(" ".join(stated.lower().split()))
    if pair is not None and others:
        names[first], names[others[0]] = pair
        return tuple(names), numbers, []
    names[first], notes = stated, list[str]()
    for k in others[:1]:
        if not numbers[k].any():
            continue
        if (
            stated.strip("|").upper() not in ("Z", "Y")
            or np.abs(numbers[k]).max() > MAX_PHASE_DEGREES
        ):
            raise ValueError(
                f"the second trace column {titles[k].strip()!r} is not zero, but the file states "
                f"the format {stated}, which has one real value for each frequency"
            )
        notes.append(
            f"{titles[k].strip()}: not zero although the format is {stated}; read as the phase"
        )
        names[k] = "Phase"
    return tuple(names), numbers, notes


# --- blocks of one table ---


def _append_block(before: TextTable, table: TextTable) -> TextTable:
    """Append the rows of a table without titles to the table that precedes it."""
    pairs = zip(before.numbers, table.numbers, strict=True)
    numbers = tuple(map(np.concatenate, pairs))
    note = f"{table.line_range} have no titles; read as further rows of the table above"
    lines = before.lines[0], table.lines[1]
    notes = (*before.notes, *table.notes, note)
    return replace(before, numbers=numbers, lines=lines, notes=notes)


def _merge_tables(tables: list[TextTable]) -> list[TextTable]:
    """Merge tables that have the same frequencies into one table with all columns."""
    result = list[TextTable]()
    for table in tables:
        place = next(
            (k for k, first in enumerate(result) if _has_same_frequencies(first, table)), None
        )
        if place is None:
            result.append(table)
            continue
        first = result[place]
        assert first.titles is not None
        titles, numbers = list(table.titles or ()), list(table.numbers)
        frequency = _find_frequency_column(table)
        assert frequency is not None
        del titles[frequency], numbers[frequency]
        result[place] = replace(
            first,
            titles=(*first.titles, *titles),
            numbers=(*first.numbers, *numbers),
            lines=(first.lines[0], table.lines[1]),
            notes=(*first.notes, *table.notes),
        )
    return result


def _has_same_frequencies(first: TextTable, table: TextTable) -> bool:
    """Return whether two tables have equal frequencies in columns with the same title."""
    if first.titles is None or table.titles is None or first.row_count != table.row_count:
        return False
    a, b = _find_frequency_column(first), _find_frequency_column(table)
    if a is None or b is None or first.titles[a].strip() != table.titles[b].strip():
        return False
    return bool(np.array_equal(first.numbers[a], table.numbers[b]))


def _find_frequency_column(table: TextTable) -> int | None:
    """Return the index of the first frequency column in a table; None if none exists."""
    return next((k for k, title in enumerate(table.titles or ()) if is_frequency(title)), None)


# --- numbers --------------------------------------------------------------------------------------


def _parse_column(words: Sequence[str], rows: list[list[str]], title: str) -> np.ndarray:
    """Parse the numbers in one column of a table.

    ``words`` are the fields of the column, and ``rows`` the fields of the whole table. A comma
    within a number is a decimal comma, or a thousands separator if the table also contains decimal
    points.

    Raises
    ------
    ValueError : a comma may separate thousands or decimals, or the table contains decimal commas
        and decimal points.
    """
    text = "\n".join(words).replace("\u2212", "-")
    text = re.sub("(?<=\\d)[' \u00a0\u202f](?=\\d)", "", text)
    with_comma = _LINE_WITH_COMMA.findall(text)
    if with_comma:
        table = "\n".join(chain.from_iterable(rows))
        if "." in table or re.search(",.*,", text):
            if not all(map(_GROUPED_PATTERN.fullmatch, with_comma)):
                raise ValueError(
                    f"column {title!r}: the table mixes decimal commas and decimal points"
                )
            text = text.replace(",", "")
        else:
            thousands = re.compile(r"[-+]?[1-9]\d{0,2},\d{3}")
            if all(map(thousands.fullmatch, _LINE_WITH_COMMA.findall(table))):
                raise ValueError(
                    f"column {title!r}: {with_comma[0]!r} has a comma that can separate "
                    f"thousands or decimals; write a decimal point"
                )
            text = text.replace(",", ".")
    text = text.translate(str.maketrans("dD", "ee", "()"))
    if "i" in text or "j" in text:
        values = np.array(list(map(complex, text.replace("i", "j").split("\n"))))
        return values if values.imag.any() else values.real
    return np.array(list(map(float, text.split("\n"))))
