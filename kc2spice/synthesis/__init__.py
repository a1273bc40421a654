"""Linear models as subcircuits, and the head that every library has."""
