"""Exact motion of modes that no contact touches, under an anode voltage that is linear in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.reference.law import Law, Mode


@dataclass(frozen=True)
class FreeModes:
    """``a(s) = c1 e^(r1 s) + c2 e^(r2 s) + a0 + a1 s`` with ``s = t - start``, per mode.

    Solves ``a'' + damp a' + omega^2 a = f + g s``; ``r1``, ``r2`` are the roots of the
    characteristic polynomial. The three exponents (r1, r2, 0) carry the velocity.
    """

    start: float
    roots: np.ndarray  # (2, q) complex
    amplitudes: np.ndarray  # (2, q) complex
    a0: np.ndarray
    a1: np.ndarray
    law: Law
    mode: Mode

    @classmethod
    def of(cls, law: Law, mode: Mode, start: float, x: np.ndarray) -> FreeModes:
        """Start from the full state ``x`` at time ``start``."""
        q, w = law.q, law.omega
        a, velocity = x[:q], w * x[q : 2 * q]
        half = 0.5 * law.damp
        spread = np.sqrt((half**2 - w**2).astype(complex))
        # Equal roots divide by zero; 1e-4 apart the solution differs by 1e-8, and so much again
        # is lost by cancellation in the energy.
        spread = np.where(np.abs(spread) < 1e-4 * w, 1e-4 * w, spread)
        fast = -half - spread
        slow = np.where(half > w, w**2 / fast, -half + spread)
        push = law.scale**2 * law.charge / w**2
        a1 = push * mode.slope
        a0 = push * mode.voltage(start) - law.damp / w**2 * a1
        u, du = a - a0, velocity - a1
        c1 = (du - slow * u) / (fast - slow)
        return cls(start, np.array((fast, slow)), np.array((c1, u - c1)), a0, a1, law, mode)

    def at(self, t: np.ndarray) -> np.ndarray:
        """Modal rows ``[a, b]`` (2 q, nt) of the state."""
        s = np.atleast_1d(t) - self.start
        waves = self.amplitudes[:, :, None] * np.exp(self.roots[:, :, None] * s)
        a = waves.sum(axis=0).real + self.a0[:, None] + self.a1[:, None] * s
        velocity = (self.roots[:, :, None] * waves).sum(axis=0).real + self.a1[:, None]
        return np.vstack((a, velocity / self.law.omega[:, None]))

    def reach(self, end: float) -> float:
        """Bound on the rings' height over rest until ``end`` [m]."""
        steady = np.maximum(np.abs(self.a0), np.abs(self.a0 + self.a1 * (end - self.start)))
        bound = np.abs(self.amplitudes).sum(axis=0) + steady
        return float((np.abs(self.law.rings) @ bound).max())

    def dissipated(self, end: float) -> float:
        """Energy that the damping takes from ``start`` to ``end`` [J], in closed form."""
        span = end - self.start
        roots = np.vstack((self.roots, np.zeros(self.law.q)))
        rates = np.vstack((self.roots * self.amplitudes, self.a1))
        square = sum(
            rates[i] * rates[j] * _integral(roots[i] + roots[j], span)
            for i in range(3)
            for j in range(3)
        )
        return float((self.law.damp / self.law.scale**2) @ square.real)

    def electrical_input(self, end: float) -> float:
        """``int V dQ`` from ``start`` to ``end`` [J], in closed form (V is linear in time)."""
        span, slope = end - self.start, self.mode.slope
        volt = self.mode.voltage(self.start)
        first, last = self.at(np.array((self.start, end)))[: self.law.q].T
        area = (self.amplitudes * _integral(self.roots, span)).sum(axis=0).real
        area += self.a0 * span + 0.5 * self.a1 * span**2
        piezo = volt * (last - first) + slope * (span * last - area)
        clamped = self.law.c0 * slope * (volt * span + 0.5 * slope * span**2)
        return float(self.law.charge @ piezo + clamped)


def _integral(rate: np.ndarray, span: float) -> np.ndarray:
    """``int_0^span e^(rate s) ds``."""
    small = np.abs(rate * span) < 1e-12
    safe = np.where(small, 1.0, rate)
    return np.where(small, span, np.expm1(safe * span) / safe)
