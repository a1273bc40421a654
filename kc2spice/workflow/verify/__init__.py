"""Comparison of three solutions: full models, reduced models, and ngspice."""
