"""Descriptions of part types for the reference pages: pins, keys and examples."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

from kc2spice.core.toml_text import format_toml
from kc2spice.core.untrusted_files import parse_toml
from kc2spice.scene.catalogue import CataloguePart
from kc2spice.scene.keys import KeyDescription, list_part_keys
from kc2spice.scene.load import STRUCTURAL_KEYS, load_scene
from kc2spice.scene.parttype import find_part_type, load_part_types
from kc2spice.scene.probed_results import list_part_results
from kc2spice.scene.scene_classes import DEFAULT_TABLES, Part, Scene, Terminal
from kc2spice.scene.scene_file import list_gallery
from kc2spice.scene.table_advice import PARTS_COMMAND, make_unknown_type_error


@dataclass(frozen=True)
class PartTypeReference:
    """Description of a part type, with an example.

    ``optional_pins`` are pins that the example need not have, each with the key that adds the pin.
    ``origin_of_pins`` states where the pins of a part come from, if parts of this type can have
    different pins; otherwise it is empty. ``results`` are the names of the results of the example,
    without the name of the part. ``scene`` is the name of the built-in scene that contains the
    example, or None for other examples.
    """

    name: str
    title: str
    doc: str
    pins: tuple[Terminal, ...]
    keys: tuple[KeyDescription, ...]
    results: tuple[str, ...]
    example: str
    scene: str | None
    short_for: tuple[str, ...]
    optional_pins: Mapping[str, str]
    origin_of_pins: str


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
        raise make_unknown_type_error(name, "--part", advice)
    return _describe_type(name, {} if kind.example else _find_examples())


def write_catalogue_table(sold: CataloguePart) -> str:
    """Return the TOML table of a catalogue part in a scene, without joins of pins.

    Examples
    --------
    >>> from kc2spice.scene.catalogue import find_part
    >>> print(write_catalogue_table(find_part("7BB-12-9")).splitlines()[:3])
    ['[device]', 'part = "bvd"', 'number = "7BB-12-9"']
    """
    scene = load_scene(sold.number)
    part = scene.list_parts(sold.kind)[0]
    lines = [f"[{part.name}]", f'part = "{sold.kind}"']
    for key, value in scene.tables[part.name].items():
        if key not in STRUCTURAL_KEYS:
            lines.append(f"{key} = {format_toml(value)}")
    if sold.assumed:
        lines += textwrap.wrap(f"# assumed: {sold.assumed}", 98, subsequent_indent="# ")
    return "\n".join(lines)


def _describe_type(name: str, examples: Mapping[str, tuple[str, Part, Scene]]) -> PartTypeReference:
    """Return the description of a part type.

    ``examples`` maps each part type to an example in a built-in scene. An example consists of the
    name of the scene, the part, and the scene itself.
    """
    kind, scene_name = load_part_types()[name], None
    pins: tuple[Terminal, ...] = ()
    results: tuple[str, ...] = ()
    example = kind.example
    if example:
        scene = load_scene({"name": "example", **parse_toml(example)})
        part = scene.list_parts(name)[0]
        pins = kind.pins(part, replace(scene, ports="all"))
        results = list_part_results(part, scene)
    elif name in examples:
        scene_name, part, scene = examples[name]
        pins = kind.pins(part, replace(scene, ports="all"))
        results = list_part_results(part, scene)
        tables = list_gallery()[scene_name].read_text().split("\n\n")
        heading = rf"(#.*\n)*\[{part.name}[].]"
        example = "\n\n".join(table for table in tables if re.match(heading, table))
    return PartTypeReference(
        name,
        kind.title,
        " ".join((kind.schema.__doc__ or "").split()),
        pins,
        tuple(list_part_keys(kind.schema)),
        results,
        example.strip(),
        scene_name,
        (DEFAULT_TABLES[name],) if name in DEFAULT_TABLES else (),
        {pin: key for pin, key in kind.optional_pins.items() if pin not in {t.name for t in pins}},
        kind.origin_of_pins,
    )


def _find_examples() -> dict[str, tuple[str, Part, Scene]]:
    """Return one example of each part type from the built-in scenes, keyed by type."""
    result: dict[str, tuple[str, Part, Scene]] = {}
    for name in list_gallery():
        scene = load_scene(name)
        for part in scene.parts.values():
            result.setdefault(part.type.name, (name, part, scene))
    return result
