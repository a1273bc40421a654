"""What a verification found: checks against gates, errors between the solutions, their times."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from kc2spice.core.figure import Figure
from kc2spice.report.plots import Picture
from kc2spice.scene.gates import Cost, Limit


@dataclass(frozen=True)
class Findings:
    """Outcome of one scene's verification.

    ``errors`` holds ``rom_vs_fom``, ``ngspice_vs_rom`` and ``ngspice_vs_fom`` (largest relative),
    ``speedup`` the ratios ``refactor`` and ``low_rank`` of a full-model baseline's time to the
    netlist's, where the scene has them; ``left_out`` names the parts without a law. ``shipped``
    tells whether the scene is the gallery's own, of which the paper prints figures.
    """

    checks: tuple[Limit, ...]
    errors: dict[str, float]
    speedup: dict[str, float]
    costs: tuple[Cost, ...]
    metrics: dict[str, Any]
    outputs: tuple[Any, ...] = ()
    notes: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    shipped: bool = False
    figures: tuple[Figure, ...] = field(default=(), repr=False)
    pictures: tuple[Picture, ...] = ()

    @property
    def passed(self) -> bool:
        """Whether every check is."""
        return all(check.passed for check in self.checks)
