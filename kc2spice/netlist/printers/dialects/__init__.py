"""Simulators besides ngspice: each module registers one dialect."""
