"""Sweeps: runs of one scene with different key values, which share models and workers."""
