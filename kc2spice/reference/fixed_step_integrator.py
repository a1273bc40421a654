"""Transient analysis with equal time steps, for circuits that contain bodies.

A body with n unknowns is connected to other parts at p ports (`PortBody`). In each stage of the
method, the unknowns x of the body solve ``P(s) x = r + B a`` with port inputs a, input matrix B and
the effect r of earlier steps. The matrix ``P(s)`` contains the body's equations at the value
``s = 1/(gamma h)``, with the time step h and ``gamma = 1 - 1/sqrt(2)``. The outputs are ``y = H(s)
a + C P(s)^-1 r``, where ``H(s)`` is the transfer matrix of the ports.

The matrix ``P(s)`` is factorised only once for all steps. Each stage then needs one back
substitution, and the solution of a small nonlinear system. In the nonlinear system, p linear
relations represent the body, and all other parts have their laws.

The method of Alexander (SIAM J. Numer. Anal. 14, 1006, 1977) has two stages and second-order
accuracy. The method is L-stable: a motion that is too fast for the time step decays and does not
ring. The equations of the two stages are::

    g(z_1) = g(z_0) + gamma h f(z_1),                gamma = 1 - 1/sqrt(2),  s = 1/(gamma h)
    g(z)   = g(z_0) + (1 - gamma) h f(z_1) + gamma h f(z)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import starmap
from typing import Any

import numpy as np
from scipy import sparse

from kc2spice.core.constitutive_laws import Device, PortBody, Relation
from kc2spice.core.errors import SimulationError
from kc2spice.linalg.factor import factorise
from kc2spice.reference.equilibrium import Interval, LimitedTangents, find_equilibrium, join_waves
from kc2spice.reference.system import System

GAMMA = 1.0 - np.sqrt(0.5)
MAX_ITERATIONS = 60  # largest number of iterations in a stage, including changes of device modes
# iteration number from which only one device at a time changes its mode
SINGLE_SWITCH_ITERATION = 30
# A device changes its mode if a guard function of the device becomes negative.
# A negative guard function of at most this magnitude counts as a rounding error.
GUARD_ROUNDING = 1e-15
ZERO_LOAD = 1e-100  # largest load that counts as zero, because no solver resolves it
# A body without supports has no finite static response, so its response to a slow load is used.
# The slow load is e^(s t), where the rate s is DRIFT_RATE_RATIO times the fastest rate of the body.
# A load e^(s t) with s = DRIFT_RATE_RATIO * (fastest rate of a body) moves the body only rigidly.
DRIFT_RATE_RATIO = 3e-8


class _BodyIntegrator:
    """Integrator of a body with time steps of fixed length.

    The equations of the body are ``sum_k P_k d^k x/dt^k = B a``. The body starts at rest, in
    equilibrium with the initial inputs ``a`` of its ports.

    Raises
    ------
    SimulationError : the matrix of a time step is singular.
    """

    def __init__(self, law: PortBody, step: float, e: np.ndarray) -> None:
        self.law, self.pencil = law, law.model.pencil
        self.step, self.rate = step, 1.0 / (GAMMA * step)
        self.solve = _make_solver(self.pencil, self.rate)
        self.answers = self.solve(self.pencil.B)
        H = self.pencil.C @ self.answers + self.pencil.D
        self.H = 0.5 * (H + H.T) if self.pencil.is_symmetric and self.pencil.is_collocated else H
        self.x, self.v, self._v, self._a = np.zeros((4, self.pencil.size))
        a = law.compute_loads(e)
        if np.abs(a).max(initial=0.0) > ZERO_LOAD:
            self.x = make_static_solver(self.pencil)(self.pencil.B @ a)

    def begin_stage(self, second: bool) -> Relation:
        """Begin a stage of a time step; return the body's input-output relation.

        Within the stage, the outputs of the body are an affine function of its port inputs. A time
        step has two stages; ``second`` is true in the second stage.
        """
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

    def finish_stage(self, e: np.ndarray, second: bool) -> None:
        """Finish a stage of a time step: update the states of the body.

        ``e`` contains the inputs of the body.
        """
        x, v = self._past
        displacement = self._free + self.answers @ self.law.compute_loads(e)
        self._v = self.rate * (displacement - x)
        self._a = self.rate * (self._v - v)
        if second:
            self.x, self.v = displacement, self._v


def _make_solver(pencil: Any, s: float) -> Callable[[np.ndarray], np.ndarray]:
    """Return a solver of ``P(s) x = b`` with a body's matrix polynomial at real ``s``.

    The function uses a Cholesky factor if ``P(s)`` is positive definite.
    """
    if pencil.is_symmetric:
        matrix = sparse.csc_array(pencil.evaluate_polynomial(s))
        if matrix.shape[0] == pencil.size:
            try:
                return factorise(matrix, definite=True).solve
            except SimulationError:
                pass  # the matrix is indefinite and needs pivoting
    result: Callable[[np.ndarray], np.ndarray] = pencil.factorise_polynomial(s)[0].solve
    return result


def make_static_solver(pencil: Any) -> Callable[[np.ndarray], np.ndarray]:
    """Return a function that computes the static solution of a body for a load.

    The function multiplies the load by the inverse of the static matrix ``P(0)``. For a body
    without a mechanical support, ``P(0)`` is singular. The function then uses ``P(s)`` at a rate
    ``s`` far below the natural frequencies of the body.

    Raises
    ------
    SimulationError : both ``P(0)`` and ``P(s)`` are singular.
    """
    try:
        return _make_solver(pencil, 0.0)
    except SimulationError:
        ratio = float(abs(pencil.coefficients[0]).max()) / float(abs(pencil.coefficients[-1]).max())
        return _make_solver(pencil, DRIFT_RATE_RATIO * ratio ** (1 / pencil.degree))


@dataclass(frozen=True, eq=False)
class FixedStepResult:
    """Result of a fixed-step run: times, waveforms and switching states of devices.

    ``time`` and each waveform have the shape (nt,). The waveforms exclude currents and forces that
    contain the rate of change of a stored charge or momentum. Bodies have no modes.
    """

    time: np.ndarray
    waves: dict[str, np.ndarray]
    modes: list[tuple[Any, ...]]


def integrate_steps(
    system: System,
    first: float,
    step: float,
    count: int,
    start_from: Callable[[System, np.ndarray], np.ndarray] | None = None,
    progress: Callable[[float], None] | None = None,
) -> FixedStepResult:
    """Integrate a system over ``count`` equal time steps from the time ``first`` [s].

    All parts start in equilibrium at t = 0, and bodies stay in equilibrium until ``first``. Parts
    other than bodies may leave their equilibrium before the time ``first``. Then the function
    ``start_from`` must convert the unknowns in equilibrium at t = 0 to the unknowns at the time
    ``first``.

    Raises
    ------
    SimulationError : there is no equilibrium, a stage does not converge, or the inputs of a law
    leave the valid range.
    """
    z, modes = find_equilibrium(system)
    march = _StepIntegrator(system, modes, step)
    es = march.make_interval(0.0).compute_device_inputs(0.0, z)
    for k, ported in march.ported:
        march.bodies[k] = _BodyIntegrator(ported, step, es[k])
    if start_from is not None:
        z = start_from(system, z)
    es = march.make_interval(first).compute_device_inputs(first, z)
    for k, law in march.others:
        march.modes[k] = law.find_initial_mode(es[k])
    times, states, intervals = [first], [z], [march.make_interval(first)]
    for k in range(count):
        z = march.step(first + k * step, z)
        times.append(first + (k + 1) * step)
        states.append(z)
        intervals.append(march.make_interval(times[-1]))
        if progress is not None and k % 20 == 0:
            progress(k / count)
    time = np.array(times)
    unknowns = np.array(states)
    rates = np.gradient(unknowns.T, time, axis=1).T
    points = zip(intervals, time[:, None], unknowns[:, :, None], rates[:, :, None], strict=True)
    waves = join_waves(list(starmap(Interval.compute_waveforms, points)))
    for _, law in march.others:
        for k in law.storing_flow_indices:
            waves.pop(f"{law.name}.{law.flows[k].pin}.through", None)
    return FixedStepResult(
        time, {"time": time} | waves, list(map(march.get_switching_states, intervals))
    )


class _StepIntegrator:
    """Fixed-step integrator of a system with bodies.

    The integrator stores the states of the bodies and the present mode of each device.
    """

    def __init__(self, system: System, modes: list[Any], step: float) -> None:
        self.system, self.modes, self.h = system, modes, step
        self.rate = 1.0 / (GAMMA * step)
        self.ported, self.others = list[tuple[int, PortBody]](), list[tuple[int, Device]]()
        for k, device in enumerate(system.devices):
            if isinstance(device.law, PortBody):
                self.ported.append((k, device.law))
            else:
                self.others.append((k, device.law))
        self.bodies: dict[int, _BodyIntegrator] = {}
        self.is_affine = all(law.is_affine for _, law in self.others)

    def make_interval(self, t: float) -> Interval:
        """Make the interval that begins at time ``t`` with the present switching states."""
        return Interval(self.system, list(self.modes), t)

    def get_switching_states(self, interval: Interval) -> tuple[Any, ...]:
        """Return the switching states of all devices except bodies in one time interval.

        The mode of a device states which pieces of its piecewise equations apply.
        """
        return tuple(interval.modes[k] for k, _ in self.others)

    def step(self, t: float, z: np.ndarray) -> np.ndarray:
        """Compute the unknowns one step after the time ``t``.

        The function also stores the switching state of each device at the end of the step.
        """
        stored = self.make_interval(t).evaluate_equations(t, z)[0]
        stage_time = t + GAMMA * self.h
        first = self._solve_stage(stage_time, z, stored, False)
        inner = self.make_interval(stage_time).evaluate_equations(stage_time, first)[0]
        last = self._solve_stage(
            t + self.h, first, stored + (1 - GAMMA) / GAMMA * (inner - stored), True
        )
        es = self.make_interval(t + self.h).compute_device_inputs(t + self.h, last)
        for k, law in self.others:
            law.require_in_range(t + self.h, es[k])
        return last

    def _solve_stage(self, t: float, z: np.ndarray, stored: np.ndarray, second: bool) -> np.ndarray:
        """Solve the equations ``g(z) - stored = f(z) / rate`` of a stage for ``z``.

        The function also stores the switching state of each device at the solution ``z``.
        """
        for k, body in self.bodies.items():
            self.modes[k] = body.begin_stage(second)
        es = self.make_interval(t).compute_device_inputs(t, z)
        self._switch_devices(es, 0)
        tangents = LimitedTangents()
        for count in range(MAX_ITERATIONS):
            interval, limited = tangents.linearise_limited_laws(self.make_interval(t), t, z)
            g, f = interval.evaluate_equations(t, z)
            M, J = interval.compute_jacobians(t, z)
            J = J - self.rate * M
            size = np.abs(J).max(axis=1)
            right = self.rate * (g - stored) - f
            change = np.linalg.solve(J / size[:, None], right / size)
            z = z + change
            es = interval.compute_device_inputs(t, z)
            small = np.abs(change).max() <= 1e-10 * (1e-3 + np.abs(z).max())
            if not self._switch_devices(es, count) and (self.is_affine or (small and not limited)):
                for k, body in self.bodies.items():
                    body.finish_stage(es[k], second)
                return z
        raise SimulationError(
            "the iteration of a time step does not converge", where=f"t = {t:.6e} s"
        )

    def _switch_devices(self, es: list[np.ndarray], count: int) -> bool:
        """Switch the state of each device that has a negative guard function.

        Return whether a mode changed.
        """
        changed = False
        for k, law in self.others:
            guards = law.evaluate_guards(es[k], self.modes[k])
            if guards.size and guards.min() < -GUARD_ROUNDING:
                changed = True
                if count >= SINGLE_SWITCH_ITERATION:
                    self.modes[k] = law.find_next_mode(self.modes[k], int(guards.argmin()))
                    break
                self.modes[k] = law.find_initial_mode(es[k])
        return changed
