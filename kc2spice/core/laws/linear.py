"""Linear laws, which the assembler stamps into matrices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from kc2spice.core.laws.pin import MECHANICAL, Pin
from kc2spice.core.laws.wave import Waveform


@dataclass(frozen=True)
class Port:
    """A port of a :class:`LinearBody`: one column of B, one row of C.

    Electrical: voltage in, charge out; ``ret`` names the pin of its return. Mechanical: force in,
    displacement out. ``acceleration``: acceleration of the base in [m/s^2] (a signal pin), reaction
    force out [N], seen in the wave ``NAME.PORT.reaction``.
    """

    name: str
    kind: str
    ret: str = ""


@dataclass(frozen=True)
class LinearBody:
    """``M x'' + E x' + K x = B in``, ``out = C x + D in``.

    ``M``, ``E``, ``K`` (n, n) or (n,) for diagonal ones; ``B`` (n, p), ``C`` (p, n), ``D`` (p, p).
    A port with ``D`` must be electrical or have an own positive compliance.
    """

    name: str
    M: np.ndarray
    E: np.ndarray
    K: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    ports: tuple[Port, ...]

    @property
    def pins(self) -> tuple[Pin, ...]:
        """One pin a port, and the returns."""
        return port_pins(self.ports)


def port_pins(ports: tuple[Port, ...]) -> tuple[Pin, ...]:
    """One pin a port, and the returns; accelerations, inputs and outputs are signals."""
    found: list[Pin] = []
    for port in ports:
        kind = port.kind if port.kind in (*MECHANICAL, "electrical") else "signal"
        found.append(Pin(port.name, kind))
        if port.ret and port.ret not in {p.name for p in found}:
            found.append(Pin(port.ret, kind, grounded=True))
    return tuple(found)


@dataclass(frozen=True)
class SignalBlock:
    """``E x' = A x + B u``, ``y = C x + D u`` from signals to signals."""

    name: str
    E: np.ndarray
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]

    @property
    def pins(self) -> tuple[Pin, ...]:
        """Inputs, then outputs."""
        return tuple(Pin(n, "signal") for n in (*self.inputs, *self.outputs))


@dataclass(frozen=True)
class Mass:
    """A rigid mass [kg] on pin ``a``.

    ``position`` and ``velocity`` start it there; None starts it where the rest of the system holds
    it in equilibrium. ``gravity`` [m/s^2] pulls towards smaller displacements.
    """

    name: str
    mass: float
    gravity: float = 0.0
    position: float | None = None
    velocity: float = 0.0

    @property
    def pins(self) -> tuple[Pin, ...]:
        """The one pin ``a``."""
        return (Pin("a", "displacement"),)


@dataclass(frozen=True)
class TwoTerminal:
    """``through = value d^order/dt^order`` of the voltage, or of the velocity, from ``a`` to ``b``.

    ``order`` -1 stores energy by the integral (inductor, spring), 0 dissipates it (resistor,
    damper), 1 stores it by the value itself (capacitor, inerter). ``value`` is in SI: 1/H, N/m,
    1/Ohm, N s/m, F or kg.
    """

    name: str
    order: int
    value: float
    kind: str = "electrical"

    @property
    def pins(self) -> tuple[Pin, ...]:
        """``a``, and ``b``, which lies on the reference by default."""
        return (Pin("a", self.kind), Pin("b", self.kind, grounded=True))


@dataclass(frozen=True)
class Source:
    """A prescribed quantity between ``out`` and ``ret``.

    ``kind``: ``voltage`` [V], ``current`` [A] out of ``out``, ``force`` [N] on what is joined to
    ``out``, ``displacement`` [m], ``acceleration``
    [m/s^2] (a signal pin), ``signal``. ``ac`` is the complex amplitude of an ac analysis.
    """

    name: str
    kind: str
    wave: Waveform
    ac: complex = 0.0

    @property
    def pins(self) -> tuple[Pin, ...]:
        """``out``, and ``ret``, which is grounded by default."""
        if self.kind in ("signal", "acceleration"):
            return (Pin("out", "signal"),)
        kind = "electrical" if self.kind in ("voltage", "current") else "displacement"
        return (Pin("out", kind), Pin("ret", kind, grounded=True))


@dataclass(frozen=True)
class Sensor:
    """Signal ``out = gain across(a)``."""

    name: str
    gain: float
    kind: str

    @property
    def pins(self) -> tuple[Pin, ...]:
        """``a`` and the signal ``out``."""
        return (Pin("a", self.kind), Pin("out", "signal"))
