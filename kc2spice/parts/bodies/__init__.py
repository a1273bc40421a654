"""Part types with reduced linear models, from finite elements or from matrix files."""
