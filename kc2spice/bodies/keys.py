"""Keys that all parametric bodies share: damping and the mesh."""

from __future__ import annotations

import math
from collections.abc import Sequence

from pydantic import Field, model_validator
from scipy import sparse

from kc2spice.core.quantities import Count, Frequency, Rate, Ratio, Section


class Mesh(Section):
    """``refine`` divides every cell along each axis."""

    refine: Count = Field(1, ge=1, le=8)


class Damping(Section):
    """Viscous damping matrix E.

    ``E = alpha M + beta K`` with ``beta = 2 zeta / omega`` so that the ratio ``zeta`` (or the
    quality ``Q = 1/(2 zeta)``) is met at ``at``, by default the body's first resonance. With
    ``per_material`` it is the sum of ``K_i/(Q_i omega)`` over the materials i instead.
    """

    ratio: Ratio | None = Field(None, ge=0)
    quality: Ratio | None = Field(None, gt=0)
    per_material: bool = False
    at: Frequency | None = Field(None, gt=0)
    alpha: Rate = Field(0.0, ge=0)

    @model_validator(mode="after")
    def _one(self) -> Damping:
        given = [self.ratio is not None, self.quality is not None, self.per_material]
        if sum(given) > 1:
            raise ValueError("give one of ratio, quality, per_material")
        return self

    @property
    def zeta(self) -> float:
        """Damping ratio at ``at``; 1 % where nothing is given."""
        if self.quality is not None:
            return 0.5 / self.quality
        return 0.01 if self.ratio is None else self.ratio

    def beta(self, resonance_hz: float) -> float:
        """Stiffness coefficient [s] of ``E = alpha M + beta K``: ``2 zeta/omega``."""
        return self.zeta / (math.pi * (self.at or resonance_hz))

    def matrix(
        self,
        M: sparse.csc_array,
        K: sparse.csc_array,
        parts: Sequence[sparse.csc_array],
        qualities: Sequence[float],
        resonance_hz: float,
    ) -> sparse.csc_array:
        """E of a model with stiffness K, whose ``parts`` belong to materials of ``qualities``."""
        E = self.alpha * M
        if not self.per_material:
            return (E + self.beta(resonance_hz) * K).tocsc()
        omega = 2 * math.pi * (self.at or resonance_hz)
        for part, quality in zip(parts, qualities, strict=True):
            E = E + part / (quality * omega)
        return E.tocsc()
