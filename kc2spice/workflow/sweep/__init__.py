"""Sweeps: runs of one scene with other values, which share models, on any pool of workers."""
