"""A lower bound: how little time the loop needs if nothing but its own equations is solved.

Between two events the set of closed rings is fixed, and modes, springs and sphere are one linear
system ``x' = A x + c0 + c1 t``. Its eigenvectors give the state at any time; the instant at which a
ring closes or opens is located on that exact solution. Far from the chip the sphere is alone (see
``flight.c``, built once by the compiler). Benchmark code: it serves this loop only, not a circuit.
"""

import ctypes
import shutil
import subprocess
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy.linalg import eig, lu_factor, lu_solve
from scipy.optimize import brentq

from bench.law import waveforms
from bench.segments import initial, saturation, segments
from kc2spice.core.errors import MissingToolError, SimulationError

SPAN = 2e-6  # s after which the magnets' pull is linearised anew
PIECES = 20_000
SAMPLING = 20e-9  # s, near contact
RTOL = 1e-7  # of flights
SOURCE = Path(__file__).with_name("flight.c")
FLAGS = ("-O3", "-shared", "-fPIC")
# States below these, times the tolerance, count as zero: m, m/s, m/s, A.
SCALE = np.array([1e-6, 1e-2, 1e-2, 1e-3])
ROOM = 100_000  # points that one flight may take


class _Law(ctypes.Structure):
    _fields_ = (
        *((name, ctypes.c_double) for name in (
            "mass", "gravity", "radius", "kp", "ki", "kd", "rolloff", "limit", "setpoint",
            "enabled", "controlled", "pulled",
        )),
        ("cells", ctypes.c_int),
        ("knots", ctypes.c_void_p),
        ("spline", ctypes.c_void_p),
    )  # fmt: skip


@dataclass(frozen=True)
class Flown:
    """End of a flight: time, state (4,), clamp, and ``track`` (n, 3) of time, height, velocity."""

    time: float
    state: np.ndarray
    saturated: int
    track: np.ndarray


@cache
def library():
    """The compiled ``flight.c``."""
    compiler = shutil.which("cc")
    if compiler is None:
        raise MissingToolError("no C compiler", where="cc", hint="apt-get install gcc")
    with tempfile.TemporaryDirectory() as folder:
        file = f"{folder}/flight.so"
        command = [compiler, *FLAGS, str(SOURCE), "-o", file, "-lm"]
        built = subprocess.run(command, capture_output=True, text=True, check=False)
        if built.returncode:
            raise MissingToolError("the C compiler failed", where=compiler, got=built.stderr[-500:])
        return ctypes.CDLL(file)


def flyer(law):
    """``fly(state, t, end, near, saturated, enabled)`` for the sphere of ``law``."""
    fly, track = library().flight, np.empty((ROOM, 3))
    fly.restype = ctypes.c_int
    knots, spline = np.zeros(2), np.zeros((1, 4, 3))
    if law.force_map is not None:
        knots = np.ascontiguousarray(law.force_map.knots)
        spline = np.ascontiguousarray(law.force_map.coefficients.transpose(1, 0, 2))
    c = law.control
    gains = (c.kp, c.ki, c.kd, c.rolloff, c.current_limit, c.setpoint) if c else (0.0,) * 6

    def run(state, t, end, near, saturated, enabled):
        constants = _Law(
            law.mass, law.gravity, law.radius, *gains, float(enabled), float(c is not None),
            float(law.force_map is not None), len(spline), knots.ctypes.data, spline.ctypes.data,
        )  # fmt: skip
        x, now, mode = state.copy(), ctypes.c_double(t), ctypes.c_int(saturated)
        count = fly(
            ctypes.byref(constants), ctypes.c_void_p(x.ctypes.data), ctypes.byref(now),
            ctypes.c_double(end), ctypes.c_double(near), ctypes.c_double(RTOL),
            ctypes.c_void_p(SCALE.ctypes.data), ctypes.byref(mode),
            ctypes.c_void_p(track.ctypes.data), ctypes.c_int(ROOM),
        )  # fmt: skip
        if count < 0:
            raise SimulationError("the flight's integration failed", where=f"t = {now.value} s")
        clamp = saturated if mode.value == 2 else mode.value  # 2: it is near
        return Flown(now.value, x, clamp, track[:count].copy())

    return run


@dataclass(frozen=True)
class Modes:
    """Eigenvectors of one contact set: rates (k,), rows of interest, transformation to them."""

    rates: np.ndarray
    vectors: np.ndarray  # (n, k), those of conjugate pairs once, twice as large
    rows: np.ndarray  # (rings + 2, k): ring displacements, height, velocity
    inverse: np.ndarray  # (k, n)
    lu: tuple[np.ndarray, np.ndarray]


@dataclass(frozen=True)
class Motion:
    """``x(s) = V e^(r s) y + X0 + X1 s`` with one contact set."""

    modes: Modes
    y: np.ndarray
    X0: np.ndarray
    X1: np.ndarray

    def at(self, s):
        """State [a, b, p, v, d] at one time."""
        wave = np.exp(self.modes.rates * s)
        return (self.modes.vectors @ (self.y * wave)).real + self.X0 + self.X1 * s

    def rows(self, select, s):
        """``select`` of the state at many times."""
        still = select[:, : self.X0.size] @ (self.X0[:, None] + self.X1[:, None] * s)
        return still + ((self.modes.rows * self.y) @ np.exp(np.outer(self.modes.rates, s))).real

    def swing(self):
        """Bounds on what oscillates of the rows."""
        return np.abs(self.modes.rows * self.y).sum(axis=1)


class LowerBound:
    """Runs one scene's transient; the eigenvectors of each contact set are made once and kept.

    ``x' = A x`` is over ``x = [a, b, p, v, d]``; without contact over the modes alone.
    """

    def __init__(self, law):
        self.law, q, count = law, law.q, len(law.gaps)
        self.n = 2 * q + 3
        self.select = np.zeros((count + 2, self.n))
        self.select[:count, :q] = law.rings
        self.select[count, 2 * q] = self.select[count + 1, 2 * q + 1] = 1.0
        self.known, self.fly, self.slope = {}, flyer(law), 0.0
        if law.force_map is not None:  # dF/dp [N/m] at the chip, with the current for the set point
            side = 0.0 if law.control is None else np.sign(law.control.setpoint - law.radius)
            limit = 0.0 if law.control is None else law.control.current_limit
            self.slope = law.force_map(law.radius, float(side * limit))[1]

    def run(self, scene):
        """Waveforms of the whole transient, at the samples that were needed.

        Raises
        ------
        SimulationError : contact chatters, or the controller is not at its limit during contact.
        """
        log, x = [], initial(self.law, scene)  # pieces of: time, p, v, u (rings), closed (rings)
        closed = self.law.penetration(x) > 0.0
        for segment in segments(self.law, scene.stop_time):
            t, saturated = segment.start, saturation(self.law, x, segment.enabled)
            for _ in range(PIECES):
                if t >= segment.end:
                    break
                t, x, closed, saturated = self._piece(segment, t, x, closed, saturated, log)
            else:
                raise SimulationError("contact chatters without end", where=f"t = {t:g} s")
        t, p, v, u, closed = (np.concatenate(part, axis=-1) for part in zip(*log, strict=True))
        over = np.maximum(u - p - self.law.gaps[:, None], 0.0)
        force = self.law.stiffness * np.where(closed, over, 0.0).sum(axis=0)
        return waveforms(t, p + self.law.radius, v, force, u, t.size)

    def _modes(self, closed):
        key = closed.tobytes()
        if key not in self.known:
            A = self.law.with_contact(closed)[: self.n, : self.n]
            A[-2, -3] += self.slope / self.law.mass
            if self.law.control is None:
                A[-1, -1] = -1.0  # d, which stays 0
            if not closed.any():
                A = A[:-3, :-3]
            rates, vectors = eig(A)
            inverse = np.linalg.inv(vectors)
            kept = rates.imag >= 0.0
            twice = np.where(rates[kept].imag > 0.0, 2.0, 1.0)
            vectors = vectors[:, kept] * twice
            rows = self.select[:, : len(A)] @ vectors
            self.known[key] = Modes(rates[kept], vectors, rows, inverse[kept], lu_factor(A))
        return self.known[key]

    def _motion(self, segment, t, x, closed, force):
        """From ``x`` on, driven by the anode, the gaps and a force on the sphere."""
        law, q, modes = self.law, self.law.q, self._modes(closed)
        c0, c1 = np.zeros(self.n), np.zeros(self.n)
        if law.electrical != "open":
            c0[q : 2 * q] = law.inverse_mass * law.charge * segment.voltage(t)
            c1[q : 2 * q] = law.inverse_mass * law.charge * segment.slope
        gaps = law.stiffness * law.gaps * closed
        c0[q : 2 * q] += law.inverse_mass * (gaps @ law.rings)
        c0[2 * q + 1] = (force - self.slope * x[2 * q] - gaps.sum()) / law.mass - law.gravity
        size = modes.vectors.shape[0]
        X1 = -lu_solve(modes.lu, c1[:size])
        X0 = lu_solve(modes.lu, X1 - c0[:size])
        return Motion(modes, modes.inverse @ (x[:size] - X0), X0, X1)

    def _piece(self, segment, t, x, closed, saturated, log):
        if not closed.any():
            law, free = self.law, self._motion(segment, t, x, closed, 0.0)
            ends = free.X0, free.X0 + free.X1 * (segment.end - t)
            steady = np.maximum(*(np.abs(law.rings @ s[: law.q]) for s in ends))
            reach = float((free.swing()[:-2] + steady).max())
            if x[2 * law.q] > reach:
                sphere = x[2 * law.q :]
                flown = self.fly(sphere, t, segment.end, reach, saturated, segment.enabled)
                zero = np.zeros((len(law.gaps), len(flown.track)))
                log.append((*flown.track.T, zero, zero))
                x = np.append(free.at(flown.time - t), flown.state)
                return flown.time, x, closed, flown.saturated
        return (*self._linear(segment, t, x, closed, saturated, log), saturated)

    def _linear(self, segment, t, x, closed, saturated, log):
        """Exact motion until a ring toggles, the pull must be linearised anew, or the end."""
        law, touching, span = self.law, bool(closed.any()), segment.end - t
        force = self._pull(x, segment, saturated, t)
        motion = self._motion(segment, t, x, closed, force)
        if touching and self._quiet(motion, span, closed):
            times = np.array([span])
        else:
            span = min(span, SPAN)
            times = np.append(np.arange(SAMPLING, span, SAMPLING), span)

        def values(s):
            """(rings + 2, ns): displacements, height, velocity."""
            rows = motion.rows(self.select, s)
            if not touching:
                rows[-2:] = self._ballistic(x, force, s)[:2]
            return rows

        rows = values(times)
        over = rows[:-2] - rows[-2] - law.gaps[:, None]
        wrong = (over > 0.0) != closed[:, None]
        hit = np.flatnonzero(wrong.any(axis=0))
        stop, toggled = float(times[-1]), np.zeros_like(closed)
        if hit.size:
            stop, toggled = self._locate(values, times, int(hit[0]), wrong[:, hit[0]], closed)
            keep = times < stop
            times = np.append(times[keep], stop)
            rows = np.hstack([rows[:, keep], values(times[-1:])])
        all_closed = np.repeat(closed[:, None], times.size, axis=1)
        log.append((t + times, rows[-2], rows[-1], rows[:-2], all_closed))
        end, ahead = x.copy(), motion.at(stop)
        end[: ahead.size] = ahead
        if not touching:
            end[2 * law.q : self.n] = self._ballistic(x, force, stop)
        now = segment.end if t + stop >= segment.end * (1 - 1e-15) else t + stop
        return now, end, closed ^ toggled

    def _locate(self, values, times, first, wrong, closed):
        """Earliest crossing of the rings that have the wrong sign at sample ``first``."""
        start, found = max(float(times[first - 1]) if first else 0.0, 1e-15), []
        for ring in np.flatnonzero(wrong):

            def over(s, ring=ring):
                row = values(np.array([s]))
                return float(row[ring, 0] - row[-2, 0] - self.law.gaps[ring])

            crossing = (over(start) > 0.0) == closed[ring]
            time = brentq(over, start, times[first], xtol=1e-18, rtol=1e-14) if crossing else start
            found.append((time, ring))
        time = min(found)[0]
        toggled = np.zeros_like(closed)
        toggled[[ring for s, ring in found if s == time]] = True
        return time, toggled

    def _quiet(self, motion, span, closed):
        """Whether what oscillates is too small for any ring to toggle within the span."""
        swing = motion.swing()
        for state in (motion.X0, motion.X0 + motion.X1 * span):
            rows = self.select @ state
            over = rows[:-2] - rows[-2] - self.law.gaps
            if np.any((over > 0.0) != closed) or np.any(np.abs(over) <= swing[:-2] + swing[-2]):
                return False
        return True

    def _ballistic(self, x, force, s):
        """Height, velocity and rolled-off rate over a short span in which the pull is linear."""
        p, v, d = x[2 * self.law.q :][:3]
        a, j = force / self.law.mass - self.law.gravity, self.slope * v / self.law.mass
        height = p + s * (v + s * (a / 2 + s * j / 6))
        speed = v + s * (a + s * j / 2)
        if self.law.control is None:
            return np.array([height, speed, 0 * s])
        # d' = (-v - d) / Tf with a quadratic v: a quadratic that follows and an exponential.
        T = self.law.control.rolloff
        start = -v + T * (a - T * j)
        follow = -speed + T * (a + j * s - T * j)
        return np.array([height, speed, follow + (d - start) * np.exp(-s / T)])

    def _pull(self, x, segment, saturated, t):
        """Force of the magnets [N] with the current at its limit, or none yet."""
        if self.law.force_map is None:
            return 0.0
        current = 0.0
        if segment.enabled and self.law.control is not None:
            if saturated == 0:
                raise SimulationError(
                    "the current must be at its limit while the sphere is near the chip",
                    where=f"t = {t:g} s",
                )
            current = saturated * self.law.control.current_limit
        return self.law.force_map(x[2 * self.law.q] + self.law.radius, current)[0]
