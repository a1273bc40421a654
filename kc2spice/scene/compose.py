"""From parts and their pins to nets: what is joined, what may be joined, what must be.

A target is ``"gnd"`` or ``"part.pin"``. All pins that are joined, directly or over others, are one
net; its name in the netlist is that of its first pin in the order of the scene. Every name that a
deck has at its top goes through one allocator, so that no two nets and no two cards share one.
"""

from __future__ import annotations

from collections.abc import Collection, Hashable, Iterable, Iterator, Mapping
from dataclasses import replace
from string import ascii_lowercase
from typing import TypeVar

from kc2spice.core.errors import UsageError
from kc2spice.core.words import did_you_mean
from kc2spice.scene.model import GROUND, Part, Scene, Terminal
from kc2spice.scene.parttype import METER, Build, PartType

Pin = tuple[str, str]
Key = TypeVar("Key", bound=Hashable)
_GROUND: Pin = (GROUND, "")


def composed(scene: Scene) -> Scene:
    """``scene`` with its nets.

    Raises
    ------
    UsageError : an unknown part or pin, pins of one part whose names differ in case only, pins of
        different kinds on one net, a required pin that is not joined, a part whose two pins are
        one, two outputs or a loop of ideal sources on one net; ``where`` is a dotted key.
    """
    terminals = {
        (part.name, pin.name): pin
        for part in scene.parts.values()
        for pin in part.type.pins(part, scene)
    }
    _told_apart(terminals)
    union = _Union([_GROUND, *terminals])
    for part in scene.parts.values():
        for pin, target, where in _joins(part, scene, terminals):
            other = _target(target, terminals, where, scene)
            _same_kind((part.name, pin), other, terminals, where)
            union.join((part.name, pin), other)
    for net in union.groups():
        _one_kind(net, terminals)
    nets = _names(union, terminals)
    joined = replace(scene, nets=nets)
    found = replace(joined, own=_own(joined, nets.values()))
    _required(found, terminals, union)
    _outputs(found, terminals)
    _across_nothing(found, terminals)
    _source_loops(found)
    _grounded(found)
    return found


def _joins(
    part: Part, scene: Scene, terminals: Mapping[Pin, Terminal]
) -> Iterator[tuple[str, str, str]]:
    """Pin, target and the key that says so: the scene's own, then links, then defaults.

    A pin that any part of the scene names is where the scene says, not at its default as well.
    """
    named = {target for other in scene.parts.values() for target in other.pins.values()}
    own = {pin for name, pin in terminals if name == part.name}
    for pin, target in part.pins.items():
        where = f"{part.name}.pins.{pin}"
        if pin not in own:
            raise UsageError(
                f"{part.type.name} has no such pin",
                where=where,
                got=repr(pin),
                expected="one of " + ", ".join(sorted(own)),
                hint=did_you_mean(pin, own),
            )
        yield pin, target, where
    links = {k: v for k, v in part.type.links(part, scene).items() if k not in part.pins}
    yield from ((pin, target, part.name) for pin, target in links.items())
    for pin in sorted(own - {*links, *part.pins}):
        default = terminals[part.name, pin].default
        if default is not None and f"{part.name}.{pin}" not in named:
            yield pin, default, part.name


def _target(target: str, terminals: Mapping[Pin, Terminal], where: str, scene: Scene) -> Pin:
    """The pin that a target names."""
    if target in (GROUND, "0"):
        return _GROUND
    name, dot, pin = target.partition(".")
    if (name, pin) in terminals:
        return (name, pin)
    pins = [other for part, other in terminals if part == name]
    if pins and not dot:
        expected = f"{name} with one of its pins: " + ", ".join(f"{name}.{p}" for p in pins)
    elif pins:
        expected = f"a pin of {name}: " + ", ".join(pins)
    else:
        expected = "gnd or PART.PIN with a part of the scene: " + ", ".join(scene.parts)
    near = did_you_mean(pin, pins) if pins else did_you_mean(name, scene.parts)
    raise UsageError(
        "no such pin to join", where=where, got=repr(target), expected=expected, hint=near
    )


def _same_kind(a: Pin, b: Pin, terminals: Mapping[Pin, Terminal], where: str) -> None:
    if _GROUND in (a, b):
        return
    first, second = terminals[a], terminals[b]
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


def _one_kind(net: list[Pin], terminals: Mapping[Pin, Terminal]) -> None:
    """A signal may listen to two conservative pins only if these fit each other as well."""
    if _GROUND in net:
        return
    for a, b in ((x, y) for k, x in enumerate(net) for y in net[k + 1 :]):
        _same_kind(a, b, terminals, f"{a[0]}.pins.{a[1]}")


def _told_apart(terminals: Mapping[Pin, Terminal]) -> None:
    """No two pins of a part are one to a simulator, which does not tell case apart."""
    seen: dict[Pin, str] = {}
    for name, pin in terminals:
        first = seen.setdefault((name, pin.lower()), pin)
        if first != pin:
            raise UsageError(
                "two pins whose names differ in case only",
                where=name,
                got=f"{first} and {pin}",
                expected="names that differ: netlists do not tell case apart",
            )


def _names(union: _Union, terminals: Mapping[Pin, Terminal]) -> dict[Pin, str]:
    groups = union.groups()
    plain = [("_".join(group[0]).lower(), group[0]) for group in groups if _GROUND not in group]
    names = allocated(((first, name) for name, first in plain), ("0", GROUND))
    nets = {pin: names.get(group[0], "0") for group in groups for pin in group}
    return {pin: nets[pin] for pin in terminals}


def _own(scene: Scene, nets: Iterable[str]) -> dict[tuple[str, ...], str]:
    """Names of nodes and cards that parts have besides their pins and ``LETTERname``."""
    cards = (f"{letter}{name.lower()}" for name in scene.parts for letter in ascii_lowercase)
    wanted = (
        ((part.name, *words), "_".join(words))
        for part in scene.parts.values()
        for words in part.type.own_names(part, scene)
    )
    meters = (
        ((part, pin, METER), f"v{part}_{pin}_{METER}".lower())
        for part, pin in dict.fromkeys(metered(scene))
    )
    return allocated((*wanted, *meters), {*nets, *cards})


def electrical(part: Part, scene: Scene) -> tuple[str, ...]:
    """Its pins that carry a current and are not on ground."""
    pins = (pin for pin in part.type.pins(part, scene) if (pin.unit, pin.flow) == ("V", "A"))
    return tuple(pin.name for pin in pins if scene.nets[part.name, pin.name] != "0")


def metered(scene: Scene) -> Iterator[tuple[str, str]]:
    """Pins of subcircuits whose current probes ask for by ``PART.current``, that of the first pin,
    ``PART.PIN.current`` or ``PART.power``, where no neighbour tells it."""
    for of in dict.fromkeys(probe.of for probe in scene.probes.values()):
        name, _, asked = of.partition(".")
        part = scene.parts.get(name)
        if part is None or type(part.type).cards is not PartType.cards:
            continue
        pins = electrical(part, scene)
        for pin in pins:
            if asked == "power" or (
                asked in (f"{pin}.current", "current" if pin == pins[0] else "")
                and not _told(part, pin, scene)
            ):
                yield name, pin


def _told(part: Part, pin: str, scene: Scene) -> bool:
    """Whether the one part at this pin of a body tells what goes into it."""
    joined = scene.joined(part.name, pin) if part.type.reduced else ()
    others = [(scene.parts[name], end) for name, end in joined]
    return len(others) == 1 and others[0][0].type.current(*others[0], Build(scene, {})) is not None


def allocated(wanted: Iterable[tuple[Key, str]], taken: Collection[str]) -> dict[Key, str]:
    """A name for each key, the wanted one unless it is taken; case does not tell names apart."""
    used = set(taken)
    found: dict[Key, str] = {}
    for key, name in wanted:
        free, count = name, 1
        while free.lower() in used:
            count += 1
            free = f"{name}_{count}"
        used.add(free.lower())
        found[key] = free
    return found


def _required(scene: Scene, terminals: Mapping[Pin, Terminal], union: _Union) -> None:
    alone = {group[0] for group in union.groups() if len(group) == 1}
    for (name, pin), terminal in terminals.items():
        if terminal.required and (name, pin) in alone:
            fitting = [
                f"{n}.{p}"
                for (n, p), other in terminals.items()
                if n != name and _compatible(terminal, other)
            ]
            raise UsageError(
                f"pin {pin} of {name} is not joined",
                where=f"{name}.pins.{pin}",
                expected="gnd or one of " + ", ".join(fitting) if fitting else "gnd",
                hint=f'add  pins = {{ {pin} = "{fitting[0] if fitting else GROUND}" }}  '
                f"to [{name}]",
            )


def _outputs(scene: Scene, terminals: Mapping[Pin, Terminal]) -> None:
    taken: dict[str, Pin] = {}
    for pin, terminal in terminals.items():
        if not terminal.signal_out:
            continue
        net = scene.nets[pin]
        if net == "0" or net in taken:
            other = "ground" if net == "0" else ".".join(taken[net])
            raise UsageError(
                "two outputs set one net",
                where=f"{pin[0]}.pins.{pin[1]}",
                got=f"{'.'.join(pin)} and {other}",
                expected="one output",
            )
        taken[net] = pin


def _across_nothing(scene: Scene, terminals: Mapping[Pin, Terminal]) -> None:
    """A part of two pins alone does nothing if both are on one net; most often a slip."""
    for name in scene.parts:
        pins = [(pin, terminal) for (part, pin), terminal in terminals.items() if part == name]
        if len(pins) != 2 or any(terminal.flow == "-" for _, terminal in pins):
            continue
        (first, a), (second, b) = pins
        net = scene.nets[name, first]
        if a.kind == b.kind and net == scene.nets[name, second]:
            raise UsageError(
                "both ends are on one net",
                where=f"{name}.pins.{first}",
                got=f"{name}.{first} and {name}.{second} on {'gnd' if net == '0' else net}",
                expected="two nets",
                hint=f'join one of them elsewhere: pins = {{ {first} = "part.pin" }}',
            )


def _source_loops(scene: Scene) -> None:
    """No two ideal sources in parallel, no loop of them: their currents would be undetermined."""
    union = _Union(["0", *scene.nets.values()])
    for part in scene.parts.values():
        for plus, minus in part.type.prescribes(part):
            a, b = scene.nets[part.name, plus], scene.nets[part.name, minus]
            if union.find(a) == union.find(b):
                raise UsageError(
                    "closes a loop of ideal sources",
                    where=part.name,
                    got=f"{part.name}.{plus} and {part.name}.{minus} are already held apart",
                    expected="one ideal source between two nets",
                    hint="put a resistor (or a spring) in between, or drop one source",
                )
            union.join(a, b)


def _grounded(scene: Scene) -> None:
    """Every part is joined to ground, over others if need be: else its potentials are open."""
    first = {part: (part, pin) for part, pin in reversed(list(scene.nets))}
    union = _Union([_GROUND, *scene.nets])
    at: dict[str, Pin] = {"0": _GROUND}
    for pin, net in scene.nets.items():
        union.join(pin, at.setdefault(net, pin))
        union.join(pin, first[pin[0]])
    for part, name in scene.nets:
        if union.find((part, name)) != union.find(_GROUND):
            free = [f"{n}.{p}" for n, p in scene.nets if union.find((n, p)) != union.find(_GROUND)]
            raise UsageError(
                "nothing of this circuit is on ground",
                where=part,
                got=", ".join(free),
                expected='one of these pins at "gnd"',
            )


class _Union:
    """Disjoint sets in the order of their members."""

    def __init__(self, members: list) -> None:
        self._parent = {member: member for member in members}
        self._order = list(dict.fromkeys(members))

    def find(self, x: object) -> object:
        while self._parent[x] != x:
            self._parent[x] = self._parent[self._parent[x]]
            x = self._parent[x]
        return x

    def join(self, a: object, b: object) -> None:
        self._parent[self.find(a)] = self.find(b)

    def groups(self) -> list[list]:
        found: dict[object, list] = {}
        for member in self._order:
            found.setdefault(self.find(member), []).append(member)
        return list(found.values())


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
