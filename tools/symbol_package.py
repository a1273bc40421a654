"""All parts of netlists/ as one KiCad symbol library with its models: a package for a release.

    python tools/symbol_package.py build/kc2spice_symbols.zip

KiCad finds the models by a path variable of the user's, ``KC2SPICE_NETLISTS`` (Preferences,
Configure Paths): the folder ``libraries`` of the package, or ``netlists`` of a checkout.
"""

from __future__ import annotations

import json
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import kc2spice
from kc2spice.spice import read_lib
from kc2spice.spice.box import layout
from kc2spice.spice.kicad import Symbol, element_symbols, library, part_symbol

NETLISTS = Path(__file__).parents[1] / "netlists"
FOLDER = "${KC2SPICE_NETLISTS}"
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


def libraries() -> list[Path]:
    """The library files of all scenes; LTspice has its own."""
    return [p for p in sorted(NETLISTS.glob("*/*.lib")) if not p.name.endswith(".ltspice.lib")]


def symbols() -> Iterator[Symbol]:
    """One symbol for each subcircuit; its name is unique, so that all fit into one library."""
    seen: set[str] = set()
    for path in libraries():
        for part in read_lib(path):
            if part.name not in seen:
                seen.add(part.name)
                drawn = part_symbol(layout(part))
                where = {"Sim.Library": f"{FOLDER}/{path.parent.name}/{path.name}"}
                title = f"{drawn.fields['Description']} ({path.parent.name})"
                yield replace(drawn, fields=drawn.fields | where | {"Description": title})


def main(target: Path) -> None:
    """Write the package."""
    plain = {symbol.name: symbol for symbol in element_symbols().values()}
    target.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as package:
        package.writestr("metadata.json", json.dumps(METADATA, indent=2) + "\n")
        package.writestr("symbols/kc2spice.kicad_sym", library([*symbols(), *plain.values()]))
        for path in libraries():
            package.write(path, f"libraries/{path.parent.name}/{path.name}")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
