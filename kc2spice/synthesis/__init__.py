"""Subcircuits of linear models, and headers of all libraries."""
