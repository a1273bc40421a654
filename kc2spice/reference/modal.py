"""Exact motion of the unknowns that nothing nonlinear or time-dependent acts on."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from kc2spice.reference.assemble import Rows, System, Term
from kc2spice.reference.piece import Piece
from kc2spice.reference.radau import NODES, Step

_WORST_BASIS = 1e7  # condition of the eigenvectors beyond which the steps are integrated


@dataclass(frozen=True)
class Modes:
    """``z = rest + Re (shapes amplitudes e^(rates (t - start)))`` on the unknowns ``where``."""

    where: np.ndarray
    others: np.ndarray
    rates: np.ndarray
    shapes: np.ndarray  # (len(where), modes) complex
    read: np.ndarray  # (modes, len(where)): amplitudes of the deviation from rest
    rest: np.ndarray
    guards: np.ndarray  # (g, len(where)): how the guards depend on these unknowns
    watched: np.ndarray  # (g,) bool
    part: Piece  # the other unknowns alone

    def launched(self, t: float, z: np.ndarray) -> Flight:
        """The motion from the state ``z``."""
        return Flight(self, t, self.read @ (z[self.where] - self.rest))


@dataclass(frozen=True)
class Flight:
    """One motion of the modes."""

    modes: Modes
    start: float
    amplitudes: np.ndarray

    def at(self, t: np.ndarray) -> np.ndarray:
        """Their unknowns (len(where), nt)."""
        m = self.modes
        wave = self.amplitudes[:, None] * np.exp(m.rates[:, None] * (t - self.start))
        return (m.shapes @ wave).real + m.rest[:, None]

    def rate(self, t: np.ndarray) -> np.ndarray:
        """Their time derivatives."""
        m = self.modes
        wave = self.amplitudes[:, None] * np.exp(m.rates[:, None] * (t - self.start))
        return (m.shapes @ (m.rates[:, None] * wave)).real

    def mean(self, t0: float, t1: float) -> np.ndarray:
        """Their mean (len(where),) from ``t0`` to ``t1``."""
        m = self.modes
        grown = (
            np.exp(m.rates * (t1 - self.start)) - np.exp(m.rates * (t0 - self.start))
        ) / m.rates
        return (m.shapes @ (self.amplitudes * grown)).real / (t1 - t0) + m.rest

    def swing(self, t: float) -> np.ndarray:
        """(g,) by how much every guard may still move after ``t`` through them."""
        m = self.modes
        size = np.abs(self.amplitudes) * np.exp(m.rates.real * (t - self.start))
        now = m.guards @ (self.at(np.array([t]))[:, 0] - m.rest)
        return np.abs(m.guards @ m.shapes) @ size + now

    def squares(
        self, rows: np.ndarray, weight: np.ndarray, offset: np.ndarray, t1: float, rate: bool
    ) -> float:
        """``int sum weight (rows z + offset)^2 dt`` from the start to ``t1``, or of the ``rate`` of
        that form, in closed form."""
        m, span = self.modes, t1 - self.start
        c = (rows @ m.shapes) * self.amplitudes * (m.rates if rate else 1.0)
        base = (rows @ m.rest + offset) * (not rate)
        rates, waves = np.append(m.rates, 0.0), np.column_stack((c, base.astype(complex)))
        gram = waves.T @ (weight[:, None] * waves)
        cross = waves.T @ (weight[:, None] * waves.conj())
        return 0.5 * float(
            (gram * _integral(rates[:, None] + rates, span)).sum().real
            + (cross * _integral(rates[:, None] + rates.conj(), span)).sum().real
        )


@dataclass(frozen=True)
class FlightStep(Step):
    """A step of the other unknowns, with those of the flight beside it."""

    flight: Flight
    inner: Step

    @classmethod
    def of(cls, inner: Step, flight: Flight, n: int) -> FlightStep:
        """Widen ``inner`` to all unknowns."""
        m = flight.modes
        ends = flight.at(inner.start + inner.length * np.concatenate(([0.0], NODES)))
        first, increments = np.zeros(n), np.zeros((n, 3))
        first[m.where], first[m.others] = ends[:, 0], inner.first
        increments[m.where] = ends[:, 1:] - ends[:, :1]
        increments[m.others] = inner.increments
        both = np.ones(n, dtype=bool)
        both[m.others] = inner.differential
        return cls(inner.start, inner.length, first, increments, both, flight, inner)

    def at(self, t: np.ndarray | float) -> np.ndarray:
        """States (n, nt)."""
        t = np.atleast_1d(t)
        z = np.empty((self.first.size, t.size))
        z[self.flight.modes.where], z[self.flight.modes.others] = (
            self.flight.at(t),
            self.inner.at(t),
        )
        return z

    def rate(self, t: np.ndarray | float) -> np.ndarray:
        """Time derivatives (n, nt)."""
        t = np.atleast_1d(t)
        z = np.empty((self.first.size, t.size))
        z[self.flight.modes.where] = self.flight.rate(t)
        z[self.flight.modes.others] = self.inner.rate(t)
        return z

    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """States and rates for quadrature: of the flight their means, exact for linear forms."""
        z, r = super().nodes()
        where, end = self.flight.modes.where, self.start + self.length
        z[where] = self.flight.mean(self.start, end)[:, None]
        r[where] = self.increments[where, 2:] / self.length
        return z, r


def modes_of(piece: Piece) -> Modes | None:
    """What can fly in this piece; None if nothing does."""
    system, n = piece.system, piece.A.shape[0]
    pattern = (piece.system.M != 0.0) | (piece.A != 0.0)
    bent = np.zeros(n, dtype=bool)
    for device, _ in piece.curved:
        used = device.inputs.z.any(axis=0) | device.into.any(axis=1)
        bent |= used
        pattern = pattern | np.outer(used, used)
    _, d = system.inputs(piece.within, piece.within)
    varying = (piece.Bs @ d != 0.0) | (system.Gs @ d != 0.0) | (piece.Bd @ d != 0.0)
    steady = np.abs(d).max(initial=0.0) == 0.0 and all(
        np.size(p.wave.corners(np.inf)) == 0 or _constant(p, piece.within) for p in system.sources
    )
    if not steady:
        bent |= varying
        bent |= np.abs(piece.Bs).max(axis=1, initial=0.0) > 0.0
    count, label = connected_components(csr_array(pattern | pattern.T), directed=False)
    chosen = np.ones(n, dtype=bool)
    for k in range(count):
        inside = label == k
        square = np.ix_(inside, inside)
        if bent[inside].any() or np.linalg.matrix_rank(piece.A[square]) < inside.sum():
            chosen[inside] = False
    where, others = np.flatnonzero(chosen), np.flatnonzero(~chosen)
    if not where.size or not others.size:
        return None
    return _decomposed(piece, where, others)


def _constant(source: object, t: float) -> bool:
    wave = source.wave  # type: ignore[attr-defined]
    return bool(wave.rate(t, t) == 0.0 and hasattr(wave, "points"))


def _decomposed(piece: Piece, where: np.ndarray, others: np.ndarray) -> Modes | None:
    system = piece.system
    if not piece.differential[where].all() or not piece.rows[where].all():
        return None
    s, d = system.inputs(piece.within, piece.within)
    square = np.ix_(where, where)
    M, A = system.M[square], piece.A[square]
    b = (piece.Bs @ s + piece.Bd @ d + piece.const)[where]
    try:
        F = np.linalg.solve(M, A)
        rest = -np.linalg.solve(A, b)
        rates, shapes = np.linalg.eig(F)
        if (
            np.linalg.cond(shapes) > _WORST_BASIS
            or np.abs(rates).min() < 1e-9 * np.abs(rates).max()
        ):
            return None
    except np.linalg.LinAlgError:
        return None
    rows, watched = [], []
    for device, mode in zip(system.devices, piece.modes, strict=True):
        e = np.zeros(device.inputs.z.shape[0])
        base = device.law.guards(0.0, e, mode)
        slope = np.array([device.law.guards(0.0, e + u, mode) - base for u in np.eye(e.size)])
        form = slope.T @ device.inputs.z[:, where] if base.size else np.zeros((0, where.size))
        rows.append(form)
        watched.append(np.abs(form).max(axis=1, initial=0.0) > 0.0)
    guards = np.vstack(rows) if rows else np.zeros((0, where.size))
    part = Piece(_restricted(system, others), piece.modes, piece.within)
    return Modes(
        where,
        others,
        rates,
        shapes,
        np.linalg.inv(shapes),
        rest,
        guards,
        np.concatenate(watched) if watched else np.zeros(0, dtype=bool),
        part,
    )


def _restricted(system: System, keep: np.ndarray) -> System:
    """The system of the unknowns ``keep`` alone; no other acts on them."""
    square = np.ix_(keep, keep)
    place = {int(k): i for i, k in enumerate(keep)}
    devices = tuple(
        replace(
            device,
            inputs=Rows(device.inputs.z[:, keep], device.inputs.s, device.inputs.d),
            into=device.into[keep],
            stores=None if device.stores is None else device.stores[keep],
            states=np.array([place.get(int(k), -1) for k in device.states], dtype=int),
        )
        for device in system.devices
    )
    return replace(
        system,
        M=system.M[square],
        A=system.A[square],
        Gs=system.Gs[keep],
        Gd=system.Gd[keep],
        Bs=system.Bs[keep],
        Bd=system.Bd[keep],
        const=system.const[keep],
        differential=system.differential[keep],
        velocity=system.velocity[keep],
        devices=devices,
    )


def flown_loss(
    flight: Flight, end: float, term: Term, s: np.ndarray, d: np.ndarray
) -> float | None:
    """Loss of a term that lies within the flight alone; None if it does not."""
    if term.rows.z[:, flight.modes.others].any():
        return None
    offset = term.rows.s @ s + term.rows.d @ d
    rows, rate = term.rows.z[:, flight.modes.where], term.kind == "drag"
    return flight.squares(rows, term.weight, offset, end, rate)


def _integral(rate: np.ndarray, span: float) -> np.ndarray:
    small = np.abs(rate * span) < 1e-12
    safe = np.where(small, 1.0, rate)
    return np.where(small, span, np.expm1(safe * span) / safe)
