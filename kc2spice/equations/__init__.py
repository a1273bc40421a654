"""Equations of a scene: the laws of its parts, joined like the pins of the parts.

The input is a scene and the models of its parts. The output is networks of laws in SI units.
Solvers of these networks are in :mod:`kc2spice.reference`. Begin to read at
:mod:`kc2spice.equations.scene_laws`.
"""
