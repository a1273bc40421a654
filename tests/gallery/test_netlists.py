"""The committed netlists are what the program writes today ('make netlists' writes them anew)."""

import re
import runpy
from pathlib import Path

import numpy as np
import pytest

from kc2spice.netlist.deck import Deck
from kc2spice.netlist.read import read_lib
from kc2spice.scene.load import gallery
from kc2spice.sim.ngspice import run_deck

NETLISTS = Path(__file__).parents[2] / "netlists"
TOOL = runpy.run_path(str(NETLISTS.parent / "tools" / "netlists.py"))
NUMBER = re.compile(r"(?<![A-Za-z0-9_.])-?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![A-Za-z0-9_])")
# Another mesher moves the field by some 1e-5. Each number is compared to itself; only values of a
# lookup, which pass through zero, count beside the largest of their table.
RELATIVE, OF_ITS_TABLE = 1e-4, 1e-5
# Another processor's arithmetic turns the last states of a reduced model, and may even keep one
# more: cards change by a tenth, what the part answers by far less than its certified error: 1.1e-5
# at the band's end of a beam that is certified to 7e-5, 3.7e-5 of a chip certified to 7.3e-4.
RESPONSE, OF_CERTIFIED, BAND = 3e-5, 0.1, 1e-9
ROM = re.compile(
    r"(?:\*|//) (?:\w+, )?rom: order=\d+ band=[\d.e+]+\.\.([\d.e+]+) Hz norm=\w+ error=(\S+).*"
    r"(?:\n(?:\*|//)   .*)*"
)
IS_ROM = re.compile(r"(?m)^(?:\*|//) rom: ")  # the library of one, not a deck that names it


def parts(text):
    """Lines as (words without numbers, numbers); the hash and the version stay words."""
    for line in ROM.sub("", text).splitlines():
        if line.startswith(("* tool:", "* scene:")) or "uuid" in line:
            yield line, []
        else:
            yield NUMBER.sub("#", line), [float(x) for x in NUMBER.findall(line)]


def sizes(text):
    """The largest value of the lookup of each line, 0 elsewhere."""
    tables, largest, table = [], {None: 0.0}, 0
    for row, line in enumerate(text.splitlines()):
        lookup = re.match(r"\+ -?[0-9]+,", line)
        table = table if lookup else row
        tables.append(table if lookup else None)
        if lookup:  # heights stand before their values
            values = [abs(float(x)) for x in NUMBER.findall(line)[1::2]]
            largest[table] = max(largest.get(table, 0.0), *values)
    return [largest[table] for table in tables]


def assert_same(name, ours, theirs):
    allowed = sizes(ROM.sub("", theirs))
    ours, theirs = list(parts(ours)), list(parts(theirs))
    assert [words for words, _ in ours] == [words for words, _ in theirs], name
    for (words, a), (_, b), size in zip(ours, theirs, allowed, strict=True):
        limit = RELATIVE * np.abs(b) + OF_ITS_TABLE * size
        assert np.all(np.abs(np.subtract(a, b)) <= limit), f"{name}: {words} {a} {b}"


def of_model(text):
    """A library without its scene and the reduction's order and error."""
    return re.sub(r"(?m)^(?:\*|//) scene: .*$", "", ROM.sub("", text))


def shapes(text):
    """The cards without names' and values' digits, each once: the same for any number of states."""
    return {re.sub(r"[-+]?\d[\d.]*(e[-+]?\d+)?", "#", line) for line in text.splitlines()}


def response(path, stop, directory):
    """Answers of every terminal of a reduced model's part to 1 V or 1 A at each, up to ``stop``."""
    (part,) = read_lib(path)
    ends = [p.name for p in part.pins if p.name not in ("cathode", "base")]
    volts = {p.name for p in part.pins if p.unit == "V"}
    cards, saved = [], {}
    for k, load in enumerate(ends):
        nodes = [f"{p.name}_{k}" if p.name in ends else "0" for p in part.pins]
        cards.append(f"X{k} {' '.join(nodes)} {part.name}")
        for end in ends:
            on = int(end == load)
            if end in volts:
                cards.append(f"V{end}_{k} {end}_{k} 0 DC 0 AC {on}")
            elif on:
                cards.append(f"I{end}_{k} 0 {end}_{k} DC 0 AC 1")
            saved[load, end] = f"i(v{end}_{k})" if end in volts else f"v({end}_{k})".lower()
    text = "\n".join([
        "response", f".include {part.filename}", *cards, f".ac lin 120 {stop / 120} {stop}",
        f".save {' '.join(saved.values())}", ".end", "",
    ])  # fmt: skip
    vectors = {"".join(pair): (vector.lower(), 1.0) for pair, vector in saved.items()}
    deck = Deck(name="ac", text=text, more={part.filename: part.text}, vectors=vectors)
    waves = run_deck(deck, directory)
    return np.array([waves[name] for name in vectors])


def assert_answers_alike(ours, theirs, directory):
    """Two libraries of one reduced model, by what they do."""
    a, b = ours.read_text(encoding="utf-8"), theirs.read_text(encoding="utf-8")
    a_head, b_head = (of_model(text.partition(".subckt")[0]) for text in (a, b))
    assert_same(theirs.name, a_head, b_head)
    assert shapes(of_model(a)) == shapes(of_model(b)), theirs
    stop = float(ROM.search(b)[1])  # the end of some bands is a computed resonance
    assert stop == pytest.approx(float(ROM.search(a)[1]), rel=BAND), theirs
    x, y = (response(p, stop, directory / s) for p, s in ((ours, "ours"), (theirs, "theirs")))
    apart = np.abs(x - y) / np.abs(y)
    limit = max(RESPONSE, OF_CERTIFIED * float(ROM.search(b)[2]))
    assert apart.max() <= limit, f"{theirs}: {apart.max():.1e}"


# Plain buzzers but two differ in numbers alone, and each has a model to be built.
ONE_OF = re.compile(r"buzzer_7bb_(?!20_6)|buzzer_ft_(?!39t)")


@pytest.mark.parametrize(
    "scene",
    [pytest.param(name, marks=pytest.mark.slow if ONE_OF.match(name) else ())
     for name in sorted(gallery())],
)  # fmt: skip
def test_committed_netlists_are_current(scene, tmp_path):
    written, shared = TOOL["scene_files"](scene, tmp_path), scene in TOOL["SHARED"]
    folder = TOOL["folder"](scene)
    committed = {path.name for path in folder.iterdir()}
    names = {path.name for path in written}
    assert names <= committed if folder.name in {*TOOL["SHARED"].values()} else names == committed
    for path in written:
        file = folder / path.name
        ours, theirs = path.read_text(encoding="utf-8"), file.read_text(encoding="utf-8")
        if shared and path.suffix == ".lib":  # its head has the scene of the folder
            ours, theirs = (re.sub(r"(?m)^\* scene: .*$", "", text) for text in (ours, theirs))
        if ours != theirs and IS_ROM.search(theirs):
            assert_answers_alike(path, file, tmp_path / "response")
        else:
            assert_same(f"{scene}/{path.name}", ours, theirs)


@pytest.mark.parametrize("scene", TOOL["SHOWN"])
def test_examples_of_dialects_are_current(scene, tmp_path):
    TOOL["example_files"](scene, tmp_path)
    folder = TOOL["EXAMPLES"] / scene
    files = {p.relative_to(tmp_path) for p in tmp_path.rglob("*") if p.is_file()}
    assert files == {p.relative_to(folder) for p in folder.rglob("*") if p.is_file()}
    for name in files:
        ours, theirs = ((base / name).read_text("utf-8") for base in (tmp_path, folder))
        if IS_ROM.search(theirs):  # what its cards answer is seen in the scene's own library
            assert shapes(of_model(ours)) == shapes(of_model(theirs)), name
        else:
            assert_same(str(name), ours, theirs)


@pytest.mark.parametrize(
    ("name", "before", "after"),
    [
        ("sphere.lib", "mass=3.288", "mass=9.864"),
        ("kick_and_catch.cir", "2.49e-05", "9e-02"),
        ("pid.lib", "kd=20", "kd=20.4"),
        ("contact.lib", "eps=4", "eps=4.001"),
    ],
)
def test_a_changed_scene_is_noticed(name, before, after):
    text = (NETLISTS / "kick_and_catch" / name).read_text(encoding="utf-8")
    assert before in text
    with pytest.raises(AssertionError):
        assert_same(name, text.replace(before, after), text)


@pytest.mark.parametrize(
    ("before", "after"),
    [("Guring1_3 base uring1 q3", "Guring1_3 uring1 base q3"), ("Rcharge  charge base 1\n", ""),
     ("28.682", "28.725"), ("500000.0 Hz", "500001.0 Hz")],
)  # fmt: skip
def test_a_changed_model_is_noticed(before, after, tmp_path):
    text = (NETLISTS / "kick_and_catch" / "kick_and_catch_kick.lib").read_text(encoding="utf-8")
    assert before in text
    ours, theirs = tmp_path / "kick.lib", tmp_path / "known" / "kick.lib"
    theirs.parent.mkdir()
    ours.write_text(text.replace(before, after), encoding="utf-8")
    theirs.write_text(text, encoding="utf-8")
    with pytest.raises(AssertionError):
        assert_answers_alike(ours, theirs, tmp_path / "response")
