"""Symbols against the libraries they stand for, read by parsers that share no code with us."""

import re
from dataclasses import replace

import pytest

from kc2spice.netlist.circuit import Element
from kc2spice.netlist.expression import literal
from kc2spice.netlist.translate import symbol_files

kicadfiles = pytest.importorskip("kicadfiles")
asy_reader = pytest.importorskip("spicelib.editor.asy_reader")


@pytest.fixture(scope="module")
def deck(parts, loop):
    """A loop, and an operational amplifier whose output nothing else is wired to."""
    nodes = "sphere_y", "0", "spare", "0", "0", "0"
    amplifier = Element.of("Xamp", *nodes, "opamp", a0="1e5")
    mirror = Element.of("Fmirror", "mirror", "0", "Vkick_drive", 0.5)
    items = (*loop.items, amplifier, mirror)
    return replace(loop, parts=(*loop.parts, parts["opamp"]), items=items)


@pytest.fixture(scope="module")
def files(deck):
    return symbol_files(deck)


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


def test_kicad_reads_what_the_library_declares(written, deck):
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


def test_the_sheet_joins_what_the_deck_joins(written, files, deck):
    """Nets found from coordinates: a pin is on the label or ground that stands at its end."""
    sheet = kicadfiles.KicadSch.from_file(
        str(written / "loop.kicad_sch"), kicadfiles.ParseStrictness.STRICT
    )
    drawn = {s.library_id: s for s in sheet.lib_symbols.symbols}
    labels = {
        (round(float(x), 3), round(float(y), 3)): name
        for name, x, y in re.findall(
            r'\(global_label "(\w+)"\s+\(shape passive\)\s+\(at (\S+) (\S+)',
            files["loop.kicad_sch"],
        )
    }
    assert labels
    ends = {}
    for symbol in sheet.symbols:
        reference = next(p.value for p in symbol.properties if p.key == "Reference")
        for number, pin in pins_of(drawn[symbol.lib_id.value]).items():
            at = (round(symbol.at.x + pin.at.x, 3), round(symbol.at.y - pin.at.y, 3))
            if reference.startswith("#PWR"):
                labels[at] = "0"
            else:
                ends[reference, int(number)] = at
    named = {key: labels[at].lower() for key, at in ends.items() if not key[0].startswith("#FLG")}
    for element in deck.scope.elements:
        name = element.name
        reference = name if name[-1].isdigit() else f"{name}1"
        nets = [named.pop((reference, k)) for k, _ in enumerate(element.nodes, 1)]
        assert tuple(nets) == element.ends
    assert sorted(named.values()) == ["mirror", "spare"]  # what one pin alone is on has a probe
    assert all(reference.startswith("TP") for reference, _ in named)


# ---------------------------------------------------------------------------------- LTspice


def test_ltspice_reads_what_the_library_declares(written, deck):
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
        read_values = {k: literal(v) for k, v in (w.split("=") for w in line.split())}
        assert read_values == {k: literal(v) for k, v in params.items()}
        assert all(p.coord.X % 16 == p.coord.Y % 16 == 0 for p in read.pins)
