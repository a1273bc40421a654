"""Effects of assumptions about a radiating face on the sound pressure level.

Acoustic parts represent a face of a body by its volume velocity. A part of type ``radiation`` on
the face represents a piston with the volume velocity of the face. Other acoustic parts at the face,
such as a cavity or a tube, assume a uniform pressure. This module estimates five effects before a
simulation: shape of the motion, baffle, and the tolerances of resonance frequency, support and Q
factor. The five effects on the sound level are computed from the full model of the body, at the
frequency with the largest level.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from kc2spice.bodies.face_motion import FaceMotion
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.parts.bodies._face_response import (
    HALF_OCTAVE,
    LOWEST_SHARE,
    FluidAtFace,
    LoadedFace,
)
from kc2spice.scene.part_records import NeglectedEffect

TOLERANCE = 0.01  # relative tolerance of a resonance frequency and of a support's diameter
# Largest product k a of wave number and radius for which the level without a baffle is estimated.
# At this k a, the dipole formula differs by about 2 dB from the pressure of a rigid disc without a
# baffle.
# Reference for the 2 dB error of the dipole formula: F. M. Wiener, J. Acoust. Soc. Am. 23 (1951)
# 697.
LARGEST_DIPOLE_KA = 1.5
# A mode of a body counts as a sound source if the ratio of mean to rms velocity of the face is
# larger than this value.
# A ratio of mean to rms velocity below 1e-6 is a rounding error, for example in a torsional mode.
SMALLEST_PISTON_RATIO = 1e-6
# Difference [dB] of radiated power between face and piston, above which a run prints a warning.
# The value of 1 dB equals the tolerance of a sound level meter of class 2 (IEC 61672-1).
PISTON_TOLERANCE = 1.0
# Smallest ratio of mean to rms velocity of a face; below this ratio, a run prints a warning.
MIN_PISTON_SHARE = 0.5


@dataclass(frozen=True)
class FaceLevelEffects:
    """Effects of assumptions on the sound level [dB] of a face at its resonance.

    Attributes
    ----------
    resonance : natural frequency [Hz] of the mode that determines the largest level.
    piston_ratio : ratio of mean to rms velocity of the face; 1 for a piston.
    peak : ratio of the largest to the mean displacement of the face.
    power : radiated power [dB] relative to a piston with the same volume velocity. ``worst`` [dB]
        is the value of ``power`` with the largest magnitude of all modes in the band.
        ``worst_frequency`` [Hz] is the natural frequency of the mode whose ``power`` has the
        largest magnitude. ``power``, ``worst`` and ``worst_frequency`` are 0 without a part of type
        ``radiation`` on the face.
    shift : relative change of the resonance frequency by the near field of a face that works into
        other acoustic parts, infinite if unknown. ``near_field`` is the change [dB] of the sound
        level that ``shift`` causes.
    size : product k a, where k is the wave number and a the radius of the baffled piston that
        represents the face. ``size`` is None if the scene assumes no baffle.
    unbaffled : change [dB] of the level if the assumed baffle is removed; None if the scene assumes
        no baffle, or if ``size`` exceeds :data:`LARGEST_DIPOLE_KA`.
    detuned : change [dB] of the level at a frequency 1 % below or above the resonance, None
        without electrodes or sound.
    halved : change [dB] of the level at half the Q factor, None without electrodes or sound.
    node : diameter [m] of the nodal circle, None without a nodal circle.
    support : changes [dB] of the level on supporting rings with the diameters ``rings`` [m]; empty
        if unknown.
    """

    resonance: float
    piston_ratio: float
    peak: float
    power: float = 0.0
    worst: float = 0.0
    worst_frequency: float = 0.0
    shift: float = 0.0
    near_field: float = 0.0
    size: float | None = None
    unbaffled: float | None = None
    detuned: float | None = None
    halved: float | None = None
    node: float | None = None
    rings: tuple[float, ...] = ()
    support: tuple[float, ...] = ()

    @property
    def total_effect(self) -> float | None:
        """Total effect [dB] of all assumptions except ``unbaffled`` on the sound level.

        The value is the root sum square of the effects. The value is None if ``detuned`` or
        ``halved`` is unknown.
        """
        if self.detuned is None or self.halved is None:
            return None
        sizes = [self.power, self.near_field, self.halved, self.detuned]
        sizes.append(max(map(abs, self.support), default=0.0))
        return math.hypot(*sizes)


def find_nodal_circle_diameter(motion: FaceMotion, mode: int) -> float | None:
    """Find the diameter [m] of the innermost nodal circle on a face."""
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


def estimate_face_level_effects(face: LoadedFace) -> FaceLevelEffects | None:
    """Estimate the effect of each assumption on the sound level of a radiating face.

    The result is None if no mode of the face radiates sound.
    """
    hertz, motion, surface = face.compute_mode_motions()
    select = motion.piston_ratios > SMALLEST_PISTON_RATIO
    hertz = hertz[select]
    if not hertz.size:
        return None
    motion, surface = motion.select_motions(select), surface.select_motions(select)
    main, tone, level = 0, None, 0.0
    if face.can_compute_sound:
        low = hertz[0] * LOWEST_SHARE
        high = face.end if face.count > 1 else hertz[0] * HALF_OCTAVE
        tone, level = face.find_loudest(low, high)
        main = int(np.abs(hertz - tone).argmin())
    result = FaceLevelEffects(
        float(hertz[main]),
        float(motion.piston_ratios[main]),
        float(motion.peak_ratios[main]),
        node=find_nodal_circle_diameter(motion, main),
    )
    result = _compare_with_piston(result, face, motion, hertz, main)
    if result.size is not None and result.size <= LARGEST_DIPOLE_KA:
        number = 2 * math.pi * result.resonance / face.facing.fluid.sound_speed
        ratio = float(motion.compute_unbaffled_ratios(number, surface)[main])
        result = replace(result, unbaffled=20 * math.log10(ratio))
    if tone is None:
        return result
    sides = face.compute_sound_levels(tone * np.array([1 - TOLERANCE, 1 + TOLERANCE])) - level
    damped = face.find_largest_level(tone, damping=2.0)
    near = 0.0
    if 0 < result.shift < np.inf:
        # The near field lowers the resonance frequency by the fraction ``result.shift``. Relative
        # to the resonance, the tone therefore rises by this fraction.
        near = float((face.compute_sound_levels([tone * (1 + result.shift)]) - level)[0])
    return replace(
        result, detuned=float(sides.min()), halved=float(damped - level), near_field=near
    )


def _compare_with_piston(
    result: FaceLevelEffects, face: LoadedFace, motion: FaceMotion, hertz: np.ndarray, main: int
) -> FaceLevelEffects:
    """Compare the face with a rigid piston; return ``result`` with the differences."""
    facing = face.facing
    numbers = 2 * np.pi * hertz / facing.fluid.sound_speed
    if facing.radiation is None:
        depth = facing.volume / motion.area
        masses = motion.bound_near_field_masses(depth, float(numbers[main]))
        # The modes are normalised to a modal mass of 1.
        return replace(result, shift=float(facing.fluid.density * masses[main] / 2))
    radius = facing.radiation.surface_radius
    ratios = [motion.compute_power_ratios(k, radius)[mode] for mode, k in enumerate(numbers)]
    power = 10 * np.log10(ratios)
    worst, baffled = int(np.abs(power).argmax()), facing.radiation.shape == "baffled_piston"
    return replace(
        result,
        power=float(power[main]),
        worst=float(power[worst]),
        worst_frequency=float(hertz[worst]),
        size=float(numbers[main] * radius) if baffled else None,
    )


def describe_piston_difference(name: str, facing: FluidAtFace, levels: FaceLevelEffects) -> str:
    """Return a warning if a face does not move like a piston; otherwise empty text."""
    share = levels.piston_ratio
    differences = (levels.worst, levels.near_field)
    if share >= MIN_PISTON_SHARE and max(map(abs, differences)) <= PISTON_TOLERANCE:
        return ""
    first = facing.names[0]
    advice = f'State this assumption in the scene by {first}.motion = "piston"'
    text = (
        f"{name} does not move like a piston: at {format_quantity(levels.resonance, 'Hz')}, its "
        f"volume velocity is {share:.2g} of that of a piston with the same rms velocity. "
    )
    if facing.radiation is None:
        return (
            f"{text}The model of {' and '.join(facing.names)} includes only the volume velocity of "
            f"the face: the near field {_describe_near_field(levels)}. {advice}"
        )
    worst, sign = abs(levels.worst), "less" if levels.worst < 0 else "more"
    return (
        f"{text}{name} radiates {worst:.1f} dB {sign} power than {first} at "
        f"{format_quantity(levels.worst_frequency, 'Hz')}, but the same pressure on the axis. "
        f"{advice}"
    )


def _describe_near_field(levels: FaceLevelEffects) -> str:
    """Describe the near field of a face in a closed volume as text."""
    if math.isinf(levels.shift):
        return "is not estimated, because cross modes of the volume propagate"
    shift = f"lowers the resonance by at most {100 * levels.shift:.2g} %"
    return shift if levels.detuned is None else f"{shift}, {levels.near_field:+.1f} dB"


def list_level_effects(
    name: str, port: str, levels: FaceLevelEffects, *, direct: bool
) -> Iterator[NeglectedEffect]:
    """Yield each assumption about a face and its estimated effect on the sound level.

    ``direct`` states whether a part of type ``radiation`` is on the face.
    """
    place, percent = format_quantity(float(f"{levels.resonance:.4g}"), "Hz"), 100 * TOLERANCE

    def make_neglected_effect(of: str, assumption: str, size: str) -> NeglectedEffect:
        """Make the record of a neglected effect: the assumption and the error it causes."""
        return NeglectedEffect(f"{name}: {of}", assumption, size, summarised=True)

    if direct:
        shape = f"{levels.power:+.1f} dB power relative to a piston at {place}"
        yield make_neglected_effect(f"motion of {port}", "a piston", shape)
    else:
        share = f"{levels.piston_ratio:.2g} of the volume velocity of a piston at {place}"
        yield make_neglected_effect(f"motion of {port}", "a piston", share)
        yield make_neglected_effect(
            f"near field of {port}", "uniform pressure", _describe_near_field(levels)
        )
    if levels.size is not None:
        size = f"not estimated at k a = {levels.size:.2g}, above {LARGEST_DIPOLE_KA:g}"
        if levels.unbaffled is not None:
            size = f"about {levels.unbaffled:+.0f} dB without a baffle"
        yield make_neglected_effect(f"baffle of {port}", "infinite and rigid", size)
    if levels.detuned is not None:
        size = f"{levels.detuned:+.1f} dB for a tone detuned by {percent:g} %"
        yield make_neglected_effect("resonance", "exact", size)
    if levels.support:
        changes = ", ".join(f"{change:+.1f}" for change in levels.support)
        rings = ", ".join(f"{1e3 * ring:.3g}" for ring in levels.rings)
        ring = "a ring" if len(levels.rings) == 1 else "rings"
        size = f"{changes} dB on {ring} of {rings} mm"
        yield make_neglected_effect("support", "ideal", size)
    if levels.halved is not None:
        yield make_neglected_effect(
            "Q factor", "as stated", f"{levels.halved:+.1f} dB at half the Q factor"
        )
