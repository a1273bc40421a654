"""The documentation names what exists: files behind links, modules, functions, classes."""

import ast
import pkgutil
import re
import tomllib
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

import pytest

import kc2spice as kc
import netlists

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


def documented_objects():
    """Each object that a page shows with its docstring, keyed by page and dotted name."""
    for page in PAGES:
        for name in re.findall(r"(?m)^::: *([\w.]+)", page.read_text(encoding="utf-8")):
            yield page.name, name


def test_objects_on_the_api_page_can_be_imported():
    found, missing = [], []
    for page, name in documented_objects():
        try:
            found.append(pkgutil.resolve_name(name))
        except (ImportError, AttributeError) as error:
            missing.append(f"{page}: {name}: {error}")
    assert not missing
    public = {name: getattr(kc, name) for name in set(kc.__all__) - {"errors", "Section"}}
    assert {name for name, item in public.items() if item not in found} == set()


def uneven_rows(page):
    """Rows of tables with more or fewer cells than the head; GitHub cuts code at a bare bar."""
    head = None
    for line in prose(page).splitlines():
        bars = len(re.findall(r"(?<!\\)\|", line)) if line.startswith("|") else None
        if bars is not None and head is not None and bars != head:
            yield line
        head = None if bars is None else head or bars


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_rows_of_tables_have_as_many_cells_as_the_head(page):
    assert list(uneven_rows(page)) == []


def test_the_readme_states_the_errors_of_the_shipped_libraries():
    (row,) = re.findall(
        r"(?m)^\| reduction \|(.*)\|.*\|$", (ROOT / "README.md").read_text(encoding="utf-8")
    )
    without, over_ranges = map(float, re.findall(r"\de-\d", row))
    for path in netlists.libraries():
        text = path.read_text(encoding="utf-8")
        if error := re.search(r"(?m)^\* rom: .* error=(\S+)", text):
            has_ranges = re.search(r"(?m)^\* @param .* range=", text)
            limit = over_ranges if has_ranges else without
            assert float(error[1]) <= limit, path.name


def test_the_page_of_the_netlists_counts_the_libraries_with_parameters():
    table = tomllib.loads(netlists.RANGES.read_text(encoding="utf-8"))
    changed = {name for name, keys in table.items() if isinstance(keys, dict)}
    assert all(re.fullmatch(r"buzzer_(7bb|ft)_\w+", name) for name in changed)
    scenes = {path.stem for path in (ROOT / "kc2spice" / "scenes").glob("*.toml")}
    assert changed == {name for name in scenes if re.match(r"buzzer_(7bb|ft)_", name)}
    assert len(changed) == 11
    assert "the eleven scenes `buzzer_7bb_*` and `buzzer_ft_*`" in netlists.PAGE.read_text("utf-8")


@pytest.mark.parametrize("action", ["fail", "warn", "off"])
def test_exit_codes_of_violated_checks_are_those_of_the_page(action, cli, tmp_path):
    """A penalty of 1 N/um lets the sphere of `impact` enter deeper than the check permits."""
    page = (ROOT / "docs" / "reference" / "exit_codes.md").read_text(encoding="utf-8")
    (code,) = re.findall(rf"(?m)^\| `{action}` \|.*\| (\d+) \|$", page)
    settings = ("contact.penalty=1e6", f"checks.penetration={action}")
    words = [word for text in settings for word in ("--set", text)]
    done = cli("run", "impact", *words, "-o", "out")
    assert done.exit_code == int(code)
    assert ("VIOLATED" in done.stdout) is (action == "warn")
    assert (tmp_path / "out").exists() is (action != "fail")


def written_names(command):
    """Patterns of the files that a command writes, from the table on the page of files."""
    page, names, rows = ROOT / "docs" / "reference" / "files.md", [], False
    for line in page.read_text(encoding="utf-8").splitlines():
        cells = [cell.strip() for cell in line.split("|")]
        if line.startswith("|") and cells[1]:
            rows = cells[1] == f"`{command}`"
        if line.startswith("|") and rows:
            names += re.findall(r"`([^`]+)`", cells[2])
    return [re.escape(n).replace("SCENE", r"\w+").replace("NAME", r"\w+") for n in names]


@pytest.mark.parametrize("dialect", ["ngspice", "ltspice", "xyce", "verilog-a"])
def test_the_page_lists_the_files_of_an_export(dialect, tmp_path):
    command = "export" if dialect == "ngspice" else f"export --dialect {dialect}"
    patterns = written_names(command)
    files = [path.name for path in kc.export("7BB-20-6", tmp_path, dialect=dialect)]
    assert [name for name in files if not any(re.fullmatch(p, name) for p in patterns)] == []
    optional = ["verilog\\-a\\.txt", "\\w+\\.lib"] if dialect == "verilog-a" else []
    unused = [p for p in patterns if not any(re.fullmatch(p, name) for name in files)]
    assert set(unused) <= set(optional)


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
