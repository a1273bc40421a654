"""Impedance from a library, with either client: impedance_library.py PySpice|InSpice kick.lib"""

import sys
from importlib import import_module

import numpy as np

from kc2spice.netlist import read_lib
from kc2spice.pyspice import pyspice_subcircuit

client, library, *picture = sys.argv[1:]
(chip,) = read_lib(library)
circuit = import_module(f"{client}.Spice.Netlist").Circuit("impedance")
circuit.subcircuit(pyspice_subcircuit(chip, client))
grounded = ("cathode", "base")
nodes = [circuit.gnd if pin.name in grounded else pin.name for pin in chip.pins]
circuit.X("chip", chip.name, *nodes)
circuit.V("drive", "anode", circuit.gnd, "DC 0 AC 1")
if client == "PySpice":
    # Debian has no libngspice.so without its headers
    import_module("PySpice.Spice.NgSpice.Shared").NgSpiceShared.LIBRARY_PATH = "libngspice.so.0"
    simulation = circuit.simulator()
else:
    simulation = import_module("InSpice.Spice.Simulator").Simulator.factory().simulation(circuit)
sweep = {"start_frequency": 1e5, "stop_frequency": 5e5, "number_of_points": 401}
analysis = simulation.ac(variation="lin", **sweep)
impedance = np.abs(1 / np.array(analysis.branches["vdrive"]))
frequency = np.real(np.array(analysis.frequency))
print(f"resonance {frequency[impedance.argmin()]:g} Hz, {impedance.min():g} Ohm")
print(f"antiresonance {frequency[impedance.argmax()]:g} Hz, {impedance.max():g} Ohm")
if picture:
    import matplotlib.pyplot as plt

    plt.semilogy(frequency, impedance)
    plt.xlabel("frequency [Hz]")
    plt.ylabel("impedance [Ohm]")
    plt.savefig(picture[0])
