"""Radiation impedances as networks, for pistons and for a pulsating sphere.

The radiation impedance is the pressure on a surface divided by the volume velocity of the surface.
The surface has the radius a and the area S; k is the wave number, rho the density, and c the speed
of sound. The radiation impedances of three shapes are:

    piston in a baffle   (rho c / S) * (1 - J1(2 k a) / (k a) + j H1(2 k a) / (k a))
    open end of a tube   (rho c / S) * (1 + R) / (1 - R)
    pulsating sphere     (rho c / S) * j k a / (1 + j k a)

The impedance of the pulsating sphere is a resistance parallel to a mass. R is the reflection
coefficient of Levine and Schwinger. J1 is the Bessel and H1 the Struve function (L. E. Kinsler et
al., Fundamentals of Acoustics, 4th ed., sections 7.4 and 7.5; H. Levine and J. Schwinger, Phys.
Rev. 73 (1948) 383).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal

from kc2spice.parts.acoustics._acoustic_part import COMPLIANCE, MASS, RESISTANCE, AcousticElement
from kc2spice.parts.acoustics._network_sections import NetworkSection, RadiationNetwork
from kc2spice.parts.acoustics._radiation_networks import BAFFLED_PISTON, FREE_PISTON

Shape = Literal["baffled_piston", "free_piston", "sphere"]
SPHERE = RadiationNetwork((NetworkSection(1.0, 1.0),), math.inf, 0.0, 0.0)


@dataclass(frozen=True)
class Radiator:
    """Radiator: radiation network, area, and solid angle into which it radiates.

    ``network`` approximates the radiation impedance. ``area`` is the surface area divided by the
    squared radius. ``solid_angle`` is 2 pi if a baffle confines the sound to a half-space. Without
    a baffle, ``solid_angle`` is 4 pi.
    """

    words: str
    network: RadiationNetwork
    area: float
    solid_angle: float

    @property
    def error_text(self) -> str:
        """Text that lists the network's approximation errors and their range of ``k a``."""
        if math.isinf(self.network.largest_ka):
            return "exact at all frequencies"
        return (
            f"up to k a = {self.network.largest_ka:g} at most "
            f"{100 * self.network.impedance_error:.2g} % error of the impedance and "
            f"{100 * self.network.power_error:.2g} % of the radiated power"
        )

    def largest_frequency(self, radius: float, sound_speed: float) -> float:
        """Return the frequency [Hz] up to which the network's stated errors apply."""
        return self.network.largest_ka * sound_speed / (2 * math.pi * radius)


RADIATORS: Mapping[Shape, Radiator] = {
    "baffled_piston": Radiator(
        "circular piston in an infinite baffle", BAFFLED_PISTON, math.pi, 2 * math.pi
    ),
    "free_piston": Radiator(
        "circular piston in the open end of a tube", FREE_PISTON, math.pi, 4 * math.pi
    ),
    "sphere": Radiator("pulsating sphere", SPHERE, 4 * math.pi, 4 * math.pi),
}


def list_elements(network: RadiationNetwork, first: str, last: str) -> Iterator[AcousticElement]:
    """Yield the elements of a radiation network between two nodes.

    The element values are expressions of ``impedance`` = rho c / S and ``rate`` = c / a; the
    sections are in series.
    """
    count = len(network.sections)
    nodes = [first, *map("n{}".format, range(1, count)), last]
    for k, section in enumerate(network.sections):
        start, end, (r, w, b) = nodes[k], nodes[k + 1], section
        yield AcousticElement(RESISTANCE, f"r{k + 1}", start, end, f"{r:.12g}*impedance")
        # The relative bandwidth b of a resonator with the resonance frequency w is 1 / (w R C).
        # The resonance frequency of a resonator is w = 1 / sqrt(L C).
        mass = r * b / w if b else r / w
        yield AcousticElement(MASS, f"m{k + 1}", start, end, f"{mass:.12g}*impedance/rate")
        if b:
            compliance = 1 / (r * b * w)
            value = f"{compliance:.12g}/(impedance*rate)"
            yield AcousticElement(COMPLIANCE, f"c{k + 1}", start, end, value)
