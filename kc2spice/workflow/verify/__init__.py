"""Comparison of full models, equations with reduced models, and ngspice."""
