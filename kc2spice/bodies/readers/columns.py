"""Tables of instruments: their numbers, their titles, and what each column means.

:data:`MEANINGS` lists every column that is known: its quantity, its units and the words of its
title. A title of an instrument, such as ``Trace 2: Impedance: Phase (deg)`` or ``-Im(Z)/Ohm``, is
taken apart into a sign, words and a unit. Columns without a known meaning are not used.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import chain, groupby

import numpy as np

from kc2spice.core.equality import EqualByContent

PREFIXES = {"f": 1e-15, "p": 1e-12, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "": 1.0,
            "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}  # fmt: skip
LARGE = "kMGT"  # prefixes of both cases where a small letter is no smaller prefix
# Spellings of each unit, by what it measures, with its value in SI.
UNITS: dict[str, dict[str, float]] = {
    "frequency": {"hz": 1.0, "hertz": 1.0, "rad/s": 0.5 / np.pi, "rads": 0.5 / np.pi},
    "impedance": {"ohm": 1.0, "ohms": 1.0},
    "admittance": {"s": 1.0, "siemens": 1.0, "mho": 1.0},
    "capacitance": {"f": 1.0, "farad": 1.0},
    "inductance": {"h": 1.0, "henry": 1.0},
    "angle": {"deg": np.pi / 180, "degree": np.pi / 180, "degrees": np.pi / 180,
              "°": np.pi / 180, "rad": 1.0},
    "decibel": {"db": 1.0},
    "number": {"": 1.0, "-": 1.0, "1": 1.0, "%": 0.01},
}  # fmt: skip
BARE = ("°", "db", "", "-", "1", "%")  # units without prefixes
# An angle without unit is in rad if its size is at most the first and its spread above the second.
RADIANS = 0.51 * np.pi, 0.5


@dataclass(frozen=True)
class Meaning:
    """A kind of column: its ``quantity``, what it may be measured in, the first by default, and the
    pattern of its title in small letters, without sign, unit, blanks and words of instruments.
    With ``needs_unit`` the title alone does not tell it from others."""

    quantity: str
    measures: tuple[str, ...]
    names: str
    needs_unit: bool = False


_PHASE = r"(phase|theta|θ|φ|phi|arg|angle|ang)"
_SIZE = r"(mag|magnitude|abs|mod|modulus)"
_REAL, _IMAG = r"(re|real|realpart)", r"(im|imag|imaginary|imagpart)"


def _part(of: str, word: str) -> str:
    """The word before or behind the letter ``of``, as in ``magz`` and ``zmag``."""
    return rf"{of}{word}|{word}{of}|{word}\|{of}\|"


MEANINGS = (
    Meaning("f", ("frequency",), r"f|freq|frequency|frequenz|frq|omega|ω"),
    Meaning("z", ("impedance", "decibel"), rf"z|z?\|z\||{_SIZE}|{_part('z', _SIZE)}"),
    Meaning("y", ("admittance", "decibel"), rf"y|y?\|y\||{_SIZE}|{_part('y', _SIZE)}"),
    Meaning("phase", ("angle",), _PHASE),
    Meaning("phase_z", ("angle",), _part("z", _PHASE)),
    Meaning("phase_y", ("angle",), _part("y", _PHASE)),
    Meaning("r", ("impedance",), rf"r|z?rs|resistance|{_REAL}|{_part('z', _REAL)}"),
    Meaning("x", ("impedance",), rf"x|z?xs|reactance|{_IMAG}|{_part('z', _IMAG)}"),
    Meaning("rp", ("impedance",), r"z?rp"),
    Meaning("g", ("admittance",), rf"g|y?gp|conductance|{_REAL}|{_part('y', _REAL)}"),
    Meaning("b", ("admittance",), rf"b|y?bp|susceptance|{_IMAG}|{_part('y', _IMAG)}"),
    Meaning("c", ("capacitance",), r"c|capacitance"),
    Meaning("cp", ("capacitance",), r"[zy]?cp"),
    Meaning("cs", ("capacitance",), r"[zy]?cs"),
    Meaning("lp", ("inductance",), r"[zy]?lp"),
    Meaning("ls", ("inductance",), r"[zy]?ls"),
    Meaning("d", ("number",), r"d|df|tan(d|δ|delta)|dissipation(factor)?|loss(factor|tangent)"),
    Meaning("q", ("number",), r"q|quality(factor)?|qfactor"),
    Meaning("s_size", ("decibel",), r"s|s11|γ|gamma", needs_unit=True),
    Meaning("s_phase", ("angle",), r"s|s11|γ|gamma", needs_unit=True),
    Meaning("s_size", ("number", "decibel"), rf"{_part('s', _SIZE)}|{_part('s11', _SIZE)}"),
    Meaning("s_phase", ("angle",), rf"{_part('s', _PHASE)}|{_part('s11', _PHASE)}"),
    Meaning("s_real", ("number",), rf"{_part('s', _REAL)}|{_part('s11', _REAL)}"),
    Meaning("s_imag", ("number",), rf"{_part('s', _IMAG)}|{_part('s11', _IMAG)}"),
)  # fmt: skip
# Words that instruments add to a title.
_ADDED = re.compile(
    r"trace|tr\d*|ch\d*|channel|data|measured|measurement|meas|value|\d+|parameter|primary|secondary"
)
_GREEK_OHM = str.maketrans({"\u2126": "Ohm", "Ω": "Ohm", "−": "-", "–": "-", "′": "'", "″": "''"})
_NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)([eEdD][-+]?\d{1,3})?")
_GROUPED = re.compile(r"[-+]?\d{1,3}([,' \u00a0\u202f])\d{3}(\1\d{3})*(\.\d*)?([eE][-+]?\d{1,3})?")
_COMMENT = "#%!*; "  # marks in front of a title
SEPARATORS = (";", "\t", ",", None)
FEWEST_COLUMNS = 2


@dataclass(frozen=True)
class Unit:
    """A unit as it is written, what it ``measures`` and its ``value`` in SI."""

    text: str
    measures: str
    value: float


@dataclass(frozen=True)
class Title:
    """Meaning of the title of a column; ``unit`` is None if the title contains no unit."""

    text: str
    meaning: Meaning
    sign: float
    unit: Unit | None


@dataclass(frozen=True, eq=False)
class Column(EqualByContent):
    """The ``values`` (n,) of a quantity in SI, angles in rad."""

    title: Title
    values: np.ndarray
    note: str
    unit: str

    def __str__(self) -> str:
        sign = "-" if self.title.sign < 0 else ""
        return f"{sign}{self.title.meaning.quantity} [{self.unit}] from {self.title.text!r}"


def units_of(text: str) -> list[Unit]:
    """Units that ``text`` may be; ``s`` is siemens, ``f`` farad.

    Raises
    ------
    ValueError : the case of ``mhz`` or ``MF`` does not tell a prefix.
    """
    plain = text.strip().translate(_GREEK_OHM).replace(" ", "")
    result = []
    for measures, spellings in UNITS.items():
        for base, value in spellings.items():
            if not plain.lower().endswith(base) or (not base and plain):
                continue
            prefix, spelled = plain[: len(plain) - len(base)], plain[len(plain) - len(base) :]
            factor = _prefix(prefix, spelled, measures, text)
            if factor is None or (prefix and base in BARE):
                continue
            result.append(Unit(text.strip(), measures, factor * value))
    return result


def _prefix(prefix: str, base: str, measures: str, text: str) -> float | None:
    """The factor of a prefix, None for what is none."""
    if len(prefix) > 1:
        return None
    doubtful = (prefix == "m" and base == "hz") or (
        prefix == "M" and measures in ("capacitance", "inductance")
    )
    if doubtful:
        big = "MHz or mHz" if base == "hz" else f"milli or mega {measures}"
        raise ValueError(f"the unit {text!r} may be {big}: write its prefix in the right case")
    if prefix in PREFIXES:
        return PREFIXES[prefix]
    other = prefix.swapcase()
    known = other in PREFIXES and (other in LARGE) == (measures == "frequency" or prefix == "K")
    return PREFIXES[other] if known else None


def read_title(text: str) -> Title | None:
    """Parse a title; None if its meaning is not known.

    Raises
    ------
    ValueError : a unit that its quantity is not measured in, or whose prefix is not clear.
    """
    plain = text.strip().strip('"').lstrip(_COMMENT).translate(_GREEK_OHM).strip()
    sign = -1.0 if re.match(r"-\s*[^\s\d-]", plain) else 1.0
    plain = plain.lstrip("-+ ")
    unfit = ""
    for stem, unit_text in _splits(plain):
        words = _words(stem)
        meanings = [m for m in MEANINGS if re.fullmatch(m.names, words)]
        if not meanings:
            continue
        if unit_text is None:
            first = next((m for m in meanings if not m.needs_unit), None)
            if first is None:
                raise ValueError(f"column {text!r} has no unit: is it dB, deg, real or imag?")
            return Title(text, first, sign, None)
        units = units_of(unit_text)
        for meaning in meanings:
            for unit in units:
                if unit.measures in meaning.measures:
                    return Title(text, meaning, sign, unit)
        unfit = unfit or f"column {text!r}: {unit_text!r} is no unit of {meanings[0].measures[0]}"
    if unfit:
        raise ValueError(unfit)
    return None


def _splits(title: str) -> Iterator[tuple[str, str | None]]:
    """Ways to divide a title into words and a unit; None is a title without one."""
    for match in re.finditer(r"[\[(]([^\[\]()]*)[\])]", title):
        if units_of(match[1]):
            yield title[: match.start()] + " " + title[match.end() :], match[1]
            return
    tail = re.fullmatch(r"(.*?\S)\s*(?:/|[\s_,]+)\s*((?:rad/s|[^\s_/,()\[\]]+))", title)
    if tail and _units_or_none(tail[2]):
        yield tail[1], tail[2]
    bracket = re.fullmatch(r"(.*?\S)\s*[\[(]([^\[\]()]+)[\])](.*)", title)
    if bracket:  # Re(Z) names a quantity, frequency (rpm) an unknown unit
        yield title, None
        yield bracket[1] + bracket[3], bracket[2]
    else:
        yield title, None


def _units_or_none(text: str) -> list[Unit]:
    """Units of a word that may be part of a name instead."""
    return units_of(text) if text not in ("-", "1") else []


def _words(stem: str) -> str:
    """The words of a title in small letters and in one, without those of instruments."""
    low = re.sub(r"z\s*''", "zimag", stem.lower())
    low = re.sub(r"z\s*'", "zreal", low)
    words = [w for w in re.findall(r"\|\w+\||[^\W_]+", low) if not _ADDED.fullmatch(w)]
    return "".join(words).replace("impedance", "z").replace("admittance", "y")


def column_of(title: Title, values: np.ndarray) -> Column:
    """The column of a title with its ``values`` (n,) in SI."""
    unit, note, name = title.unit, "", title.text.strip()
    if unit is None:
        unit = _assumed_unit(title, values)
        if unit.text:
            note = f"{name}: no unit, taken as {unit.text}"
    scaled = 10 ** (values / 20) if unit.measures == "decibel" else unit.value * values
    return Column(title, title.sign * scaled, note, unit.text or "1")


def _assumed_unit(title: Title, values: np.ndarray) -> Unit:
    """The unit of a column that states none."""
    measures = title.meaning.measures[0]
    if measures == "frequency" and re.search("ω|omega", title.text.lower()):
        return Unit("rad/s", measures, UNITS[measures]["rad/s"])
    if measures == "angle":
        largest, spread = RADIANS
        in_rad = np.abs(values).max(initial=0.0) <= largest and np.ptp(values) > spread
        return Unit("rad", measures, 1.0) if in_rad else Unit("degrees", measures, np.pi / 180)
    names = {"frequency": "Hz", "impedance": "Ohm", "admittance": "S", "capacitance": "F"}
    return Unit(names.get(measures, "H" if measures == "inductance" else ""), measures, 1.0)


# ------------------------------------------------------------------------------------ the numbers


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
    lines = [line.strip().lstrip(_COMMENT) for line in above if line.strip().strip(_COMMENT)]
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
