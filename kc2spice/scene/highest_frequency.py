"""Highest frequency of a scene, up to which the models of its parts are accurate."""

from __future__ import annotations

from kc2spice.scene.scene_classes import GovernedScene


def find_highest_frequency(scene: GovernedScene, constant: float = 0.0) -> float:
    """Return the highest frequency [Hz] with which a scene drives its parts.

    In an ``ac`` or ``noise`` analysis, the result is the end of the frequency range. In a ``dc`` or
    ``op`` analysis, the result is zero. In a transient, the result is the largest frequency of all
    sines, carriers and waves with edges. The frequency of a wave with edges is the limit below
    which the wave has 99.9 % of its energy. If the scene has a ``resolved_frequency``, the result
    is this frequency.

    Parameters
    ----------
    scene : the scene.
    constant : time constant [s] of a low-pass filter between the sources and the part, for example
        the inductance of a coil divided by its resistance.
    """
    if scene.resolved_frequency is not None:
        return scene.resolved_frequency
    if scene.analysis.is_small_signal:
        return float(scene.analysis.stop or 0.0)
    if scene.analysis.type != "transient":
        return 0.0
    answers = (record.highest_frequency for record in scene.records.values())
    return max((answer(constant) for answer in answers if answer is not None), default=0.0)
