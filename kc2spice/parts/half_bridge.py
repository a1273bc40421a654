"""The part ``half_bridge``: half-bridge with gate resistors and reservoir."""

from __future__ import annotations

from typing import Any

from pydantic import Field

from kc2spice.core.quantities import (
    Capacitance,
    Current,
    Resistance,
    Section,
    Voltage,
)
from kc2spice.parts._drivers import (
    Driver,
    driver_part,
)
from kc2spice.scene.model import Part
from kc2spice.scene.parttype import Build, register
from kc2spice.spice.circuit import Subcircuit
from kc2spice.spice.header import Header


class HalfBridgeKeys(Section):
    """Two transistors from a charged capacitor; the high one is on during the kick pulse."""

    rail: Voltage = Field(100.0, gt=0)
    resistance: Resistance = Field(2.0, gt=0, description="between the bridge and the chip")
    gate_resistance: Resistance = Field(10.0, gt=0)
    current_limit: Current = Field(15.0, gt=0, description="at which a transistor saturates")
    reservoir: Capacitance = Field(10e-6, gt=0, description="limits the charge of a pulse")
    supply_resistance: Resistance = Field(100.0, gt=0, description="that refills the reservoir")


class HalfBridge(Driver):
    name, title = "half_bridge", "half-bridge with gate resistors and reservoir"
    schema = HalfBridgeKeys

    def subcircuits(self, part: Part, build: Build, header: Any) -> tuple[Any, ...]:
        return (half_bridge_subcircuit(header, part.keys, build.libraries[part.name]),)


def half_bridge_subcircuit(
    header: Header, drive: HalfBridgeKeys, name: str = "half_bridge"
) -> Subcircuit:
    """Two transistors, gate resistors, reservoir; ``command`` switches at half the rail."""
    docs = {
        "rail": "supply",
        "resistance": "between bridge and chip",
        "gate_resistance": "of both gates",
        "current_limit": "at which a transistor saturates",
        "reservoir": "capacitor that the pulse's charge comes from",
        "supply_resistance": "through which it is refilled",
    }
    return driver_part(header, "half_bridge", name, "half-bridge for the chip", drive, docs)


register(HalfBridge())
