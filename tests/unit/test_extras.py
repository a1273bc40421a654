"""Optional libraries: each missing one is an error with the command that installs it."""

import ast
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest
from support import (
    _PYTHON_PACKAGES,
    OPTIONAL_LIBRARIES,
    LinearModel,
    MissingToolError,
    import_optional,
)

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
FOR_DEVELOPERS = {"test", "docs", "dev"}
EXTRAS = {library.extra for library in OPTIONAL_LIBRARIES.values()} - {None}
# Hides a library in every process of a command, as if it were not installed.
HIDING = """
import sys
class Missing:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] == {top!r}:
            raise ModuleNotFoundError(f"No module named {{name!r}}", name=name)
sys.meta_path.insert(0, Missing())
"""
SWEEP = ("sweep", "newtons_cradle", "--set", "gravity=9.8,9.81", "--out", "table", "--quiet")


def export(folder, name):
    """The command that reads an exported file; only its library could tell that it is damaged."""
    (folder / name).write_bytes(b"x")
    return ("reduce", name)


def two_port(folder):
    """The command that fits a measured attenuator of two ports."""
    rows = (f"{k}e6 0.1 0 0.5 0 0.5 0 0.1 0" for k in range(1, 20))
    (folder / "two.s2p").write_text("\n".join(("# Hz S RI R 50", *rows)), encoding="utf-8")
    return ("reduce", "two.s2p")


COMMANDS = {
    "ansys": lambda folder: export(folder, "job.full"),
    "distributed": lambda folder: (*SWEEP, "--dask", "local"),
    "pyarrow": lambda folder: (*SWEEP, "--format", "parquet"),
    "pyyeti": lambda folder: export(folder, "job.op4"),
    "skrf": two_port,
}


@pytest.mark.parametrize("top", COMMANDS)
def test_a_command_without_its_library_names_the_extra(top, tmp_path):
    words = COMMANDS[top](tmp_path)
    hooks = tmp_path / "hooks"
    hooks.mkdir()
    (hooks / "sitecustomize.py").write_text(HIDING.format(top=top), encoding="utf-8")
    path = os.pathsep.join(map(str, (hooks, ROOT)))
    done = subprocess.run(
        [sys.executable, "-m", "kc2spice", *words], cwd=tmp_path, capture_output=True, text=True,
        env={**os.environ, "PYTHONPATH": path}, check=False,
    )  # fmt: skip
    assert done.returncode == MissingToolError.exit_code, done.stderr
    library = OPTIONAL_LIBRARIES[top]
    assert f"{library.package} is not installed" in done.stderr
    assert f"  next:     pip install 'kc2spice[{library.extra}]'\n" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.parametrize("top", OPTIONAL_LIBRARIES)
def test_a_module_without_its_library_is_an_error(top, monkeypatch):
    monkeypatch.setitem(sys.modules, top, None)
    with pytest.raises(MissingToolError) as caught:
        import_optional(f"{top}.module", "--option")
    assert (caught.value.where, caught.value.got) == ("--option", None)
    name = OPTIONAL_LIBRARIES[top].extra
    expected = OPTIONAL_LIBRARIES[top].package if name is None else f"'kc2spice[{name}]'"
    assert caught.value.hint == f"pip install {expected}"


def test_pymor_is_needed_for_its_models_alone(monkeypatch):
    model = LinearModel(K=np.eye(2), M=np.eye(2), B=np.eye(2), name="two")
    for name in [name for name in sys.modules if name.startswith("pymor.")]:
        monkeypatch.delitem(sys.modules, name)  # another test may have loaded it
    monkeypatch.setitem(sys.modules, "pymor", None)
    with pytest.raises(MissingToolError) as caught:
        model.to_pymor()
    assert caught.value.hint == "pip install 'kc2spice[pymor]'"


def test_a_damaged_library_states_its_own_error(tmp_path, monkeypatch):
    (tmp_path / "pyyeti.py").write_text("import no_such_library", encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(sys.modules, "pyyeti", raising=False)
    with pytest.raises(MissingToolError, match="pyyeti cannot be loaded") as caught:
        import_optional("pyyeti", "job.op4")
    assert caught.value.got == "No module named 'no_such_library'"


def test_a_library_cannot_change_how_arrays_are_printed(tmp_path, monkeypatch):
    text = "import numpy\nnumpy.set_printoptions(legacy='1.13', precision=2)"
    (tmp_path / "pyyeti.py").write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setitem(sys.modules, "pyyeti", None)  # what the test imports goes afterwards
    del sys.modules["pyyeti"]
    with np.printoptions():
        import_optional("pyyeti", "job.op4")
        assert str(np.array([1.0, 0.125])) == "[1.    0.125]"


def test_extras_are_declared_and_documented():
    declared = PROJECT["optional-dependencies"]
    assert set(declared) - FOR_DEVELOPERS == EXTRAS
    page = (ROOT / "docs/how-to/install.md").read_text(encoding="utf-8")
    rows = [line.split("|") for line in page.splitlines() if "pip install 'kc2spice[" in line]
    commands = {name.strip(): command.strip(" `") for _, name, command, *_ in rows}
    assert commands == {name: f"pip install 'kc2spice[{name}]'" for name in EXTRAS}
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    assert "(docs/how-to/install.md)" in readme


def test_optional_libraries_are_imported_in_one_place():
    for path in (ROOT / "kc2spice").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            tops = {name.partition(".")[0] for name in names}
            assert not tops & set(OPTIONAL_LIBRARIES), (
                f"{path} imports {tops & set(OPTIONAL_LIBRARIES)}"
            )


def test_doctor_looks_for_every_required_library():
    required = {text.partition(">=")[0] for text in PROJECT["dependencies"]}
    assert set(_PYTHON_PACKAGES) == required
