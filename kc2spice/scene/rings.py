"""Which contact rings a scene needs: those that the sphere can reach, estimated before any FE.

What is estimated here is checked after the run, on its waveforms (:mod:`kc2spice.sim.truth`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from kc2spice.scene.schema import Kick, Material, Scene, Sphere

SWING = 2.0  # an elastic body overshoots a step of its load by as much again
SPARE = 1.25  # on the dent: the chip is neither a half-space nor pressed on more than a few rings


@dataclass(frozen=True)
class Reach:
    """How far the chip's surface can rise over the sphere's lowest point [m], and by what."""

    depth: float
    why: str


def ring_gaps(ring_radii: np.ndarray, sphere_radius: float) -> np.ndarray:
    """Gap [m] of every ring under a sphere that touches the centre: ``R - sqrt(R^2 - r^2)``.

    Written as ``r^2 / (R + sqrt(R^2 - r^2))``, which does not cancel.
    """
    r = np.asarray(ring_radii, dtype=float)
    return r**2 / (sphere_radius + np.sqrt(sphere_radius**2 - r**2))


def mesh_rings(kick: Kick) -> np.ndarray:
    """Radii [m] of the chip's rings, R0 (the centre node) first."""
    return kick.mesh.ring_spacing * np.arange(kick.mesh.rings + 1)


def kept_rings(scene: Scene) -> int:
    """How many rings, R0 first, are ports of the chip: as many as ``contact.rings`` says.

    A harmonic scene keeps all, a scene without contact none.
    """
    if scene.kick is None:
        return 0
    every = scene.kick.mesh.rings + 1
    if scene.experiment == "harmonic":
        return every
    if scene.contact is None or scene.sphere is None:
        return 0
    if scene.contact.rings == "all":
        return every
    if scene.contact.rings != "needed":
        return min(scene.contact.rings, every)
    gaps = ring_gaps(mesh_rings(scene.kick), scene.sphere.radius)
    return max(1, int(np.count_nonzero(gaps < reach(scene).depth)))


def reach(scene: Scene) -> Reach:
    """The largest of what imprint, impact, fall and kick can do; needs chip and sphere."""
    assert scene.kick is not None
    assert scene.sphere is not None
    if scene.imprint is not None:
        return Reach(scene.imprint.depth, "imprint.depth")
    found = [Reach(0.0, "its weight")]
    if scene.impact is not None:
        speed = math.hypot(scene.impact.velocity, _fall(scene.impact.gap, scene.gravity))
        found.append(Reach(_dent(scene.kick, scene.sphere, speed), f"impact at {speed:.3g} m/s"))
    if scene.catch is not None:
        speed = _fall(scene.catch.y_max - scene.sphere.radius, scene.gravity)
        found.append(Reach(_dent(scene.kick, scene.sphere, speed), "fall from catch.y_max"))
    if scene.experiment == "loop" and scene.kick.electrical == "driven":
        found.append(_kicked(scene.kick))
    return max(found, key=lambda each: each.depth)


def free_stroke(kick: Kick, voltage: float) -> float:
    """Static stroke [m] of the free stack: ``layers d33 |voltage|``."""
    return kick.layers * abs(charge_constant(kick.material) * voltage)


def charge_constant(material: Material) -> float:
    """d33 [m/V] of a 6mm ceramic, from ``d = e C^-1``."""
    c11, c12, c13, c33, _, _ = material.stiffness
    e31, e33, _ = material.coupling
    return (e33 * (c11 + c12) - 2 * e31 * c13) / ((c11 + c12) * c33 - 2 * c13**2)


def _kicked(kick: Kick) -> Reach:
    """The sphere stays where it is while the surface swings up.

    A landing goes less deep: a kick of 2.35 um throws at 1.0 m/s, which dents the chip by 3.1 um.
    """
    stroke = free_stroke(kick, kick.drive.voltage)
    why = f"{SWING:g} times the free stroke at {kick.drive.voltage:g} V"
    return Reach(SWING * stroke, why)


def _dent(kick: Kick, sphere: Sphere, speed: float) -> float:
    """Depth [m] at which a rigid sphere of this speed [m/s] stops.

    No state of the chip stores less energy under a dent than the static one, so what the static
    law needs to stop the sphere is a bound: ``m v^2 / 2 = 8/15 E sqrt(R) d^(5/2)`` (Hertz 1881).
    """
    energy = 0.5 * sphere.mass * speed**2
    modulus = indentation_modulus(kick.material)
    return SPARE * float((15 * energy / (8 * modulus * math.sqrt(sphere.radius))) ** 0.4)


def indentation_modulus(material: Material) -> float:
    """Modulus [Pa] of a transversely isotropic half-space pressed along its axis, fields zero.

    Source: Delafargue and Ulm, Int. J. Solids Structures 41 (2004), eq. 13.
    """
    c11, _, c13, c33, c44, _ = material.stiffness
    mean = math.sqrt(c11 * c33)
    slender = (mean**2 - c13**2) / c11
    return 2 * math.sqrt(slender / (1 / c44 + 2 / (mean + c13)))


def _fall(height: float, gravity: float) -> float:
    """Speed [m/s] gained over ``height`` [m]."""
    return math.sqrt(max(0.0, 2 * gravity * height))
