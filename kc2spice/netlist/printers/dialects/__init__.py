"""Dialects of simulators other than ngspice: each module registers one dialect."""
