"""Conversion of columns of numbers to complex responses and admittances.

The input is either the tables of a file, or a list of columns with their titles. The output is a
:class:`MeasuredResponse`. A file with two possible meanings is rejected, and the error describes
both meanings.

In a gain measurement, a source drives the part Z in series with a resistor R, which is called the
shunt. The gain g is the voltage across the shunt divided by the source voltage::

    g = R / (Z + R)        Z = R (1 / g - 1)        Y = (1 / R) g / (1 - g)

The reflection ``S = 1 - 2 g`` with the reference resistance R represents the same admittance Y. If
the part is passive, the voltage across the shunt is at most the source voltage, so the gain is at
most 1. If most samples of a measured gain are above 1, the file contains the inverse of the gain.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from operator import attrgetter

import numpy as np

from kc2spice.bodies.readers.column_kinds import (
    CHANNEL_PATTERN,
    COMBINATIONS,
    DEFAULT_UNITS,
    QUANTITY_LABELS,
    SOUND_QUANTITY,
    SUFFIX_TITLES,
    UNSTATED_QUANTITIES,
    UNTITLED_MEANINGS,
    ColumnCombination,
    Quantity,
)
from kc2spice.bodies.readers.column_titles import (
    Column,
    ColumnTitleError,
    MissingUnitError,
    convert_column,
    find_complex_quantity,
    is_frequency,
    read_title,
)
from kc2spice.bodies.readers.text_table import MAX_HEADER_LENGTH, TextTable
from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import MAX_CANDIDATES, UsageError, list_candidates

DEFAULT_REFERENCE = 50.0  # Ohm, reference resistance of S parameters if the file states none
# Smallest number of frequencies of a response.
# Twelve frequencies suffice for the four parameters of a resonance and an estimate of the noise.
MIN_FREQUENCIES = 12
# Largest median of the relative difference between two responses that agree.
# The limit of 5 % is larger than the rounding errors of the columns.
AGREEMENT_LIMIT = 0.05
# Largest share of frequency steps against the sweep direction, in a table of several sweeps.
# If more steps run against the sweep direction, the reader rejects the frequencies as unsorted.
MAX_REVERSAL_SHARE = 0.1
MAX_TITLE_LENGTH = 50  # largest number of characters of column titles in an error message
NAME_COLUMNS_HINT = "name the columns in the first line, such as  frequency_hz,real_ohm,imag_ohm"
ONE_PART_HINT = (
    "keep one of the listed alternatives, and delete the columns or rows of the other alternatives"
)


@dataclass(frozen=True, eq=False)
class MeasuredResponse(EqualByContent):
    """Measured samples of S, Z or Y, and the admittances computed from the samples.

    ``samples`` of shape (n, ports, ports) are values of the ``quantity`` S, Z or Y at the
    frequencies ``f`` (n,) [Hz]. ``Y`` contains the admittances [S] of the samples, an array of the
    same shape as ``samples``. ``reference`` (ports,) [Ohm] contains the reference resistances of S
    parameters. ``notes`` are assumptions of the reader, and ``columns`` describes the meaning of
    the columns. ``doubt`` describes a property of the data that suggests a wrong unit or format,
    and how to correct the file. If the data fit the stated unit and format, ``doubt`` is empty.
    """

    f: np.ndarray
    quantity: Quantity
    samples: np.ndarray
    Y: np.ndarray
    reference: np.ndarray
    notes: tuple[str, ...] = ()
    columns: str = ""
    doubt: str = ""


def convert_to_admittance(quantity: Quantity, P: np.ndarray, z0: np.ndarray) -> np.ndarray:
    """Convert samples of S, Z or Y parameters to admittance matrices.

    ``P`` and the returned array have the shape (n, ports, ports). ``z0`` (ports,) [Ohm] contains
    the reference resistances of S parameters.
    """
    one = np.eye(P.shape[1])
    try:
        if quantity == "S":
            root = np.diag(1 / np.sqrt(z0))
            return np.asarray(root @ np.linalg.solve(one + P, one - P) @ root)
        return np.linalg.inv(P) if quantity == "Z" else P
    except np.linalg.LinAlgError:
        raise ValueError("an impedance of zero: an ideal short circuit has no admittance") from None


def make_ambiguity_error(got: str, readings: Sequence[str], hint: str) -> UsageError:
    """Make the error for a file whose data can be read in more than one way.

    ``readings`` describes the possible meanings of the data.
    """
    listed = "; or ".join(f"({k}) {text}" for k, text in enumerate(readings, 1))
    return UsageError(
        "the data in this file can be read in more than one way",
        got=got,
        expected=f"data that can be read in only one of these ways: {listed}",
        hint=hint,
    )


def find_response(
    tables: Sequence[TextTable], shunt: float | None, suffix: str
) -> MeasuredResponse:
    """Find the only frequency response in the tables of a file.

    ``shunt`` [Ohm] is the resistance of the shunt with which a gain was measured, and ``suffix`` is
    the file extension.

    Raises
    ------
    ValueError, UsageError : no table contains a response, or several tables contain one.
    """
    large = [table for table in tables if table.row_count >= MIN_FREQUENCIES] or list(tables[:1])
    responses, reasons = list[tuple[TextTable, MeasuredResponse]](), list[Exception]()
    notes = list[str]()
    for table in large:
        try:
            responses.append((table, _find_table_response(table, shunt, suffix)))
        except (ValueError, UsageError) as error:
            reasons.append(error)
            notes.append(f"{table.line_range} are not used: {error}".splitlines()[0])
    if not responses:
        raise reasons[0]
    if len(responses) > 1:
        readings = [f"{table.line_range}: {response.columns}" for table, response in responses]
        raise make_ambiguity_error(f"{len(responses)} sweeps", readings, ONE_PART_HINT)
    response = responses[0][1]
    return replace(response, notes=(*response.notes, *notes))


def _find_table_response(table: TextTable, shunt: float | None, suffix: str) -> MeasuredResponse:
    """Return the frequency response in one table of a file.

    The extension of the file is ``suffix``.
    """
    if table.titles is not None and any(map(is_frequency, table.titles)):
        return combine_response(table.titles, table.numbers, shunt, table.notes)
    suffix_titles = SUFFIX_TITLES.get(suffix)
    width = len(table.numbers)
    if suffix_titles and width == len(suffix_titles):
        titles = _replace_titles(suffix_titles, table.comments)
        notes = (*table.notes, f"no column titles; {', '.join(titles)} are assumed")
        return combine_response(titles, table.numbers, shunt, notes)
    if table.titles is not None:
        return combine_response(table.titles, table.numbers, shunt, table.notes)
    _require_two_value_columns(table.numbers, table.header)
    if table.header:
        raise ValueError(
            f"the header {table.header[:MAX_HEADER_LENGTH]!r} does not contain {width} titles, "
            f"separated like the {width} columns of numbers below it"
        )
    first = " ".join(f"{column[0]:g}" for column in table.numbers[:6])
    got = f"{width} columns without titles, first row {first}"
    raise make_ambiguity_error(got, UNTITLED_MEANINGS, NAME_COLUMNS_HINT)


def _replace_titles(titles: Sequence[str], comments: Sequence[str]) -> tuple[str, ...]:
    """Replace the default titles of columns by titles that comment lines state.

    Raises
    ------
    ValueError : a title in the comments combines a quantity with a unit of another quantity.
    """
    result = list(titles)
    quantities = [title.meaning.quantity for title in map(read_title, titles) if title]
    for comment in comments:
        for piece in comment.rpartition(": ")[2].split(","):
            title = read_title(piece)
            if title is None or title.unit is None:
                continue
            quantity = title.meaning.quantity
            if quantity in quantities:
                result[quantities.index(quantity)] = piece.strip()
            elif quantity == SOUND_QUANTITY:
                result[1] = piece.strip()
    return tuple(result)


@dataclass(frozen=True, eq=False)
class _ColumnPair(EqualByContent):
    """Two columns, such as magnitude and phase, and the response computed from them."""

    combination: ColumnCombination
    columns: tuple[Column, ...]
    samples: np.ndarray

    def __str__(self) -> str:
        return " and ".join(map(str, self.columns))


@dataclass(frozen=True, eq=False)
class ClassifiedColumns(EqualByContent):
    """Columns of a table, classified by the meaning of their titles.

    ``by_quantity`` contains the real columns, keyed by quantity. ``complex_columns`` contains the
    title, quantity and values of each column of complex numbers. ``unknown`` are titles without a
    known meaning, and ``problems`` are errors about titles.
    """

    by_quantity: dict[str, list[Column]]
    complex_columns: list[tuple[str, Quantity, np.ndarray]]
    unknown: list[str]
    problems: list[ValueError]


def combine_response(
    titles: Sequence[str],
    numbers: Sequence[np.ndarray],
    shunt: float | None = None,
    notes: Sequence[str] = (),
) -> MeasuredResponse:
    """Compute the frequency response of a table from its columns.

    ``numbers`` contains an array of shape (n,) for each of the ``titles``. ``shunt`` is the
    resistance [Ohm] of the shunt with which a gain was measured, and ``notes`` are assumptions of
    the parser.

    Raises
    ------
    ValueError : there is no frequency column, or no two columns determine an impedance.
    UsageError : columns contradict each other, a gain is given without a shunt, or a shunt is given
        without a gain.
    """
    if len(titles) != len(numbers):
        raise ValueError(
            f"the table has {len(titles)} titles above {len(numbers)} columns of numbers"
        )
    columns = classify_columns(titles, numbers)
    if set(columns.by_quantity) <= {"f"}:
        _require_two_value_columns(numbers, ", ".join(map(str.strip, titles)), columns.unknown)
    _require_complete(titles, columns, shunt)
    frequency = _select_agreeing_column("f", columns.by_quantity["f"])
    f = frequency.values
    _require_one_sweep(f)
    notes = [*notes, *map("not used: {}".format, columns.problems)]
    if columns.complex_columns:
        return _make_complex_response(frequency, columns, titles, notes)
    readings = _combine_columns(columns, f, shunt)
    reading = readings[0]
    used = (frequency, *reading.columns)
    remarks = [*notes, *filter(None, map(attrgetter("note"), used))]
    reference = DEFAULT_REFERENCE
    samples = reading.samples
    if reading.combination.shunt:
        assert shunt is not None
        samples, reference, remark = _convert_gain(samples, shunt)
        remarks.append(remark)
    elif reading.combination.quantity == "S":
        remarks.append(
            f"no reference resistance for the S parameters; {DEFAULT_REFERENCE:g} Ohm is assumed"
        )
    if "c" in reading.combination.columns:
        remarks.append(f"{reading.columns[0].title.text}: neither Cp nor Cs; Cp is assumed")
    texts = map(attrgetter("title.text"), used)
    summary = ", ".join(map(str, used)) + describe_unused(titles, texts)
    response = _make_response(f, reading.combination.quantity, samples, reference, remarks, summary)
    return replace(response, doubt=next(filter(None, map(attrgetter("doubt"), used)), ""))


def _require_one_sweep(f: np.ndarray) -> None:
    """Reject a table that contains several sweeps or unsorted frequencies.

    Sorted frequencies never decrease, or never increase. Rows with the frequency 0 are ignored.

    Raises
    ------
    UsageError : the table contains several sweeps.
    ValueError : the frequencies are not sorted.
    """
    (rows,) = np.nonzero(f)
    steps = np.diff(f[rows])
    if (steps >= 0).all() or (steps <= 0).all():
        return
    starts = rows[np.flatnonzero(steps * np.median(steps) < 0) + 1]
    if not starts.size or len(starts) > MAX_REVERSAL_SHARE * len(steps):
        raise ValueError("the values in the frequency column increase and decrease")
    ends = [*starts[:3], len(f)][:3]
    sweeps = [f"rows {a + 1} to {b}" for a, b in zip((0, *starts), ends, strict=False)]
    raise make_ambiguity_error(f"{len(starts) + 1} sweeps in one table", sweeps, ONE_PART_HINT)


def classify_columns(titles: Sequence[str], numbers: Sequence[np.ndarray]) -> ClassifiedColumns:
    """Classify the columns of a table by the meaning of their titles."""
    result = ClassifiedColumns({}, [], [], [])
    for text, values in zip(titles, numbers, strict=True):
        try:
            if np.iscomplexobj(values):
                kind = find_complex_quantity(text)
                if kind is not None:
                    result.complex_columns.append((text.strip(), kind[0], kind[1] * values))
                else:
                    result.unknown.append(text.strip())
                continue
            title = read_title(text)
            column = None if title is None else convert_column(title, values)
        except ValueError as error:
            result.problems.append(error)
            continue
        if column is None:
            result.unknown.append(text.strip())
        else:
            result.by_quantity.setdefault(column.title.meaning.quantity, []).append(column)
    return result


def _require_two_value_columns(
    numbers: Sequence[np.ndarray], header: str, unknown: Sequence[str] = ()
) -> None:
    """Reject a table with a frequency and only one column of real values.

    ``unknown`` are titles without a known meaning.

    Raises
    ------
    UsageError : the table has two columns of real numbers.
    """
    if len(numbers) == 2 and not any(map(np.iscomplexobj, numbers)):
        raise UsageError(
            "this table contains only one column of values beside the frequency, and an impedance "
            f"needs two{_describe_unknown_columns(unknown)}",
            got=f"2 columns in total: {header[:MAX_HEADER_LENGTH] or 'without titles'}",
            expected="a frequency and two columns of impedance, admittance or reflection",
            hint="export the table again with a second column of values: the phase or "
            "the imaginary part; " + NAME_COLUMNS_HINT,
        )


def _require_complete(
    titles: Sequence[str], columns: ClassifiedColumns, shunt: float | None
) -> None:
    """Raise an error unless the columns determine an impedance at known frequencies.

    A gain determines an impedance only if the resistance of the ``shunt`` is given.
    """
    names = set(columns.by_quantity)
    complete = [c for c in COMBINATIONS if set(c.columns) <= names]
    gains = list(filter(attrgetter("shunt"), complete))
    if shunt is not None and not gains:
        raise UsageError(
            "this option applies only to a table of gain and phase",
            where="--shunt",
            got=f"columns {', '.join(t.strip() for t in titles[:5])}",
            expected="columns such as  Frequency (Hz), Gain (dB), Phase (deg)",
            hint="leave out --shunt",
        )
    usable = columns.complex_columns or shunt is not None or len(complete) > len(gains)
    if "f" in names and usable:
        return
    if "f" in names and gains:
        column = columns.by_quantity[gains[0].columns[0]][0]
        raise UsageError(
            "a table of gain and phase needs the resistance of the shunt, which is missing",
            got=str(column),
            expected="the resistance of the shunt, which is the resistor in series with the part",
            hint="add for example  --shunt '100 Ohm'",
        )
    raise _make_incomplete_error(titles, columns)


def _make_incomplete_error(titles: Sequence[str], columns: ClassifiedColumns) -> Exception:
    """Make the error for columns that do not determine an impedance."""
    if columns.problems:
        return _make_title_error(columns.problems, columns.unknown)
    for text in columns.unknown:
        meaning = UNSTATED_QUANTITIES.get("".join(text.lower().split()))
        if meaning is not None:
            got = f"the column {text!r} states neither quantity nor unit"
            return make_ambiguity_error(got, meaning.split("; or "), NAME_COLUMNS_HINT)
    if SOUND_QUANTITY in columns.by_quantity:
        title = columns.by_quantity[SOUND_QUANTITY][0].title.text
        return ValueError(f"column {title!r} is a sound pressure, not an electrical quantity")
    if {"f"} < set(columns.by_quantity) and not columns.unknown:
        raise _make_half_impedance_error(titles, columns)
    missing_quantity = "complete impedance" if "f" in columns.by_quantity else "frequency"
    names = ", ".join(titles[:5])
    names = names if len(names) <= MAX_TITLE_LENGTH else f"{names[:MAX_TITLE_LENGTH]}…"
    unknown = _describe_unknown_columns(columns.unknown)
    return ValueError(f"the columns {names} contain no {missing_quantity}{unknown}")


def _describe_unknown_columns(unknown: Sequence[str]) -> str:
    """Describe the columns with unknown titles, for the end of an error message."""
    listed = ", ".join(map(repr, unknown[:MAX_CANDIDATES]))
    return f"; unknown columns: {listed}" if listed else ""


def _make_title_error(problems: Sequence[ValueError], unknown: Sequence[str]) -> Exception:
    """Make the error about titles; if several titles lack a unit, name all of them.

    ``unknown`` are titles without a known meaning.
    """
    lacking = [item for item in problems if isinstance(item, MissingUnitError)]
    if len(lacking) == len(problems) == 1 and unknown:
        message = f"{lacking[0]}{_describe_unknown_columns(unknown)}"
        return ColumnTitleError(message, NAME_COLUMNS_HINT)
    if len(lacking) < 2 or len(lacking) < len(problems):
        return problems[0]
    units = " and ".join(dict.fromkeys(item.unit for item in lacking))
    titles = "  and  ".join(item.corrected_title for item in lacking)
    return UsageError(
        "the titles of several columns need a unit, because a title without a unit does not "
        "identify the quantity",
        got=f"columns {', '.join(repr(item.title) for item in lacking[:MAX_CANDIDATES])}",
        expected="; ".join(
            f"{item.title}: {' or '.join(item.choices)}" for item in lacking[:MAX_CANDIDATES]
        ),
        hint=f"if the values are in {units}, write the titles  {titles}",
    )


def _make_half_impedance_error(titles: Sequence[str], columns: ClassifiedColumns) -> UsageError:
    """Make the error for a table with only one of the two columns of an impedance."""
    names = set(columns.by_quantity) - {"f"}
    shared = [item for item in COMBINATIONS if names & set(item.columns)]
    partners = dict.fromkeys(chain.from_iterable(item.columns for item in shared))
    labels = QUANTITY_LABELS | {"x": "X (the imaginary part of Z)", "r": "R (the real part of Z)"}
    lacking = [labels.get(name, name) for name in partners if name not in names]
    listed = ", ".join(title.strip() for title in titles[:5])
    return UsageError(
        "this table contains only one half of a complex impedance",
        got=f"columns {listed}",
        expected=f"a second column: {list_candidates('', lacking)}",
        hint=f"export the table again with a column of {lacking[0]}",
    )


def _select_agreeing_column(quantity: str, candidates: Sequence[Column]) -> Column:
    """Return the first of several columns of a quantity; reject columns that differ.

    Raises
    ------
    UsageError : the values of columns of the same quantity differ by more than
        :data:`AGREEMENT_LIMIT`.
    """
    first, *others = candidates
    for other in others:
        if _compute_relative_difference(other.values, first.values) > AGREEMENT_LIMIT:
            label = f"two columns of {QUANTITY_LABELS.get(quantity, quantity)}"
            raise make_ambiguity_error(label, (str(first), str(other)), ONE_PART_HINT)
    return first


def _select_column_pair(
    combination: ColumnCombination, columns: ClassifiedColumns
) -> tuple[Column, Column]:
    """Select the two table columns that together determine a complex quantity.

    An example of such a combination is the resistance and the reactance of an impedance. If several
    columns contain the first quantity, the function selects the column whose title names the
    measuring channel of the second quantity.

    Raises
    ------
    UsageError : several columns of one quantity differ, and their titles do not contain channels
        that show which columns belong together.
    """
    first, second = combination.columns
    sizes, others = columns.by_quantity[first], columns.by_quantity[second]
    channel = _find_channel(others[0])
    if len(sizes) > 1 and len(others) == 1 and channel:
        same = [column for column in sizes if _find_channel(column) == channel]
        sizes = same if len(same) == 1 else sizes
    return _select_agreeing_column(first, sizes), _select_agreeing_column(second, others)


def _find_channel(column: Column) -> str:
    """Return the measuring channel in the title of a column, such as ``channel 2``.

    Return an empty string if the title contains no channel.
    """
    match = CHANNEL_PATTERN.search(column.title.text)
    return match[0].lower() if match else ""


def _compute_relative_difference(a: np.ndarray, b: np.ndarray) -> float:
    """Return the median relative difference between two arrays.

    The differences are relative to ``b``. Points at which a value is zero or not finite are
    omitted.
    """
    with np.errstate(all="ignore"):
        ratio = np.abs(a / b - 1)
    ratio = ratio[np.isfinite(ratio) & (b != 0) & (a != 0)]
    return float(np.median(ratio)) if ratio.size else 0.0


def _combine_columns(
    columns: ClassifiedColumns, f: np.ndarray, shunt: float | None
) -> list[_ColumnPair]:
    """Compute the complex response from each column pair; reject contradictory pairs.

    Return one pair of columns for each representation of the response in the table, such as
    magnitude and phase.

    Raises
    ------
    UsageError : two combinations of columns give different responses.
    """
    names, readings = set(columns.by_quantity), list[_ColumnPair]()
    phases = {"z": "phase_z", "y": "phase_y"} if shunt is None else {"gain": "gain_phase"}
    # quantity whose phase a column with the title `phase` contains
    size = next(filter(names.__contains__, phases), None)
    for combination in COMBINATIONS:
        first, second = combination.columns
        if combination.shunt != (shunt is not None) or not {first, second} <= names:
            continue
        if second == "phase" and (first != size or phases[first] in names):
            continue
        pair = _select_column_pair(combination, columns)
        samples = combination.value(pair[0].values, pair[1].values, 2 * np.pi * f)
        readings.append(_ColumnPair(combination, pair, samples))
    best = readings[0]
    for other in readings[1:]:
        if (
            _compute_relative_difference(_compute_admittance(other), _compute_admittance(best))
            > AGREEMENT_LIMIT
        ):
            got = f"columns that differ, first at {f[0]:g} Hz"
            hint = "check the units of these columns, or delete the wrong columns"
            raise make_ambiguity_error(got, (str(best), str(other)), hint)
    return readings


def _compute_admittance(reading: _ColumnPair) -> np.ndarray:
    """Compute the admittance of a response from two columns.

    S parameters have the default reference resistance.
    """
    x = reading.samples
    if reading.combination.quantity == "Y":
        return x
    return 1 / x if reading.combination.quantity == "Z" else (1 - x) / (1 + x) / DEFAULT_REFERENCE


def _convert_gain(gain: np.ndarray, shunt: float) -> tuple[np.ndarray, float, str]:
    """Convert a gain (shunt voltage per source voltage) to a reflection coefficient.

    Return the reflection coefficient, its reference resistance [Ohm], and a note that describes the
    measured gain.
    """
    inverse = bool(np.median(np.abs(gain)) > 1)
    ratio = (
        "source voltage divided by shunt voltage"
        if inverse
        else "shunt voltage divided by source voltage"
    )
    gain = 1 / gain if inverse else gain
    note = f"gain: {ratio}, with a shunt of {shunt:g} Ohm in series with the part"
    return 1 - 2 * gain, shunt, note


def _make_complex_response(
    frequency: Column, columns: ClassifiedColumns, titles: Sequence[str], notes: Sequence[str]
) -> MeasuredResponse:
    """Make the response of a table that contains one column of complex numbers."""
    text, quantity, samples = columns.complex_columns[0]
    if len(columns.complex_columns) > 1:
        readings = [f"{kind} from {name!r}" for name, kind, _ in columns.complex_columns]
        raise make_ambiguity_error("two columns of complex numbers", readings, ONE_PART_HINT)
    remarks = [*notes, frequency.note] if frequency.note else list(notes)
    if quantity == "S":
        remarks.append(
            f"no reference resistance for the S parameters; {DEFAULT_REFERENCE:g} Ohm is assumed"
        )
    elif "(" in text or "_" in text:
        remarks.append(
            f"{text}: complex numbers, read as {quantity} in the unit given in the column title"
        )
    else:
        unit = DEFAULT_UNITS["impedance" if quantity == "Z" else "admittance"]
        remarks.append(f"{text}: the unit {unit} is assumed")
    summary = f"{frequency}, {quantity} from {text!r}"
    summary += describe_unused(titles, (text, frequency.title.text))
    return _make_response(frequency.values, quantity, samples, DEFAULT_REFERENCE, remarks, summary)


def describe_unused(titles: Sequence[str], used: Iterable[str]) -> str:
    """Return a list of the unused column titles as a string, for messages.

    The string is empty if all titles are used.
    """
    names = set(map(str.strip, used))
    unused = [title for title in map(str.strip, titles) if title and title not in names]
    return f"; not used: {', '.join(unused)}" if unused else ""


def _make_response(
    f: np.ndarray,
    quantity: Quantity,
    samples: np.ndarray,
    reference: float,
    notes: Sequence[str],
    summary: str,
) -> MeasuredResponse:
    """Make the response of a one-port part from samples of S, Z or Y.

    Samples at frequency zero are omitted.
    """
    f, samples = f[f != 0], samples[f != 0]
    matrix, z0 = samples[:, None, None], np.array([reference])
    Y = convert_to_admittance(quantity, matrix, z0)
    return MeasuredResponse(f, quantity, matrix, Y, z0, tuple(notes), summary)
