"""Data flows one way: the packages' imports are this graph, and no module is in a circle."""

import ast
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

import kc2spice

ROOT = Path(kc2spice.__file__).parent
# What each package imports, for types and within functions too; nothing that it could do without.
MAY = {
    "core": "",
    "linalg": "core",
    "rom": "core linalg",
    "fem": "core linalg",
    "bodies": "core fem linalg netlist rom",
    "netlist": "core",
    "scene": "core netlist",
    "synthesis": "core netlist rom scene",
    "physics": "core netlist scene synthesis",
    "parts": "core fem netlist rom bodies scene synthesis physics",
    "sim": "core netlist scene",
    "reference": "core linalg",
    "equations": "core scene",
    "report": "core netlist scene",
    "workflow": "core linalg netlist rom fem bodies scene synthesis parts sim reference equations "
    "report",
    "api": "core netlist rom scene parts sim report workflow",
    "pyspice": "core netlist",
    "cli": "core netlist scene sim report workflow",
    "__main__": "core cli",
    "__init__": "core netlist rom bodies scene synthesis api workflow",
}
LAZY = ("gmsh", "PySpice", "matplotlib")


MODULES = {
    ".".join(path.relative_to(ROOT.parent).with_suffix("").parts).removesuffix(".__init__"): path
    for path in sorted(ROOT.rglob("*.py"))
}


def package(dotted):
    """``a`` of ``kc2spice.a.b``; ``__init__`` of the public face and of names that it has."""
    parts = dotted.split(".")
    return parts[1] if len(parts) > 1 and ".".join(parts[:2]) in MODULES else "__init__"


@cache
def walked(path):
    """Nodes at the top level of a module, its imports and its constants."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    kinds = ast.Import | ast.ImportFrom | ast.Constant
    return set(tree.body), [node for node in ast.walk(tree) if isinstance(node, kinds)]


def imports(path):
    """Dotted names that a module imports, with whether the import is at its top level.

    A name taken from a package is the submodule where there is one, else the package.
    """
    top, nodes = walked(path)
    for node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, node in top
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                yield full if full in MODULES else node.module, node in top


def graph():
    """Packages that each one imports from."""
    found = {}
    for name, path in MODULES.items():
        own = found.setdefault(package(name), set())
        own |= {package(o) for o, _ in imports(path) if o.split(".")[0] == "kc2spice"}
    return {name: others - {name} for name, others in found.items()}


def test_every_package_imports_only_allowed_packages():
    assert graph() == {name: set(others.split()) for name, others in MAY.items()}


def test_packages_form_no_circle():
    TopologicalSorter({name: others.split() for name, others in MAY.items()}).prepare()


def test_no_modules_import_each_other():
    """Over all imports: those within functions and those for types as well."""
    TopologicalSorter({
        name: {other for other, _ in imports(path) if other in MODULES and other != name}
        for name, path in MODULES.items()
    }).prepare()  # fmt: skip


@pytest.mark.parametrize("library", LAZY)
def test_heavy_libraries_have_one_lazy_home(library):
    homes = set()
    for name, path in MODULES.items():
        for other, top_level in imports(path):
            if other.split(".")[0] == library:
                homes.add(name)
                assert not top_level, f"{path} imports {other} at module level"
    assert len(homes) <= 1, f"{library} is imported in {sorted(homes)}"


def test_only_parts_name_part_types():
    """Deck, metrics, checks, sweeps and reports ask parts; the short form of a scene is the rest.

    Names that are words of other subjects as well (``mass``) are not looked for.
    """
    from support import load_part_types

    asking = {"scene", "synthesis", "sim", "report", "workflow", "cli", "api"}
    words = {"mass", "spring", "damper", "body", "netlist", "source", "sensor", "matrices",
             "resistor", "capacitor", "inductor", "bvd"}  # fmt: skip
    named = {
        f"{name}: {node.value!r}"
        for name, path in MODULES.items()
        if asking & set(name.split(".")[1:2]) and name != "kc2spice.scene.scene_classes"
        for node in walked(path)[1]
        if isinstance(node, ast.Constant) and node.value in set(load_part_types()) - words
    }
    assert not named
