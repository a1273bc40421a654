"""Acoustic part types: radiation, listeners, diaphragms, cavities, vents and tubes."""
