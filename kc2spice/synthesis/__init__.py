"""Subcircuits of linear models, and the header of all libraries."""
