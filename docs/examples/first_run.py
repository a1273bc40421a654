"""First run: the kick-and-catch actuator with its electronics, in ngspice."""

import kc2spice as kc

result = kc.run("kick_and_catch")
print(result)

launch = result.metrics["launch_velocity_m_s"]
assert result.metrics["caught"]
print(f"The sphere leaves at {launch:.3f} m/s and is held {result.waves['sphere.y'][-1] * 1e3:.2f}"
      " mm above the chip.")  # fmt: skip

weaker = kc.run(kc.load_scene("kick_and_catch", {"kick.drive.voltage": "80 V"}))
assert weaker.metrics["launch_velocity_m_s"] < launch

result.plot("sphere.y", "sphere.v").savefig("first_run.png")
result.save("kick_and_catch")  # deck, libraries, waveforms, report
