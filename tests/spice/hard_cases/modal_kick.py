"""A kick on hundreds of modes: the oracle of error budgets.

Every mode moves by its closed form within a step; the contact's force is constant over it and
follows from the mean penetration, which keeps the energy of a spring that opens and closes. It
shares no code with the product: the modes are those of a model with ten times the states, all
with their inertia. On lightly damped chips models of 39 to 160 states scatter by 1e-3 of the
launch, those of 240, 320 and 480 differ by 5e-4 and 1e-4.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

AWAY = 6.0  # free strokes above the chip: as it rings it comes up by two, from two below
FALL = 20.0  # m/s2: nor does the sphere come back if this cannot stop it


@dataclass(frozen=True)
class Kick:
    """Modes (omega [rad/s], damp [1/s], gain (q, rings + 1), the anode last) of a whole chip, a
    sphere (radius [m], mass [kg]) on its rings, whose springs have the stiffness ``penalty`` [N/m],
    a voltage of corners ``pulse`` [(s, V)], and another force on the sphere [(s, N)]."""

    omega: np.ndarray
    damp: np.ndarray
    gain: np.ndarray
    spacing: float
    radius: float
    mass: float
    penalty: float
    pulse: np.ndarray
    other: np.ndarray
    start: tuple[float, float] | None = None  # height [m] and velocity [m/s]; at rest on the chip

    def flight(self, step, stop):
        """Times [s], heights [m] over the plane of contact, velocities [m/s] up to ``stop``, and
        when it last touched."""
        poles, residue, gain = self._poles()
        rings, anode = gain[:, :-1], gain[:, -1]
        distance = self.spacing * np.arange(rings.shape[1])
        gap = self.radius - np.sqrt(self.radius**2 - distance**2)
        grow = np.exp(poles * step)
        hold = (grow - 1) / poles  # of a constant force
        ramp = (hold - step) / poles  # of one that rises by one a second
        see = _real(residue[:, None] * rings)
        ahead = _real((residue * grow)[:, None] * rings)
        give = -_flat((hold[:, None] * rings).T)
        held, rising = hold * anode, ramp * anode
        moved = np.einsum("tr,tk->kr", _real((residue * hold)[:, None] * rings), _pairs(rings)) / 2
        soft = moved + step**2 / (4 * self.mass) + np.eye(gap.size) / self.penalty
        times = step * np.arange(int(np.ceil(stop / step)) + 1)
        volts = np.interp(times, *self.pulse.T)
        pushed = np.interp(times, *self.other.T)
        stroke = AWAY * float(np.abs((anode * residue / -poles).real @ rings[:, 0])) * np.ptp(volts)
        weight = -pushed[0]
        state = (-(rings[:, 0] * weight) + anode * volts[0]) / -poles
        if self.start is not None:
            state = 0 * state
        top = _flat(state) @ see
        y, v = self.start or (top[0] - weight / self.penalty, 0.0)
        up = top - y - gap
        heights, speeds = np.empty((2, times.size))
        heights[0], speeds[0] = y, v
        touched = 0.0
        for k in range(times.size - 1):
            a = pushed[k] / self.mass
            free = y + step * v + step**2 / 2 * a
            new = state * grow
            top = _flat(state) @ ahead
            if volts[k] or volts[k + 1]:
                slope = (volts[k + 1] - volts[k]) / step
                more = held * volts[k] + rising * slope
                new += more
                top = top + _flat(more) @ see
            mean = (up + top - free - gap) / 2
            y, v = free, v + step * a
            if mean.max() > 0:
                force = pressed(mean, soft)
                touched = float(times[k + 1])
                new += (force @ give).view(complex)
                y += step**2 / 2 * force.sum() / self.mass
                v += step * force.sum() / self.mass
                top = _flat(new) @ see
            state, up = new, top - y - gap
            heights[k + 1], speeds[k + 1] = y, v
            if v > FALL * stop and up.max() < -stroke:
                rest = np.arange(times.size - k - 1)
                gained = np.cumsum(np.r_[0.0, pushed[k + 1 : -1]]) * step / self.mass
                speeds[k + 1 :] = v + gained
                heights[k + 1 :] = y + step * (v * rest + np.cumsum(np.r_[0.0, gained[1:]]))
                break
        return times, heights, speeds, touched

    def _poles(self):
        """``z = Re sum r p``, ``p' = s p + f``: one pole of a pair, both of overdamped modes."""
        root = np.sqrt(self.omega**2 - (self.damp / 2) ** 2 + 0j)
        rings = root.real > 0
        first = -self.damp / 2 + 1j * root
        other = (-self.damp / 2 - 1j * root)[~rings]
        residue = np.where(rings, 1 / (1j * root), 1 / (2j * root))
        return (
            np.r_[first, other], np.r_[residue, -residue[~rings]],
            np.vstack([self.gain, self.gain[~rings]]),
        )  # fmt: skip


def pressed(mean, soft):
    """Ring forces, none negative, with ``soft force = mean`` where they are closed."""
    L = np.linalg.cholesky(soft)
    return nnls(L.T, np.linalg.solve(L, mean))[0]


def _flat(values):
    return np.ascontiguousarray(values).view(float)


def _real(weights):
    """(2 n, rings) such that ``_flat(p) @ it = Re(p @ weights)``."""
    return np.stack([weights.real, -weights.imag], axis=1).reshape(-1, weights.shape[1])


def _pairs(gain):
    """Gains of a real force on the states as ``_flat`` sees them."""
    return np.stack([gain, np.zeros_like(gain)], axis=1).reshape(-1, gain.shape[1])
