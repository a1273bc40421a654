"""The distance of two runs of a sphere, each on its own time points."""

import numpy as np
from scipy.interpolate import CubicHermiteSpline

from kc2spice.parts.mechanics._contact_surfaces import find_separation


def compare(waves, reference):
    """Errors of a transient against a reference, both on their own time points.

    ``launch`` is relative, of the velocity at the separation (None without one), ``position_m`` the
    largest difference of ``sphere.y``, ``of_travel`` that over the reference's travel. Heights are
    interpolated by cubics through y and v.
    """
    first, second = _height(waves), _height(reference)
    t = np.union1d(first.x, second.x)
    t = t[(t >= max(first.x[0], second.x[0])) & (t <= min(first.x[-1], second.x[-1]))]
    largest = float(np.abs(first(t) - second(t)).max())
    ours, theirs = _leaves(waves), _leaves(reference)
    launch = None if ours is None or theirs is None else abs(ours[1] / theirs[1] - 1.0)
    travel = float(np.ptp(reference["sphere.y"]))
    return {"launch": launch, "position_m": largest, "of_travel": largest / travel}


def _height(waves):
    t, unique = np.unique(waves["time"], return_index=True)
    return CubicHermiteSpline(t, waves["sphere.y"][unique], waves["sphere.v"][unique])


def _leaves(waves):
    return find_separation(waves["time"], waves["contact.force"], waves["sphere.v"])
