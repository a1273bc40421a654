"""The part ``capacitor``."""

from __future__ import annotations

from pydantic import Field

from kc2spice.core.quantities import Capacitance, Section
from kc2spice.parts._twoterminal import TwoTerminal
from kc2spice.scene.parttype import register


class CapacitorKeys(Section):
    """``i = C dv/dt``."""

    capacitance: Capacitance = Field(gt=0)


class Capacitor(TwoTerminal):
    name, title, schema = "capacitor", "ideal capacitor", CapacitorKeys
    letter, key, unit = "C", "capacitance", "F"


register(Capacitor())
