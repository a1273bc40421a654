"""Reference frames of displacements: the ground, or an accelerated frame.

If the acceleration pin (kind ``m/s2``) of a body is joined, the body is fixed to an accelerated
frame. The displacements of this body, and of all nets that parts couple to this body, are relative
to the accelerated frame. The pin ``gnd`` is then the origin of the frame. In a frame with the
acceleration a, a force F moves a mass m by the displacement x along the unit vector e::

    m x'' = F - m a . e
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from operator import mul

from kc2spice.core.domains import ACCELERATION, ACOUSTIC, THERMAL, TRANSLATION, VELOCITY
from kc2spice.core.errors import UsageError
from kc2spice.core.key_actions import SetKey
from kc2spice.core.user_warnings import warn_user
from kc2spice.scene.part_records import PERPENDICULAR_COSINE, AcceleratedFrame, FrameAcceleration
from kc2spice.scene.scene_classes import GROUND, Part, Scene

# units of pins that move a body or sense a motion
MOTION_UNITS = (TRANSLATION.across.pin_unit, VELOCITY.pin_unit)


def find_frames(scene: Scene) -> dict[tuple[str, str], AcceleratedFrame]:
    """Find the pins in accelerated reference frames, with the frame of each pin.

    Raises
    ------
    UsageError : a part couples nets in different frames, a part with inertia ignores the
        acceleration of its frame, or the direction of an acceleration is not known.
    """
    bodies = {}
    for part in scene.bodies:
        if shaken := _find_body_frames(part, scene):
            bodies[part.name] = shaken
    if not bodies:
        return {}
    result = dict[str, AcceleratedFrame]()
    for name, pins in bodies.items():
        for pin, frame in pins.items():
            _set_frame(result, scene.nets[name, pin], frame, f"{name}.{pin}")
    changed = True
    while changed:
        before = len(result)
        for part in scene.parts.values():
            if not part.is_body:
                _copy_frame_to_moving_nets(part, scene, result)
        changed = len(result) > before
    for part in scene.parts.values():
        _require_one_frame(part, scene, result)
        _require_acceleration_pin(part, scene, result, bodies.get(part.name, {}))
    return {pin: result[net] for pin, net in scene.nets.items() if net in result}


def _find_body_frames(part: Part, scene: Scene) -> dict[str, AcceleratedFrame]:
    """Return the accelerated frame in which each moving pin of a body is measured.

    The result is empty for a body whose acceleration pins are not joined.
    """
    directions = part.type.pin_directions(part, scene)
    accelerations = {}
    for terminal in scene.pins(part.name):
        net = scene.get_net(part.name, terminal.name)
        if terminal.domain is ACCELERATION and net != "0":
            accelerations[terminal.name] = net
    if not accelerations:
        return {}
    result = {}
    for pin in _list_moving_pins(part, scene):
        shakes = []
        for source, net in accelerations.items():
            share = _compute_cosine(directions.get(pin), directions.get(source))
            if share is None or abs(share) > PERPENDICULAR_COSINE:
                shakes.append(FrameAcceleration(net, (part.name, source), share))
        result[pin] = AcceleratedFrame(part.name, tuple(shakes))
    return result


def _compute_cosine(a: tuple[float, ...] | None, b: tuple[float, ...] | None) -> float | None:
    """Return the cosine of the angle between two unit vectors, or None if unknown."""
    if a is None or b is None:
        return None
    return float(sum(map(mul, a, b)))


def _list_moving_pins(part: Part, scene: Scene, *, listening: bool = False) -> list[str]:
    """Return the moving pins of a part that are not on ground.

    If ``listening`` is true, the result includes signal inputs for a displacement or a velocity.
    """
    result = []
    for terminal in scene.pins(part.name):
        reads = listening and terminal.unit in MOTION_UNITS and not terminal.signal_out
        if (terminal.can_move or reads) and scene.get_net(part.name, terminal.name) != "0":
            result.append(terminal.name)
    return result


def _set_frame(
    known: dict[str, AcceleratedFrame], net: str, frame: AcceleratedFrame, where: str
) -> None:
    """Store the reference frame of a net in ``known``; reject conflicting frames."""
    if net == "0":
        return
    first = known.setdefault(net, frame)
    if first.node_cosines != frame.node_cosines:
        raise UsageError(
            "this connection joins displacements in different frames of reference",
            where=where,
            got=f"a displacement in {_describe_frame(first)}, and a displacement in "
            f"{_describe_frame(frame)}",
            expected="bodies with the same acceleration along the same axis",
            hint="connect the acceleration pins of both bodies to one source, or separate the "
            "bodies",
        )


def _copy_frame_to_moving_nets(
    part: Part, scene: Scene, known: dict[str, AcceleratedFrame]
) -> None:
    """Copy the frame of one moving net of a part to all moving nets of the part."""
    nets = scene.get_nets(part.name, _list_moving_pins(part, scene))
    frame = next(filter(None, map(known.get, nets)), None)
    if frame is not None:
        for net in nets:
            _set_frame(known, net, frame, part.name)


def _require_one_frame(part: Part, scene: Scene, known: Mapping[str, AcceleratedFrame]) -> None:
    """Reject a part that compares displacements relative to different frames."""
    if part.is_body:
        return
    moving = {scene.nets[key] for key, terminal in scene.terminals.items() if terminal.can_move}
    frames_of_pins: dict[object, str] = {}  # first pin in each frame
    frames = []
    for pin in _list_moving_pins(part, scene, listening=True):
        net = scene.get_net(part.name, pin)
        if net in moving:
            frame = known.get(net)
            frames_of_pins.setdefault(frame and frame.node_cosines, f"{part.name}.{pin}")
            frames.append(f"{part.name}.{pin} in {_describe_frame(frame)}")
    if len(frames_of_pins) > 1:
        first, second, *_ = frames_of_pins.values()
        raise UsageError(
            "the displacements at the pins of this part have different frames of reference",
            where=part.name,
            got=", ".join(frames),
            expected="pins in one frame; gnd is in every frame",
            hint=f"connect {second} to gnd, or to a part in the same frame as {first}",
        )


def _describe_frame(frame: AcceleratedFrame | None) -> str:
    """Describe a frame in words; ``frame`` is None for the inertial frame of gnd."""
    return (
        "the inertial frame" if frame is None else f"the frame accelerated by {frame.description}"
    )


def _require_acceleration_pin(
    part: Part,
    scene: Scene,
    known: Mapping[str, AcceleratedFrame],
    shaken: Mapping[str, AcceleratedFrame],
) -> None:
    """Reject a part with inertia that has no pin for the acceleration of its frame."""
    if shaken:
        return
    for pin in _list_moving_pins(part, scene):
        frame = known.get(scene.nets[part.name, pin])
        if frame is None or not frame.shakes:
            continue
        if part.is_user_netlist:
            advice = (
                f"in {_describe_frame(frame)}, the netlist must apply the inertial force -m a to "
                "each of its masses"
            )
            warn_user(f"{part.name}.{pin}: {advice}")
        elif pin not in part.type.pins_with_mass(part, scene):
            continue
        elif not part.type.follows_frames:
            got = f"a pin in {_describe_frame(frame)}"
            raise make_ignored_acceleration_error(part, scene, f"{part.name}.{pin}", got)
        elif any(shake.along is None for shake in frame.shakes):
            raise UsageError(
                f"{part.name} moves in an accelerated frame of reference, and the direction of the "
                "acceleration is unknown",
                where=f"{part.name}.{pin}",
                got=f"a pin in {_describe_frame(frame)}",
                expected=f"a stated direction of each port of {frame.body}",
                hint=f"state `axis` or `dof` of the ports of {frame.body}, or include the mass of "
                f"{part.name} in the matrices of {frame.body}",
            )


def make_ignored_acceleration_error(part: Part, scene: Scene, where: str, got: str) -> UsageError:
    """Return the error about a part with inertia that ignores an acceleration."""
    expected = "a part type with an input for the acceleration, such as mass"
    hint = (
        'use part = "mass" with the key `mass`, or drive the body by a force instead of its '
        "acceleration"
    )
    if part.is_body:
        expected = "a body with a port of kind base"
        hint = f"{_advise_on_acceleration_pin(part, scene)} to the same source"
    return UsageError(
        f"{part.name} has inertia and moves with an accelerated frame, but has no input for the "
        "acceleration",
        where=where,
        got=got,
        expected=expected,
        hint=hint,
    )


def _advise_on_acceleration_pin(part: Part, scene: Scene) -> str:
    """Return the text ``connect PIN`` for the acceleration pin that a body has or can have."""
    for terminal in part.type.pins(part, replace(scene, ports="all")):
        if terminal.domain is ACCELERATION:
            return f"connect {part.name}.{terminal.name}"
    return f'add a port of kind "base" to {part.name}, and connect its acceleration pin'


# For each domain: the energy storage of a part, the quantities relative to a pin to which this
# storage applies, and the condition on this pin.
_RESTS = {
    TRANSLATION: ("inertia", "displacements", "does not move"),
    ACOUSTIC: ("compliance", "pressures", "has a constant pressure"),
    THERMAL: ("heat capacity", "temperatures", "has a constant temperature"),
}


def require_constant_pins(scene: Scene) -> None:
    """Reject a varying displacement or pressure at a pin that must be constant.

    A varying temperature causes only a warning, because a slow variation is harmless. In static
    analyses, all pins are constant.

    Raises
    ------
    UsageError : a displacement or pressure varies at a pin where it must be constant.
    """
    if scene.analysis.type in ("op", "dc"):
        return
    for part in scene.parts.values():
        for pin, action in part.type.constant_pins(part, scene).items():
            net, domain = scene.nets[part.name, pin], scene.terminals[part.name, pin].domain
            if domain is None or net == "0" or _is_constant(net, scene):
                continue
            stored, quantities, condition = _RESTS[domain]
            problem = (
                f"the {stored} of {part.name} applies to {quantities} relative to its pin {pin}, "
                f"so the model is valid only if {pin} {condition}"
            )
            if domain.is_relaxing:
                warn_user(": ".join(filter(None, (f"{part.name}.{pin}", problem, action))))
                continue
            where, target = _find_join(part, pin, scene)
            hint = suggest_ground(where, action)
            raise UsageError(problem, where=where, got=target, expected=GROUND, hint=hint)


def suggest_ground(where: str, advice: str) -> SetKey:
    """Suggest ground for the pin at a dotted key, with advice for a moving pin."""
    table, _, key = where.rpartition(".")
    return SetKey(table, key, f'"{GROUND}"', place="", end=advice and f"; {advice}")


def _is_constant(net: str, scene: Scene) -> bool:
    """Return whether a constant ideal source holds a net relative to ground."""
    for name, record in scene.records.items():
        part, frequency = record.part, record.highest_frequency
        ends = [set(scene.get_nets(name, pair)) for pair in record.rest.ideal]
        if {net, "0"} not in ends:
            continue
        if scene.analysis.is_small_signal:
            return not part.type.has_ac_source(part, scene)
        return frequency is not None and frequency(0.0) == 0
    return False


def _find_join(part: Part, pin: str, scene: Scene) -> tuple[str, str]:
    """Return the dotted key that joins a pin to another pin, and the target as typed."""
    if pin in part.pins:
        return f"{part.name}.pins.{pin}", part.pins[pin]
    target = f"{part.name}.{pin}"
    for other in scene.parts.values():
        for end, joined in other.pins.items():
            if joined == target:
                return f"{other.name}.pins.{end}", target
    return target, ", ".join(map(".".join, scene.list_joined_pins(part.name, pin)))


def describe_frames(scene: Scene) -> Iterator[str]:
    """Yield lines of text that describe the reference frames of displacements.

    The command ``explain`` prints the lines.
    """
    nets: dict[str, list[str]] = {}
    for (part, pin), net in scene.nets.items():
        end = scene.terminals[part, pin]
        if net != "0" and (end.can_move or (net in nets and end.unit in MOTION_UNITS)):
            nets.setdefault(net, []).append(f"{part}.{pin}")
    relative = {scene.nets[pin]: frame for pin, frame in scene.frames.items()}
    if nets and not relative:
        yield "Displacements are measured from gnd, which is at rest."
    for net, pins in nets.items() if relative else ():
        frame = relative.get(net)
        if frame is None:
            yield f"{', '.join(pins)}: absolute"
        else:
            where = f"relative to gnd, which has the acceleration of {frame.description}"
            yield f"{', '.join(pins)}: {where}"
