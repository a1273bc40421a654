"""Declared parts that have a mass at one of their displacement pins.

The mass has a separate declaration, but its nodes are in the same subcircuit. The netlist computes
the volume velocity or the back-EMF of the part from the velocity node of the mass, so that no
displacement is differentiated.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import replace
from typing import ClassVar

from kc2spice.core import constitutive_laws as laws
from kc2spice.netlist.subcircuit_library import Header, Subcircuit
from kc2spice.physics.declaration import Declaration
from kc2spice.physics.declaration_cards import write_subcircuit_items
from kc2spice.physics.law import DeclaredLaw
from kc2spice.physics.part import DeclaredPart, make_declared_subcircuit
from kc2spice.scene.part_records import EquilibriumConditions
from kc2spice.scene.scene_classes import BuiltScene, JoinedScene, KeysT, Part, WiredScene


class DeclaredPartWithMass(DeclaredPart[KeysT]):
    """Part type with a declaration, and with a mass at a displacement pin."""

    moving_pins: tuple[str, str]  # pin with the mass, and pin relative to which the mass moves
    # advice to users in whose scenes the second pin of ``moving_pins`` moves
    moving_frame_advice: ClassVar[str] = ""

    @abstractmethod
    def declare_mass(self, part: Part[KeysT], scene: WiredScene) -> Declaration:
        """Return the declaration of the mass between :attr:`moving_pins`."""

    def pins_with_mass(self, part: Part[KeysT], scene: JoinedScene) -> tuple[str, ...]:
        """Return the name of the pin that has the mass."""
        return self.moving_pins[:1]

    def constant_pins(self, part: Part[KeysT], scene: WiredScene) -> Mapping[str, str]:
        """Return the pin relative to which the mass moves."""
        return {self.moving_pins[1]: self.moving_frame_advice}

    def equilibrium_conditions(self, part: Part[KeysT], scene: WiredScene) -> EquilibriumConditions:
        """Return the equilibrium conditions: paths of steady flow, and the pin with mass.

        The velocity of a pin that has a mass cannot jump.
        """
        return replace(
            super().equilibrium_conditions(part, scene), inertial_pins=self.moving_pins[:1]
        )

    def subcircuits(
        self, part: Part[KeysT], build: BuiltScene, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return the subcircuit of the part, as a tuple of length 1.

        The subcircuit includes the cards of the mass.
        """
        d, name = self.declare_built_part(part, build), build.libraries[part.name]
        mass = self.declare_mass(part, build.scene)
        known = {param.name for param in d.given}
        d = replace(d, given=(*d.given, *(p for p in mass.given if p.name not in known)))
        cards, values = write_subcircuit_items(mass), d.compute_parameter_values(part.keys)
        return (make_declared_subcircuit(header, name, d, values, build.has_noise, cards),)

    def law(self, part: Part[KeysT], build: BuiltScene) -> laws.Equations:
        """Return the part's model equations: laws of its declaration and of its mass."""
        equations, name = super().law(part, build), part.name
        mass = self.declare_mass(part, build.scene)
        mass_law = DeclaredLaw(f"{name}_mass", mass, tuple(mass.defaults.values()))
        nets = tuple((f"{name}.{pin}", f"{name}_mass.{pin}") for pin in self.moving_pins)
        return replace(equations, laws=(*equations.laws, mass_law), nets=nets)
