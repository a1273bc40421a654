"""Netlists as data: pins, parameters and subcircuits."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

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


@dataclass(frozen=True, repr=False)
class Subcircuit:
    """One part: its ``.subckt``, pin table and the text of its library file.

    ``file`` is the name of that file where it is not ``NAME.lib``. ``no_module`` says why it must
    not become a Verilog-A module, "" where it may.
    """

    name: str
    pins: tuple[Pin, ...]
    params: tuple[Param, ...]
    text: str
    file: str = ""
    no_module: str = ""

    @property
    def filename(self) -> str:
        """Name of the library file that holds this part."""
        return self.file or f"{self.name}.lib"

    def write(self, path: str | Path) -> Path:
        """Write the library file to ``path``, or under its own name into the directory ``path``."""
        path = Path(path)
        if path.is_dir():
            path = path / self.filename
        path.write_text(self.text, encoding="utf-8")
        return path

    def __repr__(self) -> str:
        pins = " ".join(f"{pin.name}[{pin.unit}/{pin.flow}]" for pin in self.pins)
        params = " ".join(f"{param.name}={param.default:g}" for param in self.params)
        return f"<Subcircuit {self.name}: pins {pins}{'; ' + params if params else ''}>"


def positive(name: str, default: float, unit: str, doc: str) -> Param:
    """A parameter that must stay above zero."""
    return Param(name, default, unit, doc, low=LEAST)
