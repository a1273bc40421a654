"""Buzzers of data sheets, from their scenes and textbook materials: nothing is fitted."""

import tomllib
from pathlib import Path

import pytest
from support import disc

ROOT = Path(__file__).parents[2]
PUBLISHED = tomllib.loads((ROOT / "docs" / "published.toml").read_text("utf-8"))
BUZZERS = [
    name
    for name, entry in PUBLISHED.items()
    if name.startswith("buzzer_") and "capacitance_f" in entry
]


def keys_of(name):
    text = (ROOT / "kc2spice" / "scenes" / f"{name}.toml").read_text("utf-8")
    assert len(text.splitlines()) < 40
    table = tomllib.loads(text)["disc"]
    assert table.pop("part") == "disc"
    assert {"anode", "cathode"} <= set(table.pop("pins"))
    return table


def test_every_buzzer_of_the_gallery_has_published_numbers():
    scenes = {path.stem for path in (ROOT / "kc2spice" / "scenes").glob("buzzer_*.toml")}
    circuits = {"buzzer_square", "buzzer_self", "buzzer_noise", "buzzer_and_speaker"}
    assert scenes - circuits == set(BUZZERS)
    assert len(BUZZERS) >= 6


@pytest.mark.parametrize("name", BUZZERS)
def test_resonance_and_capacitance_are_those_of_the_sheet_or_a_stated_miss(name):
    published = PUBLISHED[name]
    model = disc.make_disc_blocks(keys_of(name)).build_fe_model().model
    predicted = {
        "resonance_hz": model.facts["resonance_short_hz"],
        "capacitance_f": model.facts["capacitance_free_f"],
    }
    if "feedback_capacitance_f" in published:
        predicted["feedback_capacitance_f"] = model.facts["feedback_capacitance_f"]
    misses = published.get("misses", {})
    for quantity, value in predicted.items():
        sheet = published[quantity]
        inside = abs(value / sheet["value"] - 1) <= sheet["tolerance"]
        assert inside != (quantity in misses), (quantity, value, sheet)
