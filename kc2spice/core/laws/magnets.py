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
    With ``j = [1, i]`` this is ``F = j' S'(y) j / 2``, the slope of the coenergy ``j' S(y) j / 2``.
    """

    y: np.ndarray
    columns: np.ndarray
    coils: int

    @cached_property
    def _quartics(self) -> np.ndarray:
        """Coefficients (5, n - 1, (1 + m)^2) of ``S`` between the nodes."""
        from scipy.interpolate import CubicSpline

        k, m = np.triu_indices(1 + self.coils)  # in the order of the columns
        half = np.zeros((self.y.size, 1 + self.coils, 1 + self.coils))
        half[:, k, m] = self.columns
        spline = CubicSpline(self.y, half + half.transpose(0, 2, 1), bc_type="not-a-knot")
        return np.asarray(spline.antiderivative().c.reshape(5, self.y.size - 1, -1))

    def forms(self, y: float) -> np.ndarray:
        """``S``, zero at the first node, ``S'`` and ``S''``; the end cubics go on outside."""
        k = min(max(int(self.y.searchsorted(y, side="right")) - 1, 0), self.y.size - 2)
        s = y - self.y[k]
        t = s * s
        powers = np.array(
            [
                [t * t, t * s, t, s, 1.0],
                [4 * t * s, 3 * t, 2 * s, 1.0, 0.0],
                [12 * t, 6 * s, 2, 0, 0],
            ]
        )
        return (powers @ self._quartics[:, k]).reshape(3, 1 + self.coils, 1 + self.coils)

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

    flows = (Flow("y"),)

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

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Reaction and its slopes in y and the currents."""
        j = np.append(1.0, np.asarray(self.gains) * e[2:])
        _, S1, S2 = self.table.forms(float(e[0]) + self.offset)
        slopes = np.append([0.5 * j @ S2 @ j, 0.0], (S1 @ j)[1:] * self.gains)
        return np.array([-0.5 * j @ S1 @ j]), -slopes[None]

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

    def _at(self, e: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """``j``, and the forms of the table with ``L0`` in the first."""
        S, S1, S2 = self.table.forms(float(e[0]) + self.offset)
        S[1:, 1:] += self.inductance
        return np.append(1.0, e[1 + self.table.coils :]), S, S1, S2

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Reaction, currents, and ``d lambda/dt = v - R i``."""
        m = self.table.coils
        j, _, S1, S2 = self._at(e)
        out = np.concatenate(([-0.5 * j @ S1 @ j], j[1:], e[1 : 1 + m] - self.resistance * j[1:]))
        jac = np.zeros((1 + 2 * m, e.size))
        jac[0, 0], jac[0, 1 + m :] = -0.5 * j @ S2 @ j, -(S1 @ j)[1:]
        jac[1 : 1 + m, 1 + m :] = jac[1 + m :, 1 : 1 + m] = np.eye(m)
        jac[1 + m :, 1 + m :] = -np.diag(self.resistance)
        return out, jac

    def store(self, e: np.ndarray, mode: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """Flux linkages [Wb] with their slopes."""
        j, S, S1, _ = self._at(e)
        slopes = np.column_stack(((S1 @ j)[1:], np.zeros((j.size - 1, j.size - 1)), S[1:, 1:]))
        return (S @ j)[1:], slopes

    def check(self, t: float, e: np.ndarray) -> None:
        """Raise SimulationError outside the table."""
        self.table.check(float(e[0]) + self.offset, self.name, t)

    def energy(self, e: np.ndarray, mode: Any) -> float:
        """``i' L i / 2 - int c0 dy``."""
        j, S, _, _ = self._at(e)
        return float(0.5 * (j[1:] @ S[1:, 1:] @ j[1:] - S[0, 0]))

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        """``R i^2``."""
        return float(self.resistance @ e[1 + self.table.coils :] ** 2)
