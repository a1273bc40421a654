"""What exists or can be made, in numbers: ranges beyond which a key is more likely a wrong unit."""

from __future__ import annotations

from collections.abc import Iterator

from kc2spice.core.errors import UsageError


def within(
    where: str, value: float, unit: str, low: float, high: float, why: str
) -> Iterator[UsageError]:
    """The error for a value outside ``low`` to ``high``, with the physical reason; else nothing."""
    if not low <= value <= high:
        yield UsageError(
            f"hardly exists: {why}", where=where, got=f"{value:.4g} {unit}",
            expected=f"{low:g} to {high:g} {unit}",
        )  # fmt: skip
