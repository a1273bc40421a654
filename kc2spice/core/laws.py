"""Constitutive equations (laws) of parts for the independent integrator.

A law consists of data in SI units and of pins with a name and a kind. It does not depend on a scene
or a netlist. The kind of a pin is the name of a domain (:mod:`kc2spice.core.domains`). All pins of
a net share the *across* quantity of this domain, such as a voltage [V]. The *through* quantities
into the parts, such as currents [A], sum to zero on each net. Pins of the kind ``signal`` have no
through quantity, and one pin of each net sets the signal.

The module :mod:`kc2spice.reference.system` assembles bodies, sources and linear devices into
constant matrices. Every law except bodies and sources is a :class:`Device`, which consists of
smooth expressions and guard functions. The expressions are valid within a *mode*, which ends when a
guard function reaches zero.
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
    """Return the names of domains."""
    return tuple(map(attrgetter("name"), domains))


MECHANICAL = _collect_names(filter(attrgetter("has_position"), CONSERVATIVE))
POTENTIALS = _collect_names(filter(attrgetter("has_potential"), CONSERVATIVE))
# Kinds of ports whose input is a flow and whose output is a potential.
# The flow into such a port is an unknown of the equations.
FLOW_DRIVEN = _collect_names(
    d for d in CONSERVATIVE if d.has_potential and d.input_side == "through"
)
# Kinds of ports whose input is a potential and whose output is the time integral of the flow.
# For example, the output of an electrical port is a charge.
CHARGE_OUTPUTS = _collect_names(filter(attrgetter("has_charge_output"), CONSERVATIVE))
GROUND = "gnd"


@dataclass(frozen=True)
class LawPin:
    """Pin of a law, with a name and a kind.

    A ``grounded`` pin is connected to the reference if it is not joined to another pin.
    """

    name: str
    kind: str
    grounded: bool = False


@dataclass(frozen=True)
class WaveCombination:
    """Result as a linear combination of the integrator's waves: ``sum factor wave + constant``.

    ``terms`` are pairs ``(factor, wave)``. If ``charge`` is true, an ac result is divided by ``j
    omega``, which converts a current to a charge. If ``rate`` is true, an ac result is multiplied
    by ``j omega`` and by a :func:`compute_low_pass_response` with the corner frequency ``corner``
    [rad/s]; in other analyses the result does not exist.
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
        """Evaluate the combination; for small signals, the constant is omitted.

        ``scale`` are the times [s] or frequencies [Hz] of the waves. The function returns None if
        ``rate`` is true and the waves are not small signals.
        """
        value = self.combine(waves)
        if not np.iscomplexobj(value):
            return None if self.rate else np.asarray(value + self.constant)
        s = 2j * np.pi * scale
        if self.rate:
            return np.asarray(s * compute_low_pass_response(s, self.corner) * value)
        return np.asarray(value / s) if self.charge else value


def evaluate_combinations(
    combinations: Mapping[str, WaveCombination], waves: Mapping[str, np.ndarray], scale: np.ndarray
) -> dict[str, np.ndarray]:
    """Evaluate the combinations whose waves are all in ``waves``, and return the values by name.

    ``scale`` are the times [s] or frequencies [Hz] of the waves.
    """
    result = {}
    for name, item in combinations.items():
        if waves.keys() >= {*item.waves}:
            value = item.evaluate(waves, scale)
            if value is not None:
                result[name] = value
    return result


def compute_low_pass_response(s: np.ndarray, corner: float) -> np.ndarray:
    """Return the response of a second-order low-pass filter at complex frequencies ``s``.

    The response is ``1 / (1 + sqrt(2) s / w + (s / w)^2)`` with the corner frequency w [rad/s],
    which may be infinite.
    """
    x = s / corner
    return np.asarray(1 / (1 + math.sqrt(2) * x + x**2))


def scale_wave(wave: str, factor: float = 1.0, constant: float = 0.0) -> WaveCombination:
    """Make the combination of ``factor`` times one wave, plus ``constant``."""
    return WaveCombination(((factor, wave),), constant)


def subtract_waves(plus: str, minus: str) -> WaveCombination:
    """Make the combination of the wave ``plus`` minus the wave ``minus``."""
    return WaveCombination(((1.0, plus), (-1.0, minus)))


@dataclass(frozen=True)
class Equations:
    """Laws of a part, with tables that map its pins and results to pins and waves of the laws.

    ``pins`` maps pins of the part to pins of the laws (``NAME.pin``). A pin of the part is not in
    ``pins`` if another pin represents this pin, or if nothing acts on this pin. Two pins of the
    part may correspond to one pin of a law: a netlist has a velocity node and a displacement node
    for one coordinate of the law. ``nets`` are pins of the laws that are joined inside of the part.
    ``results`` maps the part's results to combinations of waves. ``sweeps`` maps each key that a dc
    analysis may sweep to the name of a source and the value of the source per SI unit of the key.
    """

    laws: tuple[Law, ...] = ()
    pins: tuple[tuple[str, str], ...] = ()
    results: dict[str, WaveCombination] = field(default_factory=dict)
    sweeps: dict[str, tuple[str, float]] = field(default_factory=dict)
    nets: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class MissingEquations:
    """Reason why a part has no equations; ``verify`` prints it."""

    reason: str


@dataclass(frozen=True)
class LawPort:
    """Port of a :class:`SecondOrderBody`, with one column of its matrix B and one row of C.

    The input and the output of a port depend on its kind:

    * electrical: voltage and charge; ``ret`` names the return pin,
    * acoustic: pressure and volume,
    * mechanical: force and displacement,
    * ``acceleration``: acceleration [m/s^2] of the base, on a signal pin, and reaction force [N],
      which the wave ``NAME.PORT.reaction`` contains.
    """

    name: str
    kind: str
    ret: str = ""


@dataclass(frozen=True, eq=False)
class SecondOrderBody:
    """Body with the equations ``M x'' + E x' + K x = B u`` and ``y = C x + D u``.

    The ``pencil`` of ``model`` contains dense matrices of second-order differential equations or,
    without M, of first-order equations. The unknowns x are unknowns of the complete system of
    equations.

    A port with an entry in ``D`` must be electrical or acoustic, or this entry must be a positive
    compliance. A heat model has the energy ``x^T E x / 2`` and the loss ``x^T K x``, like an RC
    circuit with the same values.
    """

    name: str
    model: Any
    ports: tuple[LawPort, ...]

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins of the ports, with their return pins."""
        return make_port_pins(self.ports)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of ports whose flow is a state: heat ports, mechanical ports with a row of D."""
        pairs = zip(self.ports, self.model.D, strict=True)
        return tuple(
            port.name
            for port, row in pairs
            if port.kind in FLOW_DRIVEN or (port.kind in MECHANICAL and row.any())
        )

    @property
    def state_scales(self) -> tuple[float, ...]:
        """Reference magnitude of each state, by which the error of the state is divided."""
        return (1e-3,) * len(self.states)


def make_port_pins(ports: tuple[LawPort, ...]) -> tuple[LawPin, ...]:
    """Make a :class:`LawPin` for each port, and for each return pin of a port.

    Pins of ports of the kinds ``acceleration``, ``input`` and ``output`` are signals.
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

    ``kind`` is ``signal`` or a quantity of :mod:`kc2spice.core.domains`, such as the ``voltage``
    between the pins or the ``current`` out of the pin ``out``. A source of ``acceleration`` has a
    signal pin. ``ac`` is the complex amplitude of the source in an ac analysis.
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
    def sets_signal(self) -> bool:
        """Whether the source sets a signal pin."""
        return self.domain.law_pin_kind == SIGNALS.name

    @property
    def prescribes_flow(self) -> bool:
        """Whether the source prescribes a through quantity, such as a current."""
        return self.kind in QUANTITIES and QUANTITIES[self.kind][1] == "through"

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins of the source."""
        kind = self.domain.law_pin_kind
        if self.sets_signal:
            return (LawPin("out", kind),)
        return (LawPin("out", kind), LawPin("ret", kind, grounded=True))


@dataclass(frozen=True)
class AcrossInput:
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
    """Output of a device: a through quantity (flow) that enters the device at ``pin``.

    The flow leaves the device at ``minus``. A flow of equal size also leaves the device at
    ``less``.
    """

    pin: str
    minus: str = ""
    less: str = ""


class Device(ABC):
    """Law as a function of inputs, rates and states; subclasses are frozen dataclasses.

    Each device has a ``name``. The inputs ``e``, an array of shape (m,), contain the across inputs
    and then the states. A mode may be any value. Within a mode, the law has the form::

        out = [through of each flow, rate of each state's store, value of each prescribed signal]
        d/dt store(e) = rate,   store(e) = the states themselves by default

    Flows with an index in ``charged`` also contain the rates of further entries of ``store``. A
    mode ends when a guard function is no longer positive. ``start`` contains the initial
    values [m] and [m/s] of the first across input and of its rate. Without ``start``, the device
    begins at equilibrium.
    """

    name: str
    start: tuple[float, float] | None = None

    @property
    @abstractmethod
    def pins(self) -> tuple[LawPin, ...]:
        """All pins of the device."""

    @property
    @abstractmethod
    def across_inputs(self) -> tuple[AcrossInput, ...]:
        """Across quantities and rates that are inputs of the law."""

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Through variables (force, current, heat flow) that the law applies to its ports."""
        return ()

    @property
    def storing_flow_indices(self) -> tuple[int, ...]:
        """Indices of the flows that contain the rate of a stored quantity, such as a charge."""
        return ()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states of the device."""
        return ()

    @property
    def prescribed_signals(self) -> tuple[str, ...]:
        """Signal pins that the device sets."""
        return ()

    @property
    def state_scales(self) -> tuple[float, ...]:
        """Reference magnitude [A, N] of each state, by which the error of the state is divided."""
        return (1e-3,) * len(self.states)

    @property
    def is_affine(self) -> bool:
        """Whether ``evaluate`` is affine in ``e`` within a mode."""
        return False

    @property
    def linear(self) -> bool:
        """Whether the device has one mode, with affine ``evaluate`` and ``store``.

        The energy and the loss of a linear device are quadratic functions of its inputs.
        """
        return False

    @property
    def has_stored_quantities(self) -> bool:
        """Whether the device stores quantities that differ from its states."""
        return type(self).evaluate_storage is not Device.evaluate_storage and bool(
            self.states or self.storing_flow_indices
        )

    @abstractmethod
    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the outputs and their derivatives by ``e``, arrays of shape (k,) and (k, m)."""

    def evaluate_storage(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the stored quantities, and their derivatives with respect to ``e``.

        The number of stored quantities is ``len(states) + len(charged)``.
        """
        k, m = len(self.states), len(e)
        return e[m - k :], np.eye(k, m, m - k)

    def evaluate_outputs(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return the outputs ``out``, an array of shape (k,), without their derivatives."""
        return self.evaluate(e, mode)[0]

    def evaluate_stored_quantities(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return the stored quantities without their derivatives."""
        return self.evaluate_storage(e, mode)[0]

    def small_signal_derivatives(
        self, s: complex, e: np.ndarray, mode: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute derivatives for small signals ``exp(s t)`` at the operating point.

        The first result contains the derivatives of ``out`` with respect to the inputs and has the
        shape (k, m). The second result contains the derivatives of ``store`` and has the shape
        (len(states), m). All derivatives are evaluated at the inputs ``e`` of the operating point.
        The derivatives are complex if they depend on the frequency.
        """
        return self.evaluate(e, mode)[1], self.evaluate_storage(e, mode)[1]

    def noise(self, s: complex, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray] | None:
        """Compute the weights of the noise sources in ``out`` and in the stored quantities.

        Each of the two arrays has one row for each output or stored quantity, and one column for
        each noise source. The noise density is ``4 k T`` times the squared weight, with
        Boltzmann's constant ``k``. The result is None for a device without noise.
        """
        return None

    def find_initial_mode(self, e: np.ndarray) -> Any:
        """Return the mode in which the device begins, at the inputs ``e``."""
        return None

    def evaluate_guards(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return the values of the guard functions, which are positive within the mode."""
        return np.empty(0)

    def find_next_mode(self, mode: Any, guard: int) -> Any:
        """Return the mode that follows ``mode`` when the guard function ``guard`` reaches zero."""
        return mode

    def limit_change(self, e: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Return the new inputs, with a limited change in one step of Newton's method.

        ``e`` are the inputs of the new iterate, ``last`` the inputs of the last linearisation. A
        law with an exponential function limits the difference of these inputs, so that the function
        does not overflow.
        """
        return e

    def require_in_range(self, t: float, e: np.ndarray) -> None:  # noqa: B027 (most laws have no limits)
        """Raise SimulationError if the inputs at the time ``t`` are outside of the law's range."""

    def energy(self, e: np.ndarray, mode: Any) -> float:
        """Compute the stored energy [J]."""
        return 0.0

    def loss(self, e: np.ndarray, mode: Any) -> float:
        """Compute the power [W] that becomes heat; supplied power is negative."""
        return 0.0

    @property
    def energy_forms(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Matrices of the quadratic forms of a linear device's energy and loss; shape (m, m).

        A large device states these matrices in place of the methods ``energy`` and ``loss``.
        """
        return None


Law = SecondOrderBody | IdealSource | Device

MICRO = 1e-6  # m, unit of displacements in the scaled equations
GROWTH_RATE = 1e3  # 1/s, growth rate of the load on an unsupported body


@dataclass(frozen=True, eq=False)
class Relation:
    """Relation ``y = H a + free`` between the loads a and the outputs y of a body.

    The array a has the shape (inputs,), and the array y the shape (outputs,). A relation describes
    a linear body in static equilibrium, at one frequency, or within one stage of an implicit time
    step. In a time step, ``free`` is the effect of the body's earlier motion.
    """

    H: np.ndarray
    free: np.ndarray


@dataclass(frozen=True, eq=False)
class PortBody(Device):
    """Linear model of any size, represented by a relation between its ports.

    The mode of the body is a :class:`Relation`. Loads are forces [N], voltages [V], accelerations
    and signals, in the order of the ports with a column of B. Outputs are displacements [m],
    charges [C] and signals, in the order of the rows of C. The forces and the currents i are
    unknowns of the device. The equation for each force states that the displacement at the pin
    equals the output ``y(a)`` for the loads a. The equation for each current i is ``dq(a)/dt = i``
    with the charge q.

    The method ``transfer(s)`` of the model's ``pencil`` gives the static relation and the relation
    at a frequency. The integrator computes the relations of time steps. ``responses`` contains the
    matrices ``H(s)`` that were already computed, keyed by ``s``.
    """

    name: str
    model: Any
    ports: tuple[LawPort, ...]
    responses: dict[complex, np.ndarray] = field(default_factory=dict)

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
    def across_inputs(self) -> tuple[AcrossInput, ...]:
        """Across quantities that are inputs of the device."""
        return tuple(AcrossInput(port.name, port.ret) for port in self._load_ports)

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Through quantities at the pins of the device."""
        return tuple(Flow(port.name, port.ret) for port in self._flow_ports)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the through quantities that are unknowns."""
        return tuple(f"{port.name}.through" for port in self._flow_ports)

    @property
    def prescribed_signals(self) -> tuple[str, ...]:
        """Signal pins that the body sets."""
        return tuple(port.name for port in self.ports if port.kind == "output")

    @cached_property
    def _port_matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Matrices ``load``, ``stored``, ``direct`` and ``output``, in this order.

        With the inputs e of the device and the outputs y of the body, the loads are ``load @ e``,
        the charges are ``stored @ y``, and ``out`` is ``direct @ e + output @ y``.
        """
        n, k, drives = len(self._load_ports), len(self._flow_ports), len(self.prescribed_signals)
        rows = [port for port in self.ports if port.kind != "input"]
        load, stored = np.zeros((n, n + k)), np.zeros((k, len(rows)))
        direct, output = np.zeros((2 * k + drives, n + k)), np.zeros((2 * k + drives, len(rows)))
        direct[:k, n:] = np.eye(k)
        for row, port in enumerate(self._load_ports):
            force = port.kind in (*MECHANICAL, *FLOW_DRIVEN)
            load[row, n + self._flow_ports.index(port) if force else row] = 1.0
        for at, port in enumerate(self._flow_ports):
            if port.kind in POTENTIALS and port.kind not in FLOW_DRIVEN:
                stored[at, rows.index(port)] = direct[k + at, n + at] = 1.0
            else:
                direct[k + at, self._load_ports.index(port)] = 1 / MICRO
                output[k + at, rows.index(port)] = -1 / MICRO
        for at, name in enumerate(self.prescribed_signals, 2 * k):
            output[at, list(map(attrgetter("name"), rows)).index(name)] = 1.0
        return load, stored, direct, output

    def compute_loads(self, e: np.ndarray) -> np.ndarray:
        """Compute the loads ``a`` (inputs,) from the inputs ``e`` of the device."""
        return self._port_matrices[0] @ e

    @cached_property
    def static_relation(self) -> Relation:
        """Relation of loads and displacements in static equilibrium.

        A scene with a constant load on an unsupported body is rejected. For an unsupported body
        without constant loads, any finite relation is valid: the result is the response to a load
        that grows exponentially with the rate :data:`GROWTH_RATE`.
        """
        try:
            H = self.transfer(0.0)
        except SimulationError:
            H = self.responses[0.0] = self.transfer(GROWTH_RATE)
        return Relation(H.real, np.zeros(len(H)))

    def transfer(self, s: complex) -> np.ndarray:
        """Return the transfer matrix ``H(s)``, which is computed once for all copies of a body.

        The transfer matrix has the shape (outputs, inputs).
        """
        if s not in self.responses:
            self.responses[s] = self.model.pencil.transfer(np.array([s]))[0]
        return self.responses[s]

    def find_initial_mode(self, e: np.ndarray) -> Relation:
        """Return the static relation, in which the body begins."""
        return self.static_relation

    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the outputs ``out`` and their derivatives from the relation ``mode``."""
        slope = self._compute_slope(mode.H)
        return slope @ e + self._port_matrices[3] @ mode.free, slope

    def _compute_slope(self, H: np.ndarray) -> np.ndarray:
        """Return the derivatives of the outputs ``out`` for a transfer matrix ``H``."""
        load, _, direct, output = self._port_matrices
        return direct + output @ H @ load

    def evaluate_storage(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the charges and their derivatives with respect to ``e``."""
        load, stored, _, _ = self._port_matrices
        slope = stored @ mode.H @ load
        return slope @ e + stored @ mode.free, slope

    def small_signal_derivatives(
        self, s: complex, e: np.ndarray, mode: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the derivatives of ``out`` and of the charges at the complex frequency ``s``."""
        load, stored, _, _ = self._port_matrices
        H = self.transfer(s) if s else self.static_relation.H
        return self._compute_slope(H), stored @ H @ load

    def noise(self, s: complex, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray] | None:
        """Compute the noise of the outputs, which has the density ``4 k T (Y + Y^H) / (2 |s|^2)``.

        Here ``Y`` is ``s H(s)``, because the product of a load and the rate of its output is a
        power.
        """
        if any(port.kind in ("input", "output", *FLOW_DRIVEN) for port in self.ports):
            return None
        _, stored, _, output = self._port_matrices
        Y = s * self.transfer(s)
        size = np.sqrt(np.abs(np.diagonal(Y)))
        powers, shapes = np.linalg.eigh((Y + Y.conj().T) / (2 * np.outer(size, size)))
        y = size[:, None] * shapes * np.sqrt(np.maximum(powers, 0.0)) / s
        return output @ y, stored @ y


@dataclass(frozen=True, eq=False)
class SignalBlock(Device):
    """Linear system ``E x' = A x + B u``, ``y = C x + D u``, whose outputs y are signals.

    The inputs u are across quantities.
    """

    name: str
    E: np.ndarray
    A: np.ndarray
    B: np.ndarray
    C: np.ndarray
    D: np.ndarray
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    kind: str = "signal"  # kind of the input pins

    linear = True

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins of the inputs and outputs."""
        kinds = dict.fromkeys(self.inputs, self.kind) | dict.fromkeys(self.outputs, "signal")
        return tuple(LawPin(*pin) for pin in kinds.items())

    @property
    def across_inputs(self) -> tuple[AcrossInput, ...]:
        """Across quantities that are inputs of the block."""
        return tuple(map(AcrossInput, self.inputs))

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states."""
        return tuple(map("x{}".format, range(len(self.A))))

    @property
    def state_scales(self) -> tuple[float, ...]:
        """Reference magnitude of each state, by which the error of the state is divided."""
        return (1.0,) * len(self.A)

    @property
    def prescribed_signals(self) -> tuple[str, ...]:
        """Signal pins that the block sets."""
        return self.outputs

    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the rates ``A x + B u`` and the outputs ``y``, with their derivatives."""
        slope = np.block([[self.B, self.A], [self.D, self.C]])
        return slope @ e, slope

    def evaluate_storage(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return ``E x`` and its derivative with respect to ``e``."""
        slope = np.hstack([0.0 * self.B, self.E])
        return slope @ e, slope


def make_sensor_block(name: str, gain: float, kind: str) -> SignalBlock:
    """Make a block whose signal ``out`` is ``gain`` times the across quantity of the pin ``a``."""
    none, column = np.zeros((0, 0)), np.zeros((0, 1))
    D = np.array([[gain]])
    return SignalBlock(name, none, none, column, column.T, D, ("a",), ("out",), kind)
