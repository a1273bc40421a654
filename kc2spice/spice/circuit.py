"""Netlists as data: pins, parameters and subcircuits."""

from __future__ import annotations

import math
from dataclasses import dataclass

LEAST = 1e-30  # what "above zero" means for a parameter


@dataclass(frozen=True)
class Pin:
    """One pin of a subcircuit: what 1 V and 1 A on it mean (``flow="-"`` for a signal pin)."""

    name: str
    unit: str
    flow: str


@dataclass(frozen=True)
class Param:
    """A subcircuit parameter with its default in ``unit``, a word of explanation and its range."""

    name: str
    default: float
    unit: str
    doc: str
    low: float = -math.inf
    high: float = math.inf


@dataclass(frozen=True)
class Subcircuit:
    """One part: its ``.subckt``, pin table and the text of its library file.

    ``file`` is the name of that file where it is not ``NAME.lib``.
    """

    name: str
    pins: tuple[Pin, ...]
    params: tuple[Param, ...]
    text: str
    file: str = ""

    @property
    def filename(self) -> str:
        """Name of the library file that holds this part."""
        return self.file or f"{self.name}.lib"


def positive(name: str, default: float, unit: str, doc: str) -> Param:
    """A parameter that must stay above zero."""
    return Param(name, default, unit, doc, low=LEAST)
