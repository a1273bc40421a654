"""Netlist sources of the heat flows that the losses of a resonator model cause.

A mode with the equation ``m z'' + d z' + w^2 z = sum_k g_k u_k`` dissipates the power ``d z'^2``
[W]. In the netlist, the rate ``z'`` of a mode with inertia is a voltage. A mode without inertia is
a relaxation, whose rate is ``z' = (sum_k g_k u_k - w^2 z) / d``. The dielectric loss of
:func:`kc2spice.rom.modal_models.add_dielectric_loss` consists of relaxations. The functions of this
module return a heat source for each mode of :mod:`kc2spice.synthesis.mode_cards`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from kc2spice.core.domains import AMBIENT, HEAT, THERMAL
from kc2spice.netlist.circuit import Element, Pin
from kc2spice.netlist.number_and_name_spelling import format_number
from kc2spice.netlist.shared_cards import Line

LOSS_NODE = "losses"  # inner node at which all heat flows meet
METER = "Vheat"  # 0 V source that measures the heat flow into the pin ``heat``
HEAT_PIN_ROWS = (Pin(HEAT, *THERMAL.units), Pin(AMBIENT, *THERMAL.units))
_HEAT_COMMENT = (
    "",
    f"* Modal losses as heat flows; their sum leaves through the pin {HEAT} (1 A is 1 W)",
)
# lower limit of the divisor ``damping`` in the heat flows, which avoids a division by zero
_SMALLEST_DAMPING = "1p"


def write_heat_meter() -> Iterator[Line]:
    """Yield the ammeter at the heat pin; all heat flows pass through the ammeter."""
    yield from _HEAT_COMMENT
    yield Element.from_words(METER, HEAT, LOSS_NODE, "0")


def write_inertial_mode_loss_card(index: int, velocity: tuple[str, str], power: float) -> Element:
    """Write the card of the heat source for the loss of a mode with inertia.

    Parameters
    ----------
    index : int
        Number of the mode.
    velocity : tuple of str
        Nodes between which the voltage is the velocity of the mode.
    power : float
        Power [W] if the voltage between the nodes ``velocity`` is 1 V and the parameter ``damping``
        has the value 1.

    Examples
    --------
    >>> write_inertial_mode_loss_card(1, ("p1", "base"), 2e-3).expression
    'damping*0.002*V(p1,base)*V(p1,base)'
    """
    square = "*".join(["V({},{})".format(*velocity)] * 2)
    return write_heat_source(index, f"damping*{format_number(power)}*{square}")


def write_massless_mode_loss_card(
    index: int, drives: Sequence[tuple[float, str, str]], node: tuple[str, str], power: float
) -> Element:
    """Write the card of the heat source for the loss of a massless mode.

    Parameters
    ----------
    index : int
        Number of the mode.
    drives : sequence of tuple
        Factor and the two nodes of each voltage that drives the mode.
    node : tuple of str
        Nodes between which the voltage is the state of the mode.
    power : float
        Power [W] that a voltage of 1 V dissipates if the parameter ``damping`` has the value 1. The
        voltage is the sum of the drives minus the state of the mode.

    Examples
    --------
    >>> write_massless_mode_loss_card(2, [(0.5, "a", "b")], ("q2", "base"), 3e-6).expression
    '3e-06*(0.5*V(a,b)-V(q2,base))*(0.5*V(a,b)-V(q2,base))/max(damping,1p)'
    """
    sums = "+".join(f"{format_number(factor)}*V({a},{b})" for factor, a, b in drives)
    apart = f"({sums.replace('+-', '-')}-V({node[0]},{node[1]}))"
    law = f"{format_number(power)}*{apart}*{apart}/max(damping,{_SMALLEST_DAMPING})"
    return write_heat_source(index, law)


def write_heat_source(tag: int | str, law: str) -> Element:
    """Return a netlist source of a heat flow [W] that follows an expression.

    ``law`` is the expression. The name of the source ends with ``tag``.
    """
    return Element.behavioural_source(f"Bheat{tag}", AMBIENT, LOSS_NODE, "I", law)
