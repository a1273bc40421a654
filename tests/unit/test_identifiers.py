"""Names of the package: modules and public names have one meaning, identifiers name a thing."""

import ast
from collections import Counter, defaultdict
from pathlib import Path

import kc2spice

ROOT = Path(kc2spice.__file__).parent
MODULES = {path: ast.parse(path.read_text(encoding="utf-8")) for path in ROOT.rglob("*.py")}
# A law and the part with it; the dialect of a simulator and the process that runs it.
PARALLEL_MODULES = {"contact", "ngspice"}
NOT_NAMES = {
    "own", "kept", "given", "told", "found", "held", "wanted", "made", "shown", "taken", "whole",
    "sure", "few", "way", "ways", "once", "asked", "seen", "meant", "said", "lost", "sent", "named",
    "beside", "looked_at", "left_over",
}  # fmt: skip
MOST = 30  # identifiers of these words in the whole package
# `seen` and `Declaration.given` belong to the documented interface for parts of users.
ALLOWED = {"physics/declaration.py": {"seen", "given"}}


def bound_names(node):
    """Names that a node of a syntax tree binds: variables, parameters, functions, classes."""
    match node:
        case ast.Name(id=name, ctx=ast.Store()):
            return [name]
        case ast.FunctionDef(name=name, args=arguments):
            return [name, *(argument.arg for argument in arguments.args)]
        case ast.ClassDef(name=name):
            return [name]
    return []


def test_module_names_occur_twice_only_for_parallel_roles():
    stems = Counter(path.stem.lstrip("_") for path in MODULES if not path.stem.startswith("__"))
    assert {stem for stem, count in stems.items() if count > 1} == PARALLEL_MODULES


def test_public_names_have_one_meaning():
    homes = defaultdict(set)
    for path, tree in MODULES.items():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef) and not node.name.startswith("_"):
                homes[node.name].add(path.relative_to(ROOT).as_posix())
    several = {name: sorted(paths) for name, paths in homes.items() if len(paths) > 1}
    assert not several


def test_identifiers_describe_values():
    found = []
    for path, tree in MODULES.items():
        place = path.relative_to(ROOT).as_posix()
        words = NOT_NAMES - ALLOWED.get(place, set())
        for node in ast.walk(tree):
            names = (name for name in bound_names(node) if name.lstrip("_") in words)
            found += [f"{place}:{node.lineno} {name}" for name in names]
    assert len(found) <= MOST, found
