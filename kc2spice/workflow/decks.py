"""From a scene and the models of its parts to a deck: every part is asked, none is known.

A deck of the scene that somebody edited by hand.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

from kc2spice.core.domains import ELECTRICAL, SIGNAL
from kc2spice.core.errors import UsageError
from kc2spice.core.files import list_earlier_files
from kc2spice.core.progress import Clock
from kc2spice.equations.scene_laws import with_laws
from kc2spice.netlist.circuit import Element, Item
from kc2spice.netlist.deck import Command, Deck, Option, ac, dc, transient
from kc2spice.netlist.elements import titled
from kc2spice.netlist.expression import literal, vector
from kc2spice.netlist.include_scan import ANALYSES, HARMLESS, accuracy, checked, refuse
from kc2spice.netlist.library import Header, Subcircuit
from kc2spice.netlist.lint import lint
from kc2spice.netlist.read import Statement, statements, tree_of
from kc2spice.netlist.scope import INCLUDES, Scope, circuit, has_vector
from kc2spice.netlist.spelling import comment, number, tidy
from kc2spice.netlist.transforms import quiet
from kc2spice.scene.axes import MAX_STEP, plan
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


def prepared(
    scene: Scene,
    clock: Clock,
    *,
    trust: bool = False,
    functions: Mapping[str, Any] | None = None,
    edited: Path | None = None,
) -> tuple[Build, Deck]:
    """Models and deck of ``scene``, or the deck ``edited`` by hand; wrong wiring is named with file
    and line before a simulator sees it. ``functions`` are those of controllers, by part.

    Raises as :func:`make_deck` and :func:`edited_deck` do.
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
    """The testbench of a scene with its libraries.

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
    ours = () if scene.solver.max_step else (MAX_STEP,)  # a line of its own says why
    notes = (*header.origin(), *plan_lines(plan(build), ours))
    results = collect_results(build)
    watts = collect_powers(build, results)
    require_probed_results(build)
    parts = tuple(_libraries(build, header))
    noise = noise_analysis.noise_cards(build) if build.noisy else None
    sweep = resolve_dc_sweep(build) if scene.analysis.type == "dc" else None
    sweep_scale = 1.0 if sweep is None else sweep.scale
    reduced = ((part.name, part.reduction) for part in parts)
    reductions = (f"* {name}, rom: {facts.summary}" for name, facts in reduced if facts)
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
        initial=_initial(build, loose),
        controlled=any(_controls(part, scene) for part in scene.parts.values()),
        trusted=build.trust,
        sweep_scale=sweep_scale,
    )
    return noise_analysis.sources(deck, build) if noise else deck


def _controls(part: Part, scene: Scene) -> bool:
    """Whether it measures a motion and sets a voltage or current, which may close a loop."""
    pins = scene.pins(part.name)
    sees = any(p.flow == SIGNAL and p.unit in MOTIONS and not p.signal_out for p in pins)
    acts = any(p.domain is ELECTRICAL and p.default is None for p in pins)
    return sees and acts and not any(p.moving for p in pins)


def _libraries(build: Build, header: Header) -> Iterator[Subcircuit]:
    known: dict[str, tuple[str, Subcircuit]] = {}
    for part in build.scene.parts.values():
        if part.name in build.scene.movers:
            continue
        for result in part.type.subcircuits(part, build, header):
            if build.noisy and not part.netlist:
                meters = part.type.noise
                result = quiet(result, () if isinstance(meters, str) else meters)
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
    scene = build.scene
    for part in scene.parts.values():
        cards = () if part.name in scene.without_cards else part.type.cards(part, build)
        if cards:
            yield from titled(f"{part.name}: {part.type.title}", cards, part.name)
    yield from noise_items
    nets = [group.nets[0] for group in loose if group.nets]
    if scene.analysis.small and nets:
        names = Names(scene.parts)
        inductors = [
            Element.of(f"L{names.name(net, f'{net}_held')}", net, "0", number(HOLD)) for net in nets
        ]
        yield from titled("held at the operating point alone: nothing else does", inductors)


def _options(build: Build) -> Iterable[Option]:
    scene = build.scene
    solver, rows = scene.solver, scene.numerics
    part_options = [
        Option(key, *why) for key, why in chain.from_iterable(row.options.items() for row in rows)
    ]
    if scene.analysis.type != "transient":
        return part_options
    reltol = solver.reltol * min((row.reltol for row in rows), default=1.0)
    chgtol = solver.chgtol * min((row.chgtol for row in rows), default=1.0)
    return [
        Option("reltol", tidy(reltol), "relative error of a time step"),
        Option(
            "trtol",
            number(solver.trtol).removesuffix(".0"),
            "trust the error estimate: take every step it asks for",
        ),
        Option(
            "chgtol",
            tidy(chgtol),
            f"C on 1 uF, thus {1e6 * chgtol:g} um: displacement error of a step",
        ),
        Option("method", solver.method, "rule of integration"),
        Option("acct", "", "print accepted and rejected steps, iterations and time"),
        *part_options,
    ]


def _step_lines(build: Build) -> Iterator[str]:
    """Reason for the largest time step, unless the scene sets it."""
    limit = build.largest
    if limit is not None and not build.scene.solver.max_step:
        yield f"* {comment(f'largest step {limit.step:g} s: {limit.why}')}"


def _command(build: Build, sweep: DcSweep | None) -> Command:
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


def _initial(build: Build, loose: Sequence[FloatingNets]) -> dict[str, float]:
    if build.scene.analysis.type != "transient":
        return {}
    rows = {name: record.settable.items() for name, record in build.records.items()}
    states = {n: {k: v for k, v in row if isinstance(v, float)} for n, row in rows.items()}
    result = {node: value for item in states.values() for node, value in item.items()}
    for group in loose:
        if group.nets and not group.bodies and not any(states[name] for name in group.parts):
            result[group.nets[0]] = 0.0  # dampers alone
    return result


def edited_deck(build: Build, original: Deck, path: Path) -> tuple[Deck, Build]:
    """An edited netlist of the scene with the results of its ``original`` deck, and its build.

    The build has the parameters that parts have in the edited netlist. Parts whose cards are
    others, or joined otherwise, are not judged.

    What it includes from its own directory is written into its place; it is refused if it could
    act on the machine, unless the build is trusted.

    Raises
    ------
    UsageError : no such file, a line that could act on the machine, a card that changes what the
        parts of the deck mean, another analysis than the scene's, vectors that the file no longer
        saves or that nothing in it has.

    Warns of options that are not the scene's: they decide how accurate its results are; and of
    parts that cannot be judged.
    """
    result = checked(path, trust=build.trust)
    cards = list(result.cards(title=True))
    refuse(cards, part=False)
    analyses = [s for s in cards if s.keyword in ANALYSES]
    if [s.keyword for s in analyses] != [f".{original.command.kind}"]:
        raise UsageError(
            "not the scene's analysis",
            where=str(path),
            got=" and ".join(s.written for s in analyses) or "none",
            expected=original.command.card,
            hint=f"write this line into the deck: {original.command.card}",
        )
    saved = {vector(w.lower()) for s in cards if s.keyword == ".save" for w in s.words[1:]}
    missing = [v for v in original.saved if vector(v.lower()) not in saved]
    if saved and vector("all") not in saved and missing:
        raise UsageError(
            "the scene's metrics need vectors that this deck does not save",
            where=str(path),
            got=", ".join(missing),
            expected="these vectors on a line that begins with .save",
            hint="add this line to the deck: .save " + " ".join(missing),
        )
    tree = tree_of(cards)
    _require_results(original, circuit(tree), path)
    _tell_options(original, cards, path)
    words = tuple(analyses[0].words[1:])
    stop = original.stop
    if stop is not None:  # the end of the transient whose card has these words
        stop = literal(words[1], where=analyses[0].where) if len(words) > 1 else None
        if stop is None:
            message, got = "the end of the transient is no number", " ".join(words)
            raise UsageError(message, where=analyses[0].where, got=got)
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
    return deck, _judged_by(build, original, deck, path)


def _judged_by(build: Build, original: Deck, edited: Deck, path: Path) -> Build:
    """Return ``build`` with the parameter values of the ``edited`` deck.

    A part is not checked if its keys cannot express its cards in the edited deck. Prints a warning
    that lists these parts.
    """
    edits, parts = _edits(original, edited), dict(build.scene.parts)
    reasons = {name: why for name, why in edits.items() if name in parts}
    for name, part in build.scene.parts.items():
        before, now = (instance(deck.scope, f"x{name}") for deck in (original, edited))
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
        lines = "; ".join(f"{name}: {why}" for name, why in reasons.items())
        warnings.warn(f"{path}: parts without checks and energy balance: {lines}", stacklevel=2)
    unjudged = build.unjudged | edits.keys() | reasons.keys()
    scene = resolve_again(replace(build.scene, parts=parts))
    result = resolve_build(replace(build, scene=scene, unjudged=frozenset(unjudged)))
    return with_linearised_scene(with_laws(result))


def _edits(original: Deck, edited: Deck) -> dict[str, str]:
    """Parts of the scene whose cards are others in the ``edited`` deck, with the reason: their keys
    no longer say what is there. Also names of cards that it has besides, and of instances joined
    otherwise. Parameters of an instance, and its subcircuit, are none of these."""

    def content(card: Element) -> str:
        """The card without its nodes, and without the parameters of an instance."""
        plain = replace(card, nodes=())
        return element_text(replace(plain, parameters={}) if card.kind == "x" else plain)

    before, now = ({e.key: e for e in deck.scope.elements} for deck in (original, edited))
    owner = {key: card.owner for key, card in before.items() if card.owner}
    result = {}
    for key in before.keys() | now.keys():
        a, b = before.get(key), now.get(key)
        if b is None and a is not None:
            result[owner.get(key, key)] = f"the deck has no card {a.name}"
        elif a is None or b is None or content(a) != content(b):
            result[owner.get(key, key)] = f"its card {(a or b).name} is another one"  # type: ignore[union-attr]
        elif a.ends != b.ends:  # an instance is still the part that its keys tell
            name = key if key.startswith("x") else owner.get(key, key)
            result[name] = f"its card {a.name} is joined otherwise"
    return result


def _require_instances(now: Scope, before: Scope, path: Path) -> None:
    """Refuse a deck that lost the subcircuit of a part and has no new card in its place.

    Raises
    ------
    UsageError : names the card.
    """
    old, new = ({card.key: card for card in scope.elements} for scope in (before, now))
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
    for source in (sources[v.lower()] for v in missing if v.lower() in sources):
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


def _tell_options(original: Deck, cards: Iterable[Statement], path: Path) -> None:
    """Warn of accuracy options that differ from those of the scene's own deck."""
    before, now = (
        {o.key: o.value for o in original.options if o.key not in HARMLESS},
        accuracy(cards),
    )
    pairs = {key: (before.get(key), now.get(key)) for key in [*before, *now]}

    def value(text: str | None) -> float | str | None:
        number = literal(text) if text else None
        return text if number is None else number

    changed = [
        f"{key} = {b or 'default'} ({a or 'default'})"
        for key, (a, b) in pairs.items()
        if value(a) != value(b)
    ]
    if changed:
        options = ", ".join(changed)
        problem = "options differ from those of the scene, which are in brackets"
        warnings.warn(f"{path}: {problem}: {options}", stacklevel=2)


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
            old, new = (
                [item.written for item in statements(known, name) if item.written]
                for known in (text(out / name), files[name])
            )
            if old != new:  # the statements that a simulator reads
                raise UsageError(
                    f"this deck there includes another {name}",
                    where=str(others[key]),
                    got=f"{name} with other cards",
                    hint=f"write to another directory, such as --out {out.name}_2",
                )
