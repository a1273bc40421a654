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

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.errors import UsageError
from kc2spice.core.magnets import MagnetostaticTable
from kc2spice.core.quantities import BOLTZMANN, DEFAULT_TEMPERATURE, Current, Section, Voltage
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Param, make_positive_parameter
from kc2spice.netlist.subcircuit_library import Header, Subcircuit
from kc2spice.netlist.transforms import merge_helpers
from kc2spice.parts.control._pid_keys import MAX_SATURATED_SHARE, PidKeys
from kc2spice.parts.electronics._driver_laws import (
    OUTPUT_RESISTANCE,
    STATIC_GAIN,
    build_driver_equations,
    make_parameters,
)
from kc2spice.physics.declaration import Declaration
from kc2spice.scene.checks import Check
from kc2spice.scene.keys import list_schema_keys
from kc2spice.scene.part_records import NeglectedEffect, PartResult
from kc2spice.scene.scene_classes import (
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
from kc2spice.synthesis.library_headers import ROOM_TEXT, render_library

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
    numbers for the template that no key sets. ``opamp`` is the level of detail of the operational
    amplifier's model, or None if the template contains no operational amplifier.
    """

    template: ClassVar[str]
    heading: ClassVar[str]
    fixed: ClassVar[tuple[Terminal, ...]]
    rating: ClassVar[str]
    validity: ClassVar[str] = ROOM_TEXT
    opamp: ClassVar[Level | None] = None
    constants: ClassVar[Mapping[str, float]] = {}

    def pins(self, part: Part[KeysT], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        return self.fixed

    def template_values(
        self, part: Part[KeysT], build: BuiltScene
    ) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """Return the netlist parameters, and other values that the template needs."""
        return make_key_parameters(part.keys), _NOTHING

    def subcircuits(
        self, part: Part[KeysT], build: BuiltScene, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return the subcircuit of the part, as a tuple of length 1."""
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


def make_key_parameters(keys: Section, *names: str) -> tuple[Param, ...]:
    """Make netlist parameters from keys of the part; the values must be positive.

    ``names`` selects the keys, by default all keys. Keys of the input noise are omitted.
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
    the output voltage is ``V(out) = A(s) (V(inp) - V(inn))`` with ``A = a0 / (1 + s * a0 / (2 pi *
    gbw))``. With the level ``slew``, the subcircuit ``opamp_slew`` also limits the slew rate and
    the output current. A resistor of 1 Ohm generates the input ``noise`` of ``opamp_slew``: its
    thermal noise ``sqrt(4 k T 1 Ohm)`` is multiplied by a gain.
    """
    pins = [Terminal(pin, "V", "A") for pin in ("inp", "inn", "out", "vcc", "vee", "ref")]
    params = (
        make_positive_parameter("a0", STATIC_GAIN, "-", "open-loop DC gain"),
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
        make_positive_parameter("slew", 1e9, "V/s", "slew rate of the output"),
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
SWITCHING_ADVICE = (
    "the driver switches, and a linear analysis describes only its state at the operating point: "
    "use a transient analysis"
)
# The tolerance of a driver's command is RAIL_MARGIN times the largest command of the run.
# If the largest command is below MIN_COMMAND [V], the tolerance is RAIL_MARGIN * MIN_COMMAND.
MIN_COMMAND = 1.0


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
    # relation of the output to the command
    function: ClassVar[str]
    # names of the keys that set the lower and the upper rail
    rail_keys: ClassVar[tuple[str, str]] = ("rail", "rail")
    terminals: tuple[str, ...] = ("out",)
    fixed = make_driver_pins("out")
    validity = "27 C (transistors: .options temp); no heating, ageing or failure"
    rating = (
        "its parameters limit voltage and current; compare rms current and power with the data "
        "sheet of your devices"
    )

    @abstractmethod
    def declare_circuit(self, parameters: tuple[Param, ...]) -> Declaration:
        """Return the declaration of the driver's circuit with the netlist ``parameters``."""

    def law(self, part: Part[KeysT], build: BuiltScene) -> laws.Equations | laws.MissingEquations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice."""
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
        """Return the ngspice vectors: expressions of the part's results, keyed by name.

        In an ac analysis, ngspice has no complex current of a resistor. The current is therefore
        the voltage across ``Rout``, divided by its resistance, except in transients.
        """
        kind, n = build.scene.analysis.type, part.name
        if build.has_noise or (kind != "transient" and self.opamp != "slew"):
            return {}
        result = list_pin_voltages(part, build, ("command", *self.terminals))
        read, factor = f"@r.x{n.lower()}.rout[i]", 1.0
        if kind != "transient":
            net = build.get_net(part, self.terminals[0])
            read = f"v(x{n.lower()}.{self.inner_node})" + f"-v({net})" * (net != "0")
            factor = 1.0 / self.get_series_resistance(part)
        return result | {f"{n}.i": PartResult(read, factor, "A", self.terminals[:1])}

    def get_series_resistance(self, part: Part[KeysT]) -> float:
        """Return the resistance [Ohm] in series with the first terminal.

        The resistance is the value of ``Rout``, from ``inner_node`` to the first terminal.
        """
        return float(part.keys.resistance)  # type: ignore[attr-defined]

    def compute_control_variables(
        self, part: Part[KeysT], waves: Waveforms
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the control variables: set and actual voltage [V] of the control loop."""
        raise NotImplementedError

    def read_pin(self, part: Part[KeysT], waves: Waveforms, pin: str) -> np.ndarray:
        """Return the recorded voltage [V] of a pin, or zeros without a recorded result."""
        return waves.data.get(f"{part.name}.{pin}", np.zeros(waves.scale.shape))

    def compute_inner_voltage(
        self, part: Part[KeysT], waves: Waveforms, resistance: float = 0.0
    ) -> np.ndarray:
        """Return the voltage [V] of ``inner_node``, before an output ``resistance`` [Ohm]."""
        total = self.get_series_resistance(part) + resistance
        volts = self.read_pin(part, waves, self.terminals[0])
        return np.asarray(volts + total * waves[f"{part.name}.i"])

    def checks(self, part: Part[KeysT], build: BuiltScene, waves: Waveforms) -> Iterator[Check]:
        """Yield the checks for clipping at the rails and for an output beyond the rails.

        The check of the rails detects a load that drives the output beyond the rails. The checked
        voltage is the voltage before the output resistances. The diodes of a bridge keep its
        voltage within the rails.
        """
        if f"{part.name}.i" not in waves or build.scene.analysis.is_small_signal:
            return
        if self.opamp == "slew" and "time" in waves:
            low, high = self.rails(part)
            inner = self.compute_inner_voltage(part, waves, OUTPUT_RESISTANCE)
            yield make_rails_check(
                part.name, inner, low, high, RAIL_MARGIN * (high - low), OVERDRIVE_ADVICE
            )
        yield from self._check_clipping(part, build, waves)

    def check_operating_point(
        self, part: Part[KeysT], build: BuiltScene, point: Waveforms
    ) -> Iterator[Check]:
        """Yield the check that the output is not at a rail at the operating point."""
        if f"{part.name}.i" in point:
            yield from self._check_clipping(part, build, point)

    def find_clipping(self, part: Part[KeysT], waves: Waveforms) -> tuple[np.ndarray, np.ndarray]:
        """Return masks of the samples with clipping at the lower and at the upper rail.

        The output clips if its voltage is at a rail, and the command requests a voltage beyond
        this rail.
        """
        low, high = self.rails(part)
        inner = self.compute_inner_voltage(part, waves, OUTPUT_RESISTANCE)
        wanted, actual = self.compute_control_variables(part, waves)
        margin = RAIL_MARGIN * (high - low)
        slack = RAIL_MARGIN * max(MIN_COMMAND, float(np.abs(wanted).max()))
        return (
            (inner <= low + margin) & (wanted < actual - slack),
            (inner >= high - margin) & (wanted > actual + slack),
        )

    def _check_clipping(
        self, part: Part[KeysT], build: BuiltScene, waves: Waveforms
    ) -> Iterator[Check]:
        """Yield the check that the output does not clip at a rail."""
        if self.opamp is None:
            return
        scale, sides = waves.scale.real, self.find_clipping(part, waves)
        clipped = (sides[0] | sides[1]).astype(float)
        share, first = float(clipped.mean()), int(np.argmax(clipped))
        unit, where = "of the points", ""
        if "time" in waves:
            share, unit = float(np.trapezoid(clipped, scale) / np.ptp(scale)), "of the time"
            where = f" from {format_quantity(scale[first], 's')} on"
        elif "sweep" in waves:
            where = f" at the swept value {scale[first]:.4g}"
        side = int(sides[1][first])
        advice = (
            f"the output is at its rail of {format_quantity(self.rails(part)[side], 'V')}{where}, "
            f"and the command requests a voltage beyond this rail: lower the command, or increase "
            f"the magnitude of {part.key_prefix}.{self.rail_keys[side]}"
        )
        action = build.scene.checks.saturation
        limit = self.get_permitted_clipping(part, build)
        name, label = f"clipping of {part.name}", f"share of time clipped, {part.name}"
        yield Check(name, share, limit, unit, advice, action, label=label)

    def get_permitted_clipping(self, part: Part[KeysT], build: BuiltScene) -> float:
        """Return the largest permitted fraction of the run during which the output clips."""
        return 0.0

    def check_amplitudes(
        self, part: Part[KeysT], build: BuiltScene, point: Waveforms | None, waves: Waveforms
    ) -> Iterator[Check]:
        """Yield checks of ac amplitudes against rails, current limit and slew rate.

        The largest permitted amplitude is the distance from the operating point to the nearer limit
        of the voltage or current. Without a known operating point, the operating point is assumed
        in the middle between both limits, where the permitted amplitudes are largest. The amplitude
        of the slope at the frequency f is ``2 pi f`` times the amplitude of the voltage.
        """
        n, action = part.name, build.scene.checks.saturation
        if self.opamp != "slew":
            yield Check(f"switching of {n}", 1.0, 0.0, "", SWITCHING_ADVICE, action)
        if f"{n}.i" not in waves:
            return
        (low, high), parameters = self.rails(part), self.template_values(part, build)[0]
        limits = {parameter.name: parameter.default for parameter in parameters}
        voltage, current = (high + low) / 2, 0.0
        if point is not None and f"{n}.i" in point:
            voltage = float(self.compute_inner_voltage(part, point, OUTPUT_RESISTANCE)[-1])
            current = float(point[f"{n}.i"][-1])
        side = int(high - voltage < voltage - low)
        rail, bias = format_quantity((low, high)[side], "V"), format_quantity(voltage, "V")
        distance = max(min(high - voltage, voltage - low), 0.0)
        reserve = max(limits["current_limit"] - abs(current), 0.0)
        volts = self.compute_inner_voltage(part, waves, OUTPUT_RESISTANCE)
        frequency = waves["frequency"].real
        nearest = f"the supply rail at {rail}, nearest to the operating point of {bias}"
        rows = (
            ("voltage", volts, distance, "V", nearest, self.rail_keys[side]),
            ("current", waves[f"{n}.i"], reserve, "A", "the current limit", "current_limit"),
            (
                "slope",
                2 * np.pi * frequency * volts,
                limits["slew"],
                "V/s",
                "the slew rate",
                "slew",
            ),
        )
        for what, wave, limit, unit, neglected, key in rows:
            worst = int(np.argmax(np.abs(wave)))
            advice = (
                f"the amplitude is largest at {format_quantity(frequency[worst], 'Hz')}, and a "
                f"linear analysis neglects {neglected}: lower the amplitude of the source"
            )
            if key in type(part.keys).model_fields:
                advice += f", or increase the magnitude of {part.key_prefix}.{key}"
            name = f"output {what} of {n}"
            yield Check(name, float(np.abs(wave[worst])), limit, unit, advice, action)

    def notes(self, part: Part[KeysT], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        units = {key.name: key.unit for key in list_schema_keys(type(part.keys))}
        settings = (
            f"{key} {format_quantity(value, units[key] or '')}"
            for key, value in part.keys
            if value is not None
        )
        low, high = (format_quantity(volts, "V") for volts in self.rails(part))
        between = f"the output voltage stays between {low} and {high}"
        yield f"{self.name}, {self.function}; {between}; " + ", ".join(settings)
        if scene.analysis.is_small_signal:
            effect, size = "switching", "not estimated"
            if self.opamp == "slew":
                effect = "rails, current limit and slew rate"
            if self.opamp == "slew" and scene.analysis.type == "ac":
                size = "checks compare the amplitudes of the output with these limits"
            yield NeglectedEffect(effect, "the analysis is linear", size)


class CoilDriver(Driver[KeysT]):
    """Base class of drivers that are current sources for coils.

    The set current is ``V(command) / 100 Ohm``. The control loop is designed for the coils that are
    connected to the terminals.
    """

    terminals, fixed = ("drive", "ret"), make_driver_pins("drive", "ret")

    def template_values(
        self, part: Part[KeysT], build: BuiltScene
    ) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """Return parameters and template values for the coils that the driver feeds."""
        return self.adapt_to_load(part.keys, self.compute_coil_load(part, build))

    @abstractmethod
    def adapt_to_load(
        self, keys: Any, load: CoilLoad
    ) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """Return netlist parameters and template values that suit the coils ``load``."""

    def default_joins(self, part: Part[KeysT], scene: GovernedScene) -> Mapping[str, str]:
        """Return the default connection of the pin ``command`` to the controller.

        The pin ``command`` is connected to the only controller of the scene.
        """
        control = scene.find_only_part("pid")
        return {} if control is None else {"command": f"{control.name}.command"}

    def get_permitted_clipping(self, part: Part[KeysT], build: BuiltScene) -> float:
        """Return the largest permitted fraction of the run during which the output clips.

        A controller that commands the driver corrects the effect of short clipping.
        """
        control = _find_joined_part(part, "command", build.scene, "pid")
        return 0.0 if control is None else MAX_SATURATED_SHARE

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
    return Check(
        f"{name} within its rails",
        beyond,
        slack,
        "V beyond",
        advice,
        wiring=True,
        label=f"{name}, voltage beyond its rails",
    )
