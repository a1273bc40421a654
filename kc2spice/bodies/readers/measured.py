"""Measured responses: Touchstone files of version 1 and 2, tables of impedance analysers, MATLAB.

A table has titles that say what its columns are (:mod:`kc2spice.bodies.readers.columns`), in any
order: frequency, and the columns of one of :data:`COMBINATIONS`. Fields lie between semicolons,
tabs, commas or blanks; a decimal comma is read where commas do not separate.

Variables of a MATLAB file are named as columns are; a complex one is ``z``, ``y`` or ``s``, of n
frequencies or (ports, ports, n) as MATLAB has it, ``s`` with its resistance ``z0`` beside it.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np

from kc2spice.bodies.readers.columns import Column, column_of, read_table, read_title, units_of
from kc2spice.bodies.readers.raw import (
    absent,
    call_reader,
    in_own_process,
    present,
    unusable_file,
    vectors,
)
from kc2spice.core.equality import EqualByContent
from kc2spice.core.errors import wrong
from kc2spice.core.untrusted_files import read_bounded
from kc2spice.rom.linear_model import Norm

Quantity = Literal["S", "Z", "Y"]
MAX_BYTES = 20_000_000
MOST = 20_000  # frequencies: no analyser has as many, and a fit would take hours
FEWEST = 12  # frequencies: four numbers of one resonance and its noise
ACTIVE = 0.05  # negative resistance over |Z| that is not noise, if a tenth of the points have it
HINT = "name the columns in the first line, such as  frequency_hz,real_ohm,imag_ohm"
_TOUCHSTONE = re.compile(r"\.(s(\d+)p|ts)", re.IGNORECASE)
_TABLES = (".csv", ".txt", ".tsv", ".zma")
_COMPLEX: dict[Quantity, str] = {
    "Z": r"z|impedance", "Y": r"y|admittance", "S": r"s|s11|sparameters|scattering"
}  # fmt: skip
_RESISTANCE = ("z0", "r0", "zref", "reference")
REFERENCE = 50.0  # Ohm, of S where no file states it
_MATRIX = re.compile(r".*[._][MEKABCD]", re.DOTALL)  # NAME_K.txt
_HERTZ = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9, "thz": 1e12}
_OPTIONS = {"ri", "ma", "db", *"syzgh", *_HERTZ}


@dataclass(frozen=True)
class Combination:
    """Columns that determine the ``quantity`` together, and how: angles in rad, w in rad/s."""

    columns: tuple[str, str]
    quantity: Quantity
    value: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]


COMBINATIONS = (
    Combination(("r", "x"), "Z", lambda r, x, w: r + 1j * x),
    Combination(("g", "b"), "Y", lambda g, b, w: g + 1j * b),
    Combination(("z", "phase"), "Z", lambda z, a, w: z * np.exp(1j * a)),
    Combination(("z", "phase_z"), "Z", lambda z, a, w: z * np.exp(1j * a)),
    Combination(("z", "phase_y"), "Z", lambda z, a, w: z * np.exp(-1j * a)),
    Combination(("y", "phase"), "Y", lambda y, a, w: y * np.exp(1j * a)),
    Combination(("y", "phase_y"), "Y", lambda y, a, w: y * np.exp(1j * a)),
    Combination(("y", "phase_z"), "Y", lambda y, a, w: y * np.exp(-1j * a)),
    Combination(("r", "cs"), "Z", lambda r, c, w: r - 1j / (w * c)),
    Combination(("r", "ls"), "Z", lambda r, l, w: r + 1j * w * l),
    Combination(("rp", "cp"), "Y", lambda r, c, w: 1 / r + 1j * w * c),
    Combination(("rp", "lp"), "Y", lambda r, l, w: 1 / r - 1j / (w * l)),
    Combination(("g", "cp"), "Y", lambda g, c, w: g + 1j * w * c),
    Combination(("g", "lp"), "Y", lambda g, l, w: g - 1j / (w * l)),
    Combination(("cp", "d"), "Y", lambda c, d, w: w * c * (d + 1j)),
    Combination(("cp", "q"), "Y", lambda c, q, w: w * c * (1 / q + 1j)),
    Combination(("cs", "d"), "Z", lambda c, d, w: (d - 1j) / (w * c)),
    Combination(("cs", "q"), "Z", lambda c, q, w: (1 / q - 1j) / (w * c)),
    Combination(("ls", "d"), "Z", lambda l, d, w: w * l * (d + 1j)),
    Combination(("ls", "q"), "Z", lambda l, q, w: w * l * (1 / q + 1j)),
    Combination(("lp", "d"), "Y", lambda l, d, w: (d - 1j) / (w * l)),
    Combination(("lp", "q"), "Y", lambda l, q, w: (1 / q - 1j) / (w * l)),
    Combination(("c", "d"), "Y", lambda c, d, w: w * c * (d + 1j)),
    Combination(("s_real", "s_imag"), "S", lambda a, b, w: a + 1j * b),
    Combination(("s_size", "s_phase"), "S", lambda s, a, w: s * np.exp(1j * a)),
)


@dataclass(frozen=True, eq=False)
class MeasuredResponse(EqualByContent):
    """``samples`` (n, ports, ports) of a ``quantity`` at ``f`` (n,) [Hz], the admittances ``Y``
    that they are, the ``reference`` resistances (ports,) [Ohm] of S, what the reader assumed and
    what the columns mean."""

    f: np.ndarray
    quantity: Quantity
    samples: np.ndarray
    Y: np.ndarray
    reference: np.ndarray
    notes: tuple[str, ...] = ()
    columns: str = ""


@dataclass(frozen=True, eq=False)
class Measured(EqualByContent):
    """Admittance ``Y`` (n, ports, ports) [S] at the increasing frequencies ``f`` (n,) [Hz].

    ``samples`` (n, ports, ports) are the ``quantity`` that was measured, ``"S"``, ``"Z"`` or
    ``"Y"``; ``Y`` by default. ``reference`` (ports,) [Ohm] are the resistances of S. ``notes`` are
    assumptions of the reader, ``columns`` what it understood.
    """

    name: str
    where: str
    f: np.ndarray
    Y: np.ndarray
    notes: tuple[str, ...] = ()
    quantity: Quantity = "Y"
    samples: np.ndarray | None = None
    columns: str = ""
    reference: np.ndarray = field(default_factory=lambda: np.array([REFERENCE]))

    @property
    def description(self) -> str:
        """Columns, number of points and frequency range that the reader found."""
        span = f"{len(self.f)} points from {self.f[0]:.6g} to {self.f[-1]:.6g} Hz"
        return f"{self.columns}; {span}" if self.columns else span

    @property
    def measured_noise(self) -> float:
        """Standard deviation of one component of the measured quantity, of Z and Y relative to
        each entry: the median size of third differences, which a smooth response does not have.
        Entries that are zero have none."""
        x = self.Y if self.samples is None else self.samples
        x = x.reshape(len(self.f), -1)
        size = np.ones(x[1:-2].shape) if self.quantity == "S" else np.abs(x[1:-2])
        steps = np.diff(x, 3, axis=0)[size > 0] / size[size > 0]
        return float(np.median(np.abs(np.r_[steps.real, steps.imag])) / (0.6745 * np.sqrt(20)))

    @cached_property
    def admittance_noise(self) -> np.ndarray:
        """Standard deviation (n, ports, ports) [S] of one component of each entry of Y, by the
        first-order effect of independent noise of the measured entries::

            dY = -Y dZ Y        R^(1/2) dY R^(1/2) = -2 (1 + S)^-1 dS (1 + S)^-1

        where ``(1 + S)^-1 = (1 + R^(1/2) Y R^(1/2)) / 2``.
        """
        noise, one = self.measured_noise, np.eye(self.Y.shape[1])
        if self.quantity == "Y" or self.samples is None:
            return noise * np.abs(self.Y)
        if self.quantity == "Z":
            left, size = self.Y, np.abs(self.samples) ** 2
            variance = np.abs(left) ** 2 @ size @ np.abs(left) ** 2
            return np.asarray(noise * np.sqrt(variance))
        root = np.sqrt(self.reference)
        wave = 0.5 * (one + root[:, None] * self.Y * root)
        rows, columns = (np.linalg.norm(wave, axis=k) for k in (2, 1))
        return np.asarray(2 * noise * rows[:, :, None] * columns[:, None] / np.outer(root, root))

    @property
    def noise(self) -> float:
        """Relative standard deviation of one component of Y: the median over the samples."""
        size = np.abs(self.Y)
        return float(np.median(self.admittance_noise[size > 0] / size[size > 0]))

    def relative_noise(self, norm: Norm) -> float:
        """Noise (rms, complex) of Y in the norm of an error: *pointwise* relative to each entry,
        *peak* to the largest value of the entry, of which the noisiest counts."""
        size = np.abs(self.Y)
        size = np.broadcast_to(size.max(axis=0), size.shape) if norm == "peak" else size
        share = np.where(size > 0, self.admittance_noise / np.where(size > 0, size, 1.0), 0.0)
        return float(np.sqrt(2 * np.mean(share**2, axis=0)).max())


def is_measured(path: Path) -> bool:
    """Whether a path is that of a measured response."""
    by_suffix = _TOUCHSTONE.fullmatch(path.suffix) or (
        path.suffix.lower() in _TABLES and not _MATRIX.fullmatch(path.stem)
    )
    if path.suffix.lower() == ".mat" and present(path):
        try:
            return any(map(_is_frequency, _variables(path, path.stat().st_mtime)))
        except (ValueError, NotImplementedError):  # which the reader of matrices tells
            return False
    return bool(by_suffix) and present(path)


def read_measured(path: Path) -> Measured:
    """The response in a Touchstone file, a table or a MATLAB file.

    Raises
    ------
    UsageError : no such file, damaged, too large, too few points, columns that are not known, or
        that make a passive part give power; a short circuit, or a port that conducts nothing.
    """
    match = _TOUCHSTONE.fullmatch(path.suffix)
    expected = "a table with a frequency and two columns of impedance, admittance or reflection"
    advice = HINT
    if match:
        expected = "a Touchstone file with S, Y or Z parameters in RI, MA or DB"
        advice = "export the file again as Touchstone"

    if not present(path):
        raise absent(path, expected)

    def read() -> MeasuredResponse:
        if path.suffix.lower() == ".mat":
            return _matlab(_variables(path, path.stat().st_mtime))
        data = read_bounded(path, MAX_BYTES)
        try:
            text = data.decode("utf-8-sig")
        except UnicodeDecodeError:
            text = data.decode("latin-1")
        return _touchstone(text, int(match[2] or 0)) if match else _response(*read_table(text))

    with np.errstate(all="ignore"):  # values that are not finite are refused
        response = call_reader(path, expected, read, advice)
    f, Y = response.f, response.Y
    if not (np.isfinite(f).all() and np.isfinite(Y).all() and f.min(initial=1.0) >= 0):
        got = "NaN, infinity, an impedance of zero or a frequency below zero"
        raise unusable_file(path, got, "finite numbers", HINT)
    f, order = np.unique(f, return_index=True)  # increasing, each once
    order = order[f > 0]
    if len(order) < FEWEST:
        raise unusable_file(
            path, f"{len(order)} frequencies", f"at least {FEWEST}", "measure more points"
        )
    result = Measured(
        name=path.stem,
        where=str(path),
        f=response.f[order],
        Y=Y[order],
        notes=response.notes,
        quantity=response.quantity,
        samples=response.samples[order],
        reference=response.reference,
        columns=response.columns,
    )
    if len(order) > MOST:
        hint = "leave out points between resonances"
        raise unusable_file(path, f"{len(order)} frequencies", f"at most {MOST}", hint)
    _require_conducting(result)
    _require_passive(result)
    return result


def _require_conducting(data: Measured) -> None:
    """Deviations are relative: to each admittance of one port, to the largest of several."""
    still = np.einsum("fii->fi", data.Y) == 0
    one = still.shape[1] == 1
    still = still[:, 0] if one else still.all(axis=0)
    if not still.any():
        return
    first, of = int(np.argmax(still)), f"{still.sum()} of {len(still)}"
    got = f"no current at {of} frequencies, first at {data.f[first]:g} Hz"
    got = got if one else f"no current into {of} ports, first into port {first + 1}"
    hint = "delete these frequencies from the file, or measure with the part connected"
    raise wrong(data.where, "is an open circuit", got, "admittances that are not zero", hint)


def _require_passive(data: Measured) -> None:
    """Check that the real part of Y has no negative eigenvalue beyond noise."""
    size = np.linalg.norm(data.Y, 2, axis=(1, 2))
    least = np.linalg.eigvalsh(0.5 * (data.Y + data.Y.conj().swapaxes(1, 2)))[:, 0]
    bad = least < -max(ACTIVE, 5 * data.noise) * size
    if np.mean(bad) < 0.1:
        return
    hint = "check the order of the columns and the sign of the phase"
    if data.Y.shape[1] == 1 and (data.Y.imag[bad] > 0).mean() < 0.5:
        hint = "swap the columns of real and imaginary part, which seem to be interchanged"
    got = f"a real part below zero at {bad.sum()} of {len(bad)} frequencies, "
    got += f"first at {data.f[bad][0]:g} Hz"
    problem = "the measured part gives power, which no passive part does"
    raise wrong(data.where, problem, got, "Re Z >= 0, except for noise", hint)


def _touchstone(text: str, ports: int) -> MeasuredResponse:
    """Touchstone 1 and 2 (IBIS Open Forum, 2009): S, Y or Z in RI, MA or DB.

    The first option line counts; the standard ignores others.
    """
    unit, kind, form, reference = "ghz", "s", "ma", [50.0]
    section = words = list[str]()
    keys: dict[str, list[str]] = {}
    options: list[list[str]] = []
    for raw in text.lower().splitlines():
        line = raw.partition("!")[0].strip()
        if line.startswith("["):
            key, _, value = line[1:].partition("]")
            section = keys[key.strip()] = value.split()
        elif line.startswith("#"):
            options.append(line[1:].split())
        else:
            section += line.split()
    for option in options[:1]:
        at = option.index("r") if "r" in option else len(option)
        reference = [float(w) for w in option[at + 1 :]] or reference
        unknown = [word for word in option[:at] if word not in _OPTIONS]
        if unknown:
            raise ValueError(f"the option line has the word {unknown[0]!r}, which is not known")
        unit = next((word for word in option[:at] if word in _HERTZ), unit)
        kind = next((word for word in option[:at] if word in "syzgh"), kind)
        form = next((word for word in option[:at] if word in ("ri", "ma", "db")), form)
    notes = ["the first of several option lines counts"] if len(options) > 1 else []
    words = keys.get("network data", words)
    reference = [float(w) for w in keys.get("reference", ())] or reference
    n = int(keys.get("number of ports", [str(ports)])[0])
    order, shape = keys.get("two-port data order"), keys.get("matrix format", ["full"])
    if kind in "gh" or not 1 <= n <= 64 or shape != ["full"]:
        raise ValueError(f"{kind.upper()} parameters of {n} ports, {' '.join(shape)}")
    width = 1 + 2 * n * n
    values = np.array([float(w) for w in words])
    table = values[: len(values) // width * width].reshape(-1, width)
    back = np.flatnonzero(np.diff(table[:, 0]) < 0)  # noise parameters of version 1 come last
    if len(values) % width and not back.size:
        raise ValueError(f"{len(values)} numbers, not {width} a frequency")
    table = table[: back[0] + 1] if back.size else table
    a, b = table[:, 1::2], table[:, 2::2]
    polar = np.deg2rad(b)
    size = 10 ** (a / 20) if form == "db" else a
    P = (a + 1j * b if form == "ri" else size * np.exp(1j * polar)).reshape(-1, n, n)
    if n == 2 and order in (None, ["21_12"]):
        P = P.swapaxes(1, 2)
    z0 = np.broadcast_to(reference if len(reference) == n else reference[:1], (n,)).astype(float)
    if kind != "s" and "version" not in keys:  # version 1 normalises to the first reference
        P = P * z0[0] if kind == "z" else P / z0[0]
    summary = f"{kind.upper()} of {n} ports in {form.upper()}, frequency in {_spell_unit(unit)}"
    summary += f", reference {' '.join(f'{R:g}' for R in reference)} Ohm" if kind == "s" else ""
    quantity = _QUANTITIES[kind]
    Y = _admittance(quantity, P, z0)
    return MeasuredResponse(_HERTZ[unit] * table[:, 0], quantity, P, Y, z0, tuple(notes), summary)


_QUANTITIES: dict[str, Quantity] = {"s": "S", "z": "Z", "y": "Y"}


def _spell_unit(unit: str) -> str:
    """A unit of frequency in its own case."""
    return unit[:-2].upper().replace("K", "k") + "Hz"


def _admittance(quantity: Quantity, P: np.ndarray, z0: np.ndarray) -> np.ndarray:
    """Y (n, ports, ports) of S with the reference resistances ``z0`` (ports,), of Z or of Y."""
    one = np.eye(P.shape[1])
    try:
        if quantity == "S":
            root = np.diag(1 / np.sqrt(z0))
            return np.asarray(root @ np.linalg.solve(one + P, one - P) @ root)
        return np.linalg.inv(P) if quantity == "Z" else P
    except np.linalg.LinAlgError:
        text = "an impedance of zero: an ideal short circuit has no admittance"
        raise ValueError(text) from None


def _response(titles: list[str], rows: np.ndarray) -> MeasuredResponse:
    """The response of a table or of vectors under ``titles``; rows (n, columns)."""
    if len(titles) != rows.shape[-1]:
        raise ValueError(f"{len(titles)} titles above {rows.shape[-1]} columns of numbers")
    columns: dict[str, Column] = {}
    unknown = []
    for text, values in zip(titles, rows.T, strict=True):
        title = read_title(text)
        if title is None:
            unknown.append(repr(text.strip()))
        elif title.meaning.quantity not in columns:
            columns[title.meaning.quantity] = column_of(title, values)
    combination = next((c for c in COMBINATIONS if set(c.columns) <= set(columns)), None)
    if "f" not in columns or combination is None:
        missing = "no frequency" if "f" not in columns else "no complete impedance"
        strange = f"; unknown: {', '.join(unknown[:5])}" if unknown else ""
        raise ValueError(f"the columns {', '.join(titles[:5])} contain {missing}{strange}")
    used = [columns[name] for name in ("f", *combination.columns)]
    f = used[0].values
    steps = np.diff(f)
    if not ((steps >= 0).all() or (steps <= 0).all()):
        raise ValueError("the frequency column goes up and down: is it another one?")
    first, second = (column.values for column in used[1:])
    samples = combination.value(first, second, 2 * np.pi * f)[:, None, None]
    notes = [column.note for column in used if column.note]
    if combination.quantity == "S":
        notes.append(f"no reference resistance of S, taken as {REFERENCE:g} Ohm")
    if "c" in combination.columns:
        notes.append(f"{columns['c'].title.text}: neither Cp nor Cs, taken as Cp")
    left = [text for text in titles if text not in [column.title.text for column in used]]
    summary = ", ".join(map(str, used)) + (f"; not used: {', '.join(left)}" if left else "")
    z0 = np.array([REFERENCE])
    Y = _admittance(combination.quantity, samples, z0)
    return MeasuredResponse(f, combination.quantity, samples, Y, z0, tuple(notes), summary)


@lru_cache(maxsize=1)
def _variables(path: Path, changed: float) -> dict[str, np.ndarray]:
    """Numeric arrays of a MATLAB file by name, none of one that has matrices of a model."""
    return in_own_process(vectors, path)


def _is_frequency(name: str) -> bool:
    """Whether the title of a column, or the name of a variable, is that of the frequency."""
    try:
        title = read_title(name)
    except ValueError:
        return False
    return title is not None and title.meaning.quantity == "f"


def _matlab(variables: dict[str, np.ndarray]) -> MeasuredResponse:
    """Real vectors are columns; a complex array says all itself, its parts are those of one."""
    first = next(filter(_is_frequency, variables), None)
    if first is None:
        raise ValueError(f"variables {', '.join(variables)}, none of them the frequency")
    n, names = variables[first].size, ", ".join(variables)
    columns = {
        name: a.ravel() for name, a in variables.items() if a.size == n and a.dtype.kind in "fiu"
    }
    numbers = [name for name in variables if variables[name].dtype.kind == "c"]
    pairs = product(_COMPLEX, numbers)
    kinds = [(kind, name) for kind, name in pairs if _is_complex(kind, name)]
    if not kinds:
        return _response(list(columns), np.column_stack(list(columns.values())))
    quantity, name = kinds[0]
    P = variables[name]
    if P.ndim == 3 and P.shape[2] == n and P.shape[0] == P.shape[1]:
        P = np.moveaxis(P, 2, 0)
    elif P.size == n:
        P = P.reshape(n, 1, 1)
    if P.ndim != 3 or P.shape[0] != n or P.shape[1] != P.shape[2]:
        raise ValueError(f"{name} of {P.shape} beside {n} frequencies in {names}")
    title = read_title(first)
    assert title is not None  # title of the frequency
    frequency = column_of(title, variables[first].ravel())
    notes = [frequency.note] if frequency.note else []
    P, R = P * _scale(name), REFERENCE
    if quantity == "S":
        resistance = next((variables[k] for k in variables if k.lower() in _RESISTANCE), None)
        R = R if resistance is None else float(resistance.ravel()[0].real)
        notes += (
            [f"{name}: no reference resistance, taken as {R:g} Ohm"] if resistance is None else []
        )
    z0 = np.full(P.shape[1], R)
    Y = _admittance(quantity, P, z0)
    understood = f"{frequency}, {quantity} from {name!r}"
    return MeasuredResponse(frequency.values, quantity, P, Y, z0, tuple(notes), understood)


def _is_complex(quantity: Quantity, name: str) -> bool:
    """Whether a complex array of this name is the quantity, its unit left out."""
    return bool(re.fullmatch(_COMPLEX[quantity], name.partition("_")[0], re.I))


def _scale(name: str) -> float:
    """SI value of the unit behind the underscore in the name of an array, 1 without."""
    _, _, unit = name.partition("_")
    units = units_of(unit) if unit else []
    return units[0].value if units else 1.0
