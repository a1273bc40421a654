"""Part types for the experiments of the paper.

The experiments are impacts, imprints, frequency responses and force maps.
"""
