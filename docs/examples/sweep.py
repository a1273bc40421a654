"""Sweep: what the edges of the drive do to the launch of the sphere."""

import kc2spice as kc

scene = kc.load_scene(
    "kick_and_catch",
    # The flight is of no interest here, and a weak kick may fall short of the field table.
    {"solver.stop": "0.6 ms"},
)
table = kc.sweep(scene, {
    "kick.drive.voltage": [60, 100],
    "kick.drive.edge": ["0.1 us", "5 us", "10 us"],
})  # fmt: skip
print(table)
table.save("edges.csv")

speeds = table["launch_velocity_m_s"]
assert table["status"] == ["ok"] * 6
assert speeds[3] > speeds[4] > speeds[5]  # slow edges cost more than a third of the speed
