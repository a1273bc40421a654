"""A lower bound: how little time the loop needs if nothing but its own equations is solved.

Between two events the set of closed rings is fixed, and modes, springs and sphere are one linear
system ``x' = A x + c0 + c1 t``. Its eigenvectors give the state at any time; the instant at which a
ring closes or opens is located on that exact solution. Far from the chip the sphere is alone (see
``flight.c``). Benchmark code: it serves this loop only, not a circuit.
"""

from collections.abc import Callable

import numpy as np
from scipy.linalg import lu_solve
from scipy.optimize import brentq

from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.model import Scene
from laboratory.contactsets import ContactSets, Modes
from laboratory.kernel import Fly, flyer
from laboratory.law import Law
from laboratory.segments import Segment, initial, saturation, segments

Values = Callable[[np.ndarray], np.ndarray]
Log = list[tuple[np.ndarray, ...]]  # pieces of: time, p, v, u (rings), closed (rings)

SPAN = 2e-6  # s after which the magnets' pull is linearised anew
PIECES = 20_000


class LowerBound:
    """Runs one scene's transient; the eigenvectors of each contact set are made once and kept."""

    def __init__(self, law: Law, sampling: float = 20e-9, rtol: float = 1e-7) -> None:
        self.law, self.sampling = law, sampling
        self.fly: Fly = flyer(law, rtol)
        self.sets = ContactSets(law)

    def run(self, scene: Scene) -> Waveforms:
        """Waveforms of the whole transient, at the samples that were needed.

        Raises
        ------
        SimulationError : contact chatters, or the controller is not at its limit during contact.
        """
        log, x = [], initial(self.law, scene)
        closed = self._penetration(x) > 0.0
        for segment in segments(self.law, scene.stop):
            t, saturated = segment.start, saturation(self.law, x, segment.enabled)
            for _ in range(PIECES):
                if t >= segment.end:
                    break
                t, x, closed, saturated = self._piece(segment, t, x, closed, saturated, log)
            else:
                raise SimulationError("contact chatters without end", where=f"t = {t:g} s")
        return self._waveforms(log)

    def _piece(
        self, segment: Segment, t: float, x: np.ndarray, closed: np.ndarray, saturated: int,
        log: Log,
    ) -> tuple[float, np.ndarray, np.ndarray, int]:  # fmt: skip
        if closed.any():
            return (*self._linear(segment, t, x, closed, saturated, log), saturated)
        modes, still = self.sets.modes(closed), self._particular(segment, t, x, closed, 0.0)
        y = modes.inverse @ (x[: 2 * self.law.q] - still[0])
        rings = modes.rows[:-2]
        last = still[0] + still[1] * (segment.end - t)
        steady = np.maximum(*(np.abs(self.law.rings @ s[: self.law.q]) for s in (still[0], last)))
        reach = float((np.abs(rings * y).sum(axis=1) + steady).max())
        if x[2 * self.law.q] <= reach:
            return (*self._linear(segment, t, x, closed, saturated, log), saturated)
        sphere = x[2 * self.law.q :]
        flown = self.fly(sphere, t, segment.end, reach, saturated, segment.enabled)
        ahead = self._at(modes, y, still, np.array([flown.time - t]))[:, 0]
        zero = np.zeros((len(self.law.gaps), len(flown.track)))
        log.append((*flown.track.T, zero, zero))
        return flown.time, np.append(ahead, flown.state), closed, flown.saturated

    def _linear(
        self, segment: Segment, t: float, x: np.ndarray, closed: np.ndarray, saturated: int,
        log: Log,
    ) -> tuple[float, np.ndarray, np.ndarray]:  # fmt: skip
        """Exact motion until a ring toggles, the pull must be linearised anew, or the end."""
        law, closed_any = self.law, bool(closed.any())
        force = self._pull(x, segment, saturated, t)
        modes, still = self.sets.modes(closed), self._particular(segment, t, x, closed, force)
        size = self.sets.n if closed_any else 2 * law.q
        y = modes.inverse @ (x[:size] - still[0])
        span = segment.end - t
        if closed_any and self._quiet(modes, y, still, span, closed):
            times = np.array([span])
        else:
            span = min(span, SPAN)
            times = np.append(np.arange(self.sampling, span, self.sampling), span)

        def values(s: np.ndarray) -> np.ndarray:
            """(rings + 2, ns): displacements, height, velocity."""
            wave = np.exp(np.outer(modes.rates, s))
            rows = self.sets.select[:, :size] @ (still[0][:, None] + still[1][:, None] * s)
            rows += ((modes.rows * y) @ wave).real
            if not closed_any:
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
        touching = np.repeat(closed[:, None], times.size, axis=1)
        log.append((t + times, rows[-2], rows[-1], rows[:-2], touching))
        end = x.copy()
        ahead = self._at(modes, y, still, np.array([stop]))[:, 0]
        end[:size] = ahead
        if not closed_any:
            end[2 * law.q : 2 * law.q + 3] = self._ballistic(x, force, np.array([stop]))[:, 0]
        now = segment.end if t + stop >= segment.end * (1 - 1e-15) else t + stop
        return now, end, closed ^ toggled

    def _locate(
        self, values: Values, times: np.ndarray, first: int, wrong: np.ndarray, closed: np.ndarray
    ) -> tuple[float, np.ndarray]:
        """Earliest crossing of the rings that have the wrong sign at sample ``first``."""
        low = float(times[first - 1]) if first else 0.0
        found = []
        for ring in np.flatnonzero(wrong):

            def over(s: float, ring: int = int(ring)) -> float:
                row = values(np.array([s]))
                return float(row[ring, 0] - row[-2, 0] - self.law.gaps[ring])

            start = max(low, 1e-15)
            crossing = (over(start) > 0.0) == closed[ring]
            time = brentq(over, start, times[first], xtol=1e-18, rtol=1e-14) if crossing else start
            found.append((time, int(ring)))
        time = min(found)[0]
        toggled = np.zeros_like(closed)
        toggled[[ring for s, ring in found if s == time]] = True
        return time, toggled

    def _quiet(
        self, modes: Modes, y: np.ndarray, still: tuple[np.ndarray, np.ndarray], span: float,
        closed: np.ndarray,
    ) -> bool:  # fmt: skip
        """Whether what oscillates is too small for any ring to toggle within the span."""
        swing = np.abs(modes.rows * y).sum(axis=1)
        for state in (still[0], still[0] + still[1] * span):
            rows = self.sets.select @ state
            over = rows[:-2] - rows[-2] - self.law.gaps
            if np.any((over > 0.0) != closed) or np.any(np.abs(over) <= swing[:-2] + swing[-2]):
                return False
        return True

    def _particular(
        self, segment: Segment, t: float, x: np.ndarray, closed: np.ndarray, force: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """``X0 + X1 s`` that solves the driven system, s counted from ``t``."""
        law, q = self.law, self.law.q
        size = self.sets.n if closed.any() else 2 * q
        c0, c1 = np.zeros(self.sets.n), np.zeros(self.sets.n)
        if law.electrical != "open":
            volt = segment.volt + segment.slope * (t - segment.start)
            c0[q : 2 * q] = law.inverse_mass * law.charge * volt
            c1[q : 2 * q] = law.inverse_mass * law.charge * segment.slope
        gaps = law.stiffness * law.gaps * closed
        c0[q : 2 * q] += law.inverse_mass * (gaps @ law.rings)
        c0[2 * q + 1] = (force - self.sets.slope * x[2 * q] - gaps.sum()) / law.mass - law.gravity
        lu = self.sets.modes(closed).lu
        X1 = -lu_solve(lu, c1[:size])
        return lu_solve(lu, X1 - c0[:size]), X1

    def _at(
        self, modes: Modes, y: np.ndarray, still: tuple[np.ndarray, np.ndarray], s: np.ndarray
    ) -> np.ndarray:
        wave = np.exp(np.outer(modes.rates, s))
        return (
            (modes.vectors @ (y[:, None] * wave)).real + still[0][:, None] + still[1][:, None] * s
        )

    def _ballistic(self, x: np.ndarray, force: float, s: np.ndarray) -> np.ndarray:
        """Height, velocity and rolled-off rate over a short span in which the pull is linear."""
        p, v, d = x[2 * self.law.q :][:3]
        a, j = force / self.law.mass - self.law.gravity, self.sets.slope * v / self.law.mass
        height = p + s * (v + s * (a / 2 + s * j / 6))
        speed = v + s * (a + s * j / 2)
        if self.law.control is None:
            return np.array([height, speed, np.full_like(s, d)])
        # d' = (-v - d) / Tf with a quadratic v: a quadratic that follows and an exponential.
        T = self.sets.rolloff
        start = -v + T * (a - T * j)
        follow = -speed + T * (a + j * s - T * j)
        return np.array([height, speed, follow + (d - start) * np.exp(-s / T)])

    def _pull(self, x: np.ndarray, segment: Segment, saturated: int, t: float) -> float:
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

    def _penetration(self, x: np.ndarray) -> np.ndarray:
        return self.law.rings @ x[: self.law.q] - x[2 * self.law.q] - self.law.gaps

    def _waveforms(self, log: Log) -> Waveforms:
        t, p, v, u, closed = (np.concatenate(part, axis=-1) for part in zip(*log, strict=True))
        over = u - p - self.law.gaps[:, None]
        force = self.law.stiffness * np.where(closed, np.maximum(over, 0.0), 0.0)
        data = {
            "time": t, "sphere.y": p + self.law.radius, "sphere.v": v,
            "contact.force": force.sum(axis=0),
        }  # fmt: skip
        data |= {f"kick.u.ring{k}": row for k, row in enumerate(u)}
        return Waveforms(data, {"accepted": float(t.size)})
