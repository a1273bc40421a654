"""The motion of a whole body from the port waveforms of a run.

A run knows what the ports did. The body's own motion under these inputs follows from a projection
of the full model on a Krylov basis V, whose modes are integrated exactly for inputs that are
linear between samples: whatever simulator made the waveforms, z = V x is the full model's answer.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from kc2spice.bodies.device import Device
from kc2spice.core.errors import UsageError
from kc2spice.rom.krylov import block_arnoldi
from kc2spice.rom.march import resonant

ORDER = 40
STILL = 1e-6  # of the highest frequency: a motion without stiffness
SLOWEST = 1e-4  # angle over the whole run of a mode that is free to move


@dataclass(frozen=True)
class Motion:
    """Displacements ``z(t) = basis @ states[t]`` and ``voltages`` (times, electrical ports)."""

    device: Device
    time: np.ndarray
    inputs: np.ndarray
    basis: np.ndarray
    states: np.ndarray

    @property
    def voltages(self) -> np.ndarray:
        """Inputs of the electrical ports (times, e)."""
        return self.inputs[:, _electrical(self.device)]

    @property
    def outputs(self) -> np.ndarray:
        """(times, ports) in SI, to be compared with the run's own."""
        model = self.device.model
        return np.asarray(self.states @ (model.C @ self.basis).T + self.inputs @ model.D.T)

    def at(self, instant: float) -> tuple[np.ndarray, np.ndarray]:
        """Displacements z (n,) and voltages (e,) at the sample nearest to ``instant`` [s]."""
        k = int(np.argmin(np.abs(self.time - instant)))
        return self.basis @ self.states[k], self.voltages[k]


def recover(
    device: Device, time: np.ndarray, inputs: Mapping[str, np.ndarray], *, order: int = ORDER
) -> Motion:
    """The motion of the body under port inputs (by port name, SI, over ``time``); ports that are
    not named get none. It starts at rest under the first values.

    Raises
    ------
    UsageError : a port that the body does not have, or waveforms of another length.
    """
    names = [port.name for port in device.model.ports]
    u = np.zeros((len(time), len(names)))
    for name, wave in inputs.items():
        if name not in names or np.shape(wave) != np.shape(time):
            raise UsageError(
                "not a port waveform of this body",
                where="fields",
                got=f"{name} {np.shape(wave)}",
                expected=f"{len(time)} values of one of {', '.join(names)}",
            )
        u[:, names.index(name)] = wave
    t = np.asarray(time)
    basis, omega, damp = _modes(device, order, float(t[-1] - t[0]))
    states, _ = resonant(omega, damp, t, u @ (basis.T @ device.model.B).T)
    return Motion(device, t, u, basis, states)


def lowest_modes(device: Device, count: int, end: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequencies [Hz] below ``end`` of at most ``count`` modes that the ports excite, electrodes
    shorted, and their displacements (n, modes); motions without stiffness are none of them."""
    basis, omega, _ = _modes(device, ORDER, np.inf)
    kept = np.flatnonzero((omega > STILL * omega.max()) & (omega < 2 * np.pi * end))
    kept = kept[np.argsort(omega[kept])][:count]
    return omega[kept] / (2 * np.pi), basis[:, kept]


def _modes(device: Device, order: int, span: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Mass-normalised modes (n, q) of the projected model, their frequencies [rad/s] and damping
    [1/s] each by itself."""
    model, shift = device.model, device.shift
    solve = model.pencil.pencil_solver(-shift).solve
    V = block_arnoldi(
        lambda v: model.K @ v + shift * (model.M @ v), solve, lambda v: model.M @ v, model.B, order
    )
    K, E, M = model.pencil.project(V).coefficients
    squares, X = eigh(0.5 * (K + K.T), 0.5 * (M + M.T))
    omega = np.sqrt(np.maximum(squares, (SLOWEST / span) ** 2))
    return V @ X, omega, np.einsum("ij,ik,kj->j", X, E, X)


def _electrical(device: Device) -> list[int]:
    return [k for k, port in enumerate(device.model.ports) if port.kind == "electrical"]
