"""Sweeps: many decks of one scene, planned by what they share, on any pool of workers."""
