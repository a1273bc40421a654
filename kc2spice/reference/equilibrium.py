"""Operating point and dc sweep of a `System`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.reference.assemble import System

_ITERATIONS = 400
_DIRECT = 12  # Newton steps from a guess


@dataclass(frozen=True)
class Point:
    """A state of rest: unknowns, modes of the devices, and everything by name in ``values``."""

    z: np.ndarray
    modes: tuple[Any, ...]
    values: dict[str, float]


def operating_point(system: System) -> Point:
    """Equilibrium with the sources as they are at t = 0; charges of floating nets are zero.

    Raises SimulationError where nothing holds a part, or where no equilibrium was reached.
    """
    z, modes = equilibrium(system)
    return Point(z, tuple(modes), _values(system, z, modes))


def dc(system: System, source: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """Equilibria while ``source`` takes ``values``, each started from the one before.

    Returns arrays over the sweep: ``sweep`` and every name of `operating_point`.
    """
    names = [p.name for p in system.sources]
    if source not in names:
        raise UsageError("no such source to sweep", got=source, expected=", ".join(names))
    z, found = None, []
    for value in np.asarray(values, dtype=float):
        z, modes = equilibrium(system, z, {names.index(source): value})
        found.append(_values(system, z, modes, {names.index(source): value}))
    swept = {key: np.array([point[key] for point in found]) for key in found[0]}
    return {"sweep": np.asarray(values, dtype=float)} | swept


def _values(
    system: System, z: np.ndarray, modes: list[Any], fixed: dict[int, float] | None = None
) -> dict[str, float]:
    s, d = _sources(system, fixed)
    found = {name: float(rows.at(z, s, d)[0]) for name, rows in system.across.items()}
    for name, (direct, _) in system.through.items():
        found[f"{name}.through"] = float(direct.at(z, s, d)[0])
    for device, mode in zip(system.devices, modes, strict=True):
        e, name = device.inputs.at(z, s, d), device.law.name
        out = device.law.evaluate(0.0, e, mode)[0]
        for k, flow in enumerate(device.law.flows):
            found[f"{name}.{flow.pin}.through"] = float(out[k])
        for k, state in enumerate(device.law.states):
            found[f"{name}.{state}"] = float(e[len(device.law.taps) + k])
        found |= {f"{name}.{key}": v for key, v in device.law.waves(0.0, e, mode).items()}
    return found


def _sources(system: System, fixed: dict[int, float] | None) -> tuple[np.ndarray, np.ndarray]:
    s, _ = system.inputs(0.0, 0.0)
    for k, value in (fixed or {}).items():
        s[k] = value
    return s, np.zeros(s.size)


class _Rest:
    """Equations of rest: balance, start values that are held, charges that nothing can change."""

    def __init__(self, system: System, fixed: dict[int, float] | None) -> None:
        self.system = system
        self.s, self.d = _sources(system, fixed)
        held = system.held
        self.H = np.array([h.rows.z[0] for h in held]).reshape(-1, system.A.shape[0])
        self.h = np.array([h.value - float(h.rows.s[0] @ self.s) for h in held])
        self.into = np.array([h.into for h in held]).reshape(-1, system.A.shape[0]).T

    def modes(self, z: np.ndarray) -> list[Any]:
        """Modes of the devices at ``z``."""
        return [
            device.law.mode(0.0, device.inputs.at(z, self.s, self.d))
            for device in self.system.devices
        ]

    def equations(self, z: np.ndarray, modes: list[Any]) -> tuple[np.ndarray, np.ndarray]:
        """Residual (n,) and slopes (n, n) without what is held."""
        system = self.system
        f = system.A @ z + system.Bs @ self.s + system.const
        J = system.A.copy()
        for device, mode in zip(system.devices, modes, strict=True):
            e = device.inputs.at(z, self.s, self.d)
            out, slope = device.law.evaluate(0.0, e, mode)
            f = f + device.into @ out
            J += device.into @ slope @ device.inputs.z
            start = device.law.initial(e[: len(device.law.taps)])
            if start is not None:
                rows = np.abs(system.M[:, device.states]).argmax(axis=0)
                sizes = device.inputs.z[len(device.law.taps) :, device.states].diagonal()
                J[rows] = 0.0
                J[rows, device.states] = 1.0
                f[rows] = z[device.states] - start / sizes
        return f, J

    def stored(self, z: np.ndarray, modes: list[Any]) -> tuple[np.ndarray, np.ndarray]:
        """Charges, fluxes and momenta (n,), and their slopes (n, n)."""
        g, slope = self.system.M @ z + self.system.Gs @ self.s, self.system.M
        for device, mode in zip(self.system.devices, modes, strict=True):
            if device.stores is not None:
                kept, by = device.law.store(device.inputs.at(z, self.s, self.d), mode)
                g = g + device.stores @ kept
                slope = slope + device.stores @ by @ device.inputs.z
        return g, slope


def equilibrium(
    system: System, guess: np.ndarray | None = None, fixed: dict[int, float] | None = None
) -> tuple[np.ndarray, list[Any]]:
    """Unknowns and modes at rest, by Newton's method after a motion through thick friction."""
    rest, n = _Rest(system, fixed), system.A.shape[0]
    z = np.zeros(n) if guess is None else guess.copy()
    z[system.velocity] = 0.0
    if rest.h.size and guess is None:
        z = z + np.linalg.lstsq(rest.H, rest.h - rest.H @ z, rcond=None)[0]
    moving = np.flatnonzero(system.velocity)
    friction = np.zeros((n, n))
    for v in moving:  # the row of p' = speed v tells whose velocity it is
        p = int(np.flatnonzero((system.A[:, v] != 0.0) & _kinematic(system))[0])
        friction[v, p] = 1.0
    # A guess is mostly near: Newton's method alone first, the slow motion where that fails.
    pace, direct = (1e-6, 0) if guess is None else (1e13, _DIRECT)
    start = z
    for count in range(_ITERATIONS):
        if direct and count == direct:
            z, pace = start, 1e-6
        modes = rest.modes(z)
        f, J = rest.equations(z, modes)
        step = _solve(rest, z, modes, f, J - friction / pace if pace < 1e13 else J)
        z = z + step
        small = np.abs(step).max(initial=0.0) <= 1e-11 * (1e-3 + np.abs(z).max(initial=0.0))
        settled = pace >= 1e13 and small
        if settled and (rest.modes(z) == modes or not _changed(rest, z, modes)):
            return _moving(system, z, rest), modes
        pace = min(10.0 * pace, 1e13)
    raise SimulationError(
        "no equilibrium was reached",
        where="operating point",
        hint="does something hold every part? give a mass a position to start it in flight",
    )


def _changed(rest: _Rest, z: np.ndarray, modes: list[Any]) -> bool:
    """Whether a guard is negative beyond rounding."""
    for device, mode in zip(rest.system.devices, modes, strict=True):
        e = device.inputs.at(z, rest.s, rest.d)
        if np.any(device.law.guards(0.0, e, mode) < -1e-18):
            return True
    return False


def _kinematic(system: System) -> np.ndarray:
    """Rows ``p' = speed v``: a rate of a displacement, moved by nothing but one velocity."""
    return (
        ((np.abs(system.M) > 0).sum(axis=1) == 1)
        & ((np.abs(system.A) > 0).sum(axis=1) == 1)
        & (system.A[:, system.velocity] != 0).any(axis=1)
        & ~system.M[:, system.velocity].any(axis=1)
    )


def _solve(
    rest: _Rest, z: np.ndarray, modes: list[Any], f: np.ndarray, J: np.ndarray
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
        kept = (idle[:n] / size[:n, None]).T
        short = np.abs(idle.T @ right) > 1e-9 * np.abs(right).max(initial=1e-300)
        stored, slope = rest.stored(z, modes)
        add = np.hstack((kept @ slope, np.zeros((len(kept), m))))
        drop = -kept @ stored
        level = np.maximum(np.abs(add).max(axis=1), 1e-300)
        if short.any() and np.abs(right).max() > 1e-12:
            raise SimulationError(
                "nothing holds a part: there is no equilibrium",
                where="operating point",
                hint="give a mass a position to start it in flight, or a support",
            )
        full = np.vstack((full, add / level[:, None]))
        right = np.concatenate((right, drop / level))
    return np.linalg.lstsq(full, right, rcond=1e-15)[0][:n]


def _moving(system: System, z: np.ndarray, rest: _Rest) -> np.ndarray:
    """Give held masses their velocities."""
    asked = [(h.rate, h.speed) for h in system.held if h.rate is not None]
    if not asked:
        return z
    forms = np.array([rate.z[0] for rate, _ in asked])[:, system.velocity]
    speeds = np.array([speed for _, speed in asked])
    z = z.copy()
    z[system.velocity] = np.linalg.lstsq(forms, speeds, rcond=None)[0]
    return z
