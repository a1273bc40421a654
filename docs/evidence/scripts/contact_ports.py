"""Compare contact rings with pressure functions: static force, impact and launch of the chip."""

from collections.abc import Iterator

from tables import percent, print_table

import kc2spice as kc

RINGS = {"kick.mesh.ring_spacing": "50 um", "contact.rings": 3}
FORMS = {
    "rings, 50 µm, lumped": RINGS | {"contact.inertia": "lumped"},
    "rings, 50 µm, massless": RINGS | {"contact.inertia": "massless"},
    "pressure, 20 µm": {"contact.shape": "pressure", "contact.spacing": "20 um"},
    "pressure, 10 µm": {"contact.shape": "pressure", "contact.spacing": "10 um"},
    "pressure, 5 µm": {"contact.shape": "pressure", "contact.spacing": "5 um"},
}
KICK = {
    "name": "kick",
    "kick": {"drive": {"voltage": "100 V", "start": "1 us"}},
    "contact": {},
    "sphere": {},
    "rom": {"order": 30},
    "solver": {"stop": "15 us"},
}


def measure(form: dict[str, str]) -> list[float]:
    """Static force [N], depth of the impact [um], rebound and launch velocity [m/s]."""
    fine = form | {"solver.reltol": 1e-6}
    force = kc.run("imprint", overrides=form | {"imprint.depth": "5 um", "imprint.steps": 10})
    impact = kc.run("impact", overrides=fine).metrics
    launch = kc.run(KICK, overrides=fine).metrics["launch_velocity_m_s"]
    depth = 1e6 * impact["min_position_m"]
    return [force.metrics["max_force_n"], depth, impact["rebound_velocity_m_s"], launch]


def rows() -> Iterator[list[str]]:
    """One row for each form, with its differences from the finest one."""
    values = {name: measure(form) for name, form in FORMS.items()}
    finest = values["pressure, 5 µm"]
    for name, row in values.items():
        pairs = zip(row, finest, strict=True)
        yield [name, *(f"{x:#.4g} ({percent(x, reference)} %)" for x, reference in pairs)]


if __name__ == "__main__":
    head = ["contact ports", "force at 5 µm [N]", "impact depth [µm]", "rebound [m/s]"]
    print_table([*head, "launch [m/s]"], rows())
