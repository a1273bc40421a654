"""Coils, magnets and iron that move, and conductors with eddy currents."""
