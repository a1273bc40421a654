"""Acoustic parts, whose subcircuits are networks of acoustic elements.

A part type defines an :class:`AcousticNetwork`: acoustic masses, resistances and compliances
between nodes, whose values are expressions of parameters. The netlist, the noise, the results and
the equations of a part are derived from the network of the part. All elements of a network are
positive, so the network is positive real.
"""

from __future__ import annotations

import math
from abc import abstractmethod
from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar

from typing_extensions import TypeVar

from kc2spice.core import constitutive_laws as laws
from kc2spice.core.domains import ACOUSTIC, AMBIENT
from kc2spice.core.errors import UsageError
from kc2spice.netlist.circuit import Circuit, Element, Item, Param, Parameters, Pin
from kc2spice.netlist.expression import Tree
from kc2spice.netlist.number_and_name_spelling import (
    LEAK_RATE,
    format_comment,
    format_number,
    format_voltage,
)
from kc2spice.netlist.shared_cards import attach_comments
from kc2spice.netlist.subcircuit_library import Header, Subcircuit
from kc2spice.parts.acoustics._fluids import USUAL_LIQUID_DENSITY, FluidKeys
from kc2spice.parts.electronics.two_terminal_types import make_element_law
from kc2spice.physics.symbolic_algebra import evaluate_tree, parse_simplified
from kc2spice.scene.part_records import EquilibriumConditions, PartResult
from kc2spice.scene.plausibility import check_usual_range
from kc2spice.scene.scene_classes import (
    GROUND,
    BuiltScene,
    GovernedScene,
    JoinedScene,
    Part,
    PartType,
    Terminal,
    WiredScene,
)

FluidKeysT = TypeVar("FluidKeysT", bound=FluidKeys, default=FluidKeys, covariant=True)

MASS, RESISTANCE, COMPLIANCE = "acoustic_mass", "acoustic_resistor", "acoustic_compliance"
ELEMENT_LETTERS = {MASS: "L", RESISTANCE: "R", COMPLIANCE: "C"}
# Ratio of an element's value in the netlist to its value in SI units.
# In the netlist, 1 V represents 1 Pa, and 1 A represents 1e-6 m3/s.
SCALES = {
    MASS: 1 / ACOUSTIC.admittance,
    RESISTANCE: 1 / ACOUSTIC.admittance,
    COMPLIANCE: ACOUSTIC.admittance,
}
RATING = "not checked; the equations hold for small amplitudes only"
METER = "Vflow"  # ammeter that measures the volume velocity into the first pin


@dataclass(frozen=True)
class AcousticElement:
    """Acoustic element between two network nodes, with an expression as its value.

    ``value`` is in SI units. With ``leak``, a compliance has a small parallel conductance, which
    defines the operating point of a floating net.
    """

    kind: str
    name: str
    plus: str
    minus: str
    value: str
    leak: bool = False

    @property
    def card_name(self) -> str:
        """Name of the element in the netlist."""
        return f"{ELEMENT_LETTERS[self.kind]}{self.name}"

    @cached_property
    def tree(self) -> Tree:
        """Expression tree of the element's value."""
        return parse_simplified(self.value, self.name)


@dataclass(frozen=True)
class AcousticNetwork:
    """Network of the acoustic elements of a part.

    ``params`` are the parameters of the subcircuit. ``constants`` are expressions of the parameters
    and of earlier constants. ``entry`` is the inner node that an ammeter connects to the first pin.
    ``exits`` maps each further pin with an ammeter to the inner node that this ammeter connects to
    the pin. ``validity`` is the line of the library header that states the frequency range and the
    error of the network.
    """

    params: tuple[Param, ...]
    constants: Mapping[str, str]
    elements: tuple[AcousticElement, ...]
    validity: str
    entry: str = "in"
    exits: Mapping[str, str] = field(default_factory=dict)

    @cached_property
    def values(self) -> dict[str, float]:
        """Default values of all parameters, and values of all constants, keyed by name."""
        result = {param.name: param.default for param in self.params}
        for name, text in self.constants.items():
            result[name] = float(evaluate_tree(parse_simplified(text, name), result))
        return result

    def evaluate_element(self, item: AcousticElement) -> float:
        """Return the value of an acoustic element in SI units."""
        return float(evaluate_tree(item.tree, self.values))


class AcousticPart(PartType[FluidKeysT]):
    """Base class of parts with a subcircuit that is an acoustic network.

    An ammeter at the first pin measures the volume velocity into this pin. The last acoustic pin of
    the part is the pin ``ambient``, which represents the ambient pressure.
    """

    source = "closed form"
    noise = ("Rnoise_*",)
    encloses_fluid: ClassVar[bool] = True  # whether the walls of the part enclose the fluid
    # advice to users in whose scenes the pressure at the pin ``ambient`` varies
    varying_ambient_advice: ClassVar[str] = ""

    @abstractmethod
    def network(self, part: Part[FluidKeysT], scene: GovernedScene) -> AcousticNetwork:
        """Return the acoustic network of the part."""

    def list_pressure_pins(self, part: Part[FluidKeysT]) -> tuple[str, ...]:
        """Return the pressure pins except ``ambient``, beginning with the metered pin."""
        return ("a",)

    def steady_flow_paths(self, part: Part[FluidKeysT]) -> tuple[tuple[str, str], ...]:
        """Return the paths of a steady flow of fluid, as pairs of pins."""
        return ()

    def get_fluid_volume(self, part: Part[FluidKeysT]) -> float:
        """Return the fluid volume [m3] in front of a face; infinite without walls."""
        return math.inf

    def problems(self, part: Part[FluidKeysT], scene: GovernedScene) -> Iterator[UsageError]:
        """Yield an error for each invalid key of the part."""
        yield from super().problems(part, scene)
        fluid, where = part.keys.fluid, f"{part.name}.fluid.density"
        if fluid.sounds_like_liquid:
            yield from check_usual_range(where, fluid.density, USUAL_LIQUID_DENSITY)

    # --- pins and netlist -------------------------------------------------------------------------

    def pins(self, part: Part[FluidKeysT], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        ends = (
            replace(Terminal.from_domain(end, ACOUSTIC), required=True)
            for end in self.list_pressure_pins(part)
        )
        joined = scene.is_target(part.name, AMBIENT)
        ambient = Terminal.from_domain(AMBIENT, ACOUSTIC, None if joined else GROUND)
        return (*ends, replace(ambient, required=joined))

    def equilibrium_conditions(
        self, part: Part[FluidKeysT], scene: WiredScene
    ) -> EquilibriumConditions:
        """Return the equilibrium conditions: pin pairs with a possible steady flow."""
        return EquilibriumConditions(self.steady_flow_paths(part))

    def constant_pins(self, part: Part[FluidKeysT], scene: WiredScene) -> Mapping[str, str]:
        """Return the pin ``ambient`` if its pressure must be constant.

        The pressure must be constant if the walls of the part enclose a compressible fluid.
        """
        return {AMBIENT: self.varying_ambient_advice} if self.encloses_fluid else {}

    def subcircuits(
        self, part: Part[FluidKeysT], build: BuiltScene, header: Header
    ) -> tuple[Subcircuit, ...]:
        """Return the subcircuit of the part, as a tuple of length 1."""
        from kc2spice.synthesis.library_headers import (
            format_parameter_defaults,
            write_part_header,
        )  # loads slowly

        network, name = self.network(part, build.scene), build.libraries[part.name]
        pins = tuple(Pin(pin.name, pin.unit, pin.flow) for pin in build.scene.pins(part.name))
        title = f"{name}: {self.title}"
        validity = f"{network.validity}; constant temperature"
        limits: dict[str, Any] = {"rating": RATING, "validity": validity}
        head = write_part_header(header, title, pins, network.params, **limits)
        items = attach_comments(tuple(self._write_items(part, network, noisy=build.has_noise)))
        names = tuple(pin.name for pin in pins)
        defaults = format_parameter_defaults(network.params)
        circuit = Circuit(name, names, defaults, items, notes=head)
        tree = Circuit(items=(circuit,))
        text = format_comment(title)
        return (Subcircuit(name, pins, network.params, tree, title=text, header_lines=len(head)),)

    def _write_items(
        self, part: Part[FluidKeysT], network: AcousticNetwork, *, noisy: bool
    ) -> Iterator[Item | str]:
        """Yield the cards of a network: constants, ammeter, elements and optional noise."""
        for name, text in network.constants.items():
            yield Parameters({name: f"{{{text}}}"})
        yield "* volume velocity into the part"
        yield Element.from_words(METER, self.list_pressure_pins(part)[0], network.entry, "0")
        for item in network.elements:
            yield from _write_element(item, noisy=noisy)
        yield from self.write_further_cards(part)

    def write_further_cards(self, part: Part[FluidKeysT]) -> Iterator[Item | str]:
        """Yield additional cards of the part, below the cards of its network."""
        return iter(())

    # --- results ----------------------------------------------------------------------------------

    def vectors(self, part: Part[FluidKeysT], build: BuiltScene) -> Mapping[str, PartResult]:
        """Return the ngspice vectors: expressions of the part's results, keyed by name."""
        n, first = part.name, self.list_pressure_pins(part)[0]
        pressure, flow = ACOUSTIC.across, ACOUSTIC.through_variable
        across = format_voltage(build.get_net(part, first), build.get_net(part, AMBIENT)) or "v(0)"
        level = part.keys.fluid.level_reference_pressure
        wave = PartResult(across, pressure.factor, pressure.unit, level_reference=level)
        result = {f"{n}.{pressure.symbol}": wave}
        through = f"i(v.x{n}.{METER})".lower()
        leaves = self.list_pressure_pins(part)[1:] or (AMBIENT,)
        result[f"{n}.{flow.symbol}"] = PartResult(through, flow.factor, flow.unit, leaves, (first,))
        return result

    def law(self, part: Part[FluidKeysT], build: BuiltScene) -> laws.Equations:
        """Return the part's law: its model equations, solved by kc2spice without ngspice."""
        n, network = part.name, self.network(part, build.scene)
        devices, at_node = [], defaultdict[str, list[str]](list)
        for item in network.elements:
            name = f"{n}_{item.card_name}"
            devices.append(make_element_law(name, item.kind, network.evaluate_element(item)))
            at_node[item.plus].append(f"{name}.a")
            at_node[item.minus].append(f"{name}.b")
        first, *others = self.list_pressure_pins(part)
        nodes = {pin: network.exits.get(pin, pin) for pin in (*others, AMBIENT)}
        pins = [(pin, at_node[node][0]) for pin, node in ({first: network.entry} | nodes).items()]
        inside = tuple(tuple(ends) for ends in at_node.values() if len(ends) > 1)
        pressure = laws.subtract_waves(at_node[network.entry][0], at_node[AMBIENT][0])
        results = {
            f"{n}.{ACOUSTIC.across.symbol}": pressure,
            f"{n}.{ACOUSTIC.through_variable.symbol}": laws.WaveCombination(
                self.list_flows_from_node(part, network, network.entry)
            ),
        }
        return laws.Equations(tuple(devices), tuple(pins), results, nets=inside)

    def list_flows_from_node(
        self, part: Part[FluidKeysT], network: AcousticNetwork, node: str
    ) -> tuple[tuple[float, str], ...]:
        """Return sign and name of each element's volume velocity out of ``node``.

        Each entry contains a sign and the waveform name of an element's volume velocity.
        """
        result = []
        for item in network.elements:
            wave = f"{part.name}_{item.card_name}.a.through"
            if node in (item.plus, item.minus):
                result.append((1.0 if node == item.plus else -1.0, wave))
        return tuple(result)


def _write_element(item: AcousticElement, *, noisy: bool) -> Iterator[Element]:
    """Yield the cards of an element, of its leak and of its thermal noise.

    The noise of a resistance R is a volume velocity with the power spectral density ``4 k T / R``.
    """
    scale, ends = SCALES[item.kind], (item.plus, item.minus)
    words = {"noisy": "0"} if noisy and item.kind == RESISTANCE else {}
    card = Element.from_words(
        item.card_name, *ends, _write_scaled_value(item.value, scale), **words
    )
    yield card.with_unit(ACOUSTIC.find_value_unit(ELEMENT_LETTERS[item.kind]))
    if item.leak:
        yield Element.from_words(
            f"Gleak_{item.name}", *ends, *ends, _write_scaled_value(item.value, scale * LEAK_RATE)
        )
    if words:
        node = f"noise_{item.name}"
        yield Element.from_words(
            f"Rnoise_{item.name}", node, AMBIENT, _write_scaled_value(f"1/({item.value})", 1.0)
        )
        gain = format_number(ACOUSTIC.through_variable.pin_value_per_si_unit)
        yield Element.from_words(f"Gnoise_{item.name}", *ends, node, AMBIENT, gain)


def _write_scaled_value(value: str, scale: float) -> str:
    """Return the text of ``value`` times ``scale``: a number or an expression."""
    try:
        return format_number(float(value) * scale)
    except ValueError:
        return f"{{{value}}}" if scale == 1 else f"{{{scale:g}*({value})}}"
