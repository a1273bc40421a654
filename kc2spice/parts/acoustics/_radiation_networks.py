"""Networks of radiation impedances, which tools/radiation_networks.py computes.

Resistances are relative to rho c / S, angular frequencies to c / a, with the radius a and the area
S of the piston. A section without bandwidth is a resistance parallel to an inductance; the other
sections are parallel resonators.
"""

from __future__ import annotations

from typing import NamedTuple


class NetworkSection(NamedTuple):
    """Section of a network: resistance, corner or resonance, and relative bandwidth.

    Parameters
    ----------
    resistance : float
        Resistance relative to rho c / S.
    frequency : float
        Corner or resonance frequency, as the product k a.
    bandwidth : float, default 0
        Bandwidth of a resonator relative to its resonance frequency; 0 without a capacitance.
    """

    resistance: float
    frequency: float
    bandwidth: float = 0.0


class RadiationNetwork(NamedTuple):
    """Series connection of sections, with its errors.

    Parameters
    ----------
    sections : tuple of NetworkSection
        Sections of the network.
    largest_ka : float
        Largest product k a for which the errors hold.
    impedance_error : float
        Largest relative error of the impedance.
    power_error : float
        Largest relative error of the resistance, which is the error of the radiated power.
    """

    sections: tuple[NetworkSection, ...]
    largest_ka: float
    impedance_error: float
    power_error: float


BAFFLED_PISTON = RadiationNetwork(
    (
        NetworkSection(0.121976, 1.01782),
        NetworkSection(0.373897, 2.68687, 0.899969),
        NetworkSection(0.270468, 5.72277, 0.513828),
        NetworkSection(0.580562, 1.96848, 1.45942),
        NetworkSection(0.11276, 8.88779, 0.301991),
        NetworkSection(0.943549, 39.9929, 6.04909),
        NetworkSection(0.0450813, 11.9881, 0.129239),
    ),
    largest_ka=15.0,
    impedance_error=0.0063,
    power_error=0.0062,
)
FREE_PISTON = RadiationNetwork(
    (
        NetworkSection(0.00211455, 0.314304),
        NetworkSection(0.875884, 2.57405, 1.25592),
        NetworkSection(0.0863041, 3.57633, 0.341467),
        NetworkSection(1.55627, 21.3661, 2.38268),
    ),
    largest_ka=3.8,
    impedance_error=0.0071,
    power_error=0.0071,
)
