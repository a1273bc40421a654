"""Masses, spheres, springs and contacts."""
