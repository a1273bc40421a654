"""Equilibrium and imprint of the resonator model in closed form."""

import numpy as np
from scipy.optimize import brentq

from bench.law import EXTRA, HEIGHT
from kc2spice.core.errors import SimulationError


def compliance(equations):
    """(n, n) static compliance of the rings [m/N]: anode shorted, or floating with no charge.

    ``S = G' diag(1/omega^2) G``; a floating anode takes off ``s s' / (c0 + e' diag(1/omega^2) e)``.
    """
    weight = (equations.scale / equations.omega) ** 2
    rings, charge = equations.rings, equations.charge
    shorted = (rings * weight) @ rings.T
    if equations.electrical != "open":
        return shorted
    cross = rings @ (weight * charge)
    return shorted - np.outer(cross, cross) / (equations.c0 + (weight * charge) @ charge)


def contact_forces(compliant, stiffness, overlap):
    """Ring forces (m, n) [N] with ``F = k max(0, overlap - S F)`` by semi-smooth Newton.

    ``overlap`` (m, n) are the penetrations that would be there without forces, of m cases; cases
    with the same closed rings share one factorisation.
    """
    closed, soft = overlap > 0.0, np.diag(1 / np.broadcast_to(stiffness, overlap.shape[1]))
    bits = 1 << np.arange(overlap.shape[1])  # a set of closed rings as one number
    for _ in range(4 * overlap.shape[1] + 10):
        force = np.zeros(overlap.shape)
        _, first, member = np.unique(closed @ bits, return_index=True, return_inverse=True)
        for number, touching in enumerate(closed[first]):
            cases = np.ix_(member == number, touching)
            system = (compliant + soft)[np.ix_(touching, touching)]
            force[cases] = np.linalg.solve(system, overlap[cases].T).T
        now = overlap - force @ compliant.T > 0.0
        if np.array_equal(now, closed):
            return force
        closed = now
    raise SimulationError("static contact did not converge", where="contact", got=f"{overlap}")


def rest(equations):
    """Full state of the sphere resting on the chip, coils dead and anode at 0 V."""
    soft = compliance(equations)

    def forces(p):
        return contact_forces(soft, equations.stiffness, (-p - equations.gaps)[None])[0]

    def surplus(p):
        pull = 0.0
        if equations.force_map is not None:
            pull = equations.force_map(p + equations.radius, 0.0)[0]
        return forces(p).sum() + pull - equations.mass * equations.gravity

    if surplus(0.0) >= 0.0:
        raise SimulationError(
            "the sphere does not rest on the chip: nothing presses it down",
            where="sphere",
            got=f"net force {surplus(0.0):.3e} N upwards when it just touches",
        )
    low = -1e-9
    while surplus(low) < 0.0:
        low *= 4.0
    p = brentq(surplus, low, 0.0, xtol=1e-24, rtol=1e-15)
    x = np.zeros(2 * equations.q + EXTRA)
    weight = (equations.scale / equations.omega) ** 2
    load = -forces(p) @ equations.rings
    if equations.electrical == "open":
        volt = -(equations.charge * weight) @ load
        volt /= equations.c0 + (weight * equations.charge) @ equations.charge
        load = load + equations.charge * volt
    x[: equations.q] = weight * load
    x[2 * equations.q + HEIGHT] = p
    return x


def pushed(equations, depth):
    """Whole contact force [N] (m,) at each imprint ``depth`` [m] (paper Fig. 8)."""
    soft = compliance(equations)
    force = contact_forces(soft, equations.stiffness, depth[:, None] - equations.gaps)
    return np.asarray(force.sum(axis=1))
