"""Independent integration of equations of any set of parts (reference solver)."""
