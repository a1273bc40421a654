"""The committed netlists are what the program writes today ('make netlists' writes them anew)."""

import re
from pathlib import Path

import numpy as np
import pytest

from kc2spice.scene.load import gallery, load_scene
from kc2spice.workflow.run import export

NETLISTS = Path(__file__).parents[2] / "netlists"
NUMBER = re.compile(r"(?<![A-Za-z0-9_.])-?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![A-Za-z0-9_])")
# Another processor's arithmetic moves the states of a model reduced to a tolerance of 1e-6 by 3e-6
# (measured), those of fixed order by 1e-9; another mesher moves the field by some 1e-5. What is
# zero by symmetry is noise compared to its like, the cards of one kind.
RELATIVE, OF_ITS_KIND = 1e-4, 1e-5


def parts(text):
    """Lines as (words without numbers, numbers); the hash and the version stay words."""
    for line in text.splitlines():
        if line.startswith(("* tool:", "* scene:")) or "uuid" in line:
            yield line, []
        else:
            yield NUMBER.sub("#", line), [float(x) for x in NUMBER.findall(line)]


def kind(line):
    return line[:2].lower()


def assert_same(name, ours, theirs):
    ours, theirs = list(parts(ours)), list(parts(theirs))
    assert [words for words, _ in ours] == [words for words, _ in theirs], name
    largest = {}
    for words, values in theirs:
        size = max(map(abs, values), default=0.0)
        largest[kind(words)] = max(largest.get(kind(words), 0.0), size)
    for (words, a), (_, b) in zip(ours, theirs, strict=True):
        allowed = RELATIVE * np.abs(b) + OF_ITS_KIND * largest[kind(words)]
        assert np.all(np.abs(np.subtract(a, b)) <= allowed), f"{name}: {words} {a} {b}"


@pytest.mark.parametrize("scene", sorted(gallery()))
def test_committed_netlists_are_current(scene, tmp_path):
    written = export(load_scene(scene), tmp_path)
    committed = {path.name for path in (NETLISTS / scene).iterdir()}
    assert committed == {path.name for path in written}
    for path in written:
        theirs = (NETLISTS / scene / path.name).read_text(encoding="utf-8")
        assert_same(f"{scene}/{path.name}", path.read_text(encoding="utf-8"), theirs)
