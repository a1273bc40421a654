"""The emitted devices with a user's passive parts on their pins: they ring, and they die away."""

from dataclasses import replace

import numpy as np
import pytest
from device import bench, deck_of

from kc2spice.bodies.piezo_stack import from_sector
from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.fem.piezo.keys import Chip
from kc2spice.parts.ring_magnet_coils import coil_subcircuit
from kc2spice.rom.modal import resonators
from kc2spice.rom.reduce import reduce
from kc2spice.scene.load import load_scene
from kc2spice.sim.ngspice import run_deck
from kc2spice.spice.realize import subcircuit

RINGS = ("ring0", "ring1", "ring2", "ring3", "ring4", "ring5")
COPIES = 40


def decays(waves, names):
    """Later swings are no larger than earlier ones, beyond what error control lets through."""
    t = waves["time"]
    third = t[-1] / 3
    for name in names:
        early = np.abs(waves[name][t < third]).max()
        late = np.abs(waves[name][t > 2 * third]).max()
        assert late <= 1.02 * early + 1e-9, name


def test_all_ports_of_the_emitted_kick_are_positive_real(header, model, tmp_path):
    """Any passive load is covered at once: j omega H has no negative hermitian part."""
    scene = load_scene({"name": "h", "kick": {}, "harmonic": {"stop": 5e6, "steps": 400}})
    waves = run_deck(deck_of(scene, model), tmp_path)
    names = (*RINGS, "anode")
    response = np.array([[waves[f"{i}>{o}"] for i in names] for o in names]).transpose(2, 0, 1)
    power = 2j * np.pi * waves["frequency"][:, None, None] * response
    hermitian = (power + power.conj().transpose(0, 2, 1)) / 2
    scale = np.sqrt(np.einsum("fii->fi", np.abs(power)).max(axis=0))
    smallest = np.linalg.eigvalsh(hermitian / np.outer(scale, scale)).min()
    assert smallest > -1e-9


def coils_ring(header, table, tmp_path, values=""):
    """R, L, C on both coils, a spring, a damper and a mass on the sphere's node, held at y."""
    rng = np.random.default_rng(4)
    inductance = np.tile([[43.8e-3, 7.3e-3], [7.3e-3, 43.8e-3]], (table.y.size, 1, 1))
    still = np.zeros_like(table.y)
    coils = replace(table, c0=still, c11=still, c22=still, inductance=inductance)
    cards, vectors = [], {}
    for k in range(COPIES):
        ohm, farad, henry, damper, mass = 10 ** rng.uniform([-2, -9, -4, -6, -5], [6, -6, 0, 0, -3])
        spring = 10 ** rng.uniform(0, 4)
        cards += [
            f"Vy{k} y{k} 0 {rng.uniform(-1000, 6000)}",
            f"Xcoil{k} a{k} 0 b{k} 0 y{k} v{k} 0 coil {values}",
            f"Ipush{k} 0 a{k} PULSE(0 1e-3 1e-05 1e-06 1e-06 1e-05)",
            f"R{k} a{k} 0 {ohm}", f"C{k} a{k} 0 {farad}", f"L{k} b{k} 0 {henry}",
            f"Cm{k} v{k} 0 {mass}", f"Rd{k} v{k} 0 {1 / damper}", f"Ls{k} v{k} 0 {1 / spring}",
        ]  # fmt: skip
        vectors[f"i{k}"] = (f"v(xcoil{k}.i1)", 1.0)
    cards += [".options reltol=1e-3 trtol=7 chgtol=1e-11", ".tran 1e-06 3e-04 0 6e-06"]
    deck = bench([coil_subcircuit(header, coils, points=21)], "\n".join(cards), vectors, 3e-4)
    return run_deck(deck, tmp_path), vectors


def test_coils_die_away_under_random_passive_parts(header, table, tmp_path):
    decays(*coils_ring(header, table, tmp_path))


def test_coils_with_an_active_part_do_not(header, table, tmp_path):
    """The test above can fail: a negative resistance feeds the oscillation."""
    with pytest.raises(AssertionError):
        decays(*coils_ring(header, table, tmp_path, "resistance_lower=-3000"))


# ------------------------------------------------------------------------ a user's own deck


@pytest.fixture(scope="module")
def chip():
    """The paper's chip for a band of 1 MHz, whole device, with its full model."""
    device = from_sector(assemble_kick(Chip()))
    return device, resonators(reduce(device, tolerance=1e-5, band=(0.0, 1e6)))


@pytest.mark.slow
def test_resonance_and_antiresonance_of_the_chip(chip, header, tmp_path):
    """Largest and smallest current against eigenvalues of the full model, to 0.1 %."""
    device, model = chip
    cards = """Vdrive in 0 AC 1
Xkick in 0 ring0 ring1 ring2 ring3 ring4 ring5 0 kick
.ac lin 2401 260e3 380e3"""
    vectors = {"i": ("i(vdrive)", -1.0)}
    waves = run_deck(bench([subcircuit(model.linear(), "kick", header)], cards, vectors), tmp_path)
    size, facts = np.abs(waves["i"]), device.facts
    series, parallel = (waves["frequency"][k] for k in (np.argmax(size), np.argmin(size)))
    assert series == pytest.approx(facts["resonance_short_hz"], rel=1e-3)
    assert parallel == pytest.approx(facts["resonance_open_hz"], rel=1e-3)


@pytest.mark.slow
def test_impedance_is_that_of_the_full_model(chip, header, tmp_path):
    """Direct solutions of all 16 722 equations at the resonance and far above."""
    device, model = chip
    frequency = np.array([270e3, 900e3])
    full = device.transfer(frequency)[:, -1, -1]
    for f, charge in zip(frequency, full, strict=True):
        cards = f"Vdrive in 0 AC 1\nXkick in 0 {' '.join(RINGS)} 0 kick\n.ac lin 1 {f} {f}"
        deck = bench(
            [subcircuit(model.linear(), "kick", header)], cards, {"i": ("i(vdrive)", -1.0)}
        )
        current = run_deck(deck, tmp_path / str(f))["i"][0]
        assert current / (2j * np.pi * f * charge) == pytest.approx(1.0, abs=1e-4)
