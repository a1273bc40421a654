"""Powers of parts and pins, which are products of two results.

A :class:`PowerTerm` contains the names of both results. :func:`add_powers` computes the powers from
the waves of a run.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kc2spice.core.domains import Power
from kc2spice.core.waveforms import Waveforms, differentiate


class PowerTerm(NamedTuple):
    """Power [W] as the product of two results.

    ``across`` is the name of the quantity across the pins, ``through`` the name of the quantity
    through the pins. The formula ``law`` depends on the domain of the pins.
    """

    across: str
    through: str
    law: Power

    @property
    def result_names(self) -> frozenset[str]:
        """Names of the results that the power depends on."""
        return frozenset({self.through} if self.law == "through" else {self.across, self.through})


def add_powers(waves: Waveforms, powers: Mapping[str, Iterable[PowerTerm]]) -> Waveforms:
    """Return the waves with the computed powers added.

    A power is the instantaneous power, or in an ``ac`` analysis the mean over a period.
    """
    result = dict(waves.data)
    for name, terms in powers.items():
        result[name] = np.asarray(sum(_compute_power(term, waves) for term in terms))
    return replace(waves, data=result)


def _compute_power(term: PowerTerm, waves: Waveforms) -> np.ndarray:
    """Compute the values of one power term at all points of the waves.

    In an ``ac`` analysis, the mean of a heat flow over a period is zero. In a dc sweep, a
    mechanical power is zero, because nothing moves at an operating point.
    """
    through = waves[term.through]
    if term.law == "through":
        return np.zeros(through.size) if np.iscomplexobj(through) else through
    across = waves[term.across]
    if term.law == "d(across)/dt * through":
        if "frequency" in waves:
            across = 2j * np.pi * waves["frequency"].real * across
        else:
            across = differentiate(across, waves["time"]) if "time" in waves else 0.0 * across
    return (across * through.conj()).real / 2 if np.iscomplexobj(through) else across * through
