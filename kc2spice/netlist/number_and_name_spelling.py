"""Spelling of numbers and names on netlist cards, and rendering of templates."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from functools import cache
from pathlib import Path
from typing import Any

from kc2spice.core.errors import MissingToolError, UsageError

# Decay rate [1/s] of the charge on a floating node of a netlist.
# Each node that stores a charge has a leakage current, which is ``LEAK_RATE`` times the charge.
# At an operating point, the leakage currents of a floating node sum to zero, and so do its charges.
# Leakage is negligible: its ratio to the node's capacitive current is 1.6e-10 Hz / frequency.
LEAK_RATE = 1e-9
_PLAIN_EXPONENTS = str.maketrans("²³", "23")
# Number with a unit in place of the decimal point, such as 4k7, but not an exponent such as 1e5.
_INFIX_UNIT = re.compile(r"(\d+)([a-df-z][a-z]*)(\d+)", re.IGNORECASE)
_VALID_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
# Names that simulators treat as ground, time, temperature, a constant, a multiplier or a function.
RESERVED_NAMES = frozenset({"gnd", "time", "temper", "hertz", "temp", "dtemp", "pi", "m", "limit"})


def format_number(value: float) -> str:
    """Return the shortest decimal text that represents a number exactly.

    The text has at most 17 digits and no suffix letters: SPICE reads ``M`` as milli, and simulators
    differ in other letters.

    Raises
    ------
    UsageError : the value is not finite.
    """
    plain = float(value)
    if not math.isfinite(plain):
        raise UsageError(
            "this number cannot be written to a netlist", got=plain, expected="a finite number"
        )
    return repr(plain)


def split_infix_unit(text: str) -> tuple[str, str, str] | None:
    """Split a number with a prefix or unit as decimal point, such as ``4k7``.

    The result consists of the digits before the unit, the unit, and the digits after it; for ``R``
    (ohms), the unit is empty.

    Examples
    --------
    >>> split_infix_unit("4k7"), split_infix_unit("2R2"), split_infix_unit("1e5")
    (('4', 'k', '7'), ('2', '', '2'), None)
    """
    match = _INFIX_UNIT.fullmatch(text)
    if match is None:
        return None
    integer, unit, decimals = match.groups()
    return integer, "" if unit.lower() == "r" else unit, decimals


def round_to_digits(value: float) -> float:
    """Round a value to 12 significant digits, which removes rounding errors."""
    return float(f"{value:.12g}")


def format_rounded(value: float) -> str:
    """Return the text of a number with 12 significant digits."""
    return format_number(round_to_digits(value))


def require_name(text: str, *, where: str = "netlist") -> str:
    """Return a text if it is a valid name of a node, a part or a parameter.

    Raises
    ------
    UsageError : the text is not a letter followed by letters, digits and underscores.
    """
    if not is_valid_name(text):
        raise UsageError(
            "this text is not a valid name in netlists",
            where=where,
            got=repr(text),
            expected="a letter, then letters, digits or _ (64 at most), no reserved word",
            hint=f"for example {suggest_name(text)}",
        )
    return text


def is_valid_name(text: str) -> bool:
    """Return whether a text is a valid name of a node, a part or a parameter."""
    return _VALID_NAME.fullmatch(text) is not None and text.lower() not in RESERVED_NAMES


def suggest_name(text: str) -> str:
    """Return a valid name that is similar to an invalid name."""
    words = re.findall(r"\w+", text, re.ASCII)
    name = "_".join(words)[:60].strip("_")
    return name if name[:1].isalpha() and name.lower() not in RESERVED_NAMES else f"n_{name}"


def format_voltage(plus: str, minus: str) -> str:
    """Return the voltage between two nodes as an expression, such as ``v(a)-v(b)``.

    Node 0 is left out, so the expression is empty if both nodes are node 0.
    """
    return f"v({plus})" * (plus != "0") + f"-v({minus})" * (minus != "0")


def require_word(text: str) -> str:
    """Return a text if it is one printable word, such as a unit in a header.

    Raises
    ------
    UsageError : the text is not one printable word of at most 64 characters. A line break in the
        text would begin a new card of the netlist.
    """
    if not text.isprintable() or len(text.split()) != 1 or len(text) > 64:
        raise UsageError(
            "this unit contains a blank or a line break, or has more than 64 characters",
            where="netlist",
            got=repr(text[:80]),
            expected="one word, such as N/m",
            hint="write the unit without blanks",
        )
    return text


def require_distinct(
    names: Sequence[str], inner: str, *, where: str, expected: str | None = None
) -> None:
    """Reject pin names that are equal to each other or to internal nodes.

    ``inner`` is the regular expression that matches the names of internal nodes. ``expected``
    describes the accepted names in an error about an internal node.

    Raises
    ------
    UsageError : a pin has the name of another pin or of an internal node in any letter case.
    """
    low = [text.lower() for text in names]
    for text, plain in zip(names, low, strict=True):
        if low.count(plain) > 1:
            raise UsageError(
                "the subcircuit already contains this name",
                where=where,
                got=text,
                expected="names that differ in more than letter case",
                hint=f"rename one of the pins {text}",
            )
        if re.fullmatch(inner, plain):
            raise UsageError(
                "the subcircuit already contains this name, for an internal node",
                where=where,
                got=text,
                expected=expected,
                hint=f"rename {text}, for example to my_{text}",
            )


def format_comment(text: str) -> str:
    """Return a text on one line, because a line break would begin a card.

    Superscript exponents of units are replaced by plain digits.

    Examples
    --------
    >>> format_comment("a cavity\\n of 0.8 cm³")
    'a cavity of 0.8 cm3'
    """
    plain = text.translate(_PLAIN_EXPONENTS)
    return " ".join("".join(ch if ch.isprintable() else " " for ch in plain).split())


# --- templates ---


@cache
def get_template_environment(autoescape: bool = False) -> Any:
    """Return the jinja2 environment for the package's templates."""
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    package = Path(__file__).resolve().parent.parent
    places = [p / "templates" for p in (package, package.parent) if (p / "templates").is_dir()]
    if not places:
        raise MissingToolError(
            "the netlist templates are not installed", where=str(package), hint="reinstall kc2spice"
        )
    environment = Environment(
        loader=FileSystemLoader(places),
        autoescape=autoescape,
        undefined=StrictUndefined,  # a missing value causes an error, not an empty field
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        line_comment_prefix="##",
    )
    environment.filters.update(
        n=format_number, name=require_name, comment=format_comment, q=quote_string
    )
    return environment


def quote_string(text: str) -> str:
    """Return a text as a quoted string of an S-expression, as in KiCad files."""
    escaped = text.replace("\\", "\\\\").replace('"', '\\"').replace("\n", "\\n")
    return f'"{escaped}"'


def render_template(template: str, **values: object) -> str:
    """Return the text of a template with values inserted.

    The template can use four filters: ``n`` formats a number, ``name`` checks a name, ``comment``
    formats a comment, and ``q`` quotes a string of an S-expression.
    """
    return get_template_environment().get_template(template).render(**values)
