"""Fit: the thickness of a buzzer's brass and its losses, by its measured impedance."""

from pathlib import Path

import numpy as np

import kc2spice as kc

# What an analyser would have written; here another buzzer's model, and 1 % of noise.
scene = kc.load_scene("buzzer_7bb_20_3")
true = {"disc.layers[0].thickness": 0.105e-3, "disc.damping.quality": 45.0}
model = kc.build(kc.load_scene(scene, true))["disc"].select(["anode"])
f = np.linspace(2e3, 6e3, 120)
noise = 1 + 0.01 * np.random.default_rng(1).normal(size=(2, f.size))
Z = 1 / (2j * np.pi * f * model.transfer(f)[:, 0, 0])
rows = np.column_stack([f, Z.real * noise[0], Z.imag * noise[1]])
np.savetxt("part.csv", rows, delimiter=",", header="frequency_hz,real_ohm,imag_ohm", comments="")

vary = {"layers[0].thickness": (80e-6, 130e-6), "damping.quality": (10.0, 200.0)}
found = kc.fit(scene, "disc", Path("part.csv"), vary, out=Path("fitted"))
for key, each in found["parameters"].items():
    print(f"{key} = {each['value']:.5g} +- {each['sigma']:.2g}")
print(found["page"])
fitted = kc.load_scene(scene, [found["overrides"]])  # run, sweep and export take it by --set too

assert found["identifiable"]
assert abs(fitted.get_part("disc").keys.layers[0].thickness / 0.105e-3 - 1) < 0.01
