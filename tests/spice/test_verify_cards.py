"""Every card of a body's subcircuit, changed by a little, is seen by ``verify``'s gates of it."""

import re
from pathlib import Path

import numpy as np
import pytest

from kc2spice.core.progress import Clock, silent
from kc2spice.netlist.read import subcircuits
from kc2spice.rom.linear import LinearModel
from kc2spice.rom.response import relative_error
from kc2spice.scene.load import load_scene
from kc2spice.workflow.decks import make_deck
from kc2spice.workflow.models import build_models
from kc2spice.workflow.verify import bodies

SMALL = ("kick.layers=2", "kick.mesh.sectors=4", "kick.mesh.rings=1", "kick.mesh.outer_rings=1",
         "rom.order=6", "contact.rings=all", "catch.positions=4")  # fmt: skip
SHIPPED = Path(__file__).parents[2] / "netlists/kick_and_catch/kick.lib"
CARD = re.compile(r"(?m)^([GCR]\w+ +)((?:\S+ +)+?)(\{damping\*)?(-?\d[\d.e+-]*)(\}?)$")
# The tick that makes the first step small, the leak of a floating anode and the links to the pins,
# whose equation has no other term, change nothing that could be seen in the band; nor does the
# inertia of the highest mode.
NOTHING = re.compile(r"Rtick |Gleak |Gfring\d base fring")
ABOVE_THE_BAND = re.compile(r"Cp6 ")


@pytest.fixture(scope="module")
def chip():
    build = build_models(load_scene("kick_and_catch", list(SMALL)), Clock(silent))
    text = make_deck(build).files["kick.lib"]
    return build, text


def missed_gates(build, text, folder):
    """Names of the netlist's checks that fail."""
    part = build.scene.parts["kick"]
    rom, band = build.model(part), (0.0, 500e3)
    libraries = tuple(subcircuits(text, "kick.lib"))
    waves = bodies.netlist_response(part, build, libraries, Clock(silent), folder, band)
    frequency = waves["frequency"].real
    found, exact = bodies._matrix(waves, rom), rom.transfer(frequency)
    leak = bodies.leakage(rom, frequency)
    own = build.scene.gates.harmonic_ngspice
    leaked = bodies.LEAKED * leak.max()
    limits = [
        bodies.Limit("all ports", relative_error(found, exact), max(own, leaked)),
        *bodies.electrical_checks("kick", rom, found, exact, own, leak),
        *bodies.structure("netlist", frequency, found, max(bodies.NETLIST_ROUNDING, leaked)),
    ]
    return [limit.name for limit in limits if not limit.passed]


def test_the_emitted_subcircuit_passes(chip, tmp_path):
    assert missed_gates(*chip, tmp_path) == []


def unseen(build, text, folder):
    """Cards that may be 0.1 % larger without a gate that notices."""
    missed = []
    for number, card in enumerate(CARD.finditer(text)):
        value = f"{float(card[4]) * 1.001!r}"
        changed = text[: card.start(4)] + value + text[card.end(4) :]
        part = folder / str(number)
        part.mkdir()
        if not missed_gates(build, changed, part):
            missed.append(card[0])
    return missed


def test_one_changed_card_fails(chip, tmp_path):
    """By 0.1 %: couplings, stiffness, damping, inertia, capacitance and the links to the pins."""
    assert len(list(CARD.finditer(chip[1]))) > 40
    missed = [line for line in unseen(*chip, tmp_path) if not ABOVE_THE_BAND.match(line)]
    assert [line for line in missed if not NOTHING.match(line)] == []


@pytest.mark.slow
def test_one_changed_card_of_the_committed_chip_fails(tmp_path):
    """All of ``netlists/kick_and_catch/kick.lib``, against the default scene's model."""
    build = build_models(load_scene("kick_and_catch"), Clock(silent))
    text = SHIPPED.read_text(encoding="utf-8")
    assert missed_gates(build, text, tmp_path) == []
    assert [line for line in unseen(build, text, tmp_path) if not NOTHING.match(line)] == []


def test_a_sample_of_frequencies_has_the_highest_resonances():
    """Of masses on springs, 1 kHz to 30 kHz, that one port drives."""
    peaks = np.geomspace(1e3, 3e4, 6)
    rom = LinearModel(M=np.eye(6), K=np.diag((2 * np.pi * peaks) ** 2), B=np.ones((6, 1)),
                      rayleigh=(1.0, 0.0))  # fmt: skip
    beside = np.setdiff1d(np.linspace(500.0, 4e4, 80), peaks)
    chosen = bodies._first(rom, np.r_[beside, peaks], 12)
    assert set(peaks) <= set(chosen)
    assert chosen.size == 12


@pytest.mark.parametrize(
    ("load", "words"), [("anode", "capacitance of anode"), ("ring0", "charge by loads of anode")]
)
def test_each_charge_has_a_check_of_its_own(chip, load, words):
    build, _ = chip
    rom = build.model(build.scene.parts["kick"])
    exact = rom.transfer(np.array([1e5, 2e5]))
    found = exact.copy()
    found[1, rom.outputs.index("anode"), rom.inputs.index(load)] *= 1.0001
    checks = bodies.electrical_checks("kick", rom, found, exact, 5e-9, np.zeros(1))
    assert [check.name for check in checks if not check.passed] == [f"kick: {words}"]


@pytest.mark.parametrize(
    ("change", "words"),
    [(np.array([[0, 1e-6], [0, 0]]), "reciprocity"), (-0.1j * np.eye(2), None),
     (0.1j * np.eye(2), "active power over all frequencies")],
)  # fmt: skip
def test_structure_is_that_of_a_passive_network(change, words):
    """Charge that lags its voltage takes power; that leads gives it."""
    frequency = np.array([1e3, 2e3])
    H = np.array([[1.0, 0.2], [0.2, 1.0]]) * (1 - 0.01j) + change
    found = bodies.structure("x", frequency, np.array([H, H]), 1e-9)
    assert [c.name for c in found if not c.passed] == ([f"x, {words}"] if words else [])
