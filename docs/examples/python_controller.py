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
             "wiring": "parallel", "damping": {"quality": 30}, "pins": {"anode": "drive.out"}},
    "drive": {"part": "external"},
    "load": {"part": "source", "kind": "force", "pins": {"out": "beam.tip"},
             "pulse": {"high": "10 mN", "start": "2 ms", "width": "1 s", "edge": "0.1 ms"}},
    "analysis": {"type": "transient", "stop": "40 ms"},
    "solver": {"max_step": "20 us"},
})  # fmt: skip
volts = 0.0


def control(time, values):
    """Integrate the tip's displacement, which ngspice knows as ``beam_tip`` in um."""
    global volts
    volts += GAIN * values["beam_tip"]
    return {"vdrive": volts}


GAIN = 0.0
free = kc.simulate(deck, control=control, period=50e-6, delay=5e-6)
gain = kc.build(deck.scene) if False else None
