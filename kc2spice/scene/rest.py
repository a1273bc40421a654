"""What of a scene has an operating point: which nets of displacements something holds at rest."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from kc2spice.core.errors import UsageError
from kc2spice.scene.model import GROUND, Part, Scene
from kc2spice.scene.parttype import Build

HELD = "a spring, a contact, a clamped body or a displacement source between it and gnd"


@dataclass(frozen=True)
class Free:
    """Nets that are held against each other at most: they move together without any force.

    ``nets`` are those of displacements, none for a sphere, whose pins are a velocity and signals.
    ``parts`` have a pin there: ``heavy`` ones move along, ``bodies`` by states of their own, and
    ``pushed`` ones put a constant force on them at t = 0.
    """

    nets: tuple[str, ...]
    parts: tuple[str, ...]
    heavy: tuple[str, ...]
    pushed: tuple[str, ...]
    bodies: tuple[str, ...]


def free(build: Build) -> tuple[Free, ...]:
    """The groups of nets without an equilibrium of their own, in the order of the scene.

    Parts whose model is not built yet count as held.
    """
    scene = build.scene
    pairs = [
        pair
        for part in scene.parts.values()
        for pair in _named(part, part.type.holds(part, scene, build.model(part)), scene)
    ]
    found = _groups(_moving(scene), pairs)
    return tuple(_free(group, scene) for group in found if "0" not in group)


def rigid(scene: Scene) -> list[frozenset[str]]:
    """Nets whose displacements ideal sources tie to each other; alone where nothing does."""
    pairs = [
        pair
        for part in scene.parts.values()
        for pair in _named(part, part.type.prescribes(part), scene)
    ]
    return _groups(_moving(scene), pairs)


def without_equilibrium(build: Build) -> Iterator[UsageError]:
    """Why the analysis has no operating point to begin at, one error a group of nets."""
    kind = build.scene.analysis.type
    for group in free(build):
        named = (*group.bodies, *group.heavy, *group.parts)[0]
        by = ", ".join(group.pushed)
        if kind in ("op", "dc"):
            yield UsageError(
                f"nothing holds {named}: it has no operating point",
                where=named,
                got=f"analysis {kind}" + (f", pushed by {by}" if by else ""),
                expected=HELD,
                hint='analysis.type = "transient" lets it move',
            )
        elif by and kind == "ac":
            yield UsageError(
                f"nothing holds {named} against a constant force: there is no point at rest to "
                "linearise about",
                where=named,
                got=f"pushed by {by}",
                expected=f"no constant force, or {HELD}",
                hint="ac = … without dc; weight = false",
            )
        elif by and group.bodies:
            yield UsageError(
                f"nothing holds {named} against a constant force at t = 0: a transient cannot "
                "begin at rest",
                where=named,
                got=f"pushed by {by}",
                expected="a force that is zero at t = 0, such as a pulse, or a support",
            )


def _moving(scene: Scene) -> dict[str, str]:
    """Nets of conservative pins that move and the unit there, in the order of the scene."""
    found = {
        scene.nets[part.name, pin.name]: pin.unit
        for part in scene.parts.values()
        for pin in part.type.pins(part, scene)
        if pin.moving
    }
    return {"0": ""} | found


def _named(part: Part, pairs: Any, scene: Scene) -> Iterator[tuple[str, str]]:
    for pins in pairs:
        a, b = ("0" if pin == GROUND else scene.nets[part.name, pin] for pin in pins)
        yield a, b


def _groups(nets: Mapping[str, str], pairs: list[tuple[str, str]]) -> list[frozenset[str]]:
    """``nets`` by what the pairs join; pairs of others, such as voltages, say nothing."""
    found = {net: {net} for net in nets}
    for a, b in pairs:
        if a in found and b in found and found[a] is not found[b]:
            found[a] |= found[b]
            for net in found[b]:
                found[net] = found[a]
    return list(dict.fromkeys(frozenset(group) for group in found.values()))


def _free(group: frozenset[str], scene: Scene) -> Free:
    ends = {
        (part.name, pin.name)
        for part in scene.parts.values()
        for pin in part.type.pins(part, scene)
        if pin.moving
    }
    names = dict.fromkeys(
        n for (n, pin), net in scene.nets.items() if net in group and (n, pin) in ends
    )
    parts = {name: scene.parts[name] for name in names}
    pushed = tuple(
        name
        for name, part in parts.items()
        if any(scene.nets[name, pin] in group for pin in part.type.pushes(part, scene))
    )
    bodies = tuple(name for name, part in parts.items() if part.type.reduced)
    nets = tuple(n for n, unit in _moving(scene).items() if n in group and unit == "um")
    heavy = tuple(name for name, part in parts.items() if part.type.heavy)
    return Free(nets, tuple(parts), heavy, pushed, bodies)
