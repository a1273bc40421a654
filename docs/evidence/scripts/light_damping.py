"""Kick a sphere at two damping ratios of the chip, with and without inertia at its ports."""

from contact_ports import KICK
from tables import print_table

import kc2spice as kc


def row(damping: str, inertia: str) -> list[str]:
    """States, time points and launch velocity of one kick, or the check that it fails."""
    keys = {"kick.damping.ratio": damping, "contact.inertia": inertia, "rom.order": 120}
    try:
        result = kc.run(KICK, overrides=keys)
    except kc.errors.SimulationError as error:
        return [damping, inertia, "", "", error.message]
    steps = result.record["steps"]["accepted"]
    launch = result.metrics["launch_velocity_m_s"]
    states = str(result.record["rom"]["order"])
    return [damping, inertia, states, f"{steps / 1e3:.1f}", f"{launch:#.4g}"]


if __name__ == "__main__":
    print_table(
        ["damping ratio", "contact ports", "states", "time points [1000]", "launch [m/s]"],
        (row(d, i) for d in ("1 %", "0.1 %") for i in ("lumped", "massless")),
    )
