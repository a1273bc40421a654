"""Own driver: your netlist between a pulse and the piezo chip."""

from pathlib import Path

import kc2spice as kc

Path("follower.lib").write_text("""\
* a driver with 5 Ohm and 20 uH at its output
.subckt follower in out ref
Ebuffer inner ref in ref 1
Rout inner mid 5
Lout mid out 20u
.ends
""")
scene = kc.load_scene({
    "name": "own_driver",
    "kick": {"part": "piezo_stack"},
    "amp": {"part": "netlist", "file": "follower.lib", "subckt": "follower",
            "pins": {"in": "pulse.out", "out": "kick.anode"}},
    "pulse": {"part": "source",
              "pulse": {"high": "100 V", "start": "5 us", "width": "25 us", "edge": "1 us"}},
    "analysis": {"type": "transient", "stop": "100 us"},
    "probes": {"peak_v": {"of": "kick.voltage", "take": "max"}},
    "solver": {"max_step": "0.1 us"},
})  # fmt: skip
result = kc.run(scene)
print(result)
assert 100 < result.metrics["peak_v"] < 200  # the inductance rings with the chip's capacitance
