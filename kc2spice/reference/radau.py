"""Steps of Radau IIA of order five for ``d/dt g(t, z) = f(t, z)`` (Hairer and Wanner 1996, IV.8).

``scipy.integrate.Radau`` takes no mass matrix, and algebraic unknowns can be eliminated only where
the index is 1: for two inductors in series, or one behind a current source, which are of index 2,
what elimination has to solve is singular. This method follows both as they are. Carrying ``g``
from step to step keeps charge, flux and momentum.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg import lapack

from kc2spice.core.errors import SimulationError
from kc2spice.reference.interval import Interval

_S6 = np.sqrt(6.0)
NODES = np.array([(4 - _S6) / 10, (4 + _S6) / 10, 1.0])
_POWERS = np.arange(1, 4)
_A = (NODES[:, None] ** _POWERS / _POWERS) @ np.linalg.inv(NODES[:, None] ** (_POWERS - 1))
WEIGHTS = _A[2]
_INVERSE = np.linalg.inv(_A)
_values, _vectors = np.linalg.eig(_INVERSE)
_BACK = np.linalg.inv(_vectors)
_REAL, _PAIR = int(np.argmin(np.abs(_values.imag))), int(np.argmax(_values.imag))
_ERROR = np.array([-13 - 7 * _S6, -13 + 7 * _S6, -1.0]) / 3.0
_MAX_NEWTON = 8
# Polynomials through the start and the stages, and through the stages alone.
_CUBIC = np.linalg.inv(NODES[:, None] ** _POWERS)
_SQUARE = np.linalg.inv(NODES[:, None] ** (_POWERS - 1))


@dataclass(frozen=True)
class Step:
    """An accepted step: start, length, state at the start, increments (n, 3) at the stages."""

    start: float
    length: float
    first: np.ndarray
    increments: np.ndarray
    differential: np.ndarray

    @property
    def end(self) -> float:
        """Time at the end."""
        return self.start + self.length

    @property
    def last(self) -> np.ndarray:
        """State at the end."""
        return self.first + self.increments[:, 2]

    def at(self, t: np.ndarray | float) -> np.ndarray:
        """States (n, nt) on the collocation polynomial."""
        x = (np.atleast_1d(t) - self.start) / self.length
        powers = x ** np.arange(4)[:, None]
        return self.first[:, None] + self._polynomials(powers[1:], powers[:3])

    def rate(self, t: np.ndarray | float) -> np.ndarray:
        """Time derivatives (n, nt); those of algebraic unknowns are of low order."""
        x = (np.atleast_1d(t) - self.start) / self.length
        square = np.array([0.0 * x, x**0, 2 * x])
        return self._polynomials(np.array([x**0, 2 * x, 3 * x**2]), square) / self.length

    def _polynomials(self, cubic: np.ndarray, square: np.ndarray) -> np.ndarray:
        through_start = self.increments @ _CUBIC.T @ cubic
        alone = self.increments @ _SQUARE.T @ square
        return np.where(self.differential[:, None], through_start, alone)

    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """States and rates (n, 3) at the stages, for quadrature over the step."""
        return self.first[:, None] + self.increments, self.rate(self.start + self.length * NODES)


class Radau:
    """Steps within one interval; ``advance`` makes one of an error, ``take`` one of a length."""

    def __init__(self, interval: Interval, t: float, z: np.ndarray, rtol: float) -> None:
        self.rtol = rtol
        self.newton_tol = max(10 * np.finfo(float).eps / rtol, min(0.03, rtol**0.5))
        self.interval, self.rows = interval, interval.rows
        self.active = interval.system.differential  # unknowns whose error is judged
        self.before: Step | None = None
        self._start(t, z)
        self._linearise()

    def _start(self, t: float, z: np.ndarray) -> None:
        self.t, self.z = t, z
        self.g, f = self.interval.at(t, z)
        self.f = np.where(self.rows, f, 0.0)

    def _linearise(self) -> None:
        self.M, self.J = self.interval.slopes(self.t, self.z)
        self.h_lu, self.lu = 0.0, tuple[Any, ...]()

    def guess(self, end: float) -> float:
        """First step: a hundredth of the time in which the state doubles."""
        rates = np.linalg.lstsq(self.M, self.f, rcond=None)[0]
        speed = _norm((rates / (self.rtol * (1.0 + np.abs(self.z))))[self.active])
        if speed <= 1e-300:
            return end - self.t
        first = min(0.5 * (0.01 / speed) ** 0.25, max(1e-12, 0.01 * self.rtol**-0.75 / speed))
        return min(end - self.t, first)

    def _solve(self, right: np.ndarray, which: int) -> np.ndarray:
        if np.iscomplexobj(self.lu[which][0]):
            return np.asarray(lapack.zgetrs(*self.lu[which][:2], right)[0])
        return np.asarray(lapack.dgetrs(*self.lu[which][:2], right)[0])

    def _factor(self, h: float) -> None:
        if h == self.h_lu:
            return
        self.lu = (
            lapack.dgetrf(_values[_REAL].real / h * self.M - self.J),
            lapack.zgetrf(_values[_PAIR] / h * self.M - self.J),
        )
        self.h_lu = h
        if any(info for _, _, info in self.lu):
            raise SimulationError(
                "the equations are singular",
                where=f"t = {self.t:.6e} s",
                hint="look for a net without a path to ground, or an inductor in series with a "
                "current source",
            )

    def take(self, h: float) -> Step | None:
        """Solve one step of length ``h``; None if Newton's method does not converge."""
        self._factor(h)
        p, t = self.interval, self.t + h * NODES
        given = p.system.given(t, p.within)
        Z = np.zeros((self.z.size, 3))
        if self.before is not None:
            Z = self.before.at(t) - self.z[:, None]
        scale = self.rtol * (1.0 + np.abs(self.z))
        scale = np.where(self.active, scale, 1e3 * scale)  # these carry no error onwards
        last = 0.0
        for k in range(_MAX_NEWTON):
            X = np.concatenate((self.z[:, None] + Z, given))
            r = p.flow(t, X) - (p.stored(X) - self.g[:, None]) @ _INVERSE.T / h
            real = np.outer(self._solve(r @ _BACK[_REAL].real, 0), _vectors[:, _REAL].real)
            pair = np.outer(self._solve(r @ _BACK[_PAIR], 1), _vectors[:, _PAIR])
            change = real + 2.0 * pair.real
            size = _norm(change / scale[:, None])
            rate = size / last if last > 0.0 else 0.0
            if not np.isfinite(size) or (rate >= 1.0 and size > 1e-2):  # below it is rounding
                return None
            Z += change
            done = size == 0.0 or (p.linear and k == 0)
            if last > 0.0:
                done |= rate >= 1.0 or rate / (1 - min(rate, 0.9)) * size < self.newton_tol
            if done:
                self.iterations = k + 1
                return Step(self.t, h, self.z, Z, self.active)
            last = size
        return None

    def accept(self, step: Step) -> None:
        """Go on from the end of ``step``."""
        self.before = step
        self._start(step.end, step.last)
        if not self.interval.linear and self.iterations > 2:
            self._linearise()

    def advance(self, h: float, end: float) -> tuple[Step, float]:
        """One step whose error is within tolerance, not yet accepted, and the next length."""
        rejected = False
        while True:
            if not h > 1e-15 * max(abs(self.t), 1e-6):
                raise SimulationError("the step became too small", where=f"t = {self.t:.9e} s")
            h = min(h, end - self.t)
            if not rejected and end - self.t - h < 1e-3 * h:
                h = end - self.t
            step = self.take(h)
            if step is None:
                h, rejected = 0.5 * h, True
                continue
            size = self._error(step)
            safety = 0.9 * (2 * _MAX_NEWTON + 1) / (2 * _MAX_NEWTON + self.iterations)
            factor = min(10.0, safety * max(size, 1e-4) ** -0.25)
            if size <= 1.0:
                return step, h if 1.0 <= factor < 1.2 else h * factor
            h, rejected = h * max(0.2, factor), True

    def _error(self, step: Step) -> float:
        """Estimated error in units of the tolerance."""
        p, t, h = self.interval, self.t + step.length * NODES, step.length
        given = p.system.given(t, p.within)
        # of what is stored, not of ``M`` times the unknowns: that is of an earlier state
        late = p.stored(np.concatenate((step.first[:, None] + step.increments, given)))
        moved = np.where(self.rows, (late - self.g[:, None]) @ _ERROR / h, 0.0)
        scale = self.rtol * (1.0 + np.maximum(np.abs(self.z), np.abs(step.last)))
        error = self._solve(self.f + moved, 0)
        return _norm((error / scale)[self.active])


def _norm(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x * x))) if x.size else 0.0
