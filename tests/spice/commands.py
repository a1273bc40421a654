"""The command line as a reader uses it, in a process of its own, and in this one."""

import contextlib
import json
import os
import subprocess
import sys
import tomllib
from pathlib import Path

from support import app
from typer.testing import CliRunner

ROOT = Path(__file__).parents[2]
EACH = """
import json, sys
from kc2spice.cli.main import app
for words in json.loads(sys.argv[1]):
    if code := app(words, standalone_mode=False):
        sys.exit(f"{words}: exit code {code}")
"""


def python(folder, *words, path=()):
    """Output of a Python program in ``folder``, which must succeed; ``path`` has more modules."""
    path = os.pathsep.join(map(str, (ROOT, *path)))
    done = subprocess.run(
        [sys.executable, *words], cwd=folder, capture_output=True, text=True, check=False,
        env={**os.environ, "OMP_NUM_THREADS": "1", "PYTHONPATH": path},
    )  # fmt: skip
    assert done.returncode == 0, f"{words}\n{done.stderr}{done.stdout}"
    return done.stdout


def typed(folder, commands, path=()):
    """Output of ``kc2spice`` for commands that are lists of words, one after the other."""
    return python(folder, "-c", EACH, json.dumps(commands), path=path)


def install_package(folder, text):
    """Make the installed form of a package of one module in ``folder``, from its pyproject.toml.

    ``pip install .`` would write the same metadata, and copy only the modules in ``py-modules``.
    """
    settings = tomllib.loads(text)
    project = settings["project"]
    assert settings["build-system"]["build-backend"] == "setuptools.build_meta"
    ((group, points),) = project["entry-points"].items()
    ((name, value),) = points.items()
    (module,) = settings["tool"]["setuptools"]["py-modules"]
    assert value.startswith(f"{module}:")
    assert (folder / f"{module}.py").is_file()
    installed = folder / f"{project['name'].replace('-', '_')}-{project['version']}.dist-info"
    installed.mkdir()
    label = f"Name: {project['name']}\nVersion: {project['version']}\n"
    (installed / "METADATA").write_text(f"Metadata-Version: 2.1\n{label}")
    (installed / "entry_points.txt").write_text(f"[{group}]\n{name} = {value}\n")


def session(leader):
    """Living processes of the session that ``leader`` began, with what they run."""
    found = {}
    for path in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):  # it ended meanwhile
            state, _, _, number, *_ = path.read_text().rpartition(")")[2].split()
            if int(number) == leader and state != "Z":
                found[int(path.parent.name)] = (path.parent / "cmdline").read_bytes()
    return found


def run_command(*words, code=0):
    """Output of a command in this process: the record with ``--json``, otherwise all text."""
    done = CliRunner().invoke(app, list(map(str, words)))
    assert done.exit_code == code, done.output
    assert "Traceback" not in done.output
    return json.loads(done.stdout) if "--json" in words and code == 0 else done.output
