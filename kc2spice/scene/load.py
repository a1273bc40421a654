"""From a gallery name or a TOML file to a checked :class:`Scene`, with errors that say where."""

from __future__ import annotations

import contextlib
import json
import math
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from importlib.resources.abc import Traversable
from itertools import chain
from math import inf
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ValidationError

from kc2spice.core.errors import UsageError, candidates, did_you_mean, unknown
from kc2spice.core.quantities import (
    clipped,
    describe_invalid,
    display_text,
    dotted,
    entries,
    quantity,
    unit_of,
)
from kc2spice.core.toml_errors import parse_toml_file
from kc2spice.core.untrusted_files import (
    DEEPEST,
    LONGEST_KEY,
    MAX_BYTES,
    identifier,
    lines_of,
    parse_toml,
    read_bounded,
    text_of,
)
from kc2spice.scene.compose import with_joins
from kc2spice.scene.model import DEFAULT_TYPES, GROUND, Names, Part, PartType, Scene
from kc2spice.scene.parttype import part_type, type_names
from kc2spice.scene.plausible import ImplausibleError, apply_action, check_drive_levels
from kc2spice.scene.resolve import PERIOD_TOLERANCE, resolve, with_governed
from kc2spice.scene.settings import SCALE_OF, Analysis, Frame
from kc2spice.scene.start_conditions import find_start_errors

MOST_POINTS = 1e7  # time points of a transient at its largest step
CLOSEST = 1e-12  # smallest step that a simulator resolves, relative to the last frequency


def problems(scene: Scene) -> Iterator[UsageError]:
    """Every violated condition, with the dotted key in ``where``."""
    if not scene.parts:
        yield UsageError(
            "a scene without parts",
            where="name",
            got=scene.name,
            expected="at least one table with part = TYPE",
            hint="kc2spice scenes lists scenes to start from",
        )
        return
    doubtful = []
    for item in (item for part in scene.parts.values() for item in part.type.problems(part, scene)):
        if isinstance(item, ImplausibleError):
            doubtful.append(item)
        else:
            yield item
    yield from apply_action(doubtful, scene.checks.plausible)
    selected, solver = scene.analysis, scene.solver
    if scene.include and not any(part.netlist for part in scene.parts.values()):
        yield UsageError(
            "nothing uses these netlists",
            where="include",
            got=", ".join(scene.include),
            expected="a part that names a subcircuit out of them",
        )
    if selected.type == "transient" and (solver.max_step or 0.0) > scene.stop:
        yield UsageError(
            "longer than the whole simulation",
            where="solver.max_step",
            got=f"{solver.max_step:g} s",
            expected=f"at most the end of the simulation, {scene.stop:g} s",
        )
    step = solver.max_step if selected.type == "transient" else None
    points = 0.0 if step is None else scene.stop / step
    if points > MOST_POINTS:
        yield UsageError(
            "more time points than a run may have",
            where="solver.max_step",
            got=f"{scene.stop:g} s in steps of {solver.max_step:g} s: {points:.2g} points",
            expected=f"at most {MOST_POINTS:g}",
            hint="raise solver.max_step, or end earlier (analysis.stop or solver.stop)",
        )
    yield from _without_effect(selected)
    if selected.type != "dc" and selected.sweep is not None:
        yield UsageError(
            "only dc sweeps a key",
            where="analysis.sweep",
            got=f"{selected.type} and a sweep",
            expected='type = "dc", or no sweep',
            hint="kc2spice sweep SCENE --set KEY=FROM:TO:POINTS runs an analysis at each value",
        )
    if selected.back:
        source = scene.parts.get((selected.sweep or "").removesuffix(".dc"))
        if selected.type != "dc" or source is None or source.type.name != "source":
            yield UsageError(
                "only the dc value of a source returns",
                where="analysis.back",
                got=f"{selected.type} of {selected.sweep}",
                expected='type = "dc" and sweep = "SOURCE.dc", or back = false',
            )
    stop = selected.stop or 0.0
    if selected.small and selected.stop is None:
        yield UsageError(
            f"analysis.stop is missing in {selected.type}",
            where="analysis",
            got=f'type = "{selected.type}" without stop',
            expected='the last frequency, such as stop = "100 kHz"',
            hint='add  stop = "100 kHz"  to [analysis]',
        )
    elif selected.small and not stop - selected.start > CLOSEST * selected.points * stop:
        yield UsageError(
            "empty frequency range",
            where="analysis.stop",
            got=f"{selected.start:g} … {stop:g} Hz",
            expected=f"a stop above the start, {selected.start:g} Hz, and points that differ by "
            f"more than {CLOSEST:g} of the stop",
            hint="raise analysis.stop, or lower analysis.start",
        )
    if selected.small and selected.scale == "log" and selected.start <= 0:
        yield UsageError(
            "a logarithmic range cannot begin at zero",
            where="analysis.start",
            got=f"{selected.start:g} Hz",
            expected='above 0, or scale = "linear"',
        )
    elif selected.small and selected.scale == "log" and math.isinf(stop / selected.start):
        yield UsageError(
            "a range of more decades than numbers have",
            where="analysis.start",
            got=f"{selected.start:g} … {stop:g} Hz",
            expected="at most 308 decades",
        )
    if (selected.type == "noise") != (selected.output is not None):
        yield UsageError(
            "a noise analysis needs an output"
            if selected.output is None
            else f"output has no effect in {selected.type}",
            where="analysis" if selected.output is None else "analysis.output",
            got=f'type = "{selected.type}"'
            + (" without output" if selected.output is None else f', output = "{selected.output}"'),
            expected='output = "PART.RESULT" or "PART.PIN" with type = "noise"',
            hint='add  output = "PART.RESULT"  to [analysis]'
            if selected.output is None
            else "delete the key output of [analysis]",
        )
    if selected.type == "dc":
        name, _, _ = (selected.sweep or "").partition(".")
        if name not in scene.parts:
            sources = [part.name for part in scene.of("source")] or list(scene.parts)
            yield UsageError(
                "analysis.sweep is missing in dc"
                if selected.sweep is None
                else f"this scene has no part {name!r}",
                where="analysis" if selected.sweep is None else "analysis.sweep",
                got='type = "dc" without sweep' if selected.sweep is None else repr(selected.sweep),
                expected=f"PART.dc of a source of the scene: {candidates(name, sources)}",
                hint=f'write  sweep = "{sources[0]}.dc"  in [analysis]',
            )
        unit = _scale_unit(scene)
        for key, value in (("from", selected.from_), ("to", selected.to)):
            if unit is not None and isinstance(value, str):
                quantity(value, unit, where=f"analysis.{key}")
    for name, probe in scene.probes.items():
        for key, place in probe.places.items():
            yield from _misplaced(f"probes.{name}.{key}", place, scene)


def _without_effect(selected: Analysis) -> Iterator[UsageError]:
    """Keys of the analysis that its type does not read; sweep, back and output have own errors."""
    readers = {
        "stop": ("transient", "ac", "noise"),
        "start": ("ac", "noise"),
        "scale": ("ac", "noise"),
        "points": ("ac", "noise", "dc"),
        "from_": ("dc",),
        "to": ("dc",),
    }
    for name, types in readers.items():
        value = getattr(selected, name)
        if selected.type in types or name not in selected.model_fields_set or value is None:
            continue
        key = name.rstrip("_")
        yield UsageError(
            f"{key} has no effect in {selected.type}",
            where=f"analysis.{key}",
            got=f"{key} with type = {selected.type}",
            expected=f"{key} with type = {' or '.join(types)}",
            hint=f"delete the key {key} of [analysis]",
        )


def _without_periods(scene: Scene) -> Iterator[UsageError]:
    """Probes of the last periods of a run that has no such periods."""
    for name, probe in scene.probes.items():
        if probe.periods is not None:
            yield from _no_periods(f"probes.{name}.periods", probe.periods, scene)


def _no_periods(where: str, count: int, scene: Scene) -> Iterator[UsageError]:
    """Why a transient has no such window of its last periods."""
    if scene.analysis.type != "transient":
        got, expected = f"{scene.analysis.type} analysis", "a transient, or from and to"
        yield UsageError("only a transient has periods", where=where, got=got, expected=expected)
        return
    period, known = scene.period, sorted({row.period for row in scene.numerics} - {0.0})
    if period is None:
        periods = ", ".join(f"{each:.4g} s" for each in known)
        yield UsageError(
            "the sources of this scene have no common period",
            where=where,
            got=f"periods {periods}" if periods else "no source with a period",
            expected="sines and pulse trains whose periods divide the longest one",
            hint='give the window by from and to, such as from = "8 ms"',
        )
    elif count * period > scene.stop * (1 + PERIOD_TOLERANCE):
        got = f"{count} periods of {period:.4g} s"
        expected = f"at most {scene.stop:g} s, the end of the transient"
        yield UsageError("the window is longer than the run", where=where, got=got,
                         expected=expected)  # fmt: skip


def _misplaced(where: str, place: float, scene: Scene) -> Iterator[UsageError]:
    """Why a place is none on the scale of the scene's analysis."""
    selected, part_unit = scene.analysis, getattr(place, "unit", "")
    unit = _scale_unit(scene)
    if part_unit and unit is not None and part_unit != unit:
        examples = {"s": '"2 ms"', "Hz": '"46 Hz"', "": "a plain number"}
        expected = f"a value in {unit}, such as {examples.get(unit, repr(f'1 {unit}'))}"
        got = f"a value in {part_unit}"
        article = "an" if selected.type in ("ac", "op") else "a"
        words = f"not on the scale of {article} {selected.type} analysis"
        yield UsageError(words, where=where, got=got, expected=expected)
        return
    band = (selected.start, selected.stop or 0.0)
    ends = {"ac": band, "noise": band, "transient": (0.0, scene.stop)}
    first, last = ends.get(selected.type, (-inf, inf))
    if not first <= place <= last:
        expected = f"{first:g} … {last:g} {unit or ''}".rstrip()
        got = f"{place:g}"
        yield UsageError("outside the analysis", where=where, got=got, expected=expected)


def _scale_unit(scene: Scene) -> str | None:
    """Unit of the scale of the scene's analysis, None where that is not known."""
    selected = scene.analysis
    if selected.type != "dc":
        return SCALE_OF.get(selected.type)
    name, _, key = (selected.sweep or "").partition(".")
    part = scene.parts.get(name)
    if part is None:
        return None
    part_unit = getattr(part.keys, "unit", None)
    field = type(part.keys).model_fields.get(key)
    return part_unit if isinstance(part_unit, str) else None if field is None else unit_of(field)


_WORD, _INDEX = r"[A-Za-z_][A-Za-z0-9_]*", r"\[-?[0-9]{1,6}\]"
_KEY = re.compile(rf"{_WORD}({_INDEX})*(\.{_WORD}({_INDEX})*)*")
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,47}")
_ALTERNATIVES = {"rom.order": "tolerance", "rom.tolerance": "order"}  # one replaces the other
_PARTS = "kc2spice scenes --parts"  # lists the part types with their keys
_GRAMMAR = ("part", "pins")  # keys of every part table
_OVERRIDE = "dotted.key=value, such as kick.drive.voltage=80 or beam.layers[0].thickness=0.2 mm"


def gallery() -> dict[str, Traversable]:
    """Built-in scenes by name."""
    files = (resources.files("kc2spice") / "scenes").iterdir()
    result = {file.name[:-5]: file for file in files if file.name.endswith(".toml")}
    return dict(sorted(result.items()))


def load_scene(
    scene: Scene | str | Path | Mapping[str, Any],
    overrides: Sequence[str] | Mapping[str, Any] = (),
) -> Scene:
    """Read a scene, apply overrides in order, check it and join its parts.

    Parameters
    ----------
    scene : Scene, str, Path or mapping
        Name of a built-in scene (``kc2spice scenes`` lists them), path of a TOML file, the tables
        of such a file as a mapping, or a scene to be changed.
    overrides : sequence of str, or mapping of str to value, optional
        Texts ``dotted.key=value``, or a mapping of dotted keys to values. A value in a text is TOML
        (``80``, ``"80 V"``, ``[0, 1e5]``), a bare word or a quantity (``80 V``, ``antiparallel``).
        Numbers are in SI units. The path of a TOML file of such keys may replace a text. Entries of
        a list are counted from 0, or from its end by negative numbers:
        ``beam.layers[0].thickness``, ``disc.layers[-1].material``.

    Returns
    -------
    Scene
        Checked scene, whose numbers are in SI units.

    Raises
    ------
    UsageError : no such scene, not TOML, unknown key or part type, bad value, keys that contradict
        each other, pins that do not fit.

    Examples
    --------
    >>> import kc2spice as kc
    >>> scene = kc.load_scene("impact", ["impact.velocity=-50 cm/s"])
    >>> scene.name, scene.part("impact").keys.velocity
    ('impact', -0.5)
    """
    if isinstance(scene, Scene) and not overrides:
        return scene
    if not isinstance(scene, (Scene, str, Path, Mapping)):
        raise UsageError(
            "not a scene",
            where="scene",
            got=f"{type(scene).__name__} {scene!r}"[:120],
            expected="a name or path, a mapping with its tables, or a kc.Scene",
            hint='write for example kc.load_scene("impact")',
        )
    if isinstance(scene, Scene):
        source, data = _Source("scene", scene.name, "", scene.home), _copied(scene.tables)
    elif isinstance(scene, Mapping):
        source, data = _Source("scene", "scene", "", Path()), _copied(scene)
    else:
        source = _open(scene)
        data = source.parse()
    data.setdefault("name", identifier(source.stem, "scene"))
    if isinstance(overrides, str):
        raise UsageError(
            "overrides is a text, not a list of texts",
            where="overrides",
            got=repr(clipped(overrides)),
            expected='a list such as ["KEY=VALUE"], or a mapping such as {"KEY": VALUE}',
            hint=f"write overrides=[{clipped(overrides)!r}]",
        )
    if isinstance(overrides, Mapping):
        changes = [(name, value, f"{name}={value}") for name, value in overrides.items()]
    else:
        changes = [(*_override(text), text) for text in override_texts(overrides)]
    stated = [name for name, table in data.items() if isinstance(table, Mapping)]
    for name, value, text in changes:
        source.overrides[_put(data, name, value, text)] = text
    _only_parts_of(data, stated, source)
    try:
        result = _scene(data, source)
        return replace(result, workspace=scene.workspace) if isinstance(scene, Scene) else result
    except UsageError as problem:
        # a file that the scene names is a place of its own, not a key
        if problem.where is not None and not Path(problem.where).is_absolute():
            problem.where = source.where(problem.where)
        raise


def _only_parts_of(data: Mapping[str, Any], stated: Sequence[str], source: _Source) -> None:
    """Refuse overrides of a part that the scene lacks; one with a type adds a part."""
    known = {*stated, *Frame.model_fields, *DEFAULT_TYPES}
    for name, table in data.items():
        if name in known or not isinstance(table, Mapping) or "part" in table:
            continue
        parts = [part for part in stated if part not in Frame.model_fields]
        raise UsageError(
            f"this scene has no part {name!r}",
            where=source.where(name),
            expected=f"a key of one of its parts: {candidates(name, parts)}",
            hint=did_you_mean(name, parts) or "use the name of one of these parts",
        )


def _copied(value: Any) -> Any:
    """A copy whose tables and lists may be changed."""
    if isinstance(value, Mapping):
        return {key: _copied(item) for key, item in value.items()}
    return list(map(_copied, value)) if isinstance(value, (list, tuple)) else value


def _scene(data: dict[str, Any], source: _Source) -> Scene:
    """The scene that ``data`` says; of errors ``where`` is a key."""
    home = source.folder
    types = {name: _type(name, table) for name, table in _part_tables(data)}
    frame = {key: data[key] for key in data if key not in types}
    scene = Scene(_validated(Frame, frame, ()), {}, home=home)
    parts = {}
    for name, kind in types.items():
        short = () if "part" in data[name] else tuple(data)
        parts[name] = _part(name, data[name], kind, home, short=short)
    analysis = None
    for part in list(parts.values()):
        for name, table in part.type.expand(part, data).items():
            if name == "analysis":
                analysis = analysis or _validated(Analysis, table, (part.name,))
                continue
            if name.lower() in map(str.lower, parts):
                expected = f"another name: {part.name} brings a part of this one along"
                raise UsageError("this name is taken", where=name, got=name, expected=expected)
            keys = {key: value for key, value in table.items() if key != "at"}
            at = table.get("at")
            place = at if isinstance(at, tuple) else (name,)
            parts[name] = _part(name, keys, _type(name, keys), home, place)
    scene = replace(scene, parts=parts, tables=_copied(data), source=source)
    if analysis is not None and "analysis" not in data:
        scene = replace(scene, frame=scene.frame.model_copy(update={"analysis": analysis}))
    scene = with_governed(scene)
    for problem in problems(scene):
        raise problem
    scene = resolve(_driven(scene))
    wild = apply_action(check_drive_levels(scene), scene.checks.plausible)
    for problem in chain(_without_periods(scene), find_start_errors(scene, scene.rests), wild):
        raise problem
    return scene


def _driven(scene: Scene) -> Scene:
    """``scene``; of an ``ac`` that nothing drives with 1 V on its body's first electrical port.

    Raises
    ------
    UsageError : nothing drives it, and there is no such port or something is joined to it.
    """
    parts = scene.parts
    if scene.analysis.type != "ac" or any(part.type.drives(part, scene) for part in parts.values()):
        return scene
    exported = replace(with_joins(scene), ports="all")
    bodies = [part for part in parts.values() if part.reduced]
    electrical = ([p for p in part.type.pins(part, exported) if p.unit == "V"] for part in bodies)
    ports = [(b.name, pins[0].name) for b, pins in zip(bodies, electrical, strict=True) if pins]
    if len(ports) != 1 or ports[0][1] in parts[ports[0][0]].pins or scene.is_target(*ports[0]):
        at = f" at {', '.join(map('.'.join, ports))}" if ports else ""
        raise UsageError(
            "nothing drives this analysis",
            where="analysis.type",
            got="ac, and no source with an ac value",
            expected=f'a source with ac = "1 V"{at}',
            hint="a body whose electrical port nothing is joined to is driven by 1 V",
        )
    body = ports[0][0]
    name = Names(parts).name(body, f"{body}_drive")
    table = {"part": "source", "ac": "1 V", "pins": {"out": ".".join(ports[0])}}
    drive = _part(name, table, _type(name, table), scene.home)
    return replace(scene, parts={**parts, name: drive})


def _part_tables(data: Mapping[str, Any]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Top-level tables that are parts."""
    spellings: dict[str, str] = {}
    for name, table in data.items():
        if name in Frame.model_fields:
            continue
        if not isinstance(table, Mapping) and name in DEFAULT_TYPES:
            expected = f"a table, [{name}]"
            raise UsageError("not a table", where=name, got=display_text(table), expected=expected)
        if not isinstance(table, Mapping):
            raise _unknown(name, data)
        if not _NAME.fullmatch(name) or name.lower() == GROUND:
            raise UsageError(
                "not a name for a part",
                where=name,
                got=repr(clipped(name)),
                expected="a letter, then letters, digits and _, at most 48 in all; not gnd",
                hint=f"rename it, such as [{identifier(name, 'part')}]",
            )
        first = spellings.setdefault(name.lower(), name)
        if first != name:
            raise UsageError(
                "two parts whose names differ in case only, which netlists ignore",
                where=name,
                got=f"{first} and {name}",
                expected="names that differ in more than case",
                hint=f"rename one of them, such as {name}_2",
            )
        yield name, table


def _unknown(name: str, data: Mapping[str, Any]) -> UsageError:
    """The error of a key at the top that is none; perhaps it belongs below the name of a part."""
    parts = {
        n: t for n, t in data.items() if isinstance(t, Mapping) and n not in Frame.model_fields
    }
    kinds = {item: table.get("part", DEFAULT_TYPES.get(item)) for item, table in parts.items()}
    schemas = {n: kind.schema for n, k in kinds.items() if (kind := part_type(str(k))) is not None}
    part_keys: list[str] = []
    for item, schema in schemas.items():
        part_keys += [".".join((item, *key)) for key, _ in entries(schema)]
    below = f"keys of a part stand below its name: {', '.join(parts)}" if parts else None
    return UsageError(
        "unknown key",
        where=name,
        expected=f"one of {candidates(name, Frame.model_fields)}, or a table with part = TYPE",
        hint=did_you_mean(name, Frame.model_fields) or did_you_mean(name, part_keys) or below,
    )


def _type(name: str, table: Mapping[str, Any]) -> PartType:
    selected = table.get("part", DEFAULT_TYPES.get(name))
    if selected is None:
        near = did_you_mean(name, [*Frame.model_fields, *DEFAULT_TYPES])
        raise UsageError(
            "this table states no part type",
            where=name,
            expected=f"part = one of {candidates(name, type_names(), _PARTS)}",
            hint=near
            or f'add  part = "TYPE"  to [{name}]; kc2spice scenes --parts lists the types',
        )
    result = part_type(selected) if isinstance(selected, str) else None
    if result is None:
        error = unknown("unknown part type", selected, type_names(), f"{name}.part", _PARTS)
        error.hint = error.hint or (
            "a part type of your own needs kc.register_part in Python, or an installed package "
            "with an entry point in the group kc2spice.parts"
        )
        raise error
    return result


def _part(
    name: str,
    table: Mapping[str, Any],
    kind: PartType,
    home: Path,
    at: tuple[str | int, ...] = (),
    short: tuple[str, ...] = (),
) -> Part:
    """A part of its table; ``at`` is where the file has it, if not under its name. ``short`` are
    the tables of the scene where this one's name says its type, which some keys depend on."""
    pins = table.get("pins", {})
    if not isinstance(pins, Mapping) or not all(isinstance(v, str) for v in pins.values()):
        raise UsageError(
            "pins is not a table",
            where=f"{name}.pins",
            got=clipped(repr(pins)),
            expected="a table of pins, each with the pin that it joins, or gnd",
            hint='write  pins = { PIN = "PART.PIN" }',
        )
    keys = {key: value for key, value in table.items() if key not in _GRAMMAR}
    keys, context = _completed(keys, kind.schema), {"home": home, "short": short}
    checked = _validated(kind.schema, keys, at or (name,), context)
    return Part(name, kind, checked, dict(pins), at)


def _validated(
    schema: type[BaseModel],
    table: Mapping[str, Any],
    at: tuple[str | int, ...],
    context: Mapping[str, Any] | None = None,
) -> Any:
    """The table ``at`` as its ``schema``, or an error that names its invalid key."""
    try:
        return schema.model_validate(table, context=context)
    except ValidationError as error:
        path, words = describe_invalid(error, schema, at, _GRAMMAR if at else (), table)
        raise UsageError(where=".".join(map(str, path)), **words) from None


def _completed(table: Mapping[str, Any], schema: type[BaseModel]) -> dict[str, Any]:
    """``table`` whose tables have what the schema's default for them says and they do not.

    ``ring = { outer = "6 mm" }`` changes the outer diameter of the usual ring and nothing else.
    """
    result = dict(table)
    for name, field_ in schema.model_fields.items():
        default = field_.default
        if isinstance(default, BaseModel) and isinstance(result.get(name), Mapping):
            stated = {key: getattr(default, key) for key in default.model_fields_set}
            result[name] = stated | _completed(result[name], type(default))
    return result


@dataclass(frozen=True)
class _Source:
    """Text of a scene with the overrides on top of it, to say where a key was set."""

    label: str
    stem: str
    text: str
    folder: Path
    overrides: dict[tuple[str, ...], str] = field(default_factory=dict)

    def parse(self) -> dict[str, Any]:
        return parse_toml_file(self.text, self.label)

    def where(self, key: str) -> str:
        """The override or the line that sets ``key``, entries of lists by numbers between dots."""
        names = tuple(key.split("."))
        for path, text in self.overrides.items():
            if path[: len(names)] == names or names[: len(path)] == path:
                return f"--set {clipped(text)!r}"
        line = _line_of(self.text, names)
        place = self.label if line is None else f"{self.label}, line {line}"
        return f"{place}, key {dotted(tuple(int(n) if n.isdigit() else n for n in names))}"


def _open(name_or_path: str | Path) -> _Source:
    scenes, name = gallery(), str(name_or_path)
    if name in scenes:
        text = scenes[name].read_text(encoding="utf-8")
        return _Source(f"scene {name}", name, text, Path(str(scenes[name])).parent)
    path = Path(name_or_path)
    try:
        text = text_of(read_bounded(path, MAX_BYTES))
    except UnicodeDecodeError:
        raise UsageError("not a text file", where=name, expected="TOML in UTF-8") from None
    except (FileNotFoundError, IsADirectoryError):
        raise _not_found(name, path, scenes) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise UsageError(f"cannot be read: {reason}", where=name) from None
    folder = Path.cwd() if path.parent == Path() else path.parent  # Path() is: no folder
    return _Source(name, path.stem, text, folder)


def _not_found(name: str, path: Path, scenes: Iterable[str]) -> UsageError:
    """The error of a file that does not exist, or of a name that no built-in scene has."""
    listing = "kc2spice scenes lists the built-in scenes"
    if path.suffix != ".toml" and len(path.parts) == 1:
        expected = (
            f"a TOML file, or a built-in scene: {candidates(name, scenes, 'kc2spice scenes')}"
        )
        hint = did_you_mean(name, scenes) or listing
        return UsageError("no such scene", got=repr(name), expected=expected, hint=hint)
    with contextlib.suppress(OSError):
        near = did_you_mean(path.stem, (file.stem for file in path.parent.glob("*.toml")))
        listing = near or listing
    message = "is a directory" if path.is_dir() else "this file does not exist"
    return UsageError(message, where=name, expected="the path of a TOML file", hint=listing)


def override_texts(texts: Sequence[str]) -> list[str]:
    """Overrides, each ``dotted.key=value``; a TOML file gives all that it has.

    Raises
    ------
    UsageError : a file that is not there, or not TOML.
    """
    result: list[str] = []
    for text in texts:
        plain = "=" in text or not text.endswith(".toml")
        result += [text] if plain else [f"{k}={toml(v)}" for k, v in _flat(_open(text).parse())]
    return result


def _flat(table: Mapping[str, Any], above: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of tables in tables; one whose own keys are dotted is a value."""
    for key, value in table.items():
        if isinstance(value, Mapping) and not any(re.search(r"[.\[]", name) for name in value):
            yield from _flat(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def toml(value: Any) -> str:
    """A value as the text that a scene file would have for it, to the last bit."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{json.dumps(key)} = {toml(v)}" for key, v in value.items()) + "}"
    if hasattr(value, "tolist"):  # a numpy array or number
        return toml(value.tolist())
    if isinstance(value, (list, tuple)):
        return "[" + ", ".join(map(toml, value)) + "]"
    return repr(value) if isinstance(value, float) else json.dumps(value, default=str)


def _override(text: str) -> tuple[str, Any]:
    """Key and value of ``dotted.key=value``."""
    name, equals, value = (part.strip() for part in text.partition("="))
    if not equals or not value:
        raise _no_override(text)
    return name, override_value(value)


def _no_override(text: str) -> UsageError:
    name, equals, _ = text.partition("=")
    hint = None if equals else f"write {clipped(name)}=VALUE"
    return UsageError(
        "not an override",
        where="--set",
        got=repr(clipped(text)),
        expected=_OVERRIDE,
        hint=hint,
    )


def _put(data: dict[str, Any], name: str, value: Any, text: str) -> tuple[str, ...]:
    """Set the key ``name`` and return its path, in which entries of lists are counted from their
    beginning; tables on the way are made, entries of lists must be there."""
    steps = re.findall(rf"{_WORD}|{_INDEX}", name)
    long = len(steps) > DEEPEST or max(map(len, steps), default=0) > LONGEST_KEY
    if long or not _KEY.fullmatch(name):
        raise _no_override(text)
    path: list[str] = []
    where, so_far = f"--set {clipped(text)!r}", ""
    holder: Any = data
    key: str | int = ""
    for step in steps:
        key = _place(holder, step, so_far, where)
        path.append(str(key))
        so_far += step if step[0] == "[" or not so_far else f".{step}"
        if len(path) < len(steps):
            holder = holder.setdefault(key, {}) if isinstance(holder, dict) else holder[key]
    if isinstance(holder, dict):
        holder.pop(_ALTERNATIVES.get(name, ""), None)
    holder[key] = value
    return tuple(path)


def _place(holder: Any, step: str, so_far: str, where: str) -> str | int:
    """Key of a table, or number from the beginning of a list, for a name or ``[index]``.

    Raises
    ------
    UsageError : ``holder``, which the key ``so_far`` names, is not that or has no such entry.
    """
    if step[0] != "[":
        if isinstance(holder, dict):
            return step
        entries = f"its entries are {so_far}[0], …" if isinstance(holder, list) else None
        raise UsageError(f"{so_far} is a value, not a table", where=where, hint=entries)
    if not isinstance(holder, list):
        hint = f"give all of it: {so_far} = [ … ]"
        raise UsageError(f"{so_far} is no list in this scene", where=where, hint=hint)
    index, count = int(step[1:-1]), len(holder)
    if not -count <= index < count:
        expected = f"{so_far}[0] … {so_far}[{count - 1}]" if count else "a list with entries"
        raise UsageError("no such entry", where=where, got=so_far + step, expected=expected)
    return index % count


def override_value(text: str) -> Any:
    """Parse the value of ``key=VALUE``.

    It is a TOML value. Other texts, bare words and numbers with a unit, are returned unchanged.
    """
    try:
        table = parse_toml(f"value = {text}")
    except ValueError:
        return text
    return table["value"] if set(table) == {"value"} else text


def _numbered(table: tuple[str, ...], counts: Mapping[tuple[str, ...], int]) -> tuple[str, ...]:
    """The path of a table with the number of the entry behind each list of tables."""
    result: list[str] = []
    for end in range(1, len(table) + 1):
        result.append(table[end - 1])
        if table[:end] in counts:
            result.append(str(counts[table[:end]]))
    return tuple(result)


def _line_of(text: str, path: tuple[str, ...]) -> int | None:
    """Line that sets ``path`` or, failing that, the longest part of it; for messages only."""
    table: tuple[str, ...] = ()
    counts: dict[tuple[str, ...], int] = {}  # of the entries of each list of tables
    best: tuple[int, int | None] = (0, None)
    for number, line in enumerate(lines_of(text), start=1):
        line = line.strip()
        key = re.match(r"([\w.]+)\s*=", line)
        if line.startswith("["):
            header = line.partition("]")[0].lstrip("[")
            table = tuple(part.strip() for part in header.split("."))
            if line.startswith("[["):
                counts[table] = counts.get(table, -1) + 1
            table = names = _numbered(table, counts)
        elif key:
            names = table + tuple(key[1].split("."))
        else:
            continue
        if names == path[: len(names)] and len(names) > best[0]:
            best = (len(names), number)
    return best[1]
