"""Libraries edited beside a deck: parts are judged by the netlist's own parameters, or not at all.

The energy balance of a declared part sees a flux, a loss or a stiffness that is not the declared
one, as it takes voltages, currents and forces from its pins.
"""

import json
import warnings

import pytest
from support import (
    RunEnergyBalance,
    StageTimer,
    export_scene,
    prepare_deck,
    run_scene,
    run_simulation,
)

import kc2spice as kc

SCENES = {"duffing": ("spring", "cubic_spring"), "loudspeaker": ("coil", "voice_coil")}


def edited(scene, folder, old, new, file=None):
    """The scene's deck beside a library in which ``old`` is replaced."""
    export_scene(kc.load_scene(scene), folder / "ex")
    path = folder / "ex" / (file or f"{SCENES[scene][1]}.lib")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    return folder / "ex" / f"{scene}.cir"


def energy(record, part):
    return next((c for c in record["checks"] if c["name"] == f"energy of {part}"), None)


@pytest.mark.parametrize(
    ("scene", "key", "old", "new"),
    [("duffing", "stiffness", 100.0, 120.0), ("loudspeaker", "resistance", 6.0, 12.0)],
)
@pytest.mark.parametrize("where", ["library", "instance"])
def test_a_part_is_judged_by_the_value_that_the_netlist_has(scene, key, old, new, where, tmp_path):
    part, library = SCENES[scene]
    if where == "library":
        deck = edited(scene, tmp_path, f"{key}={old:g}", f"{key}={new:g}")
    else:
        deck = edited(scene, tmp_path, f" {library}\n", f" {library} {key}={new}\n", f"{scene}.cir")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        record = run_scene(kc.load_scene(scene), tmp_path / "out", deck=deck)
    assert energy(record, part)["value"] < 1e-4
    set_by_key = run_scene(kc.load_scene(scene, {f"{part}.{key}": new}), tmp_path / "own")
    same = {k: v for k, v in record["metrics"].items() if isinstance(v, float)}
    assert same == pytest.approx({k: set_by_key["metrics"][k] for k in same}, rel=1e-6)


@pytest.mark.parametrize(
    ("scene", "old", "new"),
    [
        ("duffing", "stiffness=100", "stiffness=120"),
        ("loudspeaker", "resistance=6", "resistance=12"),
        ("loudspeaker", "(bl*(1e-6*V(a,b))+0.5", "(1.1*bl*(1e-6*V(a,b))+0.5"),  # flux, not force
        ("loudspeaker", "damping=0.8", "damping=1.6"),
        ("loudspeaker", "inductance=500u", "inductance=4m"),
    ],
)
def test_the_balance_detects_undeclared_energy(scene, old, new, tmp_path):
    """The scene's keys against the run of a netlist with another value."""
    name = SCENES[scene][0]
    loaded = kc.load_scene(scene)
    _, deck = prepare_deck(loaded, StageTimer(), edited=edited(scene, tmp_path, old, new))
    build, _ = prepare_deck(loaded, StageTimer())
    waves = run_simulation(build, deck, tmp_path)
    part = loaded.parts[name]
    (balance,) = [
        row for row in part.type.checks(part, build, waves) if isinstance(row, RunEnergyBalance)
    ]
    assert balance.relative_imbalance > 1.5 * balance.limit


def test_a_library_with_other_cards_is_not_checked_and_states_the_reason(tmp_path):
    old = "voltage minus the time derivative of the flux = resistance*i"
    deck = edited("loudspeaker", tmp_path, "I={1e-6*V(a,b)/", "I={1.1e-6*V(a,b)/")
    with pytest.warns(UserWarning, match="coil: cards of its subcircuit voice_coil differ"):
        record = run_scene(kc.load_scene("loudspeaker"), tmp_path / "out", deck=deck)
    assert energy(record, "coil") is None
    assert json.loads((tmp_path / "out" / "result.json").read_text())["checks"]
    again = edited("loudspeaker", tmp_path / "b", old, f"{old}, a comment")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        record = run_scene(kc.load_scene("loudspeaker"), tmp_path / "out2", deck=again)
    assert energy(record, "coil")["value"] < 1e-4


@pytest.mark.parametrize(
    "scene", ["kick_and_catch", "coil_rails", "pwm_coil", "three_cycles", "charge_kick"]
)
def test_an_unedited_export_has_no_edits(scene, tmp_path):
    """Libraries print 1e7 as 10meg; a changed value in an inner subcircuit is still an edit."""
    loaded = kc.load_scene(scene)
    export_scene(loaded, tmp_path)
    deck, library = tmp_path / f"{scene}.cir", tmp_path / "pid.lib"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        prepare_deck(loaded, StageTimer(), edited=deck)
    library.write_text(library.read_text().replace("ref a0=10meg", "ref a0=9meg"))
    with pytest.warns(UserWarning, match="control: cards of its subcircuit pid differ"):
        prepare_deck(loaded, StageTimer(), edited=deck)


@pytest.mark.parametrize(
    ("scene", "metric", "card", "advised"),
    [
        ("impact", "min_position_m", ".tran", "uic at the end"),
        ("duffing", "largest_force_n", ".ic", ".ic"),
    ],
)
def test_a_deck_without_its_initial_state_causes_a_warning(scene, metric, card, advised, tmp_path):
    """The advised text restores the motion."""
    loaded = kc.load_scene(scene)
    export_scene(loaded, tmp_path / "ex")
    deck = tmp_path / "ex" / f"{scene}.cir"
    text = deck.read_text()
    line = next(line for line in text.splitlines(keepends=True) if line.startswith(card))
    deck.write_text(text.replace(line, line.replace(" uic", "") if card == ".tran" else ""))
    with pytest.warns(UserWarning, match=f"ignores initial .* because the deck lacks .*{advised}"):
        still = run_scene(loaded, tmp_path / "still", deck=deck)
    assert still["metrics"][metric] == pytest.approx(0.0, abs=1e-12)
    deck.write_text(text)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        moving = run_scene(loaded, tmp_path / "moving", deck=deck)
    assert abs(moving["metrics"][metric]) > 1e-6
