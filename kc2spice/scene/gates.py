"""What ``verify`` asks of parts: gates of their results."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from kc2spice.scene.settings import Solver

PAIRS = ("rom_vs_fom", "ngspice_vs_rom", "ngspice_vs_fom")
Measure = Literal["relative", "absolute", "travel", "largest", "spectral"]


def stepping(solver: Solver) -> float:
    """Gate of motion in ngspice against the same laws, relative.

    At the usual tolerances 1e-5 to 3e-5 are found; errors fall as ``(reltol chgtol)^0.55``.
    """
    return float(4e-5 * (solver.reltol * solver.chgtol / 1e-12) ** 0.55)


@dataclass(frozen=True)
class Limit:
    """A number against its gate. ``value`` None (not reached) fails."""

    name: str
    value: float | None
    limit: float
    unit: str = "1"

    @property
    def passed(self) -> bool:
        """Whether the value is within the limit; False for what is no number."""
        return self.value is not None and self.value <= self.limit


@dataclass(frozen=True)
class Gate:
    """How far two solutions may differ in one result.

    ``of`` is a metric or waves by name (a prefix ends with ``*``); ``limits`` has the largest
    difference for each pair of solutions, and ``measure`` says what of it:

    * *relative*: each value by its own size (arrays: where it exceeds 1e-6 of the largest);
    * *absolute*: in ``unit``; *travel*: by the swing of the wave;
    * *largest*: by the largest value of all waves together;
    * *spectral*: each entry of a response by its size, at least 1e-6 of its peak.

    ``share`` is the part of the scale, from its start on, that is looked at; ``leads`` says whether
    it stands for the scene in ``errors``.
    """

    words: str
    of: str
    limits: Mapping[str, float]
    measure: Measure = "relative"
    unit: str = "1"
    leads: bool = False
    share: float = 1.0
