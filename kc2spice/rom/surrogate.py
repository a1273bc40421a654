"""Surrogate models equal to a full-order model over a band within rounding, for checks."""

from __future__ import annotations

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.rom.error_estimate import relative_error, relative_size
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.pencil import Pencil
from kc2spice.rom.reduce import reduce_model
from kc2spice.rom.rounding import RANDOM_TRIALS, TRIAL_FACTOR

TARGET_ERROR = 1e-10  # error of a surrogate
CHECKED_FREQUENCIES = 10  # direct solutions that measure a surrogate


def make_surrogate(
    model: LinearModel, band: tuple[float, float], *, blocks: int = 10
) -> tuple[LinearModel, float]:
    """Make a projected model that equals the full model over ``band``.

    The second result is the largest measured error of the projected model.

    The basis is built at s = 0 alone; ``CHECKED_FREQUENCIES`` direct solutions of the full model,
    spread over the band so that none repeats a sampling frequency, are compared in all port pairs.

    Raises
    ------
    SimulationError : the largest relative error exceeds ``TARGET_ERROR`` and the rounding error of
    the
        direct solutions; solve directly instead.
    """
    small = reduce_model(model, order=blocks * len(model.inputs), band=band)
    golden = (np.sqrt(5) - 1) / 2  # never a rational fraction of the band
    frequency = band[0] + (band[1] - band[0]) * np.sort(
        golden * np.arange(1, CHECKED_FREQUENCIES + 1) % 1
    )
    exact = model.transfer(frequency)
    errors = relative_size(small.transfer(frequency) - exact, exact)
    error, worst = float(errors.max()), int(errors.max(axis=(1, 2)).argmax())
    if error > TARGET_ERROR and error > _solution_rounding(
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


def _solution_rounding(pencil: Pencil, frequency: float, exact: np.ndarray) -> float:
    """Estimate rounding errors of a direct solution ``exact`` (outputs, inputs).

    The result is the largest relative change in other units of the unknowns. Responses of thin
    bodies are small differences of large forces.
    """
    rng, s = np.random.default_rng(0), np.array([2j * np.pi * frequency])
    trials = map(pencil.in_units, rng.uniform(1.0, 2.0, (RANDOM_TRIALS, pencil.size)))
    return TRIAL_FACTOR * max(relative_error(again.transfer(s), exact[None]) for again in trials)
