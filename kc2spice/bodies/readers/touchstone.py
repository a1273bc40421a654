"""Parser of Touchstone files with measured responses (IBIS Open Forum, 2009)."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from kc2spice.bodies.readers.column_kinds import Quantity
from kc2spice.bodies.readers.complex_response import MeasuredResponse, convert_to_admittance
from kc2spice.core.errors import UsageError

_FREQUENCY_UNITS = {"hz": 1.0, "khz": 1e3, "mhz": 1e6, "ghz": 1e9, "thz": 1e12}
_NUMBER_FORMS = ("ri", "ma", "db")
_PARAMETER_KINDS = tuple("syzgh")
_KNOWN_OPTION_WORDS = {*_NUMBER_FORMS, *_PARAMETER_KINDS, *_FREQUENCY_UNITS}
# Largest number of ports whose parameters are in a single line for each frequency
# (IBIS Open Forum, 2009).
MAX_PORTS_ON_A_LINE = 2
_QUANTITIES: dict[str, Quantity] = {"s": "S", "z": "Z", "y": "Y"}


class OptionLineError(ValueError):
    """Error for a Touchstone file without an option line.

    ``advice`` is the hint of the error message.
    """

    advice = (
        "write a line such as  # Hz S RI R 50  above the numbers, with the unit and the format "
        "of the file"
    )


def _require_line_lengths(counts: Mapping[int, int], ports: int, width: int) -> None:
    """Raise an error if all lines of data have the same wrong number of values.

    ``counts`` is the number of values in each line, keyed by line number, and ``width`` is the
    number of values for each frequency.
    """
    lengths = set(counts.values())
    if len(lengths) != 1 or not min(lengths) % width:
        return
    raise ValueError(
        f"line {min(counts)} contains {min(lengths)} numbers, but a file of {ports} "
        f"{'port' if ports == 1 else 'ports'} has {width} numbers in each line"
    )


def _require_numbers(words: list[str], text: str) -> None:
    """Raise an error if a word in the data of a Touchstone file is not a number.

    The error contains the line number of the first word that is not a number.
    """
    for word in words:
        try:
            float(word)
        except ValueError:
            lines = enumerate(text.lower().splitlines(), start=1)
            number = next((at for at, line in lines if word in line.split()), 0)
            raise ValueError(f"line {number} contains {word!r}, which is not a number") from None


def parse_touchstone(text: str, ports: int) -> MeasuredResponse:
    """Parse the response in the text of a Touchstone file of version 1 or 2.

    The file contains S, Y or Z parameters in the form RI, MA or DB. ``ports`` is the number of
    ports according to the file name. Only the first option line is used, because the standard (IBIS
    Open Forum, 2009) requires that all further option lines are ignored.
    """
    unit, kind, form, reference = "ghz", "s", "ma", [50.0]
    section = words = list[str]()
    keys: dict[str, list[str]] = {}
    options: list[list[str]] = []
    counts: dict[int, int] = {}  # number of words in each line of data, keyed by line number
    for number, raw in enumerate(text.lower().splitlines(), start=1):
        line = raw.partition("!")[0].strip()
        if line.startswith("["):
            key, _, value = line[1:].partition("]")
            section = keys[key.strip()] = value.split()
        elif line.startswith("#"):
            options.append(line[1:].split())
        elif line:
            section += line.split()
            counts[number] = len(line.split())
    if not options:
        raise OptionLineError("the option line with the unit and the format is missing")
    for option in options[:1]:
        at = option.index("r") if "r" in option else len(option)
        reference = list(map(float, option[at + 1 :])) or reference
        unknown = [word for word in option[:at] if word not in _KNOWN_OPTION_WORDS]
        if unknown:
            raise ValueError(f"the option line has the word {unknown[0]!r}, which is unknown")
        unit = _select_option(option[:at], tuple(_FREQUENCY_UNITS), unit)
        kind = _select_option(option[:at], _PARAMETER_KINDS, kind)
        form = _select_option(option[:at], _NUMBER_FORMS, form)
    notes = list[str]()
    if len(options) > 1:
        notes.append("of several option lines, only the first is used")
    stated = options[0] if options else []
    if not set(stated) & set(_FREQUENCY_UNITS):
        notes.append("the option line states no frequency unit; GHz is assumed")
    if not set(stated) & set(_NUMBER_FORMS):
        notes.append("the option line states no format; MA is assumed")
    words = keys.get("network data", words)
    reference = list(map(float, keys.get("reference", ()))) or reference
    n = int(keys.get("number of ports", [str(ports)])[0])
    order, shape = keys.get("two-port data order"), keys.get("matrix format", ["full"])
    if kind in "gh" or not 1 <= n <= 64 or shape not in (["full"], ["lower"], ["upper"]):
        raise ValueError(
            f"{kind.upper()} parameters of {n} ports in the matrix format {' '.join(shape)} are "
            "not supported"
        )
    symmetric = shape != ["full"]  # the file contains only one triangle of each matrix, row by row
    width = 1 + (n * (n + 1) if symmetric else 2 * n * n)
    if n <= MAX_PORTS_ON_A_LINE and "version" not in keys:
        _require_line_lengths(counts, n, width)
    _require_numbers(words, text)
    values = np.array(list(map(float, words)))
    table = values[: len(values) // width * width].reshape(-1, width)
    # In Touchstone version 1, noise parameters follow the response.
    # The first frequency of noise parameters is lower than the last frequency of the response.
    back = np.flatnonzero(np.diff(table[:, 0]) < 0)
    if len(values) % width and not back.size:
        raise ValueError(
            f"the file contains {len(values)} numbers, which is not a multiple of {width}, the "
            "number of values for each frequency"
        )
    table = table[: back[0] + 1] if back.size else table
    a, b = table[:, 1::2], table[:, 2::2]
    polar = np.deg2rad(b)
    size = 10 ** (a / 20) if form == "db" else a
    if form == "ma" and (a < 0).any():
        raise ValueError(
            "a magnitude is negative: the option line states MA, but the data may be in RI"
        )
    P = a + 1j * b if form == "ri" else size * np.exp(1j * polar)
    P = _fill_triangle(P, n, shape == ["lower"]) if symmetric else P.reshape(-1, n, n)
    if n == 2 and order in (None, ["21_12"]):
        P = P.swapaxes(1, 2)
    if kind == "s":
        _reject_undriven_ports(P)
    z0 = np.broadcast_to(reference if len(reference) == n else reference[:1], (n,)).astype(float)
    # in Touchstone version 1, Y and Z of all ports are normalised to the first reference resistance
    if kind != "s" and "version" not in keys:
        P = P * z0[0] if kind == "z" else P / z0[0]
    summary = f"{n}-port {kind.upper()} parameters in {form.upper()} format, "
    summary += f"frequency in {_format_unit(unit)}"
    summary += f", reference {' '.join(f'{R:g}' for R in reference)} Ohm" if kind == "s" else ""
    doubt = ""
    if form != "ri" and len(b) and np.abs(b).max() <= 1 and np.ptp(b):
        doubt = (
            f"no phase exceeds {np.abs(b).max():.3g} degrees: if the data are real and imaginary "
            f"parts, write RI in place of {form.upper()} in the option line"
        )
    quantity = _QUANTITIES[kind]
    Y = convert_to_admittance(quantity, P, z0)
    return MeasuredResponse(
        _FREQUENCY_UNITS[unit] * table[:, 0], quantity, P, Y, z0, tuple(notes), summary, doubt
    )


def _fill_triangle(entries: np.ndarray, n: int, lower: bool) -> np.ndarray:
    """Make symmetric matrices from the entries of one triangle of each matrix.

    ``entries`` contains the triangle of each of the m matrices, row by row: the lower triangle if
    ``lower`` is true, otherwise the upper triangle. The returned array of m matrices has the shape
    (m, n, n).
    """
    rows, columns = np.tril_indices(n) if lower else np.triu_indices(n)
    P = np.zeros((len(entries), n, n), dtype=complex)
    P[:, rows, columns] = P[:, columns, rows] = entries
    return P


def _reject_undriven_ports(S: np.ndarray) -> None:
    """Raise an error if a port was not driven during the measurement.

    Some analysers write zeros for a port that was not driven.

    Raises
    ------
    UsageError : all reflections and transmissions of a port are zero. An amplifier, which has a
        transmission above one, causes no error.
    """
    n = S.shape[1]
    silent = np.flatnonzero(~S.any(axis=(0, 1)))
    transmissions = S[:, ~np.eye(n, dtype=bool)]
    if n == 1 or not silent.size or silent.size == n or np.abs(transmissions).max() > 1:
        return
    port, driven = silent[0] + 1, np.flatnonzero(S.any(axis=(0, 1)))[0] + 1
    names = " and ".join(f"S{row}{port}" for row in range(1, n + 1))
    raise UsageError(
        f"the analyser did not drive port {port} in this measurement",
        got=f"{names} are zero at all frequencies",
        expected="S parameters of all ports, or of one port in a file .s1p",
        hint=f"export S{driven}{driven}, the reflection at port {driven}, as a one-port file .s1p",
    )


def _select_option(words: list[str], choices: tuple[str, ...], default: str) -> str:
    """Return the one word of a Touchstone option line that is among the choices.

    Return the ``default`` if the option line contains none of the choices.

    Raises
    ------
    ValueError : the option line contains several of the choices.
    """
    present = [word for word in words if word in choices]
    if len(present) > 1:
        raise ValueError(f"the option line has both {present[0]!r} and {present[1]!r}")
    return present[0] if present else default


def _format_unit(unit: str) -> str:
    """Return a frequency unit in the usual letter case, such as ``kHz``."""
    return unit[:-2].upper().replace("K", "k") + "Hz"
