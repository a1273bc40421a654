"""Oracle of scenes on the made-up device: plain equations, DOP853, nothing of the package's own.

One state from event to event while the sphere is near the chip, the sphere alone in flight.
"""

from __future__ import annotations

import numpy as np
from device import RADII
from hard_cases.oracle import Plain
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.optimize import brentq

NAMES = ("c0", "c1", "c2", "c11", "c12", "c22")


def plain(scene, model):
    """Sphere and modes of a scene with all rings."""
    keys = {part.type.name: part.keys for part in scene.parts.values()}
    return Plain.of(
        model, RADII, keys["sphere"].radius, keys["sphere"].mass,
        stiffness=4 * keys["contact"].penalty, gravity=scene.gravity,
    )  # fmt: skip


def loop(scene, model, table):
    """Times, heights of the centre, speeds and the launch velocity of kick and catch."""
    case, n = plain(scene, model), model.order
    radius, control = scene.parts["sphere"].keys.radius, scene.parts["control"].keys
    drive = scene.parts["kick"].keys.drive
    splines = [CubicSpline(table.y, getattr(table, name)) for name in NAMES]

    def pull(y, v, integral):
        """Force of the coils, and what the integrator takes in: it waits at the clamp."""
        error = control.setpoint - y
        wanted = control.kp * error + control.ki * integral - control.kd * v
        i = float(np.clip(wanted, -control.current_limit, control.current_limit))
        c0, c1, c2, c11, c12, c22 = (float(spline(y)) for spline in splines)
        force = c0 + (c2 - c1) * i + (c11 - c12 + c22) * i * i
        return force, error if wanted == i else 0.0

    def rest_at(p):
        weight = case.mass * case.gravity - float(splines[0](p + radius))
        z = -case.rings[:, 0] / case.omega**2 * weight
        return z, z @ case.rings[:, 0] - weight / case.stiffness - p

    p = brentq(lambda p: rest_at(p)[1], -1e-6, 1e-6, xtol=1e-18)
    corners = drive.start + np.array([0.0, drive.edge, drive.width, drive.width + drive.edge])
    volts = np.array([0.0, drive.voltage, drive.voltage, 0.0])

    def near(t, x):
        z, rate, p, v = x[:n], x[n : 2 * n], x[-3], x[-2]
        force = case.forces(z, rate, p, v)
        push = case.drive * np.interp(t, corners, volts) - case.rings @ force
        bend = -case.damp * rate - case.omega**2 * z + push
        coils, error = pull(p + radius, v, x[-1])
        speed = (force.sum() + coils) / case.mass - case.gravity
        return np.concatenate((rate, bend, (v, speed, error)))

    x = np.concatenate((rest_at(p)[0], np.zeros(n), (p, 0.0, 0.0)))
    scale = np.abs(case.rings).max(axis=1)
    atol = 1e-8 * np.concatenate((1e-6 / scale, 1e-6 / scale * case.omega, (1e-6, 1.0, 1e-9)))
    times, height, speed, launch = [], [], [], None
    for a, b in zip(corners, [*corners[1:], corners[-1] + 20e-6], strict=True):
        done = solve_ivp(near, (a, b), x, method="DOP853", rtol=1e-8, atol=atol)
        assert done.success
        x = done.y[:, -1]
        closed = [case.forces(y[:n], y[n : 2 * n], y[-3], y[-2]).sum() > 0 for y in done.y.T]
        if any(closed) and b < corners[2] + 1e-9:
            last = int(np.flatnonzero(closed)[-1])
            launch = done.y[-2, min(last + 1, done.t.size - 1)]
        times.append(done.t), height.append(done.y[-3] + radius), speed.append(done.y[-2])

    def flying(t, x):
        coils, error = pull(x[0], x[1], x[2])
        return [x[1], coils / case.mass - case.gravity, error]

    begin = [x[-3] + radius, x[-2], x[-1]]
    done = solve_ivp(flying, (times[-1][-1], scene.stop), begin, method="DOP853", rtol=1e-8,
                     atol=1e-13, max_step=5e-6)  # fmt: skip
    times.append(done.t), height.append(done.y[0]), speed.append(done.y[1])
    return np.concatenate(times), np.concatenate(height), np.concatenate(speed), launch
