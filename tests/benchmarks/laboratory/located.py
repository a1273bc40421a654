"""Event-driven integration of the loop and of the free impact: located contacts, exact flights."""

from dataclasses import replace

import numpy as np

from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.model import Scene
from laboratory.freemodes import FreeModes
from laboratory.law import HEIGHT, Law, Mode
from laboratory.pieces import Piece, coupled, flight
from laboratory.segments import initial, saturation, segments

_TOUCH = 1e-9  # m over the rings; nearer than this the sphere is not said to fly
_MAX_PIECES = 5_000  # a chattering contact beyond this is a modelling error, not a waveform


def located(law: Law, scene: Scene, rtol: float = 1e-9) -> Waveforms:
    """Integrate from the start of ``scene`` to its stop (paper 2.4, 3.2.3).

    Radau with an analytic Jacobian between located events (contact, clamp, pulse edges); far from
    contact the modes are propagated exactly. Sampled every microsecond and every 10 ns after the
    pulse's edges; an impact in 3000 steps.

    Raises
    ------
    SimulationError : contact chatters, the integrator gives up, the sphere leaves the force table.
    """
    pieces, events = _integrate(law, initial(law, scene), scene.stop, rtol)
    return _waveforms(law, pieces, np.union1d(_grid(law, scene), events))


def _integrate(
    law: Law, x: np.ndarray, stop: float, rtol: float
) -> tuple[list[Piece], list[float]]:
    """All pieces, and the times at which they end."""
    pieces: list[Piece] = []
    closed = law.penetration(x) > 0.0
    for segment in segments(law, stop):
        saturated = saturation(law, x, segment.enabled)
        mode = Mode(segment.start, segment.volt, segment.slope, segment.enabled, saturated)
        while mode.start < segment.end:
            if len(pieces) >= _MAX_PIECES:
                raise SimulationError("contact chatters without end", where=f"t = {mode.start} s")
            piece = _step(law, mode, x, segment.end, closed, rtol)
            pieces.append(piece)
            x = piece.last
            closed = _closed(law, x, closed, piece.fired)
            saturated = _toggled(mode.saturated, piece.fired)
            mode = replace(mode, start=piece.end, volt=mode.voltage(piece.end), saturated=saturated)
    return pieces, [piece.end for piece in pieces]


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
    toggled = np.array([f"ring{i}" in fired for i in range(closed.size)])
    return np.where(toggled, ~closed, law.penetration(x) > 0.0)


def _toggled(saturated: int, fired: tuple[str, ...]) -> int:
    if "upper limit" in fired:
        return 0 if saturated == 1 else 1
    if "lower limit" in fired:
        return 0 if saturated == -1 else -1
    return saturated


def _grid(law: Law, scene: Scene) -> np.ndarray:
    if scene.only("throw") is not None:
        return np.linspace(0.0, scene.stop, 3001)
    coarse = np.linspace(0.0, scene.stop, max(2, round(scene.stop / 1e-6) + 1))
    if law.drive is None:
        return coarse
    d = law.drive
    edges = d.start, d.start + d.width
    fine = [np.arange(edge - 1e-6, edge + 75e-6, 10e-9) for edge in edges]
    corners = [(edge, edge + d.edge) for edge in edges]
    both = np.unique(np.concatenate((coarse, *fine, *corners)))
    return both[(both >= 0.0) & (both <= scene.stop)]


def _waveforms(law: Law, pieces: list[Piece], times: np.ndarray) -> Waveforms:
    owner = np.searchsorted([p.end for p in pieces[:-1]], times, side="left")
    states = [pieces[k].state(times[owner == k]) for k in np.unique(owner)]
    return law.waveforms(times, np.concatenate(states, axis=1), sum(p.steps for p in pieces))
