"""Netlists as data: pins, parameters and subcircuits."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Pin:
    """One pin of a subcircuit: what 1 V and 1 A on it mean (``flow="-"`` for a signal pin)."""

    name: str
    unit: str
    flow: str


@dataclass(frozen=True)
class Param:
    """A subcircuit parameter with its default in ``unit`` and a word of explanation."""

    name: str
    default: float
    unit: str
    doc: str


@dataclass(frozen=True)
class Subcircuit:
    """One part: exactly one ``.subckt``, its pin table and the text of its library file."""

    name: str
    pins: tuple[Pin, ...]
    params: tuple[Param, ...]
    text: str
    file: str | None = None

    @property
    def filename(self) -> str:
        """Name of the library file that holds this part."""
        return self.file or f"{self.name}.lib"
