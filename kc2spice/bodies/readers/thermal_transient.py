"""Thermal transients from tables: temperature or thermal impedance over time.

A table has a column of times and a column of one of the :data:`TRANSIENT_QUANTITIES` in
:mod:`kc2spice.bodies.readers.meanings`. The power is switched on or off at the time zero. The input
is the path of a table, and the output is a :class:`ThermalTransient`, to which
:mod:`kc2spice.rom.transient_fit` fits a network.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from kc2spice.bodies.readers.complex_response import (
    ONE_PART_HINT,
    classify_columns,
    describe_unused,
    make_ambiguity_error,
)
from kc2spice.bodies.readers.meanings import TRANSIENT_QUANTITIES
from kc2spice.bodies.readers.measured import is_table, load_tables
from kc2spice.bodies.readers.raw import call_reader, is_file, make_unusable_error
from kc2spice.bodies.readers.text_table import TextTable
from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import UsageError

# Smallest number of times after the step, for two time constants with their resistances and for an
# estimate of the noise.
MIN_TIMES = 8
NAME_TIME_HINT = "name the columns in the first line, such as  time_s,temperature_k"
EXPECTED_TABLE = "a table with a time and a temperature or a thermal impedance Zth"


@dataclass(frozen=True, eq=False)
class ThermalTransient(EqualByContent):
    """Temperatures [K] or thermal impedances [K/W] (n,) at increasing times (n,) [s].

    ``quantity`` is ``"temperature"`` or ``"zth"``. ``notes`` are assumptions that the reader made,
    and ``columns`` the columns that it used.
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
        """Text with the columns, the number of points and the range of times."""
        span = f"{len(self.time)} points from {self.time[0]:.6g} to {self.time[-1]:.6g} s"
        return f"{self.columns}; {span}"


def is_transient(path: Path) -> bool:
    """Return whether a file is a table with a column of times and none of frequencies."""
    if not is_table(path) or not is_file(path):
        return False
    try:
        return call_reader(path, EXPECTED_TABLE, lambda: any(map(_has_time, load_tables(path))))
    except UsageError:  # the reader of responses reports this error
        return False


def read_transient(path: Path) -> ThermalTransient:
    """Read the transient of a table.

    Raises
    ------
    UsageError : the table has no temperature, two different temperatures, too few times, or numbers
        that are not finite.
    """

    def read_response() -> ThermalTransient:
        table = next(filter(_has_time, load_tables(path)))
        return _find_transient(table, path)

    result = call_reader(path, EXPECTED_TABLE, read_response, NAME_TIME_HINT)
    if not (np.isfinite(result.time).all() and np.isfinite(result.value).all()):
        raise make_unusable_error(path, "NaN or infinity", "finite numbers", NAME_TIME_HINT)
    count = len(np.unique(result.time[result.time > 0]))
    if count < MIN_TIMES:
        hint = "the time counts from the step of the power; measure more points after it"
        raise make_unusable_error(
            path, f"{count} times after zero", f"at least {MIN_TIMES} of them", hint
        )
    return result


def _has_time(table: TextTable) -> bool:
    """Return whether a table has a column of times."""
    if table.titles is None:
        return False
    quantities = classify_columns(table.titles, table.numbers).by_quantity
    return "time" in quantities and "f" not in quantities


def _find_transient(table: TextTable, path: Path) -> ThermalTransient:
    """Find the columns of the time and of the temperature or thermal impedance in a table."""
    titles = table.titles or ()
    by_quantity = classify_columns(titles, table.numbers).by_quantity
    times = by_quantity["time"]
    values = [column for name in TRANSIENT_QUANTITIES for column in by_quantity.get(name, ())]
    if not values:
        names = ", ".join(map(repr, map(str.strip, titles)))
        raise ValueError(f"a time, but neither a temperature nor a Zth, in the columns {names}")
    for label, found in (("times", times), ("columns of a thermal transient", values)):
        if any(not np.array_equal(found[0].values, other.values) for other in found[1:]):
            raise make_ambiguity_error(
                f"{len(found)} {label}", list(map(str, found)), ONE_PART_HINT
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
