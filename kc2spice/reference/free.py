"""Exact motion of the unknowns that nothing nonlinear or time-dependent acts on.

A chip that rings on at megahertz while its sphere is in the air takes 12 to 20 times as many steps
as all else (the scenes ``kick_and_catch`` and ``three_cycles``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from kc2spice.reference.interval import Interval

_WORST_BASIS = 1e7  # condition of the eigenvectors beyond which the steps are integrated
_MARGIN = 1.5  # times the swing by which a guard must be clear where a free motion begins


@dataclass(frozen=True)
class FreeModes:
    """Natural motions ``rest + shapes e^(rates t)`` of the unknowns ``where`` that are free."""

    where: np.ndarray
    rates: np.ndarray
    shapes: np.ndarray  # (len(where), modes) complex
    rest: np.ndarray
    guards: np.ndarray  # (g, modes): how the guards depend on them
    others: Interval  # in which these unknowns stay as they are

    def from_state(self, t: float, z: np.ndarray) -> FreeMotion:
        """The motion from the state ``z``."""
        off = z[self.where] - self.rest
        return FreeMotion(self, t, np.linalg.solve(self.shapes, off.astype(complex)))


@dataclass(frozen=True)
class FreeMotion:
    """One motion of these modes, from ``start`` [s] on."""

    modes: FreeModes
    start: float
    amplitudes: np.ndarray

    def _waves(self, t: np.ndarray | float) -> np.ndarray:
        since = np.atleast_1d(t) - self.start
        return self.amplitudes[:, None] * np.exp(self.modes.rates[:, None] * since)

    def at(self, t: np.ndarray | float) -> np.ndarray:
        """The unknowns (len(where), nt)."""
        return (self.modes.shapes @ self._waves(t)).real + self.modes.rest[:, None]

    def rate(self, t: np.ndarray | float) -> np.ndarray:
        """Their time derivatives."""
        return (self.modes.shapes @ (self.modes.rates[:, None] * self._waves(t))).real

    def mean(self, first: float, last: float) -> np.ndarray:
        """Their mean (len(where),) between two times."""
        grown = np.diff(self._waves(np.array([first, last])))[:, 0]
        mean = self.modes.shapes @ (grown / (self.modes.rates * (last - first)))
        return mean.real + self.modes.rest

    def clear(self, t: float, guards: np.ndarray, margin: float = _MARGIN) -> bool:
        """Whether no guard can fall to zero through the free motion alone after ``t``."""
        own = self.modes.guards
        wave = self._waves(t)[:, 0]
        swing = np.abs(own) @ np.abs(wave) + (own @ wave).real
        return bool(np.all((guards - margin * swing > 1e-9)[own.any(axis=1)]))

    def lost(self, first: float, last: float, form: np.ndarray, dragged: bool = False) -> float:
        """``int d' form d dt`` of the deviation ``d`` of the unknowns from their mean, or of that
        of their rates where they are ``dragged``."""
        rates = self.modes.rates
        wave = self._waves(first)[:, 0] * (rates if dragged else 1.0)
        mean = np.diff(self.at(np.array([first, last])))[:, 0] / (last - first)
        if not dragged:
            mean = self.mean(first, last) - self.modes.rest
        both = rates[:, None] + rates
        both[np.abs(both) * (last - first) < 1e-12] = 1e-12 / (last - first)  # of undamped ones
        gram = (self.modes.shapes.T @ form @ self.modes.shapes) * np.outer(wave, wave)
        whole = (gram * np.expm1(both * (last - first)) / both).sum().real
        return float(whole - (last - first) * mean @ form @ mean)


def free_modes(interval: Interval) -> FreeModes | None:
    """What is free on this interval: whole groups of coupled unknowns, and not all of them."""
    system, n = interval.system, interval.system.size
    M, A = system.G[:, :n], interval.F[:, :n]
    pattern, bent = (M != 0.0) | (A != 0.0), np.zeros(n, dtype=bool)
    for device, _ in interval.curved:
        used = device.inputs[:, :n].any(axis=0) | device.into.any(axis=1)
        bent |= used
        pattern = pattern | np.outer(used, used)
    moving = [
        not p.wave.straight or p.wave.rate(interval.within, interval.within) != 0.0
        for p in system.sources
    ]
    varying = np.flatnonzero(moving * 2) + n
    bent |= (system.G[:, varying] != 0.0).any(axis=1) | (interval.F[:, varying] != 0.0).any(axis=1)
    bent |= ~(system.differential & interval.rows)
    _, group = connected_components(csr_array(pattern | pattern.T), directed=False)
    free = ~np.isin(group, group[bent])
    for k in np.unique(group[free]):
        inside = group == k
        free &= ~inside | (np.linalg.matrix_rank(A[np.ix_(inside, inside)]) == inside.sum())
    where = np.flatnonzero(free)
    if not where.size or where.size == n:
        return None
    square = np.ix_(where, where)
    forces = interval.F[where, n:] @ system.given(interval.within, interval.within)
    try:
        rest = -np.linalg.solve(A[square], forces + interval.const[where])
        rates, shapes = np.linalg.eig(np.linalg.solve(M[square], A[square]))
    except np.linalg.LinAlgError:
        return None
    still = np.abs(rates).min() < 1e-9 * np.abs(rates).max()
    if still or np.linalg.cond(shapes) > _WORST_BASIS:
        return None
    slopes = [np.zeros((0, n))]
    for device, mode in zip(system.devices, interval.modes, strict=True):
        m = len(device.inputs)
        base = device.law.guards(0.0, np.zeros(m), mode)
        each = [device.law.guards(0.0, unit, mode) - base for unit in np.eye(m)]
        slopes.append(np.array(each).T.reshape(base.size, m) @ device.inputs[:, :n])
    guards = np.vstack(slopes)[:, where] @ shapes
    return FreeModes(where, rates, shapes, rest, guards, interval.without(free))
