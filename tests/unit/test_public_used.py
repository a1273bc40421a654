"""Nothing in the package is public for its tests alone."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import kc2spice

PACKAGE = Path(kc2spice.__file__).parent
# What users call and the package itself may not: methods of the classes that it exports.
API = frozenset(kc2spice.__all__)
# A quantity of a material that belongs to the others beside it.
ALSO = frozenset({"eps_T"})
# Called by their names by somebody else: the interpreter, Jupyter, pydantic, ctypes, jinja.
DECORATED = frozenset({"property", "cached_property", "staticmethod", "classmethod", "cache",
                       "lru_cache", "dataclass", "contextmanager", "overload"})  # fmt: skip


def definitions(tree: ast.Module) -> Iterator[tuple[str, bool]]:
    """Public functions, classes and methods of a module, and whether somebody else registers them.

    Methods of exported classes are the API itself and left out.
    """
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)
    for node in tree.body:
        if not isinstance(node, kinds) or node.name in API:
            continue
        inner = node.body if isinstance(node, ast.ClassDef) else []
        for each in (node, *(item for item in inner if isinstance(item, kinds[:2]))):
            if not each.name.startswith("_") and each.name not in ALSO:
                yield each.name, any(_name(d) not in DECORATED for d in each.decorator_list)


def _name(decorator: ast.expr) -> str:
    target = decorator.func if isinstance(decorator, ast.Call) else decorator
    return target.attr if isinstance(target, ast.Attribute) else getattr(target, "id", "")


def uses(tree: ast.Module) -> Iterator[str]:
    """Names that a module mentions other than by defining or importing them, and plain strings."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.alias) and node.asname:
            yield node.name
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield from re.findall(r"\w+", node.value) if len(node.value) < 80 else ()


def unused(sources: dict[str, str], others: str) -> list[str]:
    """``module: name`` of what neither ``sources`` nor the words of ``others`` mention."""
    trees = {name: ast.parse(text) for name, text in sources.items()}
    known = {word for tree in trees.values() for word in uses(tree)}
    known |= set(re.findall(r"\w+", others))
    return sorted(
        f"{module}: {name}"
        for module, tree in trees.items()
        for name, registered in definitions(tree)
        if not registered and name not in known
    )


def test_everything_public_is_used_by_the_package_itself():
    files = sorted(PACKAGE.rglob("*.py"))
    sources = {str(path.relative_to(PACKAGE)): path.read_text(encoding="utf-8") for path in files}
    root = PACKAGE.parent
    others = [*PACKAGE.rglob("*.j2"), *(root / "tools").glob("*.py"), root / "pyproject.toml"]
    words = " ".join(path.read_text(encoding="utf-8") for path in others)
    assert unused(sources, words) == []


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("def f(): ...", ["m: f"]),
        ("def f(): ...\nf()", []),
        ("def _f(): ...", []),
        ("class A:\n    def g(self): ...\nA()", ["m: g"]),
        ("import app\n@app.command()\ndef f(): ...", []),
        ("@cache\ndef f(): ...", ["m: f"]),
        ("from n import f", []),
    ],
)
def test_what_the_check_sees(source, found):
    assert unused({"m": source}, "") == found
