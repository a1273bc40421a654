"""Table of the physical domains, with the quantities and units of their pins.

All code that depends on a domain reads :data:`TABLE`: model ports, branches of declarations,
netlist pins, sources, symbols, netlist headers and energy balances. A new domain needs one new row
of :data:`TABLE`, and tests.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Literal

# Formulas of the power that enters a part through a pin, with the two quantities of this pin.
Power = Literal[
    "across * through",
    "d(across)/dt * through",
    "through",
    "frame velocity * force",
    "none",
]
Side = Literal["across", "through"]
BASE = "base"
AMBIENT = "ambient"
SIGNAL = "-"
# name of the heat flow of a part, and name of the pin at which the heat flow leaves the part
HEAT = "heat"
HEAT_PINS = (
    f"1 V from {HEAT} to {AMBIENT} is a rise of 1 K over the ambient temperature; "
    f"1 A out of {HEAT} is 1 W of all losses of the part"
)
SPICE_UNITS = "V", "A"  # units of across and through quantities in simulators


@dataclass(frozen=True)
class Quantity:
    """Physical quantity on a pin: name, SI unit, and the value that 1 V or 1 A means.

    ``name`` is the name of the quantity in sources and branches, ``symbol`` its short name in
    results, and ``unit`` its SI unit. One volt or one ampere on a pin represents one ``pin_unit``,
    which is ``factor`` times the SI unit.
    """

    name: str
    symbol: str
    unit: str
    pin_unit: str
    factor: float = 1.0

    @property
    def plural_name(self) -> str:
        """Plural of the quantity's name, for messages."""
        words = self.name.replace("_", " ")
        return f"{words.removesuffix('y')}ies" if words.endswith("y") else f"{words}s"

    @property
    def pin_value_per_si_unit(self) -> float:
        """Number of volts or amperes on a pin that represents one SI unit of the quantity."""
        return float(f"{1 / self.factor:.15g}")


@dataclass(frozen=True, repr=False)
class Domain:
    """Physical domain: quantities on its pins, their power, and the state at rest.

    On all pins of a net, the values of ``across`` are equal, and the values of ``through`` sum to
    zero. ``power`` is the formula of the power that enters a part through a pin. ``rest`` describes
    the state at an operating point.

    ``port`` is the kind of a model's port in this domain. The input of the port is the quantity on
    ``input_side``. The output of the port has the unit ``output_unit`` and the short name
    ``output_symbol`` in results. In the test deck that ``kc2spice reduce`` writes, the wave of the
    output is called ``output_wave``. ``compliance`` is the unit of a port's static output divided
    by the port's input, such as m/N for a displacement and a force. The value across a pin is
    relative to the pin ``reference``; in a domain without a reference pin, ports are pairs of pins.
    ``rate`` is a second quantity across pins, the time derivative of ``across``. If ``across`` is
    relative to an accelerated frame of reference, ``frame`` is the name of the domain of the
    frame's acceleration.

    In a domain with a ``path_to_reference``, a net without a path to the reference has no operating
    point. ``path_to_reference`` describes possible paths in words, and ``path_part`` is a part type
    that forms a path. ``floating_error`` is the error text for a net without a path to the
    reference.

    Examples
    --------
    >>> DOMAINS["translation"]
    <Domain translation: 1 V is 1 um, 1 A is 1 N; power: d(across)/dt * through>
    >>> DOMAINS["acoustic"].through
    Quantity(name='volume_velocity', symbol='flow', unit='m3/s', pin_unit='cm3/s', factor=1e-06)
    """

    name: str
    across: Quantity
    through: Quantity | None
    power: Power
    rest: str
    input_side: Side = "across"
    port: str = ""
    output_unit: str = ""
    compliance: str = ""
    output_symbol: str = ""
    output_wave: str = ""
    reference: str = ""
    rate: Quantity | None = None
    frame: str = ""
    path_to_reference: str = ""
    path_part: str = ""
    floating_error: str = ""

    def __repr__(self) -> str:
        """Return a one-line description of the domain for the Python prompt."""
        text = f"<Domain {self.name}: 1 V is 1 {self.across.pin_unit or 'unit'}"
        return f"{text}, 1 A is 1 {self.flow_unit}; power: {self.power}>"

    @property
    def is_conservative(self) -> bool:
        """Whether parts exchange energy through the pins of the domain."""
        return self.through is not None

    @property
    def flow_unit(self) -> str:
        """Unit that 1 A through a pin represents; ``-`` for signals."""
        return SIGNAL if self.through is None else self.through.pin_unit

    @property
    def admittance(self) -> float:
        """Netlist admittance [A/V] of an element with an SI stiffness or conductance of 1.

        For example, the result is 1e-6 A/V for a spring of 1 N/m, because 1 V represents 1 µm.
        """
        return (
            1.0 if self.through is None else self.across.factor * self.through.pin_value_per_si_unit
        )

    @property
    def units(self) -> tuple[str, str]:
        """Units that 1 V and 1 A on a pin of this domain represent."""
        return self.across.pin_unit, self.flow_unit

    def find_value_unit(self, letter: str) -> str:
        """Return the unit that replaces V, A, ohm, F or H in element values of the domain.

        The unit is an empty string if the domain's units are volt and ampere.

        Examples
        --------
        >>> [DOMAINS["thermal"].find_value_unit(letter) for letter in "VIRC"]
        ['K', 'W', 'K/W', 'W s/K']

        For an electrical resistance, the result is empty, because SPICE values have the unit ohm.

        >>> DOMAINS["electrical"].find_value_unit("R")
        ''
        """
        across, flow = (f"({unit})" if "/" in unit else unit for unit in self.units)
        units = {"V": self.units[0], "I": self.units[1], "R": f"{across}/{flow}"}
        units |= {"C": f"{flow} s/{across}", "L": f"{across} s/{flow}"}
        return "" if self.units == SPICE_UNITS else units[letter]

    @property
    def has_potential(self) -> bool:
        """Whether the value across a pin is a potential, such as a voltage."""
        return self.power in ("across * through", "through")

    @property
    def has_position(self) -> bool:
        """Whether the value across a pin is a position, whose rate determines the power."""
        return self.power == "d(across)/dt * through"

    @property
    def has_charge_output(self) -> bool:
        """Whether a port's output is the integral of its flow, such as a charge."""
        return self.input_side == "across" and self.power == "across * through"

    @property
    def is_relaxing(self) -> bool:
        """Whether the domain has no inertia, so that responses decay without oscillation.

        The thermal domain has no inertia.
        """
        return self.power == "through"

    @property
    def can_be_metered(self) -> bool:
        """Whether the power at a pin can be metered from its across and through quantity."""
        return self.is_conservative and self.power != "frame velocity * force"

    @property
    def pin_kind(self) -> str:
        """Kind of the domain's pins in the model equations: domain name or ``signal``."""
        return "signal" if self.power == "frame velocity * force" else self.name

    @property
    def quantities(self) -> Iterator[tuple[Quantity, Side]]:
        """Quantities that a source can prescribe, each with ``across`` or ``through``."""
        yield self.across, "across"
        if self.through is not None:
            yield self.through, "through"

    @property
    def through_variable(self) -> Quantity:
        """Through quantity of a conservative domain, such as current or force."""
        assert self.through is not None, f"{self.name} has no through variable"
        return self.through

    def get_quantity(self, side: Side) -> Quantity:
        """Return the across quantity or the through quantity of the domain."""
        return self.across if side == "across" else self.through_variable


VELOCITY = Quantity("velocity", "v", "m/s", "m/s")
ELECTRICAL = Domain(
    "electrical",
    Quantity("voltage", "v", "V", "V"),
    Quantity("current", "i", "A", "A"),
    "across * through",
    "no capacitor carries a current and no inductor has a voltage; a floating net keeps its charge",
    port="electrical",
    output_unit="C",
    compliance="F",
    output_wave="current",
)
TRANSLATION = Domain(
    "translation",
    Quantity("displacement", "x", "m", "um", 1e-6),
    Quantity("force", "force", "N", "N"),
    "d(across)/dt * through",
    "velocities are zero and forces sum to zero; every net needs a spring, a support or a source",
    input_side="through",
    port="mechanical",
    output_unit="m",
    compliance="m/N",
    output_symbol="u",
    output_wave="moved",
    reference=BASE,
    rate=VELOCITY,
    frame="acceleration",
    path_to_reference="a spring, a contact, a clamped body or a displacement source "
    "between it and gnd",
    floating_error="{part} has no support",
)
DISPLACEMENT = TRANSLATION.across
ROTATION = Domain(
    "rotation",
    Quantity("angle", "angle", "rad", "rad"),
    Quantity("torque", "torque", "N m", "Nm"),
    "d(across)/dt * through",
    "angular velocities are zero and torques sum to zero",
    input_side="through",
    port="rotational",
    output_unit="rad",
    compliance="rad/(N m)",
    output_symbol="angle",
    output_wave="moved",
    reference=BASE,
    path_to_reference="a torsion spring, a clamped body or an angle source between it and gnd",
    floating_error="{part} has no support",
)
ACCELERATION = Domain(
    "acceleration",
    Quantity("acceleration", "a", "m/s2", "m/s2"),
    Quantity("force", "force", "N", "N"),
    "frame velocity * force",
    "the frame has a constant acceleration and carries the weight of all masses in it",
    port="acceleration",
    output_unit="kg m",
    compliance="kg s2",
    output_symbol="a",
    output_wave="force",
    reference=BASE,
)
THERMAL = Domain(
    "thermal",
    Quantity("temperature", "temperature", "K", "K"),
    Quantity("heat_flow", "heat", "W", "W"),
    "through",
    "heat capacities absorb no heat; every net needs a path of thermal resistances to a known "
    "temperature",
    input_side="through",
    port="thermal",
    output_unit="K",
    compliance="K/W",
    output_symbol="temperature",
    output_wave="temperature",
    reference=AMBIENT,
    path_to_reference="a thermal_resistor or a temperature source between it and gnd, "
    "the ambient temperature",
    path_part="thermal_resistor",
    floating_error="heat cannot flow from {part} to the ambient temperature",
)
ACOUSTIC = Domain(
    "acoustic",
    Quantity("pressure", "pressure", "Pa", "Pa"),
    Quantity("volume_velocity", "flow", "m3/s", "cm3/s", 1e-6),
    "across * through",
    "pressures are constant; no volume flows into cavities, and acoustic masses have no pressure "
    "drop",
    port="acoustic",
    output_unit="m3",
    compliance="m3/Pa",
    output_symbol="pressure",
    output_wave="flow",
    reference=AMBIENT,
    path_to_reference="an acoustic_resistor, an acoustic_mass, a vent, a radiation or a pressure "
    "source between it and gnd",
    path_part="acoustic_resistor",
    floating_error="no flow path connects {part} to the ambient pressure",
)
SIGNALS = Domain(
    "signal",
    Quantity("signal", "", "", ""),
    None,
    "none",
    "signals are constant at an operating point; exactly one output drives each net, and inputs "
    "draw no current",
)
TABLE = (ELECTRICAL, TRANSLATION, ROTATION, ACCELERATION, THERMAL, ACOUSTIC, SIGNALS)

DOMAINS = {domain.name: domain for domain in TABLE}
PORTS = {domain.port: domain for domain in TABLE if domain.port}
CONSERVATIVE = tuple(domain for domain in TABLE if domain.is_conservative)
# Names of the reference pins; the reference of signals is ``ref``.
REFERENCES = frozenset({"ref", *(domain.reference for domain in TABLE if domain.reference)})


def _list_quantities() -> dict[str, tuple[Domain, Side]]:
    """Return the domain and the side (across or through) of each named quantity.

    Force is a quantity of the domains translation and acceleration; the returned mapping assigns
    ``force`` to translation.
    """
    result: dict[str, tuple[Domain, Side]] = {}
    for domain in CONSERVATIVE:
        for quantity, side in domain.quantities:
            result.setdefault(quantity.name, (domain, side))
    return result


QUANTITIES = _list_quantities()
# Symbols of through quantities in names of results, such as ``i`` for ``current``.
FLOW_SYMBOLS = {
    name: domain.get_quantity(side).symbol
    for name, (domain, side) in QUANTITIES.items()
    if side == "through"
}


def _list_pin_units() -> Iterator[tuple[str, str]]:
    """Yield the units that 1 V and 1 A represent on each kind of conservative pin."""
    for domain in CONSERVATIVE:
        yield domain.units
        if domain.rate is not None:
            yield domain.rate.pin_unit, domain.flow_unit


PIN_UNITS = tuple(_list_pin_units())


def find_domain(unit: str, flow: str) -> Domain | None:
    """Find the domain of a pin by the units that 1 V and 1 A represent.

    The returned domain is None for signals and unknown units.

    Examples
    --------
    >>> find_domain("um", "N").name
    'translation'
    >>> find_domain("V", "-") is None
    True
    """
    for domain in CONSERVATIVE:
        rate = domain.rate.pin_unit if domain.rate else unit
        if domain.flow_unit == flow and unit in (domain.across.pin_unit, rate):
            return domain
    return None


def find_across_quantity(unit: str) -> Quantity | None:
    """Return the across quantity with the pin unit ``unit``, or None if none has it.

    Examples
    --------
    >>> find_across_quantity("um").factor
    1e-06
    """
    for domain in CONSERVATIVE:
        for quantity in (domain.across, domain.rate):
            if quantity is not None and quantity.pin_unit == unit:
                return quantity
    return None


def describe_units(units: Collection[str]) -> str:
    """Describe what 1 V and 1 A mean in each domain to which the given units belong.

    Examples
    --------
    >>> describe_units({"K/W", "V"})
    '1 V = 1 K (temperatures), 1 A = 1 W (heat flows)'
    """
    words: dict[str, None] = {}
    for domain in CONSERVATIVE:
        across = [domain.across, *([domain.rate] if domain.rate else [])]
        through = domain.through_variable
        # the force is the through quantity of two domains
        letters = "VIRCL" if QUANTITIES[through.name][0] is domain else "VRCL"
        of_pins = set(map(domain.find_value_unit, letters)) | {q.pin_unit for q in across}
        if domain.units != SPICE_UNITS and of_pins & {*units}:
            words |= dict.fromkeys(f"1 V = 1 {q.pin_unit} ({q.plural_name})" for q in across)
            words[f"1 A = 1 {through.pin_unit} ({through.plural_name})"] = None
    return ", ".join(words)
