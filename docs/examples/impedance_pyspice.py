"""Impedance of a chip from its library, with PySpice: python impedance_pyspice.py kick.lib"""

import sys

import numpy as np
from PySpice.Spice.Netlist import Circuit
from PySpice.Spice.NgSpice.Shared import NgSpiceShared

from kc2spice.pyspice import subcircuit
from kc2spice.spice import read_lib

NgSpiceShared.LIBRARY_PATH = "libngspice.so.0"  # Debian has no libngspice.so without its headers
(chip,) = read_lib(sys.argv[1])
circuit = Circuit("impedance")
circuit.subcircuit(subcircuit(chip))
grounded = ("cathode", "base")
nodes = [circuit.gnd if pin.name in grounded else pin.name for pin in chip.pins]
circuit.X("chip", chip.name, *nodes)
circuit.V("drive", "anode", circuit.gnd, "DC 0 AC 1")
sweep = {"start_frequency": 1e5, "stop_frequency": 5e5, "number_of_points": 401}
analysis = circuit.simulator().ac(variation="lin", **sweep)
impedance = np.abs(1 / np.array(analysis.branches["vdrive"]))
frequency = np.real(np.array(analysis.frequency))
print(f"resonance {frequency[impedance.argmin()]:g} Hz, {impedance.min():g} Ohm")
print(f"antiresonance {frequency[impedance.argmax()]:g} Hz, {impedance.max():g} Ohm")
if len(sys.argv) > 2:
    import matplotlib.pyplot as plt

    plt.semilogy(frequency, impedance)
    plt.savefig(sys.argv[2])
