"""What a part says of itself: its laws and how they stand for it."""

from __future__ import annotations

from dataclasses import dataclass, field

from kc2spice.core.laws.pin import Law


@dataclass(frozen=True)
class Reading:
    """A result by the integrator's waves: ``sum factor wave + constant``; ``terms`` are the pairs
    ``(factor, wave)``. ``charge`` divides an ac result by ``j omega``: a current becomes a charge.
    """

    terms: tuple[tuple[float, str], ...]
    constant: float = 0.0
    charge: bool = False


def reading(wave: str, factor: float = 1.0, constant: float = 0.0) -> Reading:
    """``factor`` times one wave, plus ``constant``."""
    return Reading(((factor, wave),), constant)


def difference(plus: str, minus: str) -> Reading:
    """One wave less another."""
    return Reading(((1.0, plus), (-1.0, minus)))


@dataclass(frozen=True)
class Equations:
    """The laws of a part and how they stand for it.

    ``pins`` maps pins of the part to pins of the laws (``NAME.pin``); a pin that is missing has no
    counterpart, because another one stands for it or because it feels nothing. Two pins of the part
    may share a pin of a law: a netlist has a velocity and a displacement node where the law has one
    coordinate. ``nets`` are pins of the laws that meet inside of the part. ``results`` maps the
    part's results to waves, ``sweeps`` its keys that a dc analysis moves to the name of a source
    and its value per SI unit of the key.
    """

    laws: tuple[Law, ...] = ()
    pins: tuple[tuple[str, str], ...] = ()
    results: dict[str, Reading] = field(default_factory=dict)
    sweeps: dict[str, tuple[str, float]] = field(default_factory=dict)
    nets: tuple[tuple[str, ...], ...] = ()
