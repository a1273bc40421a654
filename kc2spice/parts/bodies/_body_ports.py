"""Ports of a linear part: used ports, pins, steady-flow paths and result names."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from itertools import chain, filterfalse, product
from typing import ClassVar

import numpy as np

from kc2spice.core.domains import (
    ACCELERATION,
    AMBIENT,
    BASE,
    HEAT,
    PORTS,
    REFERENCES,
    SIGNAL,
    THERMAL,
    TRANSLATION,
)
from kc2spice.core.errors import UsageError, unknown
from kc2spice.core.naming import list_names
from kc2spice.netlist.number_and_name_spelling import require_distinct
from kc2spice.parts.bodies._linear_body_keys import LinearKeysT
from kc2spice.parts.mechanics._contact_keys import ContactKeys
from kc2spice.parts.mechanics._contact_surfaces import ContactSurface, TouchablePart
from kc2spice.physics.conductors import HEAT_TERMINALS, is_heated
from kc2spice.rom.linear_model import LinearModel, Port
from kc2spice.rom.modal_models import compute_resonators
from kc2spice.scene.part_records import EquilibriumConditions
from kc2spice.scene.scene_classes import (
    GROUND,
    BuiltScene,
    DeclaredScene,
    GovernedScene,
    JoinedScene,
    Part,
    Terminal,
    WiredScene,
)
from kc2spice.synthesis.terminals import (
    INNER_NODE_PATTERN,
    PERMITTED_PIN_NAMES,
    find_reference_pin,
)

# Physical domain of each kind of port that has one pin and shares the reference pin.
SINGLE_PIN_KINDS = {kind: domain for kind, domain in PORTS.items() if domain.reference}
# Symbol of the through quantity for each kind of port; the output of the port is its time integral.
FLOW_SYMBOLS_OF_PORTS = {
    row.port: row.through_variable.symbol
    for row in SINGLE_PIN_KINDS.values()
    if row.has_charge_output
}
WAVE_WORDS = (
    *(domain.output_symbol for domain in SINGLE_PIN_KINDS.values()),
    *FLOW_SYMBOLS_OF_PORTS.values(),
)
# A mode's energy counts as zero up to this fraction of the energy of the stiffest mode.
ZERO_ENERGY = 1e-13


class BodyPorts(TouchablePart[LinearKeysT]):
    """Base class that adds ports to bodies; models contain only ports that scenes use.

    A subclass derives its :meth:`ports` from the keys of the part.
    """

    #: Origin of the model, printed in the header of its library and by ``explain``.
    source = "FE, linear"
    # advice to users in whose scenes the ambient temperature of a heat-conducting body varies
    varying_ambient_advice: ClassVar[str] = ""

    @abstractmethod
    def ports(self, part: Part[LinearKeysT], scene: DeclaredScene) -> tuple[Port, ...]:
        """Return all ports of the body."""

    def headline(self, part: Part[LinearKeysT]) -> str:
        """Return the headline of a library header, which states the model's assumptions."""
        return self.title

    def material_voltage_rating(self, part: Part[LinearKeysT]) -> float | None:
        """Return the voltage rating [V] that follows from the material; None if unknown."""
        return None

    def rated_voltage(
        self, part: Part[LinearKeysT], build: BuiltScene | None = None
    ) -> float | None:
        """Return the voltage rating [V] of the electrodes, from keys, layers or mesh."""
        mesh = {} if build is None else build.model(part, LinearModel).facts
        known = part.keys.rated_voltage or self.material_voltage_rating(part)
        return known or mesh.get("depoling_voltage_v")

    def used_ports(self, part: Part[LinearKeysT], scene: JoinedScene) -> tuple[Port, ...]:
        """Return the ports of the part that the scene uses.

        A scene uses the electrical ports of a body, and the other ports that a part or a probe
        names. A scene with the body as its only part uses all ports, because the purpose of such a
        scene is an export. In an export of a scene, a body uses all ports that its keys declare.
        """
        every = self.ports(part, scene)
        if len(scene.parts) == 1 or scene.ports == "all":
            return every
        names = find_required_ports(part, scene)
        known = {"ground", *REFERENCES}.union(*map(_list_scene_names, every))
        if self.gives_off_heat(part, scene):
            known |= {HEAT, AMBIENT}
        if missing := sorted(names - known):
            raise _make_missing_port_error(part, missing[0], every, scene)
        if scene.ports == "declared" and part.has_declared_ports:
            return every
        used = [p for p in every if p.kind not in SINGLE_PIN_KINDS or names & _list_scene_names(p)]
        return tuple(used) or every[:1]

    def used_port_names(self, part: Part[LinearKeysT], scene: JoinedScene) -> list[str]:
        """Return the names of the ports of the part that the scene uses."""
        return list_names(self.used_ports(part, scene))

    def pins(self, part: Part[LinearKeysT], scene: JoinedScene) -> tuple[Terminal, ...]:
        """Return the pins of the part in the order of its subcircuit."""
        ports, rated = self.used_ports(part, scene), self.rated_voltage(part)
        result: list[Terminal] = []
        shared: set[str] = set()
        for port in ports:
            if not port.is_paired:
                continue
            plus, minus = port.terminals
            result.append(Terminal(plus, port.across, port.flow, rated=rated))
            if minus not in shared:
                floating = minus in find_required_ports(part, scene) - set(part.pins)
                result.append(Terminal(minus, port.across, port.flow, None if floating else "gnd"))
            shared.add(minus)
        # If ``scene.ports`` is "all", the list also contains ports that the model omits.
        # The name of a port that the model omits needs no check.
        if scene.ports != "all":
            names = dict.fromkeys(chain.from_iterable(port.terminals for port in ports))
            require_distinct(
                list(names), INNER_NODE_PATTERN, where=part.name, expected=PERMITTED_PIN_NAMES
            )
        for port in ports:
            if port.kind in SINGLE_PIN_KINDS:
                result.append(Terminal(port.terminals[0], port.across, port.flow))
        for port in ports:
            if not port.conservative:
                out = port.kind == "output"
                result.append(Terminal(port.terminals[0], port.across, "-", signal_out=out))
        last = find_reference_pin(ports)
        heat = HEAT_TERMINALS if self.gives_off_heat(part, scene) else ()
        return (*result, Terminal(last.name, last.unit, last.flow, "gnd"), *heat)

    def gives_off_heat(self, part: Part[LinearKeysT], scene: DeclaredScene) -> bool:
        """Return whether the body emits its lost power as heat at the pin ``heat``.

        A heat body has no such pin, and neither has a body with its own port ``heat``.
        """
        if not is_heated(part, scene):
            return False
        ports = self.ports(part, scene)
        return all(p.name != HEAT and p.domain is not THERMAL for p in ports)

    def reference_terminal(self, part: Part[LinearKeysT], scene: WiredScene) -> Terminal:
        """Return the reference pin, which all single-pin ports of the part share."""
        last = -1 - len(HEAT_TERMINALS) * self.gives_off_heat(part, scene)
        return scene.pins(part.name)[last]

    def equilibrium_conditions(
        self, part: Part[LinearKeysT], scene: WiredScene
    ) -> EquilibriumConditions:
        """Return the equilibrium conditions: pin pairs with a possible constant flow.

        The body transmits a constant force, torque, heat flow or volume flow from each
        displacement, angle, temperature or pressure pin to the reference pin. The pin ``heat``,
        through which the losses leave the body, has no path of steady flow to the reference pin. A
        reference pin ``base`` or ``ground`` is replaced by ground.
        """
        last = self.reference_terminal(part, scene)
        end = GROUND if last.name in (BASE, "ground") else last.name
        paths = super().equilibrium_conditions(part, scene).paths
        if self.gives_off_heat(part, scene):
            paths = tuple(path for path in paths if HEAT not in path)
        return EquilibriumConditions(tuple((pin, end) for pin, _ in paths if pin != end))

    def equilibrium_after_build(
        self, part: Part[LinearKeysT], build: BuiltScene
    ) -> EquilibriumConditions:
        """Return the equilibrium conditions of a body whose model is built.

        The ``paths`` of a supported body lead from its pins to the reference pin. The ``paths`` of
        a free body connect only its pins with each other, because no support carries a force. A
        constant volume flow can pass through an acoustic port only if the body is free.
        """
        model, rest = build.models.get(part.name), build.scene.records[part.name].rest
        if not isinstance(model, LinearModel):
            return rest
        ports, inert = self.used_ports(part, build.scene), list_inertial_pins(model)
        if not has_energy_free_mode(model):
            charged = {port.terminals[0] for port in ports if port.has_charge_output}
            paths = tuple(pair for pair in rest.paths if pair[0] not in charged)
            return EquilibriumConditions(paths, inertial_pins=inert)
        free = {port.name for port in ports if not port.has_charge_output}
        fixed, pins = [], []
        for pin, end in rest.paths:
            if pin in free:
                pins.append(pin)
            else:
                fixed.append((pin, end))
        first, *others = pins or [GROUND]
        return EquilibriumConditions((*fixed, *product([first], others)), inertial_pins=inert)

    def pins_with_mass(self, part: Part[LinearKeysT], scene: JoinedScene) -> tuple[str, ...]:
        """Return the pins with mass: the displacement pins of the used mechanical ports."""
        ports = select_mechanical_ports(self.used_ports(part, scene))
        return tuple(port.terminals[0] for port in ports)

    def constant_pins(self, part: Part[LinearKeysT], scene: WiredScene) -> Mapping[str, str]:
        """Return the reference pin if displacements or temperatures are relative to it.

        A moving support is modelled by an acceleration port, if the body has one.
        """
        pin = self.reference_terminal(part, scene)
        if pin.domain is THERMAL:
            return {pin.name: self.varying_ambient_advice}
        if pin.domain is not TRANSLATION:
            return {}
        shaken = [p for p in self.ports(part, scene) if p.domain is ACCELERATION]
        action = (
            "for a moving support, use a supported disc, a bimorph, or a body with a port of kind "
            "base"
        )
        if shaken:
            end = f"{part.name}.{shaken[0].terminals[0]}"
            action = f'for a moving support, connect a source of kind "acceleration" to {end}'
        return {pin.name: action}

    def contact_surface(
        self, part: Part[LinearKeysT], scene: GovernedScene, ports: tuple[str, ...] = ()
    ) -> ContactSurface | None:
        """Return the surface on which a contact presses; None without mechanical ports."""
        mechanical = list_names(select_mechanical_ports(self.ports(part, scene)))
        names = ports or tuple(mechanical[:1])
        for name in filterfalse(mechanical.__contains__, names):
            raise unknown(f"{part.name} has no such mechanical port", name, mechanical, part.name)
        if not names:
            return None
        modulus = self.indentation_modulus(part)
        return ContactSurface(part.name, names, (0.0,) * len(names), modulus=modulus)

    def indentation_modulus(self, part: Part[LinearKeysT]) -> float | None:
        """Return the indentation modulus [Pa] of the body's surface; None if unknown."""
        return None


def _make_missing_port_error(
    part: Part, name: str, ports: Sequence[Port], scene: JoinedScene
) -> UsageError:
    """Make the error for a missing port of a part, at the key that refers to the port.

    If a pin of another part is joined to the missing port, the error proposes pins of the same
    kind as this pin.
    """
    message = f"{part.name} has no such port"
    for other in scene.parts.values():
        for pin, target in other.pins.items():
            if target == f"{part.name}.{name}":
                choices = _list_fitting_pins(part, ports, other, pin, scene)
                error = unknown(
                    message,
                    target,
                    choices,
                    f"{other.name}.pins.{pin}",
                    advice=f'write  {pin} = "{choices[0] if choices else GROUND}"',
                )
                if not choices:
                    error.expected = "gnd, or a pin of another part"
                return error
    where = part.name if name not in part.pins else f"{part.name}.pins.{name}"
    for label, probe in scene.probes.items():
        if probe.of.startswith(f"{part.name}.") and probe.of.endswith(f".{name}"):
            where = f"probes.{label}.of"
    return unknown(message, name, list_names(ports), where)


def _list_fitting_pins(
    part: Part, ports: Sequence[Port], other: Part, pin: str, scene: JoinedScene
) -> list[str]:
    """List the pins of a body to which a pin of another part may be joined.

    Pins that the body joins to the other part are excluded, because a second join could
    short-circuit the other part.
    """
    pins = [
        Terminal(name, port.across, port.flow if port.conservative else SIGNAL)
        for port in ports
        for name in (port.terminals if port.is_paired else port.terminals[:1])
    ]
    if not isinstance(other.type, BodyPorts):  # the pins of a body depend on its joins
        with suppress(UsageError):
            terminals = {item.name: item for item in other.type.pins(other, scene)}
            own = terminals.get(pin)
            pins = [item for item in pins if own is None or own.fits(item)]
    joined = {end for end, target in part.pins.items() if target.startswith(f"{other.name}.")}
    return [f"{part.name}.{item.name}" for item in pins if item.name not in joined]


def find_required_ports(part: Part, scene: JoinedScene) -> set[str]:
    """Return the names of all ports and pins of ``part`` that the scene uses.

    The references are in other parts, in probes, and in the key ``pins`` of the part.
    """
    prefix = f"{part.name}."
    assert isinstance(part.type, BodyPorts)
    result = set(part.pins)
    for other in scene.parts.values():
        names = (*other.pins.values(), *scene.joins[other.name].values())
        result.update(name.removeprefix(prefix) for name in names if name.startswith(prefix))
        # A part that copies the body connects loads to all ports of the copies.
        if scene.records[other.name].governed_parts.get(part.name) == "copied":
            result |= {
                port.name for port in part.type.ports(part, scene) if port.kind in SINGLE_PIN_KINDS
            }
    for probe in scene.probes.values():
        word, dot, _ = probe.of.removeprefix(prefix).partition(".")
        if probe.of.startswith(prefix) and dot and word in WAVE_WORDS:
            result.add(probe.of.rpartition(".")[2])
    return result


def select_mechanical_ports(ports: Iterable[Port]) -> list[Port]:
    """Select the ``ports`` that have a displacement and a force."""
    return [port for port in ports if port.domain is TRANSLATION]


def select_paired_ports(ports: Iterable[Port]) -> list[Port]:
    """Select the ``ports`` that have two pins, such as electrodes."""
    return [port for port in ports if port.is_paired]


def _list_scene_names(port: Port) -> set[str]:
    """Return all names of a port in scenes: its own name and the names of its pins."""
    return {port.name, *port.terminals}


def list_contacts_on_part(part: Part, scene: JoinedScene) -> Iterator[Part[ContactKeys]]:
    """Yield the contact parts of the scene that press on a port of ``part``."""
    for contact in scene.list_parts_with_schema("contact", ContactKeys):
        targets = scene.joins[contact.name].values()
        if any(target.startswith(f"{part.name}.") for target in targets):
            yield contact


def requires_massless_ports(part: Part, scene: JoinedScene) -> bool:
    """Return whether a contact on ``part`` requires ports without inertia."""
    return any(contact.keys.inertia == "massless" for contact in list_contacts_on_part(part, scene))


def list_inertial_pins(model: LinearModel) -> tuple[str, ...]:
    """Return displacement pins with inertia, which a sudden force cannot move at once.

    At such a pin, the displacement cannot follow a sudden force, because the feedthrough matrix D
    and the massless states contribute nothing.
    """
    if model.first_order or not model.symmetric:
        return ()
    mass = model.pencil.make_dense().coefficients[2]
    yields = np.diag(model.D) + np.abs(model.B[~mass.any(axis=0)]).sum(axis=0)
    inputs = dict(zip(model.inputs, yields, strict=True))
    ports = select_mechanical_ports(model.ports)
    return tuple(port.terminals[0] for port in ports if inputs[port.name] <= 0)


def has_energy_free_mode(model: LinearModel) -> bool:
    """Return whether the model has a mode without stored energy."""
    if compute_resonators(model) is not None:
        return False
    rest = model.pencil.make_dense().coefficients[0]
    for axis in (1, 0):
        size = np.abs(rest).max(axis=axis, keepdims=True, initial=0.0)
        rest = rest / np.where(size > 0, size, 1.0)
    values = np.linalg.svd(rest, compute_uv=False)
    return bool(values.min(initial=np.inf) <= ZERO_ENERGY * values.max(initial=0.0))


def get_wave_name(name: str, ports: Sequence[Port], port: Port) -> str:
    """Return the name of a port's waveform in the results.

    For an electrical port, the returned name is the prefix of the result names ``.voltage`` and
    ``.current``. The first electrical port has the name of the part as its name in the results.
    """
    if port.is_paired:
        return name if port == select_paired_ports(ports)[0] else f"{name}.{port.name}"
    word = "" if port.domain is None else port.domain.output_symbol
    return ".".join(filter(None, (name, word, port.name)))


def get_flow_name(name: str, ports: Sequence[Port], port: Port) -> str:
    """Return the result name of the flow (such as current) through a port's pin."""
    if port.is_paired:
        return f"{get_wave_name(name, ports, port)}.current"
    return f"{name}.{FLOW_SYMBOLS_OF_PORTS[port.kind]}.{port.name}"
