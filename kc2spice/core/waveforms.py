"""What a simulation gives back."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Waveforms:
    """SI arrays over one scale (``time`` or ``frequency``), named as in ``waveforms.npz``.

    ``stats`` holds what the simulator said of itself: ``accepted`` and ``rejected`` time points,
    ``iterations``, ``cpu_s``.
    """

    data: dict[str, np.ndarray]
    stats: dict[str, float]

    def __getitem__(self, name: str) -> np.ndarray:
        return self.data[name]

    def __contains__(self, name: str) -> bool:
        return name in self.data

    def __iter__(self) -> Iterator[str]:
        return iter(self.data)


def running(values: np.ndarray, over: np.ndarray) -> np.ndarray:
    """Running trapezoidal integral (..., n) of ``values`` d ``over``, zero at the first point."""
    steps = (values[..., 1:] + values[..., :-1]) / 2 * np.diff(over)
    start = np.zeros((*np.shape(steps)[:-1], 1))
    return np.concatenate([start, np.cumsum(steps, axis=-1)], axis=-1)
