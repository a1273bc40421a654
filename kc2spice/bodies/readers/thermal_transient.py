"""Reader of thermal transients: temperature or thermal impedance versus time.

A table has a column of times and a column of one of the :data:`TRANSIENT_QUANTITIES` in
:mod:`kc2spice.bodies.readers.column_kinds`. The heating power is switched on or off at the time
zero. The input is the path of a table, and the output is a :class:`ThermalTransient`. The module
:mod:`kc2spice.rom.transient_fit` fits a network to the transient.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from kc2spice.bodies.readers.column_kinds import TRANSIENT_QUANTITIES
from kc2spice.bodies.readers.complex_response import (
    ONE_PART_HINT,
    classify_columns,
    describe_unused,
    make_ambiguity_error,
)
from kc2spice.bodies.readers.measured_admittance import is_table, load_tables
from kc2spice.bodies.readers.raw_matrices import call_reader, is_file, make_unusable_file_error
from kc2spice.bodies.readers.text_table import TextTable
from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import UsageError

# Smallest number of instants after the power step.
# Eight instants suffice to estimate two time constants, two resistances and the noise.
MIN_TIMES = 8
NAME_TIME_HINT = "name the columns in the first line, such as  time_s,temperature_k"
EXPECTED_TABLE = "a table with a time and a temperature or a thermal impedance Zth"


@dataclass(frozen=True, eq=False)
class ThermalTransient(EqualByContent):
    """Measured thermal step response: temperature or thermal impedance over time.

    ``quantity`` is ``"temperature"`` or ``"zth"``. ``value`` contains the temperatures [K] or the
    thermal impedances [K/W] at the increasing times ``time`` [s]; both arrays have the shape (n,).
    ``notes`` are assumptions of the reader, and ``columns`` describes the columns that the reader
    used.
    """

    name: str
    where: str
    quantity: Literal["temperature", "zth"]
    time: np.ndarray
    value: np.ndarray
    notes: tuple[str, ...] = ()
    columns: str = ""

    @property
    def description(self) -> str:
        """Description of the columns, point count and time range, for messages."""
        span = f"{len(self.time)} points from {self.time[0]:.6g} to {self.time[-1]:.6g} s"
        return f"{self.columns}; {span}"


def is_transient(path: Path) -> bool:
    """Return whether a file contains a table with a time but no frequency column."""
    if not is_table(path) or not is_file(path):
        return False
    try:
        return call_reader(
            path, EXPECTED_TABLE, lambda: any(map(_has_time_column, load_tables(path)))
        )
    except UsageError:  # the reader of frequency responses will report that the table is faulty
        return False


def read_transient(path: Path) -> ThermalTransient:
    """Read a thermal transient from a table file, and check its values.

    Raises
    ------
    UsageError : the table has no column of a temperature or thermal impedance, two different such
        columns, too few time points, or numbers that are not finite.
    """

    def read_response() -> ThermalTransient:
        """Read the first table with a time column as a thermal transient."""
        table = next(filter(_has_time_column, load_tables(path)))
        return _find_transient(table, path)

    result = call_reader(path, EXPECTED_TABLE, read_response, NAME_TIME_HINT)
    if not (np.isfinite(result.time).all() and np.isfinite(result.value).all()):
        problem = "the file contains numbers that are not valid"
        raise make_unusable_file_error(
            path, "NaN or infinity", "finite numbers", NAME_TIME_HINT, problem
        )
    count = len(np.unique(result.time[result.time > 0]))
    if count < MIN_TIMES:
        hint = "measure more points after the power step, which must be at t = 0"
        got = f"{count} time points after zero"
        expected = f"at least {MIN_TIMES} time points after zero"
        problem = "the file contains too few time points"
        raise make_unusable_file_error(path, got, expected, hint, problem)
    return result


def _has_time_column(table: TextTable) -> bool:
    """Return whether a table has a time column and no frequency column."""
    if table.titles is None:
        return False
    quantities = classify_columns(table.titles, table.numbers).by_quantity
    return "time" in quantities and "f" not in quantities


def _find_transient(table: TextTable, path: Path) -> ThermalTransient:
    """Return the thermal transient that a table contains.

    The table contains a time column and a column of a temperature or thermal impedance.
    """
    titles = table.titles or ()
    by_quantity = classify_columns(titles, table.numbers).by_quantity
    times = by_quantity["time"]
    values = [column for name in TRANSIENT_QUANTITIES for column in by_quantity.get(name, ())]
    if not values:
        names = ", ".join(map(repr, map(str.strip, titles)))
        raise ValueError(
            f"the columns {names} contain neither a temperature nor a thermal impedance Zth"
        )
    for label, columns in (("time columns", times), ("columns of a thermal transient", values)):
        if any(not np.array_equal(columns[0].values, other.values) for other in columns[1:]):
            raise make_ambiguity_error(
                f"{len(columns)} {label}", list(map(str, columns)), ONE_PART_HINT
            )
    time, value = times[0], values[0]
    order = np.argsort(time.values, kind="stable")
    unused = describe_unused(titles, (time.title.text, value.title.text))
    return ThermalTransient(
        name=path.stem,
        where=str(path),
        quantity="zth" if value.title.meaning.quantity == "zth" else "temperature",
        time=time.values[order],
        value=value.values[order],
        notes=tuple(filter(None, (*table.notes, time.note, value.note))),
        columns=f"{time}, {value}{unused}",
    )
