"""Exact motion of modes that no contact touches, under an anode voltage that is linear in time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from laboratory.law import Law, Mode


@dataclass(frozen=True)
class FreeModes:
    """``a(s) = c1 e^(r1 s) + c2 e^(r2 s) + a0 + a1 s`` with ``s = t - start``, per mode.

    Solves ``a'' + damp a' + omega^2 a = f + g s``; ``r1``, ``r2`` are the roots of the
    characteristic polynomial.
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
        # Equal roots divide by zero; 1e-4 apart the solution differs by 1e-8.
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
