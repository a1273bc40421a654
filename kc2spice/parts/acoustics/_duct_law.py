"""Equations of an acoustic duct for the integrator that is independent of ngspice.

The duct is a chain of nodes, which are connected by channels. Each node except the pins has a
compliance C to the ambient pressure. A channel has the acoustic mass m, the resistance r and the
volume velocity q. A thermal relaxation at a node has the resistance R, the compliance c and the
inner pressure v::

    m dq/dt = p_start - p_end - r q
    C dp/dt = flows into the node - sum (p - v) / R
    c dv/dt = (p - v) / R
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from kc2spice.core.constitutive_laws import AcrossInput, Device, Flow, LawPin
from kc2spice.core.domains import ACOUSTIC, AMBIENT


@dataclass(frozen=True, eq=False)
class DuctLaw(Device):
    """Linear law of a duct with flow resistances, masses and thermal relaxations.

    ``nodes`` contains the compliance [m3/Pa] of each node; the nodes in ``ends`` are pins. A
    channel in ``channels`` consists of start node, end node, resistance [Pa s/m3] and mass [kg/m4].
    A thermal relaxation in ``walls`` consists of node, resistance [Pa s/m3] and compliance [m3/Pa].
    """

    name: str
    nodes: dict[str, float]
    ends: tuple[str, ...]
    channels: tuple[tuple[str, str, float, float], ...]
    walls: tuple[tuple[str, float, float], ...]

    is_linear = True

    @property
    def pins(self) -> tuple[LawPin, ...]:
        """Pins at the ends of the duct, and the pin of the ambient pressure."""
        kind = ACOUSTIC.pin_kind
        ends = (LawPin(end, kind) for end in self.ends)
        return (*ends, LawPin(AMBIENT, kind, grounded=True))

    @property
    def across_inputs(self) -> tuple[AcrossInput, ...]:
        """Inputs of the device: pressure at each end, relative to the ambient pressure."""
        return tuple(AcrossInput(end, AMBIENT) for end in self.ends)

    @property
    def flows(self) -> tuple[Flow, ...]:
        """Volume velocity into each end of the duct."""
        return tuple(Flow(end, AMBIENT) for end in self.ends)

    @cached_property
    def inner_node_names(self) -> tuple[str, ...]:
        """Names of the inner nodes, which are all nodes except the pins."""
        return tuple(node for node in self.nodes if node not in self.ends)

    @cached_property
    def storing_flow_indices(self) -> tuple[int, ...]:
        """Indices of the flows that include the time derivative of a stored quantity.

        The flow into an end with a compliance includes the rate of the volume that the compliance
        stores.
        """
        return tuple(k for k, end in enumerate(self.ends) if self.nodes[end])

    @cached_property
    def states(self) -> tuple[str, ...]:
        """Names of the states: volume velocities, node pressures, relaxation pressures."""
        flows = map("q{}".format, range(len(self.channels)))
        walls = map("v{}".format, range(len(self.walls)))
        return (*flows, *map("p_{}".format, self.inner_node_names), *walls)

    @property
    def state_scales(self) -> tuple[float, ...]:
        """Typical magnitude of each state, which scales its integration error.

        Integration errors are divided by a typical volume velocity of 1e-9 m3/s or by a typical
        pressure of 1 mPa.
        """
        pressures = len(self.inner_node_names) + len(self.walls)
        return (1e-9,) * len(self.channels) + (1e-3,) * pressures

    @cached_property
    def _storage_coefficients(self) -> np.ndarray:
        """Acoustic mass [kg/m4] or compliance [m3/Pa] that belongs to each state."""
        masses = [mass for *_, mass in self.channels]
        inner = [self.nodes[node] for node in self.inner_node_names]
        return np.array([*masses, *inner, *(size for *_, size in self.walls)])

    @cached_property
    def _pressure_indices(self) -> dict[str, int]:
        """Index of each node's pressure in the vector of end pressures and states."""
        first = len(self.ends) + len(self.channels)
        result = {end: k for k, end in enumerate(self.ends)}
        return result | {node: first + k for k, node in enumerate(self.inner_node_names)}

    @cached_property
    def _pressure_drop_matrix(self) -> np.ndarray:
        """Matrix that maps end pressures and states to pressure drops.

        The matrix has a row for each pressure drop, and a column for each end pressure and each
        state.
        """
        channels, walls = len(self.channels), len(self.walls)
        width = len(self.ends) + self._storage_coefficients.size
        result = np.zeros((channels + walls, width))
        for k, (start, end, _, _) in enumerate(self.channels):
            result[k, self._pressure_indices[start]] += 1.0
            result[k, self._pressure_indices[end]] -= 1.0
        for k, (node, _, _) in enumerate(self.walls):
            result[channels + k, self._pressure_indices[node]] += 1.0
            result[channels + k, width - walls + k] -= 1.0
        return result

    @cached_property
    def _flow_matrix(self) -> np.ndarray:
        """Matrix that maps end pressures and states to volume velocities.

        The matrix has a row for each volume velocity, and a column for each end pressure and each
        state.
        """
        channels, ends = len(self.channels), len(self.ends)
        result = np.zeros(self._pressure_drop_matrix.shape)
        result[:channels, ends : ends + channels] = np.eye(channels)
        resistances = np.array([resistance for _, resistance, _ in self.walls])
        result[channels:] = self._pressure_drop_matrix[channels:] / resistances[:, None]
        return result

    @cached_property
    def _jacobian(self) -> np.ndarray:
        """Jacobian matrix of the end flows and of the state equations."""
        ends, channels = len(self.ends), len(self.channels)
        # The pressure drops are d = G p. With the volume velocities q, the flows into the nodes are
        # -G' q.
        result = -self._pressure_drop_matrix.T @ self._flow_matrix
        result[:ends] *= -1.0  # flows at the ends count positive into the part
        rows = slice(ends, ends + channels)
        result[rows] = self._pressure_drop_matrix[:channels]
        friction = np.array([resistance for *_, resistance, _ in self.channels])
        result[rows, rows] -= np.diag(friction)
        return result

    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the flows into the ends and the right-hand sides of the state equations.

        The second returned value contains the derivatives of the first one with respect to end
        pressures and states.
        """
        return self._jacobian @ e, self._jacobian

    @cached_property
    def _storage_jacobian(self) -> np.ndarray:
        """Jacobian matrix of the stored quantities: pressure impulses and volumes."""
        ends, count = len(self.ends), self._storage_coefficients.size
        result = np.zeros((count + len(self.storing_flow_indices), ends + count))
        result[:count, ends:] = np.diag(self._storage_coefficients)
        for row, k in enumerate(self.storing_flow_indices, count):
            result[row, k] = self.nodes[self.ends[k]]
        return result

    def evaluate_storage(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Return the stored pressure impulses and volumes, and their Jacobian matrix."""
        return self._storage_jacobian @ e, self._storage_jacobian

    @cached_property
    def energy_forms(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the matrices of the stored energy and of the dissipated power.

        Both matrices define quadratic forms of the end pressures and states.
        """
        ends = np.array([self.nodes[end] for end in self.ends])
        stored = np.diag(np.concatenate([ends, self._storage_coefficients]) / 2)
        q = self._flow_matrix
        resistances = [r for *_, r, _ in self.channels] + [r for _, r, _ in self.walls]
        lost = q.T @ (np.array(resistances)[:, None] * q)
        return stored, lost

    def compute_noise_weights(
        self, s: complex, e: np.ndarray, mode: Any
    ) -> tuple[np.ndarray, np.ndarray]:
        """Return the weights of thermal noise from channel friction and from relaxations."""
        ends, channels = len(self.ends), len(self.channels)
        sources = channels + len(self.walls)
        out = np.zeros((ends + self._storage_coefficients.size, sources))
        friction = np.array([resistance for *_, resistance, _ in self.channels])
        out[ends : ends + channels, :channels] = np.diag(np.sqrt(friction))
        roots = np.sqrt([resistance for _, resistance, _ in self.walls])
        flows = -self._pressure_drop_matrix[channels:].T / roots
        flows[:ends] *= -1.0
        out[:, channels:] = flows
        return out, np.zeros(
            (self._storage_coefficients.size + len(self.storing_flow_indices), sources)
        )
