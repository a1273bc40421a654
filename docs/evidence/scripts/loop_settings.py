"""Run kick_and_catch with faster settings: time points, and changes of launch and height."""

from typing import Any

from tables import power, print_table

import kc2spice as kc

SETTINGS: dict[str, dict[str, Any]] = {
    "as shipped": {},
    "lumped contact ports": {"contact.inertia": "lumped"},
    "modes ring coarsely after the launch": {"solver.ringing": "coarse"},
    "no amplifiers in the controller": {"control.form": "ideal"},
    "steps of up to 15 µs": {"solver.max_step": "15 us"},
    "solver.reltol = 1e-3": {"solver.reltol": 1e-3},
}
FINE = {"solver.reltol": 1e-6}


def row(name: str, reference: float) -> list[str]:
    """Time points and error of the launch with one setting."""
    result = kc.run("kick_and_catch", overrides=SETTINGS[name])
    error = abs(result.metrics["launch_velocity_m_s"] / reference - 1)
    record = result.record
    points = f"{record['steps']['accepted'] / 1e3:.1f}"
    keys = " ".join(f"`{key} = {value}`" for key, value in SETTINGS[name].items())
    return [name, keys, power(error), points, f"{record['simulator_cpu_s']:.2f}"]


if __name__ == "__main__":
    reference = kc.run("kick_and_catch", overrides=FINE).metrics["launch_velocity_m_s"]
    head = ["setting", "keys", "error of the launch", "time points [1000]", "CPU of ngspice [s]"]
    print_table(head, (row(name, reference) for name in SETTINGS))
