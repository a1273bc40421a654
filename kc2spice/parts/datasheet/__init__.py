"""Part types with keys that are the values of a manufacturer's data sheet."""
