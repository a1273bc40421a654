"""Nothing in the package is public for its tests alone.

A function or class is used where some module imports that very object, reaches it through its
imported module, or mentions it beside its definition; a method where some attribute has its name.
"""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

import kc2spice

PACKAGE = Path(kc2spice.__file__).parent
# Called by their names by somebody else: the interpreter, Jupyter, pydantic, ctypes, jinja.
DECORATED = frozenset({"property", "cached_property", "staticmethod", "classmethod", "cache",
                       "lru_cache", "dataclass", "contextmanager", "overload"})  # fmt: skip
# A quantity of a material that belongs to the others beside it.
ALSO = frozenset({"eps_T"})
MENTIONS = (ast.Import, ast.ImportFrom, ast.Name, ast.Attribute, ast.Constant, ast.JoinedStr)
FUNCTIONS = (ast.FunctionDef, ast.AsyncFunctionDef)
Object = tuple[str, str]  # a module and a name in it


def registered(node: ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef) -> bool:
    """Whether a decorator hands it to somebody else."""
    targets = [d.func if isinstance(d, ast.Call) else d for d in node.decorator_list]
    names = {t.attr if isinstance(t, ast.Attribute) else getattr(t, "id", "") for t in targets}
    return not names <= DECORATED


def public(tree: ast.Module) -> Iterator[tuple[str, list[str]]]:
    """Functions and classes of a module, each with its public methods."""
    for node in tree.body:
        if isinstance(node, (*FUNCTIONS, ast.ClassDef)) and not registered(node):
            inner = node.body if isinstance(node, ast.ClassDef) else []
            methods = [item for item in inner if isinstance(item, FUNCTIONS)]
            own = [m.name for m in methods if m.name[0] != "_" and not registered(m)]
            yield node.name, own


def dots(node: ast.expr) -> str:
    """``a.b`` as it is written; empty of anything that is no such path."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and (path := dots(node.value)):
        return f"{path}.{node.attr}"
    return ""


def walked(tree: ast.Module) -> list[tuple[str | None, ast.AST]]:
    """Every node, with the name of the function or class at the top level that it is in."""
    return [
        (getattr(top, "name", None), node)
        for top in tree.body for node in ast.walk(top)
        if isinstance(node, MENTIONS)
    ]  # fmt: skip


def uses(module: str, nodes: list, known: set[str]) -> Iterator[Object]:
    """What a module imports, reaches through a module that it imported, and mentions itself."""
    modules: dict[str, str] = {}
    words = [node.value for _, node in nodes if isinstance(node, ast.Constant)]
    for _, node in nodes:
        if isinstance(node, ast.Import):
            for alias in node.names:
                modules[alias.asname or alias.name] = alias.name
        elif isinstance(node, ast.ImportFrom):
            for alias in node.names:
                full = f"{node.module}.{alias.name}"
                if full in known:
                    modules[alias.asname or alias.name] = full
                else:
                    yield node.module or "", alias.name
    for own, node in nodes:
        if isinstance(node, ast.Name) and node.id != own:
            yield module, node.id
        elif isinstance(node, ast.Attribute) and (path := dots(node.value)):
            yield modules.get(path, path), node.attr
        elif isinstance(node, ast.JoinedStr):  # "module:function", called in a child
            home, _, entry = ast.unparse(node)[2:-1].partition(":")
            home = home.replace("{__name__}", module)
            yield from ((home, name) for name in (words if "{" in entry else [entry]))


def attributes(nodes: list) -> Iterator[str]:
    """Names behind a dot, and those that ``getattr`` and its like are given."""
    for _, node in nodes:
        if isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value


def unused(sources: dict[str, str], others: str = "", api: frozenset[Object] = frozenset()):
    """``module: name`` of what neither ``sources`` nor the words of ``others`` use.

    ``api`` is used by users, with all methods.
    """
    trees = {name: ast.parse(text) for name, text in sources.items()}
    nodes = {name: walked(tree) for name, tree in trees.items()}
    used = {one for name, own in nodes.items() for one in uses(name, own, set(trees))} | api
    called = {word for own in nodes.values() for word in attributes(own)}
    words = set(re.findall(r"\w+", others))
    called |= words
    for module, tree in trees.items():
        for name, methods in public(tree):
            if name[0] != "_" and (module, name) not in used and name not in others:
                yield f"{module}: {name}"
            if (module, name) not in api:
                yield from (f"{module}: {name}.{m}" for m in methods if m not in called | ALSO)


def dotted(path: Path, root: Path) -> str:
    return ".".join(path.relative_to(root).with_suffix("").parts).removesuffix(".__init__")


def test_everything_public_is_used_by_the_package_itself():
    root = PACKAGE.parent
    files = [*PACKAGE.rglob("*.py"), *(root / "tools").glob("*.py")]
    sources = {dotted(path, root): path.read_text(encoding="utf-8") for path in files}
    others = [*PACKAGE.rglob("*.j2"), root / "pyproject.toml"]
    words = " ".join(path.read_text(encoding="utf-8") for path in others)
    api = frozenset(
        (getattr(kc2spice, name).__module__, name) for name in kc2spice.__all__ if name != "errors"
    )
    found = unused(sources, words, api)
    assert sorted(line for line in found if line.startswith("kc2spice")) == []


@pytest.mark.parametrize(
    ("source", "found"),
    [
        ("def f(): ...", ["m: f"]),
        ("def f(): ...\nf()", []),
        ("def f(): f()", ["m: f"]),
        ("def _f(): ...", []),
        ("class A:\n    def g(self): ...\nA()", ["m: A.g"]),
        ("class A:\n    def g(self): ...\nA().g()", []),
        ("import app\n@app.command()\ndef f(): ...", []),
        ("@cache\ndef f(): ...", ["m: f"]),
    ],
)
def test_what_the_check_sees(source, found):
    assert sorted(unused({"m": source})) == found
