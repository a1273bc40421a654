"""PID controller of the sphere's height as an operational-amplifier circuit (paper 2.4)."""

from __future__ import annotations

from math import pi

from kc2spice.core.errors import UsageError
from kc2spice.parts.opamp import BANDWIDTH
from kc2spice.scene.schema import Control
from kc2spice.spice.circuit import Param, Pin, Subcircuit
from kc2spice.spice.header import Header, parameter_list, part_header
from kc2spice.spice.render import render

SENSOR = 2e3  # V/m, 5 V at the paper's set point
SENSE = 100.0  # Ohm, 10 V at the paper's 0.1 A


def _gains(control: Control) -> tuple[Param, ...]:
    """The gains that are not zero, and the roll-off where there is a differentiator.

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
    params = (
        Param("kp", control.kp, "A/m", "proportional gain, above zero"),
        Param("ki", control.ki, "A/(m.s)", "integral gain, above zero"),
        Param("kd", control.kd, "A.s/m", "derivative gain, above zero"),
        Param("rolloff", control.rolloff, "s", "time constant of the differentiator's pole"),
    )
    present = {"kp": control.kp, "ki": control.ki, "kd": control.kd, "rolloff": control.kd}
    return tuple(param for param in params if present[param.name])


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
        *_gains(control),
        Param("current_limit", control.current_limit, "A", "largest coil current"),
        Param("offset", 0.0, "V", "input offset of the error amplifier; 1 mV is 1 um of height"),
        Param("rail", 15.0, "V", "supply of the signal amplifiers"),
        *((supply,) if output else ()),
    )
    gains = [param.name for param in params]
    text = render(
        "pid.j2",
        header=part_header(header, f"{name}: controller of the sphere's height", pins, params),
        name=name,
        pins=[pin.name for pin in pins],
        parameters=parameter_list(params),
        gains=gains,
        weights=[f"gain_{gain[1]}" for gain in ("kp", "ki", "kd") if gain in gains],
        sensor=SENSOR,
        sense=SENSE,
        bandwidth=BANDWIDTH,
        pi=pi,
        output=output,
    )
    return Subcircuit(name, pins, params, text)
