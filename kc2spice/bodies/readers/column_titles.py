"""Meaning of column titles, and conversion of columns to SI units.

A column title, such as ``Phase (deg)`` or ``-Im(Z)/Ohm``, is divided into a sign, words and a unit.
:mod:`kc2spice.bodies.readers.column_kinds` lists the known words and units. Columns whose title has
no known meaning are not used.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from kc2spice.bodies.readers.column_kinds import (
    ADDED_WORDS,
    CASE_FREE_PREFIXES,
    COLUMN_KINDS,
    COMPLEX_NAMES,
    DEFAULT_UNITS,
    MAX_PHASE,
    PASSIVE_PHASES,
    PREFIXES,
    PRIMES,
    QUANTITY_LABELS,
    RADIAN_LIMITS,
    REPLACED_LETTERS,
    UNITS,
    UNITS_WITHOUT_PREFIX,
    ColumnKind,
    Quantity,
)
from kc2spice.core.equality import EqualByContent

# unusual characters in titles, and the characters that replace them
_CHARACTER_REPLACEMENTS = str.maketrans(
    {"\u2126": "Ohm", "Ω": "Ohm", "º": "°", "−": "-", "–": "-", "′": "'", "″": "''"}
)
# sequences that arise if a program encodes a letter twice in UTF-8, and the original letters
_DOUBLE_ENCODED = {"Î©": "Ω", "â„¦": "Ω", "Â°": "°", "Î¸": "θ"}
COMMENT_MARKS = "#%!*; "  # characters that mark a comment line, and are omitted before a title
MAX_TITLE_LENGTH = 200  # largest number of characters of a title
# pattern of a title that ends with a unit without brackets: f/Hz, zth_k_per_w
_TRAILING_UNIT = re.compile(
    r"(.*?\S)\s*(?:/|[\s_,]+)\s*(rad/s|\S{1,2}/W|K_(?:per_)?W|[^\s_/,()\[\]]+)", re.IGNORECASE
)


class ColumnTitleError(ValueError):
    """Error for a column whose title does not fit its values, or has no unique meaning.

    ``advice`` is the hint of the error message.
    """

    def __init__(self, message: str, advice: str) -> None:
        super().__init__(message)
        self.advice = advice


class MissingUnitError(ColumnTitleError):
    """Error for a title whose quantity is known only together with a unit.

    ``title`` is the title in the file, ``choices`` are the possible quantities with their units,
    and ``unit`` is the unit of the first of these quantities. ``corrected_title`` is the title with
    this unit.
    """

    def __init__(self, text: str, stem: str, meanings: Sequence[ColumnKind]) -> None:
        self.title, self.choices = text.strip(), list(map(_describe_quantity, meanings))
        self.unit = DEFAULT_UNITS[meanings[0].measures[0]]
        self.corrected_title = f"{stem.strip()} ({self.unit})"
        super().__init__(
            f"column {self.title!r} has no unit; its values can be {' or '.join(self.choices)}, "
            "so add the unit to the title",
            _advise_title(stem, meanings[0].measures[0]),
        )


@dataclass(frozen=True)
class Unit:
    """Unit of a table column: spelling, measured quantity and factor to SI.

    ``text`` is the spelling of the unit in the file, and ``measures`` is the measured quantity. The
    factor ``value`` converts numbers with this unit to SI units.
    """

    text: str
    measures: str
    value: float


@dataclass(frozen=True)
class ColumnTitle:
    """Title of a table column, with the quantity, sign and unit that it states.

    ``text`` is the title in the file. ``sign`` is -1 if a minus sign precedes the title, otherwise
    1. ``unit`` is None if the title contains no unit.
    """

    text: str
    meaning: ColumnKind
    sign: float
    unit: Unit | None


@dataclass(frozen=True, eq=False)
class Column(EqualByContent):
    """Column of a measurement table, converted to SI units.

    ``values`` has the shape (n,); angles are in rad. ``note`` describes an assumption about the
    unit, and ``unit`` is the name of the unit in the file. ``doubt`` describes why the unit in the
    title may be wrong, and how to correct it; it is empty if the values fit the unit.
    """

    title: ColumnTitle
    values: np.ndarray
    note: str
    unit: str
    doubt: str = ""

    def __str__(self) -> str:
        sign = "-" if self.title.sign < 0 else ""
        quantity = self.title.meaning.quantity
        label = QUANTITY_LABELS.get(quantity, quantity)
        return f"{sign}{label} [{self.unit}] from {self.title.text.strip()!r}"


def parse_units(text: str) -> list[Unit]:
    """Return all units that a text may mean, such as siemens and seconds for ``s``.

    For example, ``s`` may be siemens or seconds.

    Raises
    ------
    ValueError : the letter case makes the prefix ambiguous, as in ``mhz`` or ``MF``.
    """
    plain = _clean_text(text).replace(" ", "")
    result = []
    for measures, spellings in UNITS.items():
        for base, value in spellings.items():
            prefix, spelled = plain[: len(plain) - len(base)], plain[len(plain) - len(base) :]
            cased = base != base.lower()
            if base != (spelled if cased else spelled.lower()) or (not base and plain):
                continue
            factor = _find_prefix_factor(prefix, spelled, measures, text)
            if factor is None or (prefix and base in UNITS_WITHOUT_PREFIX):
                continue
            result.append(Unit(text.strip(), measures, factor * value))
    return result


def _find_prefix_factor(prefix: str, base: str, measures: str, text: str) -> float | None:
    """Return the factor of the SI prefix of a unit; None if it is no valid prefix.

    Return None if ``prefix`` is not an SI prefix that the unit ``base`` can have.

    Raises
    ------
    ValueError : the prefix may mean milli or mega.
    """
    if len(prefix) > 1:
        return None
    small = measures in ("capacitance", "inductance", "admittance") or base == "OHM"
    if (prefix == "m" and base == "hz") or (prefix == "M" and small):
        big = "MHz or mHz" if base == "hz" else f"milli or mega {measures}"
        raise ValueError(
            f"the unit {text!r} may mean {big}; write the prefix in the correct letter case"
        )
    if prefix in PREFIXES:
        return PREFIXES[prefix]
    if prefix == "F":  # FF is not femtofarad
        return None
    other = prefix.swapcase()
    known = other in PREFIXES and (other in CASE_FREE_PREFIXES) == (
        measures == "frequency" or prefix == "K"
    )
    return PREFIXES[other] if known else None


def _clean_text(text: str) -> str:
    """Replace unusual letters in a title or unit; remove enclosing quotation marks.

    The returned string has at most :data:`MAX_TITLE_LENGTH` characters.
    """
    text = text[:MAX_TITLE_LENGTH]
    for wrong, letter in _DOUBLE_ENCODED.items():
        text = text.replace(wrong, letter)
    text = text.strip()
    # quotation marks around a title are removed, but not the primes in Z' and Z"
    text = text[1:].removesuffix('"') if text.startswith('"') else text
    return text.translate(_CHARACTER_REPLACEMENTS).strip()


def read_title(text: str) -> ColumnTitle | None:
    """Parse the title of a column; return None if the meaning is unknown.

    Raises
    ------
    ColumnTitleError : the title's unit does not belong to its quantity, or a unit is missing that
        would identify the quantity.
    ValueError : the prefix of the unit is ambiguous.
    """
    plain = _clean_text(text).lstrip(COMMENT_MARKS).strip()
    sign = -1.0 if re.match(r"-\s*[^\s\d-]", plain) else 1.0
    plain = plain.lstrip("-+ ")
    unfit: ColumnTitleError | None = None
    for stem, unit_text in _split_unit(plain):
        words = _normalise_words(stem)
        meanings = [m for m in COLUMN_KINDS if re.fullmatch(m.names, words)]
        if not meanings:
            continue
        if unit_text is None:
            first = next((m for m in meanings if not m.needs_unit), None)
            if first is None:
                raise MissingUnitError(text, stem, meanings)
            return ColumnTitle(text, first, sign, None)
        units = parse_units(unit_text)
        for meaning in meanings:
            for unit in units:
                if unit.measures in meaning.measures:
                    return ColumnTitle(text, meaning, sign, unit)
        measures = meanings[0].measures[0]
        if unfit is None:
            unfit = ColumnTitleError(
                f"column {text.strip()!r}: {unit_text!r} is not a unit of {measures}",
                _advise_title(stem, measures),
            )
    if unfit is not None:
        raise unfit
    return None


def _advise_title(stem: str, measures: str) -> str:
    """Return the advice to write a title with the default unit of a measured quantity."""
    unit = DEFAULT_UNITS[measures]
    title = f"{stem.strip()} ({unit})" if unit else stem.strip()
    return f"if the values are in {unit}, write the title  {title}"


def _describe_quantity(meaning: ColumnKind) -> str:
    """Return the name of a quantity and its default unit, for error messages."""
    label = QUANTITY_LABELS.get(meaning.quantity, meaning.quantity)
    return f"{label} in {DEFAULT_UNITS[meaning.measures[0]]}"


def is_frequency(text: str) -> bool:
    """Return whether a column title or variable name denotes the frequency.

    The result is true even if the unit in the title is ambiguous.
    """
    try:
        title = read_title(text)
    except ValueError:
        return "freq" in text.lower()
    return title is not None and title.meaning.quantity == "f"


def is_abscissa(text: str) -> bool:
    """Return whether a column title denotes the frequency or the time.

    The other columns of a table depend on the column of frequencies or times.
    """
    if is_frequency(text):
        return True
    try:
        title = read_title(text)
    except ValueError:
        return False
    return title is not None and title.meaning.quantity == "time"


def find_complex_quantity(text: str) -> tuple[Quantity, float] | None:
    """Return the quantity and the unit factor that a title of a complex column states.

    For example, the title ``Z (kOhm)`` means an impedance whose unit is 1000 Ohm. Return None if
    the title does not mean a complex quantity.
    """
    for stem, unit_text in _split_unit(_clean_text(text).lstrip(COMMENT_MARKS).strip()):
        for quantity, names in COMPLEX_NAMES.items():
            if not re.fullmatch(names, _normalise_words(stem)):
                continue
            if unit_text is None:
                return quantity, 1.0
            measures = {"Z": "impedance", "Y": "admittance", "S": "number"}[quantity]
            for unit in parse_units(unit_text):
                if unit.measures == measures:
                    return quantity, unit.value
    return None


def _split_unit(title: str) -> Iterator[tuple[str, str | None]]:
    """Yield each possible division of a title into words and a unit.

    The unit is None if all parts of the title are words.
    """
    for match in re.finditer(r"[\[(]([^\[\]()]*)[\])]", title):
        if parse_units(match[1]):
            yield title[: match.start()] + " " + title[match.end() :], match[1]
            return
    tail = _TRAILING_UNIT.fullmatch(title)
    if tail and _find_units_of_word(tail[2]):
        yield tail[1], tail[2]
    bracket = re.fullmatch(r"(.*?\S)\s*[\[(]([^\[\]()]+)[\])](.*)", title)
    if bracket:  # Re(Z) contains no unit; frequency (rpm) contains an unknown unit
        yield title, None
        yield bracket[1] + bracket[3], bracket[2]
    else:
        yield title, None


def _find_units_of_word(text: str) -> list[Unit]:
    """Return the possible units in the last word of a column title.

    The words ``-`` and ``1`` belong to a name and are not units.
    """
    return parse_units(text) if text not in ("-", "1") else []


def _normalise_words(stem: str) -> str:
    """Return the words of a title, joined to one string in lower case.

    Words that instruments add are omitted.
    """
    low = stem.lower()
    for mark, part in PRIMES:
        low = re.sub(rf"([zy])\s*{mark}", rf"\1{part}", low)
    words = [w for w in re.findall(r"\|\w+\||[^\W_]+", low) if not ADDED_WORDS.fullmatch(w)]
    return "".join(words).replace("impedance", "z").replace("admittance", "y")


def convert_column(title: ColumnTitle, values: np.ndarray) -> Column:
    """Convert a table column to SI units according to the column's title.

    Raises
    ------
    ColumnTitleError : the phase of an impedance exceeds a full turn.
    """
    unit, note, name = title.unit, "", title.text.strip()
    doubt = ""
    if unit is None:
        unit = _assume_unit(title, values)
        if unit.text:
            note = f"{name}: no unit; {unit.text} is assumed"
    elif unit.text[-1:] in REPLACED_LETTERS:
        note = (
            f"{name}: unit {unit.text}, read as {unit.text[:-1]}{REPLACED_LETTERS[unit.text[-1:]]}"
        )
    elif unit.measures == "angle" and unit.value != 1.0 and _are_probably_radians(values):
        largest = np.abs(values).max()
        doubt = (
            f"column {name!r}: no phase exceeds {largest:.3g} {unit.text}: if the phases are in "
            "radians, write rad in the title"
        )
    scaled = 10 ** (values / 20) if unit.measures == "decibel" else unit.value * values
    if title.meaning.quantity in PASSIVE_PHASES and np.abs(scaled).max(initial=0.0) > MAX_PHASE:
        largest = np.abs(values).max()
        advice = "subtract full turns, so that the phases are between -180 and 180 degrees"
        if unit.value > UNITS["angle"]["deg"] and largest * UNITS["angle"]["deg"] <= MAX_PHASE:
            begin, _, end = name.rpartition(unit.text)
            advice = f"write the title  {begin}deg{end}  if the phases are in degrees"
        raise ColumnTitleError(
            f"column {name!r}: {largest:.4g} {unit.text} exceeds a full turn", advice
        )
    return Column(title, title.sign * scaled, note, unit.text or "1", doubt)


def _are_probably_radians(values: np.ndarray) -> bool:
    """Return whether angles are probably in radians: small, but widely varying."""
    largest, spread = RADIAN_LIMITS
    return bool(np.abs(values).max(initial=0.0) <= largest and np.ptp(values) > spread)


def _assume_unit(title: ColumnTitle, values: np.ndarray) -> Unit:
    """Return the unit that is assumed for a column whose title contains no unit."""
    measures = title.meaning.measures[0]
    if measures == "frequency" and re.search("ω|omega", title.text.lower()):
        return Unit("rad/s", measures, UNITS[measures]["rad/s"])
    if measures == "angle":
        if _are_probably_radians(values):
            return Unit("rad", measures, 1.0)
        return Unit("degrees", measures, np.pi / 180)
    return Unit(DEFAULT_UNITS[measures], measures, 1.0)
