"""Part types as a reference: what each is, its pins, its keys, and a table that shows it.

Pins depend on a part's keys and on what is joined to it. They are those of the type's own
:attr:`kc2spice.scene.parttype.PartType.example`, else of the first built-in scene that has one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

from kc2spice.core.foreign import parse_toml
from kc2spice.scene.keys import Key, model_keys
from kc2spice.scene.load import gallery, load_scene
from kc2spice.scene.model import Part, Scene, Terminal
from kc2spice.scene.parttype import PartType, part_types
from kc2spice.scene.short import SHORT


@dataclass(frozen=True)
class PartDoc:
    """One part type; ``scene`` is the built-in scene that the pins are taken from, if any."""

    name: str
    title: str
    doc: str
    pins: tuple[Terminal, ...]
    keys: tuple[Key, ...]
    example: str
    scene: str | None
    short_for: tuple[str, ...]


def part_docs() -> Iterator[PartDoc]:
    """All part types in the order of their names."""
    shown = _in_gallery()
    for name, kind in part_types().items():
        scene_name: str | None = None
        pins: tuple[Terminal, ...] = ()
        if kind.example:
            pins = _pins(load_scene({"name": "example", **parse_toml(kind.example)}), kind)
        elif name in shown:
            scene_name, part, scene = shown[name]
            pins = kind.pins(part, replace(scene, ports="all"))
        yield PartDoc(
            name,
            kind.title,
            " ".join((kind.schema.__doc__ or "").split()),
            pins,
            tuple(model_keys(kind.schema)),
            kind.example.strip(),
            scene_name,
            (SHORT[name],) if name in SHORT else (),
        )


def _pins(scene: Scene, kind: PartType) -> tuple[Terminal, ...]:
    return kind.pins(scene.of(kind.name)[0], replace(scene, ports="all"))


def _in_gallery() -> dict[str, tuple[str, Part, Scene]]:
    """The first built-in scene with a part of each type."""
    found: dict[str, tuple[str, Part, Scene]] = {}
    for name in gallery():
        scene = load_scene(name)
        for part in scene.parts.values():
            found.setdefault(part.type.name, (name, part, scene))
    return found
