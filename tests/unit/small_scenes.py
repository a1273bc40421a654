"""Small scenes that several test files change: texts for mistakes in a file, and tables."""

# a battery and its load, without and with a probe
RESISTOR = """[battery]
part = "source"
dc = "10 V"
[load]
part = "resistor"
resistance = "1 kOhm"
pins = { a = "battery.out" }
[analysis]
type = "op"
"""
DIVIDER = RESISTOR + '[probes.current]\nof = "load.i"\n'
LAMP = {
    "name": "lamp",
    "drive": {"part": "source", "dc": "12 V"},
    "lamp": {"part": "resistor", "resistance": "6 Ohm", "pins": {"a": "drive.out"}},
    "analysis": {"type": "op"},
    "probes": {"current_a": {"of": "lamp.i"}},
}
# a disc of brass and ceramic without an analysis; a further line is a key of the ceramic layer
DISC = """[disc]
part = "disc"
[[disc.layers]]
material = "brass"
diameter = "20 mm"
thickness = "0.2 mm"
[[disc.layers]]
material = "PZT-5A"
diameter = "14 mm"
thickness = "0.2 mm"
"""
# netlist file of a user: a divider of two resistors
AMPLIFIER = "* amp\n.subckt amp in out ref\nR1 in out 1k\nR2 out ref 1k\n.ends\n"
SPEAKER = {
    "amp": {"part": "source", "ac": "2 V"},
    "woofer": {
        "part": "loudspeaker",
        "fs": "37 Hz",
        "re": "6 Ohm",
        "qms": 5.6,
        "mms": "109.5 g",
        "bl": "25.6 N/A",
        "pins": {"plus": "amp.out"},
    },
    "analysis": {"type": "ac", "start": "10 Hz", "stop": "1 kHz"},
}
