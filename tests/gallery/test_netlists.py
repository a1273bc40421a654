"""The committed netlists are what the program writes today ('make netlists' writes them anew)."""

import re
import runpy
import tomllib
from itertools import product
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from support import (
    Deck,
    LinearBody,
    StageTimer,
    list_gallery,
    load_scene,
    parse_literal,
    read_lib,
    run_deck,
)

NETLISTS = Path(__file__).parents[2] / "netlists"
TOOL = runpy.run_path(str(NETLISTS.parent / "tools" / "netlists.py"))
FACTORS = {"": 1.0, "t": 1e12, "g": 1e9, "meg": 1e6, "k": 1e3, "m": 1e-3, "u": 1e-6, "n": 1e-9,
           "p": 1e-12, "f": 1e-15}  # fmt: skip
NUMBER = re.compile(
    r"(?<![A-Za-z0-9_.])(-?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)(meg|[tgkmunpf]|)(?![A-Za-z0-9_])"
)
# Another mesher moves the field by some 1e-5. Each number is compared to itself; only values of a
# lookup, which pass through zero, count beside the largest of their table.
RELATIVE, OF_ITS_TABLE = 1e-4, 1e-5
# Another processor's arithmetic turns the last states of a reduced model, and may even keep one
# more: cards change by a tenth, what the part answers by far less than its certified error: 1.1e-5
# at the band's end of a beam that is certified to 7e-5, 3.7e-5 of a chip certified to 7.3e-4.
RESPONSE, OF_CERTIFIED, BAND = 3e-5, 0.1, 1e-9
FLOWS = {"A": 1.0, "cm3/s": 1e-6}  # SI values of 1 A at a pin
ROM = re.compile(
    r"(?:\*|//) (?:\w+, )?rom: order=\d+ band=[\d.e+]+\.\.([\d.e+]+) Hz norm=\w+ error=(\S+).*"
    r"(?:\n(?:\*|//)   .*)*"
)
IS_ROM = re.compile(r"(?m)^(?:\*|//) rom: ")  # the library of one, not a deck that names it
REFERENCES = ("cathode", "base", "ambient")  # pins that are joined to node 0


def parts(text):
    """Lines as (words without numbers, numbers); the hash and the version stay words."""
    for line in ROM.sub("", text).splitlines():
        if line.startswith(("* tool:", "* scene:")) or "uuid" in line:
            yield line, []
        else:
            yield NUMBER.sub("#", line), numbers(line)


def numbers(line):
    return [float(digits) * FACTORS[letters] for digits, letters in NUMBER.findall(line)]


def sizes(text):
    """The largest value of the lookup of each line, 0 elsewhere."""
    tables, largest, table = [], {None: 0.0}, 0
    for row, line in enumerate(text.splitlines()):
        lookup = re.match(r"\+ -?[0-9]+,", line)
        table = table if lookup else row
        tables.append(table if lookup else None)
        if lookup:  # heights stand before their values
            values = [abs(x) for x in numbers(line)[1::2]]
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
    """The cards without names' and values' digits, each once: the same for any number of states.
    Coefficients of polynomials are left out where they are rounding, so their cards are no shape.
    """
    text = re.sub(r"(?m)^\.param .*$(\n\+.*$)*", "", text)
    number = re.compile(r"[-+]?\d[\d.]*(e[-+]?\d+)?((meg|[tgkmunpf])(?!\w))?")
    return {number.sub("#", line) for line in text.splitlines()}


def response(path, stop, directory, values=None):
    """Answers of every terminal of a reduced model's part to 1 V or 1 A at each, up to ``stop``, at
    ``values`` of its parameters."""
    (part,) = read_lib(path)
    words = "".join(f" {name}={value!r}" for name, value in (values or {}).items())
    ends = [p.name for p in part.pins if p.name not in REFERENCES]
    volts = {p.name for p in part.pins if p.unit == "V"}
    cards, saved = [], {}
    for k, load in enumerate(ends):
        nodes = [f"{p.name}_{k}" if p.name in ends else "0" for p in part.pins]
        cards.append(f"X{k} {' '.join(nodes)} {part.name}{words}")
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
    limit = max(RESPONSE, OF_CERTIFIED * float(ROM.search(b)[2]))
    for values in ({}, {p.name: p.low for p in ranged(theirs)}):
        both = ((ours, "ours"), (theirs, "theirs"))
        x, y = (response(p, stop, directory / s, values) for p, s in both)
        apart = np.abs(x - y) / np.abs(y)
        assert apart.max() <= limit, f"{theirs}: {apart.max():.1e}"


RANGE = re.compile(r"(?m)^\* @param (\w+)=(\S+) unit=\S+ range=([-+.\de]+)\.\.([-+.\de]+)(?: |$)")


class Ranged(NamedTuple):
    """A parameter of a library with its range."""

    name: str
    default: float
    low: float
    high: float


def ranged(path):
    """Parameters of a library that have a range, as its head states them."""
    rows = RANGE.findall(path.read_text(encoding="utf-8"))
    return [Ranged(name, *map(float, numbers)) for name, *numbers in rows]


# Plain buzzers differ in numbers alone; a model over the ranges of its parameters takes 40 s.
RANGES = {
    k: v for k, v in tomllib.loads(TOOL["RANGES"].read_text("utf-8")).items() if k in list_gallery()
}
PUBLISHED = tomllib.loads((NETLISTS.parent / "docs" / "published.toml").read_text("utf-8"))
ONE = "buzzer_7bb_20_3"  # of them, for tests that need not run on all
WITHOUT = "No parameters in its netlist:"  # the comment of a scene whose device has none


def marks(scene):
    """Marks of the test that exports a scene."""
    return [pytest.mark.slow] + [pytest.mark.campaign] * (scene != ONE) if scene in RANGES else []


@pytest.mark.parametrize(
    "scene", [pytest.param(name, marks=marks(name)) for name in sorted(list_gallery())]
)
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


def admittance(path, frequency, directory, **values):
    """Flows [A, m3/s] into the electrodes and the face of a buzzer, by 1 V at its anode.

    The cathode and the ambient pressure are at zero. ``values`` are those of its parameters.
    """
    (part,) = read_lib(path)
    ends = get_driven_pins(path)
    pins = " ".join(pin.name if pin.name in ends else "0" for pin in part.pins)
    words = "".join(f" {name}={value!r}" for name, value in values.items())
    start, stop, points = float(frequency[0]), float(frequency[-1]), len(frequency)
    text = "\n".join([
        "admittance", f".include {part.filename}", f"X1 {pins} {part.name}{words}",
        *(f"V{end} {end} 0 DC 0 AC {int(end == 'anode')}" for end in ends),
        f".ac lin {points} {start!r} {stop!r}", f".save {' '.join(f'i(v{e})' for e in ends)}",
        ".end", "",
    ])  # fmt: skip
    flows = {pin.name: FLOWS[pin.flow] for pin in part.pins}
    vectors = {end: (f"i(v{end})", -flows[end]) for end in ends}
    deck = Deck(name="ac", text=text, more={part.filename: part.text}, vectors=vectors)
    waves = run_deck(deck, directory)
    return np.array([waves[end] for end in ends])


def get_driven_pins(path):
    """Pins of a buzzer's library except the references, the anode first."""
    (part,) = read_lib(path)
    return [pin.name for pin in part.pins if pin.name not in ("cathode", "base", "ambient")]


def disc_library(scene):
    """Library of the disc in the folder of a scene."""
    (path,) = (p for p in TOOL["folder"](scene).glob("*.lib") if "@pin 1 anode" in p.read_text())
    return path


def corners_and_inside(parameters):
    """Values of parameters at all corners of their ranges, and at five random points inside."""
    inside = np.random.default_rng(7).uniform(size=(5, len(parameters)))
    for place in (*product((0.0, 1.0), repeat=len(parameters)), *inside):
        yield {
            p.name: float(p.low ** (1 - at) * p.high**at)
            for p, at in zip(parameters, place, strict=True)
        }


@pytest.mark.parametrize(
    "scene", [pytest.param(k, marks=[pytest.mark.slow] * (k != ONE)) for k in RANGES]
)
def test_shipped_parameters_are_those_of_full_models(scene, tmp_path):
    """Full models are solved at each frequency, of the band and around their resonance."""
    path = disc_library(scene)
    error = float(ROM.search(path.read_text("utf-8"))[2])
    assert error <= 1e-2
    thickness, eps33 = ranged(path)
    like = load_scene(scene).parts["disc"]
    band = like.type.choose_reduction(like, load_scene(scene)).band
    middle = {"disc.layers[0].thickness": float(np.sqrt(thickness.low * thickness.high))}
    like = load_scene(scene, middle).parts["disc"]
    for values in corners_and_inside((thickness, eps33)):
        permittivity = {"eps11": 1730.0, "eps33": values[eps33.name]}
        shifted = {
            "disc.layers[0].thickness": values[thickness.name],
            "disc.layers[1].material": {"like": "PZT-5A", "permittivity": permittivity},
        }
        part = (changed := load_scene(scene, shifted)).parts["disc"]
        full = part.type.make_full_model_on_mesh(part, changed, StageTimer(), like).select(
            get_driven_pins(path)
        )
        around = full.facts["resonance_short_hz"] * np.linspace(0.94, 1.06, 13)
        for f in (np.linspace(*band, 17), around):
            anode = full.inputs.index("anode")
            rows = [full.outputs.index(name) for name in get_driven_pins(path)]
            exact = 2j * np.pi * f * full.transfer(f)[:, rows, anode].T
            found = admittance(path, f, tmp_path, **values)
            assert np.abs(found / exact - 1).max() <= error


@pytest.mark.parametrize("scene", RANGES)
def test_parameters_reach_every_device_within_the_tolerances_of_its_sheet(scene, tmp_path):
    """Each pair of resonance and capacitance that the sheet allows is that of some values: at the
    low end of the thickness the resonance is below the sheet's for all permittivities, at its high
    end above, and so are the capacitances at the ends of the permittivity (Poincare-Miranda)."""
    path = disc_library(scene)
    thickness, eps33 = ranged(path)
    plain = load_scene(scene)
    band = plain.parts["disc"].type.choose_reduction(plain.parts["disc"], plain).band
    sheet = PUBLISHED[scene]
    hertz, farads = (
        sheet[name]["value"] * (1 + sheet[name]["tolerance"] * np.array([-1, 1]))
        for name in ("resonance_hz", "capacitance_f")
    )
    near = np.linspace(0.7 * hertz[0], min(1.4 * hertz[1], band[1]), 1001)
    low = np.linspace(band[0], 1.01 * band[0], 2)

    def resonance(t, eps):
        Y = admittance(path, near, tmp_path, **{thickness.name: t, eps33.name: eps})[0]
        return near[Y.real.argmax()]

    def capacitance(t, eps):
        Y = admittance(path, low, tmp_path, **{thickness.name: t, eps33.name: eps})[0]
        return Y.imag[0] / (2 * np.pi * low[0])

    for t in np.linspace(thickness.low, thickness.high, 5).tolist():
        assert capacitance(t, eps33.low) <= farads[0]
        assert capacitance(t, eps33.high) >= farads[1]
    for eps in np.linspace(eps33.low, eps33.high, 5).tolist():
        assert resonance(thickness.low, eps) <= hertz[0]
        assert resonance(thickness.high, eps) >= hertz[1]


def test_devices_of_data_sheets_have_parameters_or_their_scenes_state_why_not():
    bodies, numbered = {}, []
    for scene in list_gallery():
        for name, part in load_scene(scene).parts.items():
            if isinstance(part.type, LinearBody):
                bodies[scene, name] = part.keys
    for keys in bodies.values():
        if keys.number:
            numbered.append(getattr(keys, "layers", keys.number))
    assert len(numbered) >= 12
    for (scene, name), keys in bodies.items():
        device = keys.number or getattr(keys, "layers", None) in numbered
        text = list_gallery()[scene].read_text("utf-8")
        assert bool(device) == (name in RANGES.get(scene, {}) or WITHOUT in text), scene


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
        ("sphere.lib", "mass=32.88", "mass=98.64"),
        ("kick_and_catch.cir", "24.9u", "90m"),
        ("pid.lib", "kd=20", "kd=20.4"),
        ("contact.lib", "eps=400meg", "eps=400.1meg"),
    ],
)
def test_a_changed_scene_is_noticed(name, before, after):
    text = (NETLISTS / "kick_and_catch" / name).read_text(encoding="utf-8")
    assert before in text
    with pytest.raises(AssertionError):
        assert_same(name, text.replace(before, after), text)


@pytest.mark.parametrize(
    ("before", "after"),
    [("Guring1_3 base uring1 q3", "Guring1_3 uring1 base q3"), ("Rcharge charge base 1\n", ""),
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


def test_lines_of_committed_netlists_have_at_most_100_characters():
    files = [*NETLISTS.glob("*/*.lib"), *NETLISTS.glob("*/*.cir")]
    printed = {path: text for path in files if "* tool:" in (text := path.read_text("utf-8"))}
    assert len(printed) > 100
    for path, text in printed.items():
        for line in text.splitlines():
            assert len(line) <= 100, f"{path}: {line}"


@pytest.mark.parametrize("scene", RANGES)
def test_modes_of_shipped_buzzers_are_the_branches_that_their_comments_state(scene, tmp_path):
    """What the branches leave of the simulated charge per volt is the clamped capacitance, the same
    at all frequencies. C follows from L and from the frequency, which has more digits: near the
    resonance the rounding of C counts Q times."""
    path = disc_library(scene)
    form = r"\* Mode \d+, at the default values: (\S+) kHz, .*, L=(\S+) C=(\S+) R=(\S+) at anode"
    rows = re.findall(form, path.read_text("utf-8"))
    branches = [(1e3 * float(f), *map(parse_literal, row)) for f, *row in rows]
    assert all(
        L * C * (2 * np.pi * f) ** 2 == pytest.approx(1, rel=1e-3) for f, L, C, _ in branches
    )
    frequency = branches[0][0] * np.linspace(0.5, 1.5, 101)
    s = 2j * np.pi * frequency
    charge = admittance(path, frequency, tmp_path)[0] / s
    motional = sum(1 / (L * (s**2 + (2 * np.pi * f) ** 2) + s * R) for f, L, _, R in branches)
    clamped = charge - motional
    assert np.ptp(clamped.real) < 3e-3 * np.abs(charge).max()
    assert np.abs(clamped.imag).max() < 3e-3 * np.abs(charge).max()
    assert clamped.real.min() > 0
