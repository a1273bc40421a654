"""PID controller of the sphere's height as an operational-amplifier circuit (paper 2.4)."""

from __future__ import annotations

from dataclasses import dataclass
from math import sqrt

import numpy as np

from kc2spice.errors import UsageError
from kc2spice.netlist.circuit import Param, Pin, Subcircuit
from kc2spice.netlist.header import Header, parameter_list, part_header
from kc2spice.netlist.render import render
from kc2spice.scene.schema import Control

SENSOR = 2e3  # V/m, 5 V at the paper's set point
SENSE = 100.0  # Ohm, 10 V at the paper's 0.1 A
SUM_GAIN = 40.0  # all weights of the summing stage together: 25 MHz with 1 GHz amplifiers
DERIVATIVE_GAIN = 100.0  # of the differentiator above its roll-off
RESISTOR = 1e4  # Ohm, feedback of the summing stage


@dataclass(frozen=True)
class PidComponents:
    """Gains and component values of ``templates/pid.j2`` (SI), all computed from the scene."""

    kp: float
    ki: float
    kd: float
    rolloff: float
    sensor: float
    sense: float
    gain_p: float  # V/V from the error stage to the command
    gain_i: float
    gain_d: float
    post: float
    r_i: float
    c_i: float
    td: float
    r_d: float
    c_d: float
    rf_d: float
    sum: float
    sum_p: float
    sum_i: float
    sum_d: float
    feedback: float


def pid_current(
    error: np.ndarray, integral: np.ndarray, slope: np.ndarray, control: Control
) -> np.ndarray:
    """Coil current [A], ``clamp(KP e + KI int e + KD e', +-limit)`` of error [m] and its kin."""
    wanted = control.kp * error + control.ki * integral + control.kd * slope
    return np.clip(wanted, -control.current_limit, control.current_limit)


def pid_components(control: Control) -> PidComponents:
    """Component values for the gains: ``gain = K sense / sensor``, per stage time constant.

    The branches give ``-e``, ``-int(e)/Ti`` and ``-Td e'``; the summing stage weighs them, two
    equal stages amplify the sum to the command.

    Raises
    ------
    UsageError : a negative gain, or none at all.
    """
    gains = (control.kp, control.ki, control.kd)
    if min(gains) < 0 or max(gains) == 0:
        raise UsageError(
            "the controller needs gains of one sign",
            where="control",
            got=f"kp={control.kp}, ki={control.ki}, kd={control.kd}",
            expected="no gain below zero and at least one above",
        )
    ti, td = 10.0, DERIVATIVE_GAIN * control.rolloff
    r_i, r_d = 1e7, 1e3
    scale = SENSE / SENSOR
    gain_p, gain_i, gain_d = control.kp * scale, control.ki * scale * ti, control.kd * scale / td
    post = max(1.0, sqrt((gain_p + gain_i + gain_d) / SUM_GAIN))

    def weight(gain: float) -> float:
        return RESISTOR * post**2 / gain if gain else 0.0

    return PidComponents(
        kp=control.kp,
        ki=control.ki,
        kd=control.kd,
        rolloff=control.rolloff,
        sensor=SENSOR,
        sense=SENSE,
        gain_p=gain_p,
        gain_i=gain_i,
        gain_d=gain_d,
        post=post,
        r_i=r_i,
        c_i=ti / r_i,
        td=td,
        r_d=r_d,
        c_d=control.rolloff / r_d,
        rf_d=td * r_d / control.rolloff,
        sum=RESISTOR,
        sum_p=weight(gain_p),
        sum_i=weight(gain_i),
        sum_d=weight(gain_d),
        feedback=max(1e-3, 1e3 * (post - 1.0)),
    )


def pid_subcircuit(
    header: Header, control: Control, *, output: bool = True, name: str = "pid"
) -> Subcircuit:
    """The controller between the height ``y``, ``enable`` and the coils at ``drive`` and ``sense``.

    Without its ``output`` stage it ends at ``command``, 100 V for each ampere that it wants. Needs
    the part ``opamp``.
    """
    ends = (
        (Pin("drive", "V", "A"), Pin("sense", "V", "A")) if output else (Pin("command", "V", "A"),)
    )
    pins = (Pin("y", "um", "-"), Pin("enable", "V", "-"), *ends, Pin("ref", "V", "A"))
    supply = Param("compliance", 400.0, "V", "supply of the output stage")
    params = (
        Param("setpoint", control.setpoint, "m", "height of the sphere's centre"),
        Param("current_limit", control.current_limit, "A", "largest coil current"),
        Param("rail", 15.0, "V", "supply of the signal amplifiers"),
        *((supply,) if output else ()),
    )
    text = render(
        "pid.j2",
        header=part_header(header, f"{name}: controller of the sphere's height", pins, params),
        name=name,
        pins=[pin.name for pin in pins],
        parameters=parameter_list(params),
        c=pid_components(control),
        output=output,
    )
    return Subcircuit(name, pins, params, text)
