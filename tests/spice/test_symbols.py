"""Symbols against the libraries they stand for, read by parsers that share no code with us."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from device import deck_of

from kc2spice.netlist import ltspice
from kc2spice.netlist.box import layout
from kc2spice.netlist.circuit import Param, Pin, Subcircuit
from kc2spice.netlist.deck import Block
from kc2spice.netlist.elements import circuit
from kc2spice.netlist.symbol import symbol_files
from kc2spice.parts._opamp import opamp_subcircuit
from kc2spice.parts.amplifier import AmplifierKeys, amplifier_subcircuit
from kc2spice.parts.contact import Normal, contact_subcircuit, ring_gaps
from kc2spice.parts.pid import Control, pid_subcircuit
from kc2spice.parts.ring_magnet_coils import catch_subcircuit
from kc2spice.parts.sphere import SphereKeys, sphere_subcircuit
from kc2spice.spice.realize import subcircuit

kicadfiles = pytest.importorskip("kicadfiles")
asy_reader = pytest.importorskip("spicelib.editor.asy_reader")


@pytest.fixture(scope="module")
def parts(header, model, radii, table):
    ball = SphereKeys()
    rings = tuple(f"ring{i}" for i in range(6))
    return (
        subcircuit(model.linear(), "kick", header),
        sphere_subcircuit(header, ball.mass, ball.radius, 9.81),
        contact_subcircuit(header, rings, ring_gaps(radii, ball.radius), Normal(4e8)),
        catch_subcircuit(header, table, 0.1),
        opamp_subcircuit(header),
        pid_subcircuit(header, Control()),
    )


@pytest.fixture(scope="module")
def deck(parts, scene, model, table):
    """A loop, and an operational amplifier whose output nothing else is wired to."""
    loop = deck_of(scene, model, table)
    (amplifier,) = (part for part in parts if part.name == "opamp")
    cards = "Xamp sphere_y 0 spare 0 0 0 opamp a0=1e5", "Fmirror mirror 0 Vkick_drive 0.5"
    more = Block("more", cards)
    return replace(loop, parts=(*loop.parts, amplifier), blocks=(*loop.blocks, more))


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
    words = re.search(r"(?m)^\.subckt (.*)$", part.text)[1].split()[1:]
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


def test_mechanical_parts_are_on_no_board_and_in_no_list(files):
    text = files["kc2spice.kicad_sym"] + files["loop.kicad_sch"]
    assert set(re.findall(r"\((in_bom|on_board) (\w+)\)", text)) == {
        ("in_bom", "no"), ("on_board", "no"),
    }  # fmt: skip


def test_pins_are_on_the_grid_and_apart(written):
    for symbol in library(written).symbols:
        places = [(p.at.x / 2.54, p.at.y / 2.54) for p in pins_of(symbol).values()]
        np.testing.assert_allclose(places, np.round(places), atol=1e-9)
        assert len(set(places)) == len(places)


def test_inputs_are_left_and_outputs_right(parts, header):
    sides = {
        part.name: {place.pin.name: place.side for place in layout(part).places}
        for part in (*parts, amplifier_subcircuit(header, AmplifierKeys()))
    }
    assert sides["pid"] == {
        "y": "left", "enable": "left", "drive": "right", "sense": "right", "ref": "bottom",
    }  # fmt: skip
    assert sides["amplifier"] == {"command": "left", "out": "right", "ref": "bottom"}
    assert sides["kick"]["anode"] == sides["kick"]["cathode"] == "left"
    assert sides["kick"]["ring0"] == "right"
    assert sides["contact"]["ring0"] == "left"
    assert (
        sides["contact"]["bottom"] == sides["sphere"]["bottom"] == sides["sphere"]["y"] == "right"
    )
    assert sides["sphere"]["v"] == "left"
    assert sides["opamp"] == {
        "inp": "left", "inn": "left", "out": "right", "vcc": "top", "vee": "bottom",
        "ref": "bottom",
    }  # fmt: skip


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
TEXT = {"text": {"at": None, **EFFECTS}}
SYMBOL = {
    "symbol": {
        "power": None, "pin_numbers": None, "pin_names": {"offset": None}, "exclude_from_sim": None,
        "in_bom": None, "on_board": None, **PROPERTY, "symbol": {**GRAPHICS, **PIN, **TEXT},
    }
}  # fmt: skip
HEAD = {"version": None, "generator": None, "generator_version": None}
UUID = {"uuid": None}
SHEET = {
    **HEAD, **UUID, "paper": None, "title_block": {"title": None, "comment": None},
    "lib_symbols": SYMBOL,
    "global_label": {"shape": None, "at": None, **EFFECTS, **UUID},
    "text": {"exclude_from_sim": None, "at": None, **EFFECTS, **UUID},
    "symbol": {
        "lib_id": None, "at": None, "unit": None, "exclude_from_sim": None, "in_bom": None,
        "on_board": None, "dnp": None, **UUID, **PROPERTY, "pin": UUID,
        "instances": {"project": {"path": {"reference": None, "unit": None}}},
    },
    "sheet_instances": {"path": {"page": None}},
}  # fmt: skip


def conforms(node, allowed):
    """Every token of ``node`` is one that the format knows there."""
    for child in node[1:]:
        if isinstance(child, list):
            assert child[0] in (allowed or ()), f"{child[0]} in {node[0]}"
            conforms(child, allowed[child[0]])


def test_files_have_the_published_form(files):
    found = tree(files["kc2spice.kicad_sym"])
    assert found[:2] == ["kicad_symbol_lib", ["version", "20231120"]]
    conforms(found, {**HEAD, **SYMBOL})
    sheet = tree(files["loop.kicad_sch"])
    assert sheet[:2] == ["kicad_sch", ["version", "20231120"]]
    conforms(sheet, SHEET)


def test_the_form_can_be_missed(files):
    wrong = files["kc2spice.kicad_sym"].replace("(length", "(lenght", 1)
    with pytest.raises(AssertionError, match="lenght in pin"):
        conforms(tree(wrong), {**HEAD, **SYMBOL})


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
    top = circuit(deck.main, deck.files)
    for element in top.elements:
        name = element.statement.words[0]
        reference = name if name[-1].isdigit() else f"{name}1"
        nets = [named.pop((reference, k)) for k, _ in enumerate(element.nodes, 1)]
        assert tuple(nets) == element.nodes
    assert sorted(named.values()) == ["mirror", "spare"]  # what one pin alone is on has a probe
    assert all(reference.startswith("TP") for reference, _ in named)


def test_values_keep_their_digits_and_names_follow_their_symbols(files, deck):
    sheet = files["loop.kicad_sch"].partition("(lib_symbols")[2].split("(lib_id")[1:]
    fields = {}
    for symbol in sheet:
        values = dict(re.findall(r'"([\w.]+)" "((?:[^"\\]|\\.)*)"', symbol))
        fields[values["Reference"]] = values.get("Sim.Params")
    pulse = re.search(r"(?m)^Vkick_drive kick_anode 0 (.*)$", deck.files[deck.main])[1]
    assert f'model=\\"{pulse}\\"' in fields["Vkick_drive1"]
    assert 'model=\\"Vkick_drive1 0.5\\"' in fields["Fmirror1"]
    assert fields["Xamp1"] == "a0=1e5"


def test_the_project_opens_with_its_simulation(files, deck):
    settings = json.loads(files["loop.kicad_pro"])
    book = json.loads(files[settings["schematic"]["ngspice"]["workbook_filename"]])
    analysis = re.search(r"(?m)^\.tran .*$", deck.files[deck.main])[0]
    (tab,) = book["tabs"]
    assert (tab["analysis"], tab["commands"][0]) == ("TRAN", analysis)
    assert {"signal": "V(sphere_y)", "color": "rgb(55, 126, 184)", "trace_type": 257} in tab[
        "traces"
    ]
    assert '(uri "${KIPRJMOD}/kc2spice.kicad_sym")' in files["sym-lib-table"]
    assert f'(text "{analysis}"' in files["loop.kicad_sch"]


def test_new_exports_do_not_change_the_sheet(files, deck):
    assert symbol_files(deck) == files


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
        assert dict(w.split("=") for w in line.split()) == params
        assert all(p.coord.X % 16 == p.coord.Y % 16 == 0 for p in read.pins)


ASY = """Version 4
SymbolType BLOCK
RECTANGLE Normal 96 64 -96 -64
WINDOW 0 0 -64 Bottom 2
WINDOW 3 0 64 Top 2
SYMATTR Value part
SYMATTR Prefix X
SYMATTR ModelFile part.ltspice.lib
SYMATTR Description part: a title
SYMATTR SpiceLine k=2.5 c=1e-12
PIN 96 -32 RIGHT 8
PINATTR PinName out
PINATTR SpiceOrder 1
PIN -96 -32 LEFT 8
PINATTR PinName in
PINATTR SpiceOrder 2
PIN 0 64 BOTTOM 8
PINATTR PinName ref
PINATTR SpiceOrder 3
"""


def test_a_symbol_of_ltspice_line_by_line(header):
    """32 units a row, y downwards, pins on the outline: 3 rows right and left, 2 up and down."""
    pins = tuple(Pin(name, "V", "A") for name in ("out", "in", "ref"))
    params = (Param("k", 2.5, "-", ""), Param("c", 1e-12, "F", ""))
    text = "* part: a title\n.subckt part out in ref k=2.5 c=1e-12\nE1 out ref in ref {k}\n.ends\n"
    assert ltspice.symbol(layout(Subcircuit("part", pins, params, text)), "part.ltspice.lib") == ASY
    amplifier = ltspice.symbol(layout(opamp_subcircuit(header)), "opamp.lib")
    places = re.findall(r"PIN (\S+) (\S+) (\w+) 8\nPINATTR PinName (\w+)", amplifier)
    assert {name: (int(x), int(y), side) for x, y, side, name in places} == {
        "inp": (-64, -32, "LEFT"), "inn": (-64, 32, "LEFT"), "out": (64, 0, "RIGHT"),
        "vcc": (0, -64, "TOP"), "vee": (0, 64, "BOTTOM"), "ref": (-32, 64, "BOTTOM"),
    }  # fmt: skip


def test_ltspice_symbols_bring_libraries_that_ltspice_reads(files, deck):
    for part in deck.parts:
        assert "pwl(V(" not in files[part.filename.replace(".lib", ".ltspice.lib")]
    assert "table(V(s)," in files["catch.ltspice.lib"]


def test_each_dialect_gets_the_symbols_of_its_tools(deck):
    spoken = symbol_files(deck, "ltspice")
    assert set(spoken) == {p.filename.replace(".lib", ".asy") for p in deck.parts}
    assert "SYMATTR ModelFile kick.lib\n" in spoken["kick.asy"]
    assert symbol_files(deck, "xyce") == symbol_files(deck, "verilog-a") == {}
