"""Sweeps.

Many decks of one scene that share meshes, models and netlists, on any pool of workers.
"""
