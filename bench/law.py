"""Equations of motion of the kick-and-catch loop, in displacement-scaled modal coordinates.

Written from the paper's equations (8) to (11), apart from the netlist and its parts, so that the
two can be compared. All quantities are of the whole device, in SI.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.interpolate import CubicSpline

from bench.setup import keys_of
from kc2spice.bodies.stack_keys import SECTORS
from kc2spice.core.errors import SimulationError
from kc2spice.core.magnets import MagnetostaticTable
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.bodies.piezo_stack import KickPulse
from kc2spice.parts.control.pid import PidKeys
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.modal_models import compute_resonators

# States after the 2 q modal ones, and their number.
HEIGHT, SPEED, RATE, INTEGRAL = range(4)
EXTRA = 4


@dataclass(frozen=True)
class Mode:
    """Constants of one smooth piece: drive ramp, controller state.

    ``voltage(t) = volt + slope (t - start)``; ``saturated`` is -1, 0 or +1, None where the current
    itself tells.
    """

    start: float
    volt: float
    slope: float
    enabled: bool
    end: float
    saturated: int | None = None

    def voltage(self, t):
        """Prescribed anode voltage [V] at one time or an array of them."""
        return self.volt + self.slope * (t - self.start)


@dataclass(frozen=True)
class ForceMap:
    """``F(y, i) = f0(y) + f1(y) i + f2(y) i^2`` with ``i1 = -i`` and ``i2 = +i`` (paper 2.4).

    Not-a-knot cubic splines through the FE positions; ``knots`` (n,), ``coefficients``
    (4, n - 1, 3), highest power first.
    """

    knots: np.ndarray
    coefficients: np.ndarray

    @classmethod
    def of(cls, table):
        """Combine the six coefficient functions for opposed equal currents."""
        c0, c1, c2, c11, c12, c22 = table.coefficients.T
        columns = (c0, c2 - c1, c11 - c12 + c22)
        spline = CubicSpline(table.y, np.column_stack(columns), bc_type="not-a-knot")
        return cls(spline.x, spline.c)

    def __call__(self, y, current):
        """Force [N], dF/dy [N/m] and dF/di [N/A] at one position; the end cubics go on outside."""
        j = min(max(int(self.knots.searchsorted(y, side="right")) - 1, 0), self.knots.size - 2)
        s = y - self.knots[j]
        c3, c2, c1, c0 = self.coefficients[:, j]
        value = ((c3 * s + c2) * s + c1) * s + c0
        slope = (3 * c3 * s + 2 * c2) * s + c1
        powers = np.array((1.0, current, current * current))
        return (
            float(value @ powers),
            float(slope @ powers),
            float(value[1] + 2 * current * value[2]),
        )


@dataclass(frozen=True)
class Law:
    """The loop as ``x' = rhs(t, x)`` with ``x = [a (q), b (q), p, v, d, I]``.

    ``a = scale z`` and ``b = scale z' / omega`` are modal amplitudes in metres of ring motion,
    ``p = y - R`` the sphere's height over its touching position, ``d`` the rolled-off error rate,
    ``I`` the integral part of the current::

        a' = omega b,   b' = -omega a - damp b + scale / omega (e V - G F)
        m v' = sum_i F_i - m g + F_em(y, i),   F_i = k max(0, u_i - p - gap_i)
        d' = (-v - d) / Tf,   I' = KI (setpoint - y),   i = clamp(KP (setpoint - y) + I + KD d)
    """

    omega: np.ndarray
    damp: np.ndarray
    scale: np.ndarray
    rings: np.ndarray  # (n, q): u = rings a
    charge: np.ndarray  # (q,): Q = c0 V + charge a
    c0: float
    electrical: str
    stiffness: float
    gaps: np.ndarray
    radius: float
    mass: float
    gravity: float
    force_map: ForceMap | None
    control: PidKeys | None
    drive: KickPulse | None

    @property
    def q(self):
        """Number of modes."""
        return self.omega.size

    @property
    def inverse_mass(self):
        """(q,) ``scale^2 / omega``: a generalised force ``gain / scale`` drives ``b`` by this."""
        return self.scale**2 / self.omega

    @cached_property
    def linear(self):
        """(n, n): modes, the charge of a floating anode, kinematics and roll-off."""
        q = self.q
        A, diag = np.zeros((2 * q + EXTRA, 2 * q + EXTRA)), np.arange(q)
        A[diag, q + diag], A[q + diag, diag] = self.omega, -self.omega
        A[q + diag, q + diag] = -self.damp
        if self.electrical == "open":
            A[q : 2 * q, :q] -= np.outer(self.inverse_mass * self.charge, self.charge) / self.c0
        A[2 * q + HEIGHT, 2 * q + SPEED] = 1.0
        if self.control is not None:
            A[2 * q + RATE, [2 * q + SPEED, 2 * q + RATE]] = -1.0 / self.control.rolloff
        return A

    def with_contact(self, closed):
        """``linear`` with the springs of the closed rings."""
        q, A = self.q, self.linear.copy()
        p, v, rings = 2 * q + HEIGHT, 2 * q + SPEED, self.rings[closed]
        if len(rings):
            pull = self.stiffness * rings.sum(axis=0)
            A[q : 2 * q, :q] -= self.stiffness * (self.inverse_mass[:, None] * rings.T) @ rings
            A[q : 2 * q, p] = self.inverse_mass * pull
            A[v, :q] = pull / self.mass
            A[v, p] = -self.stiffness * len(rings) / self.mass
        return A

    @cached_property
    def sphere(self):
        """The sphere alone: the law without any mode."""
        none = np.zeros(0)
        return replace(
            self, omega=none, damp=none, scale=none, rings=self.rings[:, :0], charge=none
        )

    def penetration(self, x):
        """(n,) or (n, nt) ring penetrations [m] of one state or of columns of states."""
        gaps = self.gaps if x.ndim == 1 else self.gaps[:, None]
        return self.rings @ x[: self.q] - x[2 * self.q + HEIGHT] - gaps

    def waveforms(self, t, x, steps):
        """Results of the states (n, nt) at the times ``t``, from so many steps."""
        u, force = self.rings @ x[: self.q], np.maximum(0.0, self.penetration(x))
        y, v = x[2 * self.q + HEIGHT] + self.radius, x[2 * self.q + SPEED]
        return waveforms(t, y, v, self.stiffness * force.sum(axis=0), u, steps)

    def check_height(self, height):
        """Raise SimulationError if the sphere was outside the force table."""
        if self.force_map is None:
            return
        low, high = self.force_map.knots[[0, -1]]
        y = self.radius + height
        outside = y[(y < low) | (y > high)]
        if outside.size:
            raise SimulationError(
                "the sphere left the force table",
                where="sphere",
                got=f"y = {outside[0]:.4e} m",
                expected=f"{low:.4e} to {high:.4e} m",
                hint="widen catch.y_min .. catch.y_max, or check the gains and the polarity",
            )

    def demand(self, rest):
        """Current that the controller asks for before the clamp [A], from the last four states."""
        c, (p, _, rate, integral) = self.control, rest.tolist()
        assert c is not None
        return float(c.kp * (c.setpoint - self.radius - p) + integral + c.kd * rate)

    def clamped(self, rest):
        """The demand within the controller's limits [A]."""
        assert self.control is not None
        limit = self.control.current_limit
        return min(max(self.demand(rest), -limit), limit)

    def _current(self, x, mode):
        """Coil current [A], and whether its integral part follows the error."""
        if self.control is None or not mode.enabled:
            return 0.0, False
        current = self.clamped(x[-EXTRA:])
        if mode.saturated is None:
            return current, current == self.demand(x[-EXTRA:])
        return current, mode.saturated == 0

    def rhs(self, t, x, mode):
        """Rates of the state, as lean as numpy allows."""
        q, p = self.q, float(x[2 * self.q + HEIGHT])
        force = self.stiffness * np.maximum(self.rings @ x[:q] - p - self.gaps, 0.0)
        rates = self.linear @ x
        load = mode.voltage(t) * self.charge - force @ self.rings
        rates[q : 2 * q] += self.inverse_mass * load
        current, follows = self._current(x, mode)
        pull = self.force_map(p + self.radius, current)[0] if self.force_map else 0.0
        rates[2 * q + SPEED] = (force.sum() + pull) / self.mass - self.gravity
        if follows and self.control is not None:
            rates[2 * q + INTEGRAL] = self.control.ki * (self.control.setpoint - self.radius - p)
        return rates

    def jacobian(self, t, x, mode):
        """Analytic derivative of ``rhs``; contact enters by the rings that are closed."""
        q, closed = self.q, self.penetration(x) > 0.0
        p, v, J = 2 * q + HEIGHT, 2 * q + SPEED, self.with_contact(closed)
        if self.force_map is not None:
            current, follows = self._current(x, mode)
            _, slope, gain = self.force_map(float(x[p]) + self.radius, current)
            J[v, p] += slope / self.mass
            c = self.control
            if c is not None and follows:
                J[v, 2 * q :] += gain * np.array((-c.kp, 0.0, c.kd, 1.0)) / self.mass
                J[2 * q + INTEGRAL, p] = -c.ki
        return J


def waveforms(t, y, v, force, u, steps):
    """Height and velocity of the sphere, force on it, and rows of displacements of the rings."""
    data = {"time": t, "sphere.y": y, "sphere.v": v, "contact.force": force}
    data |= {f"kick.u.ring{k}": row for k, row in enumerate(u)}
    return Waveforms(data, {"accepted": float(steps)})


def law(build):
    """The equations of a scene with one chip, one contact and one sphere.

    The scene's contact penalty is that of a ring of one symmetry sector (paper eq. 10).

    Raises
    ------
    UsageError : a part is missing.
    SimulationError : a model with rigid motion, or feed-through besides the capacitance.
    """
    scene = build.scene
    kick, sphere = keys_of(scene, "piezo_stack"), keys_of(scene, "sphere")
    model = compute_resonators(build.model(scene.list_parts("piezo_stack")[0], LinearModel))
    rings = [k for k, port in enumerate(model.ports) if port.kind == "mechanical"]
    (anode,) = (k for k, port in enumerate(model.ports) if port.kind == "electrical")
    static = model.D.copy()
    static[anode, anode] = 0.0
    if np.any(static) or np.any(model.omega <= 0.0) or model.massless:
        raise SimulationError(
            "the benchmark needs inertia, positive frequencies and no feed-through but the "
            "capacitance", where="kick model", hint='set contact.inertia = "lumped"',
        )  # fmt: skip
    gain, drive = model.gain[:, rings], model.gain[:, anode]
    radii = np.arange(len(rings)) * kick.mesh.ring_spacing
    floor = np.abs(gain).max() / max(np.abs(drive).max(), 1e-300)
    scale = np.maximum(np.abs(gain).max(axis=1), np.abs(drive) * floor)
    scale = np.maximum(scale, 1e-12 * scale.max())
    coils, control = scene.find_only_part("ring_magnet_coils"), scene.find_only_part("pid")
    table: MagnetostaticTable | None = (
        None if coils is None else build.model(coils, MagnetostaticTable)
    )
    return Law(
        omega=model.omega,
        damp=model.damp,
        scale=scale,
        rings=(gain / scale[:, None]).T.copy(),
        charge=drive / scale,
        c0=float(model.D[anode, anode]),
        electrical=kick.electrical,
        stiffness=SECTORS * keys_of(scene, "contact").penalty,
        gaps=sphere.radius - np.sqrt(sphere.radius**2 - radii**2),
        radius=sphere.radius,
        mass=sphere.mass,
        gravity=scene.gravity,
        force_map=None if table is None else ForceMap.of(table),
        control=None if control is None else control.keys,
        drive=kick.drive if kick.electrical == "driven" else None,
    )
