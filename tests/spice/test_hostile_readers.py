"""Hostile files in every place where a command opens one: none acts, each ends in a clear word."""

import json
import subprocess
import sys
from pathlib import Path

import pytest
from hostile import files, readers

PROGRAM = Path(readers.__file__)
FEW = ("csv", "deck", "rom", "plan")


def said(root, mutations, kinds):
    command = [sys.executable, str(PROGRAM), str(root), "|".join(mutations), "|".join(kinds)]
    ran = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ran.returncode == 0, ran.stderr[-3000:]
    return json.loads(ran.stdout.splitlines()[-1])


def judged(found):
    wrong = {case: seen for case, (_, seen) in found.items() if seen}
    assert not wrong, json.dumps(wrong, indent=1)[:4000]


def test_broken_files_end_in_a_clear_word(tmp_path):
    judged(said(tmp_path, ("pickle",), FEW))


def test_honest_files_are_taken(tmp_path, monkeypatch):
    """Lest a product that refuses everything should pass: as they are, all but two are read."""
    monkeypatch.setitem(files.MUTATIONS, "none", lambda data: data)
    for home, commands in readers.prepared("csv", "none", tmp_path):
        assert readers.ask(readers.COMMANDS["export"], home)[0] == 0, commands


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("kind", sorted(readers.kinds()))
def test_no_hostile_file_acts_on_any_command(kind, tmp_path):
    found = said(tmp_path, tuple(files.MUTATIONS), (kind,))
    assert len(found) >= len(files.MUTATIONS)
    judged(found)
