"""Physics stated once, as expressions, and what is generated from it."""
