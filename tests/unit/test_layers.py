"""Data flows one way: a module imports only from layers to its left."""

import ast
from pathlib import Path

import pytest

import kc2spice

ROOT = Path(kc2spice.__file__).parent
LAYERS = (
    "__init__", "core", "scene", "linalg", "fem", "rom", "bodies", "spice", "parts", "sim",
    "reference", "report", "workflow", "cli",
)  # fmt: skip
SAME_AS = {"__main__": "cli", "pyspice": "workflow"}
LAZY = ("gmsh", "PySpice", "matplotlib")
MODULES = sorted(ROOT.rglob("*.py"))


def layer(dotted):
    """Position of ``kc2spice.a.b`` in the order."""
    top = dotted.split(".")[1] if "." in dotted else "__init__"
    return LAYERS.index(SAME_AS.get(top, top))


def module_name(path):
    parts = path.relative_to(ROOT.parent).with_suffix("").parts
    return ".".join(parts)


def imports(path):
    """Dotted names that a module imports, with whether the import is at its top level."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    top = {id(node) for node in tree.body}
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield alias.name, id(node) in top
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            for alias in node.names if node.module == "kc2spice" else [None]:
                yield node.module if alias is None else f"kc2spice.{alias.name}", id(node) in top


@pytest.mark.parametrize("path", MODULES, ids=module_name)
def test_imports_point_left(path):
    own = module_name(path)
    for name, _ in imports(path):
        if name.split(".")[0] == "kc2spice" and not name.endswith("__version__"):
            assert layer(name) <= layer(own), f"{own} imports {name}"


@pytest.mark.parametrize("library", LAZY)
def test_heavy_libraries_have_one_lazy_home(library):
    homes = set()
    for path in MODULES:
        for name, top_level in imports(path):
            if name.split(".")[0] == library:
                homes.add(module_name(path))
                assert not top_level, f"{path} imports {name} at module level"
    assert len(homes) <= 1, f"{library} is imported in {sorted(homes)}"
