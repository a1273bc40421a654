"""Warnings about scenes and parts that nothing drives.

The results of a part are zero throughout a run if the part is not connected to a source, and has no
initial motion, weight or stored charge.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from kc2spice.core.disjoint_groups import DisjointGroups
from kc2spice.core.domains import QUANTITIES
from kc2spice.core.user_warnings import warn_user
from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.scene_classes import GROUND, BuiltScene, Scene, Terminal

SOURCE = "source"  # part type of independent sources


def warn_of_undriven_parts(build: BuiltScene, waves: Waveforms) -> None:
    """Warn if nothing drives the scene, or a group of connected parts.

    Scenes with netlists or functions of the user are left out, because these may contain sources.
    """
    scene = build.scene
    is_checked = scene.analysis.type in ("transient", "op")
    if not is_checked or scene.include or build.sampled_sources or build.functions:
        return
    if any(part.is_user_netlist for part in scene.parts.values()):
        return
    zero_results = _check_zero_results(build, waves)
    groups = _list_connected_parts(scene)
    if zero_results and all(zero_results.values()) and not scene.list_parts(SOURCE):
        warn_user(
            "all results are zero, because nothing drives this scene: "
            f"{_suggest_source(scene, groups[0])}"
        )
        return
    resting = [group for group in groups if _is_resting(group, zero_results, scene)]
    for group in resting:
        names = parts = " and ".join(group)
        if len(group) > 2:
            names, parts = f"{group[0]} and of the parts connected to it", "these parts"
        warn_user(
            f"all results of {names} are zero, because no source is connected to "
            f"{parts}: {_suggest_join(scene, group)}"
        )


def _check_zero_results(build: BuiltScene, waves: Waveforms) -> dict[str, bool]:
    """Check for each part with results whether all its results are zero."""
    result: dict[str, bool] = {}
    for wave in build.results.vectors:
        values, name = waves.data.get(wave), wave.partition(".")[0]
        if values is not None:
            result[name] = result.get(name, True) and not values.any()
    return result


def _list_connected_parts(scene: Scene) -> list[list[str]]:
    """List the groups of parts that are connected by nets other than ground."""
    union = DisjointGroups(scene.parts)
    first: dict[str, str] = {}
    for (name, _), net in scene.nets.items():
        if net != "0":
            union.join(first.setdefault(net, name), name)
    return union.list_groups()


def _is_resting(group: list[str], zero_results: Mapping[str, bool], scene: Scene) -> bool:
    """Return whether all results of a group are zero, and the group has no source."""
    own = [zero_results[name] for name in group if name in zero_results]
    has_cards = scene.without_cards.isdisjoint(group)
    has_source = any(scene.parts[name].type.name == SOURCE for name in group)
    return has_cards and not has_source and bool(own) and all(own)


def _list_pins(scene: Scene, group: list[str]) -> Iterator[tuple[str, Terminal]]:
    """Yield the pins of a group that a source can drive, each with its part."""
    for (name, pin), terminal in scene.terminals.items():
        if name in group and scene.nets[name, pin] != "0" and terminal.domain is not None:
            yield name, terminal


def _suggest_source(scene: Scene, group: list[str]) -> str:
    """Suggest a source that drives a group of parts."""
    for name, terminal in _list_pins(scene, group):
        units = {
            kind: domain.get_quantity(side).unit
            for kind, (domain, side) in QUANTITIES.items()
            if domain is terminal.domain
        }
        if units:
            kind = "voltage" if "voltage" in units else [*units][-1]
            label = "drive"
            while label in scene.parts:
                label += "_source"
            stated = "" if kind == "voltage" else f'kind = "{kind}"  and  '
            size = f'"1 {units[kind]}"'
            wave = (
                f"dc = {size}"
                if scene.analysis.type == "op"
                else f'sine = {{ amplitude = {size}, frequency = "1 kHz" }}'
            )
            return (
                f'add  [{label}]  and below it  part = "{SOURCE}"  and  {stated}{wave}  and  '
                f'pins = {{ out = "{name}.{terminal.name}" }}'
            )
    return f'add a part of type "{SOURCE}"'


def _suggest_join(scene: Scene, group: list[str]) -> str:
    """Suggest a connection of a group of parts to another part.

    The other pin is preferably a pin that is on ground only because no pin is joined to it.
    """
    advice_for_used_pin: str | None = None
    for name, terminal in _list_pins(scene, group):
        for (other, pin), there in scene.terminals.items():
            if other in group or there.kind != terminal.kind:
                continue
            target = f"{other}.{pin}"
            advice = f'add  {terminal.name} = "{target}"  to the pins of {name}'
            joined = pin in scene.parts[other].pins or scene.is_target(other, pin)
            if scene.nets[other, pin] != "0":
                advice_for_used_pin = advice_for_used_pin or advice
            elif there.default == GROUND and not joined and scene.parts[other].type.name != SOURCE:
                return f"`{target}` is on {GROUND}, because no pin is connected to it; {advice}"
    return advice_for_used_pin or f"connect {group[0]} to a source, or delete it"
