"""The models of a scene's parts: FE, reduction and field tables, built once and cached."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

from kc2spice.core.progress import Clock
from kc2spice.equations.scene_laws import with_laws
from kc2spice.netlist.library import Header
from kc2spice.parts.bodies._linear_body import LinearBody
from kc2spice.rom.linear_model import LinearModel
from kc2spice.rom.modal import mode_table
from kc2spice.scene.model import Build, Names, Scene, scene_hash
from kc2spice.scene.resolve import resolve_build
from kc2spice.workflow.time_step import largest_step, with_linearised_scene


def build_models(
    scene: Scene,
    clock: Clock,
    *,
    trust: bool = False,
    functions: Mapping[str, Any] | None = None,
) -> Build:
    """Build or fetch the models of the parts that the scene names, and only those.

    ``trust`` lets included netlists act on the machine; ``functions`` are those of controllers, by
    part.
    """
    models = {name: part.type.build(part, scene, clock) for name, part in scene.parts.items()}
    build = Build(scene, models, libraries(scene), trust=trust, functions=functions or {})
    build = with_laws(resolve_build(shared(build)))
    if scene.analysis.type != "transient":
        return build
    build = with_linearised_scene(build)
    return replace(build, largest=largest_step(build))


def libraries(scene: Scene) -> dict[str, str]:
    """Name of every part's subcircuit; parts of two types that would share a name get their own."""
    parts = scene.parts
    names = {part.name: part.type.library(part, scene) for part in parts.values()}
    owners: dict[str, set[str]] = {}
    for part, name in names.items():
        owners.setdefault(name.lower(), set()).add(parts[part].type.name)
    users = {part for part in parts if parts[part].netlist}
    preferred = {
        part: (parts[part].type.name, name if len(owners[name.lower()]) == 1 else part)
        for part, name in names.items()
        if part not in users
    }
    unique = Names(names[part] for part in users)
    return {
        p: names[p] if p in users else unique.name(preferred[p], preferred[p][1]) for p in parts
    }


def shared(build: Build) -> Build:
    """``build`` where parts of a type whose subcircuits are alike have one: under the type's name
    if all are alike, else under that of the first of each kind."""
    header, names = Header(build.scene.name, scene_hash(build.scene)), _numbered(build)
    for kind in {part.type.name: part.type for part in build.scene.parts.values()}.values():
        parts = [part for part in build.scene.of(kind.name) if part.name in names]
        if len(parts) < 2 or parts[0].reduced or parts[0].netlist:
            continue
        trial = replace(build, libraries={**names, **{part.name: kind.name for part in parts}})
        alike: dict[tuple[str, ...], list[str]] = {}
        for part in parts:
            texts = tuple(result.text for result in kind.subcircuits(part, trial, header))
            alike.setdefault(texts, []).append(part.name)
        free = kind.name not in {name.lower() for name in names.values()}
        single = len(alike) == 1 and free
        for group in alike.values():
            names |= dict.fromkeys(group, kind.name if single else names[group[0]])
    return replace(build, libraries=names)


def _numbered(build: Build) -> dict[str, str]:
    """Libraries of all parts. Bodies of one part number whose subcircuits differ, as those of other
    ports do, have the name of the number once, and the names of scene and part otherwise."""
    scene, names = build.scene, dict(build.libraries)
    header = Header(scene.name, scene_hash(scene))
    users = [*names.values()]
    unique, alike = Names(users), dict[tuple[str, ...], str]()
    for part in scene.parts.values():
        name = build.libraries[part.name]
        if users.count(name) < 2 or part.netlist or not isinstance(part.type, LinearBody):
            continue
        texts = tuple(result.text for result in part.type.subcircuits(part, build, header))
        if texts not in alike:
            scene_name = part.type.scene_library(part, scene)
            alike[texts] = unique.name(part.name, scene_name) if name in alike.values() else name
        names[part.name] = alike[texts]
    return names


def model_facts(build: Build) -> dict[str, dict[str, float]]:
    """``model`` of ``result.json``: the numbers by which an engineer knows the parts."""
    parts = build.scene.parts.values()
    facts = {part.name: dict(build.facts(part)) for part in parts}
    return {name: result for name, result in facts.items() if result}


# SI units of the numbers in ``model`` of result.json; those without have none.
FACT_UNITS = {
    "mass_kg": "kg", "resonance*_hz": "Hz", "*capacitance_*f": "F", "depoling_voltage_v": "V",
    "free_stroke_*_m_per_v": "m/V", "free_stroke_*_m_per_100v": "m per 100 V", "extent_*_mm": "mm",
    "force_max_n": "N", "coil_resistance_ohm": "Ohm", "coil_inductance_h": "H",
    "coil_mutual_h": "H",
}  # fmt: skip


def fact_units(facts: Mapping[str, float]) -> dict[str, str]:
    """SI unit of each of a model's ``facts`` that has one."""
    rows = {name: [u for of, u in FACT_UNITS.items() if fnmatchcase(name, of)] for name in facts}
    return {name: units[0] for name, units in rows.items() if units}


def mode_tables(build: Build) -> dict[str, dict[str, Any]]:
    """``modes`` of ``result.json``: those of each body that has some within its band."""
    result = {n: mode_table(m) for n, m in build.models.items() if isinstance(m, LinearModel)}
    return {name: modes for name, modes in result.items() if modes}


def rom_facts(build: Build) -> dict[str, Any]:
    """``rom`` of ``result.json``, that of the first part with a reduced model; ``roms`` of all."""
    reduced = {n: _rom(m) for n, m in build.models.items() if isinstance(m, LinearModel)}
    if not reduced:
        return {}
    first = {"rom": next(iter(reduced.values()))}
    return first | {"roms": reduced} if len(reduced) > 1 else first


def _rom(model: LinearModel) -> dict[str, Any]:
    result: dict[str, Any] = {
        "order": model.order,
        "ports": [port.name for port in model.ports],
        "massless": 0 if model.M is None else int((model.M.diagonal() == 0).sum()),
    }
    return result if model.certificate is None else result | model.certificate.record()
