"""Readers of measured responses in Touchstone files, tables and MATLAB files.

The columns of a table have titles, in any sequence (:mod:`kc2spice.bodies.readers.column_kinds`). A
table must contain a frequency column and two columns that determine an impedance, such as |Z| and
phase. Semicolons, tabs, commas or blanks separate the columns of a table. A comma that does not
separate columns is a decimal comma.

Real vectors in a MATLAB file are read like the columns of a table; the name of a variable is the
title of the column. A complex variable has the name ``z``, ``y`` or ``s``, and the shape (n,) or
(ports, ports, n) for n frequencies. The variable ``z0`` is the reference resistance of ``s``.
"""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import product
from pathlib import Path

import numpy as np

from kc2spice.bodies.readers.column_kinds import COMPLEX_NAMES, Quantity
from kc2spice.bodies.readers.column_titles import (
    convert_column,
    find_complex_quantity,
    is_frequency,
    read_title,
)
from kc2spice.bodies.readers.complex_response import (
    DEFAULT_REFERENCE,
    MIN_FREQUENCIES,
    NAME_COLUMNS_HINT,
    MeasuredResponse,
    combine_response,
    convert_to_admittance,
    find_response,
)
from kc2spice.bodies.readers.raw_matrices import (
    call_in_process,
    call_reader,
    is_file,
    make_missing_error,
    make_unusable_file_error,
    read_vectors,
)
from kc2spice.bodies.readers.text_table import ShortTableError, TextTable, read_tables
from kc2spice.bodies.readers.touchstone import parse_touchstone
from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import UsageError, join_first, wrong
from kc2spice.core.other_file_formats import (
    identify_binary_format,
    identify_format,
    identify_mesh,
    make_other_format_error,
    read_head,
)
from kc2spice.core.quantities import convert_quantity as parse_quantity
from kc2spice.core.untrusted_files import read_bounded
from kc2spice.rom.linear_model import Norm

MAX_BYTES = 20_000_000  # bytes, largest size of a text file
# Largest number of frequencies.
# No analyser measures more than 20 000 frequencies, and a fit to more would take hours.
MAX_FREQUENCIES = 20_000
# Largest magnitude of a negative conductance that counts as noise, relative to |Y|.
# A part is active if at least a tenth of the points exceed this limit.
ACTIVE_RATIO = 0.05
_TOUCHSTONE_SUFFIX = re.compile(r"\.(s(\d+)p|ts)", re.IGNORECASE)
TABLE_SUFFIXES = (".csv", ".txt", ".tsv", ".zma", ".frd", ".z", ".dta", ".mpt")
# names of the reference resistance in MATLAB files
_RESISTANCE_NAMES = ("z0", "r0", "zref", "reference")
_MATRIX_NAME = re.compile(r".*[._][MEKABCD]", re.DOTALL)  # name of a matrix file such as NAME_K.txt


@dataclass(frozen=True, eq=False)
class MeasuredAdmittance(EqualByContent):
    """Measured admittance of a part, and the samples from which Y was computed.

    ``Y`` is the admittance [S] at the frequencies ``f`` (n,) [Hz], an array of shape (n, ports,
    ports). ``samples`` are the values of the measured ``quantity`` ``"S"``, ``"Z"`` or ``"Y"``, an
    array of the same shape as ``Y``. ``samples`` is None if the measured values are the admittances
    ``Y`` themselves. ``reference`` (ports,) [Ohm] contains the reference resistances of S
    parameters. ``notes`` are assumptions of the reader, and ``columns`` describes the columns that
    the reader used. ``doubt`` describes a property of the data that suggests a wrong unit or
    format, and how to correct the file. If the data fit the stated unit and format, ``doubt`` is
    empty.
    """

    name: str
    where: str
    f: np.ndarray
    Y: np.ndarray
    notes: tuple[str, ...] = ()
    quantity: Quantity = "Y"
    samples: np.ndarray | None = None
    columns: str = ""
    reference: np.ndarray = field(default_factory=lambda: np.array([DEFAULT_REFERENCE]))
    doubt: str = ""

    @property
    def description(self) -> str:
        """Description of the columns, point count and frequency range, for messages."""
        span = f"{len(self.f)} points from {self.f[0]:.6g} to {self.f[-1]:.6g} Hz"
        return f"{self.columns}; {span}" if self.columns else span

    @property
    def estimated_noise(self) -> float:
        """Estimated noise of the samples: absolute for S, relative for Z and Y.

        Real and imaginary parts of the samples are assumed to have noise of equal standard
        deviation, which is returned.
        """
        x = self.Y if self.samples is None else self.samples
        x = x.reshape(len(self.f), -1)
        size = np.ones(x[1:-2].shape) if self.quantity == "S" else np.abs(x[1:-2])
        steps = np.diff(x, 3, axis=0)[size > 0] / size[size > 0]
        return float(np.median(np.abs(np.r_[steps.real, steps.imag])) / (0.6745 * np.sqrt(20)))

    @cached_property
    def admittance_noise(self) -> np.ndarray:
        """Standard deviation [S] of the noise in the real and imaginary part of each Y_ij.

        The returned array of standard deviations [S] has the shape (n, ports, ports). The noise of
        Y is the first-order effect of independent noise in the measured entries. For measured
        impedances Z, ``dY = -Y dZ Y``. For measured scattering parameters S with the diagonal
        matrix R of reference resistances::

            R^(1/2) dY R^(1/2) = -2 (1 + S)^-1 dS (1 + S)^-1,
            (1 + S)^-1 = (1 + R^(1/2) Y R^(1/2)) / 2.
        """
        noise, one = self.estimated_noise, np.eye(self.Y.shape[1])
        if self.quantity == "Y" or self.samples is None:
            return noise * np.abs(self.Y)
        if self.quantity == "Z":
            left, size = self.Y, np.abs(self.samples) ** 2
            variance = np.abs(left) ** 2 @ size @ np.abs(left) ** 2
            return np.asarray(noise * np.sqrt(variance))
        root = np.sqrt(self.reference)
        wave = 0.5 * (one + root[:, None] * self.Y * root)
        rows, columns = np.linalg.norm(wave, axis=2), np.linalg.norm(wave, axis=1)
        return np.asarray(2 * noise * rows[:, :, None] * columns[:, None] / np.outer(root, root))

    @property
    def noise(self) -> float:
        """Median of the relative noise of all nonzero entries of the admittance Y.

        The noise is a standard deviation relative to the magnitude of each entry of Y.
        """
        size = np.abs(self.Y)
        return float(np.median(self.admittance_noise[size > 0] / size[size > 0]))

    def compute_relative_noise(self, norm: Norm) -> float:
        """Return the rms noise of Y, relative to its pointwise or peak magnitude.

        In the norm *pointwise*, the noise of an entry of Y at each frequency is divided by the
        magnitude of the entry at this frequency. In the norm *peak*, the noise of an entry of Y is
        divided by the largest magnitude that the entry reaches at any frequency. The returned
        number is the noise of the entry with the largest noise.
        """
        size = np.abs(self.Y)
        size = np.broadcast_to(size.max(axis=0), size.shape) if norm == "peak" else size
        share = np.where(size > 0, self.admittance_noise / np.where(size > 0, size, 1.0), 0.0)
        return float(np.sqrt(2 * np.mean(share**2, axis=0)).max())


def is_measured(path: Path) -> bool:
    """Return whether a file contains a measured response.

    Only the name of the file is checked. In a ``.mat`` file, the names of the variables are checked
    instead: one of them must be the frequency.
    """
    by_suffix = _TOUCHSTONE_SUFFIX.fullmatch(path.suffix) or is_table(path)
    if path.suffix.lower() == ".mat" and is_file(path):
        try:
            return any(map(is_frequency, _load_variables(path, path.stat().st_mtime)))
        except (ValueError, NotImplementedError):  # the reader of matrix files reports this error
            return False
    return bool(by_suffix) and is_file(path)


def is_table(path: Path) -> bool:
    """Return whether a file name denotes a table of measured data, not a matrix file."""
    return path.suffix.lower() in TABLE_SUFFIXES and not _MATRIX_NAME.fullmatch(path.stem)


def read_measured(path: Path, shunt: float | None = None) -> MeasuredAdmittance:
    """Read the measured response in a Touchstone file, a table or a MATLAB file.

    If the file contains a gain, ``shunt`` [Ohm] is the series resistor across which the voltage was
    measured.

    Raises
    ------
    UsageError : the file is missing, damaged or too large, contains too few points or no known
        columns, or is the response of an active part, a short circuit or an open circuit.
    """
    match = _TOUCHSTONE_SUFFIX.fullmatch(path.suffix)
    expected = "a table with a frequency and two columns of impedance, admittance or reflection"
    advice = NAME_COLUMNS_HINT
    if match:
        expected = "a Touchstone file with S, Y or Z parameters in RI, MA or DB"
        advice = "export the file again as Touchstone"
    elif path.suffix.lower() == ".mat":
        advice = "save vectors with names such as  frequency_hz, real_ohm, imag_ohm"

    if not is_file(path):
        raise make_missing_error(path, expected, () if match else TABLE_SUFFIXES)

    head = read_head(path)
    if (name := identify_binary_format(head, path.suffix) or identify_mesh(head)) is not None:
        raise make_other_format_error(path, name, "measurement", expected)

    def read() -> MeasuredResponse:
        """Read the response with the parser of the file's format."""
        if path.suffix.lower() == ".mat":
            return _read_matlab(_load_variables(path, path.stat().st_mtime), shunt)
        if match:
            text = _read_text(path)
            _reject_shunt(shunt, "a Touchstone file")
            return parse_touchstone(text, int(match[2] or 0))
        try:
            tables = load_tables(path)
        except ShortTableError:
            if (name := identify_format(head, path.suffix)) is None:
                raise
            raise make_other_format_error(path, name, "measurement", expected) from None
        return find_response(tables, shunt, path.suffix.lower())

    with np.errstate(all="ignore"):  # values that are not finite are rejected later
        response = call_reader(path, expected, read, advice)
    f, Y = response.f, response.Y
    if not (np.isfinite(f).all() and np.isfinite(Y).all() and f.min(initial=1.0) >= 0):
        got = "NaN, infinity, an impedance of zero or a frequency below zero"
        problem = "the file contains numbers that are not valid"
        raise make_unusable_file_error(path, got, "finite numbers", NAME_COLUMNS_HINT, problem)
    f, order = np.unique(f, return_index=True)  # increasing frequencies without repetitions
    order = order[f > 0]
    if not len(order):
        hint = "export the file again with rows of numbers"
        problem, expected = (
            "the file contains no measured values",
            f"at least {MIN_FREQUENCIES} rows of numbers",
        )
        raise make_unusable_file_error(path, "no numbers", expected, hint, problem)
    if len(order) < MIN_FREQUENCIES:
        got, expected = f"{len(order)} frequencies", f"at least {MIN_FREQUENCIES} frequencies"
        hint = "export a measurement with more points"
        problem = "the file contains too few frequencies"
        raise make_unusable_file_error(path, got, expected, hint, problem)
    result = MeasuredAdmittance(
        name=path.stem,
        where=str(path),
        f=response.f[order],
        Y=Y[order],
        notes=(*response.notes, response.doubt) if response.doubt else response.notes,
        doubt=response.doubt,
        quantity=response.quantity,
        samples=response.samples[order],
        reference=response.reference,
        columns=response.columns,
    )
    if len(order) > MAX_FREQUENCIES:
        hint = "leave out points between resonances"
        got, expected = f"{len(order)} frequencies", f"at most {MAX_FREQUENCIES} frequencies"
        problem = "the file contains too many frequencies"
        raise make_unusable_file_error(path, got, expected, hint, problem)
    _reject_open_circuits(result)
    _reject_active_parts(result)
    return result


def parse_shunt_resistance(shunt: str | float | None) -> float | None:
    """Parse the resistance [Ohm] that is the argument of the option ``--shunt``.

    Return None if the option is missing.

    Raises
    ------
    UsageError : the argument is not a positive resistance.
    """
    if shunt is None:
        return None
    resistance = parse_quantity(shunt, "Ohm", where="--shunt")
    if resistance <= 0:
        raise UsageError(
            "this value is not a resistance",
            where="--shunt",
            got=shunt,
            expected='a positive resistance, such as "100 Ohm"',
            hint="remove the minus sign" if resistance < 0 else "leave out --shunt",
        )
    return resistance


def load_tables(path: Path) -> Sequence[TextTable]:
    """Read all tables in a file of measured data, with the longest table first.

    Raises
    ------
    ValueError : the file is too large, or
        :func:`kc2spice.bodies.readers.text_table.read_tables` rejects its text.
    """
    return _parse_tables(_read_text(path))


# The tables of the last file are cached, because several readers parse the same text.
@lru_cache(maxsize=1)
def _parse_tables(text: str) -> Sequence[TextTable]:
    """Parse the tables in the text of a file; only the latest result is cached."""
    return tuple(read_tables(text))


def _read_text(path: Path) -> str:
    """Read the text of a file.

    The encoding is UTF-8, UTF-16 with a byte order mark, or Latin-1.
    """
    data = read_bounded(path, MAX_BYTES)
    if data[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return data.decode("utf-16")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def _reject_shunt(shunt: float | None, content: str) -> None:
    """Reject the option ``--shunt`` for a file that contains no gain.

    ``content`` describes the file in the error message.
    """
    if shunt is None:
        return
    raise UsageError(
        "this option applies only to a table of gain and phase",
        where="--shunt",
        got=content,
        expected="columns such as  Frequency (Hz), Gain (dB), Phase (deg)",
        hint="leave out --shunt",
    )


def _reject_open_circuits(data: MeasuredAdmittance) -> None:
    """Reject a response with an open circuit, that is with zero admittance.

    A fit divides errors by the admittance. For a part with one port, errors are divided by the
    admittance at each frequency. For a part with several ports, errors are divided by the largest
    admittance of each port.
    """
    still = np.einsum("fii->fi", data.Y) == 0
    one = still.shape[1] == 1
    still = still[:, 0] if one else still.all(axis=0)
    if not still.any():
        return
    first, of = int(np.argmax(still)), f"{still.sum()} of {len(still)}"
    got = f"zero current at {of} frequencies, first at {data.f[first]:g} Hz"
    if not one:
        got = f"zero current at all frequencies into {of} ports, for example into port {first + 1}"
    raise wrong(
        data.where,
        "the measured part is an open circuit",
        got=got,
        expected="admittances that are not zero",
        hint="delete these frequencies from the file, or measure with the part connected",
    )


def _reject_active_parts(data: MeasuredAdmittance) -> None:
    """Reject the response of an active part, which delivers power.

    The conductance matrix of such a response has negative eigenvalues that exceed the noise. The
    conductance matrix is the Hermitian part of Y. Negative eigenvalues that exceed the noise are
    accepted if they occur at less than a tenth of the frequencies.
    """
    size = np.linalg.norm(data.Y, 2, axis=(1, 2))
    least = np.linalg.eigvalsh(0.5 * (data.Y + data.Y.conj().swapaxes(1, 2)))[:, 0]
    bad = least < -max(ACTIVE_RATIO, 5 * data.noise) * size
    if np.mean(bad) < 0.1:
        return
    hint = "check the order of the columns and the sign of the phase"
    if data.quantity == "S" and data.samples is not None:
        largest = np.linalg.norm(data.samples, 2, axis=(1, 2)).max()
        hint = f"calibrate the analyser: |S| is up to {largest:.4g}, above 1"
    elif data.Y.shape[1] == 1 and (data.Y.imag[bad] > 0).mean() < 0.5:
        hint = "swap the columns of real and imaginary part, which seem to be interchanged"
    got = f"a real part below zero at {bad.sum()} of {len(bad)} frequencies, "
    got += f"first at {data.f[bad][0]:g} Hz"
    raise wrong(
        data.where,
        "the measured part delivers power, so it is not passive",
        got=got,
        expected="Re Z >= 0, except for noise",
        hint=hint,
    )


@lru_cache(maxsize=1)
def _load_variables(path: Path, changed: float) -> dict[str, np.ndarray]:
    """Load the numeric arrays of a MATLAB file with a measured response.

    The time ``changed`` of the last change to the file is a part of the cache key.
    """
    return call_in_process(read_vectors, path)


def _read_matlab(variables: dict[str, np.ndarray], shunt: float | None) -> MeasuredResponse:
    """Convert the arrays in a MATLAB file to a frequency response.

    The file contains real vectors or one complex array.
    """
    first = next(filter(is_frequency, variables), None)
    if first is None:
        listed = join_first(list(variables)) or "no numbers of a measurement"
        raise ValueError(f"no variable is the frequency; the file contains {listed}")
    n, names = variables[first].size, ", ".join(variables)
    columns = {
        name: a.ravel() for name, a in variables.items() if a.size == n and a.dtype.kind in "fiu"
    }
    numbers = [name for name in variables if variables[name].dtype.kind == "c"]
    pairs = product(COMPLEX_NAMES, numbers)
    kinds = [(kind, name) for kind, name in pairs if _has_quantity(name, kind)]
    if not kinds:
        return combine_response(list(columns), list(columns.values()), shunt)
    _reject_shunt(shunt, "complex numbers in a MATLAB file")
    quantity, name = kinds[0]
    P = variables[name]
    if P.ndim == 3 and P.shape[2] == n and P.shape[0] == P.shape[1]:
        P = np.moveaxis(P, 2, 0)
    elif P.size == n:
        P = P.reshape(n, 1, 1)
    if P.ndim != 3 or P.shape[0] != n or P.shape[1] != P.shape[2]:
        raise ValueError(
            f"the array {name} of shape {P.shape} does not match {n} frequencies in {names}"
        )
    title = read_title(first)
    assert title is not None  # title of the frequency
    frequency = convert_column(title, variables[first].ravel())
    notes = [frequency.note] if frequency.note else []
    P, R = P * _find_unit_factor(name), DEFAULT_REFERENCE
    if quantity == "S":
        resistance = next((variables[k] for k in variables if k.lower() in _RESISTANCE_NAMES), None)
        R = R if resistance is None else float(resistance.ravel()[0].real)
        notes += (
            [f"{name}: no reference resistance; {R:g} Ohm is assumed"] if resistance is None else []
        )
    z0 = np.full(P.shape[1], R)
    Y = convert_to_admittance(quantity, P, z0)
    understood = f"{frequency}, {quantity} from {name!r}"
    return MeasuredResponse(frequency.values, quantity, P, Y, z0, tuple(notes), understood)


def _has_quantity(name: str, quantity: Quantity) -> bool:
    """Return whether an array name denotes a complex array of the given quantity."""
    kind = find_complex_quantity(name)
    return kind is not None and kind[0] == quantity


def _find_unit_factor(name: str) -> float:
    """Return the SI value of the unit in an array name; 1 if the name has no unit."""
    kind = find_complex_quantity(name)
    return kind[1] if kind else 1.0
