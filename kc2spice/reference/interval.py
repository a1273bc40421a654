"""A system on an interval without events: residuals, their exact slopes, and guards."""

from __future__ import annotations

from typing import Any

import numpy as np

from kc2spice.reference.assemble import System


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
            out, slope = device.law.evaluate(0.0, np.zeros(len(device.inputs)), mode)
            self.F = self.F + device.into @ slope @ device.inputs
            self.const = self.const + device.into @ out
        self.linear = not self.curved
        self.rows = np.abs(system.G[:, : system.size]).max(axis=1) > 0.0  # those with a rate
        for device in system.devices:
            if device.stores is not None:
                self.rows = self.rows | device.stores.any(axis=1)

    def seen(self, t: np.ndarray | float, z: np.ndarray) -> np.ndarray:
        """``X`` (N,) at one time, (N, nt) at many."""
        return np.concatenate((z, self.system.given(t, self.within)))

    def rates(self, t: np.ndarray, r: np.ndarray) -> np.ndarray:
        """Of ``X`` (N, nt) at times ``t`` (nt,) with these rates of the unknowns (n, nt)."""
        return np.concatenate((r, self.system.given(t, self.within, 1)))

    def waves(self, t: np.ndarray, z: np.ndarray, r: np.ndarray) -> dict[str, np.ndarray]:
        """All waves (nt,) at times ``t`` (nt,) by states and their rates (n, nt)."""
        system, X, dX = self.system, self.seen(t, z), self.rates(t, r)
        outputs = [np.zeros((0, t.size))]
        for device, mode in zip(system.devices, self.modes, strict=True):
            seen, rates = (device.inputs @ X).T, (device.inputs @ dX).T
            points = zip(t.tolist(), seen, rates, strict=True)
            outputs.append(np.array([device.out(*point, mode) for point in points]).T)
        y = system.now @ X + system.rated @ dX + system.direct @ np.concatenate(outputs)
        return dict(zip(system.names, y + system.constant[:, None], strict=True))

    def energy(self, t: float, z: np.ndarray) -> float:
        """Energy stored [J]."""
        X = self.seen(t, z)
        each = zip(self.system.devices, self.inputs(t, z), self.modes, strict=True)
        devices = sum(device.law.energy(e, mode) for device, e, mode in each)
        return float(X @ self.system.stored @ X + self.system.lifted @ X + devices)

    def stored(self, X: np.ndarray) -> np.ndarray:
        """``g`` (n, nt)."""
        g: np.ndarray = self.system.G @ X
        for device, mode in self.curved:
            if device.stores is not None:
                kept = [device.law.store(e, mode)[0] for e in (device.inputs @ X).T]
                g += device.stores @ np.array(kept).T
        return g

    def flow(self, t: np.ndarray, X: np.ndarray) -> np.ndarray:
        """``f`` (n, nt)."""
        f: np.ndarray = self.F @ X + self.const[:, None]
        for device, mode in self.curved:
            points = zip(t.tolist(), (device.inputs @ X).T, strict=True)
            f += device.into @ np.array([device.law.evaluate(*at, mode)[0] for at in points]).T
        return f

    def slopes(self, t: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``dg/dz`` and ``df/dz`` (n, n)."""
        n, X = self.system.size, self.seen(t, z)
        M, J = self.system.G[:, :n], self.F[:, :n]
        for device, mode in self.curved:
            e, by = device.inputs @ X, device.inputs[:, :n]
            J = J + device.into @ device.law.evaluate(t, e, mode)[1] @ by
            if device.stores is not None:
                M = M + device.stores @ device.law.store(e, mode)[1] @ by
        return M, J

    def at(self, t: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``g`` and ``f`` (n,) at one time."""
        X = self.seen(t, z)[:, None]
        return self.stored(X)[:, 0], self.flow(np.array([t]), X)[:, 0]

    def inputs(self, t: float, z: np.ndarray) -> list[np.ndarray]:
        """What every device sees."""
        X = self.seen(t, z)
        return [device.inputs @ X for device in self.system.devices]

    def guards(self, t: float, z: np.ndarray) -> np.ndarray:
        """Guards of all devices in turn."""
        each = zip(self.system.devices, self.inputs(t, z), self.modes, strict=True)
        return np.concatenate([np.empty(0), *(d.law.guards(t, e, mode) for d, e, mode in each)])

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
