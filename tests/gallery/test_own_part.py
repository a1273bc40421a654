"""The page on own parts works as it stands: its files, its package, its commands."""

import re
import shlex
from pathlib import Path

import pytest
from commands import install_package, python, typed

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "own_part.md").read_text(encoding="utf-8")


def blocks(language):
    return re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """Package of a reader: the file, and the entry point of its ``pyproject.toml``."""
    folder = tmp_path_factory.mktemp("package")
    part, *_ = blocks("python")
    entry, scene = blocks("toml")
    (folder / "solenoid.py").write_text(part, encoding="utf-8")
    (folder / "pull.toml").write_text(scene, encoding="utf-8")
    install_package(folder, entry)
    return folder


def test_the_file_and_its_closed_form_run(package):
    (package / "trial.py").write_text("\n".join(blocks("python")), encoding="utf-8")
    (output,) = blocks("text")
    assert python(package, "trial.py", path=[package]) == output


@pytest.mark.slow
def test_the_commands_find_the_installed_part(package):
    commands = [shlex.split(line)[1:] for line in "".join(blocks("sh")).splitlines()]
    typed(package, commands, path=[package])
    assert (package / "xyce" / "solenoid.lib").is_file()
    assert "I(" in (package / "modules" / "solenoid.va").read_text(encoding="utf-8")
    head = (package / "xyce" / "solenoid.lib").read_text(encoding="utf-8")
    assert "* @param travel=0.0015 unit=m Displacement x at the stop" in head
