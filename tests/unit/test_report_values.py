"""Device pictures and values of a report in the form that a person reads."""

import re
from dataclasses import astuple

import pytest
from support import RomKeys, describe_reduction_target, format_quantity, write_side_view_caption

import kc2spice as kc

RING = {"conductor.inner": "20 mm"}


def outline(overrides):
    scene = kc.load_scene("levitated_disc", overrides)
    part = scene.get_part("conductor")
    return scene, [shape for shape in part.type.outline(part, scene) if shape.kind == "metal"]


def test_a_disc_is_drawn_at_its_start_position():
    scene, (disc,) = outline({})
    # 65 mm radius, 3 mm thickness, position 3.8 mm: the values of the scene's file
    assert astuple(disc)[:4] == pytest.approx((0.0, 3.8e-3, 0.13, 3e-3))
    assert "conductor: disc of 130 mm" in write_side_view_caption(scene)


def test_a_ring_is_drawn_on_both_sides_of_its_hole():
    _, sides = outline(RING)
    edges = sorted((shape.x - shape.width / 2, shape.x + shape.width / 2) for shape in sides)
    assert edges == [pytest.approx((-0.065, -0.02)), pytest.approx((0.02, 0.065))]


def test_descriptions_have_prefixes():
    text = describe_reduction_target(RomKeys(band=("0 Hz", "500 kHz")))
    assert text.endswith("from 0 Hz to 500 kHz")
    scene = kc.load_scene("kick_and_catch")
    notes = []
    for part in scene.parts.values():
        notes += [note for note in part.type.notes(part, scene) if isinstance(note, str)]
    assert notes
    assert not [note for note in notes if re.search(r"e-0\d m\b|\d{5} Hz", note)]


@pytest.mark.parametrize(
    ("scene", "part", "text"),
    [
        ("harvester", "load", "resistor of 33 kΩ"),
        ("harvester_bridge", "store", "capacitor of 1 µF"),
        ("impact", "contact", "2 unilateral springs, 400 MN/m each"),
        ("newtons_cradle", "sphere1", "32.92 g, vertical motion"),
        ("levitated_disc", "conductor", "up to 1 kHz"),
    ],
)
def test_a_part_is_described_with_prefixes(scene, part, text):
    loaded = kc.load_scene(scene)
    described = loaded.get_part(part)
    notes = described.type.notes(described, loaded)
    assert text in next(note for note in notes if isinstance(note, str))


def test_units_of_couplings_have_superscripts():
    assert format_quantity(3.25e-9, "kg s2") == "3.25e-09 kg·s²"
