"""Formation of the nets of a scene from joined pins, and checks of the joins.

The target of a pin is ``"gnd"`` or ``"part.pin"``. Pins that are joined directly, or through other
pins, form one net. A net gets the name of its first pin in the order of the scene. One allocator
assigns all names of nodes and cards in a deck, so these names are unique.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import combinations, product
from operator import attrgetter
from string import ascii_lowercase

from kc2spice.core.disjoint_groups import DisjointGroups
from kc2spice.core.domains import ACCELERATION, DISPLACEMENT, ELECTRICAL, QUANTITIES, Domain
from kc2spice.core.errors import UsageError, did_you_mean, list_candidates, unknown
from kc2spice.core.key_actions import Hint, SetKey
from kc2spice.core.user_warnings import warn_user
from kc2spice.scene.part_records import EquilibriumConditions
from kc2spice.scene.parttype import find_current_into
from kc2spice.scene.reference_frames import (
    find_frames,
    make_ignored_acceleration_error,
    require_constant_pins,
    suggest_ground,
)
from kc2spice.scene.scene_classes import (
    GROUND,
    BuiltPartRecord,
    BuiltScene,
    NameAllocator,
    Part,
    Scene,
    Terminal,
    WiredScene,
)

Pin = tuple[str, str]
_GROUND_PIN: Pin = (GROUND, "")
LISTED_PINS = 5  # largest number of pins that an error message lists
METER_SUFFIX = "meter"  # suffix of the names of ammeters


def join_parts(scene: Scene) -> Scene:
    """Join the pins of all parts; return the scene with nets and reference frames.

    Parts in an accelerated frame have additional pins for the acceleration of the frame. The
    additional pins are joined after the frames are determined.

    Raises
    ------
    UsageError : a part or pin is unknown; names of pins of one part differ only in letter case; a
        net contains pins of different kinds or two outputs; or a required pin is not joined. The
        error also occurs if both pins of a part are on one net, ideal sources form a loop, a pin
        that must be at rest can move, or a net is in two reference frames. The ``where`` of the
        error is a dotted key.
    """
    scene = _with_nets(replace(scene, frames={}, nets={}))
    require_constant_pins(scene)
    if frames := find_frames(scene):
        scene = _with_nets(replace(scene, frames=frames))
        # the additional pins may change the names of nodes
        scene = replace(scene, frames=find_frames(scene))
    return scene


def add_default_joins(scene: Scene) -> Scene:
    """Return the scene with the default joins that the keys of its parts imply."""
    joins = {}
    for name, record in scene.records.items():
        joins[name] = record.part.type.default_joins(record.part, scene)
    return replace(scene, joins=joins)


def with_equilibrium_conditions(scene: Scene) -> Scene:
    """Return the scene with the equilibrium conditions of all parts."""
    records = {}
    for name, record in scene.records.items():
        records[name] = replace(
            record, rest=record.part.type.equilibrium_conditions(record.part, scene)
        )
    return replace(scene, records=records)


def _with_nets(scene: Scene) -> Scene:
    """Form all nets of a scene; name its nodes and cards."""
    scene = add_default_joins(scene)
    terminals = {}
    for part in scene.parts.values():
        for terminal in part.type.pins(part, scene):
            terminals[part.name, terminal.name] = terminal
    _require_distinct_pin_names(terminals)
    scene = replace(scene, terminals=terminals)
    union = DisjointGroups([_GROUND_PIN, *terminals])
    for part in scene.parts.values():
        for pin, target, where in _list_joins(part, scene):
            other = _find_target(target, scene, where)
            _require_same_kind((part.name, pin), other, scene, where)
            union.join((part.name, pin), other)
    groups = union.list_groups()
    for net in groups:
        _require_one_kind(net, scene)
    scene = with_equilibrium_conditions(replace(scene, nets=_name_nets(groups, scene)))
    scene = _with_inner_names(scene)
    _require_joined_pins(scene, {net[0] for net in groups if len(net) == 1})
    _require_one_output_per_net(scene)
    _require_pins_on_distinct_nets(scene)
    _reject_source_loops(scene)
    _require_ground(scene)
    return scene


# names in other programs for the first pin and for the second pin of a part with two pins
_FIRST_PIN_NAMES = ("p", "plus", "pos", "positive", "1", "+", "in", "anode", "top", "hot")
_SECOND_PIN_NAMES = (
    "n",
    "m",
    "minus",
    "neg",
    "negative",
    "2",
    "-",
    "cathode",
    "ground",
    "gnd",
    "com",
)


def _suggest_pin(typed: str, pins: Sequence[str]) -> str | None:
    """Suggest a pin for a name that other programs use, such as ``anode``."""
    if len(pins) >= 2:
        for names, pin in ((_FIRST_PIN_NAMES, pins[0]), (_SECOND_PIN_NAMES, pins[1])):
            if typed.lower() in names:
                return f"write {pin} in place of {typed}"
    return None


def _list_joins(part: Part, scene: Scene) -> Iterator[tuple[str, str, str]]:
    """Yield each join of a part: pin, target pin or ground, and dotted key.

    Joins in the table ``pins`` come first, then joins that keys imply, then default joins. A pin
    that another part names as a target has no default join.
    """
    names = set(map(attrgetter("name"), scene.pins(part.name)))
    for pin, target in part.pins.items():
        where = f"{part.name}.pins.{pin}"
        if pin not in names:
            advice = _suggest_pin(pin, [terminal.name for terminal in scene.pins(part.name)])
            raise unknown(
                f"{part.type.name} has no such pin", pin, sorted(names), where, advice=advice
            )
        yield pin, target, where
    joins = scene.joins[part.name]
    for pin, target in joins.items():
        if pin not in part.pins:
            yield pin, target, part.name
    for pin in sorted(names - joins.keys() - part.pins.keys()):
        default = scene.terminals[part.name, pin].default
        if default is not None and not scene.is_target(part.name, pin):
            yield pin, default, part.name


def _find_target(target: str, scene: Scene, where: str) -> Pin:
    """Parse a join target such as ``part.pin`` into a pin; reject an unknown target."""
    if target in (GROUND, "0"):
        return _GROUND_PIN
    name, dot, pin = target.partition(".")
    if where == f"{name}.pins.{pin}":
        others = [".".join(item) for item in scene.terminals if item[0] != name]
        raise UsageError(
            "this pin is joined to itself",
            where=where,
            got=repr(target),
            expected=f"gnd, or a pin of another part: {list_candidates(target, others)}",
            hint=f'for example  {pin} = "{others[0] if others else GROUND}"',
        )
    if (name, pin) in scene.terminals:
        return (name, pin)
    pins = [f"{name}.{terminal.name}" for terminal in scene.pins(name)]
    if pins and not dot:
        expected = f"{name} with one of its pins: {list_candidates(target, pins)}"
    elif pins:
        expected = f"a pin of {name}: {list_candidates(target, pins)}"
    else:
        listed = list_candidates(name, scene.parts)
        expected = f"gnd or PART.PIN with a part of the scene: {listed}"
    existing = [f"{part}.{pin}" for part in scene.parts if (part, pin) in scene.terminals]
    near = None
    if pins:
        near = did_you_mean(target, pins) if dot else None
    elif (near := did_you_mean(name, scene.parts)) is not None:
        similar = next((full for full in existing if repr(full.partition(".")[0]) in near), None)
        near = f"did you mean {similar!r}?" if similar else near
    advice = near or f"for example  {pins[0] if pins else existing[0] if existing else GROUND}"
    raise UsageError(
        "this pin does not exist", where=where, got=repr(target), expected=expected, hint=advice
    )


def _require_same_kind(a: Pin, b: Pin, scene: Scene, where: str) -> None:
    """Reject a join of two pins of different kinds."""
    if _GROUND_PIN in (a, b):
        return
    first, second = scene.terminals[a], scene.terminals[b]
    if not first.fits(second):
        _require_input_for_acceleration(a, b, scene, where)
        _require_input_for_acceleration(b, a, scene, where)
        choices = _list_targets(a, scene)
        pins = [choice for choice in choices if choice != GROUND]
        hint: Hint = (
            _advise_on_pin_at_rest(a, b, scene, where)
            or _suggest_kind(a[0], first, second)
            or _suggest_motion(a, b, scene)
            or _suggest_target(a, choices, scene)
        )
        name = ".".join(b)
        expected = f"a pin of kind {first.kind}: {list_candidates(name, pins)}"
        if not pins:
            expected = f"no other part of the scene has a pin of kind {first.kind}"
        if GROUND in choices:
            expected = f"{GROUND}{', or' if pins else ';'} {expected}"
        raise UsageError(
            "this connection joins pins of different kinds",
            where=where,
            got=f"{'.'.join(a)} is a pin of kind {first.kind}, {name} is of kind {second.kind}",
            expected=expected,
            hint=hint,
        )


def _require_input_for_acceleration(pin: Pin, other: Pin, scene: Scene, where: str) -> None:
    """Reject an acceleration at the reference pin of a part that ignores it."""
    part, terminal = scene.parts[pin[0]], scene.terminals[pin]
    if part.is_body or part.type.follows_frames or not terminal.can_move:
        return
    advice = part.type.constant_pins(part, scene).get(terminal.name)
    if advice == "" and scene.terminals[other].domain is ACCELERATION:
        got = f"{'.'.join(other)}, a pin of kind {scene.terminals[other].kind}"
        raise make_ignored_acceleration_error(part, scene, where, got)


def _advise_on_pin_at_rest(a: Pin, b: Pin, scene: Scene, where: str) -> Hint | None:
    """Return advice for a join of ``a`` to ``b`` if one of the pins must be at rest."""
    part, source = scene.parts[b[0]], scene.terminals[a].kind_key
    advice = part.type.constant_pins(part, scene).get(b[1])
    if advice and source:
        return advice
    part = scene.parts[a[0]]
    advice = part.type.constant_pins(part, scene).get(a[1])
    stated = a[1] in part.pins and where == f"{part.name}.pins.{a[1]}"
    return suggest_ground(where, advice) if stated and advice is not None else None


def _list_targets(pin: Pin, scene: Scene) -> list[str]:
    """List the pins, and ground, to which a pin can be joined without a short circuit."""
    first, shorting = scene.terminals[pin], _list_shorting_pins(pin, scene)
    result = []
    for end, terminal in [*scene.terminals.items(), *_list_optional_pins(scene)]:
        if end[0] != pin[0] and end not in shorting and first.fits(terminal):
            result.append(".".join(end))
    return result if _GROUND_PIN in shorting else [*result, GROUND]


def _list_shorting_pins(pin: Pin, scene: Scene) -> set[Pin]:
    """List the pins on the nets of all other pins of the same part and kind."""
    union = DisjointGroups([_GROUND_PIN, *scene.terminals])
    for part in scene.parts.values():
        with suppress(UsageError):  # another join is also wrong
            for name, target, where in _list_joins(part, scene):
                if (part.name, name) != pin:
                    union.join((part.name, name), _find_target(target, scene, where))
    first = scene.terminals[pin]
    result = set[Pin]()
    for group in union.list_groups():
        ends = (end for end in group if end[0] == pin[0] and end != pin)
        if any(first.fits(scene.terminals[end]) for end in ends):
            result.update(group)
    return result


def _list_optional_pins(scene: Scene) -> Iterator[tuple[Pin, Terminal]]:
    """Yield the pins that the parts of a scene lack, because the scene does not join them.

    A pin also counts as missing if its units would change as soon as the scene joins it.
    """
    every = replace(scene, ports="all")
    for part in scene.parts.values():
        added = [pin for pin, key in part.type.optional_pins.items() if key == f"pins.{pin}"]
        names = dict.fromkeys([*_compute_pins(part, every), *added])
        for name in names:
            joined = replace(part, pins={name: GROUND, **part.pins})
            terminal = _compute_pins(joined, every).get(name)
            present = scene.terminals.get((part.name, name))
            if terminal is not None and (present is None or not terminal.fits(present)):
                yield (part.name, name), terminal


def _compute_pins(part: Part, scene: Scene) -> dict[str, Terminal]:
    """Return the pins of a part, keyed by name; no pins if the part has an error."""
    with suppress(UsageError):
        return {terminal.name: terminal for terminal in part.type.pins(part, scene)}
    return {}


def _suggest_kind(part: str, terminal: Terminal, other: Terminal) -> SetKey | None:
    """Suggest a kind for a pin, so that the pin has the same units as another pin."""
    units = other.unit, other.flow
    kinds = [name for name, (domain, _) in QUANTITIES.items() if domain.units == units]
    if not terminal.kind_key or not kinds:
        return None
    # a source of acceleration prescribes a motion, so its new kind is a displacement
    kind = kinds[0 if terminal.domain is ACCELERATION else -1]
    return SetKey(part, terminal.kind_key, f'"{kind}"', end=", with values in its unit")


def _suggest_motion(pin: Pin, source: Pin, scene: Scene) -> Hint | None:
    """Suggest a kind of motion for a source that is joined to a pin of another motion.

    If the source also accelerates a body, the kind of the source remains, because ground is at rest
    relative to the body.
    """
    first, second = scene.terminals[pin], scene.terminals[source]
    moved = first.can_move and second.domain is ACCELERATION
    if not (moved or first.domain is ACCELERATION):
        return None
    body = _find_accelerated_part(source, scene) if moved else None
    if body is not None and second.kind_key:
        return (
            f'write  {pin[1]} = "{GROUND}"  if {pin[0]} moves with {body}, otherwise connect '
            f"{pin[0]}.{pin[1]} to another source of kind {DISPLACEMENT.name}"
        )
    return _suggest_kind(source[0], second, first)


def _find_accelerated_part(source: Pin, scene: Scene) -> str | None:
    """Return the name of a part with an acceleration pin that is joined to a source."""
    for (name, pin), terminal in scene.terminals.items():
        if name != source[0] and terminal.domain is ACCELERATION:
            targets = scene.parts[name].pins.get(pin), scene.parts[source[0]].pins.get(source[1])
            if targets[0] == ".".join(source) or targets[1] == f"{name}.{pin}":
                return name
    return None


def _suggest_target(pin: Pin, choices: Sequence[str], scene: Scene) -> str:
    """Suggest one of ``choices`` as the target of a pin, or a new part without choices.

    If the other pin of a part with two pins is joined, ground is suggested.
    """
    name, end = pin
    others = [other for part, other in scene.terminals if part == name and other != end]
    joined = len(others) == 1 and (
        others[0] in scene.parts[name].pins or scene.is_target(name, others[0])
    )
    if choices:
        target = GROUND if joined and GROUND in choices else choices[0]
        return f'write  {end} = "{target}"'
    terminal = scene.terminals[pin]
    if terminal.can_move:
        return (
            f'write  {end} = "{name}_spring.a"  and add [{name}_spring] with part = "spring", '
            'stiffness = "1 kN/m"'
        )
    if terminal.kind_key:
        return f"delete [{name}], or add a part with a pin of kind {terminal.kind} and connect it"
    kind = f', kind = "{terminal.domain.across.name}"' if terminal.domain else ""
    return f'write  {end} = "{name}_source.out"  and add [{name}_source] with part = "source"{kind}'


def _require_one_kind(net: list[Pin], scene: Scene) -> None:
    """Reject a net that contains two pins of incompatible kinds.

    A signal pin on a net may be compatible with two pins that are not compatible with each other.
    """
    for a, b in combinations(() if _GROUND_PIN in net else net, 2):
        _require_same_kind(a, b, scene, f"{a[0]}.pins.{a[1]}")


def _require_distinct_pin_names(terminals: Mapping[Pin, Terminal]) -> None:
    """Reject two pins of a part whose names differ only in letter case."""
    spellings: dict[Pin, str] = {}
    for name, pin in terminals:
        first = spellings.setdefault((name, pin.lower()), pin)
        if first != pin:
            raise UsageError(
                "the names of two pins differ in letter case only",
                where=name,
                got=f"{first} and {pin}",
                expected="names that differ in more than letter case",
                hint=f"rename the pin {pin}",
            )


def _name_nets(groups: list[list[Pin]], scene: Scene) -> dict[Pin, str]:
    """Name each net after its first pin, and return the net name of each pin."""
    names, nets = NameAllocator(("0", GROUND)), dict[Pin, str]()
    for group in groups:
        preferred = group[0], "_".join(group[0]).lower()
        nets |= dict.fromkeys(
            group, "0" if _GROUND_PIN in group else names.allocate_name(*preferred)
        )
    return {pin: nets[pin] for pin in scene.terminals}


def _with_inner_names(scene: Scene) -> Scene:
    """Return a scene with names for its ammeters, internal nodes and extra cards.

    Each name occurs only once in the deck.
    """
    cards = map("".join, product(ascii_lowercase, scene.parts))
    free = NameAllocator((*scene.nets.values(), *cards))
    names: dict[tuple[str, ...], str] = {}
    for part in scene.parts.values():
        for words in part.type.list_inner_names(part, scene):
            key = part.name, *words
            names[key] = free.allocate_name(key, "_".join(words))
    scene = replace(scene, names=names)
    meters = {}
    for name, pin in _list_metered_pins(scene):
        preferred = f"v{name}_{pin}_{METER_SUFFIX}".lower()
        meters[name, pin] = free.allocate_name((METER_SUFFIX, name, pin), preferred)
    return replace(scene, meters=meters)


def list_metered_pins(part: Part, scene: Scene) -> dict[str, Domain]:
    """Return the pins of a part at which a flow can be measured, with their domains.

    Electrical pins on ground are excluded, and pins that are on ground by default. A displacement
    pin that the scene joins to ground is included, because its flow is the reaction force of the
    wall. If the flow of a domain is a power, the reference pin, such as
    ``ambient``, is also excluded. The flow out of a reference pin is the sum of the flows into all
    other pins of the part.
    """
    result: dict[str, Domain] = {}
    for pin in scene.pins(part.name):
        domain = pin.domain
        if domain is None or not domain.can_be_metered:
            continue
        on_wall = domain.reference not in ("", pin.name) and pin.default != GROUND
        if scene.get_net(part.name, pin.name) == "0" and not on_wall:
            continue
        if domain.power != "through" or pin.name != domain.reference:
            result[pin.name] = domain
    return result


def list_power_input_pins(part: Part, scene: Scene) -> dict[str, Domain]:
    """Return the pins through which power enters a part, with their common domain.

    For a part with electrical pins, the domain is electrical. For all other parts, the domain of
    the first pin is used.
    """
    pins = {
        pin: domain
        for pin, domain in list_metered_pins(part, scene).items()
        if scene.get_net(part.name, pin) != "0"
    }
    domains = [*pins.values()]
    powered = ELECTRICAL if ELECTRICAL in domains else next(iter(domains), None)
    return {pin: domain for pin, domain in pins.items() if domain is powered}


def _list_metered_pins(scene: Scene) -> Iterator[Pin]:
    """Yield the pins of subcircuits at which a probe needs an ammeter.

    A probe of ``PART.power`` needs ammeters at all pins of :func:`list_power_input_pins`. A probe
    of ``PART.PIN.current``, or of another flow such as ``PART.PIN.force``, needs an ammeter at the
    pin. A probe of ``PART.current`` needs an ammeter at the first pin. A probe of ``PART.force``
    needs no ammeter, because parts compute this result.
    """
    for of in scene.probed_results:
        name, _, quantity = of.partition(".")
        part = scene.parts.get(name)
        if part is None or not scene.has_subcircuit(part):
            continue
        powered = list_power_input_pins(part, scene)
        for pin, domain in list_metered_pins(part, scene).items():
            flow = domain.through_variable.name
            first = domain is ELECTRICAL and pin == next(iter(powered))
            moves = scene.get_net(name, pin) != "0"
            # the current of a body may be known from the other part at the pin, without an ammeter
            paired = part.is_body and not domain.reference
            if (
                (quantity == "power" and pin in powered)
                or quantity == f"{pin}.{flow}"
                or (moves and quantity == f"{pin}.power")
                or (
                    first
                    and quantity == flow
                    and not (paired and _reports_pin_current(part, pin, scene))
                )
            ):
                yield name, pin


def _reports_pin_current(body: Part, pin: str, scene: Scene) -> bool:
    """Return whether a single part is joined to a body's pin and reports its current."""
    build = BuiltScene(scene, {})
    records = {}
    for name, _ in scene.list_joined_pins(body.name, pin):
        part = scene.parts[name]
        if not part.is_body:
            records[name] = BuiltPartRecord(EquilibriumConditions(), part.type.vectors(part, build))
    return find_current_into(body, pin, replace(build, records=records)) is not None


def _require_joined_pins(scene: Scene, alone: Collection[Pin]) -> None:
    """Reject a scene with a required pin that is not joined."""
    for (name, pin), terminal in scene.terminals.items():
        if terminal.required and (name, pin) in alone:
            raise _make_unjoined_error(name, terminal, alone, scene)


def _make_unjoined_error(
    name: str, terminal: Terminal, alone: Collection[Pin], scene: Scene
) -> UsageError:
    """Return the error about a required pin that is not joined.

    If possible, the hint names a target pin that is also not joined. Such a pin may exist only if
    the scene joins it, such as a port of a body. A connection to a pin that is
    already joined could short-circuit a voltage, such as a bias voltage. For a displacement pin,
    the error does not suggest ground, because ground would clamp the motion.
    """
    fitting: list[Pin] = []
    waiting: list[Pin] = []
    shorting = _list_shorting_pins((name, terminal.name), scene)
    for end, other in scene.terminals.items():
        if end[0] != name and end not in shorting and terminal.fits(other):
            (waiting if end in alone else fitting).append(end)
    for end, other in _list_optional_pins(scene):
        if end[0] != name and terminal.fits(other):
            waiting.append(end)
    names = list(map(".".join, waiting + fitting))
    count = LISTED_PINS - (not terminal.can_move)
    pin, more = terminal.name, "" if len(names) <= count else ", …"
    hint: Hint
    if waiting:
        hint = SetKey(name, "pins", f'{{ {pin} = "{names[0]}" }}', verb="add")
    elif fitting:
        hint = f'connect this pin, for example  pins = {{ {pin} = "{names[0]}" }}  in [{name}]'
        # the hint suggests a load resistor, which causes no short circuit
        if terminal.domain is ELECTRICAL:
            hint = (
                f'add a part at this pin, such as [{name}_load] with part = "resistor", '
                f'resistance = "1 MOhm", pins = {{ a = "{name}.{pin}" }}'
            )
    elif terminal.can_move:
        hint = 'add a mechanical part for this pin, such as [spring] with part = "spring"'
    elif _GROUND_PIN not in shorting:
        hint = SetKey(name, "pins", f'{{ {pin} = "{GROUND}" }}', verb="add")
    else:
        hint = _suggest_target((name, pin), [], scene)
    ground = [] if terminal.can_move or _GROUND_PIN in shorting else [GROUND]
    kind = (
        "an electrical pin" if terminal.domain is ELECTRICAL else f"a pin of kind {terminal.kind}"
    )
    pin_kind = "a displacement pin" if terminal.can_move else kind
    listed = ", ".join([*names[:count], *ground])
    return UsageError(
        f"pin {pin} of {name} is not connected",
        where=f"{name}.pins.{pin}",
        expected=f"{pin_kind}: {listed}{more}"
        if listed
        else f"{pin_kind} of another part, which this scene does not have",
        hint=hint,
    )


def _require_one_output_per_net(scene: Scene) -> None:
    """Reject a net with two signal outputs, and a signal output on ground."""
    drivers = {"0": "ground"}
    for (name, pin), terminal in scene.terminals.items():
        net = scene.nets[name, pin]
        if terminal.signal_out and net in drivers:
            raise UsageError(
                "two signal outputs drive the same net",
                where=f"{name}.pins.{pin}",
                got=f"{name}.{pin} and {drivers[net]}",
                expected="one signal output in each net, and none on ground",
                hint=f"connect {name}.{pin} to another net",
            )
        if terminal.signal_out:
            drivers[net] = f"{name}.{pin}"


def _require_pins_on_distinct_nets(scene: Scene) -> None:
    """Reject a two-pin part whose pins are on one net, where the part has no effect."""
    for part in scene.parts.values():
        pins = scene.pins(part.name)
        if len(pins) != 2 or pins[0].kind != pins[1].kind or pins[0].flow == "-":
            continue
        a, b = map(attrgetter("name"), pins)
        net, other = scene.get_nets(part.name, (a, b))
        if net == other:
            targets = {end: _list_targets((part.name, end), scene) for end in (b, a)}
            stated = [end for end in targets if end in part.pins] or [a]
            end = next((end for end in stated if targets[end]), stated[0])
            raise part.wrong(
                f"pins.{end}",
                "both pins of this part are connected to the same net",
                got=f"{part.name}.{a} and {part.name}.{b} on {'gnd' if net == '0' else net}",
                expected="two pins on different nets",
                hint=_suggest_target((part.name, end), targets[end], scene),
            )


def find_short_circuit(part: Part, scene: WiredScene) -> tuple[str, str] | None:
    """Return the two pins of a part's main electrical port if they are on the same net.

    The main port of a body consists of the first two electrical pins of the body. A part that is
    not a body has a main port only if the part has exactly two electrical pins.
    """
    pins = [pin.name for pin in scene.pins(part.name) if pin.domain is ELECTRICAL]
    if len(pins) != 2 and not (part.is_body and len(pins) > 2):
        return None
    net, other = scene.get_nets(part.name, pins[:2])
    return (pins[0], pins[1]) if net == other else None


def warn_of_short_circuits(scene: Scene) -> None:
    """Warn about each part whose main electrical port is short-circuited."""
    for name, part in scene.parts.items():
        pins = None if name in scene.without_cards else find_short_circuit(part, scene)
        if pins is not None:
            net = scene.get_net(name, pins[0])
            target = part.pins.get(pins[0], GROUND if net == "0" else f"the net {net}")
            warn_user(
                f"{name}: both {' and '.join(pins)} are connected to {target}, so {name} is "
                "short-circuited: its voltage is zero, and no source can drive it electrically; "
                f"connect {pins[0]} to another net if the short circuit is not intended"
            )


def _reject_source_loops(scene: Scene) -> None:
    """Reject loops of ideal sources, in which currents have no unique value."""
    union = DisjointGroups(["0", *scene.nets.values()])
    for part in scene.parts.values():
        for plus, minus in scene.records[part.name].rest.ideal:
            a, b = scene.get_nets(part.name, (plus, minus))
            if union.are_joined(a, b):
                raise part.wrong(
                    "",
                    "this ideal source closes a loop of ideal sources",
                    f"{part.name}.{plus} and {part.name}.{minus} are already connected "
                    "by ideal sources",
                    expected="one ideal source between two nets",
                    hint="add a resistor or a spring between the sources, or delete one source",
                )
            union.join(a, b)


def _require_ground(scene: Scene) -> None:
    """Require a ground connection of all parts, so that their potentials are unique."""
    union = DisjointGroups(["0", *scene.nets.values()])
    first: dict[str, str] = {}
    for (part, _), net in scene.nets.items():
        union.join(first.setdefault(part, net), net)
    for name, net in first.items():
        owner = scene.parts[name]
        if not union.are_joined(net, "0") and owner.type.conducts_to_ground(owner, scene):
            union.join(net, "0")
    floating = [pin for pin, net in scene.nets.items() if not union.are_joined(net, "0")]
    if floating:
        name, pin = _choose_ground_pin(floating, scene)
        raise UsageError(
            "no pin of this circuit is connected to ground",
            where=floating[0][0],
            got=", ".join(map(".".join, floating)),
            expected='at least one of these pins connected to "gnd"',
            hint=f'add  {pin} = "{GROUND}"  to the pins of {name}',
        )


def _choose_ground_pin(floating: Sequence[Pin], scene: Scene) -> Pin:
    """Choose the pin that an error suggests to connect to ground.

    A reference pin, such as the pin ``ref`` of a netlist, comes first. Among the pins on the net of
    the reference pin, the function prefers a pin whose target, such as ``gnd``, is not set. A pin
    can have only one target.
    """
    reference = (key for key in floating if scene.terminals[key].default == GROUND)
    chosen = next(reference, floating[-1])
    for key in floating:
        name, pin = key
        has_target = pin in scene.parts[name].pins or pin in scene.joins[name]
        if scene.nets[key] == scene.nets[chosen] and not has_target:
            return key
    return chosen


def describe_nets(scene: Scene) -> tuple[str, ...]:
    """Return one line of text for each net with several pins, and for ground.

    A line begins with the quantity that is equal on all pins of the net, or with ``gnd``.
    """
    nets: dict[str, list[Pin]] = {}
    for end, net in scene.nets.items():
        nets.setdefault(net, []).append(end)
    lines = []
    for net, ends in nets.items():
        pins = ", ".join(map(".".join, ends))
        if net == "0":
            lines.append(f"gnd: {pins}")
        elif len(ends) > 1:
            quantity = scene.terminals[ends[0]].across
            name = "signal" if quantity is None else quantity.name.replace("_", " ")
            lines.append(f"{name}: {pins}")
    return tuple(lines)
