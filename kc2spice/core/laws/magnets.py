"""Forces of a table over position and coil currents."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from kc2spice.core.laws.device import Device, Flow, Tap
from kc2spice.core.laws.pin import Pin


@dataclass(frozen=True)
class ForceTable:
    """``F(y, i) = c0 + sum c_k i_k + sum_{k <= l} c_kl i_k i_l`` by not-a-knot cubic splines.

    ``y`` (n,) [m]; ``columns`` (n, 1 + m + m (m + 1) / 2): c0, c_1 ... c_m, c_11, c_12, ..., c_mm.
    """

    y: np.ndarray
    columns: np.ndarray
    coils: int

    @cached_property
    def _spline(self) -> np.ndarray:
        from scipy.interpolate import CubicSpline

        return CubicSpline(self.y, self.columns, bc_type="not-a-knot").c

    @cached_property
    def _potential(self) -> np.ndarray:
        """Integrals over y from the first node, as quartics (5, n - 1, columns)."""
        c, h = self._spline, np.diff(self.y)[:, None]
        quartic = np.concatenate((c / np.array([4.0, 3.0, 2.0, 1.0])[:, None, None], c[:1] * 0))
        step = (((quartic[0] * h + quartic[1]) * h + quartic[2]) * h + quartic[3]) * h
        quartic[4, 1:] = np.cumsum(step, axis=0)[:-1]
        return quartic

    def coefficients(self, y: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Integral over y, value and slope of all columns; the end cubics go on outside."""
        j = min(max(int(self.y.searchsorted(y, side="right")) - 1, 0), self.y.size - 2)
        s, p = y - self.y[j], self._potential[:, j]
        t = s * s
        powers = np.array((t * t, t * s, t, s, 1.0))
        c = self._spline[:, j]
        return powers @ p, powers[1:] @ c, np.array((3 * t, 2 * s, 1.0)) @ c[:3]

    def powers(self, i: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Monomials (columns,) of the currents and their derivatives (columns, coils)."""
        first, k, m = self._monomials
        slopes = np.zeros((self.columns.shape[1], self.coils))
        n = 1 + self.coils
        slopes[1:n] = first[0]
        slopes[n:] = first[1] * i[m][:, None] + first[2] * i[k][:, None]
        return np.concatenate(((1.0,), i, i[k] * i[m])), slopes

    @cached_property
    def _monomials(self) -> tuple[tuple[np.ndarray, ...], np.ndarray, np.ndarray]:
        k, m = np.triu_indices(self.coils)
        unit = np.eye(self.coils)
        return (unit, unit[k], unit[m]), k, m

    def check(self, y: float, where: str, t: float) -> None:
        """Raise SimulationError if ``y`` lies outside the nodes."""
        from kc2spice.core.errors import SimulationError

        if not self.y[0] <= y <= self.y[-1]:
            raise SimulationError(
                "the sphere left the force table",
                where=f"{where} at t = {t:.6e} s",
                got=f"y = {y:.4e} m",
                expected=f"{self.y[0]:.4e} to {self.y[-1]:.4e} m",
                hint="widen the table, or check the gains and the polarity",
            )


@dataclass(frozen=True)
class PositionForce(Device):
    """Force of a table on what is joined to ``y``, with ideal coil currents given as signals.

    ``y_table = u_y + offset``; current k is ``gains[k]`` times the signal on pin ``i1``, ``i2`` ...
    """

    name: str
    table: ForceTable
    gains: tuple[float, ...]
    offset: float = 0.0

    @property
    def _signals(self) -> tuple[str, ...]:
        return tuple(f"i{k + 1}" for k in range(self.table.coils))

    @property
    def pins(self) -> tuple[Pin, ...]:
        """``y``, then the currents."""
        return (Pin("y", "displacement"), *(Pin(n, "signal", grounded=True) for n in self._signals))

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Displacement, its rate, currents."""
        return (Tap("y"), Tap("y", rate=True), *(Tap(n) for n in self._signals))

    @property
    def flows(self) -> tuple[Flow, ...]:
        """The reaction on the coils."""
        return (Flow("y"),)

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Reaction and its slopes in y and the currents."""
        gains = np.asarray(self.gains)
        _, value, slope = self.table.coefficients(float(e[0]) + self.offset)
        powers, by_current = self.table.powers(gains * e[2:])
        derivative = np.concatenate(([slope @ powers, 0.0], (value @ by_current) * gains))
        return np.array([-(value @ powers)]), -derivative[None]

    def check(self, t: float, e: np.ndarray) -> None:
        """Raise SimulationError outside the table."""
        self.table.check(float(e[0]) + self.offset, self.name, t)

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """Minus the work on the moving part: magnets and current sources give it."""
        return float(self.evaluate(t, e, mode)[0][0] * e[1])

    @property
    def extra(self) -> tuple[str, ...]:
        """Scaled currents and the force."""
        return (*(f"coil{k + 1}" for k in range(self.table.coils)), "force")

    def waves(self, t: float, e: np.ndarray, mode: Any) -> dict[str, float]:
        """Coil currents and force."""
        currents = {
            f"coil{k + 1}": g * i for k, (g, i) in enumerate(zip(self.gains, e[2:], strict=True))
        }
        return currents | {"force": -float(self.evaluate(t, e, mode)[0][0])}


@dataclass(frozen=True)
class CoilForce(Device):
    """The same table with real coils: ``v_k = R_k i_k + d lambda_k / dt``, energy consistent.

    Coenergy ``W(y, i) = int F dy + i' L0 i / 2`` gives the force ``dW/dy`` and the flux linkages
    ``lambda_k = dW/di_k``; ``L0`` (m, m) [H] is the inductance at the table's first node.
    """

    name: str
    table: ForceTable
    resistance: np.ndarray
    inductance: np.ndarray
    offset: float = 0.0

    @property
    def pins(self) -> tuple[Pin, ...]:
        """``y``, then both ends of every coil."""
        ends = []
        for k in range(self.table.coils):
            ends.append(Pin(f"a{k + 1}", "electrical", grounded=True))
            ends.append(Pin(f"b{k + 1}", "electrical", grounded=True))
        return (Pin("y", "displacement"), *ends)

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Displacement and coil voltages."""
        return (Tap("y"), *(Tap(f"a{k + 1}", f"b{k + 1}") for k in range(self.table.coils)))

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Reaction force, coil currents."""
        coils = (Flow(f"a{k + 1}", f"b{k + 1}") for k in range(self.table.coils))
        return (Flow("y"), *coils)

    @property
    def states(self) -> tuple[str, ...]:
        """Coil currents."""
        return tuple(f"i{k + 1}" for k in range(self.table.coils))

    @property
    def scales(self) -> tuple[float, ...]:
        """Milliamperes."""
        return (1e-3,) * self.table.coils

    def _split(self, e: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        m = self.table.coils
        return float(e[0]) + self.offset, e[1 : 1 + m], e[1 + m :]

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Reaction, currents, and ``d lambda/dt = v - R i``."""
        m = self.table.coils
        y, volts, i = self._split(e)
        _, value, slope = self.table.coefficients(y)
        powers, by_current = self.table.powers(i)
        out = np.concatenate(([-(value @ powers)], i, volts - self.resistance * i))
        jac = np.zeros((1 + 2 * m, e.size))
        jac[0, 0], jac[0, 1 + m :] = -(slope @ powers), -(value @ by_current)
        jac[1 : 1 + m, 1 + m :] = np.eye(m)
        jac[1 + m :, 1 : 1 + m] = np.eye(m)
        jac[1 + m :, 1 + m :] = -np.diag(self.resistance)
        return out, jac

    def store(self, e: np.ndarray, mode: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """Flux linkages [Wb] with their slopes."""
        m = self.table.coils
        y, _, i = self._split(e)
        integral, value, _ = self.table.coefficients(y)
        _, by_current = self.table.powers(i)
        jac = np.zeros((m, e.size))
        jac[:, 0] = value @ by_current
        jac[:, 1 + m :] = self._incremental(integral)
        return integral @ by_current + self.inductance @ i, jac

    def _incremental(self, integral: np.ndarray) -> np.ndarray:
        m = self.table.coils
        k, n = np.triu_indices(m)
        half = np.zeros((m, m))
        half[k, n] = integral[1 + m :]
        return half + half.T + self.inductance

    def check(self, t: float, e: np.ndarray) -> None:
        """Raise SimulationError outside the table."""
        self.table.check(float(e[0]) + self.offset, self.name, t)

    def energy(self, e: np.ndarray, mode: Any) -> float:
        """``i' L i / 2 - int c0 dy``."""
        y, _, i = self._split(e)
        integral = self.table.coefficients(y)[0]
        return float(0.5 * i @ self._incremental(integral) @ i - integral[0])

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """``R i^2``."""
        return float(self.resistance @ self._split(e)[2] ** 2)
