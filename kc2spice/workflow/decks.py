"""From a scene and the models of its parts to a deck: every part is asked, none is known."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain
from pathlib import Path

from kc2spice.core.errors import UsageError
from kc2spice.core.units import quantity
from kc2spice.core.words import did_you_mean
from kc2spice.netlist.cards import comment, number, tidy
from kc2spice.netlist.circuit import Subcircuit
from kc2spice.netlist.deck import Block, Command, Deck, Option, ac, dc, transient
from kc2spice.netlist.deckwide import ANALYSES, HARMLESS, accuracy, refuse_in_deck
from kc2spice.netlist.expression import Number, parse
from kc2spice.netlist.scan import cards as deck_cards
from kc2spice.netlist.scan import checked_lines, text_of_lines
from kc2spice.netlist.scope import circuit, has_vector
from kc2spice.netlist.statements import Statement
from kc2spice.scene.compose import allocated
from kc2spice.scene.hash import scene_hash
from kc2spice.scene.keys import model_keys
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import Build, Vector, time_scales
from kc2spice.scene.plan import plan
from kc2spice.scene.plausible import built, judged
from kc2spice.scene.rest import free, without_equilibrium
from kc2spice.spice.header import Header, plan_lines
from kc2spice.workflow.meters import meter_vectors, powers

HOLD = 1e30  # H: a constraint at rest, and above 1 uHz less than a millionth of 1 fg


def make_deck(build: Build) -> Deck:
    """The testbench of a scene with its libraries.

    Raises
    ------
    UsageError : a probe of a vector that no part has, an included file that is missing or could act
        on the machine, two libraries with one name, a dc sweep of a key that no source has, no
        operating point to begin at.
    """
    scene = build.scene
    for problem in chain(without_equilibrium(build), judged(built(build), scene.checks.plausible)):
        raise problem
    header = _header(scene)
    parts = tuple(_libraries(build, header))
    results = result_vectors(build)
    watts = powers(build, results)
    for name, probe in scene.probes.items():
        known = {*results, *watts}
        if "." in probe.of and probe.of not in known:  # without a dot: time, frequency
            raise UsageError(
                "no such vector",
                where=f"probes.{name}.of",
                got=repr(probe.of),
                expected="PART.current, PART.PIN.current or PART.power of a part with electrical "
                "pins, or one of " + ", ".join(results),
                hint=did_you_mean(probe.of, known),
            )
    told = "".join(f"\n{line}" for line in _reductions(parts))
    return Deck(
        name=scene.name,
        title=f"{scene.name}: {scene.title}",
        notes=f"{header.origin()}\n{plan_lines(plan(scene))}{told}{_step_line(build)}",
        parts=parts,
        blocks=tuple(_blocks(build)),
        options=tuple(_options(build)),
        command=_command(build),
        vectors={name: (v.expression, v.factor) for name, v in results.items()},
        units={name: v.unit for name, v in results.items()} | dict.fromkeys(watts, "W"),
        stop=scene.stop if scene.analysis.type == "transient" else None,
        initial=_initial(build),
        controlled=any(part.type.controls for part in scene.parts.values()),
    )


def _reductions(parts: Iterable[Subcircuit]) -> Iterator[str]:
    """Order, band and error of every reduced model, in the words of its library."""
    for part in parts:
        head = (line for item in part.circuit.items for line in item.notes)
        told = (line[2:].partition(" (")[0] for line in head if line.startswith("* rom: "))
        yield from (f"* {part.name}, {line}" for line in told)


def edited_deck(build: Build, path: Path) -> Deck:
    """A netlist of the scene that somebody edited, with the results of the scene's own deck.

    What it includes from its own directory is written into its place; it is refused if it could
    act on the machine, unless the build is trusted.

    Raises
    ------
    UsageError : no such file, a line that could act on the machine, a card that changes what the
        parts of the deck mean, another analysis than the scene's, vectors that the file no longer
        saves or that nothing in it has.

    Warns of options that are not the scene's: they decide how accurate its results are.
    """
    own = make_deck(build)
    lines = checked_lines(path, trust=build.trust)
    text, placed = text_of_lines(lines), list(deck_cards(lines, title=True))
    refuse_in_deck(placed)
    cards = [card for card, _ in placed]
    analyses = [s for s in cards if s.keyword in ANALYSES]
    if [s.keyword for s in analyses] != [f".{own.command.kind}"]:
        raise UsageError(
            "not the scene's analysis",
            where=str(path),
            got=" and ".join(s.text for s in analyses) or "none",
            expected=own.command.card,
            hint="one analysis of the same kind; its numbers are free",
        )
    saved = {_plain(w) for s in cards if s.keyword == ".save" for w in s.words[1:]}
    missing = [v for v in own.saved if _plain(v) not in saved]
    if saved and "all" not in saved and missing:
        raise UsageError(
            "the scene's metrics need vectors that this deck does not save",
            where=str(path),
            got=", ".join(missing),
            expected=".save " + " ".join(missing),
            hint="add this line; a node that was renamed needs its old name",
        )
    _require_results(own, text, path)
    _tell_options(own, cards, path)
    (analysis,) = analyses
    words = tuple(analysis.words[1:])
    stop = None if own.stop is None else _seconds(words, analysis.where)
    return replace(
        own,
        text=text,
        parts=(),
        blocks=(),
        options=(),
        initial={},
        stop=stop,
        command=Command(own.command.kind, words),
    )


def edits(build: Build, deck: Deck) -> frozenset[str]:
    """Parts of the scene whose cards are others in the edited ``deck``: their keys no longer
    say what is there. Also names of cards that it has besides, and of instances joined otherwise.
    """
    owner = {
        card.split()[0].lower(): part.name
        for part in build.scene.parts.values()
        for card in part.type.cards(part, build)
    }
    own, now = (
        {e.key: e for e in scope.elements} for scope in (make_deck(build).scope, deck.scope)
    )

    def same(key: str, ends: bool) -> bool:
        a, b = own.get(key), now.get(key)
        if a is None or b is None or (ends and a.ends != b.ends):
            return False
        return (a.model, a.values, a.settings, a.expression) == (
            b.model,
            b.values,
            b.settings,
            b.expression,
        )

    keys = own.keys() | now.keys()
    return frozenset(
        owner.get(key, key) if not same(key, ends=not key.startswith("x")) else key
        for key in keys
        if not same(key, ends=True)
    )


def _require_results(own: Deck, text: str, path: Path) -> None:
    """Refuse a deck without the nodes and devices that results are read from.

    Raises
    ------
    UsageError : names the vectors, and the card that brings back a current.
    """
    now, before = circuit(path.name, {path.name: text}), own.scope
    missing = [v for v in own.saved if not has_vector(now, v) and has_vector(before, v)]
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
        hints.append("nodes and devices that were renamed need their old names")
    raise UsageError(
        "the scene's results are read from what this deck does not have",
        where=str(path),
        got=", ".join(missing),
        expected="nodes and devices of these names",
        hint="; ".join(hints),
    )


def _tell_options(own: Deck, cards: Iterable[Statement], path: Path) -> None:
    """Warn of options that decide the accuracy and are not those of the scene's own deck."""
    before, now = {o.key: o.value for o in own.options if o.key not in HARMLESS}, accuracy(cards)
    changed = [
        f"{key} = {now.get(key, 'default')} ({before.get(key, 'default')})"
        for key in dict.fromkeys([*before, *now])
        if not _same(before.get(key), now.get(key))
    ]
    if changed:
        told = ", ".join(changed)
        warnings.warn(f"{path}: options are not the scene's, in brackets: {told}", stacklevel=2)


def _same(a: str | None, b: str | None) -> bool:
    """Whether two values of an option are one, as text or as a number."""
    try:
        return a == b or float(str(a)) == float(str(b))
    except ValueError:
        return False


def _plain(vector: str) -> str:
    """``v(a)`` as ``a``: a voltage is saved under either name."""
    low = vector.lower().strip("\"'")
    return low[2:-1] if low.startswith("v(") and "," not in low else low


def _seconds(words: tuple[str, ...], where: str) -> float:
    """End of the transient whose card has these words."""
    tree = parse(words[1], where=where) if len(words) > 1 else None
    if not isinstance(tree, Number):
        raise UsageError("the end of the transient is no number", where=where, got=" ".join(words))
    return float(tree.text)


def libraries(scene: Scene) -> dict[str, str]:
    """Name of every part's subcircuit; parts of two types that would share a name get their own."""
    parts = scene.parts
    names = {part.name: part.type.library(part, scene) for part in parts.values()}
    owners: dict[str, set[str]] = {}
    for part, name in names.items():
        owners.setdefault(name.lower(), set()).add(parts[part].type.name)
    users = {part for part in parts if parts[part].type.uses_netlists(parts[part])}
    own = {
        part: (parts[part].type.name, name if len(owners[name.lower()]) == 1 else part)
        for part, name in names.items()
        if part not in users
    }
    found = allocated(
        ((library, library[1]) for library in dict.fromkeys(own.values())),
        {names[part].lower() for part in users},
    )
    return {part: names[part] if part in users else found[own[part]] for part in parts}


def shared(build: Build) -> Build:
    """``build`` where parts of a type whose subcircuits are alike have one: under the type's name
    if all are alike, else under that of the first of each kind."""
    header, names = _header(build.scene), dict(build.libraries)
    for kind in {part.type.name: part.type for part in build.scene.parts.values()}.values():
        parts = [part for part in build.scene.of(kind.name) if part.name in names]
        if len(parts) < 2 or kind.reduced or kind.uses_netlists(parts[0]):
            continue
        trial = replace(build, libraries={**names, **{part.name: kind.name for part in parts}})
        alike: dict[tuple[str, ...], list[str]] = {}
        for part in parts:
            texts = tuple(found.text for found in kind.subcircuits(part, trial, header))
            alike.setdefault(texts, []).append(part.name)
        free = kind.name not in {name.lower() for name in names.values()}
        whole = len(alike) == 1 and free
        names |= {
            each: kind.name if whole else names[group[0]]
            for group in alike.values()
            for each in group
        }
    return replace(build, libraries=names)


def _header(scene: Scene) -> Header:
    return Header(scene.name, scene_hash(scene))


def _libraries(build: Build, header: Header) -> Iterator[Subcircuit]:
    known: dict[str, Subcircuit] = {}
    for part in build.scene.parts.values():
        for found in part.type.subcircuits(part, build, header):
            same = known.get(found.filename.lower())
            if same is None:
                known[found.filename.lower()] = found
                yield found
            elif same.text != found.text:
                raise UsageError(
                    "two different libraries have one name",
                    where=part.name,
                    got=found.filename,
                    expected="names that differ",
                    hint="rename the part or the included file",
                )


def replacements(build: Build) -> dict[str, tuple[str, ...]]:
    """Cards of parts that other parts write for them."""
    parts = build.scene.parts.values()
    return {k: v for part in parts for k, v in part.type.instances(part, build).items()}


def result_vectors(build: Build) -> dict[str, Vector]:
    """Results of all parts that have an instance of their own.

    Of devices' own parameters (``@b1[i]``) ngspice gives the operating point in an ac analysis,
    which is no response: they are no results there.
    """
    replaced = replacements(build)
    found: dict[str, Vector] = {}
    for part in build.scene.parts.values():
        if part.name not in replaced:
            found |= part.type.vectors(part, build)
    found |= meter_vectors(build, found)
    if build.scene.analysis.type == "ac":
        return {name: each for name, each in found.items() if "@" not in each.expression}
    return found


def _blocks(build: Build) -> Iterator[Block]:
    scene, replaced = build.scene, replacements(build)
    for part in scene.parts.values():
        cards = replaced.get(part.name)
        cards = part.type.cards(part, build) if cards is None else cards
        if cards:
            yield Block(f"{part.name}: {part.type.title}", tuple(cards))
    nets = [group.nets[0] for group in free(build) if group.nets]
    if scene.analysis.type == "ac" and nets:
        names = allocated(((n, f"{n}_held") for n in nets), {name.lower() for name in scene.parts})
        held = tuple(f"L{name} {net} 0 {number(HOLD)}" for net, name in names.items())
        yield Block("held at the operating point alone: nothing else does", held)


def _options(build: Build) -> Iterable[Option]:
    scene = build.scene
    own = [
        Option(key, value, reason)
        for part in scene.parts.values()
        for key, (value, reason) in part.type.options(part, scene).items()
    ]
    if scene.analysis.type != "transient":
        return own
    solver, rows = scene.solver, time_scales(scene)
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
        *own,
    ]


def _step_line(build: Build) -> str:
    limit = build.largest
    if build.scene.analysis.type != "transient" or limit is None or build.scene.solver.max_step:
        return ""
    return f"\n* {comment(f'largest step {limit.step:g} s: {limit.why}')}"


def _command(build: Build) -> Command:
    scene = build.scene
    chosen = scene.analysis
    if chosen.type == "transient":
        uic = any(p.type.without_operating_point(p, scene) for p in scene.parts.values())
        from kc2spice.workflow.steps import largest_step  # which asks for replacements

        step = (build.largest or largest_step(build)).step
        return transient(scene.stop, step, uic=uic)
    if chosen.type == "ac":
        # of two linear points ngspice gives the first alone
        points = 3 if (chosen.points, chosen.scale) == (2, "linear") else chosen.points
        return ac(chosen.start, float(chosen.stop or 0.0), points, chosen.scale)
    if chosen.type == "op":
        return Command("op", ())
    part, key, first, last = swept(scene)
    found = part.type.dc(part, key, build)
    if found is None:
        raise UsageError(
            "cannot be swept by dc",
            where="analysis.sweep",
            got=str(chosen.sweep),
            expected="the dc value of a source, such as push.dc",
            hint="kc2spice sweep varies any key, one run each",
        )
    source, scale = found
    return dc(source, scale * first, scale * last, chosen.points)


def swept(scene: Scene) -> tuple[Part, str, float, float]:
    """Part and key that a dc analysis moves, first and last value in SI."""
    name, _, key = str(scene.analysis.sweep).partition(".")
    part = scene.part(name, "analysis.sweep")
    first, last = part.type.sweep_range(part, scene) or _range(part, key, scene.analysis)
    return part, key, first, last


def _range(part: Part, key: str, chosen: object) -> tuple[float, float]:
    units = {each.name: each.unit for each in model_keys(type(part.keys))}
    unit = getattr(part.keys, "unit", None) or units.get(key) or ""
    first, last = (quantity(getattr(chosen, name), unit) for name in ("from_", "to"))
    return first, last


def _initial(build: Build) -> dict[str, float]:
    parts = build.scene.parts
    if build.scene.analysis.type != "transient":
        return {}
    begins = {name: part.type.initial(part, build) for name, part in parts.items()}
    found = {node: value for each in begins.values() for node, value in each.items()}
    for group in free(build):
        if group.nets and not group.bodies and not any(begins[name] for name in group.parts):
            found[group.nets[0]] = 0.0  # dampers alone
    return found
