"""Experiments of the paper as parts: impact, imprint, frequency response and force map."""
