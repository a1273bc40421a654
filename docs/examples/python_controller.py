"""Python controller in the loop: a program holds the tip of a bimorph against a load."""

import kc2spice as kc

layer = {"material": "PZT-5A", "thickness": "0.3 mm"}
scene = kc.load_scene({
    "name": "held_tip",
    "beam": {"part": "bimorph", "length": "30 mm", "width": "5 mm", "layers": [layer, layer],
             "wiring": "parallel", "damping": {"quality": 10}},
    "hold": {"part": "controller", "inputs": ["tip"], "period": "50 us", "delay": "5 us",
             "pins": {"tip": "beam.tip", "out": "beam.anode"}},
    "load": {"part": "source", "kind": "force", "pins": {"out": "beam.tip"},
             "pulse": {"high": "10 mN", "start": "2 ms", "width": "1 s", "edge": "0.1 ms"}},
    "analysis": {"type": "transient", "stop": "60 ms"},
    "solver": {"max_step": "20 us"},
})  # fmt: skip


class Integrator:
    """Volts that grow against the displacement of the tip."""

    def __init__(self, gain):
        self.gain, self.volts = gain, 0.0

    def __call__(self, time, inputs):
        self.volts -= self.gain * inputs["tip"]
        return self.volts


free = kc.run(scene, functions={"hold": Integrator(0.0)})
held = kc.run(scene, functions={"hold": Integrator(5e3)})
free_tip, held_tip = (result.waves["beam.u.tip"][-1] for result in (free, held))
print(f"tip under 10 mN: {free_tip * 1e6:.2f} um free, {held_tip * 1e6:.3f} um held")
assert abs(held_tip) < 0.05 * abs(free_tip)
