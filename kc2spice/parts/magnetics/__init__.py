"""Part types of coils, magnets, moving iron, and conductors with eddy currents."""
