"""Frequency band for which the acoustic networks of a scene are fitted."""

from __future__ import annotations

from typing import NamedTuple

from kc2spice.scene.highest_frequency import find_highest_frequency
from kc2spice.scene.scene_classes import GovernedScene

AUDIO_END = 20e3  # Hz, upper end of the band if the sources have no highest frequency
MAX_BAND_RATIO = 1e4  # largest permitted ratio of the highest to the lowest frequency of a band


class AcousticBand(NamedTuple):
    """Lowest and highest frequency [Hz] for which an acoustic network is fitted."""

    low: float
    high: float


def choose_acoustic_band(scene: GovernedScene) -> AcousticBand:
    """Return the frequency band in which acoustic networks must be accurate.

    The band ends at the highest frequency of the analysis or of the sources in the scene. In an ac
    analysis, the band begins at the lowest frequency of the analysis. The band spans at most four
    decades.
    """
    high = find_highest_frequency(scene) or AUDIO_END
    start = scene.analysis.start if scene.analysis.is_small_signal else 0.0
    return AcousticBand(max(start, high / MAX_BAND_RATIO), high)
