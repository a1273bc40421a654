"""Run the impact on three meshes of the chip: unknowns, resonances, rebound and depth."""

from tables import print_table

import kc2spice as kc


def row(keys: dict[str, str]) -> list[str]:
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
    meshes = [{"kick.mesh.ring_spacing": f"{spacing} um"} for spacing in (100, 50, 25)]
    print_table([*head, "impact depth [µm]", "rebound [m/s]"], map(row, meshes))
