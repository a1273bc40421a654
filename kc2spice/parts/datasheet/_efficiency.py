"""Efficiency of a loudspeaker: radiated power divided by electrical power."""

from __future__ import annotations

import numpy as np

from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.acoustics.listener import ListenerKeys
from kc2spice.parts.acoustics.radiation import RadiationKeys
from kc2spice.scene.scene_classes import Part, Scene

STEADY_SHARE = 0.5  # last fraction of a transient that counts as periodic


def compute_efficiency(part: Part, scene: Scene, waves: Waveforms) -> np.ndarray | None:
    """Return the efficiency of a loudspeaker: radiated power over electrical power.

    The efficiency is the radiated power divided by the electrical power. For frequency responses,
    the returned array (n,) contains a value for each frequency. For transients, the returned array
    (1,) contains the mean over the last periods. The radiated power is ::

        P = angle r^2 |p|^2 / (rho c)

    where p is the pressure on the axis at the distance r, and ``angle`` is the solid angle into
    which the surfaces radiate. The fluid has the density rho and the sound speed c. The formula for
    the radiated power neglects that large surfaces radiate less sound off their axis. The scene
    must have exactly one loudspeaker and one listener. The listener must be on the axis of the
    radiating surfaces. All radiating surfaces must have the same ``shape`` and adjoin the same
    fluid. In a transient, the sources must also have a common period. If the scene does not meet
    these conditions, the function returns None.
    """
    listener, lines = scene.find_only_part("listener"), (f"{part.name}.v", f"{part.name}.i")
    if listener is None or scene.find_only_part(part.type.name) is None:
        return None
    keys = listener.with_schema(ListenerKeys).keys
    sources = [
        item.keys
        for item in scene.list_parts_with_schema("radiation", RadiationKeys)
        if item.name in keys.sources or not keys.sources
    ]
    alike = {(item.fluid.density, item.fluid.sound_speed, item.shape) for item in sources}
    names = (f"{listener.name}.pressure", *lines)
    if keys.angle or len(alike) != 1 or not all(name in waves for name in names):
        return None
    fluid, radiator = sources[0].fluid, sources[0].radiator
    area = radiator.solid_angle * keys.distance**2
    pressure, voltage, current = map(waves.__getitem__, names)
    radiated = area * np.abs(pressure) ** 2 / (fluid.density * fluid.sound_speed)
    electrical = (voltage * np.conj(current)).real
    if "frequency" in waves:
        return np.asarray(radiated / electrical)
    delay = keys.distance / fluid.sound_speed
    return _compute_efficiency(waves["time"], radiated, electrical, scene.period, delay)


def _compute_efficiency(
    time: np.ndarray,
    radiated: np.ndarray,
    electrical: np.ndarray,
    period: float | None,
    delay: float,
) -> np.ndarray | None:
    """Return the mean efficiency over the last complete periods, an array (1,).

    The efficiency is the ratio of the mean radiated power and the mean electrical power.
    ``radiated`` and ``electrical`` are the powers versus time, arrays of shape (n,). The radiated
    power is ``delay`` [s] later than the electrical power that causes this radiation. Return None
    if the sources have no common period.
    """
    count = 0 if not period else int(STEADY_SHARE * (time[-1] - delay) / period)
    if not period or count < 1:
        return None
    energies = []
    for power, late in ((radiated, 0.0), (electrical, delay)):
        end = time[-1] - late
        inside = (time >= end - count * period) & (time <= end)
        energies.append(np.trapezoid(power[inside], time[inside]))
    return np.array([energies[0] / energies[1]])
