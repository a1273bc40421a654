"""Part types of linear two-pin elements, such as resistors and springs.

The part types are generated from a table. A table row contains the energy that an element stores,
or the power that an element loses (:mod:`kc2spice.physics.declaration`). From the table row of a
part type, the program generates keys, netlist card, results, documentation, and the equations for
the independent integrator.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import cached_property
from typing import Annotated, Any, NamedTuple

from pydantic import Field, create_model

from kc2spice.core.quantities import Capacitance, CoilInductance, Section, Stiffness, si
from kc2spice.core.si_prefix_format import format_quantity
from kc2spice.netlist.circuit import Element, Item
from kc2spice.netlist.expression import Number, Tree
from kc2spice.netlist.number_and_name_spelling import LEAK_RATE
from kc2spice.netlist.subcircuit_library import Header, Subcircuit
from kc2spice.physics.conductors import ConductorKeys, is_heated
from kc2spice.physics.declaration import (
    Branch,
    Declaration,
    branch,
    current,
    displacement,
    voltage,
)
from kc2spice.physics.law import DeclaredLaw
from kc2spice.physics.part import DeclaredPart, format_branch_voltage
from kc2spice.physics.symbolic_algebra import (
    ONE,
    ZERO,
    differentiate_tree,
    divide_trees,
    evaluate_tree,
    multiply_trees,
)
from kc2spice.scene.part_records import NeglectedEffect, PartResult
from kc2spice.scene.parttype import register_part_type
from kc2spice.scene.scene_classes import (
    BuiltScene,
    DeclaredScene,
    KeysT,
    Part,
    Scene,
    WiredScene,
)


class ElementRow(NamedTuple):
    """Row of a table that defines one linear element type, such as a spring.

    ``key`` is the name of the element's only scene key. ``unit`` is the SI unit of the key, and
    ``value`` is the value of the key in the example scene. ``stated`` contains arguments of the
    element's declaration, such as its ``energy``, ``coenergy`` or ``content``. ``drive`` contains
    the keys of the source in the example scene.
    """

    name: str
    title: str
    key: str
    unit: str
    value: str
    branch: Branch
    stated: Mapping[str, Any]
    drive: str


VOLT = 'dc = "1 V"'
AMPERE = 'kind = "current"\ndc = "1 A"'
FORCE = 'kind = "force"\ndc = "10 mN"'
HEAT = 'kind = "heat_flow"\ndc = "1 W"'
HEAT_PULSE = 'kind = "heat_flow"\npulse = { high = "1 W", width = "10 s", edge = "1 ms" }'
V = voltage("v", "a", "b")
I = current("i", "a", "b")
X = displacement("x", "a", "b")
PUSH = 'kind = "pressure"\ndc = "1 Pa"'
VOLUME_VELOCITY = 'kind = "volume_velocity"\ndc = "1e-6 m3/s"'
T = branch("temperature")
P = branch("pressure")
U = branch("volume_velocity")
TABLE = (
    ElementRow("resistor", "ideal resistor", "resistance", "Ohm", "50 Ohm", V,
        {"content": "0.5*v^2/resistance", "conductors": ("v",)}, VOLT),
    ElementRow("capacitor", "ideal capacitor", "capacitance", "F", "100 nF", V,
        {"coenergy": "0.5*capacitance*v^2"}, VOLT),
    ElementRow("inductor", "ideal inductor", "inductance", "H", "10 uH", I,
        {"coenergy": "0.5*inductance*i^2"}, AMPERE),
    ElementRow("spring", "linear spring between two displacement pins", "stiffness", "N/m",
        "100 N/m", X, {"energy": "0.5*stiffness*x^2"}, FORCE),
    ElementRow("damper", "viscous damper between two displacement pins", "damping", "N s/m",
        "0.02 N s/m", X, {"content": "0.5*damping*x_rate^2"}, FORCE),
    ElementRow("thermal_resistor", "thermal resistance between two temperature pins",
        "resistance", "K/W", "20 K/W", T, {"content": "0.5*temperature^2/resistance"}, HEAT),
    ElementRow("thermal_capacitor",
        "heat capacity between a temperature pin and ambient temperature", "capacity",
        "J/K", "0.5 J/K", T, {"coenergy": "0.5*capacity*temperature^2"}, HEAT_PULSE),
    ElementRow("acoustic_resistor", "acoustic resistance between two pressure pins",
        "resistance", "Pa s/m3", "1e6 Pa s/m3", P, {"content": "0.5*pressure^2/resistance"}, PUSH),
    ElementRow("acoustic_compliance", "acoustic compliance of a closed volume", "compliance",
        "m3/Pa", "7e-11 m3/Pa", P, {"coenergy": "0.5*compliance*pressure^2"}, PUSH),
    ElementRow("acoustic_mass", "acoustic mass of moving fluid between two pressure pins",
        "mass", "kg/m4", "150 kg/m4", U, {"coenergy": "0.5*mass*flow^2"}, VOLUME_VELOCITY),
)  # fmt: skip


# Data types that limit the values of elements to a plausible range, keyed by unit.
_TYPES_OF_UNITS: Mapping[str, Any] = {"F": Capacitance, "H": CoilInductance, "N/m": Stiffness}
# Description of the key of each element.
_KEY_DESCRIPTIONS = {
    "resistor": "Electrical resistance of the resistor",
    "capacitor": "Capacitance of the capacitor",
    "inductor": "Inductance of the inductor",
    "spring": "Stiffness of the linear spring",
    "damper": "Viscous damping coefficient of the damper",
    "thermal_resistor": "Thermal resistance between the two temperature pins",
    "thermal_capacitor": "Heat capacity between the temperature pin and ambient temperature",
    "acoustic_resistor": "Acoustic resistance between the two pressure pins",
    "acoustic_compliance": "Acoustic compliance of the closed volume",
    "acoustic_mass": "Acoustic mass of the moving fluid between the two pressure pins",
}


def declare_element(row: ElementRow) -> Declaration:
    """Return the declaration of the linear element that a table row defines."""
    value = Field(gt=0, description=_KEY_DESCRIPTIONS[row.name])
    number = _TYPES_OF_UNITS.get(row.unit, Annotated[float, si(row.unit)])
    fields: dict[str, Any] = {row.key: (number, value)}
    words = f"{row.name.title().replace('_', '')}Keys"
    base: type[Section] = ConductorKeys if "conductors" in row.stated else Section
    keys = create_model(words, __base__=base, __module__=__name__, **fields)
    example = f"""
[{row.name}]
part = "{row.name}"
{row.key} = "{row.value}"
pins = {{ a = "drive.out", b = "gnd" }}

[drive]
part = "source"
{row.drive}
"""
    result = Declaration(row.name, row.title, keys, (row.branch,), **row.stated, example=example)
    keys.__doc__ = f"``{'; '.join(result.equations)}``."
    if row.name in ("inductor", "capacitor"):
        keys.unsupported_key_hints = dict.fromkeys(
            ("series_resistance", "resistance", "r", "rs", "rser", "esr", "dcr"),
            f"delete the key, and connect a part of type resistor in series with the {row.name}",
        )
    return result


class LinearElement(DeclaredPart[KeysT]):
    """Linear element that is a single netlist card, such as a resistor.

    The equation of an element is ``through = admittance d^order/dt^order across``. An element whose
    pin ``heat`` is connected is a subcircuit instead.

    The current of an element is not read from the device parameter ``@r[i]``. In an ac analysis,
    ngspice computes device parameters only at the operating point. The current of a resistance is
    computed from its voltage. The current of an inductance is an unknown that ngspice solves for.
    The current of a capacitance is measured by an ideal ammeter in series at the pin ``a``.
    """

    @cached_property
    def branch(self) -> Branch:
        """Branch of the element between its two pins."""
        return self.declaration.branches[0]

    @cached_property
    def admittance_term(self) -> tuple[int, Tree]:
        """Admittance term of the element: order of the time derivative, and coefficient."""
        d, b = self.declaration, self.branch
        flow = d.derive_direct_flow(b)
        stiff, slow = differentiate_tree(flow, b.name), differentiate_tree(flow, b.rate)
        stored = differentiate_tree(d.derive_stored_quantity(b), b.name)
        if b.is_flow:
            return -1, divide_trees(ONE, stored)
        if b.is_motion:
            return (-1, stiff) if stiff != ZERO else (0, slow)
        return (1, stored) if stored != ZERO else (0, stiff)

    @cached_property
    def _letter(self) -> str:
        """First letter of the element's name in the netlist: L, R or C."""
        return {-1: "L", 0: "R", 1: "C"}[self.admittance_term[0] + self.branch.is_motion]

    @cached_property
    def _unit_factor(self) -> Number:
        """Factor from an admittance in the domain's SI units to A/V at the netlist pins."""
        value = self.branch.domain.admittance
        return ONE if value == 1 else Number(f"{value:g}")

    def _evaluate(self, part: Part[KeysT], tree: Tree) -> float:
        """Return the value of an expression at the part's key values."""
        return float(evaluate_tree(tree, self.declaration.compute_parameter_values(part.keys)))

    def is_subcircuit(self, part: Part[KeysT], scene: DeclaredScene) -> bool:
        """Return whether the element is a subcircuit, that is, has the pin ``heat``."""
        return is_heated(part, scene)

    def subcircuits(
        self, part: Part[KeysT], build: BuiltScene, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return the subcircuit of the element if its pin ``heat`` is connected.

        If the pin ``heat`` is not connected, the returned tuple is empty.
        """
        return super().subcircuits(part, build, header) if is_heated(part, build.scene) else ()

    def list_inner_names(self, part: Part[KeysT], scene: WiredScene) -> Iterator[tuple[str, ...]]:
        """Yield the netlist names of inner nodes, ammeter, leak and noise sources."""
        if is_heated(part, scene):
            return
        n = part.name
        yield from ((f"V{n}", "meter"), (n.lower(), "metered"), (f"G{n}", "leak"))
        yield from ((f"R{n}", "noise"), (f"G{n}", "noise"), (n.lower(), "noise"))

    def cards(self, part: Part[KeysT], build: BuiltScene) -> tuple[Item, ...]:
        """Return the cards of the part at the top level of the deck."""
        if is_heated(part, build.scene):
            return super().cards(part, build)
        a, b = build.get_net(part, "a"), build.get_net(part, "b")
        admittance = multiply_trees(self._unit_factor, self.admittance_term[1])
        if self._letter != "C":
            value = self._evaluate(part, divide_trees(ONE, admittance))
            separate = build.has_noise and not self._has_si_units
            noise = self._write_noise_cards(part, build, a, b) if separate else ()
            silent = self._letter == "R" and not (self._has_loss and self._has_si_units)
            words = {"noisy": "0"} if build.has_noise and silent else {}
            card = Element.from_words(f"{self._letter}{part.name}", a, b, value, **words)
            return (card.with_unit(self.branch.domain.find_value_unit(self._letter)), *noise)
        inner = build.get_inner_name(part, part.name.lower(), "metered")
        return (
            Element.from_words(_name_meter(part, build), a, inner, "0"),
            Element.from_words(
                f"C{part.name}", inner, b, self._evaluate(part, admittance)
            ).with_unit(self.branch.domain.find_value_unit("C")),
            *(() if self.branch.is_motion else self._write_leak_card(part, build, a, b)),
            *(self._write_noise_cards(part, build, a, b) if build.has_noise else ()),
        )

    def _write_leak_card(
        self, part: Part[KeysT], build: BuiltScene, a: str, b: str
    ) -> tuple[Element, ...]:
        """Return the card of a leak conductance for a floating net.

        The leaks do not charge a net whose total charge is zero. The conductance is proportional to
        the capacitance, as for an electrode of a body. If the sum of the charges ``C v`` on a net
        is zero, the sum of the leakage currents ``rate C v`` is also zero.
        """
        value = LEAK_RATE * self._evaluate(
            part, multiply_trees(self._unit_factor, self.admittance_term[1])
        )
        return (
            Element.from_words(
                build.get_inner_name(part, f"G{part.name}", "leak"), a, b, a, b, value
            ),
        )

    @cached_property
    def _has_loss(self) -> bool:
        """Whether the element has a loss, which causes thermal noise."""
        return self.declaration.derive_loss_coefficient(self.branch) != ZERO

    @cached_property
    def _has_si_units(self) -> bool:
        """Whether the pins of the element have SI units.

        If the pins have SI units, the thermal noise of a resistor card equals the thermal noise of
        the loss that the card represents.
        """
        return self._unit_factor == ONE

    def _write_noise_cards(
        self, part: Part[KeysT], build: BuiltScene, a: str, b: str
    ) -> tuple[Element, ...]:
        """Return the netlist cards of the thermal noise of a lossy element.

        An example is the force noise of a damper. For the damping c, the force noise has the
        spectral density ``4 k T c`` [N^2/Hz]. In the netlist, a resistor of c ohms with the voltage
        noise density ``4 k T c`` [V^2/Hz] represents the force noise.
        """
        if not self._has_loss:
            return ()
        n, value = part.name, self._evaluate(part, self.admittance_term[1])
        R, G = (
            build.get_inner_name(part, f"R{n}", "noise"),
            build.get_inner_name(part, f"G{n}", "noise"),
        )
        node = build.get_inner_name(part, n.lower(), "noise")
        gain = f"{self.branch.domain.through_variable.pin_value_per_si_unit:g}"
        return Element.from_words(R, node, "0", value), Element.from_words(G, a, b, node, "0", gain)

    def vectors(self, part: Part[KeysT], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        if is_heated(part, build.scene):
            return super().vectors(part, build)
        across, n, b = format_branch_voltage(build, part, self.branch), part.name, self.branch
        voltage, flow = b.domain.across, b.domain.through_variable
        if self._letter == "R":
            admittance = multiply_trees(Number(f"{voltage.factor:g}"), self.admittance_term[1])
            factor = self._evaluate(part, admittance)
            through = PartResult(across, factor, flow.unit, ("b",), ("a",))
        else:
            instance = _name_meter(part, build) if self._letter == "C" else f"l{n}"
            through = PartResult(f"i({instance.lower()})", flow.factor, flow.unit, ("b",), ("a",))
        if b.is_motion:
            return {f"{n}.{b.through}": through}
        difference = PartResult(across, voltage.factor, voltage.unit)
        return {f"{n}.{b.across}": difference, f"{n}.{b.through}": through}

    def notes(self, part: Part[KeysT], scene: Scene) -> Iterator[str | NeglectedEffect]:
        """Yield the assumptions of the model and the effects that it neglects."""
        if is_heated(part, scene):
            yield from super().notes(part, scene)
            return
        row = next(row for row in TABLE if row.name == self.name)
        value = format_quantity(getattr(part.keys, row.key), row.unit)
        yield f"{row.name.replace('_', ' ')} of {value}"


def _name_meter(part: Part, build: BuiltScene) -> str:
    """Return the name of the ammeter of the part in the netlist."""
    return build.get_inner_name(part, f"V{part.name}", "meter")


DECLARED = {row.name: declare_element(row) for row in TABLE}


def make_element_law(name: str, kind: str, value: float) -> DeclaredLaw:
    """Return the model equations of a two-terminal element with a value in SI units.

    ``kind`` is the name of a table row, such as ``spring``.
    """
    return DeclaredLaw(name, DECLARED[kind], (value,))


for _declared in DECLARED.values():
    register_part_type(LinearElement(_declared))
