"""Functions that write the deck of a scene from the built models of its parts.

The methods of the part types supply the cards, libraries and results of the parts.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from operator import attrgetter, itemgetter
from pathlib import Path
from typing import Any

from kc2spice.core.domains import ELECTRICAL, SIGNAL
from kc2spice.core.errors import UsageError
from kc2spice.core.files import list_earlier_files
from kc2spice.core.progress import StageTimer
from kc2spice.netlist.card_parser import split_statements
from kc2spice.netlist.circuit import Element, Item
from kc2spice.netlist.deck import Deck, Option
from kc2spice.netlist.edited_deck import read_edited_deck
from kc2spice.netlist.lint import require_valid_wiring
from kc2spice.netlist.name_scopes import INCLUDES
from kc2spice.netlist.number_and_name_spelling import format_comment, format_number
from kc2spice.netlist.shared_cards import add_title
from kc2spice.netlist.subcircuit_library import Header, Subcircuit, write_model_comments
from kc2spice.netlist.transforms import add_noise_results
from kc2spice.scene.analysis_cards import make_analysis_cards
from kc2spice.scene.numerical_settings import MAX_STEP_KEY, describe_plan
from kc2spice.scene.part_records import NumericalRequirements
from kc2spice.scene.probed_results import require_probed_results
from kc2spice.scene.reference_frames import MOTION_UNITS
from kc2spice.scene.results import NOISE_WAVE
from kc2spice.scene.scene_classes import BuiltScene, NameAllocator, Part, Scene, compute_scene_hash
from kc2spice.scene.start_conditions import FloatingNets, find_floating_nets, find_start_errors
from kc2spice.workflow.measure_cards import list_measure_cards
from kc2spice.workflow.part_models import build_models
from kc2spice.workflow.parts_from_edited_deck import with_edited_parameters
from kc2spice.workflow.time_step import find_step_reason

# Inductance [H] of an inductor that fixes a floating displacement at the operating point.
# The current of the inductor acts as a force on the part that moves with the displacement.
# Above 1 Hz, the force of an inductor of 1e30 H is negligible, because it is smaller than the
# inertia force of a mass of 1e-6 fg.
HOLD_INDUCTANCE = 1e30


def prepare_deck(
    scene: Scene,
    clock: StageTimer,
    *,
    trust: bool = False,
    functions: Mapping[str, Any] | None = None,
    edited: Path | None = None,
) -> tuple[BuiltScene, Deck]:
    """Return the built scene and its deck, or the deck that the user has edited.

    ``edited`` is the path of a deck that the user has changed by hand. Wiring errors state file and
    line, and are raised before the simulator starts. ``functions`` are the Python functions of
    controllers, keyed by part. Raises the errors of :func:`make_deck` and
    :func:`kc2spice.netlist.edited_deck.read_edited_deck`.
    """
    build = build_models(scene, clock, trust=trust, functions=functions)
    with clock.time_stage("export", "netlists"):
        deck = make_deck(build)
        if edited is None:
            require_valid_wiring(deck)
            return build, deck
        edits = read_edited_deck(deck, edited)
        require_valid_wiring(edits.deck)
        return with_edited_parameters(build, edits, edited), edits.deck


def make_deck(build: BuiltScene) -> Deck:
    """Return the deck of a scene with its libraries.

    Raises
    ------
    UsageError : a probe reads an unknown vector; an included file is missing or unsafe; two
        libraries have the same name; no source has the swept key; or the scene has no operating
        point.
    """
    scene = build.scene
    for problem in find_start_errors(scene, build.equilibrium_conditions):
        raise problem
    loose = find_floating_nets(scene, build.equilibrium_conditions)
    require_probed_results(build)
    results, plan = build.results, describe_plan(build)
    header = Header(scene.name, compute_scene_hash(scene))
    analysis = make_analysis_cards(build)
    # a separate comment line of the deck contains the reason for the largest time step
    ours = () if scene.solver.max_step else (MAX_STEP_KEY,)
    notes = (*header.origin(), *write_model_comments(plan, ours))
    libraries = list(_list_libraries(build, header))
    parts = tuple(map(itemgetter(1), libraries))
    reductions = [f"* {p.name}, rom: {p.reduction.summary}" for p in parts if p.reduction]
    sweep_scale = 1.0 if build.dc_sweep is None else build.dc_sweep.scale
    deck = Deck(
        name=scene.name,
        title=f"{scene.name}: {scene.title}",
        notes=(*notes, *reductions, *_describe_largest_step(build)),
        parts=parts,
        options=tuple(_list_options(build)),
        command=analysis.command,
        vectors={name: (v.expression, v.factor) for name, v in results.vectors.items()},
        units=results.units,
        powers=results.powers,
        measures=list_measure_cards(build, sweep_scale),
        stop=scene.stop_time if scene.analysis.type == "transient" else None,
        max_step=build.largest_step.step if build.largest_step else None,
        step_reason=find_step_reason(build),
        initial_voltages=_list_initial_voltages(build, loose),
        may_have_loop=any(_is_controller(part, scene) for part in scene.parts.values()),
        trusted=build.trust,
        free_nets=frozenset(_list_free_nets(scene)),
        sweep_scale=sweep_scale,
        items=tuple(_list_deck_cards(build, loose, analysis.items)),
    )
    if not build.has_noise:
        return deck
    meters = {
        item.filename: part.type.noise for part, item in libraries if not part.is_user_netlist
    }
    noisy = {name: () if isinstance(row, str) else row for name, row in meters.items()}
    return add_noise_results(deck, NOISE_WAVE, scene.parts, noisy)


def _list_free_nets(scene: Scene) -> Iterator[str]:
    """Yield the nets of pins that need no connection, such as a loudspeaker cone."""
    for key, terminal in scene.terminals.items():
        if not terminal.required and key in scene.nets:
            yield scene.nets[key].lower()


def _is_controller(part: Part, scene: Scene) -> bool:
    """Return whether a part measures a motion and sets a voltage or current.

    A part that measures a motion and sets a voltage or current can close a control loop, and
    therefore counts as a controller.
    """
    measures_motion = sets_output = False
    for pin in scene.pins(part.name):
        if pin.can_move:
            return False
        measures_motion |= pin.flow == SIGNAL and pin.unit in MOTION_UNITS and not pin.signal_out
        sets_output |= pin.domain is ELECTRICAL and pin.default is None
    return measures_motion and sets_output


def _list_libraries(build: BuiltScene, header: Header) -> Iterator[tuple[Part, Subcircuit]]:
    """List all different libraries, each with the first part that uses the library.

    Raises
    ------
    UsageError : two parts write different libraries with the same name.
    """
    known: dict[str, tuple[Part, Subcircuit]] = {}
    for part in build.scene.parts.values():
        if part.name in build.scene.movers:
            continue
        for result in part.type.subcircuits(part, build, header):
            first, same = known.setdefault(result.filename.lower(), (part, result))
            if same is result:
                yield part, result
            elif same.text != result.text:
                names = f"{first.name} and {part.name}"
                raise UsageError(
                    f"{names} have different libraries with the same file name",
                    where=part.name,
                    got=result.filename,
                    expected="names that differ",
                    hint=f"rename the file and the subcircuit of {part.name}",
                )


def _list_deck_cards(
    build: BuiltScene, loose: Sequence[FloatingNets], noise_items: Iterable[Item]
) -> Iterator[Item]:
    """Yield the cards of parts, of noise sources, and of inductors at floating nets.

    In a small-signal analysis, an inductor connects one net of each floating group to ground.
    """
    scene = build.scene
    for part in scene.parts.values():
        cards = () if part.name in scene.without_cards else part.type.cards(part, build)
        if cards:
            yield from add_title(f"{part.name}: {part.type.title}", cards, part.name)
    yield from noise_items
    if not scene.analysis.is_small_signal:
        return
    names, inductors = NameAllocator(scene.parts), []
    for group in loose:
        if group.nets:
            net = group.nets[0]
            name = f"L{names.allocate_name(net, f'{net}_held')}"
            inductors.append(Element.from_words(name, net, "0", format_number(HOLD_INDUCTANCE)))
    if inductors:
        yield from add_title(
            "inductors that ground floating nets at the operating point only", inductors
        )


def _list_options(build: BuiltScene) -> Iterable[Option]:
    """Return the options of a deck: tolerances, then options of the parts.

    In analyses other than a transient, the tolerance of iterations is an option only if the scene
    states it.
    """
    scene = build.scene
    solver, rows = scene.solver, scene.numerics
    part_options = _choose_strictest_options(rows)
    if scene.analysis.type != "transient":
        if "reltol" in solver.model_fields_set:
            return [Option("reltol", solver.reltol, "relative error of iterations"), *part_options]
        return part_options
    reltol = solver.reltol * min(map(attrgetter("reltol"), rows), default=1.0)
    chgtol = solver.chgtol * min(map(attrgetter("chgtol"), rows), default=1.0)
    return [
        Option("reltol", reltol, "relative error of a time step"),
        Option("trtol", solver.trtol, "assumed ratio of estimated to actual truncation error"),
        Option(
            "chgtol",
            chgtol,
            f"charge error per time step [C]: a displacement error of {1e6 * chgtol:g} um at 1 uF",
        ),
        Option("method", solver.method, "integration rule"),
        Option("acct", "", "print accepted and rejected steps, iterations and time"),
        *part_options,
    ]


def _choose_strictest_options(rows: Iterable[NumericalRequirements]) -> list[Option]:
    """Return the required options; repeated options get their smallest value."""
    result: dict[str, Option] = {}
    for row in rows:
        for key, (value, reason) in row.options.items():
            if key not in result or float(value) < float(result[key].value):
                result[key] = Option(key, value, reason)
    return list(result.values())


def _describe_largest_step(build: BuiltScene) -> Iterator[str]:
    """Yield a comment on the largest time step, unless the scene sets it."""
    limit = build.largest_step
    if limit is not None and not build.scene.solver.max_step:
        yield f"* {format_comment(f'largest step {limit.step:g} s: {limit.why}')}"


def _list_initial_voltages(build: BuiltScene, loose: Sequence[FloatingNets]) -> dict[str, float]:
    """Return the initial node voltages [V] of a transient, keyed by node.

    If only dampers connect a net to other nets, the initial value of the net is 0.
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


def _list_statements(text: str, name: str) -> list[str]:
    """Return the statements that a simulator reads from a netlist file.

    ``text`` is the text of the file.
    """
    return list(filter(None, map(attrgetter("written"), split_statements(text, name))))


def protect_other_decks(out: Path, files: Mapping[str, str]) -> None:
    """Raise an error if a new library would change another deck in a directory.

    ``out`` is the directory. Decks in ``out`` that are not among ``files`` are not replaced. If a
    new library replaced a library that an existing deck includes, the deck would simulate another
    part.

    Raises
    ------
    UsageError : another deck in ``out`` uses the library.
    """

    def read_library_text(path: Path) -> str:
        """Return the text of a library file."""
        return path.read_text(encoding="utf-8", errors="replace")

    others = {path.name: path for path in out.glob("*.cir") if path.is_file()}
    for key in sorted(others.keys() - files.keys() - list_earlier_files(out)):
        for card in split_statements(read_library_text(others[key]), key, title=True):
            name = card.words[-1].strip("\"'") if card.keyword in INCLUDES else ""
            if name not in files or not (out / name).is_file():
                continue
            if _list_statements(read_library_text(out / name), name) != _list_statements(
                files[name], name
            ):
                raise UsageError(
                    f"an existing deck in this directory includes another version of {name}",
                    where=str(others[key]),
                    got=f"{name} with other elements",
                    hint=f"write to another directory, such as --out {out.name}_2",
                )
