"""Base classes of drivers and of other parts with a netlist template.

The netlist templates are in ``templates/``. A driver is the electronic circuit between a command
voltage and electrodes or coils. The module also contains the operational amplifier that the
templates use.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np
from pydantic import Field

from kc2spice.core import laws
from kc2spice.core.errors import UsageError
from kc2spice.core.magnets import MagnetostaticTable
from kc2spice.core.quantities import BOLTZMANN, DEFAULT_TEMPERATURE, Current, Section, Voltage
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Param, make_positive_parameter
from kc2spice.netlist.library import Header, Subcircuit
from kc2spice.netlist.transforms import merge_helpers
from kc2spice.parts.control._pid_keys import PidKeys
from kc2spice.parts.electronics._driver_laws import (
    OUTPUT_RESISTANCE,
    STATIC_GAIN,
    build_driver_equations,
    make_parameters,
)
from kc2spice.physics.declaration import Declaration
from kc2spice.scene.checks import Check
from kc2spice.scene.keys import list_schema_keys
from kc2spice.scene.model import (
    BuiltScene,
    GovernedScene,
    JoinedScene,
    KeysT,
    Part,
    PartType,
    Scene,
    Terminal,
    WiredScene,
)
from kc2spice.scene.part_records import PartResult
from kc2spice.synthesis.header import ROOM_TEXT, render_library

GAIN_BANDWIDTH = 1e9  # Hz, gain-bandwidth product of a fast decompensated amplifier

Level = Literal["pole", "slew"]
_NOTHING: Mapping[str, Any] = {}


class InputNoise(Section):
    """Keys of the white input noise of an operational amplifier.

    Only noise analyses use the input noise.
    """

    noise_voltage: Voltage | None = Field(
        None,
        gt=0,
        description=(
            "Spectral density of the noise voltage between the inputs of the amplifier, in V "
            "per root hertz (rms); by default 0"
        ),
    )
    noise_current: Current | None = Field(
        None,
        gt=0,
        description=(
            "Spectral density of the noise current at each input of the amplifier, in A per "
            "root hertz (rms); by default 0"
        ),
    )


class TemplatePart(PartType[KeysT]):
    """Base class of parts with a netlist template in ``templates/``.

    The attribute ``template`` is the name of the netlist template. ``heading`` describes the part
    in the first line of its library file. ``fixed`` contains the pins. ``constants`` contains
    numbers for the template that no key sets. ``opamp`` is the level of the operational amplifier
    in the template, or None without an operational amplifier.
    """

    template: ClassVar[str]
    heading: ClassVar[str]
    fixed: ClassVar[tuple[Terminal, ...]]
    rating: ClassVar[str]
    validity: ClassVar[str] = ROOM_TEXT
    opamp: ClassVar[Level | None] = None
    constants: ClassVar[Mapping[str, float]] = {}

    def pins(self, part: Part[KeysT], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins in the order of the subcircuit."""
        return self.fixed

    def template_values(
        self, part: Part[KeysT], build: BuiltScene
    ) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """Return the netlist parameters, and other values that the template needs."""
        return parameters(part.keys), _NOTHING

    def subcircuits(
        self, part: Part[KeysT], build: BuiltScene, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return a tuple with the subcircuit of the part."""
        params, values = self.template_values(part, build)
        if build.has_noise and isinstance(part.keys, InputNoise):
            values = {**values, "input_noise": part.keys}
        return (self.render_subcircuit(header, build.libraries[part.name], params, values),)

    def render_subcircuit(
        self,
        header: Header,
        name: str,
        params: tuple[Param, ...],
        values: Mapping[str, Any] = _NOTHING,
    ) -> Subcircuit:
        """Render the subcircuit ``name`` from the template of the part."""
        limits = {"rating": self.rating, "validity": self.validity}
        words: dict[str, Any] = {**limits, **self.constants, **values}
        result = render_library(
            self.template, header, name, self.heading, self.fixed, params, **words
        )
        if not self.opamp:
            return result
        return merge_helpers(
            result, [make_opamp_subcircuit(header, self.opamp, values.get("input_noise"))]
        )


def parameters(keys: Section, *names: str) -> tuple[Param, ...]:
    """Return keys of the part as positive netlist parameters; by default all keys.

    ``names`` selects the keys.
    """
    return tuple(
        make_positive_parameter(key.name, getattr(keys, key.name), key.unit or "-", key.doc)
        for key in list_schema_keys(type(keys))
        if (not names or key.name in names) and key.name not in InputNoise.model_fields
    )


def make_opamp_subcircuit(
    header: Header, level: Level = "pole", noise: InputNoise | None = None
) -> Subcircuit:
    """Return the subcircuit of an operational amplifier.

    The model includes output resistance and input offset. Between the rails ``vee`` and ``vcc``,
    the output voltage is ``V(out) = A(s) (V(inp) - V(inn))`` with ``A = a0 / (1 + s a0 / (2 pi
    gbw))``. With the level ``slew``, the subcircuit ``opamp_slew`` also limits the slew rate and
    the output current. A resistor of 1 Ohm generates the input ``noise`` of ``opamp_slew``: its
    thermal noise ``sqrt(4 k T 1 Ohm)`` is multiplied by a gain.
    """
    pins = [Terminal(pin, "V", "A") for pin in ("inp", "inn", "out", "vcc", "vee", "ref")]
    params = (
        make_positive_parameter("a0", STATIC_GAIN, "-", "gain at rest"),
        make_positive_parameter("gbw", GAIN_BANDWIDTH, "Hz", "gain-bandwidth product"),
        make_positive_parameter("rout", OUTPUT_RESISTANCE, "Ohm", "output resistance"),
        Param("offset", 0.0, "V", "input offset"),
    )
    title, rating = "operational amplifier", "its output stays between vee and vcc"
    if level == "pole":
        stiff = make_positive_parameter("clip", 1e3, "S", "stiffness of the rails")
        return render_library(
            "opamp", header, "opamp", title, pins, (*params, stiff), rating=rating
        )
    limits = (
        make_positive_parameter("slew", 1e9, "V/s", "fastest change of the output"),
        make_positive_parameter("current_limit", 1.0, "A", "largest output current"),
    )
    title += " with slew rate and current limit"
    ohm = math.sqrt(4 * BOLTZMANN * DEFAULT_TEMPERATURE)
    result = (noise.noise_voltage, noise.noise_current) if noise else (None, None)
    volts, amperes = (item / ohm if item else None for item in result)
    words: dict[str, Any] = {"rating": rating, "volts": volts, "amperes": amperes}
    return render_library("opamp_slew", header, "opamp_slew", title, pins, params + limits, **words)


# Relative margin of rail checks.
# The margin allows for the resistance of supplies and for errors at the recorded time points.
RAIL_MARGIN = 1e-3
OVERDRIVE_ADVICE = (
    "its load drives it beyond its rails, where diodes of a real output would conduct"
)


class CoilLoad(NamedTuple):
    """Electrical load of a coil driver between its pins ``drive`` and ``ret``.

    The load is a series connection of both coils, with the lower coil reversed.
    """

    inductance: float  # of the coils [H]
    resistance: float  # of the coils [Ohm]
    current: float = 1.0  # A, largest current that the controller can set


def list_pin_voltages(part: Part, build: BuiltScene, pins: Iterable[str]) -> dict[str, PartResult]:
    """Return the results ``PART.PIN`` of a part, which are its pin voltages.

    The voltages are relative to the pin ``ref`` if the part has such a pin, otherwise to node 0.
    """
    base = build.get_net(part, "ref") if (part.name, "ref") in build.scene.nets else "0"
    result = {}
    for pin in pins:
        net = build.get_net(part, pin)
        ends = "".join(f"{sign}v({n})" for sign, n in (("", net), ("-", base)) if n != "0")
        if ends and net != base:
            result[f"{part.name}.{pin}"] = PartResult(ends, 1.0, "V")
    return result


def make_driver_pins(*terminals: str) -> tuple[Terminal, ...]:
    """Return the pins of a driver: ``command``, the output ``terminals`` and ``ref``."""
    driven = (Terminal(name, "V", "A", required=True) for name in terminals)
    return (Terminal("command", "V", "-"), *driven, Terminal("ref", "V", "A", "gnd"))


class Driver(TemplatePart[KeysT]):
    """Base class of drivers, which have the pin ``command`` and output terminals.

    The last resistor of the netlist is ``Rout``, which connects ``inner_node`` to the first
    terminal.
    """

    opamp: ClassVar[Level | None] = "slew"
    inner_node: ClassVar[str] = "drive"
    terminals: tuple[str, ...] = ("out",)
    fixed = make_driver_pins("out")
    validity = "27 C (transistors: .options temp); no heating, ageing or failure"
    rating = (
        "voltage and current stay within its parameters; compare rms current and power with the "
        "data sheet of your devices"
    )

    @abstractmethod
    def declare_circuit(self, parameters: tuple[Param, ...]) -> Declaration:
        """Return the declaration of the driver's circuit for its netlist parameters."""

    def law(self, part: Part[KeysT], build: BuiltScene) -> laws.Equations | laws.MissingEquations:
        """Return the model equations of the part."""
        if build.has_noise:
            return laws.MissingEquations("its equations do not include noise")
        if build.get_net(part, "ref") != "0":
            return laws.MissingEquations("its pin ref is not connected to ground")
        params, values = self.template_values(part, build)
        declared = self.declare_circuit((*params, *make_parameters(values)))
        return build_driver_equations(part.name, declared, self.inner_node, self.terminals)

    def subcircuit_name(self, part: Part[KeysT], scene: Scene) -> str:
        """Return the name of the subcircuit: the template name without ``driver_``.

        If the scene has several such drivers, return the name of the part.
        """
        return (
            self.template.removeprefix("driver_")
            if len(scene.list_parts(self.name)) == 1
            else part.name
        )

    def vectors(self, part: Part[KeysT], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors of the part's results, keyed by result name."""
        if build.scene.analysis.type != "transient":
            return {}
        result = list_pin_voltages(part, build, ("command", *self.terminals))
        read = f"@r.x{part.name.lower()}.rout[i]"
        return result | {f"{part.name}.i": PartResult(read, 1.0, "A", self.terminals[:1])}

    def checks(self, part: Part[KeysT], build: BuiltScene, waves: Waveforms) -> Iterator[Check]:
        """Yield the check that the amplifier's output voltage stays between its rails.

        A load could drive the output beyond the rails. The checked voltage is the voltage before
        the output resistances. A bridge is not checked, because its diodes keep the voltage within
        the rails.
        """
        name, i = f"{part.name}.{self.terminals[0]}", f"{part.name}.i"
        if self.opamp == "slew" and {"time", name, i} <= set(waves.data):
            low, high = self.rails(part)
            inner = (
                waves[name] + (getattr(part.keys, "resistance", 0.0) + OUTPUT_RESISTANCE) * waves[i]
            )
            yield make_rails_check(
                part.name, inner, low, high, RAIL_MARGIN * (high - low), OVERDRIVE_ADVICE
            )

    def notes(self, part: Part[KeysT], scene: Scene) -> Iterator[str]:
        """Yield the assumptions of the model and the effects that it neglects."""
        settings = (f"{key} {value:g}" for key, value in part.keys if value is not None)
        yield f"{self.name}, " + ", ".join(settings)


class CoilDriver(Driver[KeysT]):
    """Base class of drivers that are current sources for coils.

    The set current is ``V(command) / 100 Ohm``. The control loop is designed for the coils that are
    connected to the terminals.
    """

    terminals, fixed = ("drive", "ret"), make_driver_pins("drive", "ret")

    def template_values(
        self, part: Part[KeysT], build: BuiltScene
    ) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """Return netlist parameters and template values that suit the connected coils."""
        return self.adapt_to_load(part.keys, self.compute_coil_load(part, build))

    @abstractmethod
    def adapt_to_load(
        self, keys: Any, load: CoilLoad
    ) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """Return netlist parameters and template values that suit the coils ``load``."""

    def default_joins(self, part: Part[KeysT], scene: GovernedScene) -> Mapping[str, str]:
        """Return the default connection of the pin ``command`` to a controller output.

        The pin ``command`` is connected to the only controller of the scene.
        """
        control = scene.find_only_part("pid")
        return {} if control is None else {"command": f"{control.name}.command"}

    def compute_coil_load(self, part: Part[KeysT], build: BuiltScene) -> CoilLoad:
        """Compute the load of the driver: the coils at its terminals.

        The inductance of the coils is computed for a sphere at the set point.
        """
        coils = _find_joined_part(part, "drive", build.scene, "ring_magnet_coils")
        if coils is None:
            raise UsageError(
                "this driver is not connected to coils",
                where=f"{part.name}.drive",
                expected="a connection to a part of type ring_magnet_coils",
                hint="for another load, put the circuit of the driver into a netlist part",
            )
        control, height, current = _find_joined_part(part, "command", build.scene, "pid"), 0.0, 1.0
        if control is not None:
            keys = control.with_schema(PidKeys).keys
            height, current = keys.setpoint, keys.current_limit
        table = build.model(coils, MagnetostaticTable)
        series = np.array([1.0, -1.0])
        inductance = float(series @ table.coenergy.compute_inductances(height) @ series)
        return CoilLoad(inductance, float(table.resistance.sum()), float(current))


def _find_joined_part(part: Part, pin: str, scene: WiredScene, kind: str) -> Part | None:
    """Return the part of type ``kind`` that is connected to the pin ``pin``.

    Return None if no part of this type is connected.
    """
    joined = (scene.parts[name] for name, _ in scene.list_joined_pins(part.name, pin))
    return next((other for other in joined if other.type.name == kind), None)


def make_rails_check(
    name: str, volts: np.ndarray, low: float, high: float, slack: float, advice: str
) -> Check:
    """Return the check that the voltage ``volts`` stays between two rails.

    The voltage may exceed the rails ``low`` and ``high`` by ``slack`` [V].
    """
    beyond = max(0.0, float(np.maximum(volts - high, low - volts).max()))
    return Check(f"{name} within its rails", beyond, slack, "V beyond", advice, wiring=True)
