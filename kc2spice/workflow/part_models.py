"""Models of parts (finite elements, reductions, field tables), built or cached."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from functools import partial
from operator import attrgetter
from typing import Any

from kc2spice.core.errors import UsageError, unknown
from kc2spice.core.progress import StageTimer
from kc2spice.equations.scene_laws import store_laws
from kc2spice.netlist.subcircuit_library import Header
from kc2spice.parts.bodies._linear_body import LinearBody
from kc2spice.parts.control.controller import Controller
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.modal_models import tabulate_modes
from kc2spice.scene.part_method_calls import (
    add_results_and_sources,
    name_subcircuits,
    update_part_records,
)
from kc2spice.scene.plausibility import apply_check_action, check_model_masses
from kc2spice.scene.probed_results import require_probed_results
from kc2spice.scene.scene_classes import BuiltScene, NameAllocator, Part, Scene, compute_scene_hash
from kc2spice.workflow.time_step import choose_largest_step, with_linearised_scene


def build_models(
    scene: Scene,
    clock: StageTimer,
    *,
    trust: bool = False,
    functions: Mapping[str, Any] | None = None,
) -> BuiltScene:
    """Build the models of a scene's parts, or read them from the cache.

    With ``trust``, included netlists may execute programs and open files. ``functions`` are the
    Python functions of controllers, keyed by part.

    Raises
    ------
    UsageError : a probe reads an unknown result or ``functions`` contains an unknown controller,
        which is detected before models are built; or a mass is implausible.
    """
    _require_controllers(scene, functions or {})
    build = BuiltScene(scene, {}, trust=trust, functions=functions or {})
    require_probed_results(build)
    models = {name: _build_model(part, scene, clock) for name, part in scene.parts.items()}
    build = replace(build, models=models, libraries=name_subcircuits(scene))
    for problem in apply_check_action(check_model_masses(build), scene.checks.plausible):
        raise problem
    build = _add_results_and_equations(merge_equal_subcircuits(build))
    if scene.analysis.type != "transient":
        return build
    return replace(build, largest_step=choose_largest_step(build))


def _require_controllers(scene: Scene, functions: object) -> None:
    """Raise an error unless ``functions`` maps controllers of the scene to functions."""
    names = [part.name for part in scene.parts.values() if isinstance(part.type, Controller)]
    example = f'functions={{"{names[0] if names else "CONTROLLER"}": FUNCTION}}'
    if not isinstance(functions, Mapping):
        raise UsageError(
            "functions is not a mapping of controllers to functions",
            where="functions",
            got=repr(functions)[:120],
            expected=f"a mapping, such as {example}",
            hint=f"write {example}",
        )
    for name, function in functions.items():
        if not names:
            raise UsageError(
                "functions applies only to a scene with a controller",
                where="functions",
                got=repr(name),
                expected='the name of a part with part = "controller"',
                hint="leave out functions",
            )
        if name not in names:
            raise unknown("the scene has no such controller", name, names, "functions")
        if not callable(function):
            raise UsageError(
                "this object is not a function",
                where=f"functions: {name}",
                got=repr(function)[:120],
                expected="a function of time and inputs that returns the output",
                hint=f'write functions={{"{name}": lambda time, inputs: 0.0}}',
            )


def _build_model(part: Part, scene: Scene, clock: StageTimer) -> Any:
    """Build the model of a part; errors state the file and the line of the faulty key."""
    with scene.locate_errors(part.name):
        return part.type.build(part, scene, clock)


def _add_results_and_equations(build: BuiltScene) -> BuiltScene:
    """Complete a built scene with result definitions, equations and their linearisation."""
    return with_linearised_scene(store_laws(add_results_and_sources(build)))


def replace_parts(
    build: BuiltScene, parts: Mapping[str, Part], unchecked_parts: Iterable[str]
) -> BuiltScene:
    """Return the built scene with changed parts and unchanged models.

    For the parts ``unchecked_parts``, neither checks nor energy balances are computed.
    """
    changed = replace(build, unchecked_parts=build.unchecked_parts.union(unchecked_parts))
    return rebuild_with_scene(changed, replace(build.scene, parts=parts))


def rebuild_with_scene(build: BuiltScene, scene: Scene) -> BuiltScene:
    """Return the built scene for a changed ``scene``; reuse pins, nets and models."""
    return _add_results_and_equations(replace(build, scene=update_part_records(scene)))


def merge_equal_subcircuits(build: BuiltScene) -> BuiltScene:
    """Return the built scene in which parts of one type share equal subcircuits.

    The shared subcircuit has the name of the part type if all parts of the type have equal
    subcircuits. If the subcircuits of a part type differ, parts with equal subcircuits share the
    subcircuit name of the first of these parts.
    """
    header, names = (
        Header(build.scene.name, compute_scene_hash(build.scene)),
        _name_libraries(build),
    )
    kinds: dict[str, list[Part]] = {}
    for part in build.scene.parts.values():
        if part.name in names:
            kinds.setdefault(part.type.name, []).append(part)
    for kind, parts in kinds.items():
        if len(parts) < 2 or parts[0].is_body or parts[0].is_user_netlist:
            continue
        same_name = dict.fromkeys(map(attrgetter("name"), parts), kind)
        trial = replace(build, libraries=names | same_name)
        equal: dict[tuple[str, ...], list[str]] = {}
        for part in parts:
            equal.setdefault(_list_netlist_texts(part, trial, header), []).append(part.name)
        single = len(equal) == 1 and kind not in map(str.lower, names.values())
        for group in equal.values():
            names |= dict.fromkeys(group, kind if single else names[group[0]])
    return replace(build, libraries=names)


def _list_netlist_texts(part: Part, build: BuiltScene, header: Header) -> tuple[str, ...]:
    """Return the netlist texts of a part's subcircuits."""
    return tuple(map(attrgetter("text"), part.type.subcircuits(part, build, header)))


def _name_libraries(build: BuiltScene) -> dict[str, str]:
    """Return the library name of each part; equal subcircuits share one name.

    Bodies with the same catalogue part number may have different subcircuits, for example with
    different ports. The first subcircuit has the part number as its name; the others are named
    after scene and part.
    """
    scene, names = build.scene, dict(build.libraries)
    header = Header(scene.name, compute_scene_hash(scene))
    users = [*names.values()]
    unique, equal = NameAllocator(users), dict[tuple[str, ...], str]()
    for part in scene.parts.values():
        name = build.libraries[part.name]
        if users.count(name) < 2 or part.is_user_netlist or not isinstance(part.type, LinearBody):
            continue
        texts = _list_netlist_texts(part, build, header)
        if texts not in equal:
            scene_name = part.type.make_library_name(part, scene)
            equal[texts] = (
                unique.allocate_name(part.name, scene_name) if name in equal.values() else name
            )
        names[part.name] = equal[texts]
    return names


def list_model_values(build: BuiltScene) -> dict[str, dict[str, float]]:
    """Return the table ``model`` of ``result.json``: numbers about each part's model."""
    result = {}
    for part in build.scene.parts.values():
        if facts := build.get_model_values(part):
            result[part.name] = dict(facts)
    return result


# SI units of values in the table ``model`` of result.json; other values have no unit.
VALUE_UNITS = {
    "mass_kg": "kg", "resonance*_hz": "Hz", "*capacitance_*f": "F", "depoling_voltage_v": "V",
    "free_stroke_*_m_per_v": "m/V", "free_stroke_*_m_per_100v": "m per 100 V", "extent_*_mm": "mm",
    "area_*_m2": "m2", "force_max_n": "N", "coil_resistance_ohm": "Ohm", "coil_inductance_h": "H",
    "coil_mutual_h": "H", "mesh_limit_hz": "Hz",
}  # fmt: skip


def find_value_units(facts: Mapping[str, float]) -> dict[str, str]:
    """Return the SI units of the numbers that describe a model, keyed by name.

    Numbers without a unit are left out.
    """
    result = {}
    for name in facts:
        pattern = next(filter(partial(fnmatchcase, name), VALUE_UNITS), None)
        if pattern is not None:
            result[name] = VALUE_UNITS[pattern]
    return result


def tabulate_body_modes(build: BuiltScene) -> dict[str, dict[str, Any]]:
    """Return ``modes`` of ``result.json``: the modes of each body within its band."""
    result = {}
    for name, model in build.find_models(LinearModel).items():
        if table := tabulate_modes(model):
            result[name] = table
    return result


def collect_rom_values(build: BuiltScene) -> dict[str, Any]:
    """Return ``rom`` and ``roms`` of ``result.json``, which describe reduced models.

    The result contains ``roms`` only if the scene has more than one reduced model.
    """
    models = build.find_models(LinearModel)
    if not models:
        return {}
    reduced = dict(zip(models, map(_describe_model, models.values()), strict=True))
    first = {"rom": next(iter(reduced.values()))}
    return first | {"roms": reduced} if len(reduced) > 1 else first


def _describe_model(model: LinearModel) -> dict[str, Any]:
    """Return the order, ports and error certificate of a reduced model."""
    result: dict[str, Any] = {
        "order": model.order,
        "ports": list(map(attrgetter("name"), model.ports)),
        "massless": 0 if model.M is None else int((model.M.diagonal() == 0).sum()),
    }
    return result if model.certificate is None else result | model.certificate.record()
