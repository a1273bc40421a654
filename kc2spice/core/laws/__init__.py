"""Laws of parts: what each type of part says of itself to the independent integrator.

A law is plain data in SI with named, typed pins. It knows no scene and no netlist. A pin's kind
says which *across* quantity all pins of a net share and which *through* ones sum to zero there:

================  ===================  ==========================
kind              across               through
================  ===================  ==========================
``electrical``    voltage [V]          current into the part [A]
``displacement``  displacement [m]     force on the part [N]
``velocity``      velocity [m/s]       force on the part [N]
``rotation``      angle [rad]          torque on the part [N m]
``signal``        value                none; one pin of a net sets it
================  ===================  ==========================

Linear laws are stamped into matrices by the assembler (:mod:`kc2spice.reference.assemble`). Every
nonlinear or switched law is a :class:`Device`: smooth expressions within a *mode*, and guards whose
zeros end the mode.
"""

from kc2spice.core.laws.control import Pid
from kc2spice.core.laws.device import Device, Flow, Tap, inside
from kc2spice.core.laws.equations import Equations, Reading, difference, reading
from kc2spice.core.laws.linear import (
    LinearBody,
    Mass,
    Port,
    Sensor,
    SignalBlock,
    Source,
    TwoTerminal,
)
from kc2spice.core.laws.magnets import CoilForce, ForceTable, PositionForce
from kc2spice.core.laws.pin import GROUND, KINDS, MECHANICAL, Law, Pin
from kc2spice.core.laws.ported import PortBody, Relation
from kc2spice.core.laws.wave import Line, Recorded, Sine, Waveform

__all__ = [
    "GROUND",
    "KINDS",
    "MECHANICAL",
    "CoilForce",
    "Device",
    "Equations",
    "Flow",
    "ForceTable",
    "Law",
    "Line",
    "LinearBody",
    "Mass",
    "Pid",
    "Pin",
    "Port",
    "PortBody",
    "PositionForce",
    "Reading",
    "Recorded",
    "Relation",
    "Sensor",
    "SignalBlock",
    "Sine",
    "Source",
    "Tap",
    "TwoTerminal",
    "Waveform",
    "difference",
    "inside",
    "reading",
]
