"""Names of objects such as ports, pins, parts and branches."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol


class NamedObject(Protocol):
    """Protocol of all objects that have a name."""

    @property
    def name(self) -> str:
        """Name of the object in a scene or in a netlist."""


def list_names(items: Iterable[NamedObject]) -> list[str]:
    """Return the names of the given objects in the same order."""
    return [item.name for item in items]
