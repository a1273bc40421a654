"""Oracle of the hard cases that the scipy reference does not know: plain equations, DOP853.

Shares nothing with the package but the arrays of the model. Everything is integrated in one state
from event to event: no exact flight, no Jacobian.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.integrate import solve_ivp


@dataclass(frozen=True)
class Plain:
    """A sphere over resonators: ``z'' + d z' + w^2 z = G F + e V``, ``m v' = sum F - m g``.

    ``F_k = max(0, k x (1 + damping x'))`` for ``x = u_k - p - gap_k > 0``.
    """

    omega: np.ndarray
    damp: np.ndarray
    rings: np.ndarray  # (modes, rings)
    drive: np.ndarray
    gaps: np.ndarray
    stiffness: float
    mass: float
    gravity: float
    damping: float = 0.0

    @classmethod
    def of(cls, model, radii, radius, mass, *, stiffness, gravity=9.81, damping=0.0):
        """From a whole-device model, its mechanical ports first and its anode last."""
        gaps = radius - np.sqrt(radius**2 - radii**2)
        return cls(model.omega, model.damp, model.gain[:, :-1], model.gain[:, -1],
                   gaps, stiffness, mass, gravity, damping)  # fmt: skip

    def forces(self, z, rate, p, v):
        x = z @ self.rings - p - self.gaps
        speed = rate @ self.rings - v
        law = self.stiffness * x * (1.0 + self.damping * speed)
        return np.where(x > 0.0, np.maximum(law, 0.0), 0.0)

    def run(self, start, corners, volts, stop, *, rtol=1e-10, largest=np.inf):
        """Integrate from ``start`` = (z, z', p, v); voltage is linear between the corners.

        Returns times and states of every accepted step.
        """
        n = self.omega.size
        marks = np.unique(np.concatenate((corners[(corners > 0) & (corners < stop)], [0.0, stop])))

        def rhs(t, x):
            z, rate, p, v = x[:n], x[n : 2 * n], x[-2], x[-1]
            force = self.forces(z, rate, p, v)
            push = self.drive * np.interp(t, corners, volts) - self.rings @ force
            bend = -self.damp * rate - self.omega**2 * z + push
            return np.concatenate((rate, bend, (v, force.sum() / self.mass - self.gravity)))

        scale = np.abs(self.rings).max(axis=1)
        atol = np.concatenate((1e-6 / scale, 1e-6 / scale * self.omega, (1e-6, 1.0)))
        times, states, x = [np.array([0.0])], [np.array(start)[None]], np.array(start)
        for a, b in pairwise(marks):
            done = solve_ivp(rhs, (a, b), x, method="DOP853", rtol=rtol,
                             atol=rtol * atol, max_step=largest)  # fmt: skip
            assert done.success, done.message
            times.append(done.t[1:])
            states.append(done.y.T[1:])
            x = done.y[:, -1]
        return np.concatenate(times), np.concatenate(states)
