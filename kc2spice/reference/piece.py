"""A system while its devices stay in their modes: what the integrator steps over."""

from __future__ import annotations

from typing import Any

import numpy as np

from kc2spice.reference.assemble import System


class Piece:
    """The system with its devices in fixed modes, sources smooth: a `radau.Problem`."""

    def __init__(self, system: System, modes: list[Any], within: float) -> None:
        self.system, self.modes, self.within = system, modes, within
        self.A, self.const = system.A, system.const
        self.Bs, self.Bd = system.Bs, system.Bd
        self.curved = []
        for device, mode in zip(system.devices, modes, strict=True):
            if not device.law.affine:
                self.curved.append((device, mode))
                continue
            out, slope = device.law.evaluate(0.0, np.zeros(device.inputs.z.shape[0]), mode)
            act = device.into @ slope
            self.A = self.A + act @ device.inputs.z
            self.Bs, self.Bd = self.Bs + act @ device.inputs.s, self.Bd + act @ device.inputs.d
            self.const = self.const + device.into @ out
        self.differential = system.differential
        self.rows = np.abs(system.M).max(axis=1, initial=0.0) > 0.0
        for device in system.devices:
            if device.stores is not None:
                self.rows = self.rows | device.stores.any(axis=1)
        self.linear = not self.curved
        self._asked: np.ndarray | None = None

    def _inputs(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Sources at ``t``; Newton's iterations ask for the same times again and again."""
        if t is not self._asked:
            self._given = self.system.inputs(t, self.within)
            s, d = self._given
            self._drive = self.Bs @ s + self.Bd @ d + self.const[:, None]
            self._kept = self.system.Gs @ s + self.system.Gd @ d
            self._asked = t
        return self._given

    def stored(self, t: np.ndarray, z: np.ndarray) -> np.ndarray:
        """``g`` (n, nt)."""
        s, d = self._inputs(t)
        g = self.system.M @ z + self._kept
        for device, mode in self.curved:
            if device.stores is not None:
                e = device.inputs.at(z, s, d)
                g += device.stores @ np.array([device.law.store(x, mode)[0] for x in e.T]).T
        return g

    def flow(self, t: np.ndarray, z: np.ndarray) -> np.ndarray:
        """``f`` (n, nt)."""
        s, d = self._inputs(t)
        f = self.A @ z + self._drive
        for device, mode in self.curved:
            e = device.inputs.at(z, s, d)
            out = [device.law.evaluate(tau, x, mode)[0] for tau, x in zip(t, e.T, strict=True)]
            f += device.into @ np.array(out).T
        return f

    def slopes(self, t: float, z: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``dg/dz`` and ``df/dz``."""
        M, J = self.system.M, self.A
        s, d = self.system.inputs(t, self.within)
        for device, mode in self.curved:
            e = device.inputs.at(z, s, d)
            J = J + device.into @ device.law.evaluate(t, e, mode)[1] @ device.inputs.z
            if device.stores is not None:
                M = M + device.stores @ device.law.store(e, mode)[1] @ device.inputs.z
        return M, J

    def inputs_of(self, t: float, z: np.ndarray) -> list[np.ndarray]:
        """Inputs ``e`` of every device."""
        s, d = self.system.inputs(t, self.within)
        return [device.inputs.at(z, s, d) for device in self.system.devices]

    def guards(self, t: float, z: np.ndarray) -> np.ndarray:
        """Guards of all devices in turn."""
        found = [
            device.law.guards(t, e, mode)
            for device, e, mode in zip(
                self.system.devices, self.inputs_of(t, z), self.modes, strict=True
            )
        ]
        return np.concatenate(found) if found else np.empty(0)

    def settle(self, t: float, z: np.ndarray) -> np.ndarray:
        """Make the algebraic unknowns agree with the others."""
        algebraic, rows = ~self.differential, ~self.rows
        z = z.copy()
        if not algebraic.any():
            return z
        for _ in range(30):
            f = self.flow(np.array([t]), z[:, None])[rows, 0]
            J = self.slopes(t, z)[1][np.ix_(rows, algebraic)]
            change = np.linalg.lstsq(J, -f, rcond=1e-14)[0]
            z[algebraic] += change
            if self.linear or np.abs(change).max() < 1e-12 * (1 + np.abs(z[algebraic]).max()):
                break
        return z
