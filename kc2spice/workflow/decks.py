"""From a scene and the models of its parts to a deck: every part is asked, none is known."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain

from kc2spice.core.errors import UsageError, did_you_mean
from kc2spice.netlist.cards import comment, number, tidy
from kc2spice.netlist.circuit import Subcircuit
from kc2spice.netlist.deck import Block, Command, Deck, Option, ac, dc, transient
from kc2spice.netlist.transforms import quiet
from kc2spice.scene.compose import allocated
from kc2spice.scene.model import Part, Scene, scene_hash
from kc2spice.scene.parttype import Build, begins, mover, numerics
from kc2spice.scene.plan import MAX_STEP
from kc2spice.scene.plausible import built, judged
from kc2spice.scene.rest import Free, free, unsettled
from kc2spice.spice.header import Header, plan_lines
from kc2spice.workflow import noise
from kc2spice.workflow.meters import powers, replaced, result_vectors, sweep_values, swept
from kc2spice.workflow.steps import largest_step

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
    wild = judged(built(build), scene.checks.plausible)
    for problem in chain(unsettled(build), wild):
        raise problem
    header = Header(scene.name, scene_hash(scene))
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
    loose = free(build)
    ours = () if scene.solver.max_step else (MAX_STEP,)  # a line of its own says why
    made = Deck(
        name=scene.name,
        title=f"{scene.name}: {scene.title}",
        notes=f"{header.origin()}\n{plan_lines(build.plan, ours)}{told}{_step_line(build)}",
        parts=parts,
        blocks=tuple(_blocks(build, loose)),
        options=tuple(_options(build)),
        command=_command(build),
        vectors={name: (v.expression, v.factor) for name, v in results.items()},
        units={name: v.unit for name, v in results.items()} | dict.fromkeys(watts, "W"),
        stop=scene.stop if scene.analysis.type == "transient" else None,
        initial=_initial(build, loose),
        controlled=any(_controls(part, scene) for part in scene.parts.values()),
    )
    return noise.sources(made, build) if build.noisy else made


def _controls(part: Part, scene: Scene) -> bool:
    """Whether it measures a motion and sets a voltage or current, which may close a loop."""
    pins = [pin for (name, _), pin in scene.terminals.items() if name == part.name]
    sees = any(p.flow == "-" and p.unit in ("um", "m/s") and not p.signal_out for p in pins)
    acts = any(p.flow == "A" and p.default is None for p in pins)
    return sees and acts and not any(p.moving for p in pins)


def _reductions(parts: Iterable[Subcircuit]) -> Iterator[str]:
    """Order, band and error of every reduced model, in the words of its library."""
    for part in parts:
        head = (line for item in part.circuit.items for line in item.notes)
        told = (line[2:].partition(" (")[0] for line in head if line.startswith("* rom: "))
        yield from (f"* {part.name}, {line}" for line in told)


def _libraries(build: Build, header: Header) -> Iterator[Subcircuit]:
    known: dict[str, Subcircuit] = {}
    for part in build.scene.parts.values():
        if mover(part.name, build.scene):
            continue
        for found in part.type.subcircuits(part, build, header):
            if build.noisy and not part.netlist:
                noise = part.type.noise
                found = quiet(found, () if isinstance(noise, str) else noise)
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


def _blocks(build: Build, loose: Sequence[Free]) -> Iterator[Block]:
    scene, copied = build.scene, replaced(build.scene)
    for part in scene.parts.values():
        cards = () if part.name in copied else part.type.cards(part, build)
        if cards:
            yield Block(f"{part.name}: {part.type.title}", tuple(cards))
    if build.noisy:
        source, node = noise.reference(build)
        title = "drives nothing: what the analysis could refer the noise to"
        yield Block(title, (f"{source} {node} 0 DC 0 AC 1", f"R{node} {node} 0 1 noisy=0"))
    nets = [group.nets[0] for group in loose if group.nets]
    if scene.analysis.small and nets:
        names = allocated(((n, f"{n}_held") for n in nets), {name.lower() for name in scene.parts})
        held = tuple(f"L{name} {net} 0 {number(HOLD)}" for net, name in names.items())
        yield Block("held at the operating point alone: nothing else does", held)


def _options(build: Build) -> Iterable[Option]:
    scene = build.scene
    solver, rows = scene.solver, numerics(scene)
    own = [Option(key, *why) for row in rows for key, why in row.options.items()]
    if scene.analysis.type != "transient":
        return own
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
        uic = bool(begins(scene))
        step = (build.largest or largest_step(build)).step
        return transient(scene.stop, step, uic=uic)
    if chosen.type == "ac":
        # of two linear points ngspice gives the first alone
        points = 3 if (chosen.points, chosen.scale) == (2, "linear") else chosen.points
        return ac(chosen.start, float(chosen.stop or 0.0), points, chosen.scale)
    if chosen.type == "noise":
        return noise.command(build)
    if chosen.type == "op":
        return Command("op", ())
    _, _, found = swept(build)
    values = sweep_values(build)
    return dc(found.source, found.scale * values[0], found.scale * values[-1], values.size)


def _initial(build: Build, loose: Sequence[Free]) -> dict[str, float]:
    parts = build.scene.parts
    if build.scene.analysis.type != "transient":
        return {}
    own = (part for part in parts.values() if not mover(part.name, build.scene))
    states = {part.name: part.type.initial(part, build) for part in own}
    found = {node: value for each in states.values() for node, value in each.items()}
    for group in loose:
        if group.nets and not group.bodies and not any(states[name] for name in group.parts):
            found[group.nets[0]] = 0.0  # dampers alone
    return found
