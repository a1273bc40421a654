"""Pages of the site that are generated: parts, scenes, commands and examples.

A hook of mkdocs (see mkdocs.yml); ``make docs`` builds the site.
"""

from __future__ import annotations

import ast
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
COMMANDS = (
    "run",
    "export",
    "reduce",
    "verify",
    "bench",
    "fit",
    "sweep",
    "explain",
    "scenes",
    "parts",
    "doctor",
)


def on_files(files: Files, config: Any) -> Files:
    """Add the generated pages."""
    pages = {
        "parts.md": parts_page(),
        "domains.md": domains_page(),
        "scenes.md": scenes_page(),
        "cli.md": commands_page(),
        "examples.md": examples_page(),
    }
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def parts_page() -> str:
    """Every part type with its pins, keys and a table that shows it."""
    from kc2spice.scene.part_type_descriptions import describe_part_types

    return "\n".join([
        "# Parts",
        "",
        "A table with `part = \"TYPE\"` in a scene is a part; its name is that of the table. The "
        "columns *1 V is* and *1 A is* state the meaning of a volt and an ampere on a pin in the "
        "netlist; a signal carries no current. `pins = { PIN = \"part.pin\" }` joins pins. A pin "
        "with a default may be left out. `kc2spice scenes --part TYPE` prints the same.",
        "",
        *(line for doc in describe_part_types() for line in _select_unknowns(doc)),
    ])  # fmt: skip


def _select_unknowns(doc: Any) -> Iterator[str]:
    yield f"## {doc.name}\n\n{doc.title[:1].upper()}{doc.title[1:]}. {doc.doc}\n"
    if doc.short_for:
        tables = " or ".join(f"`[{name}]`" for name in doc.short_for)
        yield f"A table {tables} without the key `part` has this type.\n"
    if doc.pins:
        rows = [(f"`{p.name}`", p.unit, p.flow, p.default or ("required" if p.required else ""))
                for p in doc.pins]  # fmt: skip
        yield _table(("pin", "1 V is 1", "1 A is 1", "default"), rows)
        if doc.scene:
            yield f"Pins as in the built-in scene `{doc.scene}`.\n"
        if doc.origin_of_pins:
            yield f"These are the pins of the example. {doc.origin_of_pins}\n"
    else:
        yield "Its pins follow from its keys.\n"
    if doc.optional_pins:
        pairs = [(f"`{pin}`", f"`{key}`") for pin, key in doc.optional_pins.items()]
        yield _table(("optional pin", "added by the key"), pairs)
    if doc.keys:
        yield _keys(doc.keys)
    if doc.results:
        names = ", ".join(f"`PART.{name}`" for name in doc.results)
        yield f"Results of the example, for a part with the name PART: {names}.\n"
    if doc.example:
        yield f"```toml\n{doc.example}\n```\n"


def domains_page() -> str:
    """Quantities, units, power and rest of every physical domain."""
    from kc2spice.core.domains import CONSERVATIVE, QUANTITIES
    from kc2spice.physics.declaration import COORDINATES

    head = ("domain", "1 V is", "1 A is", "power into a part", "sources", "branches", "port")
    rows = []
    for domain in CONSERVATIVE:
        quantities = [quantity.name for quantity, _ in domain.quantities]
        names = [name for name in quantities if QUANTITIES[name][0] is domain]
        branches = [f"`{name}`" for name in names if name in COORDINATES]
        port = f"`{domain.port}`" if domain.port else ""
        sources = ", ".join(f"`{name}`" for name in names)
        units = tuple(f"1 {unit}" for unit in domain.units)
        rows.append((domain.name, *units, domain.power, sources, ", ".join(branches), port))
    rest = [f"- {domain.name}: {domain.rest}." for domain in CONSERVATIVE]
    paths = [
        f"- {domain.name}: {domain.path_to_reference}"
        for domain in CONSERVATIVE
        if domain.path_to_reference
    ]
    return "\n".join([
        "# Physical domains",
        "",
        "Every pin of a netlist belongs to a domain. A voltage on the pin is the quantity *across* "
        "it and a current is the quantity *through* it. Only pins of one domain can be joined. A "
        "pin of translation may carry a velocity instead of a displacement; 1 V is then 1 m/s.",
        "",
        _table(head, rows),
        "*Sources* are values of the key `kind` of the part `source`. *Branches* are arguments of "
        "`kc2spice.physics.branch` in a [declaration](reference/declarations.md). *Port* is the "
        "`kind` of a port in [matrices](reference/matrices.md). Results and keys are in SI units.",
        "",
        "The quantity across a pin counts from the pin `base`, of heat and sound from the pin "
        "`ambient`, and electrical ports are pairs of pins. If `ambient` is on node 0, "
        "temperatures are rises over the surroundings. A source of temperature there makes them "
        "absolute.",
        "",
        "Probes read `PART.power` and `PART.PIN.power` [W], and `PART.PIN.QUANTITY` with the name "
        "of the quantity through the pin, such as `chip.tip.force` or `slab.top.heat_flow`. "
        "`PART.power` is the sum over the electrical pins of a part, otherwise over those of the "
        "domain of its first pin. The power of an element is what flows into it between its pins; "
        "that of a thermal element is the heat that flows through it.",
        "",
        "## At rest",
        "",
        "An operating point is the state in which nothing changes:",
        "",
        *rest,
        "",
        "Without a path to its reference a net of these domains has no operating point. A scene "
        "that needs one is refused; pulses that begin after t = 0 are stored. A path is:",
        "",
        *paths,
        "",
        "## Add a domain",
        "",
        "A domain is one row of the table in `kc2spice/core/domains.py`. Its two-terminal parts "
        "are rows of the table in `kc2spice/parts/electronics/two_terminal_types.py`. "
        "`tests/unit/test_new_domain.py` adds a row and uses it in all of these places.",
        "",
    ])  # fmt: skip


def scenes_page() -> str:
    """The built-in scenes, and the keys outside of parts."""
    from kc2spice.scene.keys import list_schema_keys
    from kc2spice.scene.load import load_scene
    from kc2spice.scene.scene_file import list_gallery
    from kc2spice.scene.settings import SceneKeys

    loaded = {name: load_scene(name) for name in list_gallery()}
    rows = [
        (f"`{name}`", s.title, s.analysis.type, ", ".join(dict.fromkeys(
            f"[{p.type.name}](parts.md#{p.type.name})" for p in s.parts.values())))
        for name, s in loaded.items()
    ]  # fmt: skip
    text = (ROOT / "kc2spice" / "scenes" / "buzzer_7bb_20_6.toml").read_text("utf-8")
    return "\n".join([
        "# Scenes and keys\n",
        "A scene is a TOML file with parts, joined pins, an analysis and probes. A "
        "number is in SI units, a string has its unit (`\"25 us\"`). A complete scene:\n",
        f"```toml\n{text.strip()}\n```\n",
        "## Built-in scenes\n",
        _table(("scene", "what", "analysis", "parts"), rows),
        "## Keys outside of parts\n",
        "The page [Parts](parts.md) lists the keys of each part type.\n",
        _keys(list(list_schema_keys(SceneKeys))),
    ])  # fmt: skip


def commands_page() -> str:
    """The help of every command."""
    pages = [
        f"## {command}\n\n```text\n{_help(command)}\n```\n"
        for command in COMMANDS
    ]  # fmt: skip
    return "\n".join(["# Command line\n", f"```text\n{_help()}\n```\n", *pages])


def _help(*command: str) -> str:
    done = subprocess.run(
        [sys.executable, "-m", "kc2spice", *command, "--help"],
        capture_output=True, text=True, check=True, cwd=ROOT,
    )  # fmt: skip
    return done.stdout.strip()


def examples_page() -> str:
    """All files of docs/examples."""
    parts = [
        "# Examples\n",
        "Each example is a file of `docs/examples` that runs without changes.\n",
    ]
    for path in example_files():
        source = path.read_text("utf-8")
        title = (ast.get_docstring(ast.parse(source)) or path.stem).split("\n")[0]
        head = title.split(":")[0]
        parts.append(f"## {head}\n\n`{path.name}`\n\n```python\n{source.strip()}\n```\n")
    return "\n".join(parts)


def example_files() -> list[Path]:
    """The examples, the first run first."""
    found = (ROOT / "docs" / "examples").glob("*.py")
    return sorted(found, key=lambda path: (path.stem != "first_run", path.stem))


def _keys(keys: Any) -> str:
    rows = []
    for key in keys:
        default = "" if key.default is None else f"`{key.default}`"
        said = " ".join(filter(None, [", ".join(f"`{c}`" for c in key.choices), key.doc]))
        rows.append((f"`{key.name}`", key.unit or "", default, said))
    return _table(("key", "unit", "default", "meaning"), rows)


def _table(head: tuple[str, ...], rows: Sequence[tuple[str, ...]]) -> str:
    def line(cells: tuple[str, ...]) -> str:
        return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |"

    return "\n".join([line(head), "|" + "---|" * len(head), *map(line, rows), ""])
