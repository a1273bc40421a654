"""Heat flow from the losses of a linear body or resonator: law and result names.

:mod:`kc2spice.synthesis.heat_sources` contains the netlist cards of the same heat flows.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.domains import AMBIENT, HEAT, THERMAL, TRANSLATION
from kc2spice.netlist.number_and_name_spelling import format_voltage
from kc2spice.physics.declaration import TEMPERATURE
from kc2spice.scene.part_records import PartResult
from kc2spice.scene.scene_classes import BuiltScene, Part


@dataclass(frozen=True)
class LossHeatLaw(laws.Device):
    """Law of the heat flow out of the pin ``heat``.

    The heat flow is ``sum(weight * rate^2)`` [W] over all modes with losses. Each rate is the
    displacement rate of a mode.
    """

    name: str
    weights: tuple[float, ...]

    @property
    def rate_pins(self) -> tuple[str, ...]:
        """Names of the pins whose displacement rates determine the losses."""
        return tuple(map("loss{}".format, range(len(self.weights))))

    @property
    def pins(self) -> tuple[laws.LawPin, ...]:
        """Pins whose displacement rates cause losses, and pins ``heat`` and ``ambient``."""
        rates = (laws.LawPin(pin, TRANSLATION.name) for pin in self.rate_pins)
        ends = laws.LawPin(HEAT, THERMAL.name), laws.LawPin(AMBIENT, THERMAL.name, grounded=True)
        return (*rates, *ends)

    @property
    def across_inputs(self) -> tuple[laws.AcrossInput, ...]:
        """Inputs of the device: displacement rates of modes, and the temperature."""
        rates = (laws.AcrossInput(pin, rate=True) for pin in self.rate_pins)
        return (*rates, laws.AcrossInput(HEAT, AMBIENT))

    @property
    def flows(self) -> tuple[laws.Flow, ...]:
        """Heat flow into the part at pin ``heat``; negative, because losses flow out."""
        return (laws.Flow(HEAT, AMBIENT),)

    def evaluate(self, e: np.ndarray, mode: Any) -> tuple[np.ndarray, np.ndarray]:
        """Evaluate the heat flow [W] into the pin ``heat``, and its partial derivatives."""
        slope = -2 * np.array([*self.weights, 0.0]) * e
        return np.array([slope @ e / 2]), slope[None]

    def loss(self, e: np.ndarray, mode: Any) -> float:
        """Return the loss for Tellegen's theorem: temperature times heat flow, in K W.

        Tellegen's theorem counts temperature times heat flow as the power at a thermal pin.
        """
        return float(e[-1] * self.evaluate(e, mode)[0][0])


def add_loss_heat(equations: laws.Equations, body: laws.SecondOrderBody) -> laws.Equations:
    """Add the heat flow of all losses to the equations of a body.

    Parameters
    ----------
    equations : Equations
        Pins and results of the body.
    body : SecondOrderBody
        Law of the body. The unknowns of its model must be modes, so that ``E`` is diagonal.

    Returns
    -------
    Equations
        The equations with the additional pins ``heat`` and ``ambient``. The body has an additional
        port for each mode with losses; the rates at these ports determine the heat flow.
    """
    model, n = body.model, body.name
    damping = np.diag(model.E)
    lossy = np.flatnonzero(damping > 0)
    # Each additional port excites one mode, with the largest gain that this mode has at any
    # original port. Therefore, the ports do not change the scales of the integrator's error
    # control.
    reach = np.abs(model.B).max(axis=1)[lossy]
    reach = np.where(reach > 0, reach, 1.0)
    rows = np.zeros((len(lossy), len(damping)))
    rows[np.arange(len(lossy)), lossy] = reach
    heat = LossHeatLaw(f"{n} losses", tuple(map(float, damping[lossy] / reach**2)))
    size = len(lossy)
    known = model.ports[0]
    ports = tuple(type(known)(pin, TRANSLATION.port) for pin in heat.rate_pins)
    wider = replace(
        model,
        B=np.hstack([model.B, rows.T]),
        C=np.vstack([model.C, rows]),
        D=np.pad(model.D, ((0, size), (0, size))),
        ports=(*model.ports, *ports),
        certificate=None,
    )
    more = tuple(laws.LawPort(pin, TRANSLATION.name) for pin in heat.rate_pins)
    body = replace(body, model=wider, ports=(*body.ports, *more))
    ends = tuple((pin, f"{heat.name}.{pin}") for pin in (HEAT, AMBIENT))
    results = {
        f"{n}.{TEMPERATURE}": laws.subtract_waves(*(pin for _, pin in ends)),
        f"{n}.{HEAT}": laws.scale_wave(f"{heat.name}.{HEAT}.through"),
    }
    nets = tuple((f"{n}.{pin}", f"{heat.name}.{pin}") for pin in heat.rate_pins)
    return replace(
        equations,
        laws=(body, heat),
        pins=(*equations.pins, *ends),
        results=equations.results | results,
        nets=(*equations.nets, *nets),
    )


def list_heat_vectors(part: Part, build: BuiltScene, meter: str) -> Mapping[str, PartResult]:
    """Return the ngspice vectors of temperature and heat flow at the pin ``heat``.

    The dictionary is keyed by result name. ``meter`` is the source that measures the heat flow.
    """
    flow = f"i(v.x{part.name}.{meter})".lower()
    result = {f"{part.name}.{HEAT}": PartResult(flow, 1.0, THERMAL.flow_unit, (AMBIENT,), (HEAT,))}
    across = format_voltage(build.get_net(part, HEAT), build.get_net(part, AMBIENT))
    if across:
        result[f"{part.name}.{TEMPERATURE}"] = PartResult(across, 1.0, THERMAL.across.unit)
    return result
