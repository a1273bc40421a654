"""Plates, combs and gaps under a voltage."""
