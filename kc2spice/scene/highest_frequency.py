"""The highest frequency of a scene, by which its parts choose how finely they resolve."""

from __future__ import annotations

from kc2spice.scene.model import GovernedScene


def highest_frequency(scene: GovernedScene, constant: float = 0.0) -> float:
    """The highest frequency [Hz] that a scene drives its parts with.

    Of ``ac`` and ``noise`` that is the end of their range, of ``dc`` and ``op`` zero. In a
    transient it is the largest of all sines and carriers and of the frequencies up to which what
    has edges has 99.9 % of its energy within the run. A ``resolved_frequency`` of the scene
    replaces it.

    Parameters
    ----------
    scene : the scene.
    constant : time constant [s] behind which voltages and forces act, as that of a coil.
    """
    if scene.resolved_frequency is not None:
        return scene.resolved_frequency
    if scene.analysis.small:
        return float(scene.analysis.stop or 0.0)
    if scene.analysis.type != "transient":
        return 0.0
    answers = (record.highest_frequency for record in scene.records.values())
    return max((answer(constant) for answer in answers if answer is not None), default=0.0)
