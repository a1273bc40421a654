"""PID controller of a sphere's height, ideal or with op-amps.

Source: section 2.4 of Schütz, Maeter and Bechtold, Actuators 10 (2021) 279.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.domains import DISPLACEMENT
from kc2spice.core.errors import UsageError
from kc2spice.core.magnets import MagnetostaticTable
from kc2spice.core.naming import list_names
from kc2spice.core.quantities import Section
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.circuit import Param, make_positive_parameter
from kc2spice.netlist.subcircuit_library import Header, Subcircuit
from kc2spice.netlist.transforms import merge_helpers
from kc2spice.parts.control._pid_keys import MAX_SATURATED_SHARE, PidKeys
from kc2spice.parts.electronics._parts_with_netlist_template import (
    GAIN_BANDWIDTH,
    make_opamp_subcircuit,
)
from kc2spice.parts.magnetics.ring_magnet_coils import RingMagnetCoilsKeys, get_result_prefix
from kc2spice.parts.mechanics import sphere
from kc2spice.physics.declaration import Branch, Declaration, displacement, measured, voltage
from kc2spice.physics.law import DeclaredLaw
from kc2spice.physics.part import make_declared_subcircuit
from kc2spice.scene.checks import Check, Metric
from kc2spice.scene.part_records import PartResult
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    JoinedScene,
    Part,
    PartType,
    Scene,
    Terminal,
)
from kc2spice.synthesis.library_headers import render_library

# Sensor gain [V/m]; the sensor voltage is 5 V at the set point of Schütz et al. (2021).
SENSOR_GAIN = 2e3
# Resistance [Ohm] of the current-sensing resistor. The largest current of Schütz et al. (2021),
# 0.1 A, causes a voltage of 10 V across this resistor.
SENSE_RESISTANCE = 100.0
# Largest command voltage [V] of the output stage, far below the supply voltage of the amplifiers.
MAX_COMMAND = 10.0
SUPPLY_VOLTAGE = 400.0  # smallest supply voltage [V] of the output stage
SUPPLY_RATIO = 1.2  # ratio of supply voltage to required output voltage
ENABLE_EDGE = 1e-8  # rise and fall time [s] of the enable signal
DISCHARGE_TIME = 1e-6  # time constant [s] of the integral's decay in a disabled controller


# Netlist parameters for the gains of a controller. Each row contains a gain, and the name, unit and
# description of a parameter that exists only if this gain is not zero.
# The circuit has no amplifier stage for a gain of zero, so a zero gain is not a parameter.
GAIN_PARAMETERS = (
    ("kp", "kp", "A/m", "proportional gain, above zero"),
    ("ki", "ki", "A/(m.s)", "integral gain, above zero"),
    ("kd", "kd", "A.s/m", "derivative gain, above zero"),
    ("kd", "rolloff", "s", "time constant of the differentiator's pole"),
)


def _list_pins(output: bool) -> tuple[Terminal, ...]:
    """Return the pins of a controller with or without an ``output`` stage."""
    ends = ("drive", "sense") if output else ("command",)
    return (
        Terminal.signal("y", DISPLACEMENT, required=True),
        Terminal("enable", "V", "-"),
        *(Terminal(end, "V", "A") for end in ends),
        Terminal("ref", "V", "A", "gnd"),
    )


def declare_control(control: PidKeys, *, output: bool = True) -> Declaration:
    """Return the declaration of the ideal PID controller.

    The output current between ``drive`` and ``sense`` is ``i = clip(kp e + ki integral(e) + kd
    de/dt / (1 + rolloff s), +-current_limit)``, where ``e = setpoint - y`` is the error [m] of the
    height ``y``. If ``output`` is false, the pin ``command`` replaces the pins ``drive`` and
    ``sense``. The voltage at the pin ``command`` represents the computed current ``i``: 100 V stand
    for 1 A. The integral is constant while the current is at its limit. The integral and the
    current are zero until the voltage at ``enable`` rises to 1 V. If a gain is zero, its term and
    its parameter are left out.
    """
    limited = "demand/current_limit"
    within = f"(1 - above({limited} - 1) - above(-{limited} - 1))"
    reset = f"(1 - on)*integral/{DISCHARGE_TIME!r}"
    terms = {
        "kp": "kp/sensor*error",
        "ki": "integral",
        "kd": "kd/(sensor*rolloff)*(error - followed)",
    }
    states = {
        "ki": ("integral", f"ki/sensor*error*{within} - {reset}"),
        "kd": ("followed", "(error - followed)/rolloff"),
    }
    gains = [gain for gain in terms if getattr(control, gain)]
    target = f"on*current_limit*clip({limited})"
    ends: tuple[Branch, ...] = (voltage("command", "command", "ref"),)
    # voltage source with a resistance of 1 Ohm
    content = f"0.5*(command - {SENSE_RESISTANCE!r}*{target})^2"
    if output:
        ends = voltage("drop", "drive", "sense"), voltage("sensed", "sense", "ref", "returned")
        content = f"0.5*sensed^2 - {target}*drop"
    return Declaration(
        "pid",
        "controller of the sphere's height",
        Section,
        (
            measured(displacement("y", "y", "ref")),
            measured(voltage("enable", "enable", "ref")),
            *ends,
        ),
        content=content,
        states=dict(states[gain] for gain in gains if gain in states),
        signals={
            "on": "above(enable - 0.5)",
            "error": "sensor*(setpoint - y)",
            "demand": " + ".join(map(terms.__getitem__, gains)),
        },
        given=tuple(_list_parameters(control)),
        constants={"sensor": repr(SENSOR_GAIN)},
        rating="its output stays within current_limit",
        base="ref",
        metered=False,
    )


def _list_parameters(control: PidKeys) -> Iterator[Param]:
    """Yield the netlist parameters of the controller, such as the setpoint."""
    yield Param("setpoint", control.setpoint, "m", "height of the sphere's centre")
    for gain, item, unit, doc in GAIN_PARAMETERS:
        if getattr(control, gain):
            yield make_positive_parameter(item, getattr(control, item), unit, doc)
    yield make_positive_parameter(
        "current_limit", control.current_limit, "A", "largest coil current"
    )


def make_pid_subcircuit(
    header: Header,
    control: PidKeys,
    *,
    output: bool = True,
    load: float = 0.0,
    name: str = "pid",
) -> Subcircuit:
    """Return the subcircuit of a PID controller that drives coils.

    The inputs of the subcircuit are the pins ``enable`` and ``y``. The signal at the pin ``y`` is
    the height of the sphere's centre above the surface on which the sphere rests. The output stage
    measures the coil current with a resistor of at most 100 Ohm. At the current limit, this
    resistor has a voltage of at most 10 V, which is within the supply voltages of the amplifiers.
    The supply voltage of the output stage is a multiple of 100 V. The supply voltage suffices for
    the limit current through coils with the resistance ``load`` [Ohm], with a margin for changes of
    the current. Without the output stage, the output is the voltage at ``command``: 100 V for each
    ampere of the set current.
    """
    declared = declare_control(control, output=output)
    if control.form == "ideal":
        return make_declared_subcircuit(
            header, name, declared, declared.compute_parameter_values(control)
        )
    limit = control.current_limit
    sense = min(SENSE_RESISTANCE, MAX_COMMAND / limit) if output else SENSE_RESISTANCE
    supply = max(SUPPLY_VOLTAGE, 100.0 * math.ceil(SUPPLY_RATIO * limit * (load + sense) / 100.0))
    doc = "input offset of the error amplifier; 1 mV is 1 um of height"
    rail = max(15.0, SUPPLY_RATIO * sense * limit)
    params = [
        *declared.given,
        Param("offset", 0.0, "V", doc),
        make_positive_parameter("rail", rail, "V", "supply of the signal amplifiers"),
    ]
    if output:
        params += [make_positive_parameter("compliance", supply, "V", "supply of the output stage")]
    gains = list_names(params)
    part = render_library(
        "pid",
        header,
        name,
        declared.title,
        _list_pins(output),
        tuple(params),
        rating=declared.rating + " and compliance" * output,
        gains=gains,
        weights=[f"gain_{gain[1]}" for gain in ("kp", "ki", "kd") if gain in gains],
        sensor=SENSOR_GAIN,
        sense=sense,
        bandwidth=GAIN_BANDWIDTH,
        pi=math.pi,
        output=output,
    )
    return merge_helpers(part, [make_opamp_subcircuit(header)])


class Pid(PartType[PidKeys]):
    """Part type ``pid``: PID controller of a sphere's height by the current in coils."""

    name = "pid"
    title = "PID controller of a sphere's height"
    schema = PidKeys

    def generate_tables(
        self, part: Part[PidKeys], data: Mapping[str, object]
    ) -> Mapping[str, Mapping[str, object]]:
        """Return a mapping with one table: the source that enables the controller."""
        switching, pins = part.keys.switching_times, {"out": f"{part.name}.enable"}
        if len(switching) == 1:
            wave = {"high": 1.0, "width": 1e3, "edge": ENABLE_EDGE, "start": switching[0][0]}
            return {f"{part.name}_enable": {"part": "source", "pulse": wave, "pins": pins}}
        points, state = [(0.0, 0.0)], 0.0
        for time, value in switching:
            points += [(max(time, 1e-9), state), (max(time, 1e-9) + ENABLE_EDGE, value)]
            state = value
        return {f"{part.name}_enable": {"part": "source", "pwl": tuple(points), "pins": pins}}

    def pins(self, part: Part[PidKeys], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        return _list_pins(not _drives_external_circuit(part, scene))

    def default_joins(self, part: Part[PidKeys], scene: GovernedScene) -> Mapping[str, str]:
        """Return the default connections of the controller to the sphere and the coils."""
        ball = sphere.find_controlled_sphere(part, scene)
        joins = {} if ball is None else {"y": f"{ball.name}.y"}
        if not _drives_external_circuit(part, scene):
            coils = _find_driven_coils(part, scene).name
            joins |= {"drive": f"{coils}.drive", "sense": f"{coils}.ret"}
        return joins

    def problems(self, part: Part[PidKeys], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        keys, coils = part.keys, _find_driven_coils(part, scene)
        low, high = coils.keys.y_min, coils.keys.y_max
        if not low < keys.setpoint < high:
            middle = f"{500 * (low + high):.4g} mm"
            yield part.wrong(
                "setpoint",
                "the setpoint is outside of the force table",
                got=f"height {keys.setpoint:g} m",
                expected=f"between {low:g} and {high:g} m",
                hint=f'for example  setpoint = "{middle}", or extend {coils.name}.y_min and y_max',
            )
        if not max(keys.kp, keys.ki, keys.kd):
            yield part.wrong(
                "kp",
                "all gains of the controller are zero",
                got="kp = ki = kd = 0",
                expected="at least one gain above zero",
                hint='write for example  kp = "100 A/m"',
            )
        times, states = zip(*keys.switching_times, strict=True)
        if min(times) < 0 or states != ((1.0, 0.0) * len(states))[: len(states)]:
            also = "  and delete the key `disable_at`" if keys.disable_at else ""
            yield part.wrong(
                "enable_at",
                "an enable or disable time is negative"
                if min(times) < 0
                else "the enable and disable times do not alternate",
                got=f"enabled at {keys.enable_at}, disabled at {keys.disable_at}",
                expected="times from 0 on"
                if min(times) < 0
                else "first an enable time, then alternately a disable time and an enable time",
                hint=f"write  enable_at = 0{also}",
            )
        if scene.analysis.type == "transient" and times[0] >= scene.stop_time:
            yield part.wrong(
                "enable_at",
                "the controller starts after the simulation ends",
                got=f"{times[0]:g} s",
                expected=f"before the end of the simulation, {scene.stop_time:g} s",
                hint=f"lower `enable_at` below {scene.stop_time:g} s",
            )

    def subcircuits(
        self, part: Part[PidKeys], build: BuiltScene, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return the subcircuit of the part, as a tuple of length 1."""
        local = not _drives_external_circuit(part, build.scene)
        load = float(
            build.model(_find_driven_coils(part, build.scene), MagnetostaticTable).resistance.sum()
        )
        name = build.libraries[part.name]
        return (make_pid_subcircuit(header, part.keys, output=local, load=load, name=name),)

    def vectors(self, part: Part[PidKeys], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        node = "error" if part.keys.form == "ideal" else "e"
        error = PartResult(f"v(x{part.name.lower()}.{node})", 1.0 / SENSOR_GAIN, "m")
        result = {f"{part.name}.error": error}
        if _drives_external_circuit(part, build.scene):
            command = f"v({build.get_net(part, 'command')})"
            result["coil.wanted"] = PartResult(command, 1.0 / SENSE_RESISTANCE, "A")
        return result

    def law(self, part: Part[PidKeys], build: BuiltScene) -> laws.Equations | laws.MissingEquations:
        """Return the model equations of the ideal controller, without op-amp errors."""
        keys, n, scene = part.keys, part.name, build.scene
        if build.get_net(part, "ref") != "0":
            return laws.MissingEquations("its pin ref is not connected to ground")
        external = _drives_external_circuit(part, scene)
        declared = declare_control(keys, output=not external)
        height = sphere.find_height_offset(part, "y", scene)
        values = declared.compute_parameter_values(keys) | {"setpoint": keys.setpoint - height}
        controller = DeclaredLaw(n, declared, tuple(values.values()))
        error = laws.scale_wave(f"{n}.y", -DISPLACEMENT.factor, keys.setpoint - height)
        results = {f"{n}.error": error}
        if external:
            results["coil.wanted"] = laws.scale_wave(f"{n}.command", 1.0 / SENSE_RESISTANCE)
        return laws.Equations((controller,), controller.pin_pairs, results)

    def metrics(
        self, part: Part[PidKeys], build: BuiltScene, waves: Waveforms
    ) -> Mapping[str, object]:
        """Return the metrics of the part, keyed by name."""
        ball = sphere.find_controlled_sphere(part, build.scene)
        if "time" not in waves or ball is None or f"{ball.name}.y" not in waves:
            return {}
        t, y, setpoint = waves["time"], waves[f"{ball.name}.y"], part.keys.setpoint
        current = waves.data.get(
            f"{get_result_prefix(_find_driven_coils(part, build.scene))}.upper.current"
        )
        return {
            "settling_time_s": Metric(sphere.find_settling_time(part, ball, waves), "s"),
            "final_error_m": Metric(float(setpoint - y[-1]), "m"),
            "hold_current_a": Metric(
                None if current is None else compute_final_mean(t, current), "A"
            ),
            "caught": Metric(sphere.is_caught(part, ball, waves)),
        }

    def checks(self, part: Part[PidKeys], build: BuiltScene, waves: Waveforms) -> Iterator[Check]:
        """Yield the checks of the part after a run."""
        current = waves.data.get(
            f"{get_result_prefix(_find_driven_coils(part, build.scene))}.upper.current"
        )
        if current is None or "time" not in waves:
            return
        t, start = waves["time"], part.keys.switching_times[0][0]
        limited = (np.abs(current) >= 0.999 * part.keys.current_limit) & (t >= start)
        share = float(np.trapezoid(limited.astype(float), t)) / (t[-1] - start)
        advice = "the current limit is lower than the current that the controller requests: raise "
        advice, action = f"{advice}{part.name}.current_limit", build.scene.checks.saturation
        yield Check(
            "saturation",
            share,
            MAX_SATURATED_SHARE,
            "of the time",
            advice,
            action,
            label="share of time at current limit",
        )

    def notes(self, part: Part[PidKeys], scene: Scene) -> Iterator[str]:
        """Yield the assumptions of the model and the effects that it neglects."""
        coils = "real coils" if _drives_external_circuit(part, scene) else "current-driven coils"
        form = "ideal" if part.keys.form == "ideal" else "op-amp"
        yield f"{form} PID, output clamped at {part.keys.current_limit:g} A, {coils}"


def _find_driven_coils(part: Part[PidKeys], scene: DeclaredScene) -> Part[RingMagnetCoilsKeys]:
    """Return the coils that the controller drives."""
    return scene.find_partner(part, "ring_magnet_coils", key="coils").with_schema(
        RingMagnetCoilsKeys
    )


def _drives_external_circuit(part: Part[PidKeys], scene: DeclaredScene) -> bool:
    """Return whether the PID controller drives an external circuit for the coils."""
    joined = scene.is_target(part.name, "command") or "command" in part.pins
    return joined or bool(_find_driven_coils(part, scene).keys.driver)


def compute_final_mean(t: np.ndarray, values: np.ndarray) -> float:
    """Return the mean of a waveform over the last twentieth of the run."""
    tail = t >= t[-1] - 0.05 * (t[-1] - t[0])
    return float(np.trapezoid(values[tail], t[tail]) / np.ptp(t[tail]))


register_part_type(Pid())
