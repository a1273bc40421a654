"""Surrogate models that agree with a full model within rounding errors."""

from __future__ import annotations

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.rom.error_estimate import compute_relative_error, compute_relative_errors
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.reduce import reduce_model
from kc2spice.rom.rounding import RANDOM_TRIALS, TRIAL_FACTOR

TARGET_ERROR = 1e-10  # largest relative error of a surrogate model
CHECKED_FREQUENCIES = 10  # number of direct solutions that check a surrogate model


def make_surrogate(
    model: LinearModel, band: tuple[float, float], *, blocks: int = 10
) -> tuple[LinearModel, float]:
    """Reduce a full model in ``band`` [Hz]; return the surrogate and its error.

    The surrogate model is a projection on Krylov vectors at s = 0. The full model is solved
    directly at ``CHECKED_FREQUENCIES`` irregularly spaced frequencies in the band. The second
    result is the largest relative error of the surrogate model at these frequencies.

    Raises
    ------
    SimulationError : the largest relative error exceeds both ``TARGET_ERROR`` and the rounding
        error of the direct solutions. If the function raises a ``SimulationError``, the caller must
        solve the full model.
    """
    small = reduce_model(model, order=blocks * len(model.inputs), band=band)
    golden = (np.sqrt(5) - 1) / 2  # irrational, so that the frequencies are irregularly spaced
    frequency = band[0] + (band[1] - band[0]) * np.sort(
        golden * np.arange(1, CHECKED_FREQUENCIES + 1) % 1
    )
    exact = model.transfer(frequency)
    errors = compute_relative_errors(small.transfer(frequency) - exact, exact)
    error, worst = float(errors.max()), int(errors.max(axis=(1, 2)).argmax())
    if error > TARGET_ERROR and error > _estimate_solution_rounding(
        model.pencil, frequency[worst], exact[worst]
    ):
        raise SimulationError(
            "the reduced model misses the tolerance",
            where="harmonic reference",
            got=f"largest relative error {error:.1e} with {small.order} states",
            expected=f"at most {TARGET_ERROR:g}",
            hint="repeat the command with --full, which solves at every frequency",
        )
    return small, error


def _estimate_solution_rounding(pencil: Pencil, frequency: float, exact: np.ndarray) -> float:
    """Estimate the relative rounding error of the direct solution ``exact``.

    The result is :data:`TRIAL_FACTOR` times the largest relative change of the solution in trials
    in which random factors scale the unknowns. Thin bodies have large rounding errors, because
    their elastic forces are small differences of large forces.
    """
    rng, s = np.random.default_rng(0), np.array([2j * np.pi * frequency])
    trials = map(pencil.rescale_unknowns, rng.uniform(1.0, 2.0, (RANDOM_TRIALS, pencil.size)))
    return TRIAL_FACTOR * max(
        compute_relative_error(scaled_pencil.transfer(s), exact[None]) for scaled_pencil in trials
    )
