"""Stretches of a transient between the corners of its drive, and where it starts."""

from itertools import pairwise

import numpy as np

from bench.law import EXTRA, HEIGHT, SPEED, Mode
from bench.statics import rest


def segments(law, stop):
    """All stretches up to ``stop``: not restarted there, integrators miss the kick."""
    corners, volts = np.array([0.0]), np.array([0.0])
    if law.drive is not None:
        d = law.drive
        rise = d.start + np.array([0.0, d.edge, d.width, d.width + d.edge])
        corners, volts = np.append(corners, rise), np.append(volts, [0.0, d.voltage, d.voltage, 0])
    enable = law.control.switching_times[0][0] if law.control is not None else np.inf
    marks = np.unique(np.concatenate((corners, [enable, stop])))
    marks = marks[marks <= stop].tolist()
    level = np.interp(marks, corners, volts).tolist()
    return [
        Mode(a, u, (w - u) / (b - a), a >= enable, b)
        for (a, b), (u, w) in zip(pairwise(marks), pairwise(level), strict=True)
    ]


def initial(law, scene):
    """State ``[a, b, p, v, d, I]``: the sphere at rest on the chip, or thrown at it."""
    throw = scene.find_only_part("throw")
    if throw is None:
        return rest(law)
    x = np.zeros(2 * law.q + EXTRA)
    x[2 * law.q + HEIGHT], x[2 * law.q + SPEED] = throw.keys.gap, throw.keys.velocity
    return x


def saturation(law, x, enabled):
    """-1, 0 or +1: the limit at which the current is in the state ``x``."""
    if not enabled:
        return 0
    sphere = x[2 * law.q :]
    return int(np.sign(law.demand(sphere) - law.clamped(sphere)))
