"""Run of one point of a sweep: scene, models, deck, simulation and metrics."""

from __future__ import annotations

import math
import os
import re
import shutil
import tempfile
import threading
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from kc2spice.core.errors import Kc2spiceError, MissingToolError, UsageError, unknown
from kc2spice.core.files import DISK_FULL_ERRORS
from kc2spice.core.memory_store import Workspace
from kc2spice.core.progress import StageTimer
from kc2spice.core.toml_text import format_toml
from kc2spice.core.untrusted_files import MAX_TEXT_BYTES, decode_text, read_bounded
from kc2spice.core.user_warnings import collect_warnings, warn_user
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.include_scan import read_included_netlist
from kc2spice.netlist.transforms import (
    Parameters,
    list_parameter_defaults,
    list_parameterised_subcircuits,
    make_library_stem,
    with_parameters,
)
from kc2spice.report.html import flatten_mapping
from kc2spice.scene.catalogue import find_part
from kc2spice.scene.load import load_scene
from kc2spice.scene.scene_classes import BuiltScene, Part, Scene
from kc2spice.scene.scene_file import list_gallery
from kc2spice.workflow.decks import prepare_deck
from kc2spice.workflow.part_models import find_value_units, replace_parts
from kc2spice.workflow.parts_from_edited_deck import replace_key_value
from kc2spice.workflow.simulation import Run, simulate_deck
from kc2spice.workflow.sweep.grid import PARAMETER_KEY

# pattern of the error message if a signal of the operating system ended the simulator
_SIGNAL_EXIT = re.compile(r"exit code -\d+")
_MIN_FREE_BYTES = 5_000_000  # free bytes that a run needs in the temporary directory
_CACHED_DECKS = 8  # number of decks and scenes that a worker keeps in memory
MAX_FILE_BYTES = 64_000_000  # largest total size [B] of the files of a scene
Number = float | bool | None


# --- the scene ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SceneInput:
    """Source of a scene: a built-in scene, a part number, or a TOML text with files."""

    name: str
    text: str | None
    files: tuple[tuple[str, bytes], ...] = ()

    def load(self, overrides: Sequence[str]) -> Scene:
        """Load the scene with overrides of its keys.

        Raises the errors of :func:`kc2spice.scene.load.load_scene`.
        """
        if self.text is None:
            return load_scene(self.name, overrides)
        home = Path(_unpack_files(self).name)
        try:
            return load_scene(home / f"{self.name}.toml", overrides)
        except UsageError as error:  # rows must not contain paths of the worker's machine
            error.where = error.where and str(error.where).replace(f"{home}{os.sep}", "")
            raise


@lru_cache(maxsize=_CACHED_DECKS)
def _unpack_files(scene: SceneInput) -> tempfile.TemporaryDirectory[str]:
    """Write the files of ``scene`` to a directory that exists until this process ends."""
    directory = tempfile.TemporaryDirectory(prefix="kc2spice-scene-")
    for name, content in ((f"{scene.name}.toml", (scene.text or "").encode()), *scene.files):
        path = Path(directory.name) / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return directory


def read_scene_text(name_or_path: str) -> SceneInput:
    """Read the current text of a scene and of its files.

    Raises
    ------
    UsageError : the scene does not exist, or one of its files is missing or not allowed.
    """
    path = Path(name_or_path)
    is_part_number = find_part(name_or_path) is not None and not path.exists()
    if name_or_path in list_gallery() or is_part_number:
        return SceneInput(name_or_path, None)
    scene = load_scene(path)
    text = decode_text(read_bounded(path, MAX_TEXT_BYTES))
    return SceneInput(scene.name, text, tuple(read_scene_files(scene).items()))


def read_scene_files(scene: Scene) -> dict[str, bytes]:
    """Return the files that a scene reads, keyed by name; expand netlist includes.

    Raises
    ------
    UsageError : a file is missing, not allowed or too large.
    """
    parts = [(part.is_user_netlist, part.type.files(part, scene)) for part in scene.parts.values()]
    netlists = {*scene.include, *chain.from_iterable(files for local, files in parts if local)}
    result = {}
    for name in sorted(netlists.union(*(files for _, files in parts))):
        if name in netlists:
            result[name] = read_included_netlist(name, scene.home).text.encode()
            continue
        try:
            result[name] = read_bounded(scene.home / name, MAX_FILE_BYTES)
        except OSError as error:
            raise UsageError(f"this file cannot be read: {error.strerror}", where=name) from None
    if sum(map(len, result.values())) > MAX_FILE_BYTES:
        raise UsageError(
            "the files of this scene are too large for the workers of a sweep",
            where=scene.name,
            expected=f"at most {MAX_FILE_BYTES} bytes",
        )
    return result


# --- the point ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class SweepSettings:
    """Settings that all points of a sweep have in common.

    ``fixed`` are overrides of scene keys, and ``parameters`` are overrides of subcircuit
    parameters. ``timeout`` [s] limits one ngspice run. The scenes of points in one process share
    ``workspace``.
    """

    scene: SceneInput | Scene
    fixed: tuple[str, ...] = ()
    parameters: Parameters = ()
    timeout: float | None = None
    workspace: Workspace = field(default_factory=Workspace, compare=False)

    def load(self, values: Mapping[str, Any]) -> Scene:
        """Load the scene with the values of the swept keys.

        Raises the errors of :func:`kc2spice.scene.load.load_scene`.
        """
        overrides = (*self.fixed, *_format_overrides(values))
        if isinstance(self.scene, SceneInput):
            scene = self.scene.load(overrides)
        else:
            scene = load_scene(self.scene, overrides)
        return replace(scene, workspace=self.workspace)


@dataclass(frozen=True)
class PointResult:
    """Results of one run of a sweep, or a one-line reason for its failure.

    ``metrics`` are keyed by name. ``facts`` are all other numbers of ``result.json``, keyed by
    dotted path. ``units`` are the SI units of metrics and facts. If ``interrupted``, the machine
    caused the failure, and another attempt can succeed. ``warnings`` are the texts of the warnings
    that the run issued.
    """

    metrics: Mapping[str, Number] = field(default_factory=dict)
    facts: Mapping[str, Number] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)
    failure: str | None = None
    interrupted: bool = False
    warnings: tuple[str, ...] = ()


def _format_overrides(values: Mapping[str, Any]) -> tuple[str, ...]:
    """Return overrides ``key=value`` of scene keys, without subcircuit parameters."""
    return tuple(
        f"{k}={format_toml(v)}" for k, v in values.items() if not PARAMETER_KEY.fullmatch(k)
    )


def list_subcircuit_parameters(values: Mapping[str, Any]) -> Parameters:
    """Return pairs ``("PART.NAME", value)`` of the subcircuit parameters of a point."""
    result = ((PARAMETER_KEY.fullmatch(key), value) for key, value in values.items())
    return tuple((name[1], float(value)) for name, value in result if name)


def resolve_parameters(build: BuiltScene, deck: Deck, values: Parameters) -> Parameters:
    """Return parameters in which the names of libraries replace the names of parts.

    ``values`` contains pairs ``("PART.NAME", value)``. PART is the name of a part, or the name of
    its library file without suffix.

    Raises
    ------
    UsageError : no part has the parameter, PART has two meanings, several parts use the library of
        PART, or the scene already sets the parameter.
    """
    known = list_parameter_defaults(deck)
    stems = {subcircuit.name.lower(): make_library_stem(subcircuit) for subcircuit in deck.parts}
    owners = {part: stems.get(name.lower(), "") for part, name in build.libraries.items()}
    of_parts = {}
    for part, stem in owners.items():
        for key in known:
            library, _, name = key.partition(".")
            if library == stem:
                of_parts[f"{part}.{name}"] = key
    result = []
    for key, value in values:
        part, _, name = key.partition(".")
        choices = {key, of_parts.get(key, key)} & known.keys()
        where = f"param.{key}"
        if not choices:
            error = unknown(
                "no part of this scene has a parameter of this name",
                key,
                dict.fromkeys((*of_parts, *known)),
                where,
            )
            for similar, of_library in of_parts.items():
                owner, _, similar_name = similar.partition(".")
                scene_key = _find_stated_key(build.scene.parts[owner], similar_name)
                proposals = [f"did you mean {item!r}?" for item in (similar, of_library)]
                if scene_key is not None and error.hint in proposals:
                    error.hint = f"write {scene_key} in place of {where}"
            raise error
        users = [user for user, stem in owners.items() if stem == owners.get(part)]
        if len(choices) > 1:
            raise UsageError(
                f"{part} is the name of a part and of the library of another part",
                where=where,
                got=key,
                expected="a name with one meaning",
                hint=f"rename the part {part}, and write {of_parts[key]} for its parameter",
            )
        library_key = choices.pop()
        if library_key != key and len(users) > 1:
            raise UsageError(
                f"{' and '.join(users)} use the same library, so their parameters cannot differ",
                where=where,
                got=key,
                expected="the parameter of a library, which changes in all of these parts",
                hint=f"write param.{library_key} in place of param.{key}",
            )
        stem = library_key.partition(".")[0]
        for user in (user for user, used in owners.items() if used == stem):
            _require_unset_parameter(build.scene.parts[user], name, key)
        result.append((library_key, value))
    return tuple(result)


def _require_unset_parameter(part: Part, name: str, key: str) -> None:
    """Reject a parameter whose default value has no effect, because a part states its value.

    ``name`` is the name of the parameter, and ``param.KEY`` is the key that changes its default
    value.

    Raises
    ------
    UsageError : the part states a value of the parameter.
    """
    stated = _find_stated_key(part, name)
    if stated is not None:
        setting = part.type.instance_parameters(part)[stated.rpartition(".")[2]]
        raise UsageError(
            f"the scene sets this parameter in {part.name}.parameters, so another default "
            "value of the subcircuit has no effect",
            where=f"param.{key}",
            got=f"{stated} = {setting}",
            expected="a parameter that the scene does not set",
            hint=f"write {stated} in place of param.{key}",
        )


def _find_stated_key(part: Part, name: str) -> str | None:
    """Find the scene key that states a subcircuit parameter, or return None."""
    for stated in part.type.instance_parameters(part):
        if stated.lower() == name.lower():
            return f"{part.name}.parameters.{stated}"
    return None


def run_point(job: SweepSettings, values: Mapping[str, Any]) -> PointResult:
    """Run one point of a sweep, and return its result or its failure.

    A failure does not end the sweep. Warnings are part of the result, because a worker process must
    not print.

    Raises
    ------
    MissingToolError : ngspice is missing, so no point could succeed on this machine.
    """
    with collect_warnings() as texts:
        result = _run_point(job, values)
    return replace(result, warnings=tuple(texts))


def _run_point(job: SweepSettings, values: Mapping[str, Any]) -> PointResult:
    """Run one point of a sweep; warnings are issued, and errors become failures."""
    try:
        build, deck = build_sweep_point(job, values)
        stated = (*job.parameters, *list_subcircuit_parameters(values))
        changed = resolve_parameters(build, deck, stated) if stated else ()
        build, deck = with_changed_parameters(build, deck, changed), with_parameters(deck, changed)
        with tempfile.TemporaryDirectory(prefix="kc2spice-") as directory:
            return _make_point_result(
                simulate_deck(build, deck, Path(directory), timeout=job.timeout)
            )
    except MissingToolError:
        raise
    except Kc2spiceError as error:
        where = error.where if isinstance(error, UsageError) else None
        got = None if error.got is None else f"got {error.got}"
        text = ", ".join(filter(None, (where, error.message, got))).replace("\n", " ")
        return PointResult(
            failure=text, interrupted=bool(_SIGNAL_EXIT.search(text)) or _is_disk_full()
        )
    except OSError as error:
        return PointResult(
            failure=f"{error}", interrupted=error.errno in DISK_FULL_ERRORS or _is_disk_full()
        )
    except Exception as error:
        return PointResult(failure=f"{type(error).__name__}: {error}")


def with_changed_parameters(
    build: BuiltScene, deck: Deck, values: Iterable[tuple[str, float]]
) -> BuiltScene:
    """Return the built scene with changed parameter values, for metrics and checks.

    If a key of a part has the name and the previous value of a changed parameter, the key is set to
    the new value of the parameter. Otherwise, the keys of the part no longer describe the deck, and
    the part has neither checks nor an energy balance.
    """
    known, parts, unchecked_parts = (
        list_parameter_defaults(deck),
        dict(build.scene.parts),
        set[str](),
    )
    for key, value in values:
        library, _, name = key.partition(".")
        users = {
            p.name.lower() for p in deck.parts if library in dict(list_parameterised_subcircuits(p))
        }
        for owner in (p for p, used in build.libraries.items() if used.lower() in users):
            other = replace_key_value(parts[owner], name, known.get(key, math.nan), value)
            if other is not None:
                parts[owner] = other
            # the keys of a user's netlist never contain the default values of its parameters
            elif value != known.get(key) and not parts[owner].is_user_netlist:
                unchecked_parts.add(owner)
    return replace_parts(build, parts, unchecked_parts)


def _is_disk_full() -> bool:
    """Return whether the temporary directory lacks space for a run."""
    try:
        return shutil.disk_usage(tempfile.gettempdir()).free < _MIN_FREE_BYTES
    except OSError:
        return True


# lock that prevents threads of one worker from building the same model at the same time
_build_lock = threading.Lock()


def build_sweep_point(job: SweepSettings, values: Mapping[str, Any]) -> tuple[BuiltScene, Deck]:
    """Return the models and the deck of a point.

    Points that differ only in subcircuit parameters share models and deck.
    """
    with _build_lock:
        build, deck, texts = _build_testbench(
            replace(job, fixed=(*job.fixed, *_format_overrides(values)))
        )
    for text in texts:  # also if an earlier point has built the deck
        warn_user(text)
    return build, deck


@lru_cache(maxsize=_CACHED_DECKS)
def _build_testbench(job: SweepSettings) -> tuple[BuiltScene, Deck, tuple[str, ...]]:
    """Build scene and deck of a sweep, without swept parameters of subcircuits.

    The result also contains the texts of the warnings.
    """
    with collect_warnings() as texts:
        build, deck = prepare_deck(job.load({}), StageTimer())
    return build, deck, tuple(texts)


def _make_point_result(run: Run) -> PointResult:
    """Return the numbers of a run, such as metrics, as the result of a point."""
    checks = {check.name: check.value for check in run.verdict.checks}
    facts = run.result_record
    units = {f"model.{part}": find_value_units(row) for part, row in facts["model"].items()}
    return PointResult(
        _flatten_numbers(run.metrics),
        _flatten_numbers({**facts, "checks": checks}),
        {**run.units, **dict(flatten_mapping(units))},
    )


def _flatten_numbers(value: Mapping[str, Any]) -> dict[str, Number]:
    """Return the numbers, booleans and None values in nested tables, by dotted name."""
    result: dict[str, Number] = {}
    for name, item in flatten_mapping(value):
        item = item.item() if isinstance(item, np.generic) else item
        if item is None or isinstance(item, bool):
            result[name] = item
        elif isinstance(item, (int, float)):
            result[name] = float(item)
    return result
