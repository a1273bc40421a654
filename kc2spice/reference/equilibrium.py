"""A system on an interval without events: residuals, their exact slopes, and guards; its operating
point and dc sweep.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import constant
from kc2spice.reference.system import System


class Interval:
    """``d/dt g(t, z) = f(t, z)`` with the devices in fixed ``modes``, and with the smooth pieces of
    sources that hold the time ``within``."""

    def __init__(self, system: System, modes: list[Any], within: float) -> None:
        self.system, self.modes, self.within = system, modes, within
        self.F, self.const = system.F, system.const
        self.curved = []
        for device, mode in zip(system.devices, modes, strict=True):
            if not device.law.affine:
                self.curved.append((device, mode))
                continue
            out, slope = device.law.evaluate(np.zeros(len(device.inputs)), mode)
            self.F = self.F + device.into @ slope @ device.inputs
            self.const = self.const + device.into @ out
        self.linear = not self.curved
        self.rows = np.abs(system.G[:, : system.size]).max(axis=1) > 0.0  # equations with a rate
        for device in system.devices:
            if device.stores is not None:
                self.rows = self.rows | device.stores.any(axis=1)

    def with_sources(self, t: np.ndarray | float, z: np.ndarray) -> np.ndarray:
        """``X`` (N,) at one time, (N, nt) at many."""
        return np.concatenate((z, self.system.source_values(t, self.within)))

    def waves(self, t: np.ndarray, z: np.ndarray, r: np.ndarray) -> dict[str, np.ndarray]:
        """All waves (nt,) at times ``t`` (nt,) by states and their rates (n, nt)."""
        system, X = self.system, self.with_sources(t, z)
        dX = np.concatenate((r, system.source_values(t, self.within, 1)))
        outputs = [np.zeros((0, t.size))]
        for device, mode in zip(system.devices, self.modes, strict=True):
            points = zip((device.inputs @ X).T, (device.inputs @ dX).T, strict=True)
            outputs.append(np.array([device.out(*point, mode) for point in points]).T)
        y = system.now @ X + system.rated @ dX + system.direct @ np.concatenate(outputs)
        return dict(zip(system.names, y + system.constant[:, None], strict=True))

    def energy(self, t: float, z: np.ndarray) -> float:
        """Energy stored [J]."""
        X = self.with_sources(t, z)
        item = zip(self.system.devices, self.inputs(t, z), self.modes, strict=True)
        devices = sum(device.law.energy(e, mode) for device, e, mode in item)
        return float(X @ self.system.stored @ X + self.system.lifted @ X + devices)

    def stored(self, X: np.ndarray) -> np.ndarray:
        """``g`` (n, nt)."""
        g: np.ndarray = self.system.G @ X
        for device, mode in self.curved:
            if device.stores is not None:
                stores = [device.law.store(e, mode)[0] for e in (device.inputs @ X).T]
                g += device.stores @ np.array(stores).T
        return g

    def flow(self, X: np.ndarray) -> np.ndarray:
        """``f`` (n, nt)."""
        f: np.ndarray = self.F @ X + self.const[:, None]
        for device, mode in self.curved:
            out = [device.law.evaluate(e, mode)[0] for e in (device.inputs @ X).T]
            f += device.into @ np.array(out).T
        return f

    def slopes(self, t: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``dg/dz`` and ``df/dz`` (n, n)."""
        n, X = self.system.size, self.with_sources(t, z)
        M, J = self.system.G[:, :n], self.F[:, :n]
        for device, mode in self.curved:
            e, by = device.inputs @ X, device.inputs[:, :n]
            J = J + device.into @ device.law.evaluate(e, mode)[1] @ by
            if device.stores is not None:
                M = M + device.stores @ device.law.store(e, mode)[1] @ by
        return M, J

    def at(self, t: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``g`` and ``f`` (n,) at one time."""
        X = self.with_sources(t, z)[:, None]
        return self.stored(X)[:, 0], self.flow(X)[:, 0]

    def inputs(self, t: float, z: np.ndarray) -> list[np.ndarray]:
        """Inputs of every device."""
        X = self.with_sources(t, z)
        return [device.inputs @ X for device in self.system.devices]

    def guards(self, t: float, z: np.ndarray) -> np.ndarray:
        """Guards of all devices in turn."""
        item = zip(self.system.devices, self.inputs(t, z), self.modes, strict=True)
        return np.concatenate([np.empty(0), *(d.law.guards(e, mode) for d, e, mode in item)])

    def settled(self, t: float, z: np.ndarray) -> np.ndarray:
        """``z`` with algebraic unknowns that agree with the others."""
        algebraic, rows = ~self.system.differential, ~self.rows
        z = z.copy()
        for _ in range(30 if algebraic.any() else 0):
            J = self.slopes(t, z)[1][np.ix_(rows, algebraic)]
            change = np.linalg.lstsq(J, -self.at(t, z)[1][rows], rcond=1e-14)[0]
            z[algebraic] += change
            if self.linear or np.abs(change).max() < 1e-12 * (1 + np.abs(z[algebraic]).max()):
                break
        return z


_ITERATIONS = 400
_DIRECT = 12  # Newton steps from a guess


def solve_operating_point(system: System) -> dict[str, float]:
    """Every wave at the equilibrium with the sources as they are at t = 0.

    Charges of floating nets are zero. Raises SimulationError where nothing holds a part, or where
    no equilibrium was reached.
    """
    return _values(system, *equilibrium(system))


def solve_dc(system: System, source: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """Equilibria while ``source`` takes ``values``, each started from the one before.

    Returns arrays over the sweep: ``sweep`` and every name of `solve_operating_point`.
    """
    z, result = None, []
    for value in np.asarray(values, dtype=float):
        now = _with_waves(system, {source: value})
        z, modes = equilibrium(now, z)
        result.append(_values(now, z, modes))
    swept = {key: np.array([point[key] for point in result]) for key in result[0]}
    return {"sweep": np.asarray(values, dtype=float)} | swept


def _with_waves(system: System, values: dict[str, float]) -> System:
    """All sources constant, at ``values`` or what they are at t = 0."""
    waves = [(p, values.get(p.name, float(p.wave(0.0)))) for p in system.sources]
    sources = (replace(p, wave=constant(value)) for p, value in waves)
    return replace(system, sources=tuple(sources))


def _values(system: System, z: np.ndarray, modes: list[Any]) -> dict[str, float]:
    rest, t = Interval(_with_waves(system, {}), modes, 0.0), np.zeros(1)
    waves = rest.waves(t, z[:, None], np.zeros((z.size, 1)))
    return {name: float(wave[0]) for name, wave in waves.items()}


class _Rest:
    """Equations of rest: balance, start values that are held, charges that nothing can change."""

    def __init__(self, system: System) -> None:
        self.system = _with_waves(system, {})
        self.source_values = self.system.source_values(0.0, 0.0)
        n, values = system.size, system.initial_values
        self.H = np.array([h.row[:n] for h in values]).reshape(-1, n)
        self.h = np.array([h.value - h.row[n:] @ self.source_values for h in values])
        self.into = np.array([h.into for h in values]).reshape(-1, n).T

    def interval(self, z: np.ndarray) -> Interval:
        """The system in the modes that its devices have at ``z``."""
        X = np.concatenate((z, self.source_values))
        modes = [device.law.mode(device.inputs @ X) for device in self.system.devices]
        return Interval(self.system, modes, 0.0)

    def equations(self, interval: Interval, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Residual (n,) and slopes (n, n) without what is held."""
        return interval.at(0.0, z)[1], interval.slopes(0.0, z)[1]


def equilibrium(system: System, guess: np.ndarray | None = None) -> tuple[np.ndarray, list[Any]]:
    """Unknowns and modes at rest, by Newton's method after a motion through thick friction."""
    rest, n = _Rest(system), system.size
    z = np.zeros(n) if guess is None else guess.copy()
    z[system.velocity] = 0.0
    if rest.h.size and guess is None:
        z = z + np.linalg.lstsq(rest.H, rest.h - rest.H @ z, rcond=None)[0]
    friction, forces, places = np.zeros((n, n)), system.velocity, system.moved
    if guess is not None and not places.size:  # nothing has a mass: a net's row balances its forces
        forces = places = _nets(system)
    friction[forces, places] = 1.0
    # A guess is mostly near: Newton's method alone first, the slow motion where that fails.
    pace, direct = (1e-6, 0) if guess is None else (1e13, _DIRECT)
    start = z
    for count in range(_ITERATIONS):
        if direct and count == direct:
            z, pace = start, 1e-6
        interval = rest.interval(z)
        f, J = rest.equations(interval, z)
        step = _solve(rest, interval, z, f, J - friction / pace if pace < 1e13 else J)
        small = np.abs(step).max(initial=0.0) <= 1e-11 * (1e-3 + np.abs(z).max(initial=0.0))
        if guess is not None and not small and count >= direct and f[forces] @ step[places] < 0.0:
            pace *= 0.01  # past a fold a long step leads back, against its forces
            continue
        z = z + step
        if pace >= 1e13 and small and not np.any(interval.guards(0.0, z) < -1e-18):
            return _moving(system, z), interval.modes
        pace = min(10.0 * pace, 1e13)
    raise SimulationError(
        "no equilibrium was reached",
        where="operating point",
        hint="support every part, or give a mass a position to start it in flight",
    )


def _nets(system: System) -> np.ndarray:
    """Unknowns that are displacements of nets."""
    names = {name: k for k, name in enumerate(system.names)}
    moving = [k for name, k in names.items() if f"{name}.rate" in names]
    return np.flatnonzero((system.now[moving, : system.size] != 0.0).any(axis=0))


def _solve(
    rest: _Rest, interval: Interval, z: np.ndarray, f: np.ndarray, J: np.ndarray
) -> np.ndarray:
    """Newton step with the held values and, where it is singular, the kept charges."""
    n, m = z.size, rest.h.size
    full = np.block([[J, rest.into], [rest.H, np.zeros((m, m))]])
    right = -np.concatenate((f, rest.H @ z - rest.h))
    size = np.maximum(np.abs(full).max(axis=1), 1e-300)
    full, right = full / size[:, None], right / size
    u, sing, _ = np.linalg.svd(full)
    rank = int((sing > 1e-15 * sing[0]).sum())
    if rank < n + m:
        idle = u[:, rank:]
        conserved = (idle[:n] / size[:n, None]).T
        short = np.abs(idle.T @ right) > 1e-9 * np.abs(right).max(initial=1e-300)
        stored, slope = interval.at(0.0, z)[0], interval.slopes(0.0, z)[0]
        add = np.hstack((conserved @ slope, np.zeros((len(conserved), m))))
        drop = -conserved @ stored
        level = np.maximum(np.abs(add).max(axis=1), 1e-300)
        if short.any() and np.abs(right).max() > 1e-12:
            raise SimulationError(
                "a part has no support: there is no equilibrium",
                where="operating point",
                hint="give a mass a position to start it in flight, or a support",
            )
        full = np.vstack((full, add / level[:, None]))
        right = np.concatenate((right, drop / level))
    return np.linalg.lstsq(full, right, rcond=1e-15)[0][:n]


def _moving(system: System, z: np.ndarray) -> np.ndarray:
    """Give held masses their velocities."""
    if not system.initial_values:
        return z
    forms = np.array([h.rate[: system.size] for h in system.initial_values])[:, system.velocity]
    z = z.copy()
    z[system.velocity] = np.linalg.lstsq(
        forms, [h.speed for h in system.initial_values], rcond=None
    )[0]
    return z
