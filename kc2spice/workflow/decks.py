"""Deck of a scene from the models of its parts, and decks that a user edited.

The parts supply their cards, libraries and results by the methods of their types.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from operator import attrgetter
from pathlib import Path
from typing import Any

from kc2spice.core.domains import ELECTRICAL, SIGNAL
from kc2spice.core.errors import UsageError
from kc2spice.core.files import list_earlier_files
from kc2spice.core.progress import Clock
from kc2spice.equations.scene_laws import with_laws
from kc2spice.netlist.circuit import Element, Item
from kc2spice.netlist.deck import Command, Deck, Option, ac, dc, transient
from kc2spice.netlist.elements import add_title
from kc2spice.netlist.expression import Trace, literal, parse_vector
from kc2spice.netlist.include_scan import (
    ANALYSES,
    HARMLESS,
    accuracy_options,
    check_deck_effects,
    read_checked_circuit,
)
from kc2spice.netlist.library import Header, Subcircuit
from kc2spice.netlist.lint import lint
from kc2spice.netlist.read import Statement, statements, tree_of
from kc2spice.netlist.scope import INCLUDES, Scope, circuit, has_vector
from kc2spice.netlist.spelling import comment, number, write_rounded
from kc2spice.netlist.transforms import remove_arithmetic_noise
from kc2spice.scene.axes import MAX_STEP, describe_plan
from kc2spice.scene.frames import MOTIONS
from kc2spice.scene.model import Build, Names, Part, Scene, scene_hash
from kc2spice.scene.plausible import apply_action, check_models
from kc2spice.scene.resolve import resolve_again, resolve_build
from kc2spice.scene.results import (
    DcSweep,
    collect_powers,
    collect_results,
    require_probed_results,
    resolve_dc_sweep,
)
from kc2spice.scene.start_conditions import FloatingNets, find_floating_nets, find_start_errors
from kc2spice.synthesis.header import plan_lines
from kc2spice.workflow import noise_analysis
from kc2spice.workflow.edits import changed, element_text, instance, with_value
from kc2spice.workflow.measures import measures
from kc2spice.workflow.models import build_models
from kc2spice.workflow.time_step import with_linearised_scene

HOLD = 1e30  # H: a constraint at rest, and above 1 uHz less than a millionth of 1 fg


def prepare_deck(
    scene: Scene,
    clock: Clock,
    *,
    trust: bool = False,
    functions: Mapping[str, Any] | None = None,
    edited: Path | None = None,
) -> tuple[Build, Deck]:
    """Return the models and the deck of ``scene``, or its deck ``edited`` by hand.

    Errors of the wiring name file and line before the simulator starts. ``functions`` are those of
    controllers, by part. Raises as :func:`make_deck` and :func:`edited_deck` do.
    """
    require_probed_results(Build(scene, {}, trust=trust, functions=functions or {}))
    build = build_models(scene, clock, trust=trust, functions=functions)
    with clock.stage("export", "netlists"):
        deck = make_deck(build)
        if edited is not None:
            deck, build = edited_deck(build, deck, edited)
        lint(deck)
    return build, deck


def make_deck(build: Build) -> Deck:
    """Return the testbench of a scene with its libraries.

    Raises
    ------
    UsageError : a probe of a vector that no part has, an included file that is missing or could act
        on the machine, two libraries with one name, a dc sweep of a key that no source has, no
        operating point to begin at.
    """
    scene = build.scene
    implausible = apply_action(check_models(build), scene.checks.plausible)
    for problem in chain(find_start_errors(scene, build.rests), implausible):
        raise problem
    loose = find_floating_nets(scene, build.rests)
    header = Header(scene.name, scene_hash(scene))
    ours = () if scene.solver.max_step else (MAX_STEP,)  # a separate line gives the reason
    notes = (*header.origin(), *plan_lines(describe_plan(build), ours))
    results = collect_results(build)
    watts = collect_powers(build, results)
    require_probed_results(build)
    parts = tuple(_libraries(build, header))
    noise = noise_analysis.noise_cards(build) if build.noisy else None
    sweep = resolve_dc_sweep(build) if scene.analysis.type == "dc" else None
    sweep_scale = 1.0 if sweep is None else sweep.scale
    reductions = [f"* {p.name}, rom: {p.reduction.summary}" for p in parts if p.reduction]
    deck = Deck(
        name=scene.name,
        title=f"{scene.name}: {scene.title}",
        notes=(*notes, *reductions, *_step_lines(build)),
        parts=parts,
        items=tuple(_items(build, loose, noise.items if noise else ())),
        options=tuple(_options(build)),
        command=noise.command if noise else _command(build, sweep),
        vectors={name: (v.expression, v.factor) for name, v in results.items()},
        units={name: v.unit for name, v in results.items()} | dict.fromkeys(watts, "W"),
        powers=watts,
        measures=measures(build, results, sweep_scale),
        stop=scene.stop if scene.analysis.type == "transient" else None,
        initial=_initial_values(build, loose),
        controlled=any(_is_controller(part, scene) for part in scene.parts.values()),
        trusted=build.trust,
        sweep_scale=sweep_scale,
    )
    return noise_analysis.sources(deck, build) if noise else deck


def _is_controller(part: Part, scene: Scene) -> bool:
    """Return whether a part measures a motion and sets a voltage or current.

    Such a part may close a control loop.
    """
    measures_motion = sets_output = False
    for pin in scene.pins(part.name):
        if pin.moving:
            return False
        measures_motion |= pin.flow == SIGNAL and pin.unit in MOTIONS and not pin.signal_out
        sets_output |= pin.domain is ELECTRICAL and pin.default is None
    return measures_motion and sets_output


def _libraries(build: Build, header: Header) -> Iterator[Subcircuit]:
    """Yield the different subcircuits of all parts.

    Raises
    ------
    UsageError : two parts write different libraries with the same name.
    """
    known: dict[str, tuple[str, Subcircuit]] = {}
    for part in build.scene.parts.values():
        if part.name in build.scene.movers:
            continue
        for result in part.type.subcircuits(part, build, header):
            if build.noisy and not part.netlist:
                meters = part.type.noise
                result = remove_arithmetic_noise(result, () if isinstance(meters, str) else meters)
            first, same = known.setdefault(result.filename.lower(), (part.name, result))
            if same is result:
                yield result
            elif same.text != result.text:
                raise UsageError(
                    f"{first} and {part.name} write different libraries with the same name",
                    where=part.name,
                    got=result.filename,
                    expected="names that differ",
                    hint=f"rename the file of {part.name} and the subcircuit in it",
                )


def _items(
    build: Build, loose: Sequence[FloatingNets], noise_items: Iterable[Item]
) -> Iterator[Item]:
    """Yield the cards of the parts, of noise sources, and of supports of ``loose`` nets."""
    scene = build.scene
    for part in scene.parts.values():
        cards = () if part.name in scene.without_cards else part.type.cards(part, build)
        if cards:
            yield from add_title(f"{part.name}: {part.type.title}", cards, part.name)
    yield from noise_items
    if not scene.analysis.small:
        return
    names, inductors = Names(scene.parts), []
    for group in loose:
        if group.nets:
            net = group.nets[0]
            name = f"L{names.name(net, f'{net}_held')}"
            inductors.append(Element.of(name, net, "0", number(HOLD)))
    if inductors:
        yield from add_title("held at the operating point alone: nothing else does", inductors)


def _options(build: Build) -> Iterable[Option]:
    """Return the options of a deck: tolerances of a transient, then those of the parts."""
    scene = build.scene
    solver, rows = scene.solver, scene.numerics
    part_options: list[Option] = []
    for row in rows:
        part_options += [Option(key, *why) for key, why in row.options.items()]
    if scene.analysis.type != "transient":
        return part_options
    reltol = solver.reltol * min(map(attrgetter("reltol"), rows), default=1.0)
    chgtol = solver.chgtol * min(map(attrgetter("chgtol"), rows), default=1.0)
    return [
        Option("reltol", write_rounded(reltol), "relative error of a time step"),
        Option(
            "trtol",
            number(solver.trtol).removesuffix(".0"),
            "trust the error estimate: take every step it asks for",
        ),
        Option(
            "chgtol",
            write_rounded(chgtol),
            f"C on 1 uF, thus {1e6 * chgtol:g} um: displacement error of a step",
        ),
        Option("method", solver.method, "rule of integration"),
        Option("acct", "", "print accepted and rejected steps, iterations and time"),
        *part_options,
    ]


def _step_lines(build: Build) -> Iterator[str]:
    """Yield a comment on the largest time step, unless the scene sets it."""
    limit = build.largest
    if limit is not None and not build.scene.solver.max_step:
        yield f"* {comment(f'largest step {limit.step:g} s: {limit.why}')}"


def _command(build: Build, sweep: DcSweep | None) -> Command:
    """Return the command of the analysis; ``sweep`` is that of a dc analysis."""
    scene = build.scene
    selected = scene.analysis
    if selected.type == "transient":
        assert build.largest is not None
        return transient(scene.stop, build.largest.step, uic=bool(scene.initial_states))
    if selected.type == "ac":
        # ngspice returns only the first of two linear points
        points = 3 if (selected.points, selected.scale) == (2, "linear") else selected.points
        return ac(selected.start, float(selected.stop or 0.0), points, selected.scale)
    if sweep is None:
        return Command("op", ())
    values = sweep.values
    return dc(sweep.source, sweep.scale * values[0], sweep.scale * values[-1], values.size)


def _initial_values(build: Build, loose: Sequence[FloatingNets]) -> dict[str, float]:
    """Return the initial values of a transient by node.

    Nets that only dampers join have no other value and begin at 0.
    """
    if build.scene.analysis.type != "transient":
        return {}
    result: dict[str, float] = {}
    with_states = set()
    for name, record in build.records.items():
        states = {node: v for node, v in record.settable.items() if isinstance(v, float)}
        result |= states
        if states:
            with_states.add(name)
    for group in loose:
        if group.nets and not group.bodies and with_states.isdisjoint(group.parts):
            result[group.nets[0]] = 0.0
    return result


def edited_deck(build: Build, original: Deck, path: Path) -> tuple[Deck, Build]:
    """Return an edited netlist with the results of its ``original`` deck, and its build.

    The parts of the build have the parameters of the edited netlist. Parts with other cards or
    connections have no checks. The text of included files replaces their include lines. A netlist
    that could act on the machine is refused, unless the build is trusted.

    Raises
    ------
    UsageError : no such file, a line that could act on the machine, a card that changes what the
        parts of the deck mean, another analysis than the scene's, vectors that the file does not
        save or that nothing in it has.

    Warns of accuracy options that differ from those of the scene, and of parts without checks.
    """
    result = read_checked_circuit(path, trust=build.trust)
    cards = list(result.cards(title=True))
    check_deck_effects(cards, part=False)
    analysis = _require_analysis(original, cards, path)
    _require_saved(original, cards, path)
    tree = tree_of(cards)
    _require_results(original, circuit(tree), path)
    _warn_of_options(original, cards, path)
    words = tuple(analysis.words[1:])
    stop = original.stop
    if stop is not None:  # the end of the transient whose card has these words
        stop = literal(words[1], where=analysis.where) if len(words) > 1 else None
        if stop is None:
            message, got = "the end of the transient is no number", " ".join(words)
            raise UsageError(message, where=analysis.where, got=got)
    deck = replace(
        original,
        text=result.text,
        tree=tree,
        parts=(),
        items=(),
        options=(),
        initial={},
        stop=stop,
        command=Command(original.command.kind, words),
    )
    return deck, _with_edited_parameters(build, original, deck, path)


def _require_analysis(original: Deck, cards: Iterable[Statement], path: Path) -> Statement:
    """Return the card of the analysis in an edited deck.

    Raises
    ------
    UsageError : the deck has another analysis than its ``original``, or several.
    """
    analyses = [card for card in cards if card.keyword in ANALYSES]
    if list(map(attrgetter("keyword"), analyses)) != [f".{original.command.kind}"]:
        raise UsageError(
            "not the scene's analysis",
            where=str(path),
            got=" and ".join(map(attrgetter("written"), analyses)) or "none",
            expected=original.command.card,
            hint=f"write this line into the deck: {original.command.card}",
        )
    return analyses[0]


def _require_saved(original: Deck, cards: Iterable[Statement], path: Path) -> None:
    """Refuse a deck that saves vectors, but not all that the results need.

    Raises
    ------
    UsageError : names the missing vectors.
    """
    saved: set[Trace | None] = set()
    for card in cards:
        if card.keyword == ".save":
            saved.update(map(parse_vector, map(str.lower, card.words[1:])))
    missing = [name for name in original.saved if parse_vector(name.lower()) not in saved]
    if saved and parse_vector("all") not in saved and missing:
        raise UsageError(
            "the scene's metrics need vectors that this deck does not save",
            where=str(path),
            got=", ".join(missing),
            expected="these vectors on a line that begins with .save",
            hint="add this line to the deck: .save " + " ".join(missing),
        )


def _with_edited_parameters(build: Build, original: Deck, edited: Deck, path: Path) -> Build:
    """Return ``build`` with the parameter values of the ``edited`` deck.

    A part is not checked if its keys cannot express its cards in the edited deck. Prints a warning
    that lists these parts.
    """
    edits, parts = _edited_cards(original, edited), dict(build.scene.parts)
    reasons = {name: why for name, why in edits.items() if name in parts}
    for name, part in build.scene.parts.items():
        card = f"x{name}"
        before, now = instance(original.scope, card), instance(edited.scope, card)
        if before is None or now is None or name in reasons:
            continue
        if before.cards != now.cards:
            reasons[name] = f"its subcircuit {now.library.name} has other cards"
        for key, old, new in changed(before, now):
            other = with_value(parts[name], key, old, new)
            if other is None:
                reasons[name] = f"none of its keys is the parameter {key} of {now.library.name}"
            parts[name] = other or part
    if reasons:
        lines = "; ".join(map(": ".join, reasons.items()))
        warnings.warn(f"{path}: parts without checks and energy balance: {lines}", stacklevel=2)
    unjudged = build.unjudged | edits.keys() | reasons.keys()
    scene = resolve_again(replace(build.scene, parts=parts))
    result = resolve_build(replace(build, scene=scene, unjudged=frozenset(unjudged)))
    return with_linearised_scene(with_laws(result))


def _elements_by_key(scope: Scope) -> dict[str, Element]:
    """Return the elements of a circuit by their names in lower case."""
    return {card.key: card for card in scope.elements}


def _element_content(card: Element) -> str:
    """Return a card without its nodes, and without the parameters of an instance."""
    plain = replace(card, nodes=())
    return element_text(replace(plain, parameters={}) if card.kind == "x" else plain)


def _edited_cards(original: Deck, edited: Deck) -> dict[str, str]:
    """Return the parts whose cards differ in the ``edited`` deck, with the reason.

    The keys of these parts no longer describe the deck. Further names are those of new cards and of
    instances with other nodes. Other parameters or subcircuits of an instance do not count.
    """
    before, now = _elements_by_key(original.scope), _elements_by_key(edited.scope)
    result = {}
    for key in before.keys() | now.keys():
        a, b = before.get(key), now.get(key)
        owner = key if a is None else a.owner or key
        if b is None and a is not None:
            result[owner] = f"the deck has no card {a.name}"
        elif a is None or b is None or _element_content(a) != _element_content(b):
            result[owner] = f"its card {(a or b).name} is another one"  # type: ignore[union-attr]
        elif a.ends != b.ends:  # the keys still describe an instance with other nodes
            name = key if key.startswith("x") else owner
            result[name] = f"its card {a.name} is joined otherwise"
    return result


def _require_instances(now: Scope, before: Scope, path: Path) -> None:
    """Refuse a deck that lost the subcircuit of a part and has no new card in its place.

    Raises
    ------
    UsageError : names the card.
    """
    old, new = _elements_by_key(before), _elements_by_key(now)
    if new.keys() - old.keys():
        return  # the reader of the deck must judge the replacement
    for key in old.keys() - new.keys():
        if old[key].kind == "x":
            name = old[key].name
            raise UsageError(
                f"the deck has no card {name}",
                where=str(path),
                expected=f"{name} of the exported deck, or cards that take its place",
                hint=f"copy the line that begins with {name} from a new export",
            )


def _require_results(original: Deck, now: Scope, path: Path) -> None:
    """Refuse a deck without the nodes and devices that results are read from.

    Raises
    ------
    UsageError : names the vectors, and the card that brings back a current.
    """
    before = original.scope
    _require_instances(now, before, path)
    missing = [v for v in original.saved if not has_vector(now, v) and has_vector(before, v)]
    if not missing:
        return
    hints = []
    sources = {f"i({e.key})": e for e in before.elements if e.kind == "v"}
    for name in map(str.lower, missing):
        if name not in sources:
            continue
        source = sources[name]
        node = source.nodes[0]
        hints.append(
            f"a 0 V source of its name reads the current of whatever drives {node}: "
            f"{source.name} {node} NODE 0, with your driver's output at NODE"
        )
    if len(hints) < len(missing):
        hints.append("give renamed nodes and devices their old names")
    raise UsageError(
        "the scene's results need nodes or devices that this deck does not have",
        where=str(path),
        got=", ".join(missing),
        expected="nodes and devices of these names",
        hint="; ".join(hints),
    )


def _warn_of_options(original: Deck, cards: Iterable[Statement], path: Path) -> None:
    """Warn of accuracy options that differ from those of the exported deck."""
    before = {item.key: item.value for item in original.options if item.key not in HARMLESS}
    now = accuracy_options(cards)

    def value(text: str | None) -> float | str | None:
        number = literal(text) if text else None
        return text if number is None else number

    different = []
    for key in dict.fromkeys([*before, *now]):
        a, b = before.get(key), now.get(key)
        if value(a) != value(b):
            different.append(f"{key} = {b or 'default'} ({a or 'default'})")
    if different:
        options = ", ".join(different)
        problem = "options differ from those of the scene, which are in brackets"
        warnings.warn(f"{path}: {problem}: {options}", stacklevel=2)


def _card_texts(text: str, name: str) -> list[str]:
    """Return the statements that a simulator reads in the file ``name``."""
    return list(filter(None, map(attrgetter("written"), statements(text, name))))


def spare_other_decks(out: Path, files: Mapping[str, str]) -> None:
    """Refuse to change a library that another deck in ``out`` includes.

    A deck in ``out`` that is not among the ``files`` stays there, and would then simulate another
    part.

    Raises
    ------
    UsageError : another deck in ``out`` uses the library.
    """

    def text(path: Path) -> str:
        return path.read_text(encoding="utf-8", errors="replace")

    others = {path.name: path for path in out.glob("*.cir") if path.is_file()}
    for key in sorted(others.keys() - files.keys() - list_earlier_files(out)):
        for card in statements(text(others[key]), key, title=True):
            name = card.words[-1].strip("\"'") if card.keyword in INCLUDES else ""
            if name not in files or not (out / name).is_file():
                continue
            if _card_texts(text(out / name), name) != _card_texts(files[name], name):
                raise UsageError(
                    f"this deck there includes another {name}",
                    where=str(others[key]),
                    got=f"{name} with other cards",
                    hint=f"write to another directory, such as --out {out.name}_2",
                )
