"""Spelling of numbers and names on netlist cards, and templates."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from kc2spice.core.errors import MissingToolError, UsageError

#: : 1/s, at which a floating charge decays in a netlist. A node that stores charge has a leak of
# this rate times : its charge, so that the currents sum to zero at an operating point where the
# charges do, and of : the current in it a share of 1.6e-10 Hz / f, whatever the capacitance.
LEAK_RATE = 1e-9
# A unit in place of the decimal point, such as 4k7, but no exponent such as 1e5.
_INFIX = re.compile(r"(\d+)([a-df-z][a-z]*)(\d+)", re.IGNORECASE)
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
# Simulators read these as ground, clock, temperature, a constant, a multiplier, a function.
_RESERVED = frozenset({"gnd", "time", "temper", "hertz", "temp", "dtemp", "pi", "m", "limit"})


def number(value: float) -> str:
    """Return the shortest decimal text that reads back as ``value``.

    The number has at most 17 digits and no suffix letters: SPICE reads ``M`` as milli, and
    simulators disagree on further letters.

    Raises
    ------
    UsageError : the value is not finite.
    """
    plain = float(value)
    if not math.isfinite(plain):
        raise UsageError("a netlist cannot hold this number", got=plain, expected="a finite number")
    return repr(plain)


def split_infix_unit(text: str) -> tuple[str, str, str] | None:
    """Split a number whose unit stands in place of its decimal point; None of any other text.

    The parts are the digits before the unit, the unit without ``R`` for ohms, and the digits
    behind it.

    Examples
    --------
    >>> split_infix_unit("4k7"), split_infix_unit("2R2"), split_infix_unit("1e5")
    (('4', 'k', '7'), ('2', '', '2'), None)
    """
    match = _INFIX.fullmatch(text)
    if match is None:
        return None
    integer, unit, decimals = match.groups()
    return integer, "" if unit.lower() == "r" else unit, decimals


def round_to_digits(value: float) -> float:
    """Return a value with 12 significant digits, without rounding errors of arithmetic."""
    return float(f"{value:.12g}")


def write_rounded(value: float) -> str:
    """Return the text of a number with 12 significant digits."""
    return number(round_to_digits(value))


def name(text: str, *, where: str = "netlist") -> str:
    """Return ``text`` if it is a valid name of a node, a part or a parameter.

    Raises
    ------
    UsageError : anything but a letter followed by letters, digits and underscores.
    """
    if _NAME.fullmatch(text) is None or text.lower() in _RESERVED:
        expected = "a letter, then letters, digits or _ (64 at most), no reserved word"
        raise UsageError("not a netlist name", where=where, got=repr(text), expected=expected)
    return text


def voltage_between(plus: str, minus: str) -> str:
    """Return the vector of the voltage from one net to another, empty if both are ground."""
    return f"v({plus})" * (plus != "0") + f"-v({minus})" * (minus != "0")


def word(text: str) -> str:
    """Return ``text`` if it is one printable word, such as a unit in a header.

    Raises
    ------
    UsageError : anything else; a line break in it would begin a card.
    """
    if not text.isprintable() or len(text.split()) != 1 or len(text) > 64:
        raise UsageError(
            "not a unit: it contains a blank, a line break or more than 64 characters",
            where="netlist",
            got=repr(text[:80]),
            expected="one word, such as N/m",
            hint="write the unit without blanks",
        )
    return text


def require_distinct(names: Sequence[str], inner: str, *, where: str) -> None:
    """Check that pin names differ in more than case and match no internal node.

    ``inner`` is the pattern of the internal nodes of the subcircuit.

    Raises
    ------
    UsageError : a name that would tie two nodes to each other.
    """
    low = [text.lower() for text in names]
    for text, plain in zip(names, low, strict=True):
        if low.count(plain) > 1 or re.fullmatch(inner, plain):
            raise UsageError(
                "this name is taken in the subcircuit",
                where=where,
                got=text,
                expected="names of ports that differ in more than case",
                hint="rename the port",
            )


def comment(text: str) -> str:
    """Return ``text`` on one line, so that no part of it becomes a card."""
    return " ".join("".join(ch if ch.isprintable() else " " for ch in text).split())


# --- templates ---


@cache
def templates(autoescape: bool = False) -> Any:
    """Return the renderer of the templates of a wheel or of the repository."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    package = Path(__file__).resolve().parent.parent
    places = [p / "templates" for p in (package, package.parent) if (p / "templates").is_dir()]
    if not places:
        problem = "the netlist templates are not installed"
        raise MissingToolError(problem, where=str(package), hint="reinstall kc2spice")
    environment = Environment(
        loader=FileSystemLoader(places),
        autoescape=autoescape,
        undefined=StrictUndefined,  # a missing value is an error, never an empty field
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        line_comment_prefix="##",
    )
    environment.filters.update(n=number, name=name, comment=comment, q=quote)
    return environment


def quote(text: str) -> str:
    """Return ``text`` as a string of an S-expression."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'


def render(template: str, **values: object) -> str:
    """Return the text of a template with its values.

    Filters are ``n`` (number), ``name`` (checked), ``comment`` and ``q`` (a string of an
    S-expression).
    """
    return templates().get_template(template).render(**values)
