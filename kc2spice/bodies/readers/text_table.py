"""Numbers and titles of a table in a text: separators, decimal commas, lines above the numbers."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from itertools import chain, groupby

import numpy as np

from kc2spice.bodies.readers.titles import COMMENT, units_of

_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d{1,3})?")
_GROUPED = re.compile(r"[-+]?\d{1,3}([,' \u00a0\u202f])\d{3}(\1\d{3})*(\.\d*)?([eE][-+]?\d{1,3})?")
SEPARATORS = (";", "\t", ",", None)
FEWEST_COLUMNS = 2


def read_table(text: str) -> tuple[list[str], np.ndarray]:
    """Titles and numbers (n, columns) of the longest run of lines with as many numbers.

    Raises
    ------
    ValueError : no such lines, or a comma that may separate thousands or decimals.
    """
    lines = text.splitlines()
    runs = [run for separator in SEPARATORS for run in _runs(lines, separator)]
    if not runs:
        raise ValueError(f"the file has no rows of {FEWEST_COLUMNS} numbers or more")
    first, last, separator = max(runs, key=lambda run: run[1] - run[0])
    rows = [_fields(line, separator) for line in lines[first:last] if line.strip()]
    titles = _titles(lines[:first], separator, len(rows[0]))
    read = [_column_numbers([row[k] for row in rows], rows, titles, k) for k in range(len(rows[0]))]
    return titles, np.column_stack(read)


def _fields(line: str, separator: str | None) -> list[str]:
    """The words of a line, quotes and empty ones at its end removed."""
    if separator is None:
        return line.split()
    fields = [w.strip() for w in next(csv.reader([line.strip()], delimiter=separator), [])]
    while fields and not fields[-1]:
        fields.pop()
    return fields


def _is_number(word: str) -> bool:
    return bool(_NUMBER.fullmatch(word.replace(",", ".", 1)) or _GROUPED.fullmatch(word))


def _runs(lines: list[str], separator: str | None) -> Iterator[tuple[int, int, str | None]]:
    """First line, line behind the last, and separator of every run of rows of numbers."""
    widths = []
    for line in lines:
        fields = _fields(line, separator)
        numeric = len(fields) >= FEWEST_COLUMNS and all(map(_is_number, fields))
        widths.append(len(fields) if numeric else 0 if line.strip() else -1)
    filled = [k for k, width in enumerate(widths) if width >= 0]  # blank lines divide nothing
    for width, group in groupby(filled, key=widths.__getitem__):
        run = list(group)
        if width > 0:
            yield run[0], run[-1] + 1, separator


def _titles(above: list[str], separator: str | None, columns: int) -> list[str]:
    """The titles in the last line above the numbers, with the units that may have a line of their
    own; blanks divide titles if they do it as often as there are columns.

    Raises
    ------
    ValueError : no line, or none with as many titles as there are columns.
    """
    lines = [line.strip().lstrip(COMMENT) for line in above if line.strip().strip(COMMENT)]
    if not lines:
        raise ValueError("the columns have no header")
    last = _split_titles(lines[-1], separator, columns)
    units = last is not None and all(_is_unit(w) for w in last)
    names = _split_titles(lines[-2], separator, columns) if units and len(lines) > 1 else None
    if last is not None and names is not None:
        return [f"{a} ({b.strip('()[]')})" for a, b in zip(names, last, strict=True)]
    if last is None:
        raise ValueError(
            f"the header {lines[-1][:80]!r} does not have the separators of the {columns} columns "
            "of numbers below it"
        )
    return last


def _is_unit(word: str) -> bool:
    try:
        return bool(units_of(word.strip("()[]")))
    except ValueError:
        return True


def _split_titles(line: str, separator: str | None, columns: int) -> list[str] | None:
    """A line as so many titles, None where no separator does."""
    splits = [_fields(line, separator)]
    if separator is None:  # blanks also divide the words of one title
        splits += [_fields(line, other) for other in SEPARATORS if other is not None]
        splits.append(re.split(r"\s{2,}", line.strip()))
    return next((fields for fields in splits if len(fields) == columns), None)


def _column_numbers(
    words: list[str], rows: list[list[str]], titles: list[str], index: int
) -> np.ndarray:
    """The numbers of one column: commas are decimal, or separate thousands in a file with points.

    Raises
    ------
    ValueError : neither is certain.
    """
    plain = [re.sub("(?<=\\d)[' \u00a0\u202f](?=\\d)", "", w) for w in words]
    if any("," in w for w in plain):
        points = any("." in w for row in rows for w in row)
        if points or any(w.count(",") > 1 for w in plain):
            if not all("," not in w or _GROUPED.fullmatch(w) for w in plain):
                raise ValueError(f"column {titles[index]!r}: commas and points in one table")
            plain = [w.replace(",", "") for w in plain]
        else:
            marked = [w for w in chain.from_iterable(rows) if "," in w]
            if all(re.fullmatch(r"[-+]?[1-9]\d{0,2},\d{3}", w) for w in marked):
                example = next(w for w in plain if "," in w)
                raise ValueError(
                    f"column {titles[index]!r}: {example!r} may have thousands or decimals behind "
                    "its comma: write a decimal point"
                )
            plain = [w.replace(",", ".") for w in plain]
    return np.array([float(w.replace("d", "e").replace("D", "e")) for w in plain])
