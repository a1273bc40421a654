"""What the mesh is worth: a bound on the error of a body's fact from one finer mesh."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from kc2spice.rom.linear import LinearModel

HEADLINES = ("resonance_short_hz", "resonance_hz", "capacitance_free_f")


@dataclass(frozen=True)
class MeshError:
    """Relative mesh error of a body's headline ``fact``; None where finding it takes too long.

    ``seconds`` is what it took, or would have.
    """

    fact: str
    error: float | None
    seconds: float


def headline_error(
    build: Callable[[int], LinearModel], limit: float, growth: float
) -> MeshError | None:
    """Mesh error of the first of :data:`HEADLINES` that the body has; None if it has none.

    ``build(refine)`` gives the full model with every cell divided by ``refine``; the finer mesh is
    left out where ``growth`` times the time of the coarse one is more than ``limit`` [s].
    """
    start = time.process_time()
    coarse = build(1).facts
    expected = growth * (time.process_time() - start)
    fact = next((name for name in HEADLINES if name in coarse), None)
    if fact is None:
        return None
    if expected > limit:
        return MeshError(fact, None, expected)
    fine = build(2).facts[fact]
    return MeshError(fact, bound(coarse[fact], fine, 2), time.process_time() - start)


def bound(coarse: float, fine: float, refine: int) -> float:
    """Relative error of ``coarse``, a value on cells h, by that on cells h/refine.

    With an error ``c h^p`` of order p >= 1 (1 at the corners of electrodes and layers, 4 for
    smooth modes), ``|f(h) - f| <= |f(h) - f(h/k)|/(1 - 1/k)``.
    """
    return abs(coarse - fine) / (1 - 1 / refine) / abs(fine)
