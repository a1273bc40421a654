"""The intermediate model of a two-step reduction: small, and far more accurate than the result."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.rom.error_estimate import Judge
from kc2spice.rom.linear import Norm
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.response import Response


@dataclass(frozen=True)
class Subspace:
    """The ``response`` of a dense pencil, its largest relative error in the full model, whether all
    but its free motion has a static answer, what the error rests on, and how far rounding of the
    full model's entries moves its own responses (relative): no reduction is nearer than that.
    """

    response: Response
    error: float
    static: bool
    proof: str
    floor: float = 0.0
    whole: bool = False  # all of the full model
    hidden: float = 0.0  # Hz: supports of a free motion that resonate below do not show

    @property
    def pencil(self) -> Pencil:
        """The model itself."""
        return self.response.pencil

    @property
    def poles(self) -> np.ndarray | None:
        """Poles of the full model [1/s]; None if this model does not contain all of them."""
        known = self.whole and not self.pencil.free and not self.response.decoupled
        return self.response.poles if known else None

    def judge(self, band: tuple[float, float], norm: Norm) -> Judge:
        """Who judges smaller models by it."""
        return Judge(self.response, band, self.static and not self.pencil.free, norm)
