"""Quantities: exact decimal conversion, dimensions checked, nonsense refused."""

from contextlib import suppress
from fractions import Fraction

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from support import UsageError, convert_quantity


@pytest.mark.parametrize(
    ("text", "si", "value"),
    [
        ("50 um", "m", 50e-6),
        ("25us", "s", 25e-6),
        ("0.1 µs", "s", 1e-7),
        ("3 mm", "m", 3e-3),
        ("-2.5 mm", "m", -2.5e-3),
        ("7.85 g/cm3", "kg/m3", 7850.0),
        ("7850 kg/m³", "kg/m3", 7850.0),
        ("100 N/um", "N/m", 1e8),
        ("158.9 GPa", "Pa", 158.9e9),
        ("28.7 l", "m3", 28.7e-3),
        ("5 mL", "m3", 5e-6),
        ("5e4 A/m", "A/m", 5e4),
        ("50 A/mm", "A/m", 5e4),
        ("10 A/(m s)", "A/(m s)", 10.0),
        ("20 mA s/mm", "A s/m", 20.0),
        ("9.81 m/s^2", "m/s2", 9.81),
        ("250 kHz", "Hz", 250e3),
        ("1e3 1/s", "Hz", 1e3),
        ("200 mT", "T", 0.2),
        ("17 nΩ m", "Ohm m", 17e-9),
        ("1 %", "", 0.01),
        ("0.5", "", 0.5),
        (3, "m", 3.0),
        (2.5e-3, "m", 2.5e-3),
    ],
)
def test_converts_exactly(text, si, value):
    assert convert_quantity(text, si) == value


@given(
    st.integers(-(10**9), 10**9),
    st.sampled_from([("p", -12), ("n", -9), ("u", -6), ("m", -3), ("", 0), ("k", 3), ("M", 6)]),
)
def test_is_rounded_once(mantissa, prefix):
    """Oracle: exact rational arithmetic, whose conversion to float is correctly rounded."""
    name, exponent = prefix
    exact = Fraction(mantissa, 1000) * Fraction(10) ** exponent
    sign, digits = "-" if mantissa < 0 else "", f"{abs(mantissa):04d}"
    assert convert_quantity(f"{sign}{digits[:-3]}.{digits[-3:]} {name}V", "V") == float(exact)


@pytest.mark.parametrize(
    ("value", "si", "message"),
    [
        ("25 m", "s", "wrong unit 'm'"),
        ("1 N", "N/m", "wrong unit 'N'"),
        ("3 bananas", "m", "unknown unit"),
        ("3 m/", "m", "unknown unit"),
        ("2,5 mm", "m", "a comma in a number"),
        ("25", "s", "needs a unit"),
        ("fast", "m/s", "not a quantity"),
        ("", "m", "not a quantity"),
        (True, "m", "not a quantity"),
        (None, "m", "not a quantity"),
        ([1], "m", "not a quantity"),
        (float("nan"), "m", "not a finite number"),
        ("1e999 m", "m", "not a finite number"),
        (10**400, "m", "not a finite number"),
        ("1 " + "m" * 10_000, "m", "not a quantity"),
    ],
)
def test_refuses(value, si, message):
    with pytest.raises(UsageError, match=message) as error:
        convert_quantity(value, si, where="kick.side")
    assert error.value.where == "kick.side"
    assert error.value.expected
    assert len(str(error.value)) < 1000


@given(st.text(max_size=40))
def test_never_fails_otherwise(text):
    with suppress(UsageError):
        assert isinstance(convert_quantity(text, "m"), float)


UNITS = ["m", "kg", "s", "Hz", "F", "H", "V", "A", "Ohm", "N", "N/m", "m/s", "Pa", "K", "T", "W",
         "m2", "m3", "kg/m3", "A s/m", "K/W", "Ohm m", ""]  # fmt: skip
WORDS = ["N1", "m1", "1N", "m/", "/m", "m//s", "m^", "^2", "m^x", "m2m", "m-1", "mm mm", "µ", "°C",
         "℃", "inch", '"', "1/", "(m", "m)", "()", "m s)", "kkg", "u", "%", "N m/", "deg C",
         "volts", "micro F", "m²", "m³²", "..", "-", "to", ":", ";", ","]  # fmt: skip


@given(
    st.sampled_from(["1", "-2", "1.5", "1,5", "1e3", ".5", "1 2", "1 ..", "1:2", "0x1", "1e999"]),
    st.lists(st.sampled_from(WORDS) | st.text(max_size=3), min_size=1, max_size=4),
    st.sampled_from(["", " ", "\t"]),
    st.sampled_from(UNITS),
)
@example("1", ["N1"], " ", "m")
@settings(max_examples=400)
def test_no_odd_unit_fails_otherwise(number, words, gap, si):
    """The error proposes a correction, whose code reads the typed unit too."""
    try:
        assert isinstance(convert_quantity(f"{number}{gap}{gap.join(words)}", si), float)
    except UsageError as error:
        assert error.hint
