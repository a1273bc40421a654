"""The part ``moving_magnet``: a magnet that moves along coils and fixed magnets.

The part models shakers, buzzers, energy harvesters and magnetic levitation.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from itertools import product
from typing import Annotated

from pydantic import Field

from kc2spice.core.quantities import MU_0, Dimension, FluxDensity, Ratio, RefinementRule, Section
from kc2spice.fem.magnet_keys import RingKeys
from kc2spice.fem.magnet_rings import LoopModel, Winding, make_current_loop
from kc2spice.parts.magnetics.moving_conductor import (
    MovingBody,
    MovingBodyKeys,
    compute_surface_currents,
    make_windings,
)
from kc2spice.scene.part_records import NeglectedEffect
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    Part,
    Scene,
)


class MagnetisationKeys(Section):
    """Magnetisation of a moving magnet: the key ``remanence``, a netlist parameter."""

    remanence: FluxDensity = Field(
        description="Remanence of the moving magnet, positive for an upward magnetisation"
    )


class MovingMagnetKeys(MagnetisationKeys, MovingBodyKeys):
    """Keys of a moving magnet: an axially magnetised cylinder or ring.

    The model assumes the uniform magnetisation ``remanence / (MU_0 (1 + N (mu_r - 1)))`` with the
    demagnetising factor N of the shape. The model replaces the magnet by surface currents, which
    equal ``thickness`` times the magnetisation. Maxwell's formula for coaxial circles gives the
    flux and the force.
    """

    thickness: Dimension = Field(gt=0, description="Thickness of the moving magnet along the axis")
    mu_r: Ratio = Field(
        1.0,
        ge=1,
        description=(
            "Relative recoil permeability of the moving magnet: remanence / (mu_0 * coercivity)"
        ),
    )
    tolerance: Annotated[Ratio, RefinementRule(0.1, model=True)] = Field(
        1e-5,
        gt=1e-8,
        lt=0.1,
        description=(
            "Largest permitted relative error of flux and force; determines the degree of the "
            "power series that describe both as functions of the height"
        ),
    )


def compute_demagnetising_factor(inner: float, outer: float, height: float) -> float:
    """Return the axial demagnetising factor N of a ring or cylinder.

    N is the magnetometric factor: the mean field of the magnet's surface currents is ``(1 - N)``
    times the field of a very long magnet.
    """
    shells = [Winding(outer, 0.0, height, 0.0, 1.0)]
    if inner:
        shells.append(Winding(inner, 0.0, height, 0.0, -1.0))
    linked = sum(a.compute_coupling_inductance(b) for a, b in product(shells, repeat=2))
    return 1 - linked * height / (MU_0 * math.pi * (outer**2 - inner**2))


class MovingMagnet(MovingBody[MovingMagnetKeys]):
    """Part type ``moving_magnet``: magnet that moves along coils and fixed magnets."""

    name = "moving_magnet"
    title = "magnet that moves along the axis of coils and fixed magnets"
    discretisations = ("tolerance",)
    schema = MovingMagnetKeys
    parameters = MagnetisationKeys
    rating = (
        "not known; each coil is heated by the power i^2 * resistance; heat and opposing fields "
        "can demagnetise the magnet"
    )
    source = "closed form (coaxial circles)"
    example = """
[moving_magnet]
part = "moving_magnet"
radius = "3 mm"
thickness = "4 mm"
remanence = "1.2 T"
mu_r = 1.05
y_min = "-2 mm"
y_max = "2 mm"
pins = { coil_p = "drive.out", a = "spring.a" }

[moving_magnet.coils.coil]
radius = "4 mm"
width = "2 mm"
height = "3 mm"
y = "-6 mm"
turns = 200
resistance = "10 Ohm"

[spring]
part = "spring"
stiffness = "200 N/m"

[drive]
part = "source"
sine = { amplitude = "1 V", frequency = "50 Hz" }
"""

    def make_current_loops(
        self,
        keys: MovingMagnetKeys,
        fixed: list[Winding],
        tolerance: float,
        rings: int,
        frequency: float,
    ) -> LoopModel:
        """Return the magnet as one current loop that is coupled to coils and magnets.

        The loop model contains the couplings of the magnet's current loop to the coils and to the
        ``fixed`` currents, which represent fixed magnets.
        """
        shape = keys.inner, keys.radius, keys.thickness
        share = 1 / (1 + compute_demagnetising_factor(*shape) * (keys.mu_r - 1))
        ring = RingKeys(height=shape[2], outer=shape[1], inner=shape[0], y=0.0)
        return make_current_loop(
            compute_surface_currents(ring, share),
            make_windings(keys),
            fixed,
            keys.y_min,
            keys.y_max,
            tolerance,
        )

    def notes(self, part: Part[MovingMagnetKeys], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        count = len(part.keys.coils)
        yield (
            f"{count} coils; flux and force exact in the coil currents, power series in the height"
        )
        yield from self.list_neglected_effects(part, scene)
        keys = part.keys
        extra = keys.mu_r - 1
        factor = compute_demagnetising_factor(keys.inner, keys.radius, keys.thickness)
        loss = extra * factor / (1 + extra * factor)
        yield NeglectedEffect(
            "an uneven magnetisation",
            f"the recoil permeability {keys.mu_r:g} is applied only to the mean demagnetising "
            "field of the magnet itself",
            f"the demagnetising field lowers the magnetisation by {100 * loss:.2g} %; an external "
            f"flux density B would change the magnetisation by {100 * extra:.2g} % of B",
            size=loss,
        )
        yield NeglectedEffect(
            "eddy currents in the magnet", "no current flows in the magnet", "not estimated"
        )
        yield NeglectedEffect(
            "tilting and sideways motion", "one degree of freedom", "not estimated"
        )


register_part_type(MovingMagnet())
