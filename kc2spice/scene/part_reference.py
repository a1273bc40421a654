"""Descriptions of part types for the reference: pins, keys and examples."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from kc2spice.core.errors import unknown
from kc2spice.core.untrusted_files import parse_toml
from kc2spice.scene.keys import KeyDescription, list_schema_keys
from kc2spice.scene.load import PARTS_COMMAND, load_scene
from kc2spice.scene.model import DEFAULT_TABLES, Part, Scene, Terminal
from kc2spice.scene.parttype import find_part_type, list_type_names, load_part_types
from kc2spice.scene.scene_file import list_gallery


@dataclass(frozen=True)
class PartTypeReference:
    """Description of a part type, with an example.

    ``scene`` is the name of the built-in scene that contains the example, or None for other
    examples.
    """

    name: str
    title: str
    doc: str
    pins: tuple[Terminal, ...]
    keys: tuple[KeyDescription, ...]
    example: str
    scene: str | None
    short_for: tuple[str, ...]


def describe_part_types() -> Iterator[PartTypeReference]:
    """Yield the descriptions of all part types, sorted by name."""
    examples = _find_examples()
    for name in load_part_types():
        yield _describe_type(name, examples)


def describe_part_type(name: str) -> PartTypeReference:
    """Return the description of one part type.

    Raises
    ------
    UsageError : no part type has the given name.

    Examples
    --------
    >>> reference = describe_part_type("resistor")
    >>> [pin.name for pin in reference.pins]
    ['a', 'b']
    """
    kind = find_part_type(name)
    if kind is None:
        advice = f"run {PARTS_COMMAND}, which lists all types"
        raise unknown(
            "this part type does not exist",
            name,
            list_type_names(),
            "--part",
            PARTS_COMMAND,
            advice=advice,
        )
    return _describe_type(name, {} if kind.example else _find_examples())


def _describe_type(name: str, examples: Mapping[str, tuple[str, Part, Scene]]) -> PartTypeReference:
    """Return the description of a part type.

    ``examples`` maps part types to examples in built-in scenes: name of the scene, part, and scene.
    """
    kind, scene_name = load_part_types()[name], None
    pins: tuple[Terminal, ...] = ()
    example = kind.example
    if example:
        scene = load_scene({"name": "example", **parse_toml(example)})
        pins = kind.pins(scene.list_parts(name)[0], replace(scene, ports="all"))
    elif name in examples:
        scene_name, part, scene = examples[name]
        pins = kind.pins(part, replace(scene, ports="all"))
        tables = list_gallery()[scene_name].read_text().split("\n\n")
        heading = rf"(#.*\n)*\[{part.name}[].]"
        example = "\n\n".join(table for table in tables if re.match(heading, table))
    return PartTypeReference(
        name,
        kind.title,
        " ".join((kind.schema.__doc__ or "").split()),
        pins,
        tuple(list_schema_keys(kind.schema)),
        example.strip(),
        scene_name,
        (DEFAULT_TABLES[name],) if name in DEFAULT_TABLES else (),
    )


def _find_examples() -> dict[str, tuple[str, Part, Scene]]:
    """Return one example of each part type from the built-in scenes, keyed by type."""
    result: dict[str, tuple[str, Part, Scene]] = {}
    for name in list_gallery():
        scene = load_scene(name)
        for part in scene.parts.values():
            result.setdefault(part.type.name, (name, part, scene))
    return result
