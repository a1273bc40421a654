"""The part ``half_bridge``: half-bridge with gate resistors and reservoir."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
from pydantic import Field

from kc2spice.core.quantities import Capacitance, Current, Resistance, Section, Voltage
from kc2spice.parts import _driver_checks as driver
from kc2spice.parts._drivers import Driver
from kc2spice.scene.judge import Check
from kc2spice.scene.model import Part
from kc2spice.scene.parttype import Build, register

GATE, THRESHOLD, GATES = 12.0, 3.0, 5.2e-10  # V, V, F: of each transistor
DIODE, SATURATED = 0.03, 1e-14  # V for a factor e of current (75 C), A: of its diode
SETTLED, OHMIC = 10.0, 0.9  # time constants of a gate; of the current that saturates


class HalfBridgeKeys(Section):
    """Two transistors from a charged capacitor; the high one is on during the kick pulse."""

    rail: Voltage = Field(100.0, gt=0, description="supply")
    resistance: Resistance = Field(2.0, gt=0, description="between bridge and chip")
    gate_resistance: Resistance = Field(10.0, gt=0, description="of both gates")
    current_limit: Current = Field(15.0, gt=0, description="at which a transistor saturates")
    reservoir: Capacitance = Field(
        10e-6, gt=0, description="capacitor that the pulse's charge comes from"
    )
    supply_resistance: Resistance = Field(100.0, gt=0, description="through which it is refilled")


class HalfBridge(Driver):
    name, title = "half_bridge", "half-bridge with gate resistors and reservoir"
    schema = HalfBridgeKeys
    circuit, heading, opamp = "half_bridge", "half-bridge for the chip", None

    def limits(
        self, part: Part, build: Build, time: np.ndarray, wave: Mapping[str, np.ndarray]
    ) -> Iterable[Check]:
        """Between the rails but for the diodes and for charge that returns to the reservoir; the
        gates' currents come on top of a transistor's."""
        keys, i, command = part.keys, wave["i"], wave["command"]
        bridge = wave["out"] + keys.resistance * i
        drop = DIODE * np.log1p(np.abs(i).max() / SATURATED)
        charge = np.r_[0.0, np.cumsum(np.diff(time) * (i[1:] + i[:-1]) / 2)]
        back = float((np.maximum.accumulate(charge) - charge).max()) / keys.reservoir
        slack = driver.SLACK * keys.rail
        yield driver.within(part.name, bridge, -drop, keys.rail + drop + back, slack)
        inside = (bridge > 0) & (bridge < keys.rail)
        gates = GATE / keys.gate_resistance
        yield driver.bounded(part.name, i[inside], keys.current_limit + gates)
        high, low = (_since(time, on) for on in (command >= keys.rail, command <= 0))
        settled = SETTLED * keys.gate_resistance * GATES
        tank = driver.relaxed(
            time,
            keys.rail - keys.supply_resistance * i * (command > keys.rail / 2),
            keys.supply_resistance * keys.reservoir,
        )
        share = i / keys.current_limit
        across = (GATE - THRESHOLD) * (1 - np.sqrt(1 - np.minimum(np.abs(share), 1)))
        off = np.abs(bridge - np.where(high > 0, tank, 0.0) + np.sign(i) * across)
        judged = (np.maximum(high, low) > settled) & (np.abs(share) < OHMIC)
        judged &= np.where(high > 0, bridge < tank, bridge > 0) | (across < driver.LAG * keys.rail)
        value = float(off[judged].max(initial=0.0)) / keys.rail
        yield driver.check(
            part.name, "follows its command", value, driver.LAG, "of its rail", driver.MEANING
        )


def _since(time: np.ndarray, on: np.ndarray) -> np.ndarray:
    """How long [s] it is on, at every time."""
    return np.asarray(time - np.maximum.accumulate(np.where(on, time[0], time)))


register(HalfBridge())
