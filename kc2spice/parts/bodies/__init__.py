"""Finite-element bodies and models of matrices: reduced, with typed ports."""
