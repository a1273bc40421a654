"""Nets at the start of an analysis: what holds them at rest, and what is missing for that."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from kc2spice.core.domains import TRANSLATION, Domain
from kc2spice.core.errors import UsageError
from kc2spice.scene.compose import Groups
from kc2spice.scene.model import GROUND, Scene
from kc2spice.scene.rows import Rest


@dataclass(frozen=True)
class Free:
    """Nets that are held against each other at most: they move together without any force.

    ``nets`` are those of displacements, none for a sphere, whose pins are a velocity and signals.
    ``parts`` have a pin there, ``bodies`` of them move along by states of their own. ``domain`` is
    that of the pins: heat and flow without a path are no motion.
    """

    nets: tuple[str, ...]
    parts: tuple[str, ...]
    bodies: tuple[str, ...]
    domain: Domain


def free(scene: Scene, rests: Mapping[str, Rest]) -> tuple[Free, ...]:
    """The groups of nets without an equilibrium of their own, in the order of the scene.

    Parts whose model is not built yet count as held.
    """
    return tuple(_free(group, scene) for group in _unheld(scene, rests))


def rigid(scene: Scene, without: str = "") -> list[frozenset[str]]:
    """Nets whose displacements ideal sources, all but ``without``, tie to each other; alone where
    nothing does."""
    rests = ((name, rest) for name, rest in scene.rests.items() if name != without)
    return _groups(scene, {name: rest.ideal for name, rest in rests})


def unsettled(scene: Scene, rests: Mapping[str, Rest]) -> Iterator[UsageError]:
    """Why the analysis cannot begin: nets without an operating point, and sources that make the
    velocity of inertia jump with nothing that yields in between. Their force is an impulse, and a
    simulator gives what its step makes of it, ringing after it.

    Parts whose model is not built yet count as held and as yielding.
    """
    for group in _unheld(scene, rests):
        adrift = _free(group, scene)
        why = _unheld_problem if adrift.domain.position else _undrained_problem
        yield from why(adrift, group, scene, rests)
    if scene.analysis.type == "transient":
        yield from _jumps(scene, rests)


def _unheld(scene: Scene, rests: Mapping[str, Rest]) -> Iterator[frozenset[str]]:
    clamps = {name: rest.paths for name, rest in rests.items()}
    return (group for group in _groups(scene, clamps) if "0" not in group)


def _unheld_problem(
    result: Free, group: frozenset[str], scene: Scene, rests: Mapping[str, Rest]
) -> Iterator[UsageError]:
    """Why the analysis has no operating point of these nets of positions to begin at."""
    kind, path = scene.analysis.type, result.domain.path
    heavy = [name for name, rest in rests.items() if rest.inert and name in result.parts]
    part_name = (*result.bodies, *heavy, *result.parts)[0]
    pushed = _pushing(group, scene, rests)
    by = "pushed by " + ", ".join(pushed) if pushed else ""
    if kind in ("op", "dc"):
        yield UsageError(
            f"nothing holds {part_name}: it has no operating point",
            where=part_name,
            got=", ".join(filter(None, (f"analysis {kind}", by))),
            expected=path,
            hint='analysis.type = "transient" lets it move',
        )
    elif by and scene.analysis.small:
        yield UsageError(
            f"nothing holds {part_name} against a constant force: there is no point at rest to "
            "linearise about",
            where=part_name,
            got=by,
            expected=f"no constant force, or {path}",
            hint="ac = … without dc; weight = false",
        )
    elif by and result.bodies:
        yield UsageError(
            f"nothing holds {part_name} against a constant force at t = 0: a transient cannot "
            "begin at rest",
            where=part_name,
            got=by,
            expected="a force that is zero at t = 0, such as a pulse, or a support",
        )


def _pushing(group: frozenset[str], scene: Scene, rests: Mapping[str, Rest]) -> list[str]:
    """Parts that put a constant force or flow on these nets at t = 0."""
    on_group = ((n, {scene.nets[n, pin] for pin in rest.pushed}) for n, rest in rests.items())
    return [name for name, nets in on_group if nets & group]


def _undrained_problem(
    result: Free, group: frozenset[str], scene: Scene, rests: Mapping[str, Rest]
) -> Iterator[UsageError]:
    """Why the analysis has no operating point of these nets of heat or sound to begin at.

    Without a constant flow it has one: small signals and pulses are stored.
    """
    kind, domain = scene.analysis.type, result.domain
    pushed = _pushing(group, scene, rests)
    if kind not in ("op", "dc") and not pushed:
        return
    ends = ((n, pin) for (n, pin), end in scene.terminals.items() if end.domain is domain)
    pin = next(".".join(key) for key in ends if scene.nets[key] in group)
    flow = domain.quantity("through").name.replace("_", " ")
    stored = next((name for name in result.parts if name not in pushed), result.parts[0])
    later = "" if kind in ("op", "dc", "ac", "noise") else f"; or a {flow} that is zero at t = 0"
    yield UsageError(
        f"{domain.adrift.format(part=stored)}: it has no operating point",
        where=stored,
        got=", ".join([f"analysis {kind}", *(f"{flow} of {name}" for name in pushed)]),
        expected=f"{domain.path}{later}",
        hint=f'add [path] with part = "{domain.path_part}", its resistance and  '
        f'pins = {{ a = "{pin}" }}',
    )


def _jumps(scene: Scene, rests: Mapping[str, Rest]) -> Iterator[UsageError]:
    inert: dict[str, str] = {}
    for name, rest in rests.items():
        inert |= {scene.nets[name, pin]: name for pin in rest.inert}
    inert.pop("0", None)
    for name, rest in rests.items():
        if not rest.kinked:
            continue
        part = scene.parts[name]
        ends = {scene.nets[name, pin] for pair in rest.ideal for pin in pair}
        sides = [nets for nets in rigid(scene, name) if nets & ends]
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
    """Nets of pins that need a path and the unit there, in the order of the scene."""
    ends = ((key, pin.unit) for key, pin in scene.terminals.items() if pin.needs_path)
    return {"0": ""} | {scene.nets[key]: unit for key, unit in ends}


def _groups(
    scene: Scene, joined: Mapping[str, tuple[tuple[str, str], ...]]
) -> list[frozenset[str]]:
    """Nets that move by what pairs of pins join; pairs of others, such as voltages, say nothing."""
    union = Groups(nets := _moving(scene))
    for name, pairs in joined.items():
        for pins in pairs:
            a, b = ("0" if pin == GROUND else scene.nets[name, pin] for pin in pins)
            if a in nets and b in nets:
                union.join(a, b)
    return list(map(frozenset, union.groups()))


def _free(group: frozenset[str], scene: Scene) -> Free:
    rows = scene.terminals.items()
    ends = {key: pin for key, pin in rows if pin.needs_path and scene.nets[key] in group}
    parts = tuple(dict.fromkeys(name for name, _ in ends))
    domain = next(pin.domain for pin in ends.values() if pin.domain is not None)
    placed = [net for net, unit in _moving(scene).items() if unit == TRANSLATION.across.pin_unit]
    nets = tuple(net for net in placed if net in group)
    bodies = tuple(name for name in parts if scene.parts[name].reduced)
    return Free(nets, parts, bodies, domain)
