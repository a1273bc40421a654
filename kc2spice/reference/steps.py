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

import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import PortBody, Relation
from kc2spice.linalg.factor import factorise
from kc2spice.reference.assemble import System
from kc2spice.reference.equilibrium import equilibrium
from kc2spice.reference.interval import Interval

GAMMA = 1.0 - np.sqrt(0.5)
ITERATIONS = 60  # of a stage, modes of devices among them
ONE_BY_ONE = 30  # iterations after which devices change their modes one at a time
ROUNDING = 1e-15  # by which a guard may be negative
NOTHING = 1e-100  # of any load; what rounding leaves of none cannot be solved for
SLOW = 3e-8  # of the fastest rate of a free body: so slow that it is at rest but for its drift


class Body:
    """A linear model, ``sum_k d^k/dt^k P_k x = B a``, in steps of one size.

    Raises
    ------
    SimulationError : the matrix of its steps is singular.
    """

    def __init__(self, model: Any, step: float) -> None:
        self.pencil, self.step, self.rate = model.pencil, step, 1.0 / (GAMMA * step)
        self.solve = _solver(self.pencil, self.rate)
        self.answers = self.solve(self.pencil.B)
        H = self.pencil.C @ self.answers + self.pencil.D
        self.H = 0.5 * (H + H.T) if self.pencil.symmetric and self.pencil.collocated else H
        self.x = np.zeros(self.pencil.size)
        self.v, self._v, self._a = (np.zeros_like(self.x) for _ in range(3))

    def start(self, a: np.ndarray) -> None:
        """At rest under the loads ``a`` (inputs,)."""
        self.v = np.zeros_like(self.x)
        loaded = np.abs(a).max(initial=0.0) > NOTHING
        self.x = at_rest(self.pencil)(self.pencil.B @ a) if loaded else np.zeros_like(self.v)

    def relation(self, second: bool) -> Relation:
        """Of the next stage."""
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

    def loaded(self, a: np.ndarray, second: bool) -> None:
        """End the stage with the loads ``a``."""
        x, v = self._past
        now = self._free + self.answers @ a
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
    found: Callable[[np.ndarray], np.ndarray] = pencil.solver(s)[0].solve
    return found


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


@dataclass(frozen=True)
class Steps:
    """``time`` (nt,), every wave by name (nt,) as of a `reference.integrate.Result` but for what
    depends on outputs of devices, and the ``inputs`` (nt, m) of each device but bodies by name."""

    time: np.ndarray
    waves: dict[str, np.ndarray]
    inputs: dict[str, np.ndarray]


def seconds(system: System, step: float) -> tuple[float, list[Body]]:
    """Wall time of a step, from one back substitution of each body, and the bodies."""
    bodies = [Body(d.law.model, step) for d in system.devices if isinstance(d.law, PortBody)]
    started = time.perf_counter()
    for body in bodies:
        body.solve(np.ones(body.pencil.size))
    return 2 * (time.perf_counter() - started), bodies


def steps(
    system: System,
    bodies: Iterable[Body],
    first: float,
    step: float,
    count: int,
    given: Callable[[System, np.ndarray], np.ndarray] | None = None,
    progress: Callable[[float], None] | None = None,
) -> Steps:
    """``count`` steps from ``first`` [s] on.

    The laws begin in equilibrium, the bodies in that of t = 0, until ``first``; ``given`` turns the
    unknowns there into those of ``first``, for laws that move before the bodies do.

    Raises
    ------
    SimulationError : no equilibrium, a stage that does not settle, or a law that left its range.
    """
    z, modes = equilibrium(system)
    ported = [k for k, d in enumerate(system.devices) if isinstance(d.law, PortBody)]
    march = _March(system, dict(zip(ported, bodies, strict=True)), modes, step)
    es = Interval(system, modes, 0.0).inputs(0.0, z)
    for k, body in march.own.items():
        body.start(march.loads(k, es[k]))
    if given is not None:
        z = given(system, z)
    es = march.interval(first).inputs(first, z)
    for k, device in enumerate(system.devices):
        if k not in march.own:
            march.modes[k] = device.law.mode(first, es[k])
    times, states = [first], [z]
    for k in range(count):
        z = march.step(first + k * step, z)
        times.append(first + (k + 1) * step)
        states.append(z)
        if progress is not None and k % 20 == 0:
            progress(k / count)
    return _read(system, np.array(times), np.array(states).T)


class _March:
    def __init__(
        self, system: System, own: dict[int, Body], modes: Sequence[Any], step: float
    ) -> None:
        self.system, self.own, self.modes, self.h = system, own, list(modes), step
        self.rate = 1.0 / (GAMMA * step)
        self.corners = [
            np.empty(0) if k in own else d.law.corners(np.inf) for k, d in enumerate(system.devices)
        ]
        self.affine = all(d.law.affine or k in own for k, d in enumerate(system.devices))

    def interval(self, t: float) -> Interval:
        """The system in its modes about ``t``."""
        return Interval(self.system, self.modes, t)

    def loads(self, k: int, e: np.ndarray) -> np.ndarray:
        """Those on the body that is device ``k``."""
        law = self.system.devices[k].law
        assert isinstance(law, PortBody)
        return law.loads(e)

    def step(self, t: float, z: np.ndarray) -> np.ndarray:
        """The unknowns a step after ``t``; the modes become those there."""
        kept = self.interval(t).at(t, z)[0]
        within = t + GAMMA * self.h
        first = self._stage(within, z, kept, False)
        inner = self.interval(within).at(within, first)[0]
        last = self._stage(t + self.h, first, kept + (1 - GAMMA) / GAMMA * (inner - kept), True)
        es = self.interval(t + self.h).inputs(t + self.h, last)
        for device, e in zip(self.system.devices, es, strict=True):
            device.law.check(t + self.h, e)
        return last

    def _stage(self, t: float, z: np.ndarray, kept: np.ndarray, second: bool) -> np.ndarray:
        """Solve ``g(z) - kept = f(z) / rate`` at ``t`` for unknowns and modes."""
        for k, body in self.own.items():
            self.modes[k] = body.relation(second)
        es = self.interval(t).inputs(t, z)
        begin = self.h * (1.0 if second else GAMMA)
        for k, at in enumerate(self.corners):
            if np.any((at > t - begin) & (at <= t)):
                self.modes[k] = self.system.devices[k].law.mode(t, es[k], self.modes[k])
        self._switch(t, es, 0)
        for count in range(ITERATIONS):
            interval = self.interval(t)
            g, f = interval.at(t, z)
            M, J = interval.slopes(t, z)
            J = J - self.rate * M
            size = np.abs(J).max(axis=1)
            right = self.rate * (g - kept) - f
            change = np.linalg.solve(J / size[:, None], right / size)
            z = z + change
            es = interval.inputs(t, z)
            small = np.abs(change).max() <= 1e-10 * (1e-3 + np.abs(z).max())
            if not self._switch(t, es, count) and (self.affine or small):
                for k, body in self.own.items():
                    body.loaded(self.loads(k, es[k]), second)
                return z
        raise SimulationError("a time step does not settle", where=f"t = {t:.6e} s")

    def _switch(self, t: float, es: list[np.ndarray], count: int) -> bool:
        """Whether a device had to change its mode."""
        changed = False
        for k, device in enumerate(self.system.devices):
            if k in self.own:
                continue
            guards = device.law.guards(t, es[k], self.modes[k])
            if guards.size and guards.min() < -ROUNDING:
                changed = True
                if count >= ONE_BY_ONE:
                    self.modes[k], _ = device.law.switch(self.modes[k], int(guards.argmin()))
                    break
                self.modes[k] = device.law.mode(t, es[k], self.modes[k])
        return changed


def _read(system: System, times: np.ndarray, z: np.ndarray) -> Steps:
    """Waves of the unknowns (n, nt) and what devices see."""
    given = np.array([system.given(t, t) for t in times]).T
    X = np.concatenate((z, given))
    waves = {"time": times}
    for name, output in system.outputs.items():
        if not output.devices.any():
            change = np.gradient(output.rated @ X, times) if times.size > 1 else 0.0
            waves[name] = output.now @ X + output.constant + change
    inputs = {
        d.law.name: (d.inputs @ X).T for d in system.devices if not isinstance(d.law, PortBody)
    }
    return Steps(times, waves, inputs)
