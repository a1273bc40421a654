"""Networks of normalised elements that approximate a piston's radiation impedance.

The piston has the radius a and the area S. Resistances are relative to rho c / S, and angular
frequencies are relative to c / a. A section without a bandwidth is a resistance parallel to an
inductance; a section with a bandwidth is a parallel resonator.
"""

from __future__ import annotations

from typing import NamedTuple


class NetworkSection(NamedTuple):
    """Section of a radiation network, with a corner or resonance frequency.

    Parameters
    ----------
    resistance : float
        Resistance relative to rho c / S.
    frequency : float
        Corner or resonance frequency, as the product k a.
    bandwidth : float, default 0
        Bandwidth of a resonator relative to its resonance frequency; 0 for a corner frequency.
    """

    resistance: float
    frequency: float
    bandwidth: float = 0.0


class RadiationNetwork(NamedTuple):
    """Series connection of sections that approximates a radiation impedance.

    Parameters
    ----------
    sections : tuple of NetworkSection
        Sections of the network.
    largest_ka : float
        Largest product k a up to which the stated errors are valid.
    impedance_error : float
        Largest relative error of the impedance.
    power_error : float
        Largest relative error of the radiation resistance, and therefore of the radiated power.
    """

    sections: tuple[NetworkSection, ...]
    largest_ka: float
    impedance_error: float
    power_error: float
