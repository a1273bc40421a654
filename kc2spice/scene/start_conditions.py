"""Nets at the start of an analysis: clamps, and missing paths to references."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from itertools import chain

from kc2spice.core.domains import HEAT, TRANSLATION, Domain
from kc2spice.core.errors import UsageError
from kc2spice.scene.compose import Groups
from kc2spice.scene.model import GROUND, Scene
from kc2spice.scene.rows import Rest

Pairs = tuple[tuple[str, str], ...]  # pairs of pins of one part


@dataclass(frozen=True)
class FloatingNets:
    """Nets that can drift together, because no path connects them to their reference.

    ``nets`` are the nets of displacements; a sphere has none, because its pins are a velocity and
    signals. ``parts`` have a pin on the nets. ``bodies`` are the nets of bodies with inertia.
    ``domain`` is the domain of the pins; in heat and sound, the potential floats instead of a
    position.
    """

    nets: tuple[str, ...]
    parts: tuple[str, ...]
    bodies: tuple[str, ...]
    domain: Domain


def find_floating_nets(scene: Scene, rests: Mapping[str, Rest]) -> tuple[FloatingNets, ...]:
    """Return the groups of nets without an equilibrium, in the order of the scene.

    Parts without a model count as clamps.
    """
    return tuple(_describe_group(group, scene) for group in _floating_groups(scene, rests))


def find_rigid_groups(scene: Scene, without: str = "") -> list[frozenset[str]]:
    """Return groups of nets whose displacements ideal sources connect rigidly.

    The source named ``without`` is ignored. A net that no ideal source ties to another net forms
    its own group.
    """
    rests = scene.rests
    rests.pop(without, None)
    return _group_nets(scene, ((name, rest.ideal) for name, rest in rests.items()))


def find_start_errors(scene: Scene, rests: Mapping[str, Rest]) -> Iterator[UsageError]:
    """Yield the reasons why the analysis cannot begin.

    A net has no operating point, or a source makes the velocity of an inertia jump. The force of a
    jump is an impulse: the result of a simulator would depend on its time step.

    Parts without a model count as clamps that yield.
    """
    for group in _floating_groups(scene, rests):
        floating = _describe_group(group, scene)
        find = _position_errors if floating.domain.has_position else _storage_errors
        yield from find(floating, group, scene, rests)
    if scene.analysis.type == "transient":
        yield from _list_velocity_jump_errors(scene, rests)


def _floating_groups(scene: Scene, rests: Mapping[str, Rest]) -> Iterator[frozenset[str]]:
    """Yield groups of nets without a path to their reference."""
    groups = _group_nets(scene, ((name, rest.paths) for name, rest in rests.items()))
    return (group for group in groups if "0" not in group)


def _position_errors(
    result: FloatingNets, group: frozenset[str], scene: Scene, rests: Mapping[str, Rest]
) -> Iterator[UsageError]:
    """Yield the reasons why floating positions have no operating point."""
    kind, path = scene.analysis.type, result.domain.path_to_reference
    heavy = [name for name, rest in rests.items() if rest.inert and name in result.parts]
    part_name = (*result.bodies, *heavy, *result.parts)[0]
    pushed = _list_loads(group, scene, rests)
    by = "pushed by " + ", ".join(pushed) if pushed else ""
    if kind in ("op", "dc"):
        yield UsageError(
            f"{part_name} has no support, so it has no operating point",
            where=part_name,
            got=", ".join(filter(None, (f"analysis {kind}", by))),
            expected=path,
            hint='add a support, or use analysis.type = "transient"',
        )
    elif by and scene.analysis.is_small_signal:
        yield UsageError(
            f"{part_name} has no support against a constant force, so it has no operating point "
            f"for the linear analysis",
            where=part_name,
            got=by,
            expected=f"no constant force, or {path}",
            hint="delete the key dc of the source, or set weight = false",
        )
    elif by and result.bodies:
        yield UsageError(
            f"{part_name} has no support against the force at t = 0, so the transient cannot "
            f"begin at rest",
            where=part_name,
            got=by,
            expected="a force that is zero at t = 0, such as a pulse, or a support",
        )


def _list_loads(group: frozenset[str], scene: Scene, rests: Mapping[str, Rest]) -> list[str]:
    """Return the parts with a constant force or flow on these nets at t = 0."""
    result = []
    for name, rest in rests.items():
        if not group.isdisjoint(scene.nets_of(name, rest.pushed)):
            result.append(name)
    return result


def _storage_errors(
    result: FloatingNets, group: frozenset[str], scene: Scene, rests: Mapping[str, Rest]
) -> Iterator[UsageError]:
    """Yield the reason why floating temperatures or pressures have no operating point.

    Without a constant flow, such nets have an operating point: small signals and pulses are
    stored. The losses of a part count as a constant flow, because they follow from the operating
    point.
    """
    kind, domain = scene.analysis.type, result.domain
    losses = [name for (name, pin), net in scene.nets.items() if pin == HEAT and net in group]
    pushed = list(dict.fromkeys([*_list_loads(group, scene, rests), *losses]))
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


def _list_velocity_jump_errors(scene: Scene, rests: Mapping[str, Rest]) -> Iterator[UsageError]:
    """Yield an error for each initial displacement that would need a velocity step of a mass."""
    inert: dict[str, str] = {}
    for name, rest in rests.items():
        inert |= dict.fromkeys(scene.nets_of(name, rest.inert), name)
    inert.pop("0", None)
    for name, rest in rests.items():
        if not rest.kinked:
            continue
        part = scene.parts[name]
        ends = set(scene.nets_of(name, chain.from_iterable(rest.ideal)))
        sides = [nets for nets in find_rigid_groups(scene, name) if nets & ends]
        nets = chain.from_iterable(map(sorted, sides))
        driven = [inert[net] for net in nets if net in inert]
        if driven and len(sides) > 1 and all(map({"0", *inert}.intersection, sides)):
            yield part.wrong(
                rest.kinked,
                f"the velocity of {driven[0]} jumps with this displacement, which needs an "
                f"infinite force",
                f"{driven[0]} fixed to {part.name}",
                "a spring or an elastic body between both parts",
                f'kind = "force" pushes {driven[0]}; a spring as stiff as the joint follows a '
                "displacement",
            )


def _units_of_nets(scene: Scene) -> dict[str, str]:
    """Return the units of nets that need a path to their reference."""
    result = {"0": ""}
    for key, terminal in scene.terminals.items():
        if terminal.needs_path:
            result[scene.nets[key]] = terminal.unit
    return result


def _group_nets(scene: Scene, pairs_of_parts: Iterable[tuple[str, Pairs]]) -> list[frozenset[str]]:
    """Group nets that are joined by pairs of pins.

    Pairs of nets that need no path, such as electrical nets, have no effect.
    """
    union = Groups(units := _units_of_nets(scene))
    for name, pairs in pairs_of_parts:
        for pins in pairs:
            a, b = ("0" if pin == GROUND else scene.net(name, pin) for pin in pins)
            if a in units and b in units:
                union.join(a, b)
    return list(map(frozenset, union.list_groups()))


def _describe_group(group: frozenset[str], scene: Scene) -> FloatingNets:
    """Return a group of nets with the parts on it and its domain."""
    domains: dict[str, Domain] = {}  # domain of the first pin of each part
    for key, terminal in scene.terminals.items():
        if terminal.domain is not None and terminal.needs_path and scene.nets[key] in group:
            domains.setdefault(key[0], terminal.domain)
    nets = []
    for net, unit in _units_of_nets(scene).items():
        if net in group and unit == TRANSLATION.across.pin_unit:
            nets.append(net)
    bodies = tuple(name for name in domains if scene.parts[name].reduced)
    return FloatingNets(tuple(nets), tuple(domains), bodies, next(iter(domains.values())))
