"""Examples in docstrings print what they show, and public functions describe their arguments."""

import ast
import doctest
import importlib
import inspect
import re
from pathlib import Path

import pytest
from support import dialect_registry, parttype, pyspice

import kc2spice as kc

ROOT = Path(__file__).parents[2]
# Examples of many seconds without a cache: they build a buzzer and simulate or fit it.
SLOW = {"kc2spice.api.Result.to_xarray", "kc2spice.workflow.fit.fit"}
# Packages of extras that an example needs.
NEEDED = {
    "kc2spice.api.Result.to_xarray": "xarray",
    "kc2spice.api.Table.to_dataframe": "pandas",
}
PUBLIC = {name: getattr(kc, name) for name in kc.__all__}
FUNCTIONS = {name: item for name, item in PUBLIC.items() if inspect.isfunction(item)}
FUNCTIONS["pyspice.pyspice_subcircuit"] = pyspice.pyspice_subcircuit
SECTION = re.compile(r"(?m)^(\w+)\n-+$")
ENTRY = re.compile(r"(?m)^(\w+) : \S.*\n    \S")


def documented(node, name):
    """Name and docstring of a module and of all its classes and functions."""
    text = ast.get_docstring(node)
    if text:
        yield name, text
    for child in ast.iter_child_nodes(node):
        if isinstance(child, (ast.FunctionDef, ast.ClassDef)):
            yield from documented(child, f"{name}.{child.name}")


def examples():
    """Module, name and docstring of all that has an example; found without imports."""
    for path in sorted((ROOT / "kc2spice").rglob("*.py")):
        module = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        for name, text in documented(ast.parse(path.read_text("utf-8")), module):
            if ">>> " in text:
                marks = [pytest.mark.slow] if name in SLOW else []
                yield pytest.param(module, name, text, id=name, marks=marks)


@pytest.fixture
def without_own_type():
    """Other tests list all part types and dialects, so those of examples must not stay."""
    yield
    parttype._types.pop("hard_spring", None)
    dialect_registry._dialects.pop("example", None)


@pytest.mark.usefixtures("without_own_type")
@pytest.mark.parametrize(("module", "name", "text"), list(examples()))
def test_an_example_prints_its_documented_output(module, name, text, tmp_path, monkeypatch):
    if name in NEEDED:
        pytest.importorskip(NEEDED[name])
    monkeypatch.chdir(tmp_path)
    names = dict(vars(importlib.import_module(module)))
    example = doctest.DocTestParser().get_doctest(text, names, name, module, 0)
    try:
        doctest.DebugRunner().run(example)
    except doctest.UnexpectedException as stopped:
        raise stopped.exc_info[1] from None
    except doctest.DocTestFailure as other:
        pytest.fail(f"{other.example.source}shows {other.example.want}prints {other.got}")


def sections(function):
    """Text of each section of a docstring by its title."""
    parts = SECTION.split(inspect.getdoc(function) or "")
    return dict(zip(parts[1::2], parts[2::2], strict=True))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_public_function_has_all_sections(name):
    found = sections(FUNCTIONS[name])
    assert list(found) == ["Parameters", "Returns", "Raises", "Examples"]
    assert ENTRY.findall(found["Parameters"]) == list(inspect.signature(FUNCTIONS[name]).parameters)
    assert ">>> " in found["Examples"]


def test_a_parameter_of_all_functions_has_one_text():
    entry = re.compile(r"(?m)^(scene|trust) : (.*(?:\n    .*)*)")
    texts = {}
    for function in (kc.build, kc.deck, kc.run, kc.export, kc.verify, kc.sweep):
        for name, text in entry.findall(sections(function)["Parameters"]):
            texts.setdefault(name, set()).add(text)
    assert {name: len(text) for name, text in texts.items()} == {"scene": 1, "trust": 1}
