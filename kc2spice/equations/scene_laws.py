"""Laws of all parts of a scene and the nets that join their pins."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cached_property

from kc2spice.core.laws import GROUND, Device, Equations, Law, Source
from kc2spice.scene.model import Build
from kc2spice.scene.parttype import replaced


@dataclass(frozen=True)
class _Laws:
    """Equations of a scene's parts, the parts that have none, and all laws with their pins."""

    build: Build
    equations: Mapping[str, Equations]
    missing: tuple[str, ...] = ()

    @cached_property
    def laws(self) -> dict[str, Law]:
        """By name."""
        return {law.name: law for item in self.equations.values() for law in item.laws}

    @cached_property
    def kinds(self) -> dict[str, str]:
        """Kinds of all pins of laws."""
        return _kinds(self.laws.values())

    @cached_property
    def ends(self) -> list[tuple[str, str, str, str]]:
        """Net of the scene, part, its pin, and the pin of a law that stands for it."""
        nets = self.build.scene.nets
        return [
            (nets[n, pin], n, pin, end) for n, e in self.equations.items() for pin, end in e.pins
        ]

    def joins(self, replayed: Mapping[str, Source] | None = None) -> dict[str, tuple[str, ...]]:
        """Nets of the laws' pins. Nets of the scene that share a pin of a law are one."""
        groups = [set(net) for item in self.equations.values() for net in item.nets]
        by_net = {net: {f"{source.name}.out"} for net, source in (replayed or {}).items()}
        for net, _, _, end in self.ends:
            by_net.setdefault(net, {GROUND} if net == "0" else set()).add(end)
        merged = _merged([*groups, *by_net.values()])
        free = sorted(sorted(pins) for pins in merged if GROUND not in pins and len(pins) > 1)
        joins = {f"n{k}": tuple(pins) for k, pins in enumerate(free)}
        ground = next((sorted(pins - {GROUND}) for pins in merged if GROUND in pins), None)
        return joins | ({GROUND: tuple(ground)} if ground else {})


def _laws(build: Build) -> _Laws:
    """Parts that drive a load by a signal have no law, as a signal knows no current."""
    copied = replaced(build.scene)
    result: dict[str, Equations] = {}
    for part in build.scene.parts.values():
        equations = None if part.name in copied else part.type.law(part, build)
        if equations is not None:
            result[part.name] = equations
    every = _Laws(build, result)
    circuit = {net for net, _, _, end in every.ends if every.kinds[end] != "signal"}
    loaded = {
        name
        for net, name, _, end in every.ends
        if net in circuit and every.kinds[end] == "signal" and _holds(every.laws, end)
    }
    known = {name: equations for name, equations in result.items() if name not in loaded}
    missing = (name for name in build.scene.parts if name not in known and name not in copied)
    return _Laws(build, known, tuple(missing))


def _kinds(laws: Iterable[Law]) -> dict[str, str]:
    return {f"{law.name}.{pin.name}": pin.kind for law in laws for pin in law.pins}


def _merged(groups: Iterable[set[str]]) -> list[set[str]]:
    """Merge groups that have an element in common."""
    result: list[set[str]] = []
    for group in groups:
        touched = [other for other in result if other & group]
        result = [other for other in result if not other & group] + [group.union(*touched)]
    return result


def without_law(build: Build) -> tuple[str, ...]:
    """Names of the parts that have no law: the scene as a whole cannot be integrated."""
    return _laws(build).missing


def _holds(laws: Mapping[str, Law], pin: str) -> bool:
    """Whether the law of a pin prescribes what its net has."""
    name, _, own = pin.partition(".")
    law = laws[name]
    if isinstance(law, Source):
        return own == "out" and law.kind not in ("current", "force")
    return isinstance(law, Device) and own in law.prescribes
