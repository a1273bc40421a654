"""Comparison of three solutions: full models, equations with reduced models, and ngspice."""
