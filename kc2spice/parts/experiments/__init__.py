"""Part types for the experiments of the paper.

They are impact, imprint, frequency response and force map.
"""
