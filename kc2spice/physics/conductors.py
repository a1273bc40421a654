"""Keys of conductors whose resistance depends on the temperature.

The resistance is ``R0 (1 + alpha (T - T0))``. ``alpha`` is the temperature coefficient, ``T`` is
the temperature of the pin ``heat`` relative to the pin ``ambient``, and ``T0`` is the reference
temperature. The field ``conductors`` of a declaration contains the names of these conductors.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any

from pydantic import Field

from kc2spice.core.domains import AMBIENT, HEAT, THERMAL
from kc2spice.core.errors import UsageError
from kc2spice.core.quantities import Section, si
from kc2spice.physics.declaration import COEFFICIENT, REFERENCE
from kc2spice.scene.scene_classes import GROUND, DeclaredScene, Part, Terminal

HEAT_TERMINALS = Terminal.from_domain(HEAT, THERMAL), Terminal.from_domain(AMBIENT, THERMAL, GROUND)


class ConductorKeys(Section):
    """Keys of the temperature-dependent resistance of a conductor.

    The resistance is ``R0 (1 + alpha (T - T0))``.
    """

    temperature_coefficient: Annotated[float, si("1/K")] | None = Field(
        None,
        description=(
            "Temperature coefficient of the resistance (relative change for each kelvin); by "
            "default the value of copper, or zero for a resistor"
        ),
    )
    reference_temperature: Annotated[float, si("K")] | None = Field(
        None,
        description=(
            "Temperature difference between the pins `heat` and `ambient` at which the "
            "resistance has its stated value; by default 0 K"
        ),
    )

    @classmethod
    def __pydantic_init_subclass__(cls, **settings: Any) -> None:
        """Move the keys of this base class to the end of the list of the part's keys."""
        super().__pydantic_init_subclass__(**settings)
        for name in (COEFFICIENT, REFERENCE):
            cls.model_fields[name] = cls.model_fields.pop(name)


def get_temperature_coefficient(keys: Section) -> tuple[float | None, float]:
    """Return temperature coefficient [1/K] and reference temperature [K] of a part.

    The temperature coefficient is None if no key of the part states this coefficient.
    """
    if not isinstance(keys, ConductorKeys):
        return None, 0.0
    return keys.temperature_coefficient, keys.reference_temperature or 0.0


# Optional pins through which a part exchanges the heat of its losses with other parts.
# Each value is the key that adds the pin to the part.
OPTIONAL_HEAT_PINS = {"heat": "pins.heat", "ambient": "pins.heat"}


def is_heated(part: Part, scene: DeclaredScene) -> bool:
    """Return whether a part is heated: whether the scene connects its pin ``heat``."""
    return HEAT in part.pins or scene.is_target(part.name, HEAT)


def list_useless_key_errors(part: Part, scene: DeclaredScene) -> Iterator[UsageError]:
    """Yield an error for each conductor key without effect.

    Without a connected heat pin, no conductor key has an effect.
    """
    if is_heated(part, scene):
        return
    for key in (COEFFICIENT, REFERENCE):
        value = getattr(part.keys, key, None)
        if value is not None:
            yield part.wrong(
                key,
                "the key has no effect without a heat pin",
                got=f"{value:g}",
                expected=f"a part whose pin {HEAT} is connected",
                hint=f'add {HEAT} = "PART.PIN" to the pins of {part.name}, or delete the key',
            )
