"""Nothing in the package is public for its tests alone.

A function or class is used where another one of its module mentions it, or a module that imports
its module or something of it; a method where some attribute has its name.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import kc2spice

PACKAGE = Path(kc2spice.__file__).parent
# Other decorators hand a function to somebody else, who calls it: jinja, typer, pydantic.
DECORATED = {"property", "cached_property", "staticmethod", "classmethod", "cache", "lru_cache",
             "dataclass", "contextmanager", "overload"}  # fmt: skip
# A quantity of a material that belongs to the others beside it.
ALSO = {"eps_T"}
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)


def public(body: list[ast.stmt], kinds: tuple[type, ...]) -> Iterator:
    """Public definitions among statements, without those that a decorator registers."""
    for node in body:
        if isinstance(node, kinds) and node.name[0] != "_":
            called = [d.func if isinstance(d, ast.Call) else d for d in node.decorator_list]
            if {getattr(c, "attr", getattr(c, "id", "")) for c in called} <= DECORATED:
                yield node


def mentions(node: ast.AST) -> Iterator[str]:
    """Names in a piece of code, and strings, of ``module:function`` the function."""
    for inner in ast.walk(node):
        if isinstance(inner, ast.Name):
            yield inner.id
        elif isinstance(inner, ast.Attribute):
            yield inner.attr
        elif isinstance(inner, ast.alias):
            yield inner.name
        elif isinstance(inner, ast.Constant) and isinstance(inner.value, str):
            yield inner.value.rpartition(":")[2]


def imported(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            yield from (node.module, *(f"{node.module}.{alias.name}" for alias in node.names))
        elif isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value.partition(":")[0]  # a module that is called in a child


def test_every_public_name_is_used_in_the_package():
    root = PACKAGE.parent
    trees = {
        ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__"): ast.parse(
            path.read_text(encoding="utf-8")
        )
        for path in [*PACKAGE.rglob("*.py"), *(root / "tools").glob("*.py")]
    }
    said = {name: {node: set(mentions(node)) for node in tree.body} for name, tree in trees.items()}
    needs = {name: set(imported(tree)) for name, tree in trees.items()}
    others = [*PACKAGE.rglob("*.j2"), root / "pyproject.toml"]
    words = set(re.findall(r"\w+", " ".join(path.read_text(encoding="utf-8") for path in others)))
    nodes = [node for tree in trees.values() for node in ast.walk(tree)]
    called = words | ALSO | {node.attr for node in nodes if isinstance(node, ast.Attribute)}
    called |= {node.value for node in nodes if isinstance(node, ast.Constant)}
    names = [name for name in kc2spice.__all__ if name != "errors"]
    api = {(getattr(kc2spice, name).__module__, name) for name in names}
    api.add(("kc2spice.pyspice", "pyspice_subcircuit"))  # another module for users
    found = []
    for module, tree in trees.items():
        for node in public(tree.body, (*FUNCTIONS, ast.ClassDef)):
            if (module, node.name) in api:
                continue
            beside = [said[module][other] for other in tree.body if other is not node]
            for other in trees:
                beside += said[other].values() if module in needs[other] else ()
            if node.name not in words.union(*beside):
                found.append(f"{module}: {node.name}")
            if isinstance(node, ast.ClassDef):
                methods = (method.name for method in public(node.body, FUNCTIONS))
                found += [f"{module}: {node.name}.{m}" for m in methods if m not in called]
    assert [line for line in found if line.startswith("kc2spice")] == []
