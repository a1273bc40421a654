"""The page on own dialects works as it is printed, and its dialect stands in every list."""

import re
from pathlib import Path

import pytest
from commands import install_package, python, typed

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "how-to" / "own_dialect.md").read_text(encoding="utf-8")
SCENES = ("impact", "levitated_disc", "harvester_bridge")


@pytest.fixture(scope="module")
def package(tmp_path_factory):
    """Package of a reader: the file, and the entry point of its ``pyproject.toml``."""
    folder = tmp_path_factory.mktemp("package")
    first, *_ = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    (entry,) = re.findall(r"```toml\n(.*?)```", PAGE, re.DOTALL)
    (folder / "example_dialect.py").write_text(first, encoding="utf-8")
    install_package(folder, entry)
    return folder


def test_the_blocks_of_the_page_print_their_documented_output(tmp_path):
    blocks = re.findall(r"```python\n(.*?)```", PAGE, re.DOTALL)
    (output,) = re.findall(r"```text\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "trial.py").write_text("\n".join(blocks), encoding="utf-8")
    assert python(tmp_path, "trial.py") == output


def test_an_installed_dialect_writes_scenes_and_is_listed(package):
    commands = [["export", name, "--dialect", "example", "-o", name] for name in SCENES]
    typed(package, commands, path=[package])
    for name in SCENES:
        deck = (package / name / f"{name}.cir").read_text(encoding="utf-8")
        assert f"example -batch {name}.cir" in deck
    (package / "list.py").write_text(LISTS, encoding="utf-8")
    assert "example" in python(package, "list.py", path=[package])


LISTS = """
import kc2spice as kc
try:
    kc.export("impact", "out", dialect="hspice")
except kc.errors.UsageError as error:
    print(error.expected)
"""
