"""Checks before an analysis: nets without a reference, and velocity jumps."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain

from kc2spice.core.disjoint_groups import DisjointGroups
from kc2spice.core.domains import HEAT, TRANSLATION, Domain
from kc2spice.core.errors import UsageError
from kc2spice.scene.part_records import EquilibriumConditions
from kc2spice.scene.scene_classes import GROUND, Scene

# Pairs of pins of one part. Between the pins of a pair, the part conducts a steady flow, such as a
# force or heat.
Pairs = tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class FloatingNets:
    """Group of nets without a path to the reference, whose values drift together.

    ``nets`` are the displacement nets of the group. A sphere has no floating displacement net,
    because the pins of a sphere are a velocity and signals. ``parts`` are the parts with a pin on
    the nets, and ``bodies`` are the bodies among these parts. ``domain`` is the domain of the pins.
    In the thermal and acoustic domains, a temperature or a pressure floats instead of a
    displacement.
    """

    nets: tuple[str, ...]
    parts: tuple[str, ...]
    bodies: tuple[str, ...]
    domain: Domain


def find_floating_nets(
    scene: Scene, conditions: Mapping[str, EquilibriumConditions]
) -> tuple[FloatingNets, ...]:
    """Return the groups of floating nets, in the order of the scene.

    A body whose model is not built yet counts as supported, so its nets do not float.
    """
    return tuple(
        _describe_group(group, scene) for group in _list_floating_groups(scene, conditions)
    )


def find_rigid_groups(scene: Scene, without: str = "") -> list[frozenset[str]]:
    """Return the groups of nets that ideal displacement sources connect rigidly.

    The source whose name is the argument ``without`` is ignored. A net that no ideal source
    connects to another net is a separate group.
    """
    conditions = scene.equilibrium_conditions
    conditions.pop(without, None)
    return _group_nets(scene, ((name, rest.ideal) for name, rest in conditions.items()))


def find_start_errors(
    scene: Scene, conditions: Mapping[str, EquilibriumConditions]
) -> Iterator[UsageError]:
    """Yield an error for each condition that prevents the start of the analysis.

    An error concerns a net without an operating point, or a source that makes the velocity of a
    mass jump. A velocity jump requires an infinite force, so that the computed motion would depend
    on the time step.

    A body whose model is not built yet counts as supported, so its nets do not float.
    """
    for group in _list_floating_groups(scene, conditions):
        floating = _describe_group(group, scene)
        find = _list_position_errors if floating.domain.has_position else _list_storage_errors
        yield from find(floating, group, scene, conditions)
    if scene.analysis.type == "transient":
        yield from _list_velocity_jump_errors(scene, conditions)


def _list_floating_groups(
    scene: Scene, conditions: Mapping[str, EquilibriumConditions]
) -> Iterator[frozenset[str]]:
    """Yield groups of nets without a path to their reference."""
    groups = _group_nets(scene, ((name, rest.paths) for name, rest in conditions.items()))
    return (group for group in groups if "0" not in group)


def _list_position_errors(
    result: FloatingNets,
    group: frozenset[str],
    scene: Scene,
    conditions: Mapping[str, EquilibriumConditions],
) -> Iterator[UsageError]:
    """List errors about displacement nets whose position no support determines."""
    kind, path_to_reference = scene.analysis.type, result.domain.path_to_reference
    inertial_parts = [
        name for name, rest in conditions.items() if rest.inertial_pins and name in result.parts
    ]
    part_name = (*result.bodies, *inertial_parts, *result.parts)[0]
    pushed = _list_loading_parts(group, scene, conditions)
    forces = "pushed by " + ", ".join(pushed) if pushed else ""
    if kind in ("op", "dc"):
        yield UsageError(
            f"{part_name} has no support, so it has no operating point",
            where=part_name,
            got=", ".join(filter(None, (f"analysis {kind}", forces))),
            expected=path_to_reference,
            hint='add a support, or use analysis.type = "transient"',
        )
    elif forces and scene.analysis.is_small_signal:
        yield UsageError(
            f"{part_name} has no support, but a constant force acts on {part_name}, so the linear "
            f"analysis has no operating point",
            where=part_name,
            got=forces,
            expected=f"no constant force, or {path_to_reference}",
            hint="delete the key `dc` of the source of the force, or set weight = false",
        )
    elif forces and result.bodies:
        yield UsageError(
            f"{part_name} has no support against the force at t = 0, so the transient cannot "
            f"begin at rest",
            where=part_name,
            got=forces,
            expected=f"a force that is zero at t = 0, or {path_to_reference}",
            hint=f"add a support to {part_name}, or use a force that is zero at t = 0",
        )


def _list_loading_parts(
    group: frozenset[str], scene: Scene, conditions: Mapping[str, EquilibriumConditions]
) -> list[str]:
    """Return the parts that apply a constant force or flow to some nets at t = 0.

    ``group`` contains the nets.
    """
    result = []
    for name, rest in conditions.items():
        if not group.isdisjoint(scene.get_nets(name, rest.loaded_pins)):
            result.append(name)
    return result


def _list_storage_errors(
    result: FloatingNets,
    group: frozenset[str],
    scene: Scene,
    conditions: Mapping[str, EquilibriumConditions],
) -> Iterator[UsageError]:
    """List errors about nets whose stored heat or volume has no equilibrium.

    In ``op`` and ``dc`` analyses, each net without a path to its reference is an error. In all
    other analyses, a net without a path to its reference is an error only if a constant flow enters
    the net. Without a constant flow, the heat or volume that is stored in the net stays constant.
    The heat from losses of a part counts as a constant flow, because losses at the operating point
    may be nonzero.
    """
    kind, domain = scene.analysis.type, result.domain
    losses = [name for (name, pin), net in scene.nets.items() if pin == HEAT and net in group]
    pushed = list(dict.fromkeys([*_list_loading_parts(group, scene, conditions), *losses]))
    if kind not in ("op", "dc") and not pushed:
        return
    ends = (key for key, terminal in scene.terminals.items() if terminal.domain is domain)
    pin = next(end for end in ends if scene.nets[end] in group)
    flow = domain.through_variable.name.replace("_", " ")
    stored = next((name for name in result.parts if name not in pushed), result.parts[0])
    zero = kind not in ("op", "dc", "ac", "noise") and not losses
    later = f"; or a {flow} that is zero at t = 0" if zero else ""
    yield UsageError(
        f"{domain.floating_error.format(part=stored)}, so the scene has no operating point",
        where=stored,
        got=", ".join([f"analysis {kind}", *(f"{flow} of {name}" for name in pushed)]),
        expected=f"{domain.path_to_reference}{later}",
        hint=f'add [path] with part = "{domain.path_part}", its resistance and  '
        f'pins = {{ a = "{".".join(pin)}" }}',
    )


def _list_velocity_jump_errors(
    scene: Scene, conditions: Mapping[str, EquilibriumConditions]
) -> Iterator[UsageError]:
    """Yield an error for each initial displacement that causes a velocity jump."""
    inert: dict[str, str] = {}
    for name, rest in conditions.items():
        inert |= dict.fromkeys(scene.get_nets(name, rest.inertial_pins), name)
    inert.pop("0", None)
    for name, rest in conditions.items():
        if not rest.jump_key:
            continue
        part = scene.parts[name]
        ends = set(scene.get_nets(name, chain.from_iterable(rest.ideal)))
        sides = [nets for nets in find_rigid_groups(scene, name) if nets & ends]
        nets = chain.from_iterable(map(sorted, sides))
        driven = [inert[net] for net in nets if net in inert]
        if driven and len(sides) > 1 and all(map({"0", *inert}.intersection, sides)):
            yield part.wrong(
                rest.jump_key,
                f"this displacement makes the velocity of {driven[0]} jump, although "
                f"{driven[0]} has inertia",
                got=f"{driven[0]} fixed to {part.name}",
                expected=f"a spring or an elastic body between {driven[0]} and {part.name}",
                hint=f'use kind = "force", or join {driven[0]} to {part.name} by a spring',
            )


def _map_nets_to_units(scene: Scene) -> dict[str, str]:
    """Map net names to units of pins, for all nets that need a path to a reference."""
    result = {"0": ""}
    for key, terminal in scene.terminals.items():
        if terminal.needs_path:
            result[scene.nets[key]] = terminal.unit
    return result


def _group_nets(scene: Scene, pairs_of_parts: Iterable[tuple[str, Pairs]]) -> list[frozenset[str]]:
    """Group the nets that parts connect through pairs of their pins.

    For each part, ``pairs_of_parts`` contains the pairs of its pins that it connects. Pairs of pins
    on nets that need no path to a reference, such as electrical nets, are ignored.
    """
    union = DisjointGroups(units := _map_nets_to_units(scene))
    for name, pairs in pairs_of_parts:
        for pins in pairs:
            a, b = ("0" if pin == GROUND else scene.get_net(name, pin) for pin in pins)
            if a in units and b in units:
                union.join(a, b)
    return list(map(frozenset, union.list_groups()))


def _describe_group(group: frozenset[str], scene: Scene) -> FloatingNets:
    """Return the record of a group of nets, with its parts and its domain."""
    # keyed by part name: domain of the first pin that the part has on the nets of the group
    domains: dict[str, Domain] = {}
    for key, terminal in scene.terminals.items():
        if terminal.domain is not None and terminal.needs_path and scene.nets[key] in group:
            domains.setdefault(key[0], terminal.domain)
    nets = []
    for net, unit in _map_nets_to_units(scene).items():
        if net in group and unit == TRANSLATION.across.pin_unit:
            nets.append(net)
    bodies = tuple(name for name in domains if scene.parts[name].is_body)
    return FloatingNets(tuple(nets), tuple(domains), bodies, next(iter(domains.values())))
