"""Sweeps: runs of one scene with different key values and shared models."""
