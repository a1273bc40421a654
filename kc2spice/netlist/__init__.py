"""Netlists: parsers, checks, transformations and printers for all simulators."""

from kc2spice.netlist.subcircuit_library import read_lib as read_lib
