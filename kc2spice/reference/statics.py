"""Equilibrium, imprint and harmonic response of the resonator model in closed form."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from kc2spice.core.errors import SimulationError
from kc2spice.core.waveforms import Waveforms
from kc2spice.fem.magnetics.table import EMTable
from kc2spice.reference.law import EXTRA, HEIGHT, Law, law
from kc2spice.rom.modal import Resonators
from kc2spice.scene.need import need
from kc2spice.scene.schema import Scene


def compliance(equations: Law) -> np.ndarray:
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


def contact_forces(compliant: np.ndarray, stiffness: float, overlap: np.ndarray) -> np.ndarray:
    """Ring forces (m, n) [N] with ``F = k max(0, overlap - S F)`` by semi-smooth Newton.

    ``overlap`` (m, n) are the penetrations that would be there without forces, of m cases; cases
    with the same closed rings share one factorisation.
    """
    closed = overlap > 0.0
    bits = 1 << np.arange(overlap.shape[1])  # a set of closed rings as one number
    for _ in range(4 * overlap.shape[1] + 10):
        force = np.zeros(overlap.shape)
        _, first, member = np.unique(closed @ bits, return_index=True, return_inverse=True)
        for number, touching in enumerate(closed[first]):
            cases = np.ix_(member == number, touching)
            system = compliant[np.ix_(touching, touching)] + np.eye(touching.sum()) / stiffness
            force[cases] = np.linalg.solve(system, overlap[cases].T).T
        now = overlap - force @ compliant.T > 0.0
        if np.array_equal(now, closed):
            return force
        closed = now
    raise SimulationError("static contact did not converge", where="contact", got=f"{overlap}")


def rest(equations: Law) -> np.ndarray:
    """Full state of the sphere resting on the chip, coils dead and anode at 0 V."""
    soft = compliance(equations)

    def forces(p: float) -> np.ndarray:
        return contact_forces(soft, equations.stiffness, (-p - equations.gaps)[None])[0]

    def surplus(p: float) -> float:
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


def imprint(
    model: Resonators, scene: Scene, table: EMTable | None = None, sectors: int = 4
) -> Waveforms:
    """Whole contact force against imprint depth, 0 to ``scene.imprint.depth`` (paper Fig. 8).

    Arrays ``imprint.depth`` [m], ``contact.force``, ``contact.force.R0``... [N].
    """
    equations = law(model, scene, table, sectors)
    soft = compliance(equations)
    push = need(scene.imprint, "imprint")
    depth = np.linspace(0.0, push.depth, push.steps + 1)
    force = contact_forces(soft, equations.stiffness, depth[:, None] - equations.gaps)
    data = {"imprint.depth": depth, "contact.force": force.sum(axis=1)}
    data |= {f"contact.force.R{i}": column for i, column in enumerate(force.T)}
    return Waveforms(data, {})


def transfer(model: Resonators, frequency: np.ndarray, electrical: str) -> np.ndarray:
    """(nf, p, p) outputs per unit input: ``H_kl = sum_j g_jk g_jl / (w_j^2 - w^2 + i w d_j) + D``.

    ``driven`` and ``short`` take the anode's voltage in and give its charge; ``open`` takes its
    charge and gives its voltage (paper eq. 8), by the partial inverse of the former.
    """
    w = 2 * np.pi * np.asarray(frequency)[:, None]
    poles = 1.0 / (model.omega**2 - w**2 + 1j * w * model.damp)
    full = np.einsum("jk,fj,jl->fkl", model.gain, poles, model.gain) + model.D
    if electrical != "open":
        return full
    (e,) = (k for k, port in enumerate(model.ports) if port.kind == "electrical")
    pivot = full[:, e, e][:, None, None]
    column, row = full[:, :, e : e + 1] / pivot, full[:, e : e + 1, :] / pivot
    inverse = full - column * full[:, e : e + 1, :]
    inverse[:, :, e : e + 1] = column
    inverse[:, e : e + 1, :] = -row
    inverse[:, e : e + 1, e : e + 1] = 1.0 / pivot
    return inverse


def harmonic(model: Resonators, scene: Scene) -> Waveforms:
    """Transfer functions over the scene's sweep (paper Figs 7 and A1).

    Arrays ``frequency`` (nf,) and, complex, ``INPUT>OUTPUT`` (nf,) for every pair of ports.
    """
    sweep = need(scene.harmonic, "harmonic")
    frequency = np.linspace(sweep.start, sweep.stop, sweep.steps + 1)[1:]
    full = transfer(model, frequency, need(scene.kick, "kick").electrical)
    return spectra(frequency, full, [port.name for port in model.ports])


def spectra(frequency: np.ndarray, response: np.ndarray, names: Sequence[str]) -> Waveforms:
    """Name the entries of ``response`` (nf, outputs, inputs) ``INPUT>OUTPUT``."""
    data = {
        f"{source}>{sink}": response[:, k, j]
        for j, source in enumerate(names)
        for k, sink in enumerate(names)
    }
    return Waveforms({"frequency": frequency} | data, {})
