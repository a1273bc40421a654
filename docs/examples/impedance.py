"""Impedance: resonances and the equivalent circuit of a piezo buzzer."""

import numpy as np

import kc2spice as kc

result = kc.run("buzzer_7bb_20_6")  # Murata 7BB-20-6, its sheet says 6.3 kHz and 10 nF
found = result.metrics
print(
    f"resonance {found['resonance_hz']:.0f} Hz, capacitance {found['capacitance_f'] * 1e9:.2f} nF"
)
print("equivalent circuit:", found["bvd"])
assert abs(found["resonance_hz"] / 6300 - 1) < 0.1

result.plot().savefig("impedance.png")

# The same from the full finite-element model, without a simulator: charge per volt is C(f).
model = kc.build("buzzer_7bb_20_6")["disc"].select(["anode"])
print(model)
frequency = np.array([1e3])
capacitance = model.transfer(frequency)[0, 0, 0].real
assert abs(capacitance / found["capacitance_f"] - 1) < 1e-2
