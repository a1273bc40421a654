"""From parts and their pins to nets: what is joined, what may be joined, and what must be.

A target is ``"gnd"`` or ``"part.pin"``. All pins that are joined, directly or over others, are one
net; its name in the netlist is that of its first pin in the order of the scene. Every name that a
deck has at its top goes through one allocator, so that no two nets and no two cards share one.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping
from dataclasses import replace
from itertools import chain, combinations
from string import ascii_lowercase
from typing import Any

from kc2spice.core.domains import ELECTRICAL, Domain
from kc2spice.core.errors import UsageError, candidates, did_you_mean, unknown
from kc2spice.scene.frames import frames
from kc2spice.scene.model import GROUND, Build, BuildRecord, Names, Part, PartType, Scene, Terminal
from kc2spice.scene.parttype import current_into
from kc2spice.scene.rows import Rest

Pin = tuple[str, str]
_GROUND: Pin = (GROUND, "")
MOST_NAMED = 5  # pins that an error lists
METER = "meter"  # word of an ammeter's name, behind those of its pin


def composed(scene: Scene) -> Scene:
    """Return the scene with its nets and the reference frame of each net.

    Parts in a shaken frame have additional pins for its acceleration. These pins are joined after
    the frames are found.

    Raises
    ------
    UsageError : an unknown part or pin, pins of one part whose names differ in case only, pins of
        different kinds on one net, a required pin that is not joined, a part whose two pins are
        one, two outputs or a loop of ideal sources on one net, displacements in different frames;
        ``where`` is a dotted key.
    """
    scene = _joined(replace(scene, frames={}, nets={}))
    if known := frames(scene):
        scene = _joined(replace(scene, frames=known))
        scene = replace(scene, frames=frames(scene))  # nodes may be named after the further pins
    return scene


def with_joins(scene: Scene) -> Scene:
    """Return ``scene`` with the targets of pins that follow from the keys of its parts."""
    joins = {name: r.part.type.default_joins(r.part, scene) for name, r in scene.records.items()}
    return replace(scene, joins=joins)


def _joined(scene: Scene) -> Scene:
    """``scene`` with its nets; pins of parts in a frame follow from the nets that it has."""
    scene = with_joins(scene)
    terminals = {
        (part.name, pin.name): pin
        for part in scene.parts.values()
        for pin in part.type.pins(part, scene)
    }
    _told_apart(terminals)
    scene = replace(scene, terminals=terminals)
    union = Groups([_GROUND, *terminals])
    for part in scene.parts.values():
        for pin, target, where in _joins(part, scene):
            other = _target(target, scene, where)
            _same_kind((part.name, pin), other, scene, where)
            union.join((part.name, pin), other)
    groups = union.groups()
    for net in groups:
        _one_kind(net, scene)
    scene = replace(scene, nets=_names(groups, scene))
    rests = {name: r.part.type.at_rest(r.part, scene) for name, r in scene.records.items()}
    records = {name: replace(r, rest=rests[name]) for name, r in scene.records.items()}
    scene = _with_inner_names(replace(scene, records=records))
    _required(scene, {net[0] for net in groups if len(net) == 1})
    _outputs(scene)
    _across_nothing(scene)
    _source_loops(scene)
    _grounded(scene)
    return scene


def _joins(part: Part, scene: Scene) -> Iterator[tuple[str, str, str]]:
    """Pin, target and the key that joins them: the scene's own, then links, then defaults.

    A pin that any part of the scene names is where the scene says, not at its default as well.
    """
    targets = set(chain.from_iterable(other.pins.values() for other in scene.parts.values()))
    pins = {pin for name, pin in scene.terminals if name == part.name}
    for pin, target in part.pins.items():
        where = f"{part.name}.pins.{pin}"
        if pin not in pins:
            raise unknown(f"{part.type.name} has no such pin", pin, sorted(pins), where)
        yield pin, target, where
    links = {k: v for k, v in scene.joins[part.name].items() if k not in part.pins}
    yield from ((pin, target, part.name) for pin, target in links.items())
    for pin in sorted(pins - {*links, *part.pins}):
        default = scene.terminals[part.name, pin].default
        if default is not None and f"{part.name}.{pin}" not in targets:
            yield pin, default, part.name


def _target(target: str, scene: Scene, where: str) -> Pin:
    """The pin that a target names."""
    if target in (GROUND, "0"):
        return _GROUND
    name, dot, pin = target.partition(".")
    if (name, pin) in scene.terminals:
        return (name, pin)
    pins = [f"{name}.{other}" for part, other in scene.terminals if part == name]
    if pins and not dot:
        expected = f"{name} with one of its pins: {candidates(target, pins)}"
    elif pins:
        expected = f"a pin of {name}: {candidates(target, pins)}"
    else:
        listed = candidates(name, scene.parts)
        expected = f"gnd or PART.PIN with a part of the scene: {listed}"
    near = did_you_mean(target, pins) if pins else did_you_mean(name, scene.parts)
    raise UsageError(
        "no such pin to join", where=where, got=repr(target), expected=expected, hint=near
    )


def _same_kind(a: Pin, b: Pin, scene: Scene, where: str) -> None:
    if _GROUND in (a, b):
        return
    first, second = scene.terminals[a], scene.terminals[b]
    if not _compatible(first, second):
        raise UsageError(
            "joins pins of different kinds",
            where=where,
            got=f"{'.'.join(a)} is {first.kind}, {'.'.join(b)} is {second.kind}",
            expected="pins of one kind",
        )


def _compatible(a: Terminal, b: Terminal) -> bool:
    """The same unit, and the same flow unless one only listens."""
    return a.unit == b.unit and (a.flow == b.flow or "-" in (a.flow, b.flow))


def _one_kind(net: list[Pin], scene: Scene) -> None:
    """A signal may listen to two conservative pins only if these fit each other as well."""
    for a, b in combinations(() if _GROUND in net else net, 2):
        _same_kind(a, b, scene, f"{a[0]}.pins.{a[1]}")


def _told_apart(terminals: Mapping[Pin, Terminal]) -> None:
    """No two pins of a part are one to a simulator, which does not tell case apart."""
    spellings: dict[Pin, str] = {}
    for name, pin in terminals:
        first = spellings.setdefault((name, pin.lower()), pin)
        if first != pin:
            raise UsageError(
                "two pins whose names differ in case only",
                where=name,
                got=f"{first} and {pin}",
                expected="names that differ: netlists do not tell case apart",
            )


def _names(groups: list[list[Pin]], scene: Scene) -> dict[Pin, str]:
    names, nets = Names(("0", GROUND)), dict[Pin, str]()
    for group in groups:
        preferred = group[0], "_".join(group[0]).lower()
        nets |= dict.fromkeys(group, "0" if _GROUND in group else names.name(*preferred))
    return {pin: nets[pin] for pin in scene.terminals}


def _with_inner_names(scene: Scene) -> Scene:
    """``scene`` with the names besides those of nets and of cards ``LETTERname``."""
    cards = (f"{letter}{name}" for name in scene.parts for letter in ascii_lowercase)
    free = Names((*scene.nets.values(), *cards))
    names: dict[tuple[str, ...], str] = {}
    for part in scene.parts.values():
        for words in part.type.inner_names(part, scene):
            key = part.name, *words
            names[key] = free.name(key, "_".join(words))
    scene = replace(scene, names=names)
    meters = {
        (part, pin): free.name((METER, part, pin), f"v{part}_{pin}_{METER}".lower())
        for part, pin in _metered(scene)
    }
    return replace(scene, meters=meters)


def metered_pins(part: Part, scene: Scene) -> dict[str, Domain]:
    """Its pins off ground whose flow can be metered, with their domains, in order.

    The flow at a reference pin, such as ``ambient``, is the sum of those at the others where power
    is the flow itself.
    """
    result: dict[str, Domain] = {}
    for pin in scene.pins(part.name):
        domain = pin.domain
        if domain is None or not domain.metered or scene.net(part.name, pin.name) == "0":
            continue
        if domain.power != "through" or pin.name != domain.reference:
            result[pin.name] = domain
    return result


def powered_pins(part: Part, scene: Scene) -> dict[str, Domain]:
    """Its pins by which power enters in one domain: electrical ones where it has any, otherwise
    those of the domain of its first pin."""
    pins = metered_pins(part, scene)
    domains = [*pins.values()]
    one = ELECTRICAL if ELECTRICAL in domains else next(iter(domains), None)
    return {pin: domain for pin, domain in pins.items() if domain is one}


def _metered(scene: Scene) -> Iterator[tuple[str, str]]:
    """Pins of subcircuits whose flow probes ask for and no neighbour has as a result.

    Probes ask for it by ``PART.power``, by ``PART.PIN.current`` or another flow such as
    ``PART.PIN.force``, and by ``PART.current``, the one of the first pin. ``PART.force`` is a
    result of the part itself.
    """
    for of in dict.fromkeys(probe.of for probe in scene.probes.values()):
        name, _, quantity = of.partition(".")
        part = scene.parts.get(name)
        if part is None or type(part.type).cards is not PartType.cards:
            continue
        powered = powered_pins(part, scene)
        for pin, domain in metered_pins(part, scene).items():
            flow = domain.quantity("through").name
            first = domain is ELECTRICAL and pin == next(iter(powered))
            paired = part.reduced and not domain.reference  # a result of the body
            if (
                (quantity == "power" and pin in powered)
                or quantity in (f"{pin}.power", f"{pin}.{flow}")
                or (first and quantity == flow and not (paired and _is_read(part, pin, scene)))
            ):
                yield name, pin


def _is_read(body: Part, pin: str, scene: Scene) -> bool:
    """Whether a result of the part that is joined to a pin of a body is the current there."""
    build, rest = Build(scene, {}), Rest()
    names = [name for name, _ in scene.joined(body.name, pin) if not scene.parts[name].reduced]
    parts = [scene.parts[name] for name in names]
    records = {part.name: BuildRecord(rest, part.type.vectors(part, build)) for part in parts}
    return current_into(body, pin, replace(build, records=records)) is not None


def _required(scene: Scene, alone: Collection[Pin]) -> None:
    for (name, pin), terminal in scene.terminals.items():
        if terminal.required and (name, pin) in alone:
            raise _not_joined(name, terminal, alone, scene)


def _not_joined(name: str, terminal: Terminal, alone: Collection[Pin], scene: Scene) -> UsageError:
    """The error of a pin that must be joined.

    It suggests a pin that waits for a partner too. Any other pin may have a potential of its own,
    such as that of a bias, which the new joint would short; ground would hold what shall move.
    """
    fitting = [
        end
        for end, other in scene.terminals.items()
        if end[0] != name and _compatible(terminal, other)
    ]
    waiting = [end for end in fitting if end in alone]
    names = list(map(".".join, waiting + [e for e in fitting if e not in waiting]))
    pin, more = terminal.name, "" if len(names) <= MOST_NAMED else ", …"
    if waiting:
        hint = f'add  pins = {{ {pin} = "{names[0]}" }}  to [{name}]'
    elif fitting:
        hint = f'choose where {pin} leads:  pins = {{ {pin} = "PART.PIN" }}  in [{name}]'
    elif terminal.moving:
        hint = f'add a part that {name} moves with, such as [spring] with part = "spring"'
    else:
        hint = f'add  pins = {{ {pin} = "{GROUND}" }}  to [{name}]'
    ground = [] if terminal.moving else [GROUND]
    kind = "an electrical pin" if terminal.domain is ELECTRICAL else f"a pin of {terminal.kind}"
    what = "a pin of displacement" if terminal.moving else kind
    return UsageError(
        f"pin {pin} of {name} is not joined",
        where=f"{name}.pins.{pin}",
        expected=f"{what}: {', '.join([*names[:MOST_NAMED], *ground]) or 'none is here'}{more}",
        hint=hint,
    )


def _outputs(scene: Scene) -> None:
    drivers = {"0": "ground"}
    for (name, pin), terminal in scene.terminals.items():
        net = scene.nets[name, pin]
        if terminal.signal_out and net in drivers:
            got = f"{name}.{pin} and {drivers[net]}"
            where = f"{name}.pins.{pin}"
            message = "two outputs set one net"
            raise UsageError(message, where=where, got=got, expected="one output")
        if terminal.signal_out:
            drivers[net] = f"{name}.{pin}"


def _across_nothing(scene: Scene) -> None:
    """A part of two pins alone does nothing if both are on one net; most often a slip."""
    for part in scene.parts.values():
        pins = [pin for (name, _), pin in scene.terminals.items() if name == part.name]
        if len(pins) != 2 or any(pin.flow == "-" for pin in pins):
            continue
        a, b = pins
        net, other = (scene.nets[part.name, pin.name] for pin in pins)
        if a.kind == b.kind and net == other:
            ends, at = (
                f"{part.name}.{a.name} and {part.name}.{b.name}",
                "gnd" if net == "0" else net,
            )
            raise part.wrong(
                f"pins.{a.name}",
                "both ends are on one net",
                f"{ends} on {at}",
                "two nets",
                f'join one of them elsewhere: pins = {{ {a.name} = "part.pin" }}',
            )


def _source_loops(scene: Scene) -> None:
    """No two ideal sources in parallel, no loop of them: their currents would be undetermined."""
    union = Groups(["0", *scene.nets.values()])
    for part in scene.parts.values():
        for plus, minus in scene.records[part.name].rest.ideal:
            a, b = scene.nets[part.name, plus], scene.nets[part.name, minus]
            if union.together(a, b):
                raise part.wrong(
                    "",
                    "closes a loop of ideal sources",
                    f"{part.name}.{plus} and {part.name}.{minus} are already held apart",
                    "one ideal source between two nets",
                    "put a resistor (or a spring) in between, or drop one source",
                )
            union.join(a, b)


def _grounded(scene: Scene) -> None:
    """Every part is joined to ground, over others if need be: else its potentials are open."""
    union = Groups(["0", *scene.nets.values()])
    first: dict[str, str] = {}
    for (part, _), net in scene.nets.items():
        union.join(first.setdefault(part, net), net)
    free = [pin for pin, net in scene.nets.items() if not union.together(net, "0")]
    if free:
        raise UsageError(
            "nothing of this circuit is on ground",
            where=free[0][0],
            got=", ".join(map(".".join, free)),
            expected='one of these pins at "gnd"',
        )


class Groups:
    """Members that are joined, directly or over others, in the order in which they are given."""

    def __init__(self, members: Iterable[Hashable]) -> None:
        self._of = {member: [member] for member in members}

    def together(self, a: Hashable, b: Hashable) -> bool:
        """Whether both are joined."""
        return self._of[a] is self._of[b]

    def join(self, a: Hashable, b: Hashable) -> None:
        """Join the groups of both."""
        one, two = self._of[a], self._of[b]
        if one is not two:
            one += two
            self._of.update(dict.fromkeys(two, one))

    def groups(self) -> list[list[Any]]:
        """All groups by their first members."""
        result: dict[int, list[Any]] = {}
        for member, group in self._of.items():
            result.setdefault(id(group), []).append(member)
        return list(result.values())


def drawing(scene: Scene) -> tuple[str, ...]:
    """The composition as text: one line for each net with more than one pin."""
    nets: dict[str, list[str]] = {}
    for (part, pin), net in scene.nets.items():
        nets.setdefault(net, []).append(f"{part}.{pin}")
    lines = []
    for net, pins in nets.items():
        if net == "0":
            lines.append("gnd: " + ", ".join(pins))
        elif len(pins) > 1:
            lines.append(" -- ".join(pins))
    return tuple(lines)
