"""Operating points, dc sweeps, and the equations that apply between two events."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from copy import copy
from dataclasses import dataclass, field, replace
from functools import partial
from operator import attrgetter
from typing import Any

import numpy as np

from kc2spice.core.constitutive_laws import AcrossInput, Device, LawPin
from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import make_constant_waveform
from kc2spice.reference.system import PlacedDevice, System


class Interval:
    """Time interval between two events, with the equations that hold during it.

    The equations are ``d/dt g(t, z) = f(t, z)``, and each device stays in its mode in ``modes``. In
    the whole interval, each source follows one smooth piece of its waveform: the piece that
    contains the time ``within``.
    """

    def __init__(self, system: System, modes: list[Any], within: float) -> None:
        self.system, self.modes, self.within = system, modes, within
        self.F, self.const = system.F, system.const
        self.curved = []
        for device, mode in zip(system.devices, modes, strict=True):
            if not device.law.is_affine:
                self.curved.append((device, mode))
                continue
            out, slope = device.law.evaluate(np.zeros(len(device.inputs)), mode)
            self.F = self.F + device.into @ slope @ device.inputs
            self.const = self.const + device.into @ out
        self.linear = not self.curved
        # mask of the equations that contain a time derivative
        self.rows = np.abs(system.G[:, : system.size]).max(axis=1) > 0.0
        for device in system.devices:
            if device.stores is not None:
                self.rows = self.rows | device.stores.any(axis=1)

    def append_sources(self, t: np.ndarray | float, z: np.ndarray) -> np.ndarray:
        """Append the sources at the time ``t`` to the unknowns ``z``.

        Return the vector ``X`` of unknowns, source values and source rates. ``X`` has the shape
        (N,) for one time, or (N, nt) for ``nt`` times.
        """
        return np.concatenate((z, self.system.evaluate_source_derivatives(t, self.within)))

    def compute_waveforms(
        self, t: np.ndarray, z: np.ndarray, r: np.ndarray
    ) -> dict[str, np.ndarray]:
        """Compute all waveforms at the times ``t``, keyed by name.

        ``z`` contains the unknowns, and ``r`` contains the rates of the unknowns. ``z`` and ``r``
        have the shape (n, nt). Each waveform has the shape (nt,).
        """
        system, X = self.system, self.append_sources(t, z)
        dX = np.concatenate((r, system.evaluate_source_derivatives(t, self.within, 1)))
        outputs = [np.zeros((0, t.size))]
        for device, mode in zip(system.devices, self.modes, strict=True):
            evaluate = partial(device.evaluate, mode=mode)
            points = map(evaluate, (device.inputs @ X).T, (device.inputs @ dX).T)
            outputs.append(np.array(list(points)).T)
        y = system.now @ X + system.rated @ dX + system.direct @ np.concatenate(outputs)
        return dict(zip(system.names, y + system.constant[:, None], strict=True))

    def compute_energy(self, t: float, z: np.ndarray) -> float:
        """Compute the stored energy [J] of all laws at the time ``t``."""
        X = self.append_sources(t, z)
        devices_with_inputs = zip(
            self.system.devices, self.compute_device_inputs(t, z), self.modes, strict=True
        )
        device_energy = sum(device.law.energy(e, mode) for device, e, mode in devices_with_inputs)
        return float(X @ self.system.stored @ X + self.system.lifted @ X + device_energy)

    def compute_stored_quantities(self, X: np.ndarray) -> np.ndarray:
        """Return the stored quantities ``g``, an array of shape (n, nt)."""
        g: np.ndarray = self.system.G @ X
        for device, mode in self.curved:
            if device.stores is not None:
                g += device.stores @ _evaluate(
                    device.law.evaluate_stored_quantities, device.inputs @ X, mode
                )
        return g

    def compute_right_sides(self, X: np.ndarray) -> np.ndarray:
        """Return the right-hand sides ``f`` of the equations, an array of shape (n, nt)."""
        f: np.ndarray = self.F @ X + self.const[:, None]
        for device, mode in self.curved:
            f += device.into @ _evaluate(device.law.evaluate_outputs, device.inputs @ X, mode)
        return f

    def sum_term_sizes(self, X: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sum the term sizes of each right-hand side ``f`` and each stored quantity ``g``.

        Both arrays of sums have the shape (n, nt). The rounding errors of ``f`` and ``g`` are
        proportional to these sums.
        """
        F, G, sizes = map(np.abs, (self.F, self.system.G, X))
        f, g = F @ sizes + np.abs(self.const)[:, None], G @ sizes
        for device, mode in self.curved:
            terms = np.abs(device.inputs) @ sizes
            points = list(zip((device.inputs @ X).T, terms.T, strict=True))
            f += np.abs(device.into) @ _sum_absolute_terms(device.law.evaluate, points, mode)
            if device.stores is not None:
                g += np.abs(device.stores) @ _sum_absolute_terms(
                    device.law.evaluate_storage, points, mode
                )
        return f, g

    def compute_jacobians(self, t: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the Jacobians of stored quantities g and right-hand sides f, each (n, n)."""
        n, X = self.system.size, self.append_sources(t, z)
        M, J = self.system.G[:, :n], self.F[:, :n]
        for device, mode in self.curved:
            e, by = device.inputs @ X, device.inputs[:, :n]
            J = J + device.into @ device.law.evaluate(e, mode)[1] @ by
            if device.stores is not None:
                M = M + device.stores @ device.law.evaluate_storage(e, mode)[1] @ by
        return M, J

    def evaluate_equations(self, t: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the stored quantities ``g`` and right-hand sides ``f``, of shape (n,)."""
        X = self.append_sources(t, z)[:, None]
        return self.compute_stored_quantities(X)[:, 0], self.compute_right_sides(X)[:, 0]

    def compute_device_inputs(self, t: float, z: np.ndarray) -> list[np.ndarray]:
        """Return the inputs of every device at the time ``t``, one array for each device."""
        X = self.append_sources(t, z)
        return [device.inputs @ X for device in self.system.devices]

    def compute_guards(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return all guard functions; each is positive until its device switches."""
        devices_with_inputs = zip(
            self.system.devices, self.compute_device_inputs(t, z), self.modes, strict=True
        )
        return np.concatenate(
            [np.empty(0), *(d.law.evaluate_guards(e, mode) for d, e, mode in devices_with_inputs)]
        )

    def solve_algebraic(self, t: float, z: np.ndarray) -> np.ndarray:
        """Return a copy of ``z`` whose algebraic unknowns solve the algebraic equations."""
        algebraic, rows = ~self.system.differential, ~self.rows
        z, tangents = z.copy(), LimitedTangents()
        for _ in range(30 if algebraic.any() else 0):
            now, limited = tangents.linearise_limited_laws(self, t, z)
            J = now.compute_jacobians(t, z)[1][np.ix_(rows, algebraic)]
            change = np.linalg.lstsq(J, -now.evaluate_equations(t, z)[1][rows], rcond=1e-14)[0]
            z[algebraic] += change
            small = np.abs(change).max() < 1e-12 * (1 + np.abs(z[algebraic]).max())
            if self.linear or (small and not limited):
                break
        return z


@dataclass(frozen=True, eq=False)
class _LinearisedLaw(Device):
    """Linearisation of a law about given inputs."""

    law: Device
    point: np.ndarray

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins of the linearised law."""
        return self.law.pins

    @property
    def across_inputs(self) -> tuple[AcrossInput, ...]:
        """Inputs of the device: across quantities, such as voltages, and their rates."""
        return self.law.across_inputs

    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return outputs of the linearised law, with derivatives for all inputs."""
        out, slope = self.law.evaluate(self.point, mode)
        return out + slope @ (e - self.point), slope

    def evaluate_storage(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return linearised stored quantities, with derivatives for all inputs."""
        stored, slope = self.law.evaluate_storage(self.point, mode)
        return stored + slope @ (e - self.point), slope


@dataclass(frozen=True, eq=False)
class LimitedTangents:
    """Tangents of device laws, at points that move only by limited Newton steps.

    Newton's method linearises most laws at the last iterate. A law that overrides
    :meth:`Device.limit_change`, such as a diode, is linearised at inputs between the previous
    linearisation and the last iterate. SPICE limits Newton steps in the same way. For each law with
    limited Newton steps, ``points`` contains the inputs at which the law was last linearised.
    """

    points: dict[PlacedDevice, np.ndarray] = field(default_factory=dict)

    def linearise_limited_laws(
        self, interval: Interval, t: float, z: np.ndarray
    ) -> tuple[Interval, bool]:
        """Linearise each law that limits its Newton steps at the point that it permits.

        Return the equations with the linearised laws. Also return whether a limited Newton step
        moved a point of linearisation away from ``z``.
        """
        X, curved, limited = interval.append_sources(t, z), [], False
        for device, mode in interval.curved:
            placed_device = device
            if type(device.law).limit_change is not Device.limit_change:
                e = device.inputs @ X
                point = device.law.limit_change(e, self.points.get(device, e))
                self.points[device] = point
                if np.any(point != e):
                    placed_device, limited = (
                        replace(device, law=_LinearisedLaw(device.law, point)),
                        True,
                    )
            curved.append((placed_device, mode))
        if limited:
            interval = copy(interval)
            interval.curved = curved
        return interval, limited


def _evaluate(
    function: Callable[[np.ndarray, Any], np.ndarray], inputs: np.ndarray, mode: Any
) -> np.ndarray:
    """Evaluate ``function`` for each column of ``inputs``; return an array (k, nt).

    ``inputs`` has the shape (m, nt).
    """
    return np.array([function(e, mode) for e in inputs.T]).T


def _sum_absolute_terms(
    function: Callable[[np.ndarray, Any], tuple[np.ndarray, ...]],
    points: Iterable[tuple[np.ndarray, np.ndarray]],
    mode: Any,
) -> np.ndarray:
    """Sum the magnitudes of all terms in each output of a linearised law.

    The sum for an output y is ``|y| + sum_i |dy/du_i| size_i``. The factor ``size_i`` is the sum of
    the absolute values of all terms of the input ``u_i``. The array of the sums has the shape (k,
    nt).
    """
    result = []
    for e, sizes in points:
        out, slope = function(e, mode)
        result.append(np.abs(out) + np.abs(slope) @ sizes)
    return np.array(result).T


def join_waves(parts: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """Concatenate the waveforms of consecutive intervals, keyed by waveform name."""
    columns = zip(*map(dict.values, parts), strict=True)
    return dict(zip(parts[0], map(np.concatenate, columns), strict=True))


_MAX_ITERATIONS = 400
_MAX_NEWTON_STEPS = 12  # largest number of Newton steps from the initial guess


def solve_operating_point(system: System) -> dict[str, float]:
    """Compute the equilibrium value of each waveform for the source values at t = 0.

    A net without a path to the reference node has zero charge.

    Raises
    ------
    SimulationError : a part has no support, or the search for an equilibrium does not converge.
    """
    return _compute_waveform_values(system, *find_equilibrium(system))


def solve_dc(system: System, source: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """Compute the equilibrium for each of the ``values`` of a source.

    Each solution starts from the solution at the previous value. Each array in the result contains
    one entry for each value of the swept source. The array ``sweep`` contains the values of the
    source. The other arrays contain the results of :func:`solve_operating_point`.
    """
    z, result = None, []
    for value in np.asarray(values, dtype=float):
        system_at_value = _fix_sources(system, {source: value})
        z, modes = find_equilibrium(system_at_value, z)
        result.append(_compute_waveform_values(system_at_value, z, modes))
    columns = zip(*map(dict.values, result), strict=True)
    swept = dict(zip(result[0], map(np.array, columns), strict=True))
    return {"sweep": np.asarray(values, dtype=float)} | swept


def _fix_sources(system: System, values: dict[str, float]) -> System:
    """Fix each source of a system at a constant value, and return the new system.

    ``values`` contains the values of sources by name. The value of any other source is its value at
    t = 0.
    """
    sources = []
    for source in system.sources:
        value = values.get(source.name, float(source.wave(0.0)))
        sources.append(replace(source, wave=make_constant_waveform(value)))
    return replace(system, sources=tuple(sources))


def _compute_waveform_values(system: System, z: np.ndarray, modes: list[Any]) -> dict[str, float]:
    """Compute the value of each output waveform in equilibrium ``z``, keyed by name."""
    interval, t = Interval(_fix_sources(system, {}), modes, 0.0), np.zeros(1)
    waves = interval.compute_waveforms(t, z[:, None], np.zeros((z.size, 1)))
    return {name: float(wave[0]) for name, wave in waves.items()}


class _StaticEquations:
    """Equations of the equilibrium: force and current balances, and initial values."""

    def __init__(self, system: System) -> None:
        self.system = _fix_sources(system, {})
        self.evaluate_source_derivatives = self.system.evaluate_source_derivatives(0.0, 0.0)
        n, values = system.size, system.initial_values
        self.H = np.array([h.row[:n] for h in values]).reshape(-1, n)
        self.h = np.array([h.value - h.row[n:] @ self.evaluate_source_derivatives for h in values])
        self.into = np.array([*map(attrgetter("into"), values)]).reshape(-1, n).T

    def make_interval(self, z: np.ndarray) -> Interval:
        """Make a time interval with the switching states that follow from unknowns ``z``.

        The switching state of a device, such as contact or no contact, is its mode.
        """
        X = np.concatenate((z, self.evaluate_source_derivatives))
        modes = [device.law.find_initial_mode(device.inputs @ X) for device in self.system.devices]
        return Interval(self.system, modes, 0.0)

    def compute_residual(self, interval: Interval, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Compute the residual of the force and current balances, and its Jacobian.

        The residual has the shape (n,), and the Jacobian has the shape (n, n). The forces that
        enforce the initial values are not included.
        """
        return interval.evaluate_equations(0.0, z)[1], interval.compute_jacobians(0.0, z)[1]


def find_equilibrium(
    system: System, guess: np.ndarray | None = None
) -> tuple[np.ndarray, list[Any]]:
    """Compute unknowns and switching states in equilibrium by Newton's method.

    Without an initial ``guess``, the first Newton steps are time steps of an overdamped motion,
    which approaches a stable equilibrium.
    """
    static_equations, n = _StaticEquations(system), system.size
    z = np.zeros(n) if guess is None else guess.copy()
    z[system.velocity] = 0.0
    if static_equations.h.size and guess is None:
        H, h = static_equations.H, static_equations.h
        z = z + np.linalg.lstsq(H, h - H @ z, rcond=None)[0]
    friction, forces, moved = np.zeros((n, n)), system.velocity, system.moved
    # without masses, the equation of a net's displacement is the force balance of the net
    if guess is not None and not moved.size:
        forces = moved = _find_displacement_unknowns(system)
    friction[forces, moved] = 1.0
    # A guess is usually close to the equilibrium, so Newton's method without friction is tried
    # first. If Newton's method fails, the steps follow an overdamped motion.
    pseudo_time_step, direct = (1e-6, 0) if guess is None else (1e13, _MAX_NEWTON_STEPS)
    start, tangents = z, LimitedTangents()
    for count in range(_MAX_ITERATIONS):
        if direct and count == direct:
            z, pseudo_time_step, tangents = start, 1e-6, LimitedTangents()
        interval, limited = tangents.linearise_limited_laws(
            static_equations.make_interval(z), 0.0, z
        )
        f, J = static_equations.compute_residual(interval, z)
        step = _compute_newton_step(
            static_equations,
            interval,
            z,
            f,
            J - friction / pseudo_time_step if pseudo_time_step < 1e13 else J,
        )
        small = np.abs(step).max(initial=0.0) <= 1e-11 * (1e-3 + np.abs(z).max(initial=0.0))
        if guess is not None and not small and count >= direct and f[forces] @ step[moved] < 0.0:
            # A Newton step that moves against the forces has passed a turning point.
            # The Newton step is repeated with 1 % of the previous pseudo time step.
            pseudo_time_step *= 0.01
            continue
        z = z + step
        if (
            pseudo_time_step >= 1e13
            and small
            and not limited
            and not np.any(interval.compute_guards(0.0, z) < -1e-18)
        ):
            return _set_initial_speeds(system, z), interval.modes
        pseudo_time_step = min(10.0 * pseudo_time_step, 1e13)
    raise SimulationError(
        "the search for an equilibrium does not converge",
        where="operating point",
        hint="support every part, or set the key `position` of a mass that starts in flight",
    )


def _find_displacement_unknowns(system: System) -> np.ndarray:
    """Find the indices of the unknowns that determine the displacements of nets."""
    names = np.array(system.names)
    moving = np.isin(np.char.add(names, ".rate"), names)
    return np.flatnonzero((system.now[moving, : system.size] != 0.0).any(axis=0))


def _compute_newton_step(
    rest: _StaticEquations, interval: Interval, z: np.ndarray, f: np.ndarray, J: np.ndarray
) -> np.ndarray:
    """Compute a Newton step of the equations for equilibrium and initial values.

    If these equations are singular, additional equations set the charges of floating nets to zero.
    """
    n, m = z.size, rest.h.size
    full = np.block([[J, rest.into], [rest.H, np.zeros((m, m))]])
    right = -np.concatenate((f, rest.H @ z - rest.h))
    size = np.maximum(np.abs(full).max(axis=1), 1e-300)
    full, right = full / size[:, None], right / size
    u, sing, _ = np.linalg.svd(full)
    rank = int((sing > 1e-15 * sing[0]).sum())
    if rank < n + m:
        null_vectors = u[:, rank:]
        conserved = (null_vectors[:n] / size[:n, None]).T
        inconsistent = np.abs(null_vectors.T @ right) > 1e-9 * np.abs(right).max(initial=1e-300)
        stored, slope = (
            interval.evaluate_equations(0.0, z)[0],
            interval.compute_jacobians(0.0, z)[0],
        )
        charge_rows = np.hstack((conserved @ slope, np.zeros((len(conserved), m))))
        charge_residual = -conserved @ stored
        level = np.maximum(np.abs(charge_rows).max(axis=1), 1e-300)
        if inconsistent.any() and np.abs(right).max() > 1e-12:
            raise SimulationError(
                "a part has no support, so it has no equilibrium",
                where="operating point",
                hint="add a support, or set the key `position` of a mass that starts in flight",
            )
        full = np.vstack((full, charge_rows / level[:, None]))
        right = np.concatenate((right, charge_residual / level))
    return np.linalg.lstsq(full, right, rcond=1e-15)[0][:n]


def _set_initial_speeds(system: System, z: np.ndarray) -> np.ndarray:
    """Return a copy of the unknowns ``z`` with the initial velocities of masses."""
    values = system.initial_values
    if not values:
        return z
    forms = np.array([*map(attrgetter("rate"), values)])[:, system.velocity]
    speeds = list(map(attrgetter("speed"), values))
    z = z.copy()
    z[system.velocity] = np.linalg.lstsq(forms, speeds, rcond=None)[0]
    return z
