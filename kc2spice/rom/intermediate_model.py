"""Intermediate model of a two-step reduction: small and very accurate."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.rom.error_estimate import ErrorEstimator, make_inaccuracy_error
from kc2spice.rom.linear_model import Norm
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.response import Response


@dataclass(frozen=True, eq=False)
class IntermediateModel:
    """Accurate dense model that replaces the full model during a reduction.

    Reductors start from this model, and errors of reduced models are estimated by comparison with
    this model.

    Parameters
    ----------
    response : Response
        Frequency response of the model.
    error : float
        Largest relative error of the response, compared with the full-order model.
    static : bool
        Whether the model without rigid-body modes has a static response.
    proof : str
        Evidence for ``error``, for the certificate.
    floor : float
        Smallest possible error of a reduced model: the relative change of the response due to
        rounding errors of entries of the full-order model.
    complete : bool
        Whether this model is the full-order model in other coordinates.
    hidden : float
        Frequency [Hz] below which the stiffness matrix cannot represent the resonance of a body on
        a support, because of rounding errors.
    basis : (n, k) array, optional
        Column k expresses the unknown k of this model in the unknowns of the full-order model.
    points : tuple of floats
        Frequencies [Hz] at which the full-order model was factorised to compute the basis.
    """

    response: Response
    error: float
    static: bool
    proof: str
    floor: float = 0.0
    complete: bool = False
    hidden: float = 0.0
    basis: np.ndarray | None = None
    points: tuple[float, ...] = ()

    @property
    def pencil(self) -> Pencil:
        """Pencil (matrix polynomial) of the intermediate model."""
        return self.response.pencil

    @property
    def poles(self) -> np.ndarray | None:
        """Poles [1/s] of the full-order model, or None if not all poles are known."""
        known = (
            self.complete and not self.pencil.free and not self.response.has_decoupling_congruence
        )
        return self.response.poles if known else None

    def make_estimator(self, band: tuple[float, float], norm: Norm) -> ErrorEstimator:
        """Return an estimator that compares reduced models with this model."""
        return ErrorEstimator(self.response, band, self.static and not self.pencil.free, norm)


def make_no_convergence_error(
    response: Response, band: tuple[float, float], error: float, limit: float
) -> SimulationError:
    """Make the exception for a Krylov method that does not converge."""
    modes = response.select_band_resonances(band)[0].size
    return make_inaccuracy_error(
        "the reduced model does not converge with increasing order",
        f"relative error {error:.1e} with {response.pencil.size} states; the band contains at "
        f"least {modes} resonances",
        limit,
        "narrow the band or increase the tolerance",
    )
