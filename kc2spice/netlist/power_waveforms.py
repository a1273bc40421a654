"""Powers of parts and pins, each computed from one or two results.

A :class:`PowerTerm` contains the names of the one or two results from which a power is computed.
:func:`add_powers` adds the powers to the waveforms of a run.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from kc2spice.core.domains import Power
from kc2spice.core.waveforms import Waveforms, differentiate


class PowerTerm(NamedTuple):
    """Formula of the power [W] from the quantities across and through the pins.

    ``across`` is the name of the quantity across the pins, ``through`` the name of the quantity
    through the pins. ``law`` is the formula, which depends on the physical domain of the pins.
    """

    across: str
    through: str
    law: Power

    @property
    def result_names(self) -> frozenset[str]:
        """Names of the results from which the power is computed."""
        return frozenset({self.through} if self.law == "through" else {self.across, self.through})


def add_powers(waves: Waveforms, powers: Mapping[str, Iterable[PowerTerm]]) -> Waveforms:
    """Return the waveforms with the computed powers added.

    The power is instantaneous; in an ``ac`` analysis, it is the mean over a period.
    """
    result = dict(waves.data)
    for name, terms in powers.items():
        result[name] = np.asarray(sum(_compute_power(term, waves) for term in terms))
    return replace(waves, data=result)


def _compute_power(term: PowerTerm, waves: Waveforms) -> np.ndarray:
    """Compute the values of one power term at all points of the waveforms.

    In an ``ac`` analysis, the power of a heat flow is zero, because its mean over a period is zero.
    In a dc sweep, mechanical powers are zero, because nothing moves at an operating point.
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
