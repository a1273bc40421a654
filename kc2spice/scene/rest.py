"""What of a scene has an operating point: which nets of displacements something holds at rest."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from kc2spice.core.errors import UsageError
from kc2spice.scene.compose import Groups
from kc2spice.scene.model import GROUND, Part, Scene
from kc2spice.scene.parttype import Build, Rest

HELD = "a spring, a contact, a clamped body or a displacement source between it and gnd"


@dataclass(frozen=True)
class Free:
    """Nets that are held against each other at most: they move together without any force.

    ``nets`` are those of displacements, none for a sphere, whose pins are a velocity and signals.
    ``parts`` have a pin there, ``bodies`` of them move along by states of their own.
    """

    nets: tuple[str, ...]
    parts: tuple[str, ...]
    bodies: tuple[str, ...]


def free(build: Build) -> tuple[Free, ...]:
    """The groups of nets without an equilibrium of their own, in the order of the scene.

    Parts whose model is not built yet count as held.
    """
    return tuple(_free(group, build.scene) for group in _unheld(build, _rests(build)))


def rigid(scene: Scene, without: str = "") -> list[frozenset[str]]:
    """Nets whose displacements ideal sources, all but ``without``, tie to each other; alone where
    nothing does."""
    parts = [part for part in scene.parts.values() if part.name != without]
    return _groups(scene, [(part, part.type.at_rest(part, scene).ideal) for part in parts])


def unsettled(build: Build) -> Iterator[UsageError]:
    """Why the analysis cannot begin: nets without an operating point, and sources that make the
    velocity of inertia jump with nothing that yields in between. Their force is an impulse, and a
    simulator gives what its step makes of it, ringing after it.

    Parts whose model is not built yet count as held and as yielding.
    """
    rests, kind = _rests(build), build.scene.analysis.type
    for group in _unheld(build, rests):
        yield from _unheld_problem(group, build.scene, rests)
    if kind == "transient":
        yield from _jumps(build.scene, rests)


def _rests(build: Build) -> list[tuple[Part, Rest]]:
    scene = build.scene
    return [(p, p.type.at_rest(p, scene, build.model(p))) for p in scene.parts.values()]


def _unheld(build: Build, rests: list[tuple[Part, Rest]]) -> Iterator[frozenset[str]]:
    held = [(part, rest.held) for part, rest in rests]
    return (group for group in _groups(build.scene, held) if "0" not in group)


def _unheld_problem(
    group: frozenset[str], scene: Scene, rests: list[tuple[Part, Rest]]
) -> Iterator[UsageError]:
    """Why the analysis has no operating point of these nets to begin at."""
    found, kind = _free(group, scene), scene.analysis.type
    heavy = [part.name for part, rest in rests if rest.inert and part.name in found.parts]
    named = (*found.bodies, *heavy, *found.parts)[0]
    pushed = [
        p.name for p, rest in rests if any(scene.nets[p.name, x] in group for x in rest.pushed)
    ]
    by = "pushed by " + ", ".join(pushed) if pushed else ""
    if kind in ("op", "dc"):
        yield UsageError(
            f"nothing holds {named}: it has no operating point",
            where=named,
            got=", ".join(filter(None, (f"analysis {kind}", by))),
            expected=HELD,
            hint='analysis.type = "transient" lets it move',
        )
    elif by and scene.analysis.small:
        yield UsageError(
            f"nothing holds {named} against a constant force: there is no point at rest to "
            "linearise about",
            where=named,
            got=by,
            expected=f"no constant force, or {HELD}",
            hint="ac = … without dc; weight = false",
        )
    elif by and found.bodies:
        yield UsageError(
            f"nothing holds {named} against a constant force at t = 0: a transient cannot begin "
            "at rest",
            where=named,
            got=by,
            expected="a force that is zero at t = 0, such as a pulse, or a support",
        )


def _jumps(scene: Scene, rests: list[tuple[Part, Rest]]) -> Iterator[UsageError]:
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
    scene: Scene, joined: Iterable[tuple[Part, tuple[tuple[str, str], ...]]]
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
    parts = tuple(dict.fromkeys(name for name, _ in ends))
    nets = tuple(net for net, unit in _moving(scene).items() if net in group and unit == "um")
    return Free(nets, parts, tuple(name for name in parts if scene.parts[name].reduced))
