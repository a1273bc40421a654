"""Part types for coils, magnets, moving iron, and conductors with eddy currents."""
