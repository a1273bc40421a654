"""kc2spice: finite-element actuator models as SPICE subcircuits, run with their electronics."""

__version__ = "0.1.0"
