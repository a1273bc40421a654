"""Exact motion of the unknowns that nothing nonlinear or time-dependent acts on.

A chip that rings on at megahertz while its sphere is in flight takes 12 to 20 times as many steps
as all else (the scenes ``kick_and_catch`` and ``three_cycles``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from kc2spice.core.laws import Line
from kc2spice.reference.assemble import System, Term
from kc2spice.reference.interval import Interval
from kc2spice.reference.radau import NODES, Step

_WORST_BASIS = 1e7  # condition of the eigenvectors beyond which the steps are integrated


@dataclass(frozen=True)
class Modes:
    """Natural motions ``shapes e^(rates t)`` of the unknowns ``where`` about their ``rest``."""

    where: np.ndarray
    others: np.ndarray
    rates: np.ndarray
    shapes: np.ndarray  # (len(where), modes) complex
    read: np.ndarray  # (modes, len(where)): amplitudes of the deviation from rest
    rest: np.ndarray
    guards: np.ndarray  # (g, len(where)): how the guards depend on these unknowns
    part: Interval  # the other unknowns alone

    @property
    def watched(self) -> np.ndarray:
        """(g,) bool: which guards depend on these unknowns."""
        return np.asarray(self.guards.any(axis=1))

    def launched(self, t: float, z: np.ndarray) -> Flight:
        """The motion from the state ``z``."""
        return Flight(self, t, self.read @ (z[self.where] - self.rest))


@dataclass(frozen=True)
class Flight:
    """One motion of the modes."""

    modes: Modes
    start: float
    amplitudes: np.ndarray

    def waves(self, t: np.ndarray) -> np.ndarray:
        """Amplitudes (modes, nt) at the times ``t``."""
        return self.amplitudes[:, None] * np.exp(self.modes.rates[:, None] * (t - self.start))

    def at(self, t: np.ndarray) -> np.ndarray:
        """Their unknowns (len(where), nt)."""
        return (self.modes.shapes @ self.waves(t)).real + self.modes.rest[:, None]

    def rate(self, t: np.ndarray) -> np.ndarray:
        """Their time derivatives."""
        return (self.modes.shapes @ (self.modes.rates[:, None] * self.waves(t))).real

    def mean(self, t: np.ndarray) -> np.ndarray:
        """Their mean (len(where),) between two times."""
        grown = np.diff(self.waves(t))[:, 0] / (self.modes.rates * np.diff(t))
        return (self.modes.shapes @ grown).real + self.modes.rest

    def swing(self, t: float) -> np.ndarray:
        """(g,) by how much every guard may still move after ``t`` through them."""
        m, wave = self.modes, self.waves(np.array([t]))[:, 0]
        now = m.guards @ (m.shapes @ wave).real
        return np.abs(m.guards @ m.shapes) @ np.abs(wave) + now

    def loss(self, end: float, term: Term, given: np.ndarray) -> float | None:
        """``int y' weight y dt`` from the start to ``end`` in closed form, for constant sources;
        None if the term depends on other unknowns."""
        m, n = self.modes, self.modes.where.size + self.modes.others.size
        if term.rows[:, m.others].any():
            return None
        rows, drag = term.rows[:, m.where], term.kind == "drag"
        moving = (rows @ m.shapes) * self.amplitudes * (m.rates if drag else 1.0)
        still = (rows @ m.rest + term.rows[:, n:] @ given) * (not drag)
        rates, y = np.append(m.rates, 0.0), np.column_stack((moving, still.astype(complex)))
        total = 0.0
        for weighted, by in ((y, rates), (y.conj(), rates.conj())):
            gram = y.T @ term.weight @ weighted
            total += 0.5 * (gram * _integral(rates[:, None] + by, end - self.start)).sum().real
        return float(total)


@dataclass(frozen=True)
class FlightStep(Step):
    """A step of the other unknowns, with those of the flight beside it."""

    flight: Flight
    inner: Step

    @classmethod
    def of(cls, inner: Step, flight: Flight) -> FlightStep:
        """Widen ``inner`` to all unknowns."""
        m = flight.modes
        ends = flight.at(inner.start + inner.length * np.concatenate(([0.0], NODES)))
        first = _joined(m, ends[:, :1], inner.first[:, None])[:, 0]
        increments = _joined(m, ends[:, 1:] - ends[:, :1], inner.increments)
        both = np.ones(first.size, dtype=bool)
        both[m.others] = inner.differential
        return cls(inner.start, inner.length, first, increments, both, flight, inner)

    def at(self, t: np.ndarray | float) -> np.ndarray:
        """States (n, nt)."""
        return _joined(self.flight.modes, self.flight.at(np.atleast_1d(t)), self.inner.at(t))

    def rate(self, t: np.ndarray | float) -> np.ndarray:
        """Time derivatives (n, nt)."""
        return _joined(self.flight.modes, self.flight.rate(np.atleast_1d(t)), self.inner.rate(t))

    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """States and rates for quadrature: of the flight their means, exact for linear forms."""
        z, r = super().nodes()
        where = self.flight.modes.where
        z[where] = self.flight.mean(np.array([self.start, self.end]))[:, None]
        r[where] = self.increments[where, 2:] / self.length
        return z, r


def _joined(modes: Modes, flying: np.ndarray, others: np.ndarray) -> np.ndarray:
    found = np.empty((len(flying) + len(others), flying.shape[1]))
    found[modes.where], found[modes.others] = flying, others
    return found


def modes_of(interval: Interval) -> Modes | None:
    """What can fly on this interval: whole groups of coupled unknowns; None if nothing does."""
    system, n = interval.system, interval.system.size
    M, A = system.G[:, :n], interval.F[:, :n]
    pattern, bent = (M != 0.0) | (A != 0.0), np.zeros(n, dtype=bool)
    for device, _ in interval.curved:
        used = device.inputs[:, :n].any(axis=0) | device.into.any(axis=1)
        bent |= used
        pattern = pattern | np.outer(used, used)
    sources = [
        not isinstance(p.wave, Line) or p.wave.rate(interval.within, interval.within) != 0.0
        for p in system.sources
    ]
    varying = np.flatnonzero(sources * 2) + n
    bent |= (system.G[:, varying] != 0.0).any(axis=1) | (interval.F[:, varying] != 0.0).any(axis=1)
    count, label = connected_components(csr_array(pattern | pattern.T), directed=False)
    chosen = np.zeros(n, dtype=bool)
    for k in range(count):
        inside = label == k
        square = np.ix_(inside, inside)
        chosen |= inside & (
            not bent[inside].any() and np.linalg.matrix_rank(A[square]) == inside.sum()
        )
    where, others = np.flatnonzero(chosen), np.flatnonzero(~chosen)
    known = system.differential[where].all() and interval.rows[where].all()
    if not where.size or not others.size or not known:
        return None
    square = np.ix_(where, where)
    given = system.given(interval.within, interval.within)
    forces = interval.F[where, n:] @ given + interval.const[where]
    try:
        rest = -np.linalg.solve(A[square], forces)
        rates, shapes = np.linalg.eig(np.linalg.solve(M[square], A[square]))
    except np.linalg.LinAlgError:
        return None
    still = np.abs(rates).min() < 1e-9 * np.abs(rates).max()
    if still or np.linalg.cond(shapes) > _WORST_BASIS:
        return None
    rows = [np.zeros((0, n))]
    for device, mode in zip(system.devices, interval.modes, strict=True):
        e = np.zeros(len(device.inputs))
        base = device.law.guards(0.0, e, mode)
        slope = [device.law.guards(0.0, unit, mode) - base for unit in np.eye(e.size)]
        rows.append(np.array(slope).T.reshape(base.size, e.size) @ device.inputs[:, :n])
    part = Interval(_restricted(system, others), interval.modes, interval.within)
    read, guards = np.linalg.inv(shapes), np.vstack(rows)[:, where]
    return Modes(where, others, rates, shapes, read, rest, guards, part)


def _restricted(system: System, keep: np.ndarray) -> System:
    """The system of the unknowns ``keep`` alone; no other acts on them."""
    seen = np.concatenate((keep, np.arange(system.size, system.G.shape[1])))
    devices = tuple(
        replace(
            device,
            inputs=device.inputs[:, seen],
            into=device.into[keep],
            stores=None if device.stores is None else device.stores[keep],
        )
        for device in system.devices
    )
    return replace(
        system,
        G=system.G[np.ix_(keep, seen)],
        F=system.F[np.ix_(keep, seen)],
        const=system.const[keep],
        differential=system.differential[keep],
        velocity=system.velocity[keep],
        devices=devices,
    )


def _integral(rate: np.ndarray, span: float) -> np.ndarray:
    """``int e^(rate t) dt`` from 0 to ``span``."""
    small = np.abs(rate * span) < 1e-12
    safe = np.where(small, 1.0, rate)
    return np.where(small, span, np.expm1(safe * span) / safe)
