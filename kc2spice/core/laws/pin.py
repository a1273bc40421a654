"""Pins of laws, and what all laws have in common."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

MECHANICAL = ("displacement", "rotation")
GROUND = "gnd"


@dataclass(frozen=True)
class Pin:
    """A named pin; one that is ``grounded`` lies on the reference where nothing else is joined."""

    name: str
    kind: str
    grounded: bool = False


class Law(Protocol):
    """What all laws have in common."""

    @property
    def name(self) -> str:
        """Name of the part."""
        ...

    @property
    def pins(self) -> tuple[Pin, ...]:
        """Pins in the order of the part."""
        ...
