"""Temperatures inside a body during a run, from the heat flows into its ports.

The full model is projected on a Krylov basis. Each mode of the projected model has the equation
``x' + x / t = g q`` with the time constant t and the heat flows q. The equation of a mode is
integrated exactly for heat flows that are linear between samples.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import splu

from kc2spice.bodies.fields import write_nodal_values
from kc2spice.bodies.heat_model import HeatModel
from kc2spice.core.errors import wrong
from kc2spice.rom.reductors.block_krylov import compute_block_krylov_basis

BASIS_SIZE = 40  # number of vectors of the Krylov basis
SEARCH_INSTANTS = 200  # number of instants among which the highest temperature is searched
# Rate that is added to all decay rates, relative to the reciprocal duration of the run.
# The added rate makes the matrix regular for a body that loses no heat.
SLOW_RATE_RATIO = 1e-3


@dataclass(frozen=True, eq=False)
class TemperatureField:
    """Temperature rises at the nodes of a body during a run.

    The temperature rises are ``basis @ states[k]`` at the sample ``time[k]``.
    """

    heat: HeatModel
    time: np.ndarray
    basis: np.ndarray
    states: np.ndarray

    def find_nearest_rises(self, instant: float) -> np.ndarray:
        """Return the nodal temperature rises [K] at the sample nearest to ``instant`` [s].

        The returned array has the shape (nodes,).
        """
        return np.asarray(self.basis @ self.states[int(np.argmin(np.abs(self.time - instant)))])

    def find_hot_spots(self) -> list[HotSpot]:
        """Find the hot spots: each material's highest temperature rise during the run."""
        even = np.linspace(self.time[0], self.time[-1], SEARCH_INSTANTS)
        chosen = np.unique(np.searchsorted(self.time, even))
        values = self.basis @ self.states[chosen].T
        solid, result = self.heat.solid, []
        for number, material in enumerate(solid.materials):
            nodes = solid.geometry.nodes(np.flatnonzero(solid.geometry.owner == number))
            curve = values[nodes].max(axis=0)
            k = int(curve.argmax())
            instant = float(self.time[chosen[k]])
            result.append(
                HotSpot(material.name, float(curve[k]), instant, self.time[chosen], curve)
            )
        return result


@dataclass(frozen=True, eq=False)
class HotSpot:
    """Highest temperature rise of a material.

    The temperature rise ``value`` [K] occurs at the ``instant`` [s]. ``curve`` is the temperature
    rise of the hottest node of the material at the times ``time``.
    """

    material: str
    value: float
    instant: float
    time: np.ndarray
    curve: np.ndarray


def recover_temperatures(
    heat: HeatModel, time: np.ndarray, flows: Mapping[str, np.ndarray]
) -> TemperatureField:
    """Compute the nodal temperature rises due to the heat flows into a body's ports.

    ``flows`` maps names of ports to waveforms of heat flows [W] at the times ``time`` [s]. A body
    with a thermal path to the ambient temperature starts in the steady state under the heat flows
    at ``time[0]``. Any other body starts at the temperature rise zero.

    Raises
    ------
    UsageError : ``flows`` names a port that the body lacks, or ``flows`` does not contain one value
        for each time.
    """
    model, names = heat.model, [port.name for port in heat.model.ports]
    q = np.zeros((len(time), len(names)))
    for name, wave in flows.items():
        if name not in names or np.shape(wave) != np.shape(time):
            raise wrong(
                "fields",
                "this heat flow has a wrong length, or its name is not a port of this body",
                got=f"the heat flow {name} with the shape {np.shape(wave)}",
                expected=f"{len(time)} values for one of the ports {', '.join(names)}",
            )
        q[:, names.index(name)] = wave
    t = np.asarray(time)
    K, E = model.pencil.coefficients
    shift = SLOW_RATE_RATIO / float(t[-1] - t[0])
    shifted = sparse.csc_array(K + shift * E)
    V = compute_block_krylov_basis(
        lambda v: shifted @ v, splu(shifted).solve, lambda v: E @ v, model.B, BASIS_SIZE
    )
    small_E, small_K = (0.5 * (A + A.T) for A in (V.T @ (E @ V), V.T @ (K @ V)))
    times, X = eigh(small_E, small_K + shift * small_E)
    moving = times > np.finfo(float).eps * times.max()
    rates = 1 / np.where(moving, times, 1.0) - shift
    gains = X.T @ (V.T @ model.B)
    states = _integrate_modes(np.maximum(rates, 0.0), moving, times, t, q @ gains.T)
    return TemperatureField(heat, t, heat.temperature @ (V @ X), states)


def _integrate_modes(
    rates: np.ndarray, moving: np.ndarray, times: np.ndarray, t: np.ndarray, loads: np.ndarray
) -> np.ndarray:
    """Integrate the first-order differential equation of each thermal mode over time.

    The state x_k of mode k satisfies the equation
    ``times[k] * (dx_k/dt + rates[k] * x_k) = loads[:, k]``. Return the states x, an array with one
    row for each sample and one column for each mode.
    The loads are linear between samples. In a mode without heat capacity, the state is equal to the
    load.
    """
    result = np.where(moving, 0.0, loads)
    settles = moving & (rates > 0)
    start = np.zeros(len(rates))
    start[settles] = loads[0, settles] / (times * rates)[settles]
    x = np.where(settles, start, 0.0)
    result[0, moving] = x[moving]
    for k, step in enumerate(np.diff(t), 1):
        z = rates * step
        # integrals over one step of e^(-rate s) times a constant load, and times a linear load
        small = z < 1e-4
        safe = np.where(small, 1.0, z)
        decay = np.exp(-z)
        one = np.where(small, 1 - z / 2, -np.expm1(-z) / safe)
        two = np.where(small, 0.5 - z / 6, (1 - one) / safe)
        mean = loads[k - 1] * (one - two) + loads[k] * two
        x = decay * x + step * mean / np.where(moving, times, 1.0)
        result[k, moving] = x[moving]
    return result


def write_temperatures(path: Path, heat: HeatModel, rises: np.ndarray) -> None:
    """Write the nodal temperature rises of a body at one instant to a VTU file.

    ``rises`` [K] has the shape (nodes,).
    """
    geometry = heat.solid.geometry
    nodes = geometry.basis(1).element_dofs.T
    values = {
        "temperature_rise": rises[nodes.ravel()],
        "material": np.repeat(geometry.owner, nodes.shape[1]).astype(float),
    }
    write_nodal_values(path, geometry, values)
