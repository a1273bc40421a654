"""Assumptions about a radiating face of a body, and their effects on the sound pressure level.

A part of type ``radiation`` represents the face by a piston with its volume velocity. The effects
are the shape of the motion, the baffle, and the tolerances of resonance, support and Q factor.
The effects are computed before a simulation from the full model, at the resonance of the body with
the largest level.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from kc2spice.bodies.face_motion import FaceMotion, sample_face_motion
from kc2spice.bodies.fields import compute_lowest_modes
from kc2spice.bodies.undamped import FiniteElementModel
from kc2spice.core.prefix import format_quantity
from kc2spice.parts.acoustics.radiation import RadiationKeys
from kc2spice.scene.rows import Neglected

TOLERANCE = 0.01  # relative tolerances of a resonance and of the diameter of a support
# Largest k a for which the dipole formula holds: there the exact pressure of a rigid disc without a
# baffle differs by about 2 dB (F. M. Wiener, J. Acoust. Soc. Am. 23 (1951) 697).
LARGEST_DIPOLE_KA = 1.5
MAX_MODES = 6  # number of modes whose shapes are compared with a piston
HALF_QUALITY = 20 * math.log10(2)  # dB, change of a level at resonance if the Q factor is halved
# dB, largest difference of the radiated power without a warning: the tolerance of a sound level
# meter of class 2 (IEC 61672-1)
PISTON_TOLERANCE = 1.0
MIN_PISTON_SHARE = 0.5  # ratio of mean to rms velocity below which a warning is printed


@dataclass(frozen=True)
class FaceLevels:
    """Differences of levels [dB] of a face at its resonance with the largest level.

    Attributes
    ----------
    resonance : frequency [Hz] of this resonance.
    piston_ratio : ratio of mean to rms velocity.
    peak : ratio of the largest to the mean displacement.
    power : radiated power relative to that of a piston with the same volume velocity; ``worst``
        is the largest difference of all resonances in the band, at ``worst_frequency`` [Hz].
    unbaffled : level without a baffle, None if the body is no thin disc.
    detuned : level at a frequency 1 % beside the resonance, None without electrodes.
    node : diameter [m] of the circle without motion, None without such a circle.
    support : differences on a ring of 0.99 and 1.01 of the diameter ``ring`` [m]; empty if unknown.
    """

    resonance: float
    piston_ratio: float
    peak: float
    power: float
    worst: float
    worst_frequency: float
    unbaffled: float | None
    detuned: float | None
    node: float | None
    ring: float = 0.0
    support: tuple[float, ...] = ()

    @property
    def total(self) -> float:
        """Root of the sum of squares of all differences except ``unbaffled``."""
        sizes = [self.power, HALF_QUALITY, self.detuned or 0.0]
        sizes.append(max(map(abs, self.support), default=0.0))
        return math.hypot(*sizes)


@dataclass(frozen=True)
class FaceOfBody:
    """Full model with an acoustic port and the piston that represents it.

    The modes are those below ``end`` [Hz], at most ``count``.
    """

    device: FiniteElementModel
    port: str
    keys: RadiationKeys
    end: float
    count: int = MAX_MODES

    def modes(self) -> tuple[np.ndarray, np.ndarray]:
        """Return frequencies [Hz] and vectors of the modes in the band."""
        return compute_lowest_modes(self.device, self.count, self.end)

    def motions(self) -> tuple[np.ndarray, FaceMotion]:
        """Return frequencies [Hz] and motions of the modes in the band."""
        hertz, z = self.modes()
        return hertz, sample_face_motion(self.device, self.device.faces[self.port], z)

    def levels(self, hertz: Sequence[float] | np.ndarray) -> np.ndarray | None:
        """Return levels [dB] relative to a constant; None without electrodes."""
        model = self.device.model
        drives = [port.name for port in model.ports if port.electrical]
        if not drives:
            return None
        pair = model.select([drives[0], self.port])
        row, column = pair.outputs.index(self.port), pair.inputs.index(drives[0])
        f = np.asarray(hertz, dtype=float)
        volume = np.abs(pair.transfer(f)[:, row, column])
        return np.asarray(20 * np.log10(np.maximum(f**2 * volume, 1e-300)))


def find_node_diameter(motion: FaceMotion, mode: int) -> float | None:
    """Return the diameter [m] of the innermost circle without motion on a face of revolution."""
    if not motion.axisymmetric:
        return None
    order = np.argsort(motion.places[0])
    radius, normal = motion.places[0][order], motion.normal[order, mode]
    changes = np.flatnonzero(normal[1:] * normal[:-1] < 0)
    if not changes.size:
        return None
    k = changes[0]
    share = normal[k] / (normal[k] - normal[k + 1])
    return float(2 * (radius[k] + share * (radius[k + 1] - radius[k])))


def estimate_face_levels(face: FaceOfBody) -> FaceLevels | None:
    """Compare a face with a piston; None without a resonance in the band."""
    hertz, motion = face.motions()
    select = np.abs(motion.volumes) > 0
    hertz = hertz[select]
    if not hertz.size:
        return None
    motion = FaceMotion(
        motion.places, motion.areas, motion.normal[:, select], motion.axis, motion.axisymmetric
    )
    levels = face.levels(hertz)
    main = 0 if levels is None else int(levels.argmax())
    numbers = 2 * np.pi * hertz / face.keys.fluid.sound_speed
    radius = face.keys.surface_radius
    ratios = [motion.power_ratios(k, radius)[mode] for mode, k in enumerate(numbers)]
    power = 10 * np.log10(ratios)
    worst, unbaffled, detuned = int(np.abs(power).argmax()), None, None
    small = numbers[main] * radius <= LARGEST_DIPOLE_KA
    if motion.axisymmetric and small and face.keys.shape == "baffled_piston":
        unbaffled = 20 * math.log10(motion.unbaffled_ratios(numbers[main])[main])
    if levels is not None:
        sides = face.levels(hertz[main] * np.array([1 - TOLERANCE, 1 + TOLERANCE]))
        assert sides is not None
        detuned = float((sides - levels[main]).min())
    return FaceLevels(
        float(hertz[main]),
        float(motion.piston_ratios[main]),
        float(motion.peak_ratios[main]),
        float(power[main]),
        float(power[worst]),
        float(hertz[worst]),
        unbaffled,
        detuned,
        find_node_diameter(motion, main),
    )


def level_near(face: FaceOfBody, resonance: float) -> float:
    """Return the level [dB] at the resonance that is nearest to a frequency [Hz]."""
    hertz, _ = face.modes()
    levels = face.levels(hertz[[np.abs(hertz - resonance).argmin()]])
    return math.nan if levels is None else float(levels[0])


def describe_piston_difference(name: str, radiation: str, levels: FaceLevels) -> str:
    """Return the warning that a face does not move like a piston; empty if it does."""
    if levels.piston_ratio >= MIN_PISTON_SHARE and abs(levels.worst) <= PISTON_TOLERANCE:
        return ""
    worst, sign = abs(levels.worst), "less" if levels.worst < 0 else "more"
    return (
        f"{name} is not a piston: at {format_quantity(levels.resonance, 'Hz')}, its volume "
        f"velocity is {levels.piston_ratio:.2g} of that of a piston with its rms velocity. It "
        f"radiates {worst:.1f} dB {sign} power than {radiation} at "
        f"{format_quantity(levels.worst_frequency, 'Hz')}, and the same pressure on the axis"
    )


def list_level_effects(name: str, port: str, levels: FaceLevels) -> Iterator[Neglected]:
    """Yield the assumptions about a face with their effects on its level."""
    place, percent = format_quantity(float(f"{levels.resonance:.4g}"), "Hz"), 100 * TOLERANCE

    def effect(of: str, assumption: str, size: str) -> Neglected:
        """Return a neglected effect with its size."""
        return Neglected(f"{name}: {of}", assumption, size, summarised=True)

    shape = f"{levels.power:+.1f} dB of power at {place}"
    yield effect(f"motion of {port}", "that of a piston", shape)
    if levels.unbaffled is not None:
        size = f"about {levels.unbaffled:+.0f} dB without a baffle"
        yield effect(f"baffle of {port}", "infinite and rigid", size)
    if levels.detuned is not None:
        size = f"{levels.detuned:+.1f} dB for a tone {percent:g} % beside it"
        yield effect("resonance", "exact", size)
    if levels.support:
        smaller, larger = (1e3 * levels.ring * (1 + sign * TOLERANCE) for sign in (-1, 1))
        below, above = levels.support
        size = f"{below:+.1f}, {above:+.1f} dB on rings of {smaller:.3g}, {larger:.3g} mm"
        yield effect("support", "ideal", size)
    yield effect("Q factor", "as stated", f"{-HALF_QUALITY:+.1f} dB at half of it")
