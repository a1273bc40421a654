"""Transient in equal steps of laws with bodies that are known at their ports: any `PortBody`.

A body of n unknowns meets the others at p ports. Within a stage of an implicit method with the
rate ``s`` its unknowns are ``x = P(s)^-1 (r + B a)`` with what its past leaves in ``r``, thus
``y = H(s) a + C P(s)^-1 r``: one factorisation for all steps, one back substitution a stage, and
a small nonlinear system of all other laws with the body as p linear relations.

The method is that of Alexander (SIAM J. Numer. Anal. 14, 1006, 1977): two stages, second order,
L-stable, so that what is too fast for the steps dies out instead of ringing::

    g(z_1) = g(z_0) + gamma h f(z_1),                gamma = 1 - 1/sqrt(2),  s = 1/(gamma h)
    g(z)   = g(z_0) + (1 - gamma) h f(z_1) + gamma h f(z)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import PortBody, Relation
from kc2spice.linalg.factor import factorise
from kc2spice.reference.equilibrium import Interval, equilibrium
from kc2spice.reference.system import System

GAMMA = 1.0 - np.sqrt(0.5)
ITERATIONS = 60  # iterations of a stage, including changes of device modes
ONE_BY_ONE = 30  # iterations after which devices change their modes one at a time
ROUNDING = 1e-15  # by which a guard may be negative
NOTHING = 1e-100  # zero load; a solver cannot solve for its rounding errors
SLOW = 3e-8  # rate of a free body that only drifts, relative to its fastest rate


class _Body:
    """Integrator of the linear model ``sum_k P_k d^k x/dt^k = B a`` with steps of fixed length.

    It starts from rest with the initial input ``a`` (inputs,).

    Raises
    ------
    SimulationError : the matrix of its steps is singular.
    """

    def __init__(self, law: PortBody, step: float, e: np.ndarray) -> None:
        self.law, self.pencil = law, law.model.pencil
        self.step, self.rate = step, 1.0 / (GAMMA * step)
        self.solve = _solver(self.pencil, self.rate)
        self.answers = self.solve(self.pencil.B)
        H = self.pencil.C @ self.answers + self.pencil.D
        self.H = 0.5 * (H + H.T) if self.pencil.symmetric and self.pencil.collocated else H
        self.x, self.v, self._v, self._a = np.zeros((4, self.pencil.size))
        a = law.loads(e)
        if np.abs(a).max(initial=0.0) > NOTHING:
            self.x = at_rest(self.pencil)(self.pencil.B @ a)

    def relation(self, second: bool) -> Relation:
        """Right-hand side of the next stage."""
        P, s = self.pencil.coefficients, self.rate
        x, v = self.x, self.v
        if second:
            x, v = x + (1 - GAMMA) * self.step * self._v, v + (1 - GAMMA) * self.step * self._a
        self._past = x, v
        known = s * (P[1] @ x)
        if self.pencil.degree == 2:
            known = known + P[2] @ (s * s * x + s * v)
        self._free = self.solve(known)
        return Relation(self.H, self.pencil.C @ self._free)

    def loaded(self, e: np.ndarray, second: bool) -> None:
        """End the stage with what the device sees."""
        x, v = self._past
        now = self._free + self.answers @ self.law.loads(e)
        self._v = self.rate * (now - x)
        self._a = self.rate * (self._v - v)
        if second:
            self.x, self.v = now, self._v


def _solver(pencil: Any, s: float) -> Callable[[np.ndarray], np.ndarray]:
    """``P(s)^-1`` at a real ``s``, by a Cholesky factor where there is one."""
    if pencil.symmetric:
        matrix = sparse.csc_array(pencil.at(s))
        if matrix.shape[0] == pencil.size:
            try:
                return factorise(matrix, definite=True).solve
            except SimulationError:
                pass  # indefinite: pivots are needed
    result: Callable[[np.ndarray], np.ndarray] = pencil.solver(s)[0].solve
    return result


def at_rest(pencil: Any) -> Callable[[np.ndarray], np.ndarray]:
    """``P(0)^-1``; of a body that nothing holds ``P(s)^-1`` with a rate at which it but drifts.

    Raises
    ------
    SimulationError : singular at any rate.
    """
    try:
        return _solver(pencil, 0.0)
    except SimulationError:
        sizes = [float(abs(P).max()) for P in (pencil.coefficients[0], pencil.coefficients[-1])]
        return _solver(pencil, SLOW * (sizes[0] / sizes[1]) ** (1 / pencil.degree))


@dataclass(frozen=True, eq=False)
class Steps:
    """``time`` (nt,), every wave by name (nt,) as of a `reference.integrate.Result` but currents of
    charges that devices keep, and the ``modes`` of all devices but bodies at each time."""

    time: np.ndarray
    waves: dict[str, np.ndarray]
    modes: list[tuple[Any, ...]]


def steps(
    system: System,
    first: float,
    step: float,
    count: int,
    start_from: Callable[[System, np.ndarray], np.ndarray] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Steps:
    """``count`` steps from ``first`` [s] on.

    The laws begin in equilibrium, the bodies in that of t = 0, until ``first``.
    ``start_from`` converts the unknowns there to those at ``first``, for laws that move before the
    bodies do.

    Raises
    ------
    SimulationError : no equilibrium, a stage that does not settle, or a law that left its range.
    """
    z, modes = equilibrium(system)
    march = _March(system, modes, step)
    es = march.interval(0.0).inputs(0.0, z)
    for k, ported in march.ported:
        march.bodies[k] = _Body(ported, step, es[k])
    if start_from is not None:
        z = start_from(system, z)
    es = march.interval(first).inputs(first, z)
    for k, law in march.others:
        march.modes[k] = law.mode(es[k])
    times, states, intervals = [first], [z], [march.interval(first)]
    for k in range(count):
        z = march.step(first + k * step, z)
        times.append(first + (k + 1) * step)
        states.append(z)
        intervals.append(march.interval(times[-1]))
        if progress is not None and k % 20 == 0:
            progress(k / count)
    time = np.array(times)
    result = np.array(states).T, np.gradient(np.array(states).T, time, axis=1)
    points = zip(intervals, time[:, None], *(item.T[:, :, None] for item in result), strict=True)
    item = [interval.waves(*point) for interval, *point in points]
    laws = [law for _, law in march.others]
    charges = {f"{law.name}.{law.flows[k].pin}.through" for law in laws for k in law.charged}
    waves = {name: np.concatenate([row[name] for row in item]) for name in {*item[0]} - charges}
    mode_history = [tuple(interval.modes[k] for k, _ in march.others) for interval in intervals]
    return Steps(time, {"time": time} | waves, mode_history)


class _March:
    """The state of a run but for the unknowns: bodies and modes."""

    def __init__(self, system: System, modes: list[Any], step: float) -> None:
        self.system, self.modes, self.h = system, modes, step
        self.rate = 1.0 / (GAMMA * step)
        laws = [device.law for device in system.devices]
        self.ported = [(k, law) for k, law in enumerate(laws) if isinstance(law, PortBody)]
        self.others = [(k, law) for k, law in enumerate(laws) if not isinstance(law, PortBody)]
        self.bodies: dict[int, _Body] = {}
        self.affine = all(law.affine for _, law in self.others)

    def interval(self, t: float) -> Interval:
        """The system in its modes about ``t``."""
        return Interval(self.system, list(self.modes), t)

    def step(self, t: float, z: np.ndarray) -> np.ndarray:
        """The unknowns a step after ``t``; the modes become those there."""
        stored = self.interval(t).at(t, z)[0]
        within = t + GAMMA * self.h
        first = self._stage(within, z, stored, False)
        inner = self.interval(within).at(within, first)[0]
        last = self._stage(t + self.h, first, stored + (1 - GAMMA) / GAMMA * (inner - stored), True)
        es = self.interval(t + self.h).inputs(t + self.h, last)
        for k, law in self.others:
            law.check(t + self.h, es[k])
        return last

    def _stage(self, t: float, z: np.ndarray, stored: np.ndarray, second: bool) -> np.ndarray:
        """Solve ``g(z) - kept = f(z) / rate`` at ``t`` for unknowns and modes."""
        for k, body in self.bodies.items():
            self.modes[k] = body.relation(second)
        es = self.interval(t).inputs(t, z)
        self._switch(es, 0)
        for count in range(ITERATIONS):
            interval = self.interval(t)
            g, f = interval.at(t, z)
            M, J = interval.slopes(t, z)
            J = J - self.rate * M
            size = np.abs(J).max(axis=1)
            right = self.rate * (g - stored) - f
            change = np.linalg.solve(J / size[:, None], right / size)
            z = z + change
            es = interval.inputs(t, z)
            small = np.abs(change).max() <= 1e-10 * (1e-3 + np.abs(z).max())
            if not self._switch(es, count) and (self.affine or small):
                for k, body in self.bodies.items():
                    body.loaded(es[k], second)
                return z
        raise SimulationError(
            "the iteration of a time step does not converge", where=f"t = {t:.6e} s"
        )

    def _switch(self, es: list[np.ndarray], count: int) -> bool:
        """Whether a device had to change its mode."""
        changed = False
        for k, law in self.others:
            guards = law.guards(es[k], self.modes[k])
            if guards.size and guards.min() < -ROUNDING:
                changed = True
                if count >= ONE_BY_ONE:
                    self.modes[k] = law.switch(self.modes[k], int(guards.argmin()))
                    break
                self.modes[k] = law.mode(es[k])
        return changed
