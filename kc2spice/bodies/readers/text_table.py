"""Tables in a text: lines of numbers, the titles above them, and the blocks that belong together.

In: the text of a file. Out: :class:`TextTable` records, the longest first. Fields lie between
semicolons, tabs, commas or blanks. Commas are decimal where they do not separate, or separate
thousands beside decimal points. :mod:`kc2spice.bodies.readers.complex_response` reads on.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import chain, groupby

import numpy as np

from kc2spice.bodies.readers.meanings import COMPLEX_FORMATS, TRACE_COLUMN, TRACE_FORMAT
from kc2spice.bodies.readers.titles import COMMENT, is_frequency, units_of
from kc2spice.core.equality import EqualByContent
from kc2spice.core.untrusted_files import lines_of

_REAL = r"(\d+\.?\d*|\.\d+)([eEdD][-+]?\d{1,3})?"
_NUMBER = re.compile(rf"[-+]?{_REAL}")
_COMPLEX = re.compile(rf"\(?([-+]?{_REAL})?[-+]?{_REAL}[ij]\)?")
_GROUPED = re.compile(r"[-+]?\d{1,3}([,' \u00a0\u202f])\d{3}(\1\d{3})*(\.\d*)?([eE][-+]?\d{1,3})?")
SEPARATORS = (";", "\t", ",", None)
FEWEST_COLUMNS, FEWEST_ROWS = 2, 2
MOST_LINES = 100_000  # lines of a file: five times as many as frequencies are accepted
MOST_COLUMNS = 200  # fields of a line
LONGEST_LINE = 4000  # characters of a row or of a line of titles
COMMENT_LINES = 300  # lines above a table that may state units
TITLE_LINES = 40  # lines above the numbers in which their titles are searched
LEFT_OUT = 0.05  # share of rows with a word instead of a number
LONGEST_HEADER = 80  # characters of a header that an error quotes
HALF_TURN = 180.0  # degrees, the largest size of a phase


@dataclass(frozen=True, eq=False)
class TextTable(EqualByContent):
    """Columns of ``numbers`` (n,) under ``titles``, which are None where no line has as many.

    ``lines`` are the first and the last line of the numbers, from 1; ``header`` is the last line
    above them, ``comments`` are all lines above them; ``notes`` are assumptions of the reader.
    """

    titles: tuple[str, ...] | None
    numbers: tuple[np.ndarray, ...]
    lines: tuple[int, int]
    header: str = ""
    comments: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.numbers[0])

    @property
    def place(self) -> str:
        """Lines of the numbers, for messages."""
        return f"lines {self.lines[0]} to {self.lines[1]}"


def read_tables(text: str) -> list[TextTable]:
    """Tables of a text, the longest first; blocks with the same frequencies are one table.

    Raises
    ------
    ValueError : no table; too many lines or columns; a comma that may separate thousands or
        decimals; rows with words.
    """
    count = max(text.count("\n"), text.count("\r"))
    if count > MOST_LINES:
        raise ValueError(f"{count} lines, more than {MOST_LINES}")
    lines = lines_of(text)
    runs = {separator: list(_runs(lines, separator)) for separator in SEPARATORS}
    separator = max(SEPARATORS, key=lambda s: max((run.rows for run in runs[s]), default=0))
    if not runs[separator]:
        first = next((line.strip() for line in lines if line.strip()), "")
        below = f", below the first line {first[:40]!r}" if first else ""
        fewest = f"fewer than {FEWEST_ROWS} rows of {FEWEST_COLUMNS} numbers or more"
        raise ValueError(f"{fewest}{below}")
    tables, end = list[TextTable](), 0
    for run in runs[separator]:
        table = _table(lines, run, end, separator)
        end = run.last
        before = tables[-1] if tables else None
        if table.titles is None and before and len(before.numbers) == len(table.numbers):
            tables[-1] = _continued(before, table)
        else:
            tables.append(table)
    return sorted(_merged(tables), key=lambda table: -table.rows)


# --- rows of numbers ------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Run:
    """Lines ``first`` to before ``last`` whose rows have as many fields; ``rows`` of numbers."""

    first: int
    last: int
    rows: int
    width: int


def _fields(line: str, separator: str | None) -> list[str]:
    """The words of a line, quotes and empty ones at its end removed."""
    if separator is None:
        return line.split()
    fields = [w.strip() for w in next(csv.reader([line.strip()], delimiter=separator), [])]
    while fields and not fields[-1]:
        fields.pop()
    return fields


def _is_number(word: str) -> bool:
    plain = word.replace(",", ".", 1).replace("\u2212", "-")
    return bool(_NUMBER.fullmatch(plain) or _GROUPED.fullmatch(word) or _COMPLEX.fullmatch(plain))


def _width(line: str, separator: str | None) -> tuple[int, bool]:
    """Fields of a line that begins with a number, 0 of any other, -1 of a blank one; whether all
    fields are numbers."""
    if not line.strip():
        return -1, False
    if len(line) > LONGEST_LINE or (separator is not None and separator not in line):
        return 0, False
    fields = _fields(line, separator)
    if not FEWEST_COLUMNS <= len(fields) <= MOST_COLUMNS:
        return 0, False
    index = 1 if fields[0] == "" else 0  # the index column of a table may be empty
    if not _is_number(fields[index]):
        return 0, False
    return len(fields), all(map(_is_number, fields))


def _runs(lines: list[str], separator: str | None) -> Iterator[_Run]:
    """Every run of rows of the same width, some of which may contain a word."""
    kinds = [_width(line, separator) for line in lines]
    filled = [k for k, (width, _) in enumerate(kinds) if width >= 0]  # blank lines divide nothing
    for width, group in groupby(filled, key=lambda k: kinds[k][0]):
        run = list(group)
        numeric = [k for k in run if kinds[k][1]]
        if width > 0 and len(numeric) >= FEWEST_ROWS:
            yield _Run(run[0], run[-1] + 1, len(numeric), width)


def _table(lines: list[str], run: _Run, end: int, separator: str | None) -> TextTable:
    """The table of a run of rows, whose titles are below line ``end``."""
    short = (line[:LONGEST_LINE] for line in lines[max(end, run.first - COMMENT_LINES) : run.first])
    above = [line for line in short if line.strip().strip(COMMENT)]
    filled = [k for k in range(run.first, run.last) if lines[k].strip()]
    rows = [_fields(lines[k], separator) for k in filled]
    index = all(row[0] == str(k) for k, row in enumerate(rows))
    titles = _titles(above, separator, run.width, index)
    names = titles or tuple(f"column {k + 1}" for k in range(run.width))
    complete = [all(map(_is_number, row)) for row in rows]
    notes = _left_out(rows, complete, names, [k + 1 for k in filled])
    rows = [row for row, numeric in zip(rows, complete, strict=True) if numeric]
    numbers = [_column_numbers([row[k] for row in rows], rows, names[k]) for k in range(run.width)]
    stated = _last_format(above)
    if titles and stated:
        titles, numbers, more = _with_format(titles, numbers, stated)
        notes += more
    header = above[-1].strip().lstrip(COMMENT) if above else ""
    place = filled[0] + 1, filled[-1] + 1
    return TextTable(titles, tuple(numbers), place, header, tuple(above), tuple(notes))


def _left_out(
    rows: list[list[str]], complete: list[bool], names: Sequence[str], lines: list[int]
) -> list[str]:
    """A note about rows that contain a word.

    Raises
    ------
    ValueError : they are too many.
    """
    if all(complete):
        return []
    first = complete.index(False)
    column = next(k for k, word in enumerate(rows[first]) if not _is_number(word))
    count, word = complete.count(False), rows[first][column]
    text = f"line {lines[first]}: {word[:20]!r} in column {names[column].strip()!r} is no number"
    if count > max(1, LEFT_OUT * len(rows)):
        raise ValueError(f"{text}; {count} of {len(rows)} rows are like this")
    return [f"{text}: {count} of {len(rows)} rows left out"]


# --- titles ---------------------------------------------------------------------------------------


def _titles(
    above: list[str], separator: str | None, columns: int, index: bool
) -> tuple[str, ...] | None:
    """Titles of so many columns in the nearest line that names a frequency, or in the last line.

    A line of units may follow them. With ``index`` the first column may have no title.
    """
    below: list[str] | None = None
    for line in reversed(above[-TITLE_LINES:]):
        names = _split_titles(line.strip().lstrip(COMMENT), separator, columns, index)
        if names is not None and any(map(is_frequency, names)):
            if below and all(map(_is_unit, below)):
                pairs = zip(names, below, strict=True)
                return tuple(f"{name} ({unit.strip('()[]')})" for name, unit in pairs)
            return tuple(names)
        below = names
    last = above[-1].strip().lstrip(COMMENT) if above else ""
    names = _split_titles(last, separator, columns, index)
    return None if names is None else tuple(names)


def _is_unit(word: str) -> bool:
    try:
        return bool(units_of(word.strip("()[]")))
    except ValueError:
        return True


def _split_titles(line: str, separator: str | None, columns: int, index: bool) -> list[str] | None:
    """A line as so many titles, None where no separator does."""
    splits = [_fields(line, separator)]
    if separator is None:  # blanks also divide the words of one title
        splits += [_fields(line, other) for other in SEPARATORS if other is not None]
        splits.append(re.split(r"\s{2,}", line.strip()))
        splits.append(re.findall(r"[^\s()\[\]][^()\[\]]*[(\[][^()\[\]]*[)\]]", line))
    fitting = next((fields for fields in splits if len(fields) == columns), None)
    if fitting is None and index:
        short = next((fields for fields in splits if len(fields) == columns - 1), None)
        return short and ["", *short]
    return fitting


def _last_format(above: list[str]) -> str:
    """The quantity in the last line ``FORMAT: |Z|`` above a table, empty without one."""
    matches = [TRACE_FORMAT.fullmatch(line.strip().strip('"')) for line in above]
    return next((match[1] for match in reversed(matches) if match), "")


def _with_format(
    titles: tuple[str, ...], numbers: list[np.ndarray], stated: str
) -> tuple[tuple[str, ...], list[np.ndarray], list[str]]:
    """Titles of the two numbers of a trace by the ``FORMAT`` that the file states, and a note.

    The second number of one real quantity is zero. Beside |Z| or |Y| it may be the phase.

    Raises
    ------
    ValueError : it is neither zero nor a phase.
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
        if stated.strip("|").upper() not in ("Z", "Y") or np.abs(numbers[k]).max() > HALF_TURN:
            raise ValueError(
                f"column {titles[k].strip()!r}: FORMAT: {stated} has one number, but it is not zero"
            )
        notes.append(f"{titles[k].strip()}: not zero beside FORMAT: {stated}, taken as the phase")
        names[k] = "Phase"
    return tuple(names), numbers, notes


# --- blocks that belong together ------------------------------------------------------------------


def _continued(before: TextTable, table: TextTable) -> TextTable:
    """A table with the rows of a further block that has no titles."""
    pairs = zip(before.numbers, table.numbers, strict=True)
    numbers = tuple(map(np.concatenate, pairs))
    note = f"{table.place} have no titles: taken as further rows of the table above"
    lines = before.lines[0], table.lines[1]
    notes = (*before.notes, *table.notes, note)
    return replace(before, numbers=numbers, lines=lines, notes=notes)


def _merged(tables: list[TextTable]) -> list[TextTable]:
    """Tables of which blocks with the same frequencies and other titles are one."""
    result = list[TextTable]()
    for table in tables:
        place = next((k for k, first in enumerate(result) if _is_beside(first, table)), None)
        if place is None:
            result.append(table)
            continue
        first = result[place]
        assert first.titles is not None
        assert table.titles is not None
        skipped = _frequency_column(table)
        more = [k for k in range(len(table.numbers)) if k != skipped]
        result[place] = replace(
            first,
            titles=(*first.titles, *(table.titles[k] for k in more)),
            numbers=(*first.numbers, *(table.numbers[k] for k in more)),
            lines=(first.lines[0], table.lines[1]),
            notes=(*first.notes, *table.notes),
        )
    return result


def _is_beside(first: TextTable, table: TextTable) -> bool:
    """Whether two tables have the same frequencies under the same title."""
    if first.titles is None or table.titles is None or first.rows != table.rows:
        return False
    a, b = _frequency_column(first), _frequency_column(table)
    if a is None or b is None or first.titles[a].strip() != table.titles[b].strip():
        return False
    return bool(np.array_equal(first.numbers[a], table.numbers[b]))


def _frequency_column(table: TextTable) -> int | None:
    return next((k for k, title in enumerate(table.titles or ()) if is_frequency(title)), None)


# --- numbers --------------------------------------------------------------------------------------


def _column_numbers(words: list[str], rows: list[list[str]], title: str) -> np.ndarray:
    """The numbers of one column: commas are decimal, or separate thousands in a file with points.

    Raises
    ------
    ValueError : neither is certain.
    """
    words = [word.replace("\u2212", "-") for word in words]
    plain = [re.sub("(?<=\\d)[' \u00a0\u202f](?=\\d)", "", w) for w in words]
    if any("," in w for w in plain):
        points = any("." in w for row in rows for w in row)
        if points or any(w.count(",") > 1 for w in plain):
            if not all("," not in w or _GROUPED.fullmatch(w) for w in plain):
                raise ValueError(f"column {title!r}: commas and points in one table")
            plain = [w.replace(",", "") for w in plain]
        else:
            marked = [w for w in chain.from_iterable(rows) if "," in w]
            if all(re.fullmatch(r"[-+]?[1-9]\d{0,2},\d{3}", w) for w in marked):
                example = next(w for w in plain if "," in w)
                raise ValueError(
                    f"column {title!r}: {example!r} may have thousands or decimals behind "
                    "its comma: write a decimal point"
                )
            plain = [w.replace(",", ".") for w in plain]
    plain = [w.replace("d", "e").replace("D", "e") for w in plain]
    if any(w.strip("()")[-1:] in "ij" for w in plain):
        values = np.array([complex(w.strip("()").replace("i", "j")) for w in plain])
        return values if values.imag.any() else values.real
    return np.array(list(map(float, plain)))
