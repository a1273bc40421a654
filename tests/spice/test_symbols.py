"""Symbols against the libraries they stand for, read by parsers that share no code with us."""

import re

import numpy as np
import pytest

from kc2spice.parts.contact import contact_subcircuit
from kc2spice.parts.electromagnet import catch_subcircuit
from kc2spice.parts.opamp import opamp_subcircuit
from kc2spice.parts.pid import pid_subcircuit
from kc2spice.parts.sphere import sphere_subcircuit
from kc2spice.scene.rings import ring_gaps
from kc2spice.scene.schema import Control, Sphere
from kc2spice.spice.kicad import RELEASES
from kc2spice.spice.realize import realize
from kc2spice.spice.symbol import symbol_files

kicadfiles = pytest.importorskip("kicadfiles")
asy_reader = pytest.importorskip("spicelib.editor.asy_reader")


@pytest.fixture(scope="module")
def parts(header, model, radii, table):
    ball = Sphere()
    rings = tuple(f"R{i}" for i in range(6))
    return (
        realize(model, header),
        sphere_subcircuit(header, ball.mass, ball.radius, 9.81),
        contact_subcircuit(header, rings, ring_gaps(radii, ball.radius), 4e8),
        catch_subcircuit(header, table, 0.1),
        opamp_subcircuit(header),
        pid_subcircuit(header, Control()),
    )


@pytest.fixture(scope="module")
def files(parts):
    return symbol_files(parts)


@pytest.fixture(scope="module")
def written(files, tmp_path_factory):
    home = tmp_path_factory.mktemp("symbols")
    for name, text in files.items():
        (home / name).write_text(text)
    return home


def card(part):
    """``(pins, params)`` as they stand on the ``.subckt`` card."""
    words = re.search(r"(?m)^\.subckt (.*)$", part.text)[1].split()[1:]
    pins = [w for w in words if "=" not in w]
    return pins, dict(w.split("=") for w in words if "=" in w)


def table_of(part):
    """Pins of the library's header, in order."""
    return re.findall(r"(?m)^\* @pin \d+ (\w+) ", part.text)


def library(written, major):
    name = f"kc2spice_kicad{major}.kicad_sym"
    return kicadfiles.KicadSymbolLib.from_file(
        str(written / name), kicadfiles.ParseStrictness.STRICT
    )


def pins_of(symbol):
    return {p.number.number: p for unit in symbol.units for p in unit.pins}


# ------------------------------------------------------------------------------------ KiCad


@pytest.mark.parametrize("major", [8, 9])
def test_kicad_reads_what_the_library_declares(written, parts, major):
    symbols = {s.library_id: s for s in library(written, major).symbols}
    assert set(symbols) == {p.name for p in parts}
    for part in parts:
        symbol = symbols[part.name]
        fields = {p.key: p.value for p in symbol.properties}
        pins, params = card(part)
        named = {int(n): p.name.name for n, p in pins_of(symbol).items()}
        assert [named[i] for i in sorted(named)] == pins == table_of(part)
        assert fields["Sim.Device"] == "SUBCKT"
        assert fields["Sim.Library"] == part.filename
        assert fields["Sim.Name"] == part.name
        assert fields["Sim.Pins"] == " ".join(f"{i}={p}" for i, p in enumerate(pins, 1))
        given = dict(w.split("=") for w in fields.get("Sim.Params", "").split())
        assert given == params
        hidden = {p.key for p in symbol.properties if p.effects.hide.token_value == "yes"}
        assert hidden == set(fields) - {"Reference", "Value"}


@pytest.mark.parametrize("major", [8, 9])
def test_pins_are_on_the_grid_and_apart(written, major):
    for symbol in library(written, major).symbols:
        places = [(p.at.x / 1.27, p.at.y / 1.27) for p in pins_of(symbol).values()]
        np.testing.assert_allclose(places, np.round(places), atol=1e-9)
        assert len(set(places)) == len(places)


def tree(text):
    """Nested lists of an S-expression."""
    stack = [[]]
    for token in re.findall(r'"(?:\\.|[^"\\])*"|[()]|[^\s()]+', text):
        if token == "(":
            stack.append([])
        elif token == ")":
            done = stack.pop()
            stack[-1].append(done)
        else:
            stack[-1].append(token)
    assert len(stack) == 1
    return stack[0][0]


# KiCad developer documentation, "S-Expression Format", "Symbol Library" and "Schematic": which
# tokens stand in which. None: no tokens inside.
EFFECTS = {"effects": {"font": {"size": None}, "justify": None, "hide": None}}
PROPERTY = {"property": {"at": None, **EFFECTS}}
LINE = {"stroke": {"width": None, "type": None}}
FILL = {"fill": {"type": None}}
GRAPHICS = {
    "rectangle": {"start": None, "end": None, **LINE, **FILL},
    "circle": {"center": None, "radius": None, **LINE, **FILL},
    "polyline": {"pts": {"xy": None}, **LINE, **FILL},
}
PIN = {"pin": {"at": None, "length": None, "name": EFFECTS, "number": EFFECTS}}
SYMBOL = {
    "symbol": {
        "power": None, "pin_names": {"offset": None}, "exclude_from_sim": None, "in_bom": None,
        "on_board": None, **PROPERTY, "symbol": {**GRAPHICS, **PIN},
    }
}  # fmt: skip
HEAD = {"version": None, "generator": None, "generator_version": None}
UUID = {"uuid": None}
SHEET = {
    **HEAD, **UUID, "paper": None, "title_block": {"title": None}, "lib_symbols": SYMBOL,
    "no_connect": {"at": None, **UUID},
    "wire": {"pts": {"xy": None}, **LINE, **UUID},
    "label": {"at": None, **EFFECTS, **UUID},
    "text": {"exclude_from_sim": None, "at": None, **EFFECTS, **UUID},
    "symbol": {
        "lib_id": None, "at": None, "unit": None, "exclude_from_sim": None, "in_bom": None,
        "on_board": None, "dnp": None, **UUID, **PROPERTY, "pin": UUID,
        "instances": {"project": {"path": {"reference": None, "unit": None}}},
    },
    "sheet_instances": {"path": {"page": None}},
}  # fmt: skip
VERSIONS = {8: ("20231120", "20231120"), 9: ("20241209", "20250114")}


def conforms(node, allowed, fonts):
    """Every token of ``node`` is one that the format knows there; release 9 knows one more."""
    for child in node[1:]:
        if isinstance(child, list):
            if child[0] == "embedded_fonts":
                assert fonts, "release 8 has no embedded fonts"
                assert child == ["embedded_fonts", "no"]
                continue
            assert child[0] in (allowed or ()), f"{child[0]} in {node[0]}"
            conforms(child, allowed[child[0]], fonts)


@pytest.mark.parametrize("major", [8, 9])
def test_files_have_the_published_form_of_their_release(files, major):
    of_library, of_sheet = VERSIONS[major]
    found = tree(files[f"kc2spice_kicad{major}.kicad_sym"])
    assert found[0] == "kicad_symbol_lib"
    assert found[1:4] == [
        ["version", of_library], ["generator", '"kc2spice"'], ["generator_version", f'"{major}.0"'],
    ]  # fmt: skip
    conforms(found, {**HEAD, **SYMBOL}, fonts=major >= 9)
    sheet = tree(files[f"kick_driver_kicad{major}.kicad_sch"])
    assert sheet[0] == "kicad_sch"
    assert sheet[1] == ["version", of_sheet]
    conforms(sheet, SHEET, fonts=major >= 9)
    assert ("embedded_fonts" in str(found)) == (major >= 9)


def test_the_form_can_be_missed(files):
    wrong = files["kc2spice_kicad9.kicad_sym"]
    with pytest.raises(AssertionError, match="embedded"):
        conforms(tree(wrong), {**HEAD, **SYMBOL}, fonts=False)
    with pytest.raises(AssertionError, match="lenght in pin"):
        conforms(tree(wrong.replace("(length", "(lenght", 1)), {**HEAD, **SYMBOL}, fonts=True)


@pytest.mark.parametrize("major", [8, 9])
def test_the_sheet_drives_the_kick(written, model, major):
    """Nets found from coordinates: pins, wires and ground symbols that meet are one."""
    sheet = kicadfiles.KicadSch.from_file(
        str(written / f"kick_driver_kicad{major}.kicad_sch"), kicadfiles.ParseStrictness.STRICT
    )
    drawn = {s.library_id: s for s in sheet.lib_symbols.symbols}
    ends, grounds = {}, set()
    for symbol in sheet.symbols:
        reference = next(p.value for p in symbol.properties if p.key == "Reference")
        for number, pin in pins_of(drawn[symbol.lib_id.value]).items():
            at = (round(symbol.at.x + pin.at.x, 3), round(symbol.at.y - pin.at.y, 3))
            if reference.startswith("#PWR"):
                grounds.add(at)
            else:
                name = pin.name.name if reference == "X1" else number
                ends[reference, name] = at
    joined = {p: p for p in [*ends.values(), *grounds]}
    for wire in sheet.wires:
        a, b = ((round(p.x, 3), round(p.y, 3)) for p in wire.pts.points)
        assert a in joined, "a wire that ends on no pin"
        assert b in joined, "a wire that ends on no pin"
        joined = {p: joined[a] if net == joined[b] else net for p, net in joined.items()}

    def net(*pin):
        place = ends[pin]
        return "0" if place in grounds else joined[place]

    assert net("V1", "1") == net("R1", "1")
    assert net("R1", "2") == net("X1", "anode")
    assert net("R1", "1") != net("R1", "2")
    assert net("V1", "2") == net("X1", "cathode") == net("X1", "base") == "0"
    free = {(round(n.at.x, 3), round(n.at.y, 3)) for n in sheet.no_connects}
    rings = [p.name for p in model.ports if p.kind == "mechanical"]
    assert free == {ends["X1", ring] for ring in rings}


def test_new_exports_do_not_change_the_sheet(files, parts):
    assert symbol_files(parts) == files


# ---------------------------------------------------------------------------------- LTspice


def test_ltspice_reads_what_the_library_declares(written, parts):
    for part in parts:
        read = asy_reader.AsyReader(written / f"{part.name}.asy")
        pins, params = card(part)
        attributes = [dict(a.split("=") for a in p.text.strip(";").split(";")) for p in read.pins]
        order = {int(a["SpiceOrder"]): a["PinName"] for a in attributes}
        assert [order[i] for i in sorted(order)] == pins == table_of(part)
        assert read.attributes["Prefix"] == "X"
        assert read.attributes["Value"] == part.name
        assert read.attributes["ModelFile"] == f"{part.name}.ltspice.lib"
        line = read.attributes.get("SpiceLine", "")
        assert dict(w.split("=") for w in line.split()) == params
        assert all(p.coord.X % 16 == p.coord.Y % 16 == 0 for p in read.pins)


def test_ltspice_symbols_bring_libraries_that_ltspice_reads(files, parts):
    for part in parts:
        assert "pwl(V(" not in files[f"{part.name}.ltspice.lib"]
    assert "table(V(s)," in files["catch.ltspice.lib"]


def test_each_dialect_gets_the_symbols_of_its_tools(parts):
    spoken = symbol_files(parts, "ltspice")
    assert set(spoken) == {f"{p.name}.asy" for p in parts}
    assert "SYMATTR ModelFile kick.lib\n" in spoken["kick.asy"]
    assert symbol_files(parts, "xyce") == symbol_files(parts, "verilog-a") == {}
    assert [r.major for r in RELEASES] == [8, 9]
