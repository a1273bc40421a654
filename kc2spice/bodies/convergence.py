"""What the mesh is worth: a bound on the error of a body's fact from one finer mesh."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from kc2spice.rom.linear import LinearModel


def mesh_error(
    build: Callable[..., LinearModel],
    keys: Mapping[str, Any] | Any,
    fact: str = "resonance_short_hz",
    refine: int = 2,
) -> float:
    """Relative mesh error of ``fact`` on the mesh that ``keys`` ask for.

    With an error ``c h^p`` of order p >= 1 (1 at the corners of electrodes and layers, 4 for
    smooth modes) values on cells h and h/k give ``|f(h) - f| <= |f(h) - f(h/k)|/(1 - 1/k)``.
    """
    coarse, fine = build(keys).facts[fact], build(keys, refine=refine).facts[fact]
    return abs(coarse - fine) / (1 - 1 / refine) / abs(fine)
