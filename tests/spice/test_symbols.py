"""Symbols against the libraries they stand for, read by parsers that share no code with us."""

import re
from dataclasses import replace

import device
import pytest
from support import Element, load_scene, make_deck, parse_literal, write_symbol_files

import kc2spice as kc

kicadfiles = pytest.importorskip("kicadfiles")
asy_reader = pytest.importorskip("spicelib.editor.asy_reader")


@pytest.fixture(scope="module")
def deck(parts, loop):
    """A loop, and an operational amplifier whose output nothing else is wired to."""
    nodes = "sphere_y", "0", "spare", "0", "0", "0"
    amplifier = Element.from_words("Xamp", *nodes, "opamp", a0="1e5")
    mirror = Element.from_words("Fmirror", "mirror", "0", "Vkick_drive", 0.5)
    items = (*loop.items, amplifier, mirror)
    return replace(loop, parts=(*loop.parts, parts["opamp"]), items=items)


@pytest.fixture(scope="module")
def files(deck):
    return write_symbol_files(deck)


@pytest.fixture(scope="module")
def written(files, tmp_path_factory):
    home = tmp_path_factory.mktemp("symbols")
    for name, text in files.items():
        (home / name).write_text(text)
    return home


def card(part):
    """``(pins, params)`` as they stand on the ``.subckt`` card."""
    words = re.search(r"(?m)^\.subckt (.*)$", part.text.replace("\n+", ""))[1].split()[1:]
    pins = [w for w in words if "=" not in w]
    return pins, dict(w.split("=") for w in words if "=" in w)


def table_of(part):
    """Pins of the library's header, in order."""
    return re.findall(r"(?m)^\* @pin \d+ (\w+) ", part.text)


def library(written):
    return kicadfiles.KicadSymbolLib.from_file(
        str(written / "kc2spice.kicad_sym"), kicadfiles.ParseStrictness.STRICT
    )


def pins_of(symbol):
    return {p.number.number: p for unit in symbol.units for p in unit.pins}


# ------------------------------------------------------------------------------------ KiCad


def test_kicad_reads_the_pins_and_parameters_of_a_library(written, deck):
    symbols = {s.library_id: s for s in library(written).symbols}
    assert {"GND", "SOURCE", "RESISTOR", "PROBE", "PWR_FLAG"} < set(symbols)
    for part in deck.parts:
        symbol = symbols[part.name]
        fields = {p.key: p.value for p in symbol.properties}
        pins, _ = card(part)
        named = {int(n): p.name.name for n, p in pins_of(symbol).items()}
        assert [named[i] for i in sorted(named)] == pins == table_of(part)
        assert fields["Sim.Device"] == "SUBCKT"
        assert fields["Sim.Library"] == part.filename
        assert fields["Sim.Name"] == part.name
        assert fields["Sim.Pins"] == " ".join(f"{i}={p}" for i, p in enumerate(pins, 1))
        assert "Sim.Params" not in fields  # the defaults of the library have all their digits
        hidden = {p.key for p in symbol.properties if p.effects.hide.token_value == "yes"}
        assert hidden == set(fields) - {"Reference", "Value"}


def follow_wires(text):
    """The name of the net at each point: labels and grounds, passed on along the wires.

    Wires join where they end. A wire that touches the end of another one in its middle, or runs
    along it, would look joined, and is an error here.
    """
    point = r"\(xy (\S+) (\S+)\)"
    wires = [
        tuple(zip(map(float, w[::2]), map(float, w[1::2]), strict=True))
        for w in re.findall(rf"\(wire \(pts {point} {point}\)", text)
    ]
    ends = [end for wire in wires for end in wire]
    for (x1, y1), (x2, y2) in wires:
        assert (x1 == x2) != (y1 == y2), "wires are horizontal or vertical and have a length"
        for x, y in ends:
            on_line = min(x1, x2) <= x <= max(x1, x2) and min(y1, y2) <= y <= max(y1, y2)
            assert not on_line or (x, y) in ((x1, y1), (x2, y2))
    crowded = {end for end in ends if ends.count(end) > 2}
    junctions = re.findall(r"\(junction \(at (\S+) (\S+)\)", text)
    assert crowded == {(float(x), float(y)) for x, y in junctions}
    labels = re.findall(r'\(global_label "(\w+)"\s+\(shape passive\)\s+\(at (\S+) (\S+)', text)
    names = {(float(x), float(y)): name for name, x, y in labels}
    assert len(names) == len(labels)
    count = -1
    while count < len(names):
        count = len(names)
        for a, b in (*wires, *(wire[::-1] for wire in wires)):
            if a in names:
                assert names.setdefault(b, names[a]) == names[a], "a wire joins two nets"
    return {(round(x, 3), round(y, 3)): name for (x, y), name in names.items()}, len(wires)


def nets_of_sheet(written, files, name):
    """Net of every pin of the sheet, by reference and number."""
    sheet = kicadfiles.KicadSch.from_file(
        str(written / f"{name}.kicad_sch"), kicadfiles.ParseStrictness.STRICT
    )
    drawn = {s.library_id: s for s in sheet.lib_symbols.symbols}
    names, wires = follow_wires(files[f"{name}.kicad_sch"])
    assert wires
    ends = {}
    for symbol in sheet.symbols:
        reference = next(p.value for p in symbol.properties if p.key == "Reference")
        for number, pin in pins_of(drawn[symbol.lib_id.value]).items():
            at = (round(symbol.at.x + pin.at.x, 3), round(symbol.at.y - pin.at.y, 3))
            if reference.startswith("#PWR"):
                assert names.setdefault(at, "0") == "0", "a ground is on a wire"
            else:
                ends[reference, int(number)] = at
    return {key: names[at].lower() for key, at in ends.items() if not key[0].startswith("#FLG")}


def require_nets_of_elements(named, elements):
    """Remove the pins of all elements, whose nets must be those of the deck."""
    for element in elements:
        name = element.name
        reference = name if name[-1].isdigit() else f"{name}1"
        nets = [named.pop((reference, k)) for k, _ in enumerate(element.nodes, 1)]
        assert tuple(nets) == element.lower_case_nodes


def test_the_sheet_has_the_connections_of_the_deck(written, files, deck):
    """A pin is on the wire, label or ground that stands at its end."""
    named = nets_of_sheet(written, files, "loop")
    require_nets_of_elements(named, deck.scope.elements)
    assert sorted(named.values()) == ["mirror", "spare"]  # what one pin alone is on has a probe
    assert all(reference.startswith("TP") for reference, _ in named)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["buzzer_self", "harvester_bridge", "kick_and_catch"])
def test_the_sheets_of_scenes_have_the_connections_of_their_decks(name, tmp_path):
    built = device.built(load_scene(name), device.chip(), device.magnets(), others=True)
    deck = make_deck(built)
    files = write_symbol_files(deck)
    sheet = f"{name}.kicad_sch"
    (tmp_path / sheet).write_text(files[sheet])
    named = nets_of_sheet(tmp_path, files, name)
    require_nets_of_elements(named, deck.scope.elements)
    assert all(reference.startswith("TP") for reference, _ in named)


# ---------------------------------------------------------------------------------- LTspice


def test_ltspice_reads_the_pins_and_parameters_of_a_library(written, deck):
    for part in deck.parts:
        stem = part.filename.removesuffix(".lib")
        read = asy_reader.AsyReader(written / f"{stem}.asy")
        pins, params = card(part)
        attributes = [dict(a.split("=") for a in p.text.strip(";").split(";")) for p in read.pins]
        order = {int(a["SpiceOrder"]): a["PinName"] for a in attributes}
        assert [order[i] for i in sorted(order)] == pins == table_of(part)
        assert read.attributes["Prefix"] == "X"
        assert read.attributes["Value"] == part.name
        assert read.attributes["ModelFile"] == f"{stem}.ltspice.lib"
        line = read.attributes.get("SpiceLine", "")
        read_values = {k: parse_literal(v) for k, v in (w.split("=") for w in line.split())}
        assert read_values == {k: parse_literal(v) for k, v in params.items()}
        assert all(p.coord.X % 16 == p.coord.Y % 16 == 0 for p in read.pins)


SHEET_PARTS = """
[disc]
part = "bvd"
fs = "6.3 kHz"
keff = 0.36
zs = "350 Ohm"
c_low = "10 nF"
number = "B-1"
pins = { anode = "drive.out" }
[quartz]
part = "crystal"
f = "10 MHz"
cl = "18 pF"
c0 = "5 pF"
c1 = "20 fF"
r1 = "20 Ohm"
pins = { a = "drive.out", b = "gnd" }
[speaker]
part = "loudspeaker"
fs = "50 Hz"
re = "6 Ohm"
le = "0.5 mH"
qms = 4
qes = 0.5
mms = "12 g"
sd = "0.013 m2"
pins = { plus = "drive.out", minus = "gnd" }
[switch]
part = "relay"
voltage = "12 V"
resistance = "270 Ohm"
pick_up = "9 V"
release = "1.2 V"
inductance = "0.5 H"
pins = { plus = "drive.out", minus = "gnd", no = "load.a", com = "drive.out" }
[load]
part = "resistor"
resistance = "1 kOhm"
[drive]
part = "source"
dc = 12
[analysis]
stop = "1 ms"
"""


def test_symbols_of_parts_with_data_sheets_have_the_pins_of_their_libraries(tmp_path):
    (tmp_path / "board.toml").write_text(SHEET_PARTS)
    deck = kc.deck(tmp_path / "board.toml")
    files = write_symbol_files(deck)
    for name, text in files.items():
        (tmp_path / name).write_text(text)
    symbols = {s.library_id: s for s in library(tmp_path).symbols}
    titles = [part.title for part in deck.parts]
    assert len(titles) == 4
    for part in deck.parts:
        fields = {p.key: p.value for p in symbols[part.name].properties}
        named = {int(n): p.name.name for n, p in pins_of(symbols[part.name]).items()}
        assert [named[i] for i in sorted(named)] == card(part)[0]
        assert (fields["Sim.Library"], fields["Sim.Name"]) == (part.filename, part.name)
        assert fields["Description"] == part.title
    named = nets_of_sheet(tmp_path, files, "board")
    require_nets_of_elements(named, deck.scope.elements)
