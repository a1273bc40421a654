"""Reference frames of displacements: the ground, or a frame that an acceleration shakes.

A body whose pin of kind ``m/s2`` is joined is fixed to a shaken frame, and its displacements are
relative to that frame. So are those of every net that parts couple to it; ``gnd`` is the frame
there. In the frame a mass m along the unit vector e feels the force of the acceleration a besides::

    m x'' = F - m a . e
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping

from kc2spice.core.domains import ACCELERATION, TRANSLATION, VELOCITY
from kc2spice.core.errors import UsageError
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.rows import SQUARE, Shake, ShakenFrame

MOTIONS = (TRANSLATION.across.pin_unit, VELOCITY.pin_unit)  # units of pins that move or sense it


def frames(scene: Scene) -> dict[tuple[str, str], ShakenFrame]:
    """The frame of every pin whose displacement is relative to a shaken one, by part and pin.

    Raises
    ------
    UsageError : nets that parts couple are in different frames, a part with inertia does not follow
        the frame, or a direction is not known.
    """
    bodies = {part.name: shaken for part in scene.parts.values() if (shaken := _ports(part, scene))}
    if not bodies:
        return {}
    result = dict[str, ShakenFrame]()
    for name, pins in bodies.items():
        for pin, frame in pins.items():
            _put(result, scene.nets[name, pin], frame, f"{name}.{pin}")
    changed = True
    while changed:
        before = len(result)
        for part in scene.parts.values():
            if not part.reduced:
                _spread(part, scene, result)
        changed = len(result) > before
    for part in scene.parts.values():
        _compared(part, scene, result)
        _followed(part, scene, result, bodies.get(part.name, {}))
    return {pin: result[net] for pin, net in scene.nets.items() if net in result}


def _ports(part: Part, scene: Scene) -> dict[str, ShakenFrame]:
    """Frames of a body's motions by pin; none where nothing shakes it."""
    if not part.reduced:
        return {}
    known = part.type.directions(part, scene)
    ends = {pin: end for (name, pin), end in scene.terminals.items() if name == part.name}
    shaken = [
        pin
        for pin, end in ends.items()
        if end.domain is ACCELERATION and scene.nets[part.name, pin] != "0"
    ]
    if not shaken:
        return {}
    result = {}
    for pin in _moving(part, scene):
        rows = ((other, _cosine(known.get(pin), known.get(other))) for other in shaken)
        shakes = (Shake(scene.nets[part.name, a], (part.name, a), share) for a, share in rows)
        acting = (s for s in shakes if s.along is None or abs(s.along) > SQUARE)
        result[pin] = ShakenFrame(part.name, tuple(acting))
    return result


def _cosine(a: tuple[float, ...] | None, b: tuple[float, ...] | None) -> float | None:
    if a is None or b is None:
        return None
    return float(sum(x * y for x, y in zip(a, b, strict=True)))


def _moving(part: Part, scene: Scene, *, listening: bool = False) -> list[str]:
    """Pins of a part on nets of displacements or velocities that are not ground; ``listening`` ones
    too that only see them."""
    result = []
    for (name, pin), end in scene.terminals.items():
        mechanical = end.moving or (listening and end.unit in MOTIONS and not end.signal_out)
        if name == part.name and mechanical and scene.nets[name, pin] != "0":
            result.append(pin)
    return result


def _put(known: dict[str, ShakenFrame], net: str, frame: ShakenFrame, where: str) -> None:
    """State the frame of a net."""
    if net == "0":
        return
    first = known.setdefault(net, frame)
    if first.acts != frame.acts:
        raise UsageError(
            "joins displacements in different frames",
            where=where,
            got=f"relative to a frame that {first.words} shakes, and to one that {frame.words} "
            "shakes",
            expected="bodies that one acceleration shakes along the same axis",
            hint="join the acceleration pins of both bodies to one source, or separate the bodies",
        )


def _spread(part: Part, scene: Scene, known: dict[str, ShakenFrame]) -> None:
    """All nets that a part couples are in one frame."""
    nets = [scene.nets[part.name, pin] for pin in _moving(part, scene)]
    frame = next((known[net] for net in nets if net in known), None)
    if frame is not None:
        for net in nets:
            _put(known, net, frame, part.name)


def _compared(part: Part, scene: Scene, known: Mapping[str, ShakenFrame]) -> None:
    """Refuse a part that compares a relative displacement with an absolute one."""
    moving = {scene.nets[key] for key, end in scene.terminals.items() if end.moving} - {"0"}
    nets = {pin: scene.nets[part.name, pin] for pin in _moving(part, scene, listening=True)}
    nets = {pin: net for pin, net in nets.items() if net in moving}
    acts = {known[net].acts if net in known else None for net in nets.values()}
    if len(acts) > 1 and not part.reduced:
        frames = [
            f"{part.name}.{pin} in {_frame_name(known.get(net))}" for pin, net in nets.items()
        ]
        raise UsageError(
            "compares displacements in different frames",
            where=part.name,
            got=", ".join(frames),
            expected="pins in one frame; gnd is in every frame",
            hint="join the pin that is in another frame to gnd or to a part of the same frame",
        )


def _frame_name(frame: ShakenFrame | None) -> str:
    return "the frame of the ground" if frame is None else f"the frame that {frame.words} shakes"


def _followed(
    part: Part, scene: Scene, known: Mapping[str, ShakenFrame], shaken: Mapping[str, ShakenFrame]
) -> None:
    """Refuse a part whose inertia does not follow the frame it is in; warn if that is unknown."""
    if shaken:
        return
    for pin in _moving(part, scene):
        frame = known.get(scene.nets[part.name, pin])
        if frame is None or not frame.shakes:
            continue
        if part.netlist:
            advice = f"in {_frame_name(frame)} its masses need the force -m a of their own"
            warnings.warn(f"{part.name}.{pin}: {advice}", stacklevel=2)
        elif pin not in part.type.inertial(part, scene):
            continue
        elif not part.type.follows_frames:
            body = part.reduced
            cure = "join its acceleration pin to the same source"
            other = 'use part = "mass", or drive the body by a force instead of its acceleration'
            raise UsageError(
                "has inertia, but nothing that shakes it with the frame it is joined to",
                where=f"{part.name}.{pin}",
                got=f"joined to {_frame_name(frame)}",
                expected="a body with a port of kind base" if body else "a part that follows it",
                hint=f'add a port of kind "base" to {part.name} and {cure}' if body else other,
            )
        elif any(shake.along is None for shake in frame.shakes):
            raise UsageError(
                "is in a frame whose acceleration has no known direction at this net",
                where=f"{part.name}.{pin}",
                got=f"joined to {_frame_name(frame)}",
                expected="ports and accelerations whose directions the body states",
                hint=f"state axis or dof of the ports of {frame.body}, or put the mass into its "
                "matrices",
            )


def frame_lines(scene: Scene) -> Iterator[str]:
    """Reference frame of the displacements of each net, for ``explain``."""
    nets: dict[str, list[str]] = {}
    for (part, pin), net in scene.nets.items():
        end = scene.terminals[part, pin]
        if net != "0" and (end.moving or (net in nets and end.unit in MOTIONS)):
            nets.setdefault(net, []).append(f"{part}.{pin}")
    relative = {scene.nets[pin]: frame for pin, frame in scene.frames.items()}
    if nets and not relative:
        yield "all displacements are absolute: they count from gnd, which is at rest"
    for net, pins in nets.items() if relative else ():
        frame = relative.get(net)
        if frame is None:
            yield f"{', '.join(pins)}: absolute"
        else:
            meaning = f"relative to the frame that {frame.words} shakes; gnd is that frame"
            yield f"{', '.join(pins)}: {meaning}"
