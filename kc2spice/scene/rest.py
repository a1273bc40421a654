"""What of a scene has an operating point: which nets of displacements something holds at rest."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from kc2spice.core.errors import UsageError
from kc2spice.scene.compose import Groups
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
    parts = scene.parts.values()
    held = [(part, part.type.at_rest(part, scene, build.model(part)).held) for part in parts]
    return tuple(_free(group, scene) for group in _groups(scene, held) if "0" not in group)


def rigid(scene: Scene, without: str = "") -> list[frozenset[str]]:
    """Nets whose displacements ideal sources, all but ``without``, tie to each other; alone where
    nothing does."""
    parts = [part for part in scene.parts.values() if part.name != without]
    return _groups(scene, [(part, part.type.at_rest(part, scene).ideal) for part in parts])


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


def without_finite_force(build: Build) -> Iterator[UsageError]:
    """Sources that make the velocity of inertia jump, with nothing that yields in between: the
    force is an impulse, and a simulator gives what its step makes of it, ringing after it.

    Bodies whose model is not built yet count as yielding.
    """
    scene = build.scene
    if scene.analysis.type != "transient":
        return
    rests = [(p, p.type.at_rest(p, scene, build.model(p))) for p in scene.parts.values()]
    inert = {scene.nets[p.name, pin]: p.name for p, rest in rests for pin in rest.inert}
    inert.pop("0", None)
    for part, rest in rests:
        if not rest.kinked:
            continue
        ends = {scene.nets[part.name, pin] for pair in rest.ideal for pin in pair}
        sides = [nets for nets in rigid(scene, part.name) if nets & ends]
        driven = [inert[net] for nets in sides for net in sorted(nets) if net in inert]
        if driven and len(sides) > 1 and all(nets & {"0", *inert} for nets in sides):
            yield part.wrong(
                rest.kinked,
                f"the velocity of {driven[0]} jumps with this displacement, which takes an "
                "infinite force",
                f"{driven[0]} fixed to {part.name}",
                "a spring or a body that yields between both",
                f'kind = "force" pushes {driven[0]}; a spring as stiff as the joint follows a '
                "displacement",
            )


def _moving(scene: Scene) -> dict[str, str]:
    """Nets of conservative pins that move and the unit there, in the order of the scene."""
    ends = ((key, pin.unit) for key, pin in scene.terminals.items() if pin.moving)
    return {"0": ""} | {scene.nets[key]: unit for key, unit in ends}


def _groups(
    scene: Scene, joined: list[tuple[Part, tuple[tuple[str, str], ...]]]
) -> list[frozenset[str]]:
    """Nets that move by what pairs of pins join; pairs of others, such as voltages, say nothing."""
    union = Groups(nets := _moving(scene))
    for part, pairs in joined:
        for pins in pairs:
            a, b = ("0" if pin == GROUND else scene.nets[part.name, pin] for pin in pins)
            if a in nets and b in nets:
                union.join(a, b)
    return list(map(frozenset, union.groups()))


def _free(group: frozenset[str], scene: Scene) -> Free:
    ends = (key for key, pin in scene.terminals.items() if pin.moving and scene.nets[key] in group)
    parts = {name: scene.parts[name] for name, _ in ends}
    rests = {name: part.type.at_rest(part, scene) for name, part in parts.items()}
    pushed = tuple(
        name
        for name, rest in rests.items()
        if any(scene.nets[name, pin] in group for pin in rest.pushed)
    )
    bodies = tuple(name for name, part in parts.items() if part.type.reduced)
    nets = tuple(n for n, unit in _moving(scene).items() if n in group and unit == "um")
    heavy = tuple(name for name, rest in rests.items() if rest.inert)
    return Free(nets, tuple(parts), heavy, pushed, bodies)
