"""Quantities, units and titles of columns in files of measuring instruments.

This module contains only data. A new kind of column needs only one more entry of
:data:`COLUMN_KINDS`.

- :mod:`kc2spice.bodies.readers.column_titles` uses :data:`COLUMN_KINDS` and :data:`UNITS` to
  parse titles.
- :mod:`kc2spice.bodies.readers.text_table` uses :data:`TRACE_FORMAT` and similar patterns to find
  the quantities of traces.
- :mod:`kc2spice.bodies.readers.complex_response` uses :data:`COMBINATIONS` to combine columns.
- :mod:`kc2spice.bodies.readers.thermal_transient` uses :data:`TRANSIENT_QUANTITIES` to find the
  column of a thermal transient.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np

Quantity = Literal["S", "Z", "Y"]
PREFIXES = {"f": 1e-15, "p": 1e-12, "n": 1e-9, "u": 1e-6, "µ": 1e-6, "μ": 1e-6, "m": 1e-3, "": 1.0,
            "k": 1e3, "M": 1e6, "G": 1e9, "T": 1e12}  # fmt: skip
# Prefixes greater than 1; in units of frequency, their letter case is ignored.
# In units of quantities other than frequency, the letter case is ignored for k and for prefixes
# smaller than 1.
CASE_FREE_PREFIXES = "kMGT"
# Spellings of units and the SI value of each unit, keyed by measured quantity.
# A unit that UNITS spells with a capital letter is recognised only with this capital letter. All
# other units in UNITS are recognised in upper and lower case.
UNITS: dict[str, dict[str, float]] = {
    "frequency": {"hz": 1.0, "hertz": 1.0, "rad/s": 0.5 / np.pi, "rads": 0.5 / np.pi},
    # some programs write the letter O instead of omega because of a wrong code page
    "impedance": {"ohm": 1.0, "ohms": 1.0, "O": 1.0},
    "admittance": {"s": 1.0, "siemens": 1.0, "mho": 1.0},
    "capacitance": {"f": 1.0, "farad": 1.0},
    "inductance": {"h": 1.0, "henry": 1.0},
    "angle": {"deg": np.pi / 180, "degree": np.pi / 180, "degrees": np.pi / 180,
              "°": np.pi / 180, "rad": 1.0, "radian": 1.0, "radians": 1.0},
    "decibel": {"db": 1.0},
    "number": {"": 1.0, "-": 1.0, "1": 1.0, "%": 0.01, "U": 1.0},
    "time": {"s": 1.0, "sec": 1.0, "seconds": 1.0, "min": 60.0, "minutes": 60.0, "h": 3600.0,
             "hours": 3600.0},
    # Only temperature differences are used, so the zero of a temperature scale has no effect.
    "temperature": {"k": 1.0, "kelvin": 1.0, "°c": 1.0, "degc": 1.0, "c": 1.0, "celsius": 1.0,
                    "°f": 5 / 9, "degf": 5 / 9},
    "thermal impedance": {"k/w": 1.0, "k_per_w": 1.0, "k_w": 1.0, "°c/w": 1.0, "c/w": 1.0},
}  # fmt: skip
REPLACED_LETTERS = {"O": "Ohm"}  # wrong letter of a unit in a title, and the correct unit
# unit of each measured quantity if a title contains no unit
DEFAULT_UNITS = {
    "frequency": "Hz", "impedance": "Ohm", "admittance": "S", "capacitance": "F",
    "inductance": "H", "angle": "deg", "decibel": "dB", "number": "",
    "time": "s", "temperature": "K", "thermal impedance": "K/W",
}  # fmt: skip
# units that cannot have SI prefixes
UNITS_WITHOUT_PREFIX = (
    "°",
    "db",
    "",
    "-",
    "1",
    "%",
    "°c",
    "degc",
    "c",
    "celsius",
    "°f",
    "degf",
    "min",
)
# kinds of phase columns; in a passive part, these phases are within one turn
PASSIVE_PHASES = ("phase", "phase_z", "phase_y", "gain_phase")
MAX_PHASE = 2.02 * np.pi  # rad, largest phase: one turn plus 1 % for noise
# Limits that decide whether angles without a unit are in radians or in degrees.
# The unit is rad if the values are between -0.51 pi and 0.51 pi and span more than 0.5. Otherwise,
# the unit is degrees.
RADIAN_LIMITS = 0.51 * np.pi, 0.5


@dataclass(frozen=True)
class ColumnKind:
    """Kind of a table column: its quantity, its units, and the pattern of its title.

    ``measures`` lists the keys of :data:`UNITS` that are permitted for the column; the first key is
    the default. ``names`` is a regular expression for the title in lower case, without sign, unit,
    blanks and words that instruments add. If ``needs_unit`` is true, a title without a unit does
    not identify the quantity.
    """

    quantity: str
    measures: tuple[str, ...]
    names: str
    needs_unit: bool = False


_PHASE = r"(phase|theta|th|θ|φ|phi|arg|angle|ang)"
_MAGNITUDE = r"(mag|magnitude|abs|absolute|absolut|mod|modulus)"
_REAL = r"(re|real|realpart)"
_IMAGINARY = r"(im|img|imag|imaginary|imagpart)"


def _make_affix_pattern(of: str, word: str) -> str:
    """Return a regular expression of a quantity letter beside a word, in either order.

    The letter is a quantity and the word is a part of the quantity, as in ``magz`` and ``zmag``.
    The argument ``of`` is the letter of the quantity, such as ``z``. The argument ``word`` is a
    regular expression of the word beside this letter.
    """
    return rf"{of}{word}|{word}{of}|{word}\|{of}\|"


_SITE_PATTERN = r"(j|junction|c|case)"  # location of a temperature in a semiconductor package
SOUND_QUANTITY = "sound pressure"  # quantity that does not determine an impedance
COLUMN_KINDS = (
    ColumnKind("f", ("frequency",), r"f|freq|frequency|frequenz|frq|omega|ω"),
    ColumnKind("z", ("impedance", "decibel"), rf"z|z?\|z\||{_make_affix_pattern('z', _MAGNITUDE)}"),
    ColumnKind(
        "y",
        ("admittance", "decibel"),
        rf"y|y?\|y\||{_make_affix_pattern('y', _MAGNITUDE)}",
    ),
    ColumnKind("z", ("impedance",), _MAGNITUDE, needs_unit=True),
    ColumnKind("y", ("admittance",), _MAGNITUDE, needs_unit=True),
    ColumnKind("phase", ("angle",), _PHASE),
    ColumnKind("phase_z", ("angle",), _make_affix_pattern("z", _PHASE)),
    ColumnKind("phase_y", ("angle",), _make_affix_pattern("y", _PHASE)),
    ColumnKind("phase_z", ("angle",), "z", needs_unit=True),  # for example Impedance (Degree)
    ColumnKind("phase_y", ("angle",), "y", needs_unit=True),
    ColumnKind("r", ("impedance",), rf"r|z?rs|esr|resistance|{_make_affix_pattern('z', _REAL)}"),
    ColumnKind("x", ("impedance",), rf"x|z?xs|reactance|{_make_affix_pattern('z', _IMAGINARY)}"),
    ColumnKind("rp", ("impedance",), r"z?rp"),
    ColumnKind("g", ("admittance",), rf"g|y?gp|conductance|{_make_affix_pattern('y', _REAL)}"),
    ColumnKind("b", ("admittance",), rf"b|y?bp|susceptance|{_make_affix_pattern('y', _IMAGINARY)}"),
    ColumnKind("r", ("impedance",), _REAL, needs_unit=True),
    ColumnKind("x", ("impedance",), _IMAGINARY, needs_unit=True),
    ColumnKind("g", ("admittance",), _REAL, needs_unit=True),
    ColumnKind("b", ("admittance",), _IMAGINARY, needs_unit=True),
    ColumnKind("c", ("capacitance",), r"c|capacitance"),
    ColumnKind("cp", ("capacitance",), r"[zy]?cp"),
    ColumnKind("cs", ("capacitance",), r"[zy]?cs"),
    ColumnKind("lp", ("inductance",), r"[zy]?lp"),
    ColumnKind("ls", ("inductance",), r"[zy]?ls"),
    ColumnKind("d", ("number",), r"d|df|tan(d|δ|delta)|dissipation(factor)?|loss(factor|tangent)"),
    ColumnKind("q", ("number",), r"q|quality(factor)?|qfactor"),
    ColumnKind("s_size", ("decibel",), r"s|s11|γ|gamma", needs_unit=True),
    ColumnKind("s_phase", ("angle",), r"s|s11|γ|gamma", needs_unit=True),
    ColumnKind(
        "s_size",
        ("number", "decibel"),
        rf"{_make_affix_pattern('s', _MAGNITUDE)}|{_make_affix_pattern('s11', _MAGNITUDE)}",
    ),
    ColumnKind(
        "s_phase",
        ("angle",),
        rf"{_make_affix_pattern('s', _PHASE)}|{_make_affix_pattern('s11', _PHASE)}",
    ),
    ColumnKind(
        "s_real",
        ("number",),
        rf"{_make_affix_pattern('s', _REAL)}|{_make_affix_pattern('s11', _REAL)}",
    ),
    ColumnKind(
        "s_imag",
        ("number",),
        rf"{_make_affix_pattern('s', _IMAGINARY)}|{_make_affix_pattern('s11', _IMAGINARY)}",
    ),
    ColumnKind(
        "gain",
        ("decibel", "number"),
        rf"gain|{_make_affix_pattern('gain', _MAGNITUDE)}",
        needs_unit=True,
    ),
    ColumnKind("gain", ("decibel",), _MAGNITUDE, needs_unit=True),
    ColumnKind("gain_phase", ("angle",), _make_affix_pattern("gain", _PHASE)),
    ColumnKind("gain_phase", ("angle",), "gain", needs_unit=True),
    ColumnKind("gain_real", ("number",), _make_affix_pattern("gain", _REAL)),
    ColumnKind("gain_imag", ("number",), _make_affix_pattern("gain", _IMAGINARY)),
    ColumnKind("time", ("time",), r"t|tp|time|elapsed|elapsedtime|pulse(width|duration)"),
    ColumnKind(
        "temperature",
        ("temperature",),
        rf"(d|δ|delta)?t{_SITE_PATTERN}|(d|δ|delta)t|{_SITE_PATTERN}?temp(erature)?(rise)?|rise",
    ),
    ColumnKind("temperature", ("temperature",), "t", needs_unit=True),
    ColumnKind("zth", ("thermal impedance",), r"zth(j[abc]|jmb)?|(transient)?thermalz"),
    ColumnKind("zth", ("thermal impedance",), "z", needs_unit=True),
    ColumnKind(SOUND_QUANTITY, ("decibel",), r"spl|dbspl|soundpressure(level)?"),
)
# names of quantities in messages, if different from the key `quantity` of the column kind
QUANTITY_LABELS = {
    "z": "|Z|", "y": "|Y|", "phase_z": "phase of Z", "phase_y": "phase of Y", "s_size": "|S11|",
    "s_phase": "phase of S11", "s_real": "Re S11", "s_imag": "Im S11", "gain_phase": "phase",
    "gain_real": "Re gain", "gain_imag": "Im gain", "zth": "Zth",
    **{name: name.upper() for name in ("r", "x", "g", "b", "c", "d", "q")},
    **{name: name.capitalize() for name in ("rp", "cp", "cs", "lp", "ls")},
}  # fmt: skip
# patterns of the titles of columns with complex numbers, keyed by quantity
COMPLEX_NAMES: dict[Quantity, str] = {
    "Z": "z", "Y": "y", "S": "s|s11|sparameters|scattering|γ|gamma"
}  # fmt: skip
# Patterns of the prime marks ' and '' after Z or Y, and the part of a complex number they denote.
# The program ZPlot writes Z'(a) and Z''(b).
PRIMES = ((r"(''|\")\s*(\(b\))?", "imag"), (r"'\s*(\(a\))?", "real"))
# words that instruments add to a title, and that do not affect its meaning
ADDED_WORDS = re.compile(
    r"trace|tr\d*|trc\d*|ch\d*|channel|data|measured|measurement|meas|value|\d+|parameter|primary|"
    r"secondary|in|log|lin|linear"
)
# channel of a measurement in the title of a column
CHANNEL_PATTERN = re.compile(r"\b(channel|ch)\s*(\d+|[a-z]\b)", re.I)
# assumed titles of columns in a file without titles, keyed by file extension
SUFFIX_TITLES = {
    ".zma": ("Frequency (Hz)", "|Z| (Ohm)", "Phase (deg)"),
    ".frd": ("Frequency (Hz)", "Gain (dB)", "Phase (deg)"),
}
# possible meanings of three columns without titles in a file whose extension has no assumed titles
UNTITLED_MEANINGS = ("frequency, R and X in Ohm", "frequency, |Z| in Ohm and phase in degrees")
# Pattern of column titles that name a trace of an instrument instead of a quantity.
# A line such as ``FORMAT: |Z|`` above the table states the quantity of the trace.
TRACE_COLUMN = re.compile(r"((data )?trace( [a-z0-9])?|formatted data)( (real|imag))?", re.I)
TRACE_FORMAT = re.compile(r"\W*format\s*:\s*(.*\S)", re.I)
# Pattern of formats that state only the scale of an axis, not the quantity of a trace.
# The quantities are then in a line such as ``MEASURE PARAMETER: IMPEDANCE MAG PHASE (DEG)``.
TRACE_SCALE = re.compile(r"lin(ear)?( [xy])?|log( [xy])?", re.I)
TRACE_NAME = re.compile(r"\W*trace\s*:\s*([ab])\W*", re.I)
TRACE_PARAMETERS = re.compile(r"\W*measure parameter\s*:\s*(.*\S)", re.I)
TWO_PARTS = re.compile(
    r"(?P<of>impedance|admittance) (?P<a>\w+) (?P<b>\w+( \(\w+\))?)|"
    r"(?P<first>\S+)\s*-\s*(?P<second>\S+)", re.I
)  # fmt: skip
# titles of the real and imaginary part of a trace with a complex format
COMPLEX_FORMATS = {"complex z": ("Re(Z) (Ohm)", "Im(Z) (Ohm)"),
                   "complex y": ("Re(Y) (S)", "Im(Y) (S)")}  # fmt: skip
# titles that do not state a quantity, and the possible quantities of their columns
UNSTATED_QUANTITIES = {
    "formatteddata": "real and imaginary parts of S11 or Z; or one real quantity and a column of "
    "zeros"
}


@dataclass(frozen=True)
class ColumnCombination:
    """Combination of two columns that determines a complex quantity.

    The function ``value`` computes the quantity from both columns (angles in rad) and the angular
    frequency w [rad/s]. If ``shunt`` is true, the quantity is the gain from a source to a resistor
    in series with the part.
    """

    columns: tuple[str, str]
    quantity: Quantity
    value: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    shunt: bool = False


COMBINATIONS = (
    ColumnCombination(("r", "x"), "Z", lambda r, x, w: r + 1j * x),
    ColumnCombination(("g", "b"), "Y", lambda g, b, w: g + 1j * b),
    ColumnCombination(("z", "phase"), "Z", lambda z, a, w: z * np.exp(1j * a)),
    ColumnCombination(("z", "phase_z"), "Z", lambda z, a, w: z * np.exp(1j * a)),
    ColumnCombination(("z", "phase_y"), "Z", lambda z, a, w: z * np.exp(-1j * a)),
    ColumnCombination(("y", "phase"), "Y", lambda y, a, w: y * np.exp(1j * a)),
    ColumnCombination(("y", "phase_y"), "Y", lambda y, a, w: y * np.exp(1j * a)),
    ColumnCombination(("y", "phase_z"), "Y", lambda y, a, w: y * np.exp(-1j * a)),
    ColumnCombination(("r", "cs"), "Z", lambda r, c, w: r - 1j / (w * c)),
    ColumnCombination(("r", "ls"), "Z", lambda r, l, w: r + 1j * w * l),
    ColumnCombination(("rp", "cp"), "Y", lambda r, c, w: 1 / r + 1j * w * c),
    ColumnCombination(("rp", "lp"), "Y", lambda r, l, w: 1 / r - 1j / (w * l)),
    ColumnCombination(("g", "cp"), "Y", lambda g, c, w: g + 1j * w * c),
    ColumnCombination(("g", "lp"), "Y", lambda g, l, w: g - 1j / (w * l)),
    ColumnCombination(("cp", "d"), "Y", lambda c, d, w: w * c * (d + 1j)),
    ColumnCombination(("cp", "q"), "Y", lambda c, q, w: w * c * (1 / q + 1j)),
    ColumnCombination(("cs", "d"), "Z", lambda c, d, w: (d - 1j) / (w * c)),
    ColumnCombination(("cs", "q"), "Z", lambda c, q, w: (1 / q - 1j) / (w * c)),
    ColumnCombination(("ls", "d"), "Z", lambda l, d, w: w * l * (d + 1j)),
    ColumnCombination(("ls", "q"), "Z", lambda l, q, w: w * l * (1 / q + 1j)),
    ColumnCombination(("lp", "d"), "Y", lambda l, d, w: (d - 1j) / (w * l)),
    ColumnCombination(("lp", "q"), "Y", lambda l, q, w: (1 / q - 1j) / (w * l)),
    ColumnCombination(("c", "d"), "Y", lambda c, d, w: w * c * (d + 1j)),
    ColumnCombination(("s_real", "s_imag"), "S", lambda a, b, w: a + 1j * b),
    ColumnCombination(("s_size", "s_phase"), "S", lambda s, a, w: s * np.exp(1j * a)),
    ColumnCombination(("gain", "phase"), "S", lambda g, a, w: g * np.exp(1j * a), shunt=True),
    ColumnCombination(("gain", "gain_phase"), "S", lambda g, a, w: g * np.exp(1j * a), shunt=True),
    ColumnCombination(("gain_real", "gain_imag"), "S", lambda a, b, w: a + 1j * b, shunt=True),
)
# quantities of a thermal transient; each needs a time column
TRANSIENT_QUANTITIES = ("temperature", "zth")
