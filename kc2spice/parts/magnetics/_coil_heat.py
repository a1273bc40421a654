"""Heat in the wire of two coils.

The module computes the heat balance, the temperature rise and the metrics of a run.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import numpy as np

from kc2spice.core.domains import HEAT
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.thermal_materials import find_resistance_coefficient
from kc2spice.physics.conductors import ConductorKeys, get_temperature_coefficient
from kc2spice.physics.declaration import (
    COEFFICIENT,
    REFERENCE,
    TEMPERATURE,
    write_resistance_ratio,
)
from kc2spice.physics.symbolic_algebra import evaluate_tree, parse_simplified
from kc2spice.scene.checks import Check, Metric, RunEnergyBalance

# largest permitted error of the heat due to the time steps, relative to the heat
_UNEXPLAINED = 1e-3


def get_wire_coefficients(keys: ConductorKeys) -> tuple[float, float]:
    """Return temperature coefficient [1/K] and reference temperature [K] of the wire."""
    coefficient, reference = get_temperature_coefficient(keys)
    return find_resistance_coefficient("copper") if coefficient is None else coefficient, reference


def compute_resistance_ratio(keys: ConductorKeys, temperature: np.ndarray) -> np.ndarray:
    """Return the wire's resistance, divided by its value at the reference temperature.

    ``temperature`` [K] is the temperature above the ambient temperature.
    """
    coefficient, reference = get_wire_coefficients(keys)
    values = {TEMPERATURE: temperature, COEFFICIENT: coefficient, REFERENCE: reference}
    return np.asarray(evaluate_tree(parse_simplified(write_resistance_ratio()), values))


def check_heat_balance(
    keys: ConductorKeys,
    prefix: str,
    resistance: Mapping[str, float],
    currents: Mapping[str, np.ndarray],
    waves: Waveforms,
) -> Iterator[RunEnergyBalance]:
    """Yield the check that all heat of the wire flows out of the pin ``heat``.

    Parameters
    ----------
    keys : ConductorKeys
        Temperature coefficient and reference temperature of the wire.
    prefix : str
        Prefix of the names of the coil results.
    resistance : mapping of str to float
        Resistance of each coil at the reference temperature [Ohm].
    currents : mapping of str to numpy.ndarray
        Current of each coil [A] versus time.
    waves : Waveforms
        Results of a transient.
    """
    if f"{prefix}.{HEAT}" not in waves or not currents:
        return
    power = np.zeros_like(waves["time"])
    for coil, current in currents.items():
        power += resistance[coil] * current**2
    power *= compute_resistance_ratio(keys, waves[f"{prefix}.{TEMPERATURE}"])
    step, flow = np.diff(waves["time"]), -waves[f"{prefix}.{HEAT}"]
    dissipated, left = ((wave[1:] + wave[:-1]) / 2 * step for wave in (power, flow))
    missing = float(np.abs(np.cumsum(dissipated - left)).max(initial=0.0))
    entries = {
        "dissipated in the wire": float(dissipated.sum()),
        f"delivered as heat at the pin {HEAT}": float(left.sum()),
    }
    yield RunEnergyBalance(entries, missing, float(dissipated.sum()), _UNEXPLAINED)


def check_temperature(
    name: str, prefix: str, rated_rise: float, waves: Waveforms
) -> Iterator[Check]:
    """Yield the check that the wire's temperature rise is within ``rated_rise`` [K]."""
    if f"{prefix}.{TEMPERATURE}" in waves:
        largest = float(waves[f"{prefix}.{TEMPERATURE}"].max())
        advice = "the coils overheat: use less current, or cool the coils better"
        yield Check(
            f"temperature rise of {name}", max(largest, 0.0), rated_rise, "K", advice, "warn"
        )


def compute_heat_metrics(keys: ConductorKeys, prefix: str, waves: Waveforms) -> dict[str, Metric]:
    """Return the metrics of heated coils: temperature rise, heat and resistance.

    Return no metrics if the temperature was not recorded.
    """
    if f"{prefix}.{TEMPERATURE}" not in waves or "time" not in waves:
        return {}
    rise = waves[f"{prefix}.{TEMPERATURE}"]
    heat = -float(np.trapezoid(waves[f"{prefix}.{HEAT}"], waves["time"]))
    return {
        "coil_temperature_rise_k": Metric(float(rise.max()), "K"),
        "coil_heat_j": Metric(heat, "J"),
        "coil_resistance_ratio": Metric(float(compute_resistance_ratio(keys, rise).max())),
    }
