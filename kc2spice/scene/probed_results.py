"""Check that every probe of a scene reads an existing result.

The check needs no models, except for results whose names depend on a model. An error names the
probe and suggests existing results.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import replace

from kc2spice.core.domains import ACOUSTIC
from kc2spice.core.errors import UsageError, did_you_mean, list_candidates, unknown
from kc2spice.scene.net_formation import list_metered_pins, list_power_input_pins
from kc2spice.scene.part_method_calls import add_equilibrium_and_results, resolve
from kc2spice.scene.results import collect_results, find_noise_output
from kc2spice.scene.scene_classes import BuiltScene, Part, Scene


def require_probed_results(build: BuiltScene) -> None:
    """Raise an error if a probe reads a result that the scene does not have.

    The names of the results of some part types depend on the model. Probes of parts of these types
    are checked only after the model is built.

    Raises
    ------
    UsageError : a probed result does not exist. The error states the key of the probe and the
        names of existing results.
    """
    scene = build.scene
    waiting = set()
    for name, part in scene.parts.items():
        if part.type.results_of_model and build.models.get(name) is None:
            waiting.add(name)
    if not build.has_noise and not scene.probes:
        return
    resolved = build if build.records else add_equilibrium_and_results(build, without=waiting)
    if build.has_noise:
        _require_noise_output(resolved, waiting)
        return
    results = build.results if build.records else collect_results(resolved)
    known = {*results.vectors, *results.powers}
    for name, probe in scene.probes.items():
        owner, dot, _ = probe.of.partition(".")
        # a name without a dot, such as time, is the independent variable of the analysis
        if (dot or owner in scene.parts) and probe.of not in known and owner not in waiting:
            raise _make_unknown_result_error(
                build, probe.of, scene.where(f"probes.{name}.of"), waiting
            )
        unit = results.units.get(probe.of)
        level_unit = getattr(probe.level, "unit", "")
        if level_unit and unit is not None and level_unit != unit:
            raise UsageError(
                "the unit of this level does not match the unit of the probed result",
                where=scene.where(f"probes.{name}.level"),
                got=f"a value in {level_unit}",
                expected=f"a value in {unit}, the unit of {probe.of}" if unit else "a plain number",
                hint=f"write a level in {unit}" if unit else "write the level without a unit",
            )
        if probe.take == "spl" and unit not in (None, ACOUSTIC.across.unit):
            raise UsageError(
                "a sound pressure level needs a pressure",
                where=scene.where(f"probes.{name}.of"),
                got=f"{probe.of} in {unit}",
                expected="a result in Pa, such as the pressure of a listener",
                hint='use a result in Pa, or another value of the key `take`, such as take = "max"',
            )


def _require_noise_output(build: BuiltScene, waiting: Collection[str]) -> None:
    """Raise an error for an unknown output of a noise analysis.

    If the output belongs to a part in ``waiting``, the output is not checked, because the model of
    the part is not built yet.
    """
    name, where = str(build.scene.analysis.output), build.scene.where("analysis.output")
    owner, parts = name.partition(".")[0], build.scene.parts
    if owner not in parts:
        raise _make_unknown_part_error(name, parts, where)
    if build.noise_output is None and owner not in waiting:
        find_noise_output(build)


def list_all_results(scene: Scene) -> list[str]:
    """Return the names of the results that probes of a scene may read.

    Results whose names depend on a model are omitted.
    """
    waiting = {name for name, part in scene.parts.items() if part.type.results_of_model}
    return _list_results(BuiltScene(scene, {}), waiting)


def list_part_results(part: Part, scene: Scene) -> tuple[str, ...]:
    """Return the names of the results of a part, without the name of the part."""
    names = _select_names_with_prefix(list_all_results(scene), f"{part.name}.")
    return tuple(name.removeprefix(f"{part.name}.") for name in names)


def _make_unknown_result_error(
    build: BuiltScene, name: str, where: str, waiting: Collection[str]
) -> UsageError:
    """Return the error about an unknown result.

    ``waiting`` contains the names of the parts whose models are not built yet.
    """
    owner, _, _ = name.partition(".")
    parts = build.scene.parts
    if owner in parts:
        choices = _select_names_with_prefix(_list_results(build, waiting), f"{owner}.")
        if error := _make_grounded_pin_error(build, name, where, choices):
            return error
        suggestion = _suggest_result(name, choices)
        return unknown(
            "the scene has no such result",
            name,
            choices,
            where,
            f"kc2spice scenes --part {parts[owner].type.name}",
            advice=suggestion,
        )
    return _make_unknown_part_error(name, parts, where)


def _make_grounded_pin_error(
    build: BuiltScene, name: str, where: str, choices: Sequence[str]
) -> UsageError | None:
    """Return the error about the motion or power of a pin on ground; None for other results."""
    owner, *words = name.split(".")
    for pin in build.scene.pins(owner):
        domain = pin.domain
        if domain is None or not domain.reference or pin.name not in words:
            continue
        if build.scene.get_net(owner, pin.name) != "0":
            continue
        flow = f"{owner}.{pin.name}.{domain.through_variable.name}"
        return UsageError(
            f"pin {pin.name} of {owner} is on ground, where this result is zero",
            where=where,
            got=repr(name),
            expected=f"one of {list_candidates(name, choices)}" if choices else None,
            hint=f"write {flow} in place of {name}"
            if flow in choices
            else f"join pin {pin.name} of {owner} to a part instead of ground, or delete the probe",
        )
    return None


def _make_unknown_part_error(name: str, parts: Iterable[str], where: str) -> UsageError:
    """Return the error about a result ``name`` of a part that does not exist."""
    owner, dot, result = name.partition(".")
    near = did_you_mean(owner, parts)
    advice = near and near.replace("'?", f"{dot}{result}'?")
    error = unknown(f"this scene has no part {owner!r}", name, parts, where)
    error.hint = advice or error.hint
    return error


def _select_names_with_prefix(names: Iterable[str], prefix: str) -> list[str]:
    """Return the names that begin with ``prefix``."""
    return [name for name in names if name.startswith(prefix)]


def _suggest_result(name: str, choices: Sequence[str]) -> str | None:
    """Suggest a result with a similar name, such as ``r2.v`` for ``r2.voltage``."""
    near = list(filter(name.startswith, choices))
    near = near or _select_names_with_prefix(choices, f"{name}.")[:1]
    return f"did you mean {max(near, key=len)!r}?" if near else None


def _list_results(build: BuiltScene, waiting: Collection[str]) -> list[str]:
    """Return the names of all results that a probe may read.

    The names include motions at ports that are not joined to a net. The names also include currents
    and powers that are measured only if a probe reads the current or power.
    """
    scene = resolve(replace(build.scene, ports="all"))
    results = collect_results(add_equilibrium_and_results(replace(build, scene=scene), waiting))
    result = dict.fromkeys(results.vectors)
    for part in scene.parts.values():
        result |= dict.fromkeys(_list_metered_results(part, scene, result))
    return list(result)


def _list_metered_results(part: Part, scene: Scene, known: Collection[str]) -> Iterator[str]:
    """Yield names of flows and powers of a part that are measured only if probed."""
    n, pins, powered = part.name, list_metered_pins(part, scene), list_power_input_pins(part, scene)
    separate = scene.has_subcircuit(part)
    for domain in dict.fromkeys(powered.values()):
        through = domain.through_variable
        if separate or f"{n}.{through.symbol}" in known:
            yield f"{n}.power"
        if (separate and not domain.reference) or f"{n}.{through.symbol}" in known:
            yield f"{n}.{through.name}"
    if separate:
        for pin, domain in pins.items():
            yield f"{n}.{pin}.{domain.through_variable.name}"
            if scene.get_net(n, pin) != "0":
                yield f"{n}.{pin}.power"
