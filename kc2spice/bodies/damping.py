"""Rayleigh damping of a body, as its user states it."""

from __future__ import annotations

import math

from pydantic import Field, model_validator

from kc2spice.core.quantities import Frequency, Rate, Ratio, Section


class Damping(Section):
    """``E = alpha M + beta K`` with the elastic stiffness K: ``ratio`` of critical damping at the
    frequency ``at`` by stiffness, ``alpha`` on the mass. Without keys there is none.
    """

    ratio: Ratio = Field(0.0, ge=0)
    at: Frequency | None = Field(None, gt=0)
    alpha: Rate = Field(0.0, ge=0)

    @model_validator(mode="after")
    def _frequency(self) -> Damping:
        if self.ratio and self.at is None:
            raise ValueError("a damping ratio needs the frequency `at` which it is met")
        return self

    @property
    def rayleigh(self) -> tuple[float, float]:
        """alpha [1/s] and beta [s]: ``ratio = beta omega / 2`` at ``omega = 2 pi at``."""
        return self.alpha, 0.0 if self.at is None else self.ratio / (math.pi * self.at)
