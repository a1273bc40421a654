"""Python controller in the loop: a program holds the tip of a bimorph against a load."""

import kc2spice as kc


class External(kc.PartType):
    """A source whose volts come from Python."""

    name, title, schema = "external", "voltage from Python", kc.Section

    def pins(self, part, scene):
        return (kc.Terminal("out", "V", "A", required=True), kc.Terminal("ret", "V", "A", "gnd"))

    def cards(self, part, build):
        return (f"V{part.name} {build.net(part, 'out')} {build.net(part, 'ret')} EXTERNAL",)


kc.register_part(External())
layer = {"material": "PZT-5A", "thickness": "0.3 mm"}
deck = kc.deck({
    "name": "held_tip",
    "beam": {"part": "bimorph", "length": "30 mm", "width": "5 mm", "layers": [layer, layer],
             "wiring": "parallel", "damping": {"quality": 10}, "pins": {"anode": "drive.out"}},
    "drive": {"part": "external"},
    "load": {"part": "source", "kind": "force", "pins": {"out": "beam.tip"},
             "pulse": {"high": "10 mN", "start": "2 ms", "width": "1 s", "edge": "0.1 ms"}},
    "analysis": {"type": "transient", "stop": "60 ms"},
    "solver": {"max_step": "20 us"},
})  # fmt: skip


class Integrator:
    """Volts that grow against the displacement of the tip, the node ``beam_tip`` [um]."""

    def __init__(self, gain):
        self.gain, self.volts = gain, 0.0

    def __call__(self, time, values):
        self.volts -= self.gain * values["beam_tip"]
        return {"vdrive": self.volts}


free = kc.simulate(deck, control=Integrator(0.0), period=50e-6)
held = kc.simulate(deck, control=Integrator(0.005), period=50e-6, delay=5e-6)
free_tip, held_tip = (result.waves["beam.u.tip"][-1] for result in (free, held))
print(f"tip under 10 mN: {free_tip * 1e6:.2f} um free, {held_tip * 1e6:.3f} um held")
assert abs(held_tip) < 0.05 * abs(free_tip)
