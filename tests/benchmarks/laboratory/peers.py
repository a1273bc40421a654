"""scipy's integrators on the equations of the loop, restarted at the breakpoints of the pulse.

The right side and its Jacobian are as lean as numpy allows. Contact and clamp are kinks that the
step control must find; an integrator that is not restarted at the edges steps over the kick.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.model import Scene
from laboratory.law import EXTRA, Law
from laboratory.segments import Segment, initial, segments

IMPLICIT = ("Radau", "BDF", "LSODA")


@dataclass(frozen=True)
class Peer:
    """``x' = rhs(t, x)`` of one segment over ``x = [a, b, p, v, d, I]``, with its Jacobian."""

    law: Law
    segment: Segment
    linear: np.ndarray  # (n, n): modes, kinematics and roll-off

    def rhs(self, t: float, x: np.ndarray) -> np.ndarray:
        """Rates of the state."""
        law, q = self.law, self.law.q
        force = law.stiffness * np.maximum(law.rings @ x[:q] - x[2 * q] - law.gaps, 0.0)
        rates = self.linear @ x
        volt = self.segment.volt + self.segment.slope * (t - self.segment.start)
        rates[q : 2 * q] += law.inverse_mass * (volt * law.charge - force @ law.rings)
        current, clamped, error = self._current(x)
        pull = law.force_map(x[2 * q] + law.radius, current)[0] if law.force_map else 0.0
        rates[2 * q + 1] = (force.sum() + pull) / law.mass - law.gravity
        if law.control is not None and self.segment.enabled and not clamped:
            rates[2 * q + 3] = law.control.ki * error
        return rates

    def jacobian(self, t: float, x: np.ndarray) -> np.ndarray:
        """Analytic derivative of the rates."""
        law, q, J = self.law, self.law.q, self.linear.copy()
        closed = law.rings[law.rings @ x[:q] - x[2 * q] - law.gaps > 0.0]
        if len(closed):
            pull = law.stiffness * closed.sum(axis=0)
            J[q : 2 * q, :q] -= law.stiffness * (law.inverse_mass[:, None] * closed.T) @ closed
            J[q : 2 * q, 2 * q] = law.inverse_mass * pull
            J[2 * q + 1, :q] = pull / law.mass
            J[2 * q + 1, 2 * q] = -law.stiffness * len(closed) / law.mass
        if law.force_map is not None:
            current, clamped, _ = self._current(x)
            _, slope, gain = law.force_map(x[2 * q] + law.radius, current)
            J[2 * q + 1, 2 * q] += slope / law.mass
            c = law.control
            if c is not None and self.segment.enabled and not clamped:
                row = gain * np.array((-c.kp, 0.0, c.kd, 1.0)) / law.mass
                J[2 * q + 1, 2 * q :] += row
                J[2 * q + 3, 2 * q] = -c.ki
        return J

    def _current(self, x: np.ndarray) -> tuple[float, bool, float]:
        """Coil current, whether it is clamped, and the height's error."""
        c = self.law.control
        if c is None or not self.segment.enabled:
            return 0.0, False, 0.0
        p, _, d, integral = x[-EXTRA:].tolist()
        error = c.setpoint - self.law.radius - p
        wanted = c.kp * error + integral + c.kd * d
        current = min(max(wanted, -c.current_limit), c.current_limit)
        return current, current != wanted, error


def integrate(law: Law, scene: Scene, method: str, rtol: float) -> Waveforms:
    """The scene's transient by ``solve_ivp`` with ``method``, restarted at the pulse's edges.

    Raises
    ------
    SimulationError : the integrator gave up.
    """
    x, q = initial(law, scene), law.q
    # what is small: 1 um of any ring or of the sphere, 1 m/s, 1 mA
    atol = rtol * np.concatenate((np.full(2 * q, 1e-6), (1e-6, 1.0, 1.0, 1e-3)))
    linear = _linear(law)
    times, states = [np.zeros(1)], [x[:, None]]
    for segment in segments(law, scene.stop):
        peer = Peer(law, segment, linear)
        options = {"jac": peer.jacobian} if method in IMPLICIT else {}
        with np.errstate(divide="ignore"):  # scipy divides by an error that is zero at rest
            solution = solve_ivp(
                peer.rhs, (segment.start, segment.end), x, method=method, rtol=rtol, atol=atol,
                **options,
            )  # fmt: skip
        if solution.status < 0:
            raise SimulationError(
                f"{method} gave up", where=f"t = {solution.t[-1]:g} s", got=solution.message
            )
        times.append(solution.t[1:])
        states.append(solution.y[:, 1:])
        x = solution.y[:, -1]
    return _waveforms(law, np.concatenate(times), np.concatenate(states, axis=1))


def _linear(law: Law) -> np.ndarray:
    q = law.q
    A, diag = np.zeros((2 * q + EXTRA, 2 * q + EXTRA)), np.arange(q)
    A[diag, q + diag], A[q + diag, diag], A[q + diag, q + diag] = law.omega, -law.omega, -law.damp
    if law.electrical == "open":
        A[q : 2 * q, :q] -= np.outer(law.inverse_mass * law.charge, law.charge) / law.c0
    A[2 * q, 2 * q + 1] = 1.0
    if law.control is not None:
        A[2 * q + 2, [2 * q + 1, 2 * q + 2]] = -1.0 / law.control.rolloff
    return A


def _waveforms(law: Law, t: np.ndarray, x: np.ndarray) -> Waveforms:
    q = law.q
    u = law.rings @ x[:q]
    force = law.stiffness * np.maximum(u - x[2 * q] - law.gaps[:, None], 0.0)
    data = {
        "time": t, "sphere.y": x[2 * q] + law.radius, "sphere.v": x[2 * q + 1],
        "contact.force": force.sum(axis=0),
    }  # fmt: skip
    data |= {f"kick.u.ring{k}": row for k, row in enumerate(u)}
    return Waveforms(data, {"accepted": float(t.size)})
