"""Names of part types in other programs, for the errors about unknown part types."""

# Part types of this program, keyed by names of other programs without blanks and signs.
PART_TYPE_SYNONYMS = {
    "r": "resistor", "res": "resistor", "c": "capacitor", "cap": "capacitor", "l": "inductor",
    "ind": "inductor", "coil": "inductor", "v": "source", "i": "source", "vsource": "source",
    "isource": "source", "voltagesource": "source", "currentsource": "source",
    "battery": "source", "force": "source", "d": "diode", "speaker": "loudspeaker",
    "quartz": "crystal", "buzzer": "disc", "unimorph": "disc", "k": "spring", "dashpot": "damper",
    "subckt": "netlist", "spice": "netlist", "subcircuit": "netlist", "x": "netlist",
    "mesh": "body", "fem": "body", "solid": "body", "pipe": "tube", "volume": "cavity",
}  # fmt: skip
