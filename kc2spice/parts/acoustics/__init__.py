"""Acoustic parts: radiation, listeners, cavities, vents and tubes."""
