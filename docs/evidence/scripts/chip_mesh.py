"""Run the impact on three meshes of the chip: unknowns, resonances, rebound and depth."""

from typing import Any

from tables import print_table

import kc2spice as kc


def row(keys: dict[str, Any]) -> list[str]:
    """One mesh."""
    result = kc.run("impact", overrides=keys | {"contact.rings": "all"})
    chip, metrics = result.record["model"]["kick"], result.metrics
    resonances = (chip["resonance_short_hz"], chip["resonance_open_hz"])
    return [
        keys["kick.mesh.ring_spacing"].replace("um", "µm"),
        str(chip["unknowns"]),
        " / ".join(f"{1e-3 * f:.1f}" for f in resonances),
        f"{1e6 * metrics['min_position_m']:.3f}",
        f"{metrics['rebound_velocity_m_s']:.4f}",
    ]


if __name__ == "__main__":
    head = ["spacing of rings", "unknowns", "resonance, short / open [kHz]"]
    sizes = ((100, 3), (50, 5), (25, 10))  # um between the rings, and their number
    meshes = [{"kick.mesh.ring_spacing": f"{d} um", "kick.mesh.rings": n} for d, n in sizes]
    print_table([*head, "impact depth [µm]", "rebound [m/s]"], map(row, meshes))
