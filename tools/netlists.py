"""Write netlists/ anew, or pack its symbols and libraries for a release.

    python tools/netlists.py                               # all that is committed
    python tools/netlists.py build/kc2spice_symbols.zip    # a package for KiCad

Committed are the ngspice deck and the libraries of every scene (scenes of the same actuators share
one folder and its libraries), one KiCad symbol library for all of them, and as examples the files
for KiCad, LTspice, Xyce and Verilog-A of two scenes in docs/examples/dialects; ``kc2spice export``
writes these of any scene. KiCad finds the models by a path variable of the user's,
``KC2SPICE_NETLISTS`` (Preferences, Configure Paths): the folder
``libraries`` of the package, or ``netlists`` of a checkout.
"""

from __future__ import annotations

import argparse
import json
import re
import shutil
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import kc2spice
from kc2spice.core.files import HASHES_FILE
from kc2spice.netlist import read_lib
from kc2spice.netlist.card_parser import split_statements
from kc2spice.netlist.printers.dialect_registry import NGSPICE, list_dialect_names
from kc2spice.netlist.printers.kicad import (
    Symbol,
    draw_part_symbol,
    format_symbol_library,
    make_element_symbols,
)
from kc2spice.scene.load import load_scene
from kc2spice.scene.scene_classes import Part, Scene
from kc2spice.scene.scene_file import list_gallery
from kc2spice.workflow.export import export_scene

ROOT = Path(__file__).parents[1]
NETLISTS, EXAMPLES = ROOT / "netlists", ROOT / "docs" / "examples" / "dialects"
SYMBOLS, PAGE = NETLISTS / "kc2spice.kicad_sym", NETLISTS / "README.md"
SHOWN = ("impact", "buzzer_7bb_20_6")  # the scenes that stand in every dialect
RANGES = Path(__file__).with_name("netlist_ranges.toml")
SOUND_TYPES = ("radiation", "listener")
FOLDER = "${KC2SPICE_NETLISTS}"
# Scenes in the folder of another one, with which they have their libraries in common.
SHARED = {
    "amplifier_kick": "kick_and_catch",
    "charge_kick": "bring_your_own",
    "half_bridge_kick": "bring_your_own",
    "three_cycles": "bring_your_own",
}
METADATA = {
    "$schema": "https://go.kicad.org/pcm/schemas/v1",
    "name": "kc2spice actuators",
    "description": "Piezoelectric and electromagnetic actuators with their drivers, for simulation",
    "description_full": "Reduced finite-element models with certified errors, contacts, drivers.",
    "identifier": "org.kc2spice.symbols",
    "type": "library",
    "author": {"name": "kc2spice contributors", "contact": {}},
    "license": "GPL-3.0",
    "resources": {},
    "versions": [
        {"version": kc2spice.__version__, "status": "testing", "kicad_version": "8.0"}
    ],
}  # fmt: skip
TABLE = re.compile(r"(?s)(<!-- parts -->\n).*(<!-- end of parts -->)")
TABLE_HEAD = """| library | part | pins (1 V is, 1 A is) | signs | rating |
|---|---|---|---|---|
"""


def shipped(scene: str) -> Scene:
    """The scene whose libraries are committed, with the parameters of :data:`RANGES`."""
    table = tomllib.loads(RANGES.read_text(encoding="utf-8"))
    plain, changes = load_scene(scene), dict[str, Any]()
    for name, ranges in table.get(scene, {}).items():
        part: Part[Any] = plain.parts[name]
        for number, layer in enumerate(part.keys.layers):
            material = layer.material  # a material by its name has no keys that could vary
            named = {"like": material} if isinstance(material, str) else material
            changes[f"{name}.layers[{number}].material"] = named
        target = part.type.choose_reduction(part, plain)
        assert target is not None, f"{name} has no reduced model"
        band = list(target.band)
        rom = {"tolerance": table["tolerance"], "band": band, "parameters": ranges}
        changes[f"{name}.rom"] = rom
    return load_scene(plain, changes) if changes else plain


def without_sound(scene: Scene) -> Scene:
    """The scene without its acoustic parts, for examples of other dialects with electrical pins."""
    silent = {name for name, part in scene.parts.items() if part.type.name in SOUND_TYPES}
    tables = {name: table for name, table in scene.tables.items() if name not in silent}
    for name in scene.parts.keys() & tables.keys():
        pins = tables[name].get("pins", {})
        joined = {pin: target for pin, target in pins.items() if not _names(target, silent)}
        tables[name] = {**tables[name], "pins": joined}
    heard = {}
    for name, probe in scene.tables.get("probes", {}).items():
        if not _names(probe["of"], silent):
            heard[name] = probe
    return load_scene({**tables, "probes": heard, "title": scene.title.replace(" and sound", "")})


def _names(target: str, parts: set[str]) -> bool:
    """Whether a pin or a result belongs to one of these parts."""
    return target.partition(".")[0] in parts


def scene_files(scene: str, out: Path) -> list[Path]:
    """Deck and libraries of a scene, written into ``out``: what ngspice needs of an export."""
    written = export_scene(shipped(scene), out)
    kept = [p for p in written if p.suffix == ".cir" or _is_library(p)]
    for path in {*written, out / HASHES_FILE} - set(kept):
        path.unlink()
    return kept


def example_files(scene: str, out: Path) -> None:
    """A scene in every other dialect: KiCad's project and LTspice's libraries stand alone, too."""
    plain = without_sound(load_scene(scene))
    for dialect in filter(NGSPICE.__ne__, list_dialect_names()):
        export_scene(plain, out / dialect, dialect)
        (out / dialect / HASHES_FILE).unlink()
    with TemporaryDirectory() as place:
        (out / "kicad").mkdir()
        for path in export_scene(plain, Path(place)):
            if "kicad" in path.name or path.suffix in (".wbk", "") or _is_library(path):
                shutil.copy(path, out / "kicad")


def libraries() -> list[Path]:
    """The library files of all scenes."""
    return sorted(NETLISTS.glob("*/*.lib"))


def _is_library(path: Path) -> bool:
    return path.suffix == ".lib" and not path.name.endswith(".ltspice.lib")


def folder(scene: str) -> Path:
    """Where the files of a scene are committed."""
    return NETLISTS / SHARED.get(scene, scene)


def cards(path: Path) -> tuple[str, ...]:
    """The cards of a netlist without its comments."""
    found = split_statements(path.read_text(encoding="utf-8"), path.name)
    return tuple(s.written for s in found if s.written)


def symbols() -> Iterator[Symbol]:
    """One symbol for each design: under its part's name, or with the scene's where two differ."""
    designs: dict[str, dict[tuple[str, ...], Path]] = {}
    for path in libraries():
        for part in read_lib(path):
            designs.setdefault(part.name, {}).setdefault(cards(path), path)
    for name, found in designs.items():
        for path in found.values():
            (part,) = (each for each in read_lib(path) if each.name == name)
            drawn = draw_part_symbol(part)
            own = {"Sim.Library": f"{FOLDER}/{path.parent.name}/{path.name}"}
            own["Description"] = f"{drawn.fields['Description']} ({path.parent.name})"
            unique = name if len(found) == 1 else f"{name}_{path.parent.name}"
            yield replace(drawn, name=unique, fields=drawn.fields | own)


def all_symbols() -> str:
    """All designs and what stands on a sheet besides."""
    plain = {symbol.name: symbol for symbol in make_element_symbols().values()}
    return format_symbol_library([*symbols(), *plain.values()])


def page() -> str:
    """netlists/README.md with the table of parts, from the heads of the libraries."""
    ours = (path for path in reversed(libraries()) if "* tool:" in path.read_text("utf-8"))
    designs: dict[tuple[str, ...], dict[str, str]] = {}
    for path in ours:
        rating, *row = _row(path)
        designs.setdefault(tuple(row), {}).setdefault(_kind(path), rating)
    rows = TABLE_HEAD + "".join(sorted(_line(row, kinds) for row, kinds in designs.items()))
    return TABLE.sub(lambda match: match[1] + rows + match[2], PAGE.read_text(encoding="utf-8"))


def _kind(path: Path) -> str:
    """``sphere.lib`` for ``sphere3.lib``; part numbers stay."""
    return re.sub(r"(?<=[a-z])\d+\.lib$", ".lib", path.name)


def _line(row: tuple[str, ...], kinds: dict[str, str]) -> str:
    """The libraries of one design as a line of the table."""
    ratings = set(kinds.values())
    rating = ratings.pop() if len(ratings) == 1 else "stated in each header"
    cells = (", ".join(f"`{kind}`" for kind in sorted(kinds)), *row, rating)
    return "| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |\n"


def _row(path: Path) -> tuple[str, ...]:
    """Rating, title, pins and signs of a library, as its head states them."""
    text = path.read_text(encoding="utf-8")
    lines = text.partition(".subckt")[0].replace("\n*   ", " ")  # of more than one line each
    head = dict(re.findall(r"(?m)^\* (\w[\w-]*): (.+)$", lines))
    title = lines.partition("\n")[0].partition(": ")[2]
    return head["rating"], title, _pins(text), head["sign"]


def _pins(text: str) -> str:
    """Each pin with what one volt and one ampere are there; rings and ports of a kind once."""
    found = re.findall(r"(?m)^\* @pin \d+ (\S+) unit=(\S+) flow=(\S+)", text)
    rows = {re.sub(r"\d+$", "*", name): (unit, flow) for name, unit, flow in found}
    return ", ".join(f"`{name}` ({unit}, {flow})" for name, (unit, flow) in rows.items())


def write() -> None:
    """Everything that is committed."""
    for old in [path for path in NETLISTS.iterdir() if path.is_dir()]:
        shutil.rmtree(old)
    for scene in sorted(list_gallery(), key=lambda name: (name in SHARED, name)):
        print(f"{scene}: {commit(scene)} files", flush=True)
    SYMBOLS.write_text(all_symbols(), encoding="utf-8")
    PAGE.write_text(page(), encoding="utf-8")
    shutil.rmtree(EXAMPLES, ignore_errors=True)
    for scene in SHOWN:
        (EXAMPLES / scene).mkdir(parents=True)
        example_files(scene, EXAMPLES / scene)


def commit(scene: str) -> int:
    """Number of the files of a scene that its folder has not got yet, once they are there."""
    if scene not in SHARED:
        return len(scene_files(scene, folder(scene)))
    with TemporaryDirectory() as place:
        files = scene_files(scene, Path(place))
        for path in files:
            there = folder(scene) / path.name
            if there.exists() and cards(there) != cards(path):
                sys.exit(f"{scene}: {path.name} is another one than in {folder(scene)}")
        new = [path for path in files if not (folder(scene) / path.name).exists()]
        for path in new:
            shutil.copy(path, folder(scene))
        return len(new)


def package(target: Path) -> None:
    """The symbols and what they simulate, for KiCad's Plugin and Content Manager."""
    target.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("metadata.json", json.dumps(METADATA, indent=2) + "\n")
        archive.write(SYMBOLS, "symbols/kc2spice.kicad_sym")
        for path in libraries():
            archive.write(path, f"libraries/{path.parent.name}/{path.name}")


if __name__ == "__main__":
    options = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    options.add_argument("package", type=Path, nargs="?", help="write this .zip instead")
    target = options.parse_args().package
    package(target) if target else write()
