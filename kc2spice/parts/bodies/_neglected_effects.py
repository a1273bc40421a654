"""Effects that all finite-element bodies neglect, with estimates of their size.

The sizes of the neglected effects are computed from an :class:`Envelope`, which contains the outer
dimensions, mass and layers of a body. The outer dimensions, mass and layers in an :class:`Envelope`
follow from the keys of a body, so no mesh is necessary. An effect that the model of a body
includes, such as a layer of glue, is not listed.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import pairwise, starmap
from typing import TYPE_CHECKING

import numpy as np

from kc2spice.core.quantities import AIR_DENSITY
from kc2spice.fem.materials import find_material
from kc2spice.physics.declaration import ONE_TEMPERATURE
from kc2spice.scene.part_records import NeglectedEffect

if TYPE_CHECKING:
    # Imported for annotations only, because the import of ``device`` also loads the finite
    # elements.
    from kc2spice.bodies.solid_models import Block

# Heat transfer coefficient [W/(m^2 K)] from a small surface to still air.
# The coefficient includes convection and radiation of surfaces with sizes of 10 mm to 50 mm.
# The coefficient is valid for surfaces that are about 20 K warmer than the air.
# Source of the coefficient: VDI Heat Atlas, 2nd ed. 2010, sections F2 and K1.
COOLING_COEFFICIENT = 10.0
GLUE_THICKNESS = 10e-6  # thickness [m] of an epoxy joint that is pressed during curing
# Total thickness [m] of both fired silver electrodes of a layer, and density [kg/m^3] of silver.
SILVER_LAYER = (2 * 5e-6, 10490.0)
NOT_ESTIMATED_TEXT = "not estimated"


@dataclass(frozen=True)
class Envelope:
    """Envelope of a body: its size, mass and layers, to estimate neglected effects.

    Attributes
    ----------
    air : mass [kg] of the air that moves with the body, None if no formula exists for the shape of
        the body.
    mass : mass of the body [kg], None before the mesh exists.
    surface : surface area [m^2] of the body; for a user's mesh, of its bounding box.
    layers : glued layers from the bottom up; bodies with bolts and mesh files have none.
    length : length [m] along which the layers are coupled: the radius of a disc, the length of a
        beam.
    electrode : area [m^2] of one electrode, which covers the whole face of a layer.
    """

    air: float | None
    mass: float | None
    surface: float
    layers: Sequence[Block] = ()
    length: float = 0.0
    electrode: float = 0.0


def compute_disc_air_mass(radius: float) -> float:
    """Return the mass [kg] of air on both sides of a rigid disc without a baffle.

    The mass is ``8/3 rho a^3`` for the radius a and the density rho of air. In a baffle, the disc
    moves the mass ``8/3 rho a^3`` on each side (L. L. Beranek, Acoustics, 1986, section 5.2).
    """
    return 8 / 3 * AIR_DENSITY * radius**3


def make_disc_envelope(blocks: Sequence[Block], baffled: bool, glued: bool) -> Envelope:
    """Return the envelope of a disc-like body: its outer size, mass and air load.

    If ``baffled`` is true, the rim of the body of revolution is in a baffle.
    """
    boxes = np.array([block.box for block in blocks])
    radius = float(boxes[:, 0, 1].max())
    low, high = float(boxes[:, 1, 0].min()), float(boxes[:, 1, 1].max())
    surface = 2 * math.pi * radius * (radius + high - low)
    mass = 0.0
    for block in blocks:
        inner, outer = block.box[0]
        mass += math.pi * (outer**2 - inner**2) * block.thickness * block.material.density
    air = (2 if baffled else 1) * compute_disc_air_mass(radius)
    layers = blocks if glued else ()
    return Envelope(air, mass, surface, layers, radius, math.pi * radius**2)


def make_beam_envelope(blocks: Sequence[Block]) -> Envelope:
    """Return the envelope of a beam: its outer size, mass, layers and moving air mass.

    The beam moves an air mass of ``pi/4 rho w^2 l``. Source: J. N. Newman, Marine Hydrodynamics
    (1977), section 4.16, for the flow across a plate strip.
    """
    (x, length), (y, width) = blocks[0].box[:2]
    length, width = length - x, width - y
    height, mass = 0.0, 0.0
    for block in blocks:
        height += block.thickness
        mass += length * width * block.thickness * block.material.density
    surface = 2 * (length * width + height * (length + width))
    air = math.pi / 4 * AIR_DENSITY * width**2 * length
    return Envelope(air, mass, surface, blocks, length, length * width)


def estimate_surface_and_air_mass(sides: Sequence[float]) -> Envelope:
    """Estimate surface area and entrained air mass of a body from its bounding box.

    ``sides`` contains the side lengths [m] of the bounding box. Two values in ``sides`` are the
    radius and the height of a cylinder.

    The mass of the air that the box moves is at most ``8/3 rho a^3``. The length a is the radius of
    a disc that has the area of the box's largest face.
    """
    if len(sides) == 2:
        radius, height = sides
        return Envelope(
            compute_disc_air_mass(radius), None, 2 * math.pi * radius * (radius + height)
        )
    small, middle, large = sorted(sides)
    radius = math.sqrt(middle * large / math.pi)
    surface = 2 * (small * middle + small * large + middle * large)
    return Envelope(compute_disc_air_mass(radius), None, surface)


def estimate_neglected_effects(
    name: str, envelope: Envelope, support: str, *, heated: bool
) -> Iterator[NeglectedEffect]:
    """Yield the effects that the model of the body ``name`` neglects.

    A nonempty text ``support`` describes a mounting, whose compliance is then one of the effects.
    The heat from the losses of a ``heated`` body flows out of its pin ``heat``.
    """
    yield _estimate_air_effect(name, envelope)
    if support:
        yield NeglectedEffect(f"{name}: compliance of its mounting", support, NOT_ESTIMATED_TEXT)
    yield from _estimate_glue_effect(name, envelope)
    yield from _estimate_electrode_effect(name, envelope)
    yield NeglectedEffect(
        f"{name}: hysteresis, depolarisation", "linear material law", NOT_ESTIMATED_TEXT
    )
    if heated:
        what, why, size = ONE_TEMPERATURE
        yield NeglectedEffect(
            f"{name}: {what}", f"{why}; material constants do not depend on temperature", size
        )
        return
    kelvin = 1e-3 / (COOLING_COEFFICIENT * envelope.surface)
    why = "material constants at one temperature"
    size = f"{kelvin:.2g} K per mW dissipated (still air, {COOLING_COEFFICIENT:g} W/(m²·K))"
    yield NeglectedEffect(f"{name}: heating by its own losses", why, size)


def _estimate_air_effect(name: str, envelope: Envelope) -> NeglectedEffect:
    """Estimate the effect of the neglected load of the air on the first resonance."""
    effect = partial(NeglectedEffect, f"{name}: load of the air", "no air mass, no radiation")
    if envelope.air is None:
        return effect(NOT_ESTIMATED_TEXT)
    added = f"{1e6 * envelope.air:.2g} mg of added air mass"
    if envelope.mass is None:
        return effect(f"at most {added}")
    lower = _compute_frequency_drop(envelope.air / envelope.mass)
    return effect(f"first resonance at most {100 * lower:.2g} % lower, by {added}", size=lower)


def _compute_frequency_drop(added: float) -> float:
    """Return the relative drop of a natural frequency caused by an added mass.

    The added mass m_a lowers the natural frequency of a body with the mass m by the fraction
    ``1 - (1 + m_a/m)^-1/2``, where m_a/m is ``added``.
    """
    return 1 - (1 + added) ** -0.5


def _estimate_glue_effect(name: str, envelope: Envelope) -> Iterator[NeglectedEffect]:
    """Yield the neglected effect of glue between layers, with its estimated size."""
    glue = find_material("epoxy")
    layers = [b for b in envelope.layers if _compute_youngs_modulus(b) > 2 * glue.C[0, 0]]
    joints = [(a, b) for a, b in pairwise(layers) if a.box[-1][1] == b.box[-1][0]]
    if not joints:
        return
    reach = max(starmap(compute_shear_transfer_length, joints))
    share = reach / envelope.length
    size = (
        f"with {1e6 * GLUE_THICKNESS:g} µm of epoxy, the piezoelectric coupling is weaker within "
    )
    size += f"{1e3 * reach:.2g} mm of the edges ({100 * share:.2g} % of the radius or length)"
    yield NeglectedEffect(f"{name}: glue between layers", "rigid bond", size, size=share)


def compute_shear_transfer_length(below: Block, above: Block) -> float:
    """Return the length [m] over which glue transfers strain between two layers.

    The length is ``(t_g / (G (1/(E1 t1) + 1/(E2 t2))))^1/2``. The layers have the thicknesses t1
    and t2 and Young's moduli E1 and E2. The glue has the thickness t_g and the shear modulus G (E.
    F. Crawley and J. de Luis, AIAA J. 25 (1987) 1373).
    """
    shear = find_material("epoxy").C[3, 3]
    softness = 1 / (_compute_youngs_modulus(below) * below.thickness)
    softness += 1 / (_compute_youngs_modulus(above) * above.thickness)
    return math.sqrt(GLUE_THICKNESS / (shear * softness))


def _compute_youngs_modulus(block: Block) -> float:
    """Return Young's modulus [Pa] of a block in the plane of its layer."""
    return float(1 / np.linalg.inv(block.material.C)[0, 0])


def _estimate_electrode_effect(name: str, envelope: Envelope) -> Iterator[NeglectedEffect]:
    """Yield the neglected effect of the metal of electrodes, solder and wires."""
    what, why = f"{name}: metal of electrodes, solder, wires", "equipotentials without mass"
    active = [block for block in envelope.layers if block.material.is_piezoelectric]
    if not active or envelope.mass is None:
        yield NeglectedEffect(what, why, NOT_ESTIMATED_TEXT)
        return
    thickness, density = SILVER_LAYER
    added = len(active) * thickness * density * envelope.electrode / envelope.mass
    lower = _compute_frequency_drop(added)
    size = f"first resonance at most {100 * lower:.2g} % lower (5 µm of silver on both faces)"
    yield NeglectedEffect(what, why, size, size=lower)
