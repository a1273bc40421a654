"""Hostile files in every place where a command opens one: none acts, each ends in a clear word."""

import json

import pytest
from commands import python
from hostile import bombs, files, readers

FEW = ("csv", "deck", "rom", "plan")


def said(program, root, *words):
    """The last line of a program in a process of its own."""
    return json.loads(python(root, program.__file__, root, *words).splitlines()[-1])


def judged(found):
    wrong = {case: seen for case, (_, seen) in found.items() if seen}
    assert not wrong, json.dumps(wrong, indent=1)[:4000]


def test_broken_files_end_in_a_clear_word(tmp_path):
    judged(said(readers, tmp_path, "pickle", "|".join(FEW)))


@pytest.mark.parametrize("kind", ["csv", "sidecar"])
def test_honest_files_are_taken(kind, tmp_path, monkeypatch):
    """Lest a product that refuses everything should pass: as they are, they are read."""
    monkeypatch.setitem(files.MUTATIONS, "none", lambda data: data)
    for home, commands in readers.prepared(kind, "none", tmp_path):
        assert readers.ask(readers.COMMANDS["export"], home)[0] == 0, commands


@pytest.mark.parametrize(
    "rest", [0, *(pytest.param(k, marks=pytest.mark.slow) for k in range(1, 4))]
)
def test_small_files_that_declare_too_much_end_in_time_and_memory(rest, tmp_path):
    """Every format under every command: exit code 2, and what is expected instead."""
    names = list(bombs.BOMBS)
    names = names[rest::3] if rest else names[::13]
    last = said(bombs, tmp_path, *names)
    wrong = {
        case: (code, seconds, words[-1000:])
        for case, (code, seconds, words, files) in last["found"].items()
        if code != 2
        or seconds > 10
        or "expected:" not in words
        or not any(name in words for name in files)
        or ("cannot be" in words and "next:" not in words)
    }
    assert not wrong, json.dumps(wrong, indent=1)[:4000]
    assert len(last["found"]) > 3 * len(names)
    # All commands in one process: their libraries and what they leave behind take up to 1.1 GB
    # where other tests run beside; what a file declares would be tens of times as much.
    assert last["memory"] < 2e9


@pytest.mark.slow
@pytest.mark.campaign
@pytest.mark.parametrize("kind", sorted(readers.kinds()))
def test_no_hostile_file_acts_on_any_command(kind, tmp_path):
    found = said(readers, tmp_path, "|".join(files.MUTATIONS), kind)
    assert len(found) >= len(files.MUTATIONS)
    judged(found)
