"""Highest frequency of a scene, which determines the resolution of its parts."""

from __future__ import annotations

from kc2spice.scene.model import GovernedScene


def highest_frequency(scene: GovernedScene, constant: float = 0.0) -> float:
    """Return the highest frequency [Hz] that a scene drives its parts with.

    For ``ac`` and ``noise`` it is the end of their range, for ``dc`` and ``op`` zero. In a
    transient it is the largest frequency of all sines and carriers. For a wave with edges, the
    frequency below which it has 99.9 % of its energy is used. A ``resolved_frequency`` of the
    scene replaces the result.

    Parameters
    ----------
    scene : the scene.
    constant : time constant [s] of a filter before voltages and forces, such as a coil.
    """
    if scene.resolved_frequency is not None:
        return scene.resolved_frequency
    if scene.analysis.is_small_signal:
        return float(scene.analysis.stop or 0.0)
    if scene.analysis.type != "transient":
        return 0.0
    answers = (record.highest_frequency for record in scene.records.values())
    return max((answer(constant) for answer in answers if answer is not None), default=0.0)
