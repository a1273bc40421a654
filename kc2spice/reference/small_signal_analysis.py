"""Linearisation of a circuit at the operating point: ac response, modes, noise.

For waveforms that consist of straight lines and sines, the transient solution of the linearised
circuit is exact.

The admittance ``Y`` of a linear part is current divided by voltage, or force divided by velocity.
The thermal noise of the part is a current or a force. The one-sided spectral density of the noise
is ``4 k T (Y + Y^H) / 2`` per Hz (H. B. Callen, T. A. Welton, Phys. Rev. 83 (1951) 34). This module
computes the noise of a body from the responses at the ports of the body. In contrast, the netlist
of a body contains one noise force for each mode.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, repeat
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np
import scipy.linalg as sla

from kc2spice.core import constitutive_laws as L
from kc2spice.core.quantities import BOLTZMANN, DEFAULT_TEMPERATURE
from kc2spice.core.waveforms import Function, Waveform
from kc2spice.reference.equilibrium import Interval, find_equilibrium
from kc2spice.reference.system import System, assemble_system

# modes are not used if the condition number of the eigenvector matrix exceeds this limit
_MAX_BASIS_CONDITION = 1e9
# a rigid-body mode has (rate / largest rate) below this ratio
_RIGID_RATE_RATIO = 1e-7
# largest rate of a rigid-body mode, divided by the rate that rounding errors cause
_RIGID_RATE_ROUNDINGS = 1e2
# Rounding error of a sum whose terms cancel, divided by the sum of the absolute terms.
CANCELLATION_ROUNDING = 1e-9
# largest permitted (effect of sources on rigid-body modes / effect of sources on all modes)
_MAX_RIGID_EFFECT = 1e-7

RateMap = Callable[[np.ndarray], np.ndarray]


class LinearisedSystem:
    """Linearised equations ``d/dt (G X) = F X`` of deviations ``X`` from equilibrium.

    ``X = [z, s, s']`` contains the unknowns z, the sources s and the rates s' of the sources. The
    outputs ``y = C0 X + d/dt (C1 X)`` are the waveforms of the system, in the order of
    ``System.names``. If the system is linear, ``exact`` is true, and the equations are valid for
    motions of any size.

    Devices that depend on the frequency are linearised for signals ``e^(p t)``, where p is the
    complex rate ``at`` [1/s]. ``point`` may contain the unknowns and the device modes in
    equilibrium, if already known.

    Raises
    ------
    SimulationError : the system has no equilibrium.
    """

    def __init__(
        self,
        system: System,
        at: complex = 0.0,
        point: tuple[np.ndarray, list[Any]] | None = None,
    ) -> None:
        self.system = system
        self.z0, self.device_modes = point or find_equilibrium(system)
        interval = Interval(system, self.device_modes, 0.0)
        self.rows, self.exact = interval.rows, not system.devices
        self.G, self.F = system.G, system.F
        slopes, charges = [np.zeros((0, self.F.shape[1]))], [np.zeros((0, self.F.shape[1]))]
        devices = zip(
            system.devices,
            interval.compute_device_inputs(0.0, self.z0),
            self.device_modes,
            strict=True,
        )
        for device, e, mode in devices:
            slope, charge_slope = device.law.small_signal_derivatives(at, e, mode)
            rated = np.zeros_like(slope)
            rated[list(device.law.storing_flow_indices)] = charge_slope[len(device.law.states) :]
            slopes.append(slope @ device.inputs)
            charges.append(rated @ device.inputs)
            self.F = self.F + device.into @ slopes[-1]
            if device.stores is not None:
                self.G = self.G + device.stores @ charge_slope @ device.inputs
        outputs, stores = np.concatenate(slopes), np.concatenate(charges)
        self.C0 = system.now + system.direct @ outputs
        self.C1 = system.rated + system.direct @ stores
        direct = np.abs(system.direct)
        self._sizes = (
            np.abs(system.now) + direct @ np.abs(outputs),
            np.abs(system.rated) + direct @ np.abs(stores),
        )

    def respond(self, w: complex, amplitudes: np.ndarray) -> np.ndarray:
        """Return the output amplitudes for the complex frequency ``w`` of all sources.

        The sources vary as ``amplitudes * exp(w t)``. For sines of the frequency f, the complex
        frequency ``w`` [1/s] is ``2j * pi * f``. The result has the shape (ny,).
        """
        X = self._solve_unknowns(w, amplitudes)
        return np.asarray(self.C0 @ X + w * (self.C1 @ X))

    def sum_term_sizes(self, w: complex, amplitudes: np.ndarray) -> np.ndarray:
        """Return the sum of absolute term values for each output of :meth:`respond`.

        Return an array of shape (ny,).
        """
        X = self._solve_unknowns(w, amplitudes)
        return self._compute_term_sizes(slice(None), X[:, None], np.array([w]))[:, 0]

    def _solve_unknowns(self, w: complex, amplitudes: np.ndarray) -> np.ndarray:
        """Return the amplitudes of unknowns, sources and source derivatives.

        The returned array has the shape (N,). The sources are ``amplitudes * exp(w t)`` at the time
        t, with the complex frequency ``w`` [1/s].
        """
        n, sources = self.system.size, np.concatenate((amplitudes, w * amplitudes))
        P = w * self.G - self.F
        # The row scales of the system are computed without devices, whose equations may depend on
        # the frequency.
        # Therefore, the rows of P, which include the devices, are scaled again.
        size = np.abs(P[:, :n]).max(axis=1)
        z = np.linalg.solve(P[:, :n] / size[:, None], -P[:, n:] @ sources / size)
        return np.concatenate((z, sources))

    def _compute_term_sizes(self, columns: slice, X: np.ndarray, rates: np.ndarray) -> np.ndarray:
        """Compute the sum of the magnitudes of all terms in each output, an array (ny, m).

        The sums of the absolute terms are ``|C0| |X| + |C1| |dX/dt|``, where ``dX/dt`` is ``rates *
        X``. Only the ``columns`` of C0 and C1 are used.
        """
        now, rated = self._sizes
        return np.asarray(now[:, columns] @ np.abs(X) + rated[:, columns] @ np.abs(X * rates))

    @cached_property
    def _homogeneous_equations(self) -> _FreeMotion | None:
        """Homogeneous state equations, or None if some unknowns remain undetermined."""
        n, rows, cols = self.system.size, self.rows, self.system.differential
        if rows.sum() != cols.sum() or not cols.any():
            return None
        J, algebraic = self.F[:, :n], ~cols
        try:
            inner = np.linalg.inv(J[np.ix_(~rows, algebraic)])
            follow = -inner @ J[np.ix_(~rows, cols)]
            cut = J[np.ix_(rows, algebraic)] @ inner
            inverse = np.linalg.inv(self.G[:, :n][np.ix_(rows, cols)])
        except np.linalg.LinAlgError:
            return None
        dynamics = J[np.ix_(rows, cols)] + J[np.ix_(rows, algebraic)] @ follow
        return _FreeMotion(inverse @ dynamics, inverse, follow, cut, inner)

    @cached_property
    def poles(self) -> np.ndarray:
        """Poles a (m,) [1/s] of the linearised equations: free motions are ``e^(a t)``.

        If the states do not determine the algebraic unknowns, the natural frequencies are the
        finite eigenvalues of ``F X = a G X``.
        """
        motion = self._homogeneous_equations
        if motion is not None:
            return np.linalg.eigvals(motion.rates)
        n = self.system.size
        return _compute_finite_eigenvalues(self.F[:, :n], self.G[:, :n])

    def combine_output_rows(self, of: L.WaveCombination) -> tuple[np.ndarray, np.ndarray]:
        """Combine rows of the output matrices C0 and C1 for a weighted sum of results.

        ``of`` defines a linear combination of results. The returned row vectors are linear
        combinations of the rows of ``C0`` and ``C1`` with the weights in ``of``.
        """
        names = self.system.names
        rows = of.combine(dict(zip(names, self.C0, strict=True)))
        return rows, of.combine(dict(zip(names, self.C1, strict=True)))

    def find_zeros(self, of: L.WaveCombination, amplitudes: np.ndarray) -> np.ndarray:
        """Compute the zeros of the transfer function from all sources to one output.

        The zeros are an array (m,) of complex rates ``w`` [1/s]. At the rate ``w`` of a zero, the
        output ``of`` is zero for sources ``amplitudes * e^(w t)``. With the scalars u and v, the
        sources are ``amplitudes * u``, and the time derivatives of the sources are ``amplitudes *
        v``, where ``v = w * u``. The zeros are the eigenvalues of a generalised linear problem for
        ``[z, u, v]``. The problem consists of the circuit equations, the definition ``v = w * u``
        of the scalar v, and the condition that the output is zero. The method is described in
        Rosenbrock, State-Space and Multivariable Theory (1970).
        """
        n, k = self.system.size, len(self.system.sources)
        C0, C1 = self.combine_output_rows(of)
        substitution = np.zeros((n + 2 * k, n + 2), dtype=complex)
        substitution[:n, :n] = np.eye(n)
        substitution[n : n + k, n], substitution[n + k :, n + 1] = amplitudes, amplitudes
        now = np.vstack(
            [self.F @ substitution, np.eye(n + 2)[n + 1], -np.atleast_2d(C0) @ substitution]
        )
        rated = np.vstack(
            [self.G @ substitution, np.eye(n + 2)[n], np.atleast_2d(C1) @ substitution]
        )
        return _compute_finite_eigenvalues(now, rated)

    @cached_property
    def modes(self) -> Modes | None:
        """Eigenmodes of the circuit.

        The result is None if the eigenvectors do not form a basis, or if the sources or the initial
        state move an unsupported body.
        """
        n, k = self.system.size, len(self.system.sources)
        rows, cols = self.rows, self.system.differential
        motion = self._homogeneous_equations
        if motion is None:
            return None
        J, algebraic = self.F[:, :n], ~cols
        inverse, follow, cut = motion.inverse, motion.follow, motion.cut
        try:
            rates, shapes, reading, drifting = _decompose_motion(motion.rates)
        except np.linalg.LinAlgError:
            return None
        if rates is None:
            return None
        unknowns = np.zeros((n, rates.size), dtype=complex)
        unknowns[cols], unknowns[algebraic] = shapes, follow @ shapes
        out = self.C0[:, :n] @ unknowns + (self.C1[:, :n] @ unknowns) * rates
        terms = self._compute_term_sizes(slice(n), unknowns, rates)
        # the input matrix for sources e^(w t) is Bs + w (Bd - Gs) - w^2 Gd
        Gs, Gd = self.G[:, n : n + k], self.G[:, n + k :]
        Bs, Bd = self.F[:, n : n + k], self.F[:, n + k :]
        forms = [inverse @ (B[rows] - cut @ B[~rows]) for B in (Bs, Bd - Gs, -Gd)]
        drives = [reading @ form for form in forms]
        drive = sum(d * rates[:, None] ** j for j, d in enumerate(drives))
        s0 = self.system.evaluate_source_derivatives(0.0, 0.0)[:k]
        static_solution = np.linalg.lstsq(J, -Bs @ s0 - self.system.const, rcond=1e-14)[0]
        deviation = (self.z0 - static_solution)[cols]
        if drifting.size:
            free = drifting @ inverse @ ((Bs - Gs)[rows] - cut @ Bs[~rows])
            scale = np.linalg.norm(inverse @ (Bs - Gs)[rows]) + 1e-300
            moving = np.linalg.norm(drifting @ deviation) > _MAX_RIGID_EFFECT * (
                np.linalg.norm(self.z0) + 1e-300
            )
            if np.abs(free).max(initial=0.0) > _MAX_RIGID_EFFECT * scale or moving:
                return None
        level = self.C0[:, : n + k] @ np.concatenate([static_solution, s0]) + self.system.constant
        static_gains, slope_responses = self._compute_ramp_responses(motion, rates, shapes, drives)
        return Modes(
            rates,
            out,
            terms,
            np.asarray(drive),
            reading @ deviation,
            level,
            static_gains,
            slope_responses,
        )

    def _compute_ramp_responses(
        self, motion: _FreeMotion, rates: np.ndarray, shapes: np.ndarray, drives: list[np.ndarray]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute each output's responses to the value and to the slope of a linear ramp.

        If a source u is a linear ramp, an output is ``gain u + response du/dt``. The returned
        arrays ``gain`` and ``response`` have one row for each source and one column for each of the
        ny outputs.

        The amplitudes of the modes, ``a' = rates a + d0 u + d1 du/dt``, are ``-d0 u / rates - (d0 /
        rates^2 + d1 / rates) du/dt`` for a ramp. At the beginning of a steep ramp, the free
        response almost cancels the response to the ramp. Although the free response and the ramp
        response almost cancel, their sum is accurate, because both responses are sums over the same
        modes.
        """
        n, k = self.system.size, len(self.system.sources)
        rows, cols = self.rows, self.system.differential
        d0, d1, _ = drives
        per_rate = 1 / rates[:, None]
        amplitudes = -d0 * per_rate, -(d0 * per_rate + d1) * per_rate
        Bs, Bd = self.F[:, n : n + k], self.F[:, n + k :] - self.G[:, n : n + k]
        lines = []
        for a, B in zip(amplitudes, (Bs, Bd), strict=True):
            x, z = (shapes @ a).real, np.zeros((n, k))
            z[cols], z[~cols] = x, motion.follow @ x - motion.inner @ B[~rows]
            lines.append(z)
        slope, offset = lines
        static_gains = self.C0[:, :n] @ slope + self.C0[:, n : n + k]
        slope_responses = self.C0[:, :n] @ offset + self.C0[:, n + k :]
        slope_responses = slope_responses + self.C1[:, :n] @ slope + self.C1[:, n : n + k]
        return static_gains.T, slope_responses.T

    def compute_transient_solution(
        self, waves: tuple[Function, ...], stop: float
    ) -> ExponentialSolution | None:
        """Compute the exact transient solution of the linearised circuit up to ``stop``.

        ``stop`` is the end time [s]. ``waves`` contains the waveform of each source. The result is
        None if a waveform is neither piecewise linear nor a sine, or if :attr:`modes` is None.
        """
        modes = self.modes
        if modes is None:
            return None
        lines, sines = [], []
        for k, wave in enumerate(waves):
            if not isinstance(wave, Waveform) or wave.start < 0:
                return None
            if wave.is_piecewise_linear:
                lines += _find_kinks(k, wave, stop)
            elif wave.amplitude:
                sines.append((k, wave))
        return ExponentialSolution(self, modes, waves, tuple(sorted(lines)), tuple(sines), stop)


def solve_ac(system: System, frequencies: np.ndarray) -> dict[str, np.ndarray]:
    """Solve for the ac responses of all across and through quantities, keyed by name.

    The waves are complex arrays of shape (nf,). The amplitude of each source is the attribute
    ``ac`` of the source. The system is linearised about the operating point. The names are
    ``frequency`` [Hz] and, as in ``Result.waves``, ``NAME.pin`` and ``NAME.pin.through``.
    """
    amplitude = np.array([*map(attrgetter("ac"), system.sources)], dtype=complex)
    frequencies, point = np.asarray(frequencies, dtype=float), find_equilibrium(system)
    result = []
    for w in 2j * np.pi * frequencies:
        result.append(LinearisedSystem(system, w, point).respond(w, amplitude))
    waves = zip(system.names, np.array(result).T, strict=True)
    return {"frequency": frequencies} | {n: y for n, y in waves if not n.endswith(".rate")}


def _decompose_motion(F: np.ndarray) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray]:
    """Compute rates, mode shapes and left eigenvectors of ``x' = F x``.

    The results are arrays of shape (m,), (n, m) and (m, n). The fourth result, an array of shape
    (n - m, n), contains the left eigenvectors of the rigid-body modes. The rates are None if the
    mode shapes do not form a basis.
    """
    size = float(np.abs(np.linalg.eigvals(F)).max(initial=0.0))
    limit = _RIGID_RATE_RATIO * size
    T, Q, k = _sort_by_rate(F, limit)
    if k < len(F):
        T, Q, k = _sort_by_rate(F, min(limit, _estimate_rigid_rate(T[k:, k:], size)))
    X = sla.solve_sylvester(T[:k, :k], -T[k:, k:], -T[:k, k:]) if k < len(F) else T[:k, k:]
    rates, S = np.linalg.eig(T[:k, :k])
    if not k or np.linalg.cond(S) > _MAX_BASIS_CONDITION:
        return None, Q, Q, Q
    left = Q.conj().T
    reading = np.linalg.solve(S, left[:k] - X @ left[k:])
    return rates, Q[:, :k] @ S, reading, left[k:]


def _sort_by_rate(F: np.ndarray, limit: float) -> tuple[np.ndarray, np.ndarray, int]:
    """Sort the Schur form of F by rate: eigenvalues of size above ``limit`` first.

    The rates [1/s] are the eigenvalues of ``F``. Return the sorted Schur form, the Schur vectors,
    and the number of eigenvalues with magnitudes above ``limit``.
    """
    T, Q, k = sla.schur(F.astype(complex), "complex", sort=lambda rate: abs(rate) > limit)
    return T, Q, k


def _estimate_rigid_rate(T: np.ndarray, size: float) -> float:
    """Estimate the largest rate [1/s] that rounding errors give to rigid-body modes.

    ``T`` is the Schur form of the slow modes. The rounding error of ``F`` is ``e = eps * size``,
    where ``size`` is the largest magnitude of an eigenvalue of ``F``. The rounding error shifts a
    simple eigenvalue of zero by ``e``, and the two eigenvalues of a rigid-body mode ``x' = c v, v'
    = 0`` by ``sqrt(c e)``. Even slow relaxations of a circuit are faster than the returned rate.
    """
    e = float(np.finfo(float).eps) * size
    c = float(np.linalg.norm(np.triu(T, 1)))
    return _RIGID_RATE_ROUNDINGS * max(e, math.sqrt(c * e))


def _find_kinks(k: int, wave: Waveform, stop: float) -> list[tuple[float, int, float]]:
    """Find the times from t = 0 at which the slope of a source's waveform jumps.

    Each item of the result contains a time [s], the index ``k`` of the source, and the jump of the
    slope.
    """
    times, values = wave.list_points(stop)
    slopes = np.diff(values) / np.diff(times)
    jumps = np.diff(np.concatenate([[0.0], slopes, [0.0]]))
    before = times < 0
    result = [(float(t), k, float(j)) for t, j in zip(times, jumps, strict=True) if 0 <= t < stop]
    return [(0.0, k, float(jumps[before].sum())), *result] if before.any() else result


@dataclass(frozen=True, eq=False)
class _FreeMotion:
    """Homogeneous equations ``x' = rates x`` of the states ``x`` of a circuit.

    The algebraic unknowns are the matrix product ``follow @ x``. ``inverse`` is the inverse of the
    block of ``G`` for the states. ``cut`` maps right-hand sides of the algebraic equations to
    right-hand sides of the state equations. ``inner`` is the inverse of the block of ``F`` for the
    algebraic unknowns.
    """

    rates: np.ndarray
    inverse: np.ndarray
    follow: np.ndarray
    cut: np.ndarray
    inner: np.ndarray


@dataclass(frozen=True, eq=False)
class Modes:
    """Eigenmodes with amplitudes ``a_i``: ``a_i' = rates_i * a_i + drive_i * u``.

    The vector ``u`` contains the sources. The waves are ``y = level + sum_i out_i * a_i``.

    The products of ``out`` and ``drive`` are the residues at the poles ``rates`` [1/s]. Each entry
    of ``out`` is the sum of the contributions of all unknowns to one waveform in one mode. The
    corresponding entry of ``terms`` is the sum of the absolute values of the contributions of all
    unknowns. ``start`` contains the amplitudes at t = 0. ``level`` is the static solution for the
    values of the sources at t = 0. ``static_gains`` are the responses to constant sources.
    If a source has a constant slope, ``slope_responses`` times the slope is added to the response
    to the value of the source.

    The arrays ``rates`` and ``start`` have the shape (m,). ``level`` has the shape (ny,), and
    ``drive`` the shape (m, sources). ``out`` and ``terms`` have the shape (ny, m). ``static_gains``
    and ``slope_responses`` have the shape (sources, ny), where ny is the number of waveforms.
    """

    rates: np.ndarray
    out: np.ndarray
    terms: np.ndarray
    drive: np.ndarray
    start: np.ndarray
    level: np.ndarray
    static_gains: np.ndarray
    slope_responses: np.ndarray

    @property
    def q_factors(self) -> np.ndarray:
        """Q factors of all modes. Modes with a Q factor below 0.5 do not oscillate."""
        return np.abs(self.rates) / np.maximum(-2 * self.rates.real, 1e-30)


@dataclass(frozen=True, eq=False)
class ExponentialSolution:
    """Exact transient solution of a linear circuit.

    Between two successive :attr:`corner_times` of the sources, the solution is a sum of exponential
    functions, straight lines and sines.
    """

    linear: LinearisedSystem
    modes: Modes
    waves: tuple[Function, ...]
    kinks: tuple[tuple[float, int, float], ...]  # time [s], index of a source, jump of the slope
    sines: tuple[tuple[int, Waveform], ...]
    stop: float

    @property
    def corner_times(self) -> np.ndarray:
        """Times [s] at which sines start or slopes of sources jump."""
        starts = map(attrgetter("start"), map(itemgetter(1), self.sines))
        return np.unique([0.0, *map(itemgetter(0), self.kinks), *starts])

    @property
    def is_moving(self) -> bool:
        """Whether the solution changes with time."""
        return bool(self.kinks or self.sines or self.modes.start.any())

    def evaluate_waves(
        self,
        t: np.ndarray,
        outputs: np.ndarray,
        rates: RateMap | None = None,
        axis: RateMap | None = None,
    ) -> np.ndarray:
        """Compute the waveforms with indices ``outputs`` at the increasing times ``t``.

        Return an array of shape (nt, len(outputs)). By default, the waveforms are the exact
        solution of the linear circuit. With the functions ``rates`` and ``axis``, the waveforms are
        those that a numerical integration method would compute, including its errors. The function
        ``rates`` maps the exact pole of each mode to the pole of the mode in the numerical
        solution. The function ``axis`` maps the frequency ``j w`` of each sine to the complex
        frequency at which the response to the sine is evaluated.
        """
        poles = self.modes.rates
        moved = poles if rates is None else rates(poles)
        y = np.tile(self.modes.level[outputs], (t.size, 1)).astype(float)
        for k, wave in enumerate(self.waves):
            if wave.is_piecewise_linear:
                y += np.outer(wave(t) - wave(0.0), self.modes.static_gains[k][outputs])
                y += np.outer(wave.compute_derivative(t, t), self.modes.slope_responses[k][outputs])
        unit = np.eye(len(self.waves))
        for k, wave in self.sines:
            jw = np.array([2j * np.pi * wave.frequency])
            response = self.linear.respond((jw if axis is None else axis(jw))[0], unit[k])[outputs]
            started = t >= wave.start
            phasor = np.exp(jw[0] * (t - wave.start)) * started
            y += wave.amplitude * (phasor[:, None] * response).imag
        for first, last, amplitudes in self._list_intervals(moved):
            inside = (t >= first) & (t < last) if last < self.stop else t >= first
            if inside.any():
                growth = np.exp(np.outer(t[inside] - first, moved))
                y[inside] += (growth @ (self.modes.out[outputs] * amplitudes).T).real
        return y

    def _list_intervals(self, moved: np.ndarray) -> list[tuple[float, float, np.ndarray]]:
        """List the intervals between kinks of the source waveforms, with mode amplitudes.

        Each entry contains the start [s] and the end [s] of an interval, and the amplitudes (m,) of
        all modes at the start. ``moved`` (m,) [1/s] contains the poles of all modes in the exact or
        in a numerical solution. Within an interval, the amplitude of mode k with the pole
        ``moved[k]`` is proportional to ``exp(moved[k] * t)``.
        """
        poles, drive = self.modes.rates, self.modes.drive
        amplitude_jumps: dict[float, np.ndarray] = {0.0: self.modes.start.astype(complex)}
        for t, k, jump in self.kinks:
            amplitude_jumps[t] = amplitude_jumps.get(t, 0.0) + jump * drive[:, k] / poles**2
        for k, wave in self.sines:
            w = 2 * np.pi * wave.frequency
            jump_by_sine = wave.amplitude * w / (poles**2 + w**2) * drive[:, k]
            amplitude_jumps[wave.start] = amplitude_jumps.get(wave.start, 0.0) + jump_by_sine
        times = sorted(amplitude_jumps)
        result, amplitudes = [], np.zeros(poles.size, dtype=complex)
        for k, t in enumerate(times):
            amplitudes = amplitudes + amplitude_jumps[t]
            end = times[k + 1] if k + 1 < len(times) else self.stop
            result.append((t, end, amplitudes))
            amplitudes = amplitudes * np.exp(moved * (end - t))
        return result

    def find_peak_amplitudes(self) -> np.ndarray:
        """Return the largest amplitude (m, ny) of each of m modes in each of ny waveforms."""
        return np.asarray(self._largest_amplitudes[:, None] * np.abs(self.modes.out.T))

    def estimate_rounding(self) -> np.ndarray:
        """Estimate the rounding error of each waveform due to terms that cancel.

        For example, the forces on a joint without mass and the currents into a node add up to zero.
        A computed sum of terms that cancel each other is a rounding error, which a shorter time
        step does not reduce. The estimate is :data:`CANCELLATION_ROUNDING` times the sum of the
        magnitudes of all terms, which come from modes and from sinusoidal sources.
        """
        result = self.modes.terms @ self._largest_amplitudes
        unit = np.eye(len(self.waves))
        for k, wave in self.sines:
            w = 2j * np.pi * wave.frequency
            result = result + self.linear.sum_term_sizes(w, wave.amplitude * unit[k])
        return np.asarray(CANCELLATION_ROUNDING * result)

    @cached_property
    def _largest_amplitudes(self) -> np.ndarray:
        """Largest amplitudes (m,) that the modes have at the start of any interval."""
        amplitudes = np.array([*map(itemgetter(2), self._list_intervals(self.modes.rates))])
        return np.asarray(np.abs(amplitudes).max(axis=0))

    def choose_sample_times(self, count: int) -> np.ndarray:
        """Choose sample times [s] that resolve the motion after slope jumps of sources.

        Additional sample times follow each of the first eight and last eight :attr:`corner_times`.
        """
        spread = np.random.default_rng(0).uniform(0.0, self.stop, count)
        corners = self.corner_times
        outer = np.unique(np.concatenate([corners[:8], corners[-8:]]))
        delays = np.geomspace(0.1 / np.abs(self.modes.rates).max(), self.stop, 120)
        times_after_corners = (outer[:, None] + delays).ravel()
        return np.unique(
            np.concatenate([spread, times_after_corners[times_after_corners <= self.stop]])
        )


def solve_noise(
    laws: Iterable[L.Law], joins: Mapping[str, Iterable[str]], of: L.WaveCombination, f: np.ndarray
) -> np.ndarray:
    """Compute the spectral noise density of a result at the frequencies ``f`` [Hz].

    ``of`` is the result. The unit of the noise density is the unit of ``of`` per square root of Hz.
    ``joins`` maps the name of each net to pins, as in
    :func:`kc2spice.reference.system.assemble_system`.
    """
    noise_laws = (
        L.PortBody(law.name, law.model, law.ports) if isinstance(law, L.SecondOrderBody) else law
        for law in laws
    )
    system = assemble_system(noise_laws, joins)
    point = find_equilibrium(system)
    power = [
        _compute_noise_power(LinearisedSystem(system, s, point), of, s) for s in 2j * np.pi * f
    ]
    return np.sqrt(4 * BOLTZMANN * DEFAULT_TEMPERATURE * np.array(power))


def _compute_noise_power(at: LinearisedSystem, of: L.WaveCombination, s: complex) -> float:
    """Compute the squared noise density of a result, without the factor ``4 k T``.

    One solution of the adjoint circuit gives the transfer functions from all noise sources to the
    result.
    """
    system = at.system
    n, k = system.size, len(system.sources)
    C0, C1 = at.combine_output_rows(of)
    P = (s * at.G - at.F)[:, :n]
    level = np.abs(P).max(axis=1)
    adjoint = np.linalg.solve((P / level[:, None]).T, (C0 + s * C1)[:n]) / level
    power = 0.0
    modes = chain(at.device_modes, repeat((), len(system.linear)))
    for device, mode in zip((*system.devices, *system.linear), modes, strict=True):
        e = device.inputs @ np.concatenate([at.z0, np.zeros(2 * k)])
        result = device.law.compute_noise_weights(s, e, mode)
        if result is None:
            continue
        out, charge = result
        drive = device.into @ out
        if device.stores is not None:
            drive = drive - s * device.stores @ charge
        power += float((np.abs(adjoint @ drive) ** 2).sum())
    return power


def _compute_finite_eigenvalues(A: np.ndarray, B: np.ndarray) -> np.ndarray:
    """Return the finite eigenvalues ``w`` of ``A x = w B x``.

    Rows and columns may have different units, so they are scaled first.
    """
    for axis in (1, 0):
        size = np.maximum(np.abs(A), np.abs(B)).max(axis=axis, keepdims=True)
        size = np.where(size, size, 1.0)
        A, B = A / size, B / size
    w = sla.eigvals(A, B)
    return np.asarray(w[np.isfinite(w)])
