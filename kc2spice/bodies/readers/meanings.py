"""Columns of measuring instruments: quantities, units, titles and combinations.

This module contains only data. A new kind of column is added as one row.

- :mod:`kc2spice.bodies.readers.titles` reads titles by :data:`COLUMN_KINDS` and :data:`UNITS`.
- :mod:`kc2spice.bodies.readers.text_table` reads files without titles by :data:`SUFFIX_TITLES`.
- :mod:`kc2spice.bodies.readers.complex_response` combines columns by :data:`COMBINATIONS`.
- :mod:`kc2spice.bodies.readers.thermal_transient` reads a time and one of
  :data:`TRANSIENT_QUANTITIES`.
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
# prefixes that are accepted in upper and lower case, because the other case is no other prefix
CASE_FREE_PREFIXES = "kMGT"
# Spellings of each unit, keyed by measured quantity, with the SI value of the unit. Titles with a
# capital letter are matched case-sensitively; all others ignore case.
UNITS: dict[str, dict[str, float]] = {
    "frequency": {"hz": 1.0, "hertz": 1.0, "rad/s": 0.5 / np.pi, "rads": 0.5 / np.pi},
    # in a wrong code page, the letter omega is read as an O
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
REPLACED_LETTERS = {"O": "Ohm"}  # wrong letters of units in titles, and the correct units
DEFAULT_UNITS = {
    "frequency": "Hz", "impedance": "Ohm", "admittance": "S", "capacitance": "F",
    "inductance": "H", "angle": "deg", "decibel": "dB", "number": "",
    "time": "s", "temperature": "K", "thermal impedance": "K/W",
}  # fmt: skip
# units without prefixes
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
# columns of phases, which are within one turn for passive parts
PASSIVE_PHASES = ("phase", "phase_z", "phase_y", "gain_phase")
MAX_PHASE = 2.02 * np.pi  # rad: one turn plus 1 % for noise
# An angle without a unit is in rad if its largest magnitude is at most the first value and its
# range is above the second value.
RADIAN_LIMITS = 0.51 * np.pi, 0.5


@dataclass(frozen=True)
class ColumnKind:
    """Kind of column: its quantity, and the pattern of its title.

    ``measures`` are the kinds of units that the column may have; the first is the default.
    ``names`` is the pattern of the title in small letters, without sign, unit, blanks and words
    that instruments add. If ``needs_unit`` is true, the title alone does not identify the column.
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
    """Return the pattern of a word before or after a letter, as in ``magz`` and ``zmag``."""
    return rf"{of}{word}|{word}{of}|{word}\|{of}\|"


_SITE_PATTERN = r"(j|junction|c|case)"  # location of a temperature
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
    ColumnKind("phase_z", ("angle",), "z", needs_unit=True),  # Impedance (Degree)
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
# Names of quantities in messages, where they differ from the names of the columns.
QUANTITY_LABELS = {
    "z": "|Z|", "y": "|Y|", "phase_z": "phase of Z", "phase_y": "phase of Y", "s_size": "|S11|",
    "s_phase": "phase of S11", "s_real": "Re S11", "s_imag": "Im S11", "gain_phase": "phase",
    "gain_real": "Re gain", "gain_imag": "Im gain", "zth": "Zth",
    **{name: name.upper() for name in ("r", "x", "g", "b", "c", "d", "q")},
    **{name: name.capitalize() for name in ("rp", "cp", "cs", "lp", "ls")},
}  # fmt: skip
COMPLEX_NAMES: dict[Quantity, str] = {
    "Z": "z", "Y": "y", "S": "s|s11|sparameters|scattering|γ|gamma"
}  # fmt: skip
# Primes after Z or Y, and whether they denote the real or the imaginary part. ZPlot writes Z'(a)
# and Z''(b).
PRIMES = ((r"(''|\")\s*(\(b\))?", "imag"), (r"'\s*(\(a\))?", "real"))
# Words that instruments add to a title.
ADDED_WORDS = re.compile(
    r"trace|tr\d*|trc\d*|ch\d*|channel|data|measured|measurement|meas|value|\d+|parameter|primary|"
    r"secondary|in|log|lin|linear"
)
# channel to which a column belongs
CHANNEL_PATTERN = re.compile(r"\b(channel|ch)\s*(\d+|[a-z]\b)", re.I)
# Default titles of a table without titles, keyed by file suffix.
SUFFIX_TITLES = {
    ".zma": ("Frequency (Hz)", "|Z| (Ohm)", "Phase (deg)"),
    ".frd": ("Frequency (Hz)", "Gain (dB)", "Phase (deg)"),
}
# possible meanings of three columns without titles in any other file
UNTITLED_MEANINGS = ("frequency, R and X in Ohm", "frequency, |Z| in Ohm and phase in degrees")
# Columns of a trace whose quantity is stated in a line ``FORMAT: |Z|`` above the table.
TRACE_COLUMN = re.compile(r"((data )?trace( [a-z0-9])?|formatted data)( (real|imag))?", re.I)
TRACE_FORMAT = re.compile(r"\W*format\s*:\s*(.*\S)", re.I)
# A format that is only the scale of an axis. Then a line above all traces contains the quantities
# of traces A and B, such as ``MEASURE PARAMETER: IMPEDANCE MAG PHASE (DEG)``.
TRACE_SCALE = re.compile(r"lin(ear)?( [xy])?|log( [xy])?", re.I)
TRACE_NAME = re.compile(r"\W*trace\s*:\s*([ab])\W*", re.I)
TRACE_PARAMETERS = re.compile(r"\W*measure parameter\s*:\s*(.*\S)", re.I)
TWO_PARTS = re.compile(
    r"(?P<of>impedance|admittance) (?P<a>\w+) (?P<b>\w+( \(\w+\))?)|"
    r"(?P<first>\S+)\s*-\s*(?P<second>\S+)", re.I
)  # fmt: skip
COMPLEX_FORMATS = {"complex z": ("Re(Z) (Ohm)", "Im(Z) (Ohm)"),
                   "complex y": ("Re(Y) (S)", "Im(Y) (S)")}  # fmt: skip
# columns without a quantity, and their possible quantities
UNSTATED_QUANTITIES = {
    "formatteddata": "real and imaginary part of S11 or Z; or one real quantity beside zeros"
}


@dataclass(frozen=True)
class Combination:
    """Columns that determine a ``quantity``: angles in rad, w in rad/s.

    If ``shunt`` is true, the value is the gain from a source to a resistor in series with the part.
    """

    columns: tuple[str, str]
    quantity: Quantity
    value: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
    shunt: bool = False


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
    Combination(("gain", "phase"), "S", lambda g, a, w: g * np.exp(1j * a), shunt=True),
    Combination(("gain", "gain_phase"), "S", lambda g, a, w: g * np.exp(1j * a), shunt=True),
    Combination(("gain_real", "gain_imag"), "S", lambda a, b, w: a + 1j * b, shunt=True),
)
# quantities of a thermal transient; each needs a time column
TRANSIENT_QUANTITIES = ("temperature", "zth")
