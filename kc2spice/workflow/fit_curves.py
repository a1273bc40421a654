"""Measured curves of one part under several conditions, such as weights on a cone.

A TOML file lists the curves. Each entry contains a data file, and the values of scene keys that
apply only to its measurement.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ConfigDict, Field

from kc2spice.bodies.readers.measured_admittance import MeasuredAdmittance, read_measured
from kc2spice.core.errors import UsageError
from kc2spice.core.key_errors import validate_table
from kc2spice.core.quantities import Frequency, Section
from kc2spice.core.toml_errors import parse_toml_file
from kc2spice.core.untrusted_files import read_bounded

MAX_BYTES = 1_000_000  # largest size [bytes] of a file with a list of curves
MIN_POINTS = 4  # number of frequencies that a curve must at least have within its band
EXAMPLE = '[[curve]]  file = "weighted.zma"  set = { "speaker.added_mass" = "8 g" }'


class MeasurementKeys(Section):
    """Keys of one ``[[curve]]`` table: data file, band, and values of scene keys."""

    model_config = ConfigDict(arbitrary_types_allowed=True)

    file: str | Path | MeasuredAdmittance = Field(
        description="File of the measured impedance curve"
    )
    set: dict[str, Any] = Field(
        {},
        description=(
            "Values of scene keys that apply only to this measurement, written as for the "
            "option --set"
        ),
    )
    band: tuple[Frequency, Frequency] | None = Field(
        None,
        description=(
            "Lowest and highest frequency of the measured curve that the fit uses; by "
            "default all frequencies"
        ),
    )
    predict: bool = Field(
        False,
        description=(
            "Whether the measured curve is only compared with the fitted model, and not used "
            "for the fit"
        ),
    )


class MeasurementListKeys(Section):
    """Keys of a TOML file that lists all measured curves of a fit."""

    curve: list[MeasurementKeys] = Field(
        min_length=1,
        description="Measured curves that are fitted together: one table for each curve",
    )


@dataclass(frozen=True, eq=False)
class MeasuredCurve:
    """Measured admittance, and overrides of scene keys that describe its measurement.

    With ``predict``, the curve is compared with the fit, but not fitted.
    """

    data: MeasuredAdmittance
    overrides: Mapping[str, Any] = field(default_factory=dict)
    predict: bool = False

    @property
    def Y(self) -> np.ndarray:
        """Measured admittance [S] at each frequency."""
        return self.data.Y[:, 0, 0]


def read_curves(
    data: Path | str | Sequence[Mapping[str, Any]], shunt: float | None = None
) -> list[MeasuredCurve]:
    """Read curves from a TOML file, or from a list of ``[[curve]]`` tables.

    Parameters
    ----------
    data : Path, str or sequence of mapping
        A TOML file with tables ``[[curve]]``, whose data files are relative to the TOML file; or a
        list of these tables.
    shunt : float, optional
        Resistance [Ohm] in series with the part, for files of gain and phase.

    Raises
    ------
    UsageError : the file is missing or damaged, an entry has unknown keys, or every entry contains
        ``predict = true``.
    """
    if isinstance(data, (str, Path)):
        where, folder = str(data), Path(data).parent
        try:
            text = read_bounded(Path(data), MAX_BYTES).decode()
        except (OSError, ValueError) as error:
            raise UsageError(
                "this file cannot be read",
                where=where,
                got=str(error),
                expected=f"a TOML file of at most {MAX_BYTES} bytes with tables [[curve]]",
                hint=f"write for example  {EXAMPLE}",
            ) from None
        tables: Mapping[str, Any] = parse_toml_file(text, where, ("curve",))
    else:
        where, folder, tables = "data", Path(), {"curve": list(data)}
    entries = validate_table(MeasurementListKeys, tables, f"{where}:").curve
    curves = list(_read_curve_tables(entries, folder, where, shunt))
    if all(curve.predict for curve in curves):
        raise UsageError(
            "all curves are predicted, and none is fitted",
            where=where,
            got="predict = true in each entry",
            expected="at least one curve without predict",
            hint="delete predict = true from one entry",
        )
    return curves


def _read_curve_tables(
    entries: Sequence[MeasurementKeys], folder: Path, where: str, shunt: float | None
) -> Iterator[MeasuredCurve]:
    """Yield the measured curve of each ``[[curve]]`` table, limited to its band."""
    for k, entry in enumerate(entries):
        file = entry.file
        measured = (
            file if isinstance(file, MeasuredAdmittance) else read_measured(folder / file, shunt)
        )
        if entry.band is not None:
            measured = _select_band(measured, entry.band, f"{where}: curve[{k}].band")
        yield MeasuredCurve(measured, entry.set, entry.predict)


def _select_band(
    measured: MeasuredAdmittance, band: tuple[float, float], where: str
) -> MeasuredAdmittance:
    """Return a measured curve, limited to a frequency band [Hz]."""
    inside = (measured.f >= band[0]) & (measured.f <= band[1])
    if inside.sum() < MIN_POINTS:
        low, high = measured.f[0], measured.f[-1]
        raise UsageError(
            "this band contains too few frequencies of the curve",
            where=where,
            got=f"{band[0]:g} to {band[1]:g} Hz with {inside.sum()} frequencies",
            expected=f"at least {MIN_POINTS} frequencies between {low:g} and {high:g} Hz",
            hint="write a wider band, the lower frequency first",
        )
    samples = None if measured.samples is None else measured.samples[inside]
    return replace(measured, f=measured.f[inside], Y=measured.Y[inside], samples=samples)
