"""The distance of two runs of a sphere, each on its own time points."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from kc2spice.core.waveforms import Waveforms
from kc2spice.parts._touching import separation

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline


def compare(waves: Waveforms, reference: Waveforms) -> dict[str, float | None]:
    """Errors of a transient against a reference, both on their own time points.

    ``velocity_relative`` and ``separation_time_s`` at the separation (launch or rebound),
    ``trajectory_m`` the largest difference of ``sphere.y`` and ``trajectory_at_s`` where it is,
    ``trajectory_rms_m``, ``trajectory_relative`` to the reference's travel, ``final_m``,
    ``stroke_m`` of the centre node. Heights are interpolated by cubics through y and v.
    """
    t, difference = trajectory_difference(waves, reference)
    worst = int(np.argmax(np.abs(difference)))
    ours, theirs = _leaves(waves), _leaves(reference)
    velocity = time = None
    if ours is not None and theirs is not None:
        velocity, time = abs(ours[1] / theirs[1] - 1.0), abs(ours[0] - theirs[0])
    square = np.trapezoid(difference**2, t) / (t[-1] - t[0])
    return {
        "velocity_relative": velocity,
        "separation_time_s": time,
        "trajectory_m": float(abs(difference[worst])),
        "trajectory_at_s": float(t[worst]),
        "trajectory_rms_m": float(np.sqrt(square)),
        "trajectory_relative": float(abs(difference[worst]) / np.ptp(reference["sphere.y"])),
        "final_m": float(abs(difference[-1])),
        "stroke_m": float(abs(waves["kick.u.ring0"].max() - reference["kick.u.ring0"].max())),
    }


def trajectory_difference(waves: Waveforms, reference: Waveforms) -> tuple[np.ndarray, np.ndarray]:
    """Times of both runs that both cover, and ``sphere.y`` less the reference's there."""
    first, second = _height(waves), _height(reference)
    t = np.union1d(first.x, second.x)
    t = t[(t >= max(first.x[0], second.x[0])) & (t <= min(first.x[-1], second.x[-1]))]
    return t, first(t) - second(t)


def _height(waves: Waveforms) -> CubicHermiteSpline:
    from scipy.interpolate import CubicHermiteSpline

    t, unique = np.unique(waves["time"], return_index=True)
    return CubicHermiteSpline(t, waves["sphere.y"][unique], waves["sphere.v"][unique])


def _leaves(waves: Waveforms) -> tuple[float, float] | None:
    return separation(waves["time"], waves["contact.force"], waves["sphere.v"])
