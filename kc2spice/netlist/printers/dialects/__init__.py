"""Modules that each register the dialect of one simulator other than ngspice."""
