"""Networks for radiation impedances, computed by tools/radiation_networks.py."""

from __future__ import annotations

from kc2spice.parts.acoustics._network_sections import NetworkSection, RadiationNetwork

BAFFLED_PISTON = RadiationNetwork(
    (
        NetworkSection(1.04484, 8.7172),
        NetworkSection(0.202822, 2.92918, 0.775183),
        NetworkSection(0.405611, 1.92511, 1.7535),
        NetworkSection(0.472329, 2.28281, 1.19826),
        NetworkSection(0.401887, 5.76128, 0.624867),
        NetworkSection(0.119282, 12.0521, 0.27251),
        NetworkSection(0.105975, 15.6637, 0.301933),
        NetworkSection(0.213053, 8.96024, 0.403831),
    ),
    largest_ka=15.0,
    impedance_error=0.0016,
    power_error=0.0016,
)
FREE_PISTON = RadiationNetwork(
    (
        NetworkSection(0.00398606, 0.397468),
        NetworkSection(0.889339, 2.56421, 1.24308),
        NetworkSection(0.112845, 3.58372, 0.37436),
        NetworkSection(1.78583, 12.5635, 1.12475),
    ),
    largest_ka=3.8,
    impedance_error=0.0071,
    power_error=0.007,
)
