"""Acoustic part types, such as radiation, listener, diaphragm, cavity and vent."""
