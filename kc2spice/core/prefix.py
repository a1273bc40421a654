"""SI prefixes of printed numbers."""

from __future__ import annotations

import math

PREFIXES = {-18: "a", -15: "f", -12: "p", -9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G"}


def prefix_power(value: float) -> int:
    """Exponent of the SI prefix of a number, 0 where there is no such prefix.

    Examples
    --------
    >>> prefix_power(4.7e-6)
    -6
    """
    power = 3 * math.floor(math.log10(abs(value)) / 3) if value else 0
    return power if power in PREFIXES else 0
