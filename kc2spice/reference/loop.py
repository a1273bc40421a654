"""Event-driven integration of the loop and of the free impact, with an energy book."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.magnetics.table import EMTable
from kc2spice.reference.flight import FreeModes
from kc2spice.reference.law import (
    E_DAMPED,
    E_EM,
    E_IN,
    EXTRA,
    HEIGHT,
    SPEED,
    Law,
    Mode,
    law,
)
from kc2spice.reference.pieces import Piece, coupled, flight
from kc2spice.reference.statics import rest
from kc2spice.rom.modal import Resonators
from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene

_TOUCH = 1e-9  # m over the rings; nearer than this the sphere is not said to fly
_MAX_PIECES = 5_000  # a chattering contact beyond this is a modelling error, not a waveform


@dataclass(frozen=True)
class Event:
    """A located instant: a ring closes or opens, the current meets or leaves its limit."""

    time: float
    what: str


@dataclass(frozen=True)
class EnergyBook:
    """Energy in joules over the whole run; ``residual`` is what the book cannot explain.

    ``electrical_in + em_work = change of (stored + capacitor + spring + sphere) + damped``.
    """

    electrical_in: float
    em_work: float
    damped: float
    stored: tuple[float, float]
    capacitor: tuple[float, float]
    spring: tuple[float, float]
    sphere: tuple[float, float]

    @property
    def residual(self) -> float:
        """What came in less what is still there or was damped [J]."""
        change = sum(b - a for a, b in (self.stored, self.capacitor, self.spring, self.sphere))
        return self.electrical_in + self.em_work - self.damped - change


@dataclass(frozen=True)
class Reference:
    """Waveforms with the names of ``waveforms.npz``, located events and the energy book."""

    waves: Waveforms
    events: tuple[Event, ...]
    energy: EnergyBook


def kick_and_catch(
    model: Resonators,
    scene: Scene,
    table: EMTable | None,
    *,
    rtol: float = 1e-9,
    times: np.ndarray | None = None,
    sectors: int = 4,
) -> Reference:
    """Integrate the closed loop from static equilibrium to ``scene.solver.stop`` (paper 2.4).

    ``model`` is the whole device; ``times`` defaults to a 1 us grid that is 10 ns fine after the
    pulse's edges. Radau with an analytic Jacobian between located events (contact, clamp, pulse
    edges); far from contact the modes are propagated exactly. Raises SimulationError.
    """
    equations = law(model, scene, table, sectors)
    return _run(equations, rest(equations), scene.solver.stop, rtol, times)


def impact(
    model: Resonators,
    scene: Scene,
    *,
    rtol: float = 1e-9,
    times: np.ndarray | None = None,
    sectors: int = 4,
) -> Reference:
    """Throw the free sphere onto the chip at rest (paper 3.2.3); anode open (Q = 0) or shorted."""
    equations = law(model, scene, None, sectors)
    x = np.zeros(2 * equations.q + EXTRA)
    throw = need(scene.impact, "impact")
    x[2 * equations.q + HEIGHT] = throw.gap
    x[2 * equations.q + SPEED] = throw.velocity
    if times is None:
        times = np.linspace(0.0, scene.solver.stop, 3001)
    return _run(equations, x, scene.solver.stop, rtol, times)


def _run(law: Law, x: np.ndarray, stop: float, rtol: float, times: np.ndarray | None) -> Reference:
    pieces, events = _integrate(law, x, stop, rtol)
    if times is None:
        times = _grid(law, stop)
    waves = _waveforms(law, pieces, np.union1d(times, [e.time for e in events]))
    return Reference(waves, tuple(events), _book(law, x, pieces))


def _ramps(law: Law, stop: float) -> list[tuple[float, float, float, bool]]:
    """(start, volt, slope, enabled) of every stretch between pulse edges and the enable time."""
    corners, volts = np.array([0.0]), np.array([0.0])
    if law.drive is not None:
        d = law.drive
        rise = d.start + np.array([0.0, d.edge, d.width, d.width + d.edge])
        corners = np.concatenate((corners, rise))
        volts = np.concatenate((volts, [0.0, d.voltage, d.voltage, 0.0]))
    enable = law.control.enable_at if law.control is not None else np.inf
    marks = np.unique(np.concatenate((corners, [enable, stop])))
    marks = marks[marks <= stop]
    level = np.interp(marks, corners, volts)
    slope = np.diff(level) / np.diff(marks)
    return [
        (a, v, s, a >= enable) for a, v, s in zip(marks[:-1], level[:-1], slope, strict=True)
    ] + [(stop, 0.0, 0.0, False)]


def _integrate(
    law: Law, x: np.ndarray, stop: float, rtol: float
) -> tuple[list[Piece], list[Event]]:
    pieces: list[Piece] = []
    events: list[Event] = []
    ramps = _ramps(law, stop)
    closed = law.penetration(x) > 0.0
    for (start, volt, slope, enabled), (end, *_) in pairwise(ramps):
        mode = Mode(start, volt, slope, enabled, _saturation(law, x, enabled))
        while mode.start < end:
            if len(pieces) >= _MAX_PIECES:
                raise SimulationError("contact chatters without end", where=f"t = {mode.start} s")
            piece = _step(law, mode, x, end, closed, rtol)
            pieces.append(piece)
            x = piece.last
            before, closed = closed, _closed(law, x, closed, piece.fired)
            saturated = _toggled(mode.saturated, piece.fired)
            events += _events(piece.end, before, closed, mode.saturated, saturated)
            mode = replace(mode, start=piece.end, volt=mode.voltage(piece.end), saturated=saturated)
    return pieces, events


def _step(
    law: Law, mode: Mode, x: np.ndarray, end: float, closed: np.ndarray, rtol: float
) -> Piece:
    if law.electrical == "open":  # charge constraint couples the modes: no exact flight
        return coupled(law, mode, x, end, closed, np.inf, rtol)
    free = FreeModes.of(law, mode, mode.start, x)
    reach, height = free.reach(end), x[2 * law.q + HEIGHT]
    # A margin: while the modes die away under a falling sphere, flights would follow each other in
    # ever shorter pieces.
    if height > 1.1 * reach + _TOUCH and not closed.any():
        return flight(law, mode, x, end, free, reach, rtol)
    return coupled(law, mode, x, end, closed, max(1.2 * reach, height + 1e-6), rtol)


def _closed(law: Law, x: np.ndarray, closed: np.ndarray, fired: tuple[str, ...]) -> np.ndarray:
    """Which rings touch after a piece: those that fired toggled, the others by their sign."""
    toggled = np.array([f"R{i}" in fired for i in range(closed.size)])
    return np.where(toggled, ~closed, law.penetration(x) > 0.0)


def _saturation(law: Law, x: np.ndarray, enabled: bool) -> int:
    if not enabled:
        return 0
    rest = x[2 * law.q :]
    return int(np.sign(law.demand(rest) - law.current(rest, Mode(enabled=True))))


def _toggled(saturated: int, fired: tuple[str, ...]) -> int:
    if "upper limit" in fired:
        return 0 if saturated == 1 else 1
    if "lower limit" in fired:
        return 0 if saturated == -1 else -1
    return saturated


def _events(time: float, before: np.ndarray, after: np.ndarray, was: int, now: int) -> list[Event]:
    verbs = {True: "closes", False: "opens"}
    found = [Event(time, f"R{i} {verbs[bool(after[i])]}") for i in np.flatnonzero(before != after)]
    if was != now:
        found.append(Event(time, "current meets its limit" if now else "current leaves its limit"))
    return found


def _grid(law: Law, stop: float) -> np.ndarray:
    coarse = np.linspace(0.0, stop, max(2, round(stop / 1e-6) + 1))
    if law.drive is None:
        return coarse
    d = law.drive
    edges = d.start, d.start + d.width
    fine = [np.arange(edge - 1e-6, edge + 75e-6, 10e-9) for edge in edges]
    corners = [(edge, edge + d.edge) for edge in edges]
    both = np.unique(np.concatenate((coarse, *fine, *corners)))
    return both[(both >= 0.0) & (both <= stop)]


def _waveforms(law: Law, pieces: list[Piece], times: np.ndarray) -> Waveforms:
    owner = np.searchsorted([p.end for p in pieces[:-1]], times, side="left")
    parts = []
    for k in np.unique(owner):
        t = times[owner == k]
        parts.append(_columns(law, pieces[k].mode, t, pieces[k].state(t)))
    data = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    return Waveforms(data, {"accepted": float(sum(p.steps for p in pieces))})


def _columns(law: Law, mode: Mode, t: np.ndarray, x: np.ndarray) -> dict[str, np.ndarray]:
    q, rest = law.q, x[2 * law.q :]
    rings, forces = law.rings @ x[:q], law.stiffness * np.maximum(0.0, law.penetration(x))
    y = law.radius + rest[HEIGHT]
    data = {"time": t, "sphere.y": y, "sphere.v": rest[SPEED]}
    data["contact.force"] = forces.sum(axis=0)
    data |= {f"contact.force.R{i}": row for i, row in enumerate(forces)}
    data |= {f"kick.u.R{i}": row for i, row in enumerate(rings)}
    if law.electrical == "open":
        data["kick.voltage"] = -(law.charge @ x[:q]) / law.c0
        data["kick.current"] = np.zeros(t.size)
    else:
        motional = law.charge @ (law.omega[:, None] * x[q : 2 * q])
        data["kick.voltage"] = mode.voltage(t)
        data["kick.current"] = law.c0 * mode.slope + motional
    if law.control is not None:
        current = law.current(rest, mode)
        data["coil.lower.current"], data["coil.upper.current"] = -current, current
        data["control.error"] = law.control.setpoint - y
    return data


def _book(law: Law, first: np.ndarray, pieces: list[Piece]) -> EnergyBook:
    last = pieces[-1].last
    extra = last[2 * law.q :]

    def sphere(x: np.ndarray) -> float:
        p, v = x[2 * law.q + HEIGHT], x[2 * law.q + SPEED]
        return float(law.mass * (0.5 * v * v + law.gravity * p))

    def capacitor(x: np.ndarray, mode: Mode, t: float) -> float:
        return 0.5 * law.c0 * law.voltage(t, x, mode) ** 2

    def spring(x: np.ndarray) -> float:
        return 0.5 * law.stiffness * float((np.maximum(0.0, law.penetration(x)) ** 2).sum())

    return EnergyBook(
        electrical_in=float(extra[E_IN]),
        em_work=float(extra[E_EM]),
        damped=float(extra[E_DAMPED]),
        stored=(law.modal_energy(first), law.modal_energy(last)),
        capacitor=(
            capacitor(first, pieces[0].mode, pieces[0].start),
            capacitor(last, pieces[-1].mode, pieces[-1].end),
        ),
        spring=(spring(first), spring(last)),
        sphere=(sphere(first), sphere(last)),
    )
