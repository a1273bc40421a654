"""The documentation names what exists: files behind links, modules, functions, classes."""

import ast
import re
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = [*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")]
PAGES = [page for page in PAGES if page.name != "CHANGELOG.md"]  # tells of what was
SOURCES = [*(ROOT / "kc2spice").rglob("*.py")]
SCRIPTS = [
    *SOURCES,
    *(s for f in ("tests", "tools", "docs", "bench") for s in (ROOT / f).rglob("*.py")),
]


def prose(page):
    """Without blocks of code."""
    return re.sub(r"(?ms)^ *```.*?^ *```", "", page.read_text(encoding="utf-8"))


@cache
def anchors(page):
    heads = re.findall(r"(?m)^#+ +(.*)$", prose(page))
    return {re.sub(r"[^\w -]", "", head.lower()).strip().replace(" ", "-") for head in heads}


def dead_links(page):
    for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
        path, _, anchor = target.partition("#")
        if re.match(r"[a-z]+:", target):
            continue
        file = (page.parent / path).resolve() if path else page
        if (
            not file.exists()
            or ROOT not in file.parents
            or (anchor and file.suffix == ".md" and anchor not in anchors(file))
        ):
            yield target


@cache
def members():
    """Names that each class, and each module by its last word, has at its top level."""
    found = {}
    for source in SOURCES:
        tree = ast.parse(source.read_text(encoding="utf-8"))
        found.setdefault(source.stem, set()).update(_names(tree))
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef):
                found.setdefault(node.name, set()).update(_names(node))
    return found


def _names(node):
    for item in node.body:
        if isinstance(item, (ast.FunctionDef, ast.ClassDef)):
            yield item.name
        targets = [item.target] if isinstance(item, ast.AnnAssign) else getattr(item, "targets", [])
        yield from (t.id for t in targets if isinstance(t, ast.Name))


def stale_names(page):
    """Paths of Python files, `Class.member` and dotted `kc2spice.…` in backticks that are none, but
    files that a heading has the reader write."""
    written = set(re.findall(r"(?m)^#+ .*The file `([^`]+)`", prose(page)))
    for name in set(re.findall(r"`([^`\n]+)`", prose(page))) - written:
        if re.fullmatch(r"[\w/.]+\.py", name):
            if not any(str(path).endswith(f"/{name}") for path in SCRIPTS):
                yield name
        elif re.fullmatch(r"kc2spice(/\w+)+", name):
            if not (ROOT / name).exists():
                yield name
        elif re.fullmatch(r"kc2spice(\.\w+)+", name) and not name.endswith(".kicad_sym"):
            *module, last = name.split(".")
            if last not in members().get(module[-1], ()) and not _module(name):
                yield name
        elif dotted := re.fullmatch(r"([A-Z][a-z]\w*)\.(\w+)(\(\))?", name):
            yield from [] if dotted[2] in members().get(dotted[1], ()) else [name]


def _module(name):
    try:
        return find_spec(name) is not None
    except ModuleNotFoundError:
        return False


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere_and_names_exist(page):
    assert list(dead_links(page)) == []
    assert list(stale_names(page)) == []


def test_the_citation_is_complete():
    """The fields that readers of Citation File Format 1.2.0 require."""
    text = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    for key in (
        "cff-version: 1.2.0",
        "message:",
        "title:",
        "authors:",
        "license: GPL-3.0-or-later",
    ):
        assert re.search(f"(?m)^{re.escape(key)}", text), key
    assert "10.3390/act10110279" in text


def test_functions_in_tables_of_modules_exist():
    """Cells such as ``kc2spice/workflow/run.py`` `run_scene`: the module contains the function."""
    for page in PAGES:
        for module, words in re.findall(r"`(kc2spice/[\w/]+\.py)`((?: `\w+`,?)+)", prose(page)):
            source = (ROOT / module).read_text(encoding="utf-8")
            for name in re.findall(r"`(\w+)`", words):
                assert re.search(rf"\b(def|class) {name}\b", source), f"{page}: {module} {name}"


def imported_names(script):
    """Module and name of each import from kc2spice in a script."""
    for node in ast.walk(ast.parse(script.read_text(encoding="utf-8"))):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("kc2spice"):
            for name in node.names:
                yield node.module, name.name


@pytest.mark.parametrize("folder", ["docs", "bench", "tools"])
def test_scripts_import_names_that_the_package_contains(folder):
    missing = [
        f"{script.relative_to(ROOT)}: {module}.{name}"
        for script in (ROOT / folder).rglob("*.py")
        for module, name in imported_names(script)
        if not hasattr(import_module(module), name) and not _module(f"{module}.{name}")
    ]
    assert not missing
