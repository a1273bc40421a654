"""Generation of subcircuits for linear models, and of headers for all libraries."""
