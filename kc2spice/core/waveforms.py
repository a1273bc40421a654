"""What a simulation gives back."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np


class Waves(dict[str, np.ndarray]):
    """Arrays by name. The rings of a stack were called ``R0``, ``R1``, … before they were called
    ``ring0``, ``ring1``, …: a name that is missing is read that way."""

    def __missing__(self, name: str) -> np.ndarray:
        today = re.sub(r"\bR(\d{1,3})\b", r"ring\1", name)
        if today == name:
            raise KeyError(name)
        return self[today]

    def __contains__(self, name: object) -> bool:
        return self.get(str(name)) is not None

    def get(self, name: str, default: np.ndarray | None = None) -> np.ndarray | None:  # type: ignore[override]
        """The array, or ``default`` where there is none."""
        try:
            return self[name]
        except KeyError:
            return default

    def former(self) -> dict[str, np.ndarray]:
        """Arrays of rings under their former names."""
        names = {name: re.sub(r"\bring(\d{1,3})\b", r"R\1", name) for name in self}
        return {old: self[name] for name, old in names.items() if old != name}


@dataclass(frozen=True)
class Waveforms:
    """SI arrays over one scale (``time`` or ``frequency``), named as in ``waveforms.npz``.

    ``stats`` holds what the simulator said of itself: ``accepted`` and ``rejected`` time points,
    ``iterations``, ``cpu_s``.
    """

    data: dict[str, np.ndarray]
    stats: dict[str, float]

    def __post_init__(self) -> None:
        object.__setattr__(self, "data", Waves(self.data))

    def __getitem__(self, name: str) -> np.ndarray:
        return self.data[name]

    def __contains__(self, name: str) -> bool:
        return name in self.data

    def __iter__(self) -> Iterator[str]:
        return iter(self.data)
