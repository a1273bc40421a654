"""Simulators besides ngspice: one module for each dialect, which registers its printer."""
