"""Constitutive equations (laws) of parts, which the reference solver integrates.

A law consists of data in SI units and of pins with a name and a kind. Laws do not depend on a scene
or a netlist. The kind of a pin is the name of a domain (:mod:`kc2spice.core.domains`). All pins of
a net belong to one domain and share its *across* quantity, such as a voltage [V]. The *through*
quantities into the parts, such as currents [A], sum to zero on each net. Pins of the kind
``signal`` have no through quantity, and one pin of each net sets the signal.

The module :mod:`kc2spice.reference.system` assembles bodies, sources and linear devices into
constant matrices. Every law except bodies and sources is a :class:`Device`, which consists of
smooth expressions and guard functions. The expressions of a device are valid within a *mode*, which
ends when a guard function reaches zero.
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
    """Return the name of each domain, such as "thermal", in a tuple."""
    return tuple(map(attrgetter("name"), domains))


MECHANICAL = _collect_names(filter(attrgetter("has_position"), CONSERVATIVE))
POTENTIALS = _collect_names(filter(attrgetter("has_potential"), CONSERVATIVE))
# Kinds of ports with a flow as input and a potential as output.
# The flow into a port of these kinds is an unknown of the equations.
FLOW_DRIVEN = _collect_names(
    d for d in CONSERVATIVE if d.has_potential and d.input_side == "through"
)
# Kinds of ports with a potential as input and the time integral of the flow as output.
# For example, the output of an electrical port is a charge.
CHARGE_OUTPUTS = _collect_names(filter(attrgetter("has_charge_output"), CONSERVATIVE))
GROUND = "gnd"


@dataclass(frozen=True)
class LawPin:
    """Pin of a law, with the name of its physical domain.

    The ``kind`` of a pin is the name of a domain, or ``signal``. A ``grounded`` pin is connected to
    ground if the pin is not joined to another pin.
    """

    name: str
    kind: str
    grounded: bool = False


@dataclass(frozen=True)
class WaveCombination:
    """Result of a part that is a linear combination of waveforms plus a constant.

    The result is ``constant`` plus the sum of ``factor * wave`` over all pairs ``(factor, wave)``
    in ``terms``. If ``charge`` is true, an ac result is divided by ``j omega``, which converts a
    current to a charge. If ``rate`` is true, an ac result is multiplied by ``j omega`` and by the
    response of :func:`compute_low_pass_response` with the corner frequency ``corner`` [rad/s]. If
    ``rate`` is true, the result is a time derivative and exists only in ac analyses.
    """

    terms: tuple[tuple[float, str], ...]
    constant: float = 0.0
    charge: bool = False
    rate: bool = False
    corner: float = math.inf

    @property
    def waves(self) -> tuple[str, ...]:
        """Names of the waveforms that the linear combination contains."""
        return tuple(map(itemgetter(1), self.terms))

    def combine(self, waves: Mapping[str, np.ndarray]) -> np.ndarray:
        """Add all waveforms, each multiplied by its factor; omit the constant term."""
        return np.asarray(sum(factor * waves[wave] for factor, wave in self.terms))

    def evaluate(self, waves: Mapping[str, np.ndarray], scale: np.ndarray) -> np.ndarray | None:
        """Evaluate the combination of waveforms; for small signals, omit its constant.

        ``scale`` contains the time [s] or the frequency [Hz] of each sample of the waveforms. The
        function returns None if ``rate`` is true and the waves are not small signals.
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
    """Evaluate the linear combinations for which all waveforms are available.

    The result is keyed by the name of the combination. ``scale`` contains the time [s] or the
    frequency [Hz] of each sample of the waveforms.
    """
    result = {}
    for name, item in combinations.items():
        if waves.keys() >= {*item.waves}:
            value = item.evaluate(waves, scale)
            if value is not None:
                result[name] = value
    return result


def compute_low_pass_response(s: np.ndarray, corner: float) -> np.ndarray:
    """Return the frequency response of a second-order low-pass filter.

    For complex frequencies ``s`` [rad/s], the response is ``1 / (1 + sqrt(2) s / w + (s / w)^2)``.
    The corner frequency w [rad/s] may be infinite.
    """
    x = s / corner
    return np.asarray(1 / (1 + math.sqrt(2) * x + x**2))


def scale_wave(wave: str, factor: float = 1.0, constant: float = 0.0) -> WaveCombination:
    """Make the linear combination ``factor * wave + constant`` of one waveform."""
    return WaveCombination(((factor, wave),), constant)


def subtract_waves(plus: str, minus: str) -> WaveCombination:
    """Make the difference of two waveforms, ``plus - minus``."""
    return WaveCombination(((1.0, plus), (-1.0, minus)))


@dataclass(frozen=True)
class Equations:
    """Equations of a part: its laws, and how its pins and results relate to the laws.

    ``pins`` maps pins of the part to pins of the laws (``NAME.pin``). A pin of the part is not in
    ``pins`` if another pin represents the pin, or if nothing acts on the pin. Two pins of the part
    may correspond to one pin of a law. For example, the velocity node and the displacement node in
    a netlist correspond to one coordinate of a law. Each item of ``nets`` lists pins of the part's
    laws that are connected to each other inside the part. ``results`` maps the part's results to
    combinations of waves. ``sweeps`` is keyed by the scene keys that a dc analysis may sweep. For
    each scene key, ``sweeps`` contains the name of a source, and the value of this source per SI
    unit of the scene key.
    """

    laws: tuple[Law, ...] = ()
    pins: tuple[tuple[str, str], ...] = ()
    results: dict[str, WaveCombination] = field(default_factory=dict)
    sweeps: dict[str, tuple[str, float]] = field(default_factory=dict)
    nets: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class MissingEquations:
    """Marker for missing equations of a part, with the reason that ``verify`` prints."""

    reason: str


@dataclass(frozen=True)
class LawPort:
    """Port of a :class:`SecondOrderBody`: one column of B and one row of C.

    The input and the output of a port depend on its kind:

    * electrical: voltage and charge; ``ret`` names the return pin,
    * acoustic: pressure and volume,
    * mechanical: force and displacement,
    * ``acceleration``: acceleration [m/s^2] of the frame, on a signal pin, and reaction force [N]
      in the wave ``NAME.PORT.reaction``.
    """

    name: str
    kind: str
    ret: str = ""


@dataclass(frozen=True, eq=False)
class SecondOrderBody:
    """Body with the equations ``M x'' + E x' + K x = B u`` and ``y = C x + D u``.

    The ``pencil`` of ``model`` contains the dense matrices M, E and K. Without M, the differential
    equations are of first order. The solver adds the unknowns x to the unknowns of the complete
    system of equations.

    An entry of ``D`` must belong to an electrical or acoustic port, or be a positive compliance. A
    thermal model has the energy ``x^T E x / 2`` and the loss ``x^T K x``, like an RC circuit with
    the same values.
    """

    name: str
    model: Any
    ports: tuple[LawPort, ...]

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins of all ports, including return pins."""
        return make_port_pins(self.ports)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states: one for each port whose force or heat flow is unknown.

        The flow is an unknown at heat ports, and at mechanical ports with a nonzero row of D.
        """
        pairs = zip(self.ports, self.model.D, strict=True)
        return tuple(
            port.name
            for port, row in pairs
            if port.kind in FLOW_DRIVEN or (port.kind in MECHANICAL and row.any())
        )

    @property
    def state_scales(self) -> tuple[float, ...]:
        """Typical magnitude of each state, which scales its integration error."""
        return (1e-3,) * len(self.states)


def make_port_pins(ports: tuple[LawPort, ...]) -> tuple[LawPin, ...]:
    """Return the main pin of each port, and each return pin once.

    The pins of ``acceleration``, ``input`` and ``output`` ports are signal pins.
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
    """Ideal source that prescribes a quantity between its pins ``out`` and ``ret``.

    ``kind`` is ``signal`` or a quantity of :mod:`kc2spice.core.domains`, such as the ``voltage``
    between the pins or the ``current`` out of the pin ``out``. A source of the kind
    ``acceleration`` has only the pin ``out``, which is a signal pin. ``ac`` is the complex
    amplitude of the source in an ac analysis.
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
        return self.domain.pin_kind == SIGNALS.name

    @property
    def prescribes_flow(self) -> bool:
        """Whether the source prescribes a through quantity, such as a current."""
        return self.kind in QUANTITIES and QUANTITIES[self.kind][1] == "through"

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins of the source."""
        kind = self.domain.pin_kind
        if self.sets_signal:
            return (LawPin("out", kind),)
        return (LawPin("out", kind), LawPin("ret", kind, grounded=True))


@dataclass(frozen=True)
class AcrossInput:
    """Input of a device: an across quantity at its pins, or the rate of this quantity.

    The across quantities of the pins ``minus`` and ``less`` are subtracted from the across quantity
    of ``pin``.
    """

    pin: str
    minus: str = ""
    rate: bool = False
    less: str = ""


@dataclass(frozen=True)
class Flow:
    """Output of a device: a through quantity (flow) that enters at one of its pins.

    The flow that enters the device at ``pin`` leaves the device at the pin ``minus``. If ``less``
    is given, the full flow leaves the device at each of the two pins ``minus`` and ``less``.
    """

    pin: str
    minus: str = ""
    less: str = ""


class Device(ABC):
    """Base class of laws whose outputs depend on inputs, states and a switching state.

    Subclasses are frozen dataclasses. Each device has a ``name``. The array ``e`` of shape (m,)
    contains the across inputs, followed by the states. The argument ``mode`` of the methods
    identifies a switching state, such as the closed switch; its type depends on the device. The
    array of outputs contains the values of all flows, then the rates of all states, then the values
    of all prescribed signals. The rate of a state is the time derivative of the state's entry in
    ``store(e)``, the array of stored quantities. By default, ``store(e)`` contains the states
    themselves. The flow with the index ``storing_flow_indices[i]`` also contains the time
    derivative of the entry ``len(states) + i`` of ``store(e)``. A switching state ends when a guard
    function is no longer positive. ``start`` contains the initial displacement [m] and velocity
    [m/s] that belong to the first entry of ``across_inputs``. Without ``start``, the device begins
    at equilibrium.
    """

    name: str
    start: tuple[float, float] | None = None

    @property
    @abstractmethod
    def pins(self) -> tuple[LawPin, ...]:
        """Pins of the device."""

    @property
    @abstractmethod
    def across_inputs(self) -> tuple[AcrossInput, ...]:
        """Inputs of the device: across quantities, such as voltages, and their rates.

        An across quantity is a voltage, displacement, angle, temperature or pressure. Inputs on
        signal pins are the values of the signals.
        """

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Through quantities at the pins, such as forces, currents and heat flows."""
        return ()

    @property
    def storing_flow_indices(self) -> tuple[int, ...]:
        """Indices of the flows that include the time derivative of a stored quantity.

        The stored quantity is, for example, a charge or a momentum.
        """
        return ()

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states of the device."""
        return ()

    @property
    def prescribed_signals(self) -> tuple[str, ...]:
        """Names of the signal pins whose values the device sets."""
        return ()

    @property
    def state_scales(self) -> tuple[float, ...]:
        """Typical magnitude of each state, which scales its integration error.

        The error of a state is divided by its typical magnitude, by default 1e-3 in SI units.
        """
        return (1e-3,) * len(self.states)

    @property
    def is_affine(self) -> bool:
        """Whether the outputs are affine functions of the inputs in each switching state."""
        return False

    @property
    def is_linear(self) -> bool:
        """Whether the device is linear: no switching, and affine outputs and storage.

        The energy and the loss of a linear device are quadratic functions of its inputs.
        """
        return False

    @property
    def has_stored_quantities(self) -> bool:
        """Whether the device stores quantities other than its states, such as charges."""
        return type(self).evaluate_storage is not Device.evaluate_storage and bool(
            self.states or self.storing_flow_indices
        )

    @abstractmethod
    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the outputs (k,) and their derivatives (k, m) with respect to the inputs."""

    def evaluate_storage(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the stored quantities and their derivatives with respect to the inputs.

        The number of stored quantities is ``len(states) + len(storing_flow_indices)``.
        """
        k, m = len(self.states), len(e)
        return e[m - k :], np.eye(k, m, m - k)

    def evaluate_outputs(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return the outputs (k,) of the device without their derivatives."""
        return self.evaluate(e, mode)[0]

    def evaluate_stored_quantities(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Return the stored quantities of the device without their derivatives."""
        return self.evaluate_storage(e, mode)[0]

    def small_signal_derivatives(
        self, s: complex, e: np.ndarray, mode: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the derivatives of outputs and storage for small signals ``exp(s t)``.

        The first returned array (k, m) contains the derivatives of the k outputs with respect to
        the m inputs. The second array contains the derivatives of the stored quantities, with one
        row for each stored quantity. All derivatives are evaluated at the inputs ``e`` of the
        operating point. The derivatives are complex if they depend on the frequency.
        """
        return self.evaluate(e, mode)[1], self.evaluate_storage(e, mode)[1]

    def compute_noise_weights(
        self, s: complex, e: np.ndarray, mode: Any
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Compute how strongly each noise source acts on outputs and stored quantities.

        The first returned array has one row for each output, and the second array one row for each
        stored quantity. The columns correspond to the noise sources. The noise density is ``4 k T``
        times the squared weight, with Boltzmann's constant ``k``. The result is None for a device
        without noise.
        """
        return None

    def find_initial_mode(self, e: np.ndarray) -> Any:
        """Find the initial mode of a device, which selects the equations that it obeys."""
        return None

    def evaluate_guards(self, e: np.ndarray, mode: Any) -> np.ndarray:
        """Evaluate the guard functions; each one is positive until the device switches."""
        return np.empty(0)

    def find_next_mode(self, mode: Any, guard: int) -> Any:
        """Find the next mode of a device: the switching state into which it switches.

        ``mode`` is the present switching state. ``guard`` is the index of the guard function that
        has fallen to zero.
        """
        return mode

    def limit_change(self, e: np.ndarray, last: np.ndarray) -> np.ndarray:
        """Limit the change of the inputs in a Newton step, and return the new inputs.

        ``e`` contains the inputs of the new iterate, and ``last`` the inputs of the last
        linearisation. Laws with exponential functions limit the change from ``last`` to ``e``, so
        that the functions do not overflow.
        """
        return e

    def require_in_range(self, t: float, e: np.ndarray) -> None:  # noqa: B027 (most laws have no limits)
        """Raise SimulationError if an input is outside of the range of the law.

        ``t`` [s] is the time of the inputs ``e``.
        """

    def energy(self, e: np.ndarray, mode: Any) -> float:
        """Compute the energy [J] that the device stores."""
        return 0.0

    def loss(self, e: np.ndarray, mode: Any) -> float:
        """Compute the power [W] that the device dissipates; supplied power is negative."""
        return 0.0

    @property
    def energy_forms(self) -> tuple[np.ndarray, np.ndarray] | None:
        """Matrices of the quadratic forms for energy and loss of a linear device.

        Large devices define these matrices instead of the methods ``energy`` and ``loss``.
        """
        return None


Law = SecondOrderBody | IdealSource | Device

MICRO = 1e-6  # m, unit of displacement in the scaled equations
# The response to loads that grow exponentially at this rate [1/s] replaces the static response of
# an unsupported body.
GROWTH_RATE = 1e3


@dataclass(frozen=True, eq=False)
class Relation:
    """Affine relation ``y = H a + free`` between the loads and the outputs of a body.

    The array ``a`` has the shape (inputs,), and the array ``y`` has the shape (outputs,). A
    relation describes a linear body in static equilibrium, at one frequency, or within one stage of
    an implicit time step. In a time step, ``free`` contains the outputs that the earlier motion of
    the body causes.
    """

    H: np.ndarray
    free: np.ndarray


@dataclass(frozen=True, eq=False)
class PortBody(Device):
    """Linear body of any size, represented by a relation between its port quantities.

    The methods of a port body receive a :class:`Relation` as their argument ``mode``. The vector
    ``a`` contains the loads: forces [N], voltages [V], accelerations [m/s^2] and signals, in the
    order of the ports with a column of B. The vector ``y`` contains the outputs: displacements [m],
    charges [C] and signals, in the order of the rows of C. The forces and the currents i are
    unknowns of the device. For each force, one equation states that the displacement at the pin
    equals the output ``y(a)``. For each current i, the equation is ``dq(a)/dt = i`` with the charge
    q.

    The method ``transfer(s)`` of the model's ``pencil`` computes the relation at the complex
    frequency s, and with s = 0 the static relation. For each stage of a time step, the integrator
    computes the relation between loads and outputs. ``responses`` contains all computed matrices
    ``H(s)``, keyed by ``s``.
    """

    name: str
    model: Any
    ports: tuple[LawPort, ...]
    responses: dict[complex, np.ndarray] = field(default_factory=dict)

    @cached_property
    def _load_ports(self) -> tuple[LawPort, ...]:
        """Ports at which a load such as a force can act: all ports except pure outputs."""
        return tuple(port for port in self.ports if port.kind != "output")

    @cached_property
    def _flow_ports(self) -> tuple[LawPort, ...]:
        """Ports whose through quantity is an unknown of the device."""
        return tuple(p for p in self.ports if p.kind in (*POTENTIALS, *MECHANICAL))

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins of all ports, including return pins."""
        return make_port_pins(self.ports)

    @property
    def across_inputs(self) -> tuple[AcrossInput, ...]:
        """Inputs of the device: across quantities at the ports, such as voltages."""
        return tuple(AcrossInput(port.name, port.ret) for port in self._load_ports)

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Through quantities at the pins, such as forces, currents and heat flows."""
        return tuple(Flow(port.name, port.ret) for port in self._flow_ports)

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states: the through quantities of ports, such as currents."""
        return tuple(f"{port.name}.through" for port in self._flow_ports)

    @property
    def prescribed_signals(self) -> tuple[str, ...]:
        """Names of the signal pins whose values the device sets."""
        return tuple(port.name for port in self.ports if port.kind == "output")

    @cached_property
    def _port_matrices(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Matrices that map device inputs to loads, and body outputs to device outputs.

        The matrices are ``load``, ``stored``, ``direct`` and ``output``, in this order. For the
        inputs e of the device and the outputs y of the body, the loads are ``load @ e`` and the
        charges ``stored @ y``. The outputs of the device are ``direct @ e + output @ y``.
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
        """Compute the loads on the body's model from the inputs of the device."""
        return self._port_matrices[0] @ e

    @cached_property
    def static_relation(self) -> Relation:
        """Relation between the loads and the outputs of the body in static equilibrium.

        Scenes with a constant load on an unsupported body are rejected. Without a constant load,
        all loads in static equilibrium are zero, so an unsupported body stays at rest for any
        finite matrix H. The static relation of an unsupported body is the response to loads that
        grow exponentially with the rate :data:`GROWTH_RATE`.
        """
        try:
            H = self.transfer(0.0)
        except SimulationError:
            H = self.responses[0.0] = self.transfer(GROWTH_RATE)
        return Relation(H.real, np.zeros(len(H)))

    def transfer(self, s: complex) -> np.ndarray:
        """Return the transfer matrix ``H(s)`` of the body, of shape (outputs, inputs).

        The matrix is computed only once for all copies of a body.
        """
        if s not in self.responses:
            self.responses[s] = self.model.pencil.transfer(np.array([s]))[0]
        return self.responses[s]

    def find_initial_mode(self, e: np.ndarray) -> Relation:
        """Find the initial mode of a device, which selects the equations that it obeys.

        A body has no switching state, so its initial mode is the static relation between its loads
        and its outputs.
        """
        return self.static_relation

    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the outputs of the body and their derivatives with respect to the inputs."""
        slope = self._compute_slope(mode.H)
        return slope @ e + self._port_matrices[3] @ mode.free, slope

    def _compute_slope(self, H: np.ndarray) -> np.ndarray:
        """Compute the derivatives of the device outputs with respect to its inputs."""
        load, _, direct, output = self._port_matrices
        return direct + output @ H @ load

    def evaluate_storage(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the body's stored charges, and their derivatives with respect to inputs."""
        load, stored, _, _ = self._port_matrices
        slope = stored @ mode.H @ load
        return slope @ e + stored @ mode.free, slope

    def small_signal_derivatives(
        self, s: complex, e: np.ndarray, mode: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return small-signal derivatives of outputs and charges with respect to inputs.

        The derivatives are values at the complex frequency ``s``.
        """
        load, stored, _, _ = self._port_matrices
        H = self.transfer(s) if s else self.static_relation.H
        return self._compute_slope(H), stored @ H @ load

    def compute_noise_weights(
        self, s: complex, e: np.ndarray, mode: Any
    ) -> tuple[np.ndarray, np.ndarray] | None:
        """Compute how strongly each thermal noise source acts on the outputs of the body.

        The noise density of the outputs is ``4 k T (Y + Y^H) / (2 |s|^2)`` with ``Y = s H(s)``. The
        admittance Y relates the rates of the outputs to the loads. The product of a load and the
        rate of its output is a power.
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
    """Linear system ``E x' = A x + B u``, ``y = C x + D u`` whose outputs are signals.

    The inputs u are across quantities, and the outputs y are signals.
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

    is_linear = True

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins of the inputs and outputs of the block."""
        kinds = dict.fromkeys(self.inputs, self.kind) | dict.fromkeys(self.outputs, "signal")
        return tuple(LawPin(*pin) for pin in kinds.items())

    @property
    def across_inputs(self) -> tuple[AcrossInput, ...]:
        """Inputs of the block: across quantities, such as voltages."""
        return tuple(map(AcrossInput, self.inputs))

    @property
    def states(self) -> tuple[str, ...]:
        """Names of the states of the device."""
        return tuple(map("x{}".format, range(len(self.A))))

    @property
    def state_scales(self) -> tuple[float, ...]:
        """Typical magnitude of each state, which scales its integration error."""
        return (1.0,) * len(self.A)

    @property
    def prescribed_signals(self) -> tuple[str, ...]:
        """Names of the signal pins whose values the device sets."""
        return self.outputs

    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the rates ``A x + B u`` and the outputs of the block, with derivatives."""
        slope = np.block([[self.B, self.A], [self.D, self.C]])
        return slope @ e, slope

    def evaluate_storage(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the stored quantities ``E x`` of the block, and their derivatives."""
        slope = np.hstack([0.0 * self.B, self.E])
        return slope @ e, slope


def make_sensor_block(name: str, gain: float, kind: str) -> SignalBlock:
    """Make a sensor block, whose output signal is ``gain`` times an across quantity.

    The pin ``a`` has the across quantity, and the pin ``out`` the signal.
    """
    none, column = np.zeros((0, 0)), np.zeros((0, 1))
    D = np.array([[gain]])
    return SignalBlock(name, none, none, column, column.T, D, ("a",), ("out",), kind)
