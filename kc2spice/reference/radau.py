"""Radau IIA of order five for ``d/dt g(t, z) = f(t, z)`` (Hairer and Wanner 1996, IV.8).

Carrying ``g`` from step to step keeps charge, flux and momentum, and makes algebraic unknowns and
their start values a matter of course.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.linalg import lapack

from kc2spice.core.errors import SimulationError

_S6 = np.sqrt(6.0)
NODES = np.array([(4 - _S6) / 10, (4 + _S6) / 10, 1.0])
_POWERS = np.arange(1, 4)
_A = (NODES[:, None] ** _POWERS / _POWERS) @ np.linalg.inv(NODES[:, None] ** (_POWERS - 1))
WEIGHTS = _A[2]
INVERSE = np.linalg.inv(_A)
_values, _vectors = np.linalg.eig(INVERSE)
_REAL, _PAIR = int(np.argmin(np.abs(_values.imag))), int(np.argmax(_values.imag))
_MU, _LAMBDA = float(_values[_REAL].real), complex(_values[_PAIR])
_TR, _TC = _vectors[:, _REAL].real, _vectors[:, _PAIR]
_BACK = np.linalg.inv(_vectors)
_BR, _BC = _BACK[_REAL].real, _BACK[_PAIR]
_ERROR = np.array([-13 - 7 * _S6, -13 + 7 * _S6, -1.0]) / 3.0
_MAX_NEWTON = 8
# Polynomials through the start and the stages, and through the stages alone.
_CUBIC = np.linalg.inv(NODES[:, None] ** _POWERS)
_SQUARE = np.linalg.inv(NODES[:, None] ** (_POWERS - 1))


class Problem(Protocol):
    """What one smooth piece gives to the integrator."""

    differential: np.ndarray
    rows: np.ndarray  # (n,) bool: rows with a rate

    def stored(self, t: np.ndarray, z: np.ndarray) -> np.ndarray:
        """``g`` (n, nt) at columns of states."""
        ...

    def flow(self, t: np.ndarray, z: np.ndarray) -> np.ndarray:
        """``f`` (n, nt) at columns of states."""
        ...

    def slopes(self, t: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``dg/dz`` and ``df/dz``."""
        ...

    linear: bool


@dataclass(frozen=True)
class Step:
    """An accepted step: start, length, state at the start and increments (n, 3) at the stages."""

    start: float
    length: float
    first: np.ndarray
    increments: np.ndarray
    differential: np.ndarray

    @property
    def last(self) -> np.ndarray:
        """State at the end."""
        return self.first + self.increments[:, 2]

    def at(self, t: np.ndarray | float) -> np.ndarray:
        """States (n, nt) on the collocation polynomial."""
        x = (np.atleast_1d(t) - self.start) / self.length
        cubic = self.increments @ _CUBIC.T @ (x ** _POWERS[:, None])
        square = self.increments @ _SQUARE.T @ (x ** (_POWERS - 1)[:, None])
        return self.first[:, None] + np.where(self.differential[:, None], cubic, square)

    def nodes(self) -> tuple[np.ndarray, np.ndarray]:
        """States and rates (n, 3) at the stages, for quadrature over the step."""
        return self.first[:, None] + self.increments, self.rate(self.start + self.length * NODES)

    def rate(self, t: np.ndarray | float) -> np.ndarray:
        """Time derivatives (n, nt); those of algebraic unknowns are of low order."""
        x = (np.atleast_1d(t) - self.start) / self.length
        cubic = self.increments @ _CUBIC.T @ (_POWERS[:, None] * x ** (_POWERS - 1)[:, None])
        square = (
            self.increments
            @ _SQUARE.T
            @ (np.array([0, 1, 2])[:, None] * x ** np.array([0, 0, 1])[:, None])
        )
        return np.where(self.differential[:, None], cubic, square) / self.length


class Radau:
    """Steps of one smooth piece; ``advance`` makes an accepted one, ``take`` one of given size."""

    def __init__(self, problem: Problem, t: float, z: np.ndarray, rtol: float) -> None:
        self.problem, self.rtol = problem, rtol
        self.t, self.z = t, z
        self.g = problem.stored(np.array([t]), z[:, None])[:, 0]
        self.newton_tol = max(10 * np.finfo(float).eps / rtol, min(0.03, rtol**0.5))
        self.M, self.J = problem.slopes(t, z)
        self.fresh = True
        self.h_lu = 0.0
        self.lu: tuple | None = None
        self.before: Step | None = None
        self.error_before, self.h_before = 0.0, 0.0

    def guess(self, end: float) -> float:
        """First step: a hundredth of the time in which the state doubles."""
        f = self._rate()
        active = self.problem.differential
        scale = self.rtol * (1.0 + np.abs(self.z))
        speed = _norm((np.linalg.lstsq(self.M, f, rcond=None)[0] / scale)[active])
        return min(
            end - self.t,
            0.5 * (0.01 / speed) ** 0.25 if speed > 1e-300 else end - self.t,
            max(1e-12, 0.01 * self.rtol**-0.75 / max(speed, 1e-300)),
        )

    def _rate(self) -> np.ndarray:
        f = self.problem.flow(np.array([self.t]), self.z[:, None])[:, 0]
        return np.where(self.problem.rows, f, 0.0)

    def _factor(self, h: float) -> None:
        if self.lu is not None and h == self.h_lu:
            return
        real = lapack.dgetrf(_MU / h * self.M - self.J)
        pair = lapack.zgetrf(_LAMBDA / h * self.M - self.J)
        if real[2] or pair[2]:
            raise SimulationError(
                "the equations are singular",
                where=f"t = {self.t:.6e} s",
                hint="look for a net without a path to ground, or an inductor in series with a "
                "current source",
            )
        self.lu, self.h_lu = (real, pair), h

    def take(self, h: float) -> Step | None:
        """Solve one step of length ``h``; None if Newton's method does not converge."""
        self._factor(h)
        assert self.lu is not None
        (lr, pr, _), (lc, pc, _) = self.lu
        p, t = self.problem, self.t + h * NODES
        Z = np.zeros((self.z.size, 3))
        if self.before is not None:
            Z = self.before.at(t) - self.z[:, None]
        scale = self.rtol * (1.0 + np.abs(self.z))
        scale = np.where(p.differential, scale, 1e3 * scale)  # these carry no error onwards
        last, rate = None, None
        for k in range(_MAX_NEWTON):
            z = self.z[:, None] + Z
            r = p.flow(t, z) - (p.stored(t, z) - self.g[:, None]) @ INVERSE.T / h
            wr, _ = lapack.dgetrs(lr, pr, r @ _BR)
            wc, _ = lapack.zgetrs(lc, pc, r @ _BC)
            dZ = np.outer(wr, _TR) + 2.0 * np.outer(wc, _TC).real
            size = _norm(dZ / scale[:, None])
            if not np.isfinite(size):
                return None
            if last is not None and last > 0.0:
                rate = size / last
                if rate >= 1.0 and size > 1e-2:  # below that it is rounding
                    return None
            Z += dZ
            done = p.linear and k == 0 and self.fresh
            done |= size == 0.0
            if rate is not None:
                done |= rate >= 1.0 or rate / (1 - min(rate, 0.9)) * size < self.newton_tol
            if done:
                self.iterations = k + 1
                return Step(self.t, h, self.z, Z, p.differential)
            last = size
        return None

    def accept(self, step: Step) -> None:
        """Go on from the end of ``step``."""
        p = self.problem
        self.before = step
        self.t, self.z = step.start + step.length, step.last
        self.g = p.stored(np.array([self.t]), self.z[:, None])[:, 0]
        if not p.linear and self.iterations > 2:
            self.M, self.J = p.slopes(self.t, self.z)
            self.lu = None

    def advance(self, h: float, end: float) -> tuple[Step, float]:
        """One step whose error is within tolerance, not yet accepted, and the next length."""
        rejected = False
        active, f0 = self.problem.differential, self._rate()
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
            assert self.lu is not None  # ``take`` has factorised
            (lr, pr, _), _ = self.lu
            # of what is stored, not of ``M`` times the unknowns: that is of an earlier state
            late = self.problem.stored(self.t + h * NODES, self.z[:, None] + step.increments)
            ZE = np.where(self.problem.rows, (late - self.g[:, None]) @ _ERROR / h, 0.0)
            error, _ = lapack.dgetrs(lr, pr, f0 + ZE)
            scale = self.rtol * (1.0 + np.maximum(np.abs(self.z), np.abs(step.last)))
            size = _norm((error / scale)[active])
            if rejected and size > 1.0:
                again = self.problem.flow(np.array([self.t]), (self.z + error)[:, None])[:, 0]
                again = np.where(self.problem.rows, again, 0.0)
                error, _ = lapack.dgetrs(lr, pr, again + ZE)
                size = _norm((error / scale)[active])
            safety = 0.9 * (2 * _MAX_NEWTON + 1) / (2 * _MAX_NEWTON + self.iterations)
            factor = self._factor_of(h, size)
            if size <= 1.0:
                factor = min(10.0, safety * factor)
                self.h_before, self.error_before = h, max(size, 1e-10)
                return step, h * factor if factor >= 1.2 or factor < 1.0 else h
            h, rejected = h * max(0.2, safety * factor), True

    def _factor_of(self, h: float, size: float) -> float:
        if size == 0.0:
            return 10.0
        factor = 1.0
        if self.h_before and self.error_before:
            factor = h / self.h_before * (self.error_before / size) ** 0.25
        return min(1.0, factor) * size**-0.25


def _norm(x: np.ndarray) -> float:
    return float(np.sqrt(np.mean(x * x))) if x.size else 0.0
