"""How numbers and names are spelled on a netlist card."""

from __future__ import annotations

import math
import re

from kc2spice.errors import UsageError

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,63}")
# Simulators read these as ground, clock, temperature, a constant, a multiplier, a function.
_RESERVED = frozenset({"gnd", "time", "temper", "hertz", "temp", "dtemp", "pi", "m", "limit"})


def number(value: float) -> str:
    """The shortest decimal text (17 significant digits at most) that reads back as ``value``.

    There are no suffix letters: SPICE reads ``M`` as milli, LTspice and others disagree on more.

    Raises
    ------
    UsageError : the value is not finite.
    """
    plain = float(value)
    if not math.isfinite(plain):
        raise UsageError("a netlist cannot hold this number", got=plain, expected="a finite number")
    return repr(plain)


def name(text: str, *, where: str = "netlist") -> str:
    """``text`` if it may stand as a node, part or parameter name; netlists are programs.

    Raises
    ------
    UsageError : anything but a letter followed by letters, digits and underscores.
    """
    if _NAME.fullmatch(text) is None or text.lower() in _RESERVED:
        raise UsageError(
            "not a netlist name",
            where=where,
            got=repr(text),
            expected="a letter, then letters, digits or _ (64 at most), no reserved word",
        )
    return text


def comment(text: str) -> str:
    """``text`` on one line, so that no word of it can ever become a card."""
    return " ".join("".join(ch if ch.isprintable() else " " for ch in text).split())
