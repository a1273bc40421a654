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
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import PortBody, Relation
from kc2spice.linalg.factor import factorise
from kc2spice.reference.assemble import System
from kc2spice.reference.equilibrium import equilibrium

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
    """``time`` (nt,), every wave by name (nt,) as of a `reference.integrate.Result` but for outputs
    of devices, and the ``inputs`` (nt, m) of each device by its name."""

    time: np.ndarray
    waves: dict[str, np.ndarray]
    inputs: dict[str, np.ndarray]


def seconds(system: System, step: float) -> tuple[float, list[Body]]:
    """Wall time of a step, from one back substitution of each body, and the bodies."""
    bodies = [Body(law.model, step) for law in ported(system)]
    started = time.perf_counter()
    for body in bodies:
        body.solve(np.ones(body.pencil.size))
    return 2 * (time.perf_counter() - started), bodies


def ported(system: System) -> tuple[PortBody, ...]:
    """Its bodies that are known at their ports."""
    return tuple(d.law for d in system.devices if isinstance(d.law, PortBody))


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
    z, rest = equilibrium(system)
    s, d = system.inputs(0.0, 0.0)
    own = dict(zip(_ported(system), bodies, strict=True))
    for k, body in own.items():
        body.start(_loads(system, k, system.devices[k].inputs.at(z, s, d)))
    if given is not None:
        z = given(system, z)
    march = _March(system, own, rest, step)
    modes = march.rest
    for k, device in enumerate(system.devices):
        if k not in own:
            modes[k] = device.law.mode(first, device.inputs.at(z, *system.inputs(first, first)))
    record = _Record(system)
    record.add(first, z)
    for k in range(count):
        z = march.step(first + k * step, z, modes)
        record.add(first + (k + 1) * step, z)
        if progress is not None and k % 20 == 0:
            progress(k / count)
    return record.steps()


def _loads(system: System, k: int, e: np.ndarray) -> np.ndarray:
    law = system.devices[k].law
    assert isinstance(law, PortBody)
    return law.loads(e)


def _ported(system: System) -> list[int]:
    return [k for k, d in enumerate(system.devices) if isinstance(d.law, PortBody)]


class _March:
    def __init__(self, system: System, own: dict[int, Body], rest: list[Any], step: float) -> None:
        self.system, self.own, self.rest, self.h = system, own, list(rest), step
        self.s = 1.0 / (GAMMA * step)
        self.corners = [
            d.law.corners(np.inf) if k not in own else np.empty(0)
            for k, d in enumerate(system.devices)
        ]
        self.affine = all(d.law.affine or k in own for k, d in enumerate(system.devices))

    def step(self, t: float, z: np.ndarray, modes: list[Any]) -> np.ndarray:
        """The unknowns a step after ``t``; ``modes`` are changed to those there."""
        kept = self._stored(t, z, modes)
        first = self._stage(t + GAMMA * self.h, z, kept, modes, False)
        inner = self._stored(t + GAMMA * self.h, first, modes)
        kept = kept + (1 - GAMMA) / GAMMA * (inner - kept)
        last = self._stage(t + self.h, first, kept, modes, True)
        for device, e in zip(self.system.devices, self._inputs(t + self.h, last), strict=True):
            device.law.check(t + self.h, e)
        return last

    def _inputs(self, t: float, z: np.ndarray) -> list[np.ndarray]:
        s, d = self.system.inputs(t, t)
        return [device.inputs.at(z, s, d) for device in self.system.devices]

    def _stored(self, t: float, z: np.ndarray, modes: list[Any]) -> np.ndarray:
        system = self.system
        s, d = system.inputs(t, t)
        g = system.M @ z + system.Gs @ s + system.Gd @ d
        for device, mode in zip(system.devices, modes, strict=True):
            if device.stores is not None:
                g = g + device.stores @ device.law.store(device.inputs.at(z, s, d), mode)[0]
        return g

    def _stage(
        self, t: float, z: np.ndarray, kept: np.ndarray, modes: list[Any], second: bool
    ) -> np.ndarray:
        """Solve ``s (g(z) - kept) = f(z)`` at ``t`` for unknowns and modes."""
        system, rate = self.system, self.s
        for k, body in self.own.items():
            modes[k] = body.relation(second)
        s, d = system.inputs(t, t)
        fixed = system.Bs @ s + system.Bd @ d + system.const
        fixed = fixed - rate * (system.Gs @ s + system.Gd @ d - kept)
        linear = system.A - rate * system.M
        es = [device.inputs.at(z, s, d) for device in system.devices]
        begin = self.h * (GAMMA if not second else 1.0)
        for k, at in enumerate(self.corners):
            if np.any((at > t - begin) & (at <= t)):
                modes[k] = system.devices[k].law.mode(t, es[k], modes[k])
        self._switch(t, es, modes, 0)
        for count in range(ITERATIONS):
            f, J = linear @ z + fixed, linear
            for device, e, mode in zip(system.devices, es, modes, strict=True):
                out, slope = device.law.evaluate(t, e, mode)
                f = f + device.into @ out
                J = J + device.into @ slope @ device.inputs.z
                if device.stores is not None:
                    value, by = device.law.store(e, mode)
                    f = f - rate * (device.stores @ value)
                    J = J - rate * (device.stores @ by @ device.inputs.z)
            size = np.abs(J).max(axis=1)
            change = np.linalg.solve(J / size[:, None], -f / size)
            z = z + change
            es = [device.inputs.at(z, s, d) for device in system.devices]
            small = np.abs(change).max() <= 1e-10 * (1e-3 + np.abs(z).max())
            if not self._switch(t, es, modes, count) and (self.affine or small):
                for k, body in self.own.items():
                    body.loaded(_loads(system, k, es[k]), second)
                return z
        raise SimulationError("a time step does not settle", where=f"t = {t:.6e} s")

    def _switch(self, t: float, es: list[np.ndarray], modes: list[Any], count: int) -> bool:
        """Whether a device had to change its mode."""
        changed = False
        for k, device in enumerate(self.system.devices):
            if k in self.own:
                continue
            guards = device.law.guards(t, es[k], modes[k])
            if guards.size and guards.min() < -ROUNDING:
                if count < ONE_BY_ONE:
                    modes[k] = device.law.mode(t, es[k], modes[k])
                else:
                    modes[k], _ = device.law.switch(modes[k], int(guards.argmin()))
                changed = True
                if count >= ONE_BY_ONE:
                    break
        return changed


class _Record:
    """Unknowns and what devices see over time, read as waves at the end."""

    def __init__(self, system: System) -> None:
        self.system = system
        self.time: list[float] = []
        self.z: list[np.ndarray] = []

    def add(self, t: float, z: np.ndarray) -> None:
        self.time.append(t)
        self.z.append(z)

    def steps(self) -> Steps:
        system, times, z = self.system, np.array(self.time), np.array(self.z).T
        pairs = [system.inputs(t, t) for t in self.time]
        s, d = (np.array(each).reshape(times.size, -1).T for each in zip(*pairs, strict=True))
        waves = {name: rows.at(z, s, d)[0] for name, rows in system.across.items()}
        waves |= {f"{name}.rate": rows.at(z, s, d)[0] for name, rows in system.rates.items()}
        for name, (direct, rated) in system.through.items():
            change = np.gradient(rated.at(z, s, d)[0], times) if times.size > 1 else 0.0
            waves[f"{name}.through"] = direct.at(z, s, d)[0] + change
        inputs = {}
        for device in system.devices:
            law, e = device.law, device.inputs.at(z, s, d).T
            if isinstance(law, PortBody):
                own = zip(law.states, e[:, len(law.taps) :].T, strict=True)
                waves |= {f"{law.name}.{state}": value for state, value in own}
            else:
                inputs[law.name] = e
        return Steps(times, {"time": times} | waves, inputs)
