"""Netlists: reading, checking, changing and writing for every simulator."""

from kc2spice.netlist.library import read_lib as read_lib
