"""All frequencies of the full model from a few direct solves: a basis certified against them."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.reduce import reduce
from kc2spice.rom.response import relative_error

BLOCKS = 10  # Krylov blocks at s0 = 0: rounding level over the paper's band takes eight
LIMIT = 1e-10
CHECKS = 10


@dataclass(frozen=True)
class Surrogate:
    """A small ``model`` that equals a full one within ``error``, the largest of ``solved`` direct
    solutions of ``seconds`` each."""

    model: LinearModel
    error: float
    solved: int
    seconds: float


def surrogate(
    model: LinearModel, band: tuple[float, float], *, blocks: int = BLOCKS, checks: int = CHECKS
) -> Surrogate:
    """A projected model that equals the full one over ``band``, and its largest measured error.

    The basis is built at s = 0 alone; ``checks`` direct solutions of the full model, spread over
    the band so that none repeats a sampling frequency, are compared in all port pairs.

    Raises
    ------
    SimulationError : the largest relative error exceeds ``LIMIT``; solve directly instead.
    """
    small = reduce(model, order=blocks * len(model.inputs), band=band)
    golden = (np.sqrt(5) - 1) / 2  # never a rational fraction of the band
    frequency = band[0] + (band[1] - band[0]) * np.sort(golden * np.arange(1, checks + 1) % 1)
    started = time.perf_counter()
    direct = model.transfer(frequency)
    seconds = (time.perf_counter() - started) / checks
    error = relative_error(small.transfer(frequency), direct)
    if error > LIMIT:
        raise SimulationError(
            "the basis cannot replace the full model",
            where="harmonic reference",
            got=f"largest relative error {error:.1e} with {small.order} states",
            expected=f"at most {LIMIT:g}",
            hint="narrow the band, or solve the full model at every frequency",
        )
    return Surrogate(small, error, checks, seconds)
