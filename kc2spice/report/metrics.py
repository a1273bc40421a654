"""Numbers that describe a run, taken from its waveforms alone, and the distance of two runs.

Time points may be as uneven as a simulator left them. Heights ``sphere.y`` are of the sphere's
centre over the chip's top face; forces in waveforms are of the whole device.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene

if TYPE_CHECKING:
    from scipy.interpolate import CubicHermiteSpline

SETTLING_BAND = 0.05  # of the step from rest to set point
_FLIGHT = 20e-6  # several periods of the chip: a shorter gap is a bounce within the kick


@dataclass(frozen=True)
class Separation:
    """The sphere leaves the chip for good: time [s] and its velocity there [m/s]."""

    time: float
    velocity: float


def separation(waves: Waveforms) -> Separation | None:
    """End of the first contact that a flight follows, or None.

    A flight lasts 20 us or until the data end.
    """
    t, force = waves["time"], waves["contact.force"]
    loaded = force > 1e-9 * force.max(initial=0.0)
    for last in np.flatnonzero(loaded[:-1] & ~loaded[1:]):
        again = np.flatnonzero(loaded[last + 1 :])
        if again.size == 0 or t[last + 1 + again[0]] - t[last] >= _FLIGHT:
            return _edge(t, waves["sphere.v"], force, int(last))
    return None


def _edge(t: np.ndarray, v: np.ndarray, force: np.ndarray, last: int) -> Separation:
    """Extrapolate the load to zero, and the velocity from the flight back to that instant.

    Between the last loaded sample and the next one the load still bends v; the flight does not.
    """
    time, free = float(t[last]), last + 1
    if last > 0 and force[last - 1] > force[last]:
        decay = (force[last - 1] - force[last]) / (t[last] - t[last - 1])
        time = min(time + force[last] / decay, float(t[free]))
    later = min(int(np.searchsorted(t, t[free] + 100e-9)), t.size - 1)
    slope = (v[later] - v[free]) / (t[later] - t[free]) if later > free else 0.0
    return Separation(float(time), float(v[free] + slope * (time - t[free])))


def loop_metrics(waves: Waveforms, scene: Scene) -> dict[str, float | bool | None]:
    """Metrics of ``kick_and_catch``. Times count from t = 0, a metric that is not met is None.

    The launch is the separation that the flight follows; ``peak_height_m`` is the largest
    ``sphere.y``; ``final_error_m`` is set point less position, ``hold_current_a`` the upper
    coil's mean current over the last twentieth of the run (the derivative term makes single
    samples noisy), ``kick_stroke_m`` the centre node's largest displacement. ``caught``:
    inside the settling band for the last tenth of the run at least. Scenes without control, contact
    or sphere have no metrics of it, scenes with drivers also the peaks of what those give.
    """
    found: dict[str, float | bool | None] = {}
    if scene.contact:
        launch = separation(waves)
        found["launch_velocity_m_s"] = launch.velocity if launch else None
        found["launch_time_s"] = launch.time if launch else None
    if scene.sphere:
        found["peak_height_m"] = float(waves["sphere.y"].max())
        found["final_position_m"] = float(waves["sphere.y"][-1])
    if scene.contact:
        found["kick_stroke_m"] = float(waves["kick.u.R0"].max())
    found |= _driver_metrics(waves, scene)
    return found if scene.control is None else found | _control_metrics(waves, scene)


def _driver_metrics(waves: Waveforms, scene: Scene) -> dict[str, float | bool | None]:
    """What real drivers, or the ideal one of a chip alone, give: current, charge and voltage."""
    found: dict[str, float | bool | None] = {}
    if scene.kick and (scene.kick.driver or not scene.sphere):
        found["kick_voltage_peak_v"] = float(np.abs(waves["kick.voltage"]).max())
        if "kick.current" in waves:
            current = waves["kick.current"]
            charge = np.cumsum(np.diff(waves["time"]) * (current[1:] + current[:-1]) / 2)
            found["kick_current_peak_a"] = float(np.abs(current).max())
            found["kick_charge_peak_c"] = float(np.abs(charge).max())
    if scene.catch and scene.catch.driver:
        found["coil_voltage_peak_v"] = float(np.abs(waves["coil.voltage"]).max())
        found["coil_current_peak_a"] = float(np.abs(waves["coil.upper.current"]).max())
    return found


def _control_metrics(waves: Waveforms, scene: Scene) -> dict[str, float | bool | None]:
    t, y, setpoint = waves["time"], waves["sphere.y"], need(scene.control, "control").setpoint
    step = abs(setpoint - need(scene.sphere, "sphere").radius)
    settled = settling_time(t, y, setpoint, SETTLING_BAND * step)
    return {
        "settling_time_s": settled,
        "final_error_m": float(setpoint - y[-1]),
        "hold_current_a": _tail_mean(t, waves["coil.upper.current"]),
        "caught": settled is not None and bool(settled <= t[0] + 0.9 * (t[-1] - t[0])),
    }


def _tail_mean(t: np.ndarray, values: np.ndarray) -> float:
    """Time average over the last twentieth of the run."""
    tail = t >= t[-1] - 0.05 * (t[-1] - t[0])
    return float(np.trapezoid(values[tail], t[tail]) / np.ptp(t[tail]))


def settling_time(t: np.ndarray, y: np.ndarray, target: float, band: float) -> float | None:
    """Last entry into ``target`` ± ``band``, interpolated; None if the data end outside."""
    outside = np.abs(y - target) > band
    if outside[-1]:
        return None
    if not outside.any():
        return float(t[0])
    k = int(np.flatnonzero(outside)[-1])
    edge = target + np.copysign(band, y[k] - target)
    return float(t[k] + (edge - y[k]) / (y[k + 1] - y[k]) * (t[k + 1] - t[k]))


def impact_metrics(waves: Waveforms, scene: Scene, sectors: int = 4) -> dict[str, float | None]:
    """Metrics of ``impact``: positions from the touching height, the force of one sector."""
    t, y = waves["time"], waves["sphere.y"] - need(scene.sphere, "sphere").radius
    leave, (time, lowest) = separation(waves), _minimum(t, y)
    return {
        "min_position_m": lowest,
        "time_of_min_s": time,
        "separation_time_s": leave.time if leave else None,
        "rebound_velocity_m_s": leave.velocity if leave else None,
        "max_force_n": float(waves["contact.force"].max() / sectors),
    }


def _minimum(t: np.ndarray, y: np.ndarray) -> tuple[float, float]:
    """Time and value of the lowest point, by a parabola through the lowest three samples."""
    k = int(np.argmin(y))
    if k in (0, t.size - 1):
        return float(t[k]), float(y[k])
    s, z = t[k - 1 : k + 2] - t[k], y[k - 1 : k + 2] - y[k]
    left, right = z[0] / s[0], z[2] / s[2]
    curvature = (right - left) / (s[2] - s[0])
    if curvature <= 0.0:
        return float(t[k]), float(y[k])
    slope = left - curvature * s[0]
    shift = -slope / (2 * curvature)
    return float(t[k] + shift), float(y[k] + slope * shift / 2)


def imprint_metrics(waves: Waveforms, scene: Scene, sectors: int = 4) -> dict[str, object]:
    """Metrics of ``imprint``: force of one sector at each depth, and the largest."""
    return {
        "max_force_n": float(waves["contact.force"].max() / sectors),
        "imprint_m": waves["imprint.depth"].tolist(),
        "force_n": (waves["contact.force"] / sectors).tolist(),
    }


def harmonic_metrics(waves: Waveforms, scene: Scene) -> dict[str, object]:
    """Metrics of ``harmonic``: ``amplitude[input][output]`` per unit input, by ``frequency_hz``."""
    amplitude: dict[str, dict[str, list[float]]] = {}
    for name, response in waves.data.items():
        source, arrow, sink = name.partition(">")
        if arrow:
            amplitude.setdefault(source, {})[sink] = np.abs(response).tolist()
    return {"frequency_hz": waves["frequency"].tolist(), "amplitude": amplitude}


def em_force_metrics(waves: Waveforms, scene: Scene) -> dict[str, object]:
    """Metrics of ``em_force``: the force over ``position_m`` for each pair of coil currents."""
    currents = need(scene.em_force, "em_force").currents
    pairs = [[lower, upper] for lower in currents for upper in currents]
    forces = [waves[f"catch.force.{k}"] for k in range(len(pairs))]
    return {
        "force_max_n": max(float(np.abs(force).max()) for force in forces),
        "position_m": waves["sphere.y"].tolist(),
        "current_pairs_a": pairs,
        "force_n": [force.tolist() for force in forces],
    }


_BY_EXPERIMENT: dict[str, Callable[[Waveforms, Scene], dict]] = {
    "loop": loop_metrics,
    "impact": impact_metrics,
    "imprint": imprint_metrics,
    "harmonic": harmonic_metrics,
    "em_force": em_force_metrics,
}


def metrics(waves: Waveforms, scene: Scene) -> dict:
    """Metrics of a scene's experiment, keys as in ``result.json``."""
    return _BY_EXPERIMENT[scene.experiment](waves, scene)


def compare(waves: Waveforms, reference: Waveforms) -> dict[str, float | None]:
    """Errors of a transient against a reference, both on their own time points.

    ``velocity_relative`` and ``separation_time_s`` at the separation (launch or rebound),
    ``trajectory_m`` the largest difference of ``sphere.y`` and ``trajectory_at_s`` where it is,
    ``trajectory_rms_m``, ``trajectory_relative`` to the reference's travel, ``final_m``,
    ``stroke_m`` of the centre node. Heights are interpolated by cubics through y and v.
    """
    t, difference = trajectory_difference(waves, reference)
    worst = int(np.argmax(np.abs(difference)))
    ours, theirs = separation(waves), separation(reference)
    velocity = time = None
    if ours is not None and theirs is not None:
        velocity, time = abs(ours.velocity / theirs.velocity - 1.0), abs(ours.time - theirs.time)
    square = np.trapezoid(difference**2, t) / (t[-1] - t[0])
    return {
        "velocity_relative": velocity,
        "separation_time_s": time,
        "trajectory_m": float(abs(difference[worst])),
        "trajectory_at_s": float(t[worst]),
        "trajectory_rms_m": float(np.sqrt(square)),
        "trajectory_relative": float(abs(difference[worst]) / np.ptp(reference["sphere.y"])),
        "final_m": float(abs(difference[-1])),
        "stroke_m": float(abs(waves["kick.u.R0"].max() - reference["kick.u.R0"].max())),
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
