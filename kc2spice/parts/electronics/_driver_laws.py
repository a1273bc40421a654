"""Equations of the drivers' circuits, for the independent integrator.

Each function ``declare_…`` declares the circuit that one netlist template ``templates/driver_….j2``
contains. Each node of a declaration corresponds to one node of the template. A declaration
describes resistors as terms of the content function, capacitors as terms of the coenergy function,
and controlled sources as output currents. An inner node of a driver is declared as a pin to which
no other part is connected. The equations do not include noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.quantities import BOLTZMANN, DEFAULT_TEMPERATURE, ELEMENTARY_CHARGE, Section
from kc2spice.netlist.circuit import Param
from kc2spice.physics.declaration import Branch, Declaration, measured, voltage
from kc2spice.physics.law import DeclaredLaw

OUTPUT_RESISTANCE = 0.1  # Ohm, output resistance of an operational amplifier
STATIC_GAIN = 1e7  # voltage gain of an operational amplifier at zero frequency
# rate [V/s] at which a voltage beyond a rail returns to the rail, divided by the slew rate and by
# the difference between the voltage and the rail; the unit is 1/V
RAIL_STIFFNESS = 1e3
FULL_TURN = repr(2 * math.pi)
# Name of the parameter with the resistance [Ohm] of ``Rout``, the last resistor of each circuit.
SERIES_PARAMETER = "series_resistance"
# Gain of the feedback that keeps the output voltage of a controller's amplifier within its rails.
# The gain is the conductance of the rail, 1 kS, divided by the input conductance, 1 mS.
RAIL_GAIN = 1e6
# The triangular carrier of a PWM driver is the arcsine of a sine with this amplitude.
# With an amplitude below 1, the corners of the triangle are rounded.
SINE_SHARE = 0.9999
PI_BANDWIDTH = 1e7  # Hz, gain-bandwidth product of the amplifier of a PI controller
INPUT_RESISTANCE = 1e5  # Ohm, input resistor of a PI controller
SENSE_LOAD = 1e3  # Ohm, resistor that converts the current of a sensor to a voltage
GATE_SUPPLY = 12.0  # supply voltage [V] of the gate drivers
THRESHOLD_VOLTAGE = 3.0  # threshold voltage [V] of the transistors
SATURATION_CURRENT = 1e-14  # saturation current [A] of the diodes from source to drain
THERMAL_VOLTAGE = BOLTZMANN * DEFAULT_TEMPERATURE / ELEMENTARY_CHARGE  # V, at 27 C


def declare_amplifier(parameters: Iterable[Param]) -> Declaration:
    """Return the declaration of an amplifier whose output voltage follows the command.

    The parameters ``rail`` and ``negative_rail`` are the upper and the lower rail. Two voltage
    dividers divide the command and the feedback by 20. The feedback divider connects ``drive`` to
    ``ref`` with 20 kOhm.
    """
    return Declaration(
        "amplifier",
        "high-voltage amplifier",
        Section,
        _declare_node_branches("out", "drive"),
        content=f"0.5*(drive - out)^2/{SERIES_PARAMETER} + 0.5*drive^2/20000 - drive*delivered",
        signals={"delivered": _write_output_current("drive")},
        states={
            "compensation": _write_compensation_rate(
                "(command - v_drive)/20", "negative_rail", "rail"
            )
        },
        given=tuple(parameters),
        constants={SERIES_PARAMETER: "resistance", "unity": f"{FULL_TURN}*20*bandwidth"},
    )


def declare_charge_drive(parameters: Iterable[Param]) -> Declaration:
    """Return the declaration of a charge drive for a capacitive load.

    The charge drive controls the voltage of ``cathode``. The chip and the sense capacitor have leak
    conductances, whose value in siemens equals the capacitance in farads.
    """
    product = "bandwidth*(sense + capacitance)/capacitance"
    return Declaration(
        "charge_drive",
        "charge drive",
        Section,
        _declare_node_branches("anode", "cathode", "drive"),
        coenergy="0.5*sense*cathode^2",
        content=f"0.5*(drive - anode)^2/{SERIES_PARAMETER} - drive*delivered"
        " + 0.5*sense*cathode^2 + 0.5*capacitance*(anode - cathode)^2",
        signals={
            "delivered": _write_output_current("drive"),
            "target": "command*capacitance/sense",
        },
        states={"compensation": _write_compensation_rate("target - v_cathode", "-rail", "rail")},
        given=tuple(parameters),
        constants={SERIES_PARAMETER: "resistance", "unity": f"{FULL_TURN}*{product}"},
    )


def declare_linear_drive(parameters: Iterable[Param], sense: float) -> Declaration:
    """Return the declaration of a linear current source for coils.

    A sense resistor ``sense`` [Ohm] connects ``ret`` to ``ref``. R1 = 1 kOhm connects ``ret`` to
    ``inverting``, and R2 = ``ratio`` R1 connects ``inverting`` to ``middle``. A capacitor connects
    ``middle`` to ``drive``. The parameter ``constant`` [s] is the time constant of R2 and this
    capacitor.
    """
    return Declaration(
        "linear_drive",
        "current source",
        Section,
        _declare_node_branches("drive", "ret", "power", "inverting", "middle"),
        coenergy="0.5*constant/(1000*ratio)*(middle - drive)^2",
        content=f"0.5*(power - drive)^2/{SERIES_PARAMETER} - power*delivered + 0.5*ret^2/{sense!r}"
        " + 0.5*(ret - inverting)^2/1000 + 0.5*(inverting - middle)^2/(1000*ratio)",
        signals={"delivered": _write_output_current("power")},
        states={"compensation": _write_compensation_rate("command - v_inverting", "-rail", "rail")},
        given=tuple(parameters),
        constants={SERIES_PARAMETER: "1", "unity": f"{FULL_TURN}*gbw"},
    )


def declare_half_bridge(parameters: Iterable[Param]) -> Declaration:
    """Return the declaration of a half-bridge with two transistors and a reservoir.

    The reservoir is the capacitor at the node ``tank``. A MOS transistor of SPICE level 1 has the
    following current from drain to source. v_gs is the voltage from gate to source, v_gd from gate
    to drain, and v_sd from source to drain::

        i = kp/2 (max(0, v_gs - THRESHOLD_VOLTAGE)^2 - max(0, v_gd - THRESHOLD_VOLTAGE)^2)
            - SATURATION_CURRENT (exp(v_sd / THERMAL_VOLTAGE) - 1)
    """
    supplies = "0.5*(tank - rail)^2/supply_resistance + 0.5*bridge^2/leakage"
    output = f"0.5*(bridge - out)^2/{SERIES_PARAMETER}"
    gates = (
        "0.5*(high - bridge - gate_high)^2/gate_resistance + 0.5*(low - gate_low)^2/gate_resistance"
    )
    transistors = "(tank - bridge)*current_high + bridge*current_low"
    return Declaration(
        "half_bridge",
        "half-bridge",
        Section,
        _declare_node_branches("out", "bridge", "tank", "high", "low"),
        coenergy="0.5*reservoir*tank^2 + 0.5*1e-10*bridge^2"
        " + 0.5*5e-10*(high - bridge)^2 + 0.5*2e-11*(tank - high)^2"
        " + 0.5*5e-10*low^2 + 0.5*2e-11*(bridge - low)^2",
        content=f"{supplies} + {output} + {gates} + {transistors}",
        signals={
            "asked": "2*command/rail - 1",
            "gate_high": f"{GATE_SUPPLY!r}*(max(0, asked) - max(0, asked - 1))",
            "gate_low": f"{GATE_SUPPLY!r}*(max(0, -asked) - max(0, -asked - 1))",
            "current_high": _write_transistor_current("v_high", "v_tank", "v_bridge"),
            "current_low": _write_transistor_current("v_low", "v_bridge", "0"),
        },
        given=tuple(parameters),
        constants={
            SERIES_PARAMETER: "resistance",
            "kp": f"2*current_limit/({GATE_SUPPLY - THRESHOLD_VOLTAGE!r})^2",
        },
    )


def declare_pwm_drive(
    parameters: Iterable[Param], carrier: float, headroom: float, shunt: float, sense: float
) -> Declaration:
    """Return the declaration of a switched coil driver: H-bridge and PI controller.

    A comparator compares the output of the controller with a triangle between plus and minus
    ``carrier`` [V]. The triangle is the arcsine of the sine on the pin ``sine``. ``shunt`` [Ohm] is
    the resistance of the resistor in the return line. ``sense`` [Ohm] is the amplified voltage
    across ``shunt``, divided by the current through ``shunt``. The operational amplifier of the
    controller has a linear input stage. The rails of the operational amplifier are at plus and
    minus ``headroom`` times ``carrier``.
    """
    rounded = f"{SINE_SHARE!r}*sine"
    supply = headroom * carrier
    unity = f"{FULL_TURN}*{PI_BANDWIDTH!r}"
    return Declaration(
        "pwm_drive",
        "pulse-width modulated H-bridge",
        Section,
        (
            *_declare_node_branches(
                "drive", "ret", "low", "sensed", "inverting", "middle", "output"
            ),
            measured(voltage("sine", "sine", "ref")),
        ),
        coenergy="0.5*constant/r2*rail*(middle - output)^2",
        content=f"0.5*(drive - upper)^2/{SERIES_PARAMETER} + 0.5*(low - lower)^2/{SERIES_PARAMETER}"
        f" + 0.5*(ret - low)^2/{shunt!r}"
        f" + 0.5*sensed^2/{SENSE_LOAD!r} - sensed*shunted"
        f" + 0.5*(sensed - inverting)^2/{INPUT_RESISTANCE!r} + 0.5*(inverting - middle)^2*rail/r2"
        " - output*delivered",
        signals={
            "triangle": f"{2 * carrier / math.pi!r}*atan({rounded}/sqrt(1 - ({rounded})^2))",
            "duty": f"0.5*clip((v_output - triangle)/({2 * carrier!r}*frequency*edge))",
            "upper": "rail*(0.5 + duty)",
            "lower": "rail*(0.5 - duty)",
            "shunted": f"{sense / shunt / SENSE_LOAD!r}*(v_ret - v_low)",
            "delivered": f"(compensation - v_output)/{OUTPUT_RESISTANCE!r}",
        },
        states={
            "compensation": f"{unity}*(command - v_inverting - compensation/{STATIC_GAIN!r}"
            f" - {RAIL_GAIN!r}*({_write_rail_excess(repr(-supply), repr(supply))}))"
        },
        given=tuple(parameters),
        constants={SERIES_PARAMETER: "resistance"},
    )


def _write_transistor_current(gate: str, drain: str, source: str) -> str:
    """Write the current [A] from ``drain`` to ``source`` as an expression.

    The current of a transistor includes the current of its diode between source and drain.
    """
    ends = (f"max(0, {gate} - {end} - {THRESHOLD_VOLTAGE!r})^2" for end in (source, drain))
    diode = f"{SATURATION_CURRENT!r}*(exp(({source} - {drain})/{THERMAL_VOLTAGE!r}) - 1)"
    return f"0.5*kp*({' - '.join(ends)}) - {diode}"


def _declare_node_branches(*names: str) -> tuple[Branch, ...]:
    """Declare two branches for each node of ``names``, and one for pin ``command``.

    All branches lead to ``ref``. The branch ``NAME`` carries the current ``i_NAME``, and the branch
    ``v_NAME`` only measures the voltage.
    """
    acting = (voltage(name, name, "ref", f"i_{name}") for name in names)
    seen = (measured(voltage(f"v_{name}", name, "ref")) for name in names)
    return (*acting, *seen, measured(voltage("command", "command", "ref")))


def _write_output_current(node: str) -> str:
    """Write the limited output current [A] of an amplifier as an expression.

    The current flows into ``node``.
    """
    return f"current_limit*clip((compensation - v_{node})/({OUTPUT_RESISTANCE!r}*current_limit))"


def _write_compensation_rate(difference: str, low: str, high: str) -> str:
    """Write the rate [V/s] of the voltage at an amplifier's compensation node.

    The voltage c is measured before the output resistance. ``difference`` [V] is the difference of
    the input voltages, and ``low`` and ``high`` [V] are the rails. ``unity`` is the angular
    frequency of unit gain, and ``slew`` is the slew rate::

        rate = clip(unity * difference, +-slew) - unity * c / STATIC_GAIN
               - RAIL_STIFFNESS * slew * (max(0, c - high) - max(0, low - c))
    """
    return (
        f"slew*clip(unity*({difference})/slew) - unity*compensation/{STATIC_GAIN!r}"
        f" - {RAIL_STIFFNESS!r}*slew*({_write_rail_excess(low, high)})"
    )


def _write_rail_excess(low: str, high: str) -> str:
    """Return an expression for the voltage [V] of an amplifier beyond its rails.

    The voltage of the amplifier is measured before the output resistance.
    """
    return f"max(0, compensation - ({high})) - max(0, {low} - compensation)"


def build_driver_equations(
    name: str, declared: Declaration, inner_node: str, terminals: Iterable[str]
) -> laws.Equations:
    """Build the model equations of a coil or piezo driver from its declaration.

    The results are the voltages of ``command`` and ``terminals``, and the output current
    ``NAME.i``. The output current flows through the last resistor, from ``inner_node`` to the first
    terminal.
    """
    values, pins = declared.compute_parameter_values(Section()), ("command", *terminals)
    results = {f"{name}.{pin}": laws.scale_wave(f"{name}.{pin}") for pin in pins}
    conductance = 1.0 / values[SERIES_PARAMETER]
    ends = ((conductance, f"{name}.{inner_node}"), (-conductance, f"{name}.{pins[1]}"))
    results[f"{name}.i"] = laws.WaveCombination(ends)
    law = DeclaredLaw(name, declared, tuple(values.values()))
    joined = tuple((pin, f"{name}.{pin}") for pin in (*pins, "ref"))
    return laws.Equations((law,), joined, results)


def make_parameters(values: Mapping[str, float]) -> tuple[Param, ...]:
    """Convert the numeric values of a netlist template to declaration parameters."""
    return tuple(Param(name, value, "-", "") for name, value in values.items())
