"""Reference solver, which integrates the equations of parts.

The reference solver does not use a circuit simulator.
"""
