"""Constitutive equations (laws) of parts for the independent integrator.

A law is plain data in SI with named, typed pins, without a scene or a netlist. A pin's kind is the
name of a domain (:mod:`kc2spice.core.domains`). All pins of a net share the *across* quantity of
this domain, such as a voltage [V]. The *through* quantities into the parts, such as currents [A],
sum to zero on each net. The kind ``signal`` has no through quantity, and one pin of a net sets the
signal.

The assembler stamps bodies and sources into matrices (:mod:`kc2spice.reference.system`). Every
other law is a :class:`Device`: smooth expressions within a *mode*, and guards whose zeros end the
mode. A linear device also becomes constant matrices.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from operator import attrgetter, itemgetter
from typing import Any

import numpy as np

from kc2spice.core.domains import CONSERVATIVE, QUANTITIES, SIGNALS, Domain
from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import Function


def _collect_names(domains: Iterable[Domain]) -> tuple[str, ...]:
    """Return the names of domains, which are kinds of pins."""
    return tuple(map(attrgetter("name"), domains))


MECHANICAL = _collect_names(filter(attrgetter("position"), CONSERVATIVE))
POTENTIALS = _collect_names(filter(attrgetter("potential"), CONSERVATIVE))
# Kinds whose port input is a flow and whose output is a potential: the flow is an unknown.
FLOW_DRIVEN = _collect_names(d for d in CONSERVATIVE if d.potential and d.driven == "through")
# Kinds of ports whose input is a potential and whose output is the time integral of the flow, such
# as a charge.
CHARGE_OUTPUTS = _collect_names(filter(attrgetter("charged"), CONSERVATIVE))
GROUND = "gnd"


@dataclass(frozen=True)
class LawPin:
    """Named pin of a law.

    A ``grounded`` pin is connected to the reference if no other pin is joined to it.
    """

    name: str
    kind: str
    grounded: bool = False


@dataclass(frozen=True)
class Reading:
    """Result as a linear combination of the integrator's waves: ``sum factor wave + constant``.

    ``terms`` are the pairs ``(factor, wave)``. ``charge`` divides an ac result by ``j omega``, and
    a current becomes a charge. ``rate`` multiplies an ac result by ``j omega`` and by a
    :func:`low_pass` with the corner frequency ``corner`` [rad/s]; other analyses do not have this
    result.
    """

    terms: tuple[tuple[float, str], ...]
    constant: float = 0.0
    charge: bool = False
    rate: bool = False
    corner: float = math.inf

    @property
    def waves(self) -> tuple[str, ...]:
        """Names of the waves in ``terms``."""
        return tuple(map(itemgetter(1), self.terms))

    def combine(self, waves: Mapping[str, np.ndarray]) -> np.ndarray:
        """Return the sum of the waves times their factors, without the constant."""
        return np.asarray(sum(factor * waves[wave] for factor, wave in self.terms))

    def evaluate(self, waves: Mapping[str, np.ndarray], scale: np.ndarray) -> np.ndarray | None:
        """Return the values of the result; constants are omitted for small signals.

        ``scale`` are the times [s] or frequencies [Hz] of the waves. The rate of a wave is None if
        the waves are not small signals.
        """
        value = self.combine(waves)
        if not np.iscomplexobj(value):
            return None if self.rate else np.asarray(value + self.constant)
        s = 2j * np.pi * scale
        if self.rate:
            return np.asarray(s * low_pass(s, self.corner) * value)
        return np.asarray(value / s) if self.charge else value


def evaluate_readings(
    readings: Mapping[str, Reading], waves: Mapping[str, np.ndarray], scale: np.ndarray
) -> dict[str, np.ndarray]:
    """Return the results whose waves are all in ``waves``.

    ``scale`` are the times [s] or frequencies [Hz] of the waves.
    """
    result = {}
    for name, item in readings.items():
        if waves.keys() >= {*item.waves}:
            value = item.evaluate(waves, scale)
            if value is not None:
                result[name] = value
    return result


def low_pass(s: np.ndarray, corner: float) -> np.ndarray:
    """Return the response of a low pass of second order, ``1 / (1 + sqrt(2) s / w + (s / w)^2)``.

    The corner frequency w [rad/s] may be infinite.
    """
    x = s / corner
    return np.asarray(1 / (1 + math.sqrt(2) * x + x**2))


def scaled_wave(wave: str, factor: float = 1.0, constant: float = 0.0) -> Reading:
    """Make a reading of ``factor`` times one wave, plus ``constant``."""
    return Reading(((factor, wave),), constant)


def wave_difference(plus: str, minus: str) -> Reading:
    """Make a reading of one wave minus another."""
    return Reading(((1.0, plus), (-1.0, minus)))


@dataclass(frozen=True)
class Equations:
    """Laws of a part, and the pins and waves that represent the part.

    ``pins`` maps pins of the part to pins of the laws (``NAME.pin``). A missing pin has no
    counterpart, because another pin represents it or because nothing acts on it. Two pins of the
    part may share a pin of a law: a netlist has a velocity node and a displacement node for one
    coordinate of the law. ``nets`` are pins of the laws that are joined inside of the part.
    ``results`` maps the part's results to waves. ``sweeps`` maps keys that a dc analysis sweeps to
    the name of a source and its value per SI unit of the key.
    """

    laws: tuple[Law, ...] = ()
    pins: tuple[tuple[str, str], ...] = ()
    results: dict[str, Reading] = field(default_factory=dict)
    sweeps: dict[str, tuple[str, float]] = field(default_factory=dict)
    nets: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class MissingEquations:
    """Reason why a part has no equations; ``verify`` prints it."""

    reason: str


@dataclass(frozen=True)
class LawPort:
    """Port of a :class:`SecondOrderBody`: one column of B, one row of C.

    Electrical: voltage in, charge out; ``ret`` names the pin of its return. Acoustic: pressure in,
    volume out. Mechanical: force in, displacement out. ``acceleration``: acceleration of the base
    in [m/s^2] (a signal pin), reaction force out [N], recorded in the wave ``NAME.PORT.reaction``.
    """

    name: str
    kind: str
    ret: str = ""


@dataclass(frozen=True, eq=False)
class SecondOrderBody:
    """Body with the equations ``M x'' + E x' + K x = B in``, ``out = C x + D in``.

    The ``model`` has a dense ``pencil`` of second order, or of first order without M. The unknowns
    of the body are unknowns of the system of equations.

    A port with ``D`` must be electrical or acoustic, or its compliance in ``D`` must be positive.
    Energy and loss of a heat model are defined like those of a circuit with the same numbers: ``x'
    E x / 2``, ``x' K x``.
    """

    name: str
    model: Any
    ports: tuple[LawPort, ...]

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins of the ports and their returns."""
        return make_port_pins(self.ports)

    @property
    def states(self) -> tuple[str, ...]:
        """Forces at mechanical ports with additional compliance, and flows of heat, as states."""
        pairs = zip(self.ports, self.model.D, strict=True)
        return tuple(
            port.name
            for port, row in pairs
            if port.kind in FLOW_DRIVEN or (port.kind in MECHANICAL and row.any())
        )

    @property
    def scales(self) -> tuple[float, ...]:
        """Error scales of the states."""
        return (1e-3,) * len(self.states)


def make_port_pins(ports: tuple[LawPort, ...]) -> tuple[LawPin, ...]:
    """Make a pin for each port, and for the returns.

    Accelerations, inputs and outputs are signals.
    """
    result: list[LawPin] = []
    for port in ports:
        kind = port.kind if port.kind in (*MECHANICAL, *POTENTIALS) else "signal"
        result.append(LawPin(port.name, kind))
        if port.ret and port.ret not in {p.name for p in result}:
            result.append(LawPin(port.ret, kind, grounded=True))
    return tuple(result)


@dataclass(frozen=True)
class IdealSource:
    """Source that prescribes a quantity between ``out`` and ``ret``.

    ``kind`` is a quantity of :mod:`kc2spice.core.domains`, such as ``voltage`` between the pins or
    ``current`` out of ``out``, or ``signal``. An ``acceleration`` is on a signal pin. ``ac`` is the
    complex amplitude of an ac analysis.
    """

    name: str
    kind: str
    wave: Function
    ac: complex = 0.0

    @property
    def domain(self) -> Domain:
        """Domain of the pins of the source."""
        return SIGNALS if self.kind == SIGNALS.name else QUANTITIES[self.kind][0]

    @property
    def signal(self) -> bool:
        """Whether the source sets a signal pin."""
        return self.domain.kind_of_law == SIGNALS.name

    @property
    def flows(self) -> bool:
        """Whether the source prescribes a through quantity, such as a current."""
        return self.kind in QUANTITIES and QUANTITIES[self.kind][1] == "through"

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins of the source."""
        kind = self.domain.kind_of_law
        if self.signal:
            return (LawPin("out", kind),)
        return (LawPin("out", kind), LawPin("ret", kind, grounded=True))


@dataclass(frozen=True)
class Tap:
    """Input of a device: an across quantity or its rate.

    The across quantities of ``minus`` and ``less`` are subtracted from the across quantity of
    ``pin``.
    """

    pin: str
    minus: str = ""
    rate: bool = False
    less: str = ""


@dataclass(frozen=True)
class Flow:
    """Output of a device: a through quantity into the device at ``pin``.

    The flow leaves the device at ``minus``; the same quantity leaves it at ``less``.
    """

    pin: str
    minus: str = ""
    less: str = ""


class Device(ABC):
    """Law of inputs, rates and states; subclasses are frozen dataclasses.

    Each has a ``name``. The inputs ``e`` (m,) are the taps and then the states. In a mode, which
    may be any value::

        out = [through of every flow, rate of every state's store, value of every signal it drives]
        d/dt store(e) = rate,   store(e) = the states themselves by default

    Flows that are ``charged`` contain the rates of further entries of ``store`` as well. A mode
    lasts while every guard is positive. ``start`` [m], [m/s] are the initial values of the first
    tap and of its rate. Without ``start``, the tap and its rate begin at equilibrium.
    """

    name: str
    start: tuple[float, float] | None = None

    @property
    @abstractmethod
    def pins(self) -> tuple[LawPin, ...]:
        """All pins of the device."""

    @property
    @abstractmethod
    def taps(self) -> tuple[Tap, ...]:
        """Across quantities and rates that are inputs of the law."""

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Through variables (force, current, heat flow) that the law applies to its ports."""
        return ()

    @property
    def charged(self) -> tuple[int, ...]:
        """Indices of the flows that contain the rate of a stored quantity, such as a charge."""
        return ()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states of the device."""
        return ()

    @property
    def prescribes(self) -> tuple[str, ...]:
        """Signal pins that the device sets."""
        return ()

    @property
    def scales(self) -> tuple[float, ...]:
        """Error scales of the states: currents in A, forces in N."""
        return (1e-3,) * len(self.states)

    @property
    def is_affine(self) -> bool:
        """Whether ``evaluate`` is affine in ``e`` within a mode."""
        return False

    @property
    def linear(self) -> bool:
        """Whether there is one mode, with affine ``evaluate`` and ``store``.

        Energy and loss are then quadratic.
        """
        return False

    @property
    def has_stored_quantities(self) -> bool:
        """Whether the device stores quantities that differ from its states."""
        return type(self).store is not Device.store and bool(self.states or self.charged)

    @abstractmethod
    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return ``out`` (k,) and its derivative (k, m) with respect to ``e``."""

    def store(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the stored quantities (len(states) + len(charged),) and their derivatives."""
        k, m = len(self.states), len(e)
        return e[m - k :], np.eye(k, m, m - k)

    def evaluate_outputs(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return ``out`` (k,) without its derivative."""
        return self.evaluate(e, mode)[0]

    def evaluate_store(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return the stored quantities without their derivatives."""
        return self.store(e, mode)[0]

    def small_signal_derivatives(
        self, s: complex, e: np.ndarray, mode: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute derivatives for small signals ``exp(s t)`` around ``e``.

        The results are the derivatives of ``out`` (k, m) and of the store (len(states), m). The
        derivatives are complex if they depend on the frequency.
        """
        return self.evaluate(e, mode)[1], self.store(e, mode)[1]

    def noise(self, s: complex, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray] | None:
        """Compute noise sources of unit density in ``out`` (k, sources) and in the store.

        The noise is ``4 k T`` times the square of the sources. The result is None for a device
        without noise.
        """
        return None

    def mode(self, e: np.ndarray) -> Any:
        """Return the mode in which the device begins with the inputs ``e``."""
        return None

    def guards(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Compute values (g,) that stay positive within the mode."""
        return np.empty(0)

    def switch(self, mode: Any, guard: int) -> Any:
        """Return the mode after ``guard`` fell to zero."""
        return mode

    def limit(self, e: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Return the inputs at which Newton's method linearises the law next.

        ``e`` are the inputs of the new iterate, ``last`` those of the last linearisation. A law
        with an exponential function limits the change, so that it does not overflow.
        """
        return e

    def check(self, t: float, e: np.ndarray) -> None:  # noqa: B027 (most laws have no limits)
        """Raise SimulationError if the inputs are outside of the law's range."""

    def energy(self, e: np.ndarray, mode: Any) -> float:
        """Compute the stored energy [J]."""
        return 0.0

    def loss(self, e: np.ndarray, mode: Any) -> float:
        """Compute the power [W] that becomes heat; power from outside is negative."""
        return 0.0

    @property
    def energy_forms(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Matrices (m, m) of the quadratic forms ``energy`` and ``loss`` of a linear device.

        With these matrices, a large device needs no methods ``energy`` and ``loss``.
        """
        return None


Law = SecondOrderBody | IdealSource | Device

MICRO = 1e-6  # m, unit of displacements in the scaled equations
GROWTH_RATE = 1e3  # 1/s, growth rate of the load on an unsupported body


@dataclass(frozen=True, eq=False)
class Relation:
    """Relation ``y = H a + free`` between loads (inputs,) and outputs (outputs,).

    A relation describes a linear body in static equilibrium, at one frequency, or within one stage
    of an implicit time step; ``free`` is then the effect of the past.
    """

    H: np.ndarray
    free: np.ndarray


@dataclass(frozen=True, eq=False)
class PortBody(Device):
    """Linear model of any size, represented by a relation at its ports.

    The mode of the body is a :class:`Relation`. Loads are forces [N], voltages [V], accelerations
    and signals, in the order of the ports with a column of B. Outputs are displacements [m],
    charges [C] and signals, in the order of the rows of C. Forces and currents are unknowns of the
    device, with the equations ``u = y(a)`` and ``dq(a)/dt = i``.

    ``model`` has a ``pencil`` with ``transfer(s)``, which gives the static relation and the
    relation at a frequency. An integrator makes the relations of time steps.
    """

    name: str
    model: Any
    ports: tuple[LawPort, ...]
    known: dict[complex, np.ndarray] = field(default_factory=dict)

    @cached_property
    def _load_ports(self) -> tuple[LawPort, ...]:
        """Ports whose input is a load of the model."""
        return tuple(port for port in self.ports if port.kind != "output")

    @cached_property
    def _flow_ports(self) -> tuple[LawPort, ...]:
        """Ports whose through quantity is an unknown."""
        return tuple(p for p in self.ports if p.kind in (*POTENTIALS, *MECHANICAL))

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins of the ports."""
        return make_port_pins(self.ports)

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Across quantities that are inputs of the device."""
        return tuple(Tap(port.name, port.ret) for port in self._load_ports)

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Through quantities that the device exerts."""
        return tuple(Flow(port.name, port.ret) for port in self._flow_ports)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the through quantities that are unknowns."""
        return tuple(f"{port.name}.through" for port in self._flow_ports)

    @property
    def prescribes(self) -> tuple[str, ...]:
        """Signal pins that the body sets."""
        return tuple(port.name for port in self.ports if port.kind == "output")

    @cached_property
    def _port_matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Matrices ``load``, ``stored``, ``direct`` and ``answered``, in this order.

        With the inputs e and the states y, the loads are ``load @ e``, the charges ``stored @ y``,
        and the outputs ``direct @ e + answered @ y``.
        """
        n, k, drives = len(self._load_ports), len(self._flow_ports), len(self.prescribes)
        rows = [port for port in self.ports if port.kind != "input"]
        load, stored = np.zeros((n, n + k)), np.zeros((k, len(rows)))
        direct, answered = np.zeros((2 * k + drives, n + k)), np.zeros((2 * k + drives, len(rows)))
        direct[:k, n:] = np.eye(k)
        for row, port in enumerate(self._load_ports):
            force = port.kind in (*MECHANICAL, *FLOW_DRIVEN)
            load[row, n + self._flow_ports.index(port) if force else row] = 1.0
        for at, port in enumerate(self._flow_ports):
            if port.kind in POTENTIALS and port.kind not in FLOW_DRIVEN:
                stored[at, rows.index(port)] = direct[k + at, n + at] = 1.0
            else:
                direct[k + at, self._load_ports.index(port)] = 1 / MICRO
                answered[k + at, rows.index(port)] = -1 / MICRO
        for at, name in enumerate(self.prescribes, 2 * k):
            answered[at, list(map(attrgetter("name"), rows)).index(name)] = 1.0
        return load, stored, direct, answered

    def loads(self, e: np.ndarray) -> np.ndarray:
        """Compute the loads ``a`` (inputs,) from the inputs ``e`` of the device."""
        return self._port_matrices[0] @ e

    @cached_property
    def static_relation(self) -> Relation:
        """Static relation of loads and displacements.

        A scene with a constant load on an unsupported body is rejected. For other unsupported
        bodies, any finite relation is valid. The relation used is the response to a growing load.
        """
        try:
            H = self.transfer(0.0)
        except SimulationError:
            H = self.known[0.0] = self.transfer(GROWTH_RATE)
        return Relation(H.real, np.zeros(len(H)))

    def transfer(self, s: complex) -> np.ndarray:
        """Compute ``H(s)`` (outputs, inputs) once; copies of a body share the result."""
        if s not in self.known:
            self.known[s] = self.model.pencil.transfer(np.array([s]))[0]
        return self.known[s]

    def mode(self, e: np.ndarray) -> Relation:
        """Return the static relation."""
        return self.static_relation

    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return ``out`` and its derivative from the relation of the mode."""
        slope = self._compute_slope(mode.H)
        return slope @ e + self._port_matrices[3] @ mode.free, slope

    def _compute_slope(self, H: np.ndarray) -> np.ndarray:
        """Return the derivative of ``out`` for a response matrix ``H``."""
        load, _, direct, answered = self._port_matrices
        return direct + answered @ H @ load

    def store(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the charges and their derivatives."""
        load, stored, _, _ = self._port_matrices
        slope = stored @ mode.H @ load
        return slope @ e + stored @ mode.free, slope

    def small_signal_derivatives(
        self, s: complex, e: np.ndarray, mode: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of ``out`` and of the charges at ``s``."""
        load, stored, _, _ = self._port_matrices
        H = self.transfer(s) if s else self.static_relation.H
        return self._compute_slope(H), stored @ H @ load

    def noise(self, s: complex, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray] | None:
        """Compute noise of the density ``4 k T (s H + (s H)^H) / (2 |s|^2)``.

        The noise acts on the outputs.

        Loads times rates of outputs are power.
        """
        if any(port.kind in ("input", "output", *FLOW_DRIVEN) for port in self.ports):
            return None
        _, stored, _, answered = self._port_matrices
        Y = s * self.transfer(s)
        size = np.sqrt(np.abs(np.diagonal(Y)))
        powers, shapes = np.linalg.eigh((Y + Y.conj().T) / (2 * np.outer(size, size)))
        y = size[:, None] * shapes * np.sqrt(np.maximum(powers, 0.0)) / s
        return answered @ y, stored @ y


@dataclass(frozen=True, eq=False)
class SignalBlock(Device):
    """Linear system ``E x' = A x + B u``, ``y = C x + D u`` with signals as outputs.

    The inputs are across quantities.
    """

    name: str
    E: np.ndarray
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    kind: str = "signal"  # kind of the inputs

    linear = True

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins of the inputs and outputs."""
        kinds = dict.fromkeys(self.inputs, self.kind) | dict.fromkeys(self.outputs, "signal")
        return tuple(LawPin(*pin) for pin in kinds.items())

    @property
    def taps(self) -> tuple[Tap, ...]:
        """Inputs of the block."""
        return tuple(map(Tap, self.inputs))

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(map("x{}".format, range(len(self.A))))

    @property
    def scales(self) -> tuple[float, ...]:
        """Error scales of the states."""
        return (1.0,) * len(self.A)

    @property
    def prescribes(self) -> tuple[str, ...]:
        """Signal pins that the block sets."""
        return self.outputs

    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return outputs and rates, with their derivatives."""
        slope = np.block([[self.B, self.A], [self.D, self.C]])
        return slope @ e, slope

    def store(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return ``E x`` and its derivative."""
        slope = np.hstack([0.0 * self.B, self.E])
        return slope @ e, slope


def sensor_block(name: str, gain: float, kind: str) -> SignalBlock:
    """Make a block with the signal ``out = gain across(a)``."""
    none, column = np.zeros((0, 0)), np.zeros((0, 1))
    D = np.array([[gain]])
    return SignalBlock(name, none, none, column, column.T, D, ("a",), ("out",), kind)
