"""Part types for the experiments of the paper.

The experiments are impact, imprint, frequency response and force map.
"""
