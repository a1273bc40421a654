"""What a verification found: checks against gates, errors between the solutions, their times."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from kc2spice.core.figure import Figure
from kc2spice.scene.gates import Limit


@dataclass(frozen=True)
class Findings:
    """Outcome of one scene's verification.

    ``errors`` holds ``rom_vs_fom``, ``ngspice_vs_rom`` and ``ngspice_vs_fom`` (largest relative),
    ``wall_s`` the time of each stage; ``left_out`` names the parts without a law.
    """

    checks: tuple[Limit, ...]
    errors: dict[str, float]
    wall_s: dict[str, float]
    metrics: dict[str, Any]
    outputs: tuple[Any, ...] = ()
    notes: tuple[str, ...] = ()
    left_out: tuple[str, ...] = ()
    figures: tuple[Figure, ...] = field(default=(), repr=False)

    @property
    def passed(self) -> bool:
        """Whether every check is."""
        return all(check.passed for check in self.checks)
