"""Parts in PySpice: the chip of a scene in a circuit of your own."""

from PySpice.Spice.Netlist import Circuit

import kc2spice as kc
from kc2spice.pyspice import pyspice_subcircuit

for part in kc.deck("impact").parts:
    part.write(part.filename)
chip = kc.read_lib("impact_kick.lib")[0]
print(chip)

circuit = Circuit("chip behind a resistor")
circuit.subcircuit(pyspice_subcircuit(chip))
circuit.PulseVoltageSource("drive", "in", 0, 0, 100, 10e-6, 1)  # never back within the run
circuit.R("out", "in", "anode", 10)
nodes = {"anode": "anode", "ring0": "top"}  # all other pins stay at ground or hang free
free = (f"free_{pin.name}" for pin in chip.pins)
circuit.X("chip", chip.name, *(
    nodes.get(pin.name, 0 if pin.name in ("cathode", "base") else name)
    for pin, name in zip(chip.pins, free, strict=True)
))  # fmt: skip
text = f"{circuit}.tran 50n 40u 0 50n\n.save v(anode) v(top)\n.end\n"

deck = kc.Deck(
    name="chip", text=text, stop=40e-6, units={"voltage": "V", "top": "m"},
    vectors={"voltage": ("v(anode)", 1.0), "top": ("v(top)", 1e-6)},
)  # fmt: skip
result = kc.simulate(deck)
print(result)
assert result.waves["voltage"].max() > 90
assert 2e-6 < result.waves["top"].max() < 6e-6  # overshoots its free stroke of 2.35 um
