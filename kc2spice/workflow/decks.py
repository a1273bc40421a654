"""From a scene and the models of its parts to a deck: every part is asked, none is known."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from kc2spice.core.errors import UsageError
from kc2spice.core.units import quantity
from kc2spice.scene.hash import scene_hash
from kc2spice.scene.keys import model_keys
from kc2spice.scene.model import Part, Scene
from kc2spice.scene.parttype import Build, Vector
from kc2spice.scene.plan import plan
from kc2spice.spice.cards import number
from kc2spice.spice.circuit import Subcircuit
from kc2spice.spice.deck import Block, Command, Deck, Option, ac, dc, transient
from kc2spice.spice.expression import Number, parse
from kc2spice.spice.header import Header, plan_lines
from kc2spice.spice.naming import with_design_names
from kc2spice.spice.scan import third_party
from kc2spice.spice.statements import statements


def make_deck(build: Build) -> Deck:
    """The testbench of a scene with its libraries.

    Raises
    ------
    UsageError : an included file that is missing or could act on the machine, two libraries with
        one name, a dc sweep of a key that no source has.
    """
    scene = build.scene
    header = Header(scene.name, scene_hash(scene))
    parts = tuple(_libraries(build, header))
    results = result_vectors(build)
    deck = Deck(
        name=scene.name,
        title=f"{scene.name}: {scene.title}",
        notes=f"{header.origin()}\n{plan_lines(plan(scene))}",
        parts=parts,
        blocks=tuple(_blocks(build)),
        options=tuple(_options(build)),
        command=_command(build),
        vectors={name: (v.expression, v.factor) for name, v in results.items()},
        units={name: v.unit for name, v in results.items()},
        stop=scene.stop if scene.analysis.type == "transient" else None,
        initial=_initial(build),
    )
    return with_design_names(deck)


def edited_deck(build: Build, path: Path) -> Deck:
    """A netlist of the scene that somebody edited, with the results of the scene's own deck.

    What it includes from its own directory is written into its place; it is refused if it could
    act on the machine, unless the build is trusted.

    Raises
    ------
    UsageError : no such file, a line that could act on the machine, another analysis than the
        scene's, vectors that the file no longer saves.
    """
    own = make_deck(build)
    ((name, text),) = third_party(path, trust=build.trust).items()
    cards = [s for s in statements(text, name, title=True) if s.text]
    analyses = [s for s in cards if s.keyword in (".tran", ".ac", ".dc", ".op")]
    if [s.keyword for s in analyses] != [f".{own.command.kind}"]:
        raise UsageError(
            "not the scene's analysis", where=str(path),
            got=" and ".join(s.text for s in analyses) or "none", expected=own.command.card,
            hint="one analysis of the same kind; its numbers are free",
        )  # fmt: skip
    saved = {_plain(w) for s in cards if s.keyword == ".save" for w in s.words[1:]}
    missing = [v for v in own.saved if _plain(v) not in saved]
    if saved and "all" not in saved and missing:
        raise UsageError(
            "the scene's metrics need vectors that this deck does not save", where=str(path),
            got=", ".join(missing), expected=".save " + " ".join(missing),
            hint="add this line; a node that was renamed needs its old name",
        )  # fmt: skip
    (analysis,) = analyses
    words = tuple(analysis.words[1:])
    stop = None if own.stop is None else _seconds(words, analysis.where)
    return replace(
        own, text=text, parts=(), blocks=(), options=(), initial={}, stop=stop,
        command=Command(own.command.kind, words),
    )  # fmt: skip


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
    return {
        part: name
        if len(owners[name.lower()]) == 1 or parts[part].type.uses_netlists(parts[part])
        else part
        for part, name in names.items()
    }


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
                    "two different libraries have one name", where=part.name, got=found.filename,
                    expected="names that differ", hint="rename the part or the included file",
                )  # fmt: skip


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


def _options(build: Build) -> Iterable[Option]:
    scene = build.scene
    own = [
        Option(key, value, reason)
        for part in scene.parts.values()
        for key, (value, reason) in part.type.options(part, scene).items()
    ]
    if scene.analysis.type != "transient":
        return own
    solver = scene.solver
    speeds = [s for p in scene.parts.values() if (s := p.type.speed(p, scene)) is not None]
    # Displacements shrink with the speed of an impact, and so does what a step may miss.
    chgtol = solver.chgtol * min(1.0, *speeds) if speeds else solver.chgtol
    reltol = solver.reltol * min(p.type.closeness(p, scene) for p in scene.parts.values())
    return [
        Option("reltol", number(reltol), "error per step; decides the launch velocity"),
        Option(
            "trtol",
            number(solver.trtol).removesuffix(".0"),
            "trust the error estimate: contact needs every step it asks for",
        ),
        Option(
            "chgtol",
            number(chgtol),
            f"C on 1 uF, thus {1e6 * chgtol:g} um: displacement error of a step",
        ),
        Option("method", solver.method, "of integration"),
        Option("acct", "", "print accepted and rejected steps, iterations and time"),
        *own,
    ]


def _command(build: Build) -> Command:
    scene = build.scene
    chosen = scene.analysis
    if chosen.type == "transient":
        uic = any(p.type.without_operating_point(p, scene) for p in scene.parts.values())
        return transient(scene.stop, scene.solver.max_step, uic=uic)
    if chosen.type == "ac":
        return ac(chosen.start, float(chosen.stop or 0.0), chosen.points, chosen.scale)
    if chosen.type == "op":
        return Command("op", ())
    part, key, first, last = swept(scene)
    found = part.type.dc(part, key, build)
    if found is None:
        raise UsageError(
            "cannot be swept by dc", where="analysis.sweep", got=str(chosen.sweep),
            expected="the dc value of a source, such as push.dc",
            hint="kc2spice sweep varies any key, one run each",
        )  # fmt: skip
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
    found: dict[str, float] = {}
    for part in build.scene.parts.values():
        found |= part.type.initial(part, build)
    return found if build.scene.analysis.type == "transient" else {}
