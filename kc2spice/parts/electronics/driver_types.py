"""The part types of drivers, with the keys, circuit and rails of each type."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, ClassVar

import numpy as np
from pydantic import Field

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.quantities import (
    Capacitance,
    Current,
    Frequency,
    Resistance,
    Section,
    Slew,
    Time,
    Voltage,
)
from kc2spice.core.waveforms import Waveforms, make_sine_waveform
from kc2spice.netlist.circuit import Param, make_positive_parameter
from kc2spice.parts.control.pid import SENSE_RESISTANCE
from kc2spice.parts.electronics._driver_laws import (
    declare_amplifier,
    declare_charge_drive,
    declare_half_bridge,
    declare_linear_drive,
    declare_pwm_drive,
)
from kc2spice.parts.electronics._parts_with_netlist_template import (
    RAIL_MARGIN,
    CoilDriver,
    CoilLoad,
    Driver,
    InputNoise,
    make_driver_pins,
    make_key_parameters,
)
from kc2spice.physics.declaration import Declaration
from kc2spice.scene.part_records import HighestFrequency, NumericalRequirements
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    BuiltScene,
    DeclaredScene,
    Part,
    WiredScene,
)

DEFAULT_NEGATIVE_RAIL = -10.0  # V


class AmplifierKeys(InputNoise):
    """Keys of a high-voltage amplifier whose output voltage follows the command.

    The gain from the command to the output is 1, because a divider by 20 precedes an amplifier
    stage with a gain of 20.
    """

    rail: Voltage = Field(120.0, gt=0, description="Positive supply voltage of the amplifier")
    negative_rail: Voltage | None = Field(
        None,
        le=0,
        description=(
            "Negative supply voltage of the amplifier, below which the output voltage cannot "
            f"fall; by default {DEFAULT_NEGATIVE_RAIL:g} V"
        ),
    )
    resistance: Resistance = Field(
        2.0, gt=0, description="Series resistance between the amplifier and the piezoelectric chip"
    )
    bandwidth: Frequency = Field(2e6, gt=0, description="Closed-loop bandwidth of the amplifier")
    slew: Slew = Field(
        1e9,
        gt=0,
        description="Slew rate: largest rate of change of the amplifier's output voltage",
    )
    current_limit: Current = Field(
        15.0, gt=0, description="Largest output current of the amplifier"
    )


class Amplifier(Driver[AmplifierKeys]):
    """Part type ``amplifier``: high-voltage amplifier with limited slew rate.

    The gain from the command to the output is 1. The amplifier also limits its output current.
    """

    name, title = "amplifier", "high-voltage amplifier with slew rate and current limit"
    function = "the output voltage follows the command with a gain of 1"
    schema = AmplifierKeys
    template, heading = "driver_amplifier", "high-voltage amplifier for a piezoelectric chip"
    noise = ("R", "Rout")
    rail_keys = ("negative_rail", "rail")

    def template_values(
        self, part: Part[AmplifierKeys], build: BuiltScene
    ) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """Return the netlist parameters, and the lower rail [V] that the template needs."""
        names = set(AmplifierKeys.model_fields) - {"negative_rail"}
        return make_key_parameters(part.keys, *names), {"negative_rail": self.rails(part)[0]}

    def declare_circuit(self, parameters: tuple[Param, ...]) -> Declaration:
        """Return the declaration of the amplifier's circuit."""
        return declare_amplifier(parameters)

    def compute_control_variables(
        self, part: Part[AmplifierKeys], waves: Waveforms
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the control variables: command voltage and inner output voltage [V].

        The feedback divider is connected to the inner output, before the series resistor.
        """
        return self.read_pin(part, waves, "command"), self.compute_inner_voltage(part, waves)

    def rails(self, part: Part[AmplifierKeys]) -> tuple[float, float]:
        """Return the lowest and highest output voltage [V] of the amplifier."""
        low = part.keys.negative_rail
        return DEFAULT_NEGATIVE_RAIL if low is None else low, part.keys.rail


class ChargeDriveKeys(InputNoise):
    """Keys of an amplifier that controls the charge of a piezoelectric chip.

    The charge is ``capacitance`` times the command voltage.
    """

    capacitance: Capacitance = Field(
        150e-9,
        gt=0,
        description="Charge of the piezoelectric chip for each volt of the command voltage",
    )
    sense: Capacitance = Field(
        1e-6,
        gt=0,
        description=(
            "Capacitance of the capacitor in series with the piezoelectric chip; the "
            "voltage of the capacitor measures the charge of the chip"
        ),
    )
    rail: Voltage = Field(
        300.0, gt=0, description="Magnitude U of the amplifier's supply voltages, +U and -U"
    )
    resistance: Resistance = Field(
        20.0, gt=0, description="Series resistance between the amplifier and the piezoelectric chip"
    )
    bandwidth: Frequency = Field(
        200e3, gt=0, description="Closed-loop bandwidth of the charge amplifier"
    )
    slew: Slew = Field(
        1e9,
        gt=0,
        description="Slew rate: largest rate of change of the amplifier's output voltage",
    )
    current_limit: Current = Field(
        10.0, gt=0, description="Largest output current of the amplifier"
    )


class ChargeDrive(Driver[ChargeDriveKeys]):
    """Part type ``charge_drive``: charge control of a floating capacitive load."""

    name, title = "charge_drive", "charge drive for a floating capacitive load"
    function = "the charge on the load is `capacitance` times the command"
    schema = ChargeDriveKeys
    template, heading = "driver_charge", "charge drive for a piezoelectric chip"
    noise = ("Rout", "Rsense", "Rchip")
    terminals, fixed = ("anode", "cathode"), make_driver_pins("anode", "cathode")

    def declare_circuit(self, parameters: tuple[Param, ...]) -> Declaration:
        """Return the declaration of the charge drive's circuit."""
        return declare_charge_drive(parameters)

    def compute_control_variables(
        self, part: Part[ChargeDriveKeys], waves: Waveforms
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the control variables: set and actual sense-capacitor voltage [V]."""
        target = part.keys.capacitance / part.keys.sense * self.read_pin(part, waves, "command")
        return target, self.read_pin(part, waves, "cathode")

    def rails(self, part: Part[ChargeDriveKeys]) -> tuple[float, float]:
        """Return the negative and the positive supply voltage [V]."""
        return -part.keys.rail, part.keys.rail


class HalfBridgeKeys(Section):
    """Keys of a half-bridge of two transistors, supplied by a charged capacitor.

    The upper transistor conducts during the kick pulse.
    """

    rail: Voltage = Field(100.0, gt=0, description="Supply voltage of the half-bridge")
    resistance: Resistance = Field(
        2.0,
        gt=0,
        description="Series resistance between the half-bridge and the piezoelectric chip",
    )
    gate_resistance: Resistance = Field(
        10.0,
        gt=0,
        description="Resistance in series with the gate of each transistor of the half-bridge",
    )
    current_limit: Current = Field(
        15.0, gt=0, description="Current at which each transistor of the half-bridge saturates"
    )
    reservoir: Capacitance = Field(
        10e-6,
        gt=0,
        description="Capacitance of the supply capacitor, which delivers the charge of a pulse",
    )
    supply_resistance: Resistance = Field(
        100.0, gt=0, description="Resistance through which the supply capacitor is recharged"
    )
    leakage: Resistance = Field(
        10e6,
        gt=0,
        description=(
            "Leakage resistance from the half-bridge's output to the pin `ref`, which "
            "matters while both transistors are off"
        ),
    )


class HalfBridge(Driver[HalfBridgeKeys]):
    """Part type ``half_bridge``: half-bridge with gate resistors and reservoir capacitor."""

    name, title = "half_bridge", "half-bridge with gate resistors and reservoir capacitor"
    function = "the output is 0 V or the rail, and switches where the command crosses half the rail"
    schema = HalfBridgeKeys
    template, heading = "driver_half_bridge", "half-bridge driver for a piezoelectric chip"
    noise = ("Rout", "Rsupply", "Rhigh", "Rlow")
    opamp = None
    inner_node = "bridge"

    def declare_circuit(self, parameters: tuple[Param, ...]) -> Declaration:
        """Return the declaration of the half-bridge's circuit."""
        return declare_half_bridge(parameters)

    def rails(self, part: Part[HalfBridgeKeys]) -> tuple[float, float]:
        """Return the lowest and highest output voltage [V]: 0 and the supply voltage."""
        return 0.0, part.keys.rail


class LinearDriverKeys(InputNoise):
    """Keys of a linear current source for coils.

    The source consists of a linear operational amplifier between two rails, and a sense resistor.
    """

    rail: Voltage = Field(
        48.0, gt=0, description="Magnitude U of the amplifier's supply voltages, +U and -U"
    )
    bandwidth: Frequency = Field(
        50e3, gt=0, description="Bandwidth of the control loop for the coil current"
    )
    slew: Slew = Field(
        20e6,
        gt=0,
        description="Slew rate: largest rate of change of the amplifier's output voltage",
    )


LINEAR_SERIES_RESISTANCE = 1.0  # Ohm, ``Rout`` of the template ``driver_linear``


class LinearDrive(CoilDriver[LinearDriverKeys]):
    """Part type ``linear_drive``: linear amplifier as a current source for coils."""

    name, title = "linear_drive", "current source for coils, linear amplifier between two rails"
    function = "the coil current is the command divided by 100 Ohm"
    schema = LinearDriverKeys
    template, heading = "driver_linear", "current source for the coils"
    noise = ("R", "Rout", "Rsense")
    constants: ClassVar = {"sense": SENSE_RESISTANCE}
    inner_node = "power"

    def declare_circuit(self, parameters: tuple[Param, ...]) -> Declaration:
        """Return the declaration of the linear current source's circuit."""
        return declare_linear_drive(parameters, self.constants["sense"])

    def get_series_resistance(self, part: Part[LinearDriverKeys]) -> float:
        """Return the resistance [Ohm] of ``Rout``."""
        return LINEAR_SERIES_RESISTANCE

    def compute_control_variables(
        self, part: Part[LinearDriverKeys], waves: Waveforms
    ) -> tuple[np.ndarray, np.ndarray]:
        """Compute the control variables: command voltage and sense-resistor voltage [V]."""
        return self.read_pin(part, waves, "command"), self.read_pin(part, waves, "ret")

    def rails(self, part: Part[LinearDriverKeys]) -> tuple[float, float]:
        """Return the negative and the positive supply voltage [V]."""
        return -part.keys.rail, part.keys.rail

    def adapt_to_load(
        self, keys: LinearDriverKeys, load: CoilLoad
    ) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """Return netlist parameters and template values that suit the coils ``load``.

        The output voltage is ``drive = command + (command - V(ret)) ratio (1 + 1 / (s L / R))``
        with ``ratio = 2 pi f L / 100 Ohm``. In the formulas for ``drive`` and ``ratio``, f is the
        bandwidth of the control loop, and L and R are the inductance and the resistance of the
        coils. The amplifier has the bandwidth ``5 f``.
        """
        ratio = 2 * math.pi * keys.bandwidth * load.inductance / SENSE_RESISTANCE
        resistance = load.resistance + SENSE_RESISTANCE
        limit = make_positive_parameter(
            "current_limit", 2 * load.current, "A", "largest output current"
        )
        return (*make_key_parameters(keys, "rail", "slew"), limit), {
            "inductance": load.inductance,
            "resistance": resistance,
            "bandwidth": keys.bandwidth,
            "ratio": ratio,
            "constant": load.inductance / resistance,
            "gbw": 5 * keys.bandwidth * (1 + ratio),
        }


# number of carrier harmonics with 99.9 % of the energy of a triangular current ripple
RIPPLE_HARMONICS = 3


class PwmKeys(Section):
    """Keys of a switched current source for coils.

    The source consists of an H-bridge, a pulse-width modulator and a PI controller.
    """

    rail: Voltage = Field(100.0, gt=0, description="Supply voltage of the H-bridge")
    frequency: Frequency = Field(
        100e3, gt=0, description="Carrier frequency of the pulse-width modulation"
    )
    bandwidth: Frequency = Field(
        10e3, gt=0, description="Bandwidth of the control loop for the coil current"
    )
    resistance: Resistance = Field(
        0.5, gt=0, description="On-resistance of each switch of the H-bridge"
    )
    edge: Time = Field(
        50e-9,
        gt=0,
        description="Rise time of the switched voltage of the H-bridge, equal to the fall time",
    )


class PwmDrive(CoilDriver[PwmKeys]):
    """Part type ``pwm_drive``: switched H-bridge as a current source for coils."""

    name, title = "pwm_drive", "current source for coils, pulse-width modulated H-bridge"
    function = "the coil current is the command divided by 100 Ohm"
    schema = PwmKeys
    template, heading = "driver_pwm", "H-bridge for the coils"
    opamp = "pole"
    noise = "no noise: it switches, and a noise analysis is linearized at one operating point"
    # ``carrier`` is the peak of the triangle [V].
    # ``headroom`` is the rail voltage of the controller, divided by the peak of the triangle.
    # ``shunt`` is the resistor in the return line [Ohm].
    # ``sense`` is the voltage for each ampere in the shunt [Ohm].
    constants: ClassVar = {"carrier": 10.0, "headroom": 1.2, "shunt": 1, "sense": SENSE_RESISTANCE}

    def declare_circuit(self, parameters: tuple[Param, ...]) -> Declaration:
        """Return the declaration of the switched current source's circuit."""
        return declare_pwm_drive(parameters, **self.constants)

    def rails(self, part: Part[PwmKeys]) -> tuple[float, float]:
        """Return the lowest and highest voltage [V] of each leg: 0 and the supply voltage."""
        return 0.0, part.keys.rail

    def find_clipping(self, part: Part[PwmKeys], waves: Waveforms) -> tuple[np.ndarray, np.ndarray]:
        """Return masks of the times at which a leg clips at the lower or upper rail.

        The modulator clips if the voltage of a leg stays at a rail for more than one period of the
        carrier.
        """
        (low, high), leg = self.rails(part), self.compute_inner_voltage(part, waves)
        margin, period = RAIL_MARGIN * (high - low), 1 / part.keys.frequency
        return (
            _select_long_intervals(leg <= low + margin, waves["time"], period),
            _select_long_intervals(leg >= high - margin, waves["time"], period),
        )

    def law(self, part: Part[PwmKeys], build: BuiltScene) -> laws.Equations | laws.MissingEquations:
        """Return the model equations of the circuit and of the carrier waveform.

        The triangular carrier is proportional to the arcsine of a sinusoidal signal.
        """
        result = super().law(part, build)
        if isinstance(result, laws.MissingEquations):
            return result
        name = f"{part.name} carrier"
        carrier = laws.IdealSource(name, "signal", make_sine_waveform(1.0, part.keys.frequency))
        # The resistor to the pin ``drive`` begins at the output of one bridge leg.
        # The output of this bridge leg is not a node of the equations.
        results = {
            **result.results,
            f"{part.name}.i": laws.scale_wave(f"{part.name}.drive.through", -1.0),
        }
        return replace(
            result,
            laws=(*result.laws, carrier),
            nets=((f"{name}.out", f"{part.name}.sine"),),
            results=results,
        )

    def adapt_to_load(
        self, keys: PwmKeys, load: CoilLoad
    ) -> tuple[tuple[Param, ...], Mapping[str, Any]]:
        """Return netlist parameters and template values that suit the coils ``load``.

        The output of the controller is ``u = command + (command - 100 Ohm * i) * ratio * (1 + 1 /
        (s L / R))`` with ``ratio = 2 pi * f * L * carrier / (100 Ohm * rail)``. In the formulas for
        ``u`` and ``ratio``, f is the bandwidth of the control loop, L the inductance of the coils,
        and R the resistance of the coil circuit. A comparator compares the output of the controller
        with a triangle of the amplitude ``carrier``.
        """
        resistance = load.resistance + 2 * keys.resistance + self.constants["shunt"]
        r2 = (
            1e5
            * 2
            * math.pi
            * keys.bandwidth
            * load.inductance
            * self.constants["carrier"]
            / SENSE_RESISTANCE
        )
        return make_key_parameters(keys, "rail", "frequency", "resistance", "edge"), {
            "inductance": load.inductance,
            "coil_resistance": resistance,
            "bandwidth": keys.bandwidth,
            "r2": r2,  # feedback resistance of the controller times the rail voltage [Ohm V]
            "constant": load.inductance / resistance,
        }

    def numerics(self, part: Part[PwmKeys], scene: WiredScene) -> Iterable[NumericalRequirements]:
        """Return numerical requirements: time steps that resolve PWM carrier and edges."""
        f, edge = part.keys.frequency, part.keys.edge
        what = f"a tenth of a period of the carrier of {part.name}"
        return (NumericalRequirements(what, 0.1 / f, 1 / edge),)

    def make_frequency_estimator(
        self, part: Part[PwmKeys], scene: DeclaredScene
    ) -> HighestFrequency:
        """Return a function that computes the highest relevant ripple frequency [Hz]."""
        return partial(_compute_ripple_frequency, float(part.keys.frequency))


def _select_long_intervals(selected: np.ndarray, t: np.ndarray, duration: float) -> np.ndarray:
    """Select the long intervals of selected points: longer than ``duration`` [s].

    An interval consists of consecutive selected points. An interval stays selected if it lasts
    longer than ``duration`` [s]. ``selected`` and the times ``t`` [s] are arrays of shape (n,).
    """
    result = selected.copy()
    turns = np.diff(np.r_[0, selected.astype(int), 0])
    for first, end in zip(np.flatnonzero(turns > 0), np.flatnonzero(turns < 0), strict=True):
        result[first:end] = t[end - 1] - t[first] > duration
    return result


def _compute_ripple_frequency(carrier: float, constant: float) -> float:
    """Compute the highest relevant frequency [Hz] in the ripple of a PWM current."""
    return RIPPLE_HARMONICS * carrier


for _driver in (Amplifier, ChargeDrive, HalfBridge, LinearDrive, PwmDrive):
    register_part_type(_driver())
