"""The emitted devices with a user's passive parts on their pins: they ring, and they die away."""

from dataclasses import replace

import numpy as np
from device import bench, deck_of
from support import load_scene, make_coils_subcircuit, run_deck

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
    of_products = table.coefficients * [0.0, 1.0, 1.0, 0.0, 1.0, 0.0]
    coils = replace(table, coefficients=of_products, inductance=inductance)
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
    deck = bench([make_coils_subcircuit(header, coils, points=21)], "\n".join(cards), vectors, 3e-4)
    return run_deck(deck, tmp_path), vectors


def test_coils_die_away_under_random_passive_parts(header, table, tmp_path):
    decays(*coils_ring(header, table, tmp_path))
