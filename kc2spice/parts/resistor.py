"""The part ``resistor``."""

from __future__ import annotations

from pydantic import Field

from kc2spice.core.quantities import Resistance, Section
from kc2spice.parts._twoterminal import TwoTerminal
from kc2spice.scene.parttype import register


class ResistorKeys(Section):
    """``v = R i``."""

    resistance: Resistance = Field(gt=0)


class Resistor(TwoTerminal):
    name, title, schema = "resistor", "ideal resistor", ResistorKeys
    letter, key, unit = "R", "resistance", "Ohm"


register(Resistor())
