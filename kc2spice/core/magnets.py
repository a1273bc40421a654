"""Two coils and a magnet that moves: one coenergy of height and currents."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws import Device, Flow, Pin, Tap
from kc2spice.core.piecewise import Piecewise


def products(i1: Any, i2: Any) -> np.ndarray:
    """``1, i1, i2, i1^2, i1 i2, i2^2`` (..., 6) of the currents."""
    i1, i2 = np.broadcast_arrays(np.asarray(i1, dtype=float), i2)
    return np.stack([np.ones_like(i1), i1, i2, i1**2, i1 * i2, i2**2], axis=-1)


@dataclass(frozen=True)
class Coenergy:
    """``W(y, i) = p(y) . products(i)`` [J] at the height ``y`` [m]: its slopes by the height and by
    the currents are the force [N] and the flux linkages [Wb]."""

    terms: Piecewise  # p (..., 6)

    @cached_property
    def _slopes(self) -> tuple[Piecewise, Piecewise]:
        first = self.terms.derivative()
        return first, first.derivative()

    def inside(self, y: Any, where: str) -> np.ndarray:
        """``y``, if it lies in the table.

        Raises
        ------
        SimulationError : a height outside.
        """
        y, (low, high) = np.asarray(y, dtype=float), self.terms.knots[[0, -1]]
        outside = ~((y >= low) & (y <= high))
        if np.any(outside):
            raise SimulationError(
                "the sphere left the force table",
                where=where,
                got=f"y = {float(y[outside].flat[0]):g} m",
                expected=f"{low:g} to {high:g} m",
                hint="widen the table's y_min and y_max, or check the gains and the polarity",
            )
        return y

    def force(self, y: Any, i1: Any, i2: Any) -> np.ndarray:
        """Force on the sphere [N]; arguments broadcast. Raises as :meth:`inside`."""
        slopes = self._slopes[0](self.inside(y, "catch"))
        return np.asarray((slopes * products(i1, i2)).sum(axis=-1))

    def inductances(self, y: Any) -> np.ndarray:
        """Symmetric L (..., 2, 2) [H]. Raises as :meth:`inside`."""
        return _quadratic(self.terms(self.inside(y, "catch")))

    def pull(self, y: float, i: np.ndarray) -> tuple[float, float, np.ndarray]:
        """The force, and its slopes by the height and by the currents (2,)."""
        (first, second), (a, b) = (slope(y) for slope in self._slopes), i
        q = np.array([1.0, a, b, a * a, a * b, b * b])
        by = np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0), (2 * a, 0.0), (b, a), (0.0, 2 * b)])
        return float(first @ q), float(second @ q), first @ by

    def fluxes(self, y: float, i: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Flux linkages (2,), and their slopes by the height (2,) and the currents (2, 2)."""
        p, slopes = self.terms(y), self._slopes[0](y)
        own, changed = _quadratic(p), _quadratic(slopes)
        return p[1:3] + own @ i, slopes[1:3] + changed @ i, own

    def stored(self, y: float, i: np.ndarray) -> float:
        """Energy ``i' L i / 2 - p0(y)`` [J] of both coils and between the magnets."""
        p = self.terms(y)
        return float(i @ _quadratic(p) @ i / 2 - p[0])


def _quadratic(p: np.ndarray) -> np.ndarray:
    """Second derivatives (..., 2, 2) of ``p . products`` by the currents."""
    return np.stack([2 * p[..., 3], p[..., 4], p[..., 4], 2 * p[..., 5]], -1).reshape(
        *p.shape[:-1], 2, 2
    )


@dataclass(frozen=True)
class PositionForce(Device):
    """The force on what is joined to ``y``, ``offset`` below its height, with ideal coil currents:
    ``gains`` times the signals ``i1`` and ``i2``."""

    name: str
    coenergy: Coenergy
    gains: tuple[float, float]
    offset: float = 0.0

    pins = (Pin("y", "displacement"), *(Pin(n, "signal", grounded=True) for n in ("i1", "i2")))
    taps = (Tap("y"), Tap("y", rate=True), Tap("i1"), Tap("i2"))
    flows = (Flow("y"),)

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        i = np.multiply(self.gains, e[2:])
        force, stiffness, slopes = self.coenergy.pull(e[0] + self.offset, i)
        return np.array([-force]), -np.array([[stiffness, 0.0, *(slopes * self.gains)]])

    def check(self, t: float, e: np.ndarray) -> None:
        self.coenergy.inside(e[0] + self.offset, f"{self.name} at t = {t:.6e} s")

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        # minus the work on the moving part: magnets and current sources give it
        return float(self.evaluate(t, e, mode)[0][0] * e[1])


@dataclass(frozen=True)
class CoilForce(Device):
    """The same with real coils between ``a1`` and ``b1``, ``a2`` and ``b2``: ``v_k = R_k i_k +
    d(lambda_k)/dt``."""

    name: str
    coenergy: Coenergy
    resistance: np.ndarray
    offset: float = 0.0

    pins = (
        Pin("y", "displacement"),
        *(Pin(end, "electrical", grounded=True) for end in ("a1", "b1", "a2", "b2")),
    )
    taps = (Tap("y"), Tap("a1", "b1"), Tap("a2", "b2"))
    flows = (Flow("y"), Flow("a1", "b1"), Flow("a2", "b2"))
    states = ("i1", "i2")
    scales = (1e-3, 1e-3)

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        i = e[3:]
        force, stiffness, slopes = self.coenergy.pull(e[0] + self.offset, i)
        jac = np.zeros((5, 5))
        jac[0, 0], jac[0, 3:] = -stiffness, -slopes
        jac[1:3, 3:] = jac[3:, 1:3] = np.eye(2)
        jac[3:, 3:] = -np.diag(self.resistance)
        return np.array([-force, *i, *(e[1:3] - self.resistance * i)]), jac

    def store(self, e: np.ndarray, mode: Any = None) -> tuple[np.ndarray, np.ndarray]:
        fluxes, by_height, by_current = self.coenergy.fluxes(e[0] + self.offset, e[3:])
        return fluxes, np.column_stack((by_height, np.zeros((2, 2)), by_current))

    def check(self, t: float, e: np.ndarray) -> None:
        self.coenergy.inside(e[0] + self.offset, f"{self.name} at t = {t:.6e} s")

    def energy(self, e: np.ndarray, mode: Any) -> float:
        return self.coenergy.stored(e[0] + self.offset, e[3:])

    def loss(self, t: float, e: np.ndarray, mode: Any) -> float:
        return float(self.resistance @ e[3:] ** 2)
