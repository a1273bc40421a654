"""Let rigid and elastic spheres of 2 mm diameter strike the chip at 1 m/s."""

from tables import percent, print_table

import kc2spice as kc


def row(material: str) -> list[str]:
    """Depth, rebound velocity and duration of the impact: rigid, elastic and their difference."""
    keys = {"contact.shape": "pressure", "sphere.material": material}
    rigid = kc.run("impact", overrides=keys).metrics
    elastic = kc.run("impact", overrides=keys | {"sphere.elastic": True}).metrics
    cells = [material]
    for name, factor in (("min_position_m", 1e6), ("rebound_velocity_m_s", 1.0)):
        before, after = factor * rigid[name], factor * elastic[name]
        cells += [f"{before:#.4g}", f"{after:#.4g} ({percent(after, before)} %)"]
    return cells


if __name__ == "__main__":
    head = ["sphere", "depth, rigid [µm]", "depth, elastic", "rebound, rigid [m/s]"]
    print_table([*head, "rebound, elastic"], map(row, ("steel", "tungsten carbide")))
