"""Laws of parts: what each type of part says of itself to the independent integrator.

A law is plain data in SI with named, typed pins. It knows no scene and no netlist. A pin's kind
says which *across* quantity all pins of a net share and which *through* ones sum to zero there:

================  ===================  ==========================
kind              across               through
================  ===================  ==========================
``electrical``    voltage [V]          current into the part [A]
``displacement``  displacement [m]     force on the part [N]
``rotation``      angle [rad]          torque on the part [N m]
``signal``        value                none; one pin of a net sets it
================  ===================  ==========================

Linear laws are stamped into matrices by the assembler (:mod:`kc2spice.reference.assemble`). Every
nonlinear or switched law is a :class:`Device`: smooth expressions within a *mode*, and guards whose
zeros end the mode.
"""

from kc2spice.core.laws.control import Pid as Pid
from kc2spice.core.laws.device import Device as Device
from kc2spice.core.laws.device import Flow as Flow
from kc2spice.core.laws.device import Tap as Tap
from kc2spice.core.laws.device import inside as inside
from kc2spice.core.laws.equations import Equations as Equations
from kc2spice.core.laws.equations import Reading as Reading
from kc2spice.core.laws.equations import difference as difference
from kc2spice.core.laws.equations import reading as reading
from kc2spice.core.laws.linear import LinearBody as LinearBody
from kc2spice.core.laws.linear import Mass as Mass
from kc2spice.core.laws.linear import Port as Port
from kc2spice.core.laws.linear import Sensor as Sensor
from kc2spice.core.laws.linear import SignalBlock as SignalBlock
from kc2spice.core.laws.linear import Source as Source
from kc2spice.core.laws.linear import TwoTerminal as TwoTerminal
from kc2spice.core.laws.magnets import CoilForce as CoilForce
from kc2spice.core.laws.magnets import PositionForce as PositionForce
from kc2spice.core.laws.pin import GROUND as GROUND
from kc2spice.core.laws.pin import MECHANICAL as MECHANICAL
from kc2spice.core.laws.pin import Law as Law
from kc2spice.core.laws.pin import Pin as Pin
from kc2spice.core.laws.ported import PortBody as PortBody
from kc2spice.core.laws.ported import Relation as Relation
from kc2spice.core.laws.wave import Line as Line
from kc2spice.core.laws.wave import Recorded as Recorded
from kc2spice.core.laws.wave import Sine as Sine
from kc2spice.core.laws.wave import Waveform as Waveform
