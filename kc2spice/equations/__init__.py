"""Equations of a scene, which consist of the equations (laws) of its parts.

The input is a scene with the models of its parts. The output is a list of networks in SI units. A
network consists of laws that are connected like the pins of the corresponding parts. Solvers of
these networks are in :mod:`kc2spice.reference`. A good starting point for reading is
:mod:`kc2spice.equations.scene_laws`.
"""
