"""Heads of libraries: the error estimate, an instance to copy, and the length of lines."""

from dataclasses import replace
from pathlib import Path

import pytest
from support import (
    Certificate,
    Deck,
    Header,
    Pin,
    Printer,
    ReductionSummary,
    join_comments,
    read_cards,
    run_deck,
    with_parameters,
    write_part_header,
    write_rom_comments,
)

import kc2spice as kc

NETLISTS = Path(__file__).parents[2] / "netlists"


@pytest.mark.parametrize(
    ("error", "written"),
    [(1.2345e-4, "0.000124"), (1.23e-4, "0.000123"), (9.994e-3, "0.01"), (9.999e-3, "0.01"),
     (1e-6, "1e-06"), (1.001e-6, "1.01e-06")],
)  # fmt: skip
def test_a_bound_is_rounded_upwards(error, written):
    certificate = Certificate((0.0, 5e5), error, "residual", True, True)
    reduction = ReductionSummary(7, (0.0, 5e5), "pointwise", error, 1e-12, 3.0)
    first, second, *_ = lines = write_rom_comments(reduction, certificate)
    assert first == f"* rom: order=7 band=0.0..500000.0 Hz norm=pointwise error={written}"
    assert second.startswith("*   (residual; emitted circuit")
    told = "\n".join(lines).replace("\n*   ", " ")
    assert told.endswith("above the band, where a contact or a steep edge can excite modes")


def test_a_head_has_an_instance_to_copy_and_lines_of_100_characters():
    pins = (Pin("plus", "V", "A"), Pin("base", "um", "N"))
    long = "a body of " + "many words, " * 30
    lines = write_part_header(Header("scene", "0"), "part: title", pins, rating=long, validity=long)
    head = "\n".join(lines)
    assert "\n* use: X1 plus base part\n" in head
    assert max(map(len, head.splitlines())) <= 100
    assert long.strip() in head.replace("\n*   ", " ")


def declared_use(circuit):
    """The instance that the head of a subcircuit shows, as an element."""
    (line,) = (line for line in join_comments(circuit.notes) if line.startswith("* use: "))
    (element,) = read_cards(line.removeprefix("* use: ").replace(" + ", " ") + "\n", "use").items
    return element


@pytest.mark.parametrize("path", sorted(NETLISTS.glob("*/*.lib")), ids=lambda p: p.stem)
def test_the_instance_of_a_head_has_the_pins_and_parameters_of_its_subcircuit(path):
    text = path.read_text(encoding="utf-8")
    if "* tool:" not in text:
        return
    for circuit in read_cards(text, path.name).subcircuits:
        use = declared_use(circuit)
        assert (use.model, use.nodes) == (circuit.name, circuit.pins)
        assert use.parameters == circuit.defaults


def test_the_copied_instance_line_of_a_helper_runs(tmp_path):
    path = NETLISTS / "kick_and_catch" / "amplifier.lib"
    whole = read_cards(path.read_text("utf-8"), path.name)
    (helper,) = (c for c in whole.subcircuits if c.name == "amplifier_opamp_slew")
    assert "* amplifier_opamp_slew: operational amplifier with slew rate and current limit" in (
        helper.notes
    )
    use = Printer().card(replace(declared_use(helper), nodes=("in", "o", "o", "vp", "vn", "0")))
    sources = ["Vp vp 0 10", "Vn vn 0 -10", "Vin in 0 2.5"]
    cards = ["follower", f".include {path.name}", use, *sources, ".op", ".end", ""]
    more, vectors = {path.name: path.read_text("utf-8")}, {"o": ("v(o)", 1.0)}
    deck = Deck(name="use", text="\n".join(cards), more=more, vectors=vectors)
    assert run_deck(deck, tmp_path)["o"].real[-1] == pytest.approx(2.5, rel=1e-6)


def test_changed_parameters_change_the_instance_and_the_facts():
    loop = kc.deck("kick_and_catch")
    changed = with_parameters(loop, [("sphere.radius", 2e-3), ("opamp.gbw", 1e6)])
    texts = {part.name: part.text for part in changed.parts}
    assert " radius=2m " in texts["sphere"].partition("\n* tool:")[0]
    assert "* @param radius=0.002 unit=m " in texts["sphere"]
    assert " gbw=1meg " in texts["pid"].partition("* pid_opamp:")[2].partition("\n.subckt")[0]
    (sphere,) = (part for part in changed.parts if part.name == "sphere")
    assert {p.name: p.default for p in sphere.params}["radius"] == 2e-3


def test_libraries_of_scenes_without_a_chip_do_not_mention_it():
    for part in kc.deck("newtons_cradle").parts:
        assert "chip" not in part.text
