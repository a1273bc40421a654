"""A linear body of any size, known to its surroundings at its ports alone."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.laws.device import Device, Flow, Tap
from kc2spice.core.laws.linear import Port, port_pins
from kc2spice.core.laws.pin import MECHANICAL, Pin

MICRO = 1e-6  # m, in which displacements are balanced


GROWING = 1e3  # 1/s, of a load on a body that is free to move


@dataclass(frozen=True, eq=False)
class Relation:
    """``y = H a + free`` for the loads ``a`` (inputs,) and answers ``y`` (outputs,) of a body.

    At rest, at one frequency, and within one stage of an implicit time step a linear body is this
    and nothing else; ``free`` is then what its past makes it do.
    """

    H: np.ndarray
    free: np.ndarray


@dataclass(frozen=True, eq=False)
class PortBody(Device):
    """A linear model of any size by what it does at its ``ports``: its mode is a :class:`Relation`.

    Loads are forces [N], voltages [V], accelerations and signals, in the order of the ports with a
    column of B; answers are displacements [m], charges [C] and signals, in that of the rows of C.
    Forces and currents are unknowns of the device, held by ``u = y(a)`` and ``dq(a)/dt = i``.

    ``model`` has a ``pencil`` with ``transfer(s)``; the relation at rest and that at a frequency
    are taken from it, those of time steps from whoever steps.
    """

    name: str
    model: Any
    ports: tuple[Port, ...]
    known: dict[complex, np.ndarray] = field(default_factory=dict)

    @cached_property
    def _loads(self) -> tuple[Port, ...]:
        return tuple(port for port in self.ports if port.kind != "output")

    @cached_property
    def _own(self) -> tuple[Port, ...]:
        """Ports whose through quantity is an unknown."""
        return tuple(p for p in self.ports if p.kind == "electrical" or p.kind in MECHANICAL)

    @property
    def pins(self) -> tuple[Pin, ...]:
        """One pin a port, and the returns."""
        return port_pins(self.ports)

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Across quantities and signals of the loaded ports."""
        return tuple(Tap(port.name, port.ret) for port in self._loads)

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Forces on the body and currents into it."""
        return tuple(Flow(port.name, port.ret) for port in self._own)

    @property
    def states(self) -> tuple[str, ...]:
        """The same forces and currents, as unknowns."""
        return tuple(f"{port.name}.through" for port in self._own)

    @property
    def scales(self) -> tuple[float, ...]:
        """Millinewtons and milliamperes."""
        return (1e-3,) * len(self._own)

    @property
    def drives(self) -> tuple[str, ...]:
        """Outputs."""
        return tuple(port.name for port in self.ports if port.kind == "output")

    @cached_property
    def _maps(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """``a = load @ e``, ``charges = stored @ y`` and ``out = direct @ e + answered @ y``."""
        n, k, drives = len(self._loads), len(self._own), len(self.drives)
        rows = [port for port in self.ports if port.kind != "input"]
        load, stored = np.zeros((n, n + k)), np.zeros((k, len(rows)))
        direct, answered = np.zeros((2 * k + drives, n + k)), np.zeros((2 * k + drives, len(rows)))
        direct[:k, n:] = np.eye(k)
        for row, port in enumerate(self._loads):
            force = port.kind in MECHANICAL
            load[row, n + self._own.index(port) if force else row] = 1.0
        for at, port in enumerate(self._own):
            if port.kind == "electrical":
                stored[at, rows.index(port)] = direct[k + at, n + at] = 1.0
            else:
                direct[k + at, self._loads.index(port)] = 1 / MICRO
                answered[k + at, rows.index(port)] = -1 / MICRO
        for at, name in enumerate(self.drives, 2 * k):
            answered[at, [port.name for port in rows].index(name)] = 1.0
        return load, stored, direct, answered

    def loads(self, e: np.ndarray) -> np.ndarray:
        """``a`` (inputs,) of the inputs ``e`` of the device."""
        return self._maps[0] @ e

    @cached_property
    def at_rest(self) -> Relation:
        """What it does to constant loads. A body that is free to move meets none (a scene with one
        is refused): any finite answer holds it where it is, here that to a load that grows."""
        try:
            H = self.transfer(0.0)
        except SimulationError:
            H = self.known[0.0] = self.transfer(GROWING)
        return Relation(H.real, np.zeros(len(H)))

    def transfer(self, s: complex) -> np.ndarray:
        """``H(s)`` (outputs, inputs), kept: copies of a body share it."""
        if s not in self.known:
            self.known[s] = self.model.pencil.transfer(np.array([s]))[0]
        return self.known[s]

    def mode(self, t: float, e: np.ndarray, before: Any = None) -> Relation:
        """At rest."""
        return self.at_rest

    def evaluate(self, t: float, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Through quantities, what must be zero or is a current, and outputs."""
        slope = self._slope(mode.H)
        return slope @ e + self._maps[3] @ mode.free, slope

    def _slope(self, H: np.ndarray) -> np.ndarray:
        load, _, direct, answered = self._maps
        return direct + answered @ H @ load

    def store(self, e: np.ndarray, mode: Any = None) -> tuple[np.ndarray, np.ndarray]:
        """Charges."""
        load, stored, _, _ = self._maps
        slope = stored @ mode.H @ load
        return slope @ e + stored @ mode.free, slope

    def small(self, s: complex, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Slopes at a frequency, from the transfer function there."""
        load, stored, _, _ = self._maps
        H = self.transfer(s) if s else self.at_rest.H
        return self._slope(H), stored @ H @ load
