"""The catch actuator's force, flux and inductance, swept over the sphere's height.

Materials are linear, so at each height the four sources (ring magnet, sphere magnet, a current in
each coil) superpose: one factorisation and four right-hand sides give every current (paper 2.2.1
solves 369 cases instead).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import pi

import numpy as np

from kc2spice.fem.magnetics import mesh as magmesh
from kc2spice.fem.magnetics.forms import LOWER, RING, SPHERE, UPPER
from kc2spice.fem.magnetics.keys import Catch, Ring
from kc2spice.fem.magnetics.system import Pieces, assemble, condense
from kc2spice.fem.magnetics.table import EMTable

Progress = Callable[[int, int], None]


def catch_table(catch: Catch, radius: float, progress: Progress | None = None) -> EMTable:
    """Sweep the sphere over ``catch.positions`` heights from ``y_min`` to ``y_max``.

    ``progress(done, total)`` is called after each height.

    Raises
    ------
    UsageError : the sphere does not fit through the parts or leaves the air cylinder.
    SimulationError : a field that does not satisfy its equations.
    """
    y = positions(catch)
    forces = np.empty((y.size, 4, 4))
    fluxes = np.empty((y.size, 2, 4))
    unknowns = np.empty(y.size, dtype=int)
    for done, (index, pieces) in enumerate(_pieces(catch, radius, y, condense), 1):
        system = pieces.system(y[index])
        fields = system.solve(system.loads)
        forces[index] = system.force(fields)
        fluxes[index] = (pieces.energy + system.loads.T @ fields)[[LOWER, UPPER]]
        unknowns[index] = pieces.eliminated + system.free.size
        if progress is not None:
            progress(done, y.size)
    sign = ring_sign(catch)
    inductance = fluxes[:, :, [LOWER, UPPER]]
    magnets = sign * forces[:, RING] + forces[:, SPHERE]  # cross terms with both magnets
    return EMTable(
        y=y,
        c0=forces[:, RING, RING] + forces[:, SPHERE, SPHERE] + 2 * sign * forces[:, RING, SPHERE],
        c1=2 * magnets[:, LOWER],
        c2=2 * magnets[:, UPPER],
        c11=forces[:, LOWER, LOWER],
        c12=2 * forces[:, LOWER, UPPER],
        c22=forces[:, UPPER, UPPER],
        flux0=sign * fluxes[:, :, RING] + fluxes[:, :, SPHERE],
        inductance=(inductance + inductance.transpose(0, 2, 1)) / 2,
        resistance=np.array([coil_resistance(catch, coil) for coil in (catch.lower, catch.upper)]),
        unknowns=int(unknowns.max()),
    )


def positions(catch: Catch) -> np.ndarray:
    """Heights of the sphere's centre [m] that the table has."""
    return np.linspace(catch.y_min, catch.y_max, catch.positions)


def ring_sign(catch: Catch) -> float:
    """Direction of the ring's magnetisation relative to the sphere's, which is +y."""
    return 1.0 if catch.polarity == "parallel" else -1.0


def coil_resistance(catch: Catch, coil: Ring) -> float:
    """``rho l / S`` [Ohm] of ``turns`` circles with the coil's mean radius."""
    length = catch.turns * pi * (coil.inner + coil.outer)
    return catch.resistivity * length / (pi * catch.wire_diameter**2 / 4)


def _pieces(
    catch: Catch, radius: float, y: np.ndarray, prepare: Callable[[Pieces], Pieces]
) -> Iterator[tuple[int, Pieces]]:
    """Index and prepared pieces of each height; heights on one lattice share their meshes."""
    pitch = magmesh.lattice_pitch(catch, radius, (y[-1] - y[0]) / (y.size - 1))
    offset = np.round((y - y[0]) / pitch, 6) % 1.0
    for value in np.unique(offset):
        chosen = np.flatnonzero(offset == value)
        bore = magmesh.bore(catch, radius, pitch, y[chosen[0]], y[chosen[-1]])
        pieces = prepare(assemble(catch, bore))
        for index in chosen:
            yield int(index), pieces
