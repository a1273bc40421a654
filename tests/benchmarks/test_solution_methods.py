"""Lower bound and peers against the event-driven reference, forms in .ac."""

from __future__ import annotations

import numpy as np
import pytest

from kc2spice.fem.piezo.keys import Chip
from kc2spice.netlist.deck import Deck
from kc2spice.sim.ngspice import run_deck
from kc2spice.spice.header import Header
from kc2spice.spice.realize import subcircuit
from kc2spice.workflow.decks import make_deck
from laboratory.distance import compare
from laboratory.forms import FORMS, with_form
from laboratory.fullmodel import factorisations
from laboratory.law import law
from laboratory.located import located
from laboratory.lower_bound import LowerBound
from laboratory.peers import integrate
from laboratory.usual.contact import contact_surface
from laboratory.usual.statics import imprint, imprint_refactorised
from laboratory.usual.system import quarter


@pytest.fixture(scope="module")
def exact(loop):
    return located(law(loop), loop.scene)


def opens(waves):
    """The located instant [s] at which the last ring opens before the sphere flies."""
    force, t = waves["contact.force"], waves["time"]
    last = np.flatnonzero((force > 0) & (t < 0.6e-3))[-1]
    return t[last + 1]


def test_lower_bound_flies_the_loop_exactly(loop, exact):
    waves = LowerBound(law(loop)).run(loop.scene)
    error = compare(waves, exact)
    # The magnets' pull is linearised for 2 us at a time during contact; all else is exact.
    assert error["velocity_relative"] < 1e-5
    assert abs(opens(waves) - opens(exact)) < 1e-11
    assert error["trajectory_m"] < 2e-8


def test_lower_bound_bounces_exactly_on_an_open_anode(bounce):
    equations = law(bounce)
    waves = LowerBound(equations).run(bounce.scene)
    error = compare(waves, located(equations, bounce.scene, 1e-10))
    assert error["velocity_relative"] < 1e-6
    assert error["trajectory_m"] < 1e-11


def test_peers_converge_to_the_reference(loop, exact):
    equations, scene = law(loop), loop.scene
    coarse, fine = (compare(integrate(equations, scene, "Radau", r), exact) for r in (1e-3, 1e-5))
    assert fine["velocity_relative"] < 1e-4
    assert fine["trajectory_m"] < coarse["trajectory_m"]


def ac_deck(model):
    part = subcircuit(model.linear(), "kick", Header("forms", "0"))
    rings = [pin.name for pin in part.pins if pin.flow == "N" and pin.name != "base"]
    main = "\n".join(
        ["* forms", f".include {part.filename}", "V1 anode 0 DC 0 AC 1",
         f"Xkick anode 0 {' '.join(rings)} 0 {part.name}",
         *(f"I{ring} 0 {ring} AC {0.1 * (k + 1)}" for k, ring in enumerate(rings)),
         ".ac lin 21 20k 1meg", *(f".save v({ring})" for ring in rings), ".save i(v1)", ".end", ""]
    )  # fmt: skip
    vectors = {ring: (f"v({ring.lower()})", 1.0) for ring in rings} | {"i": ("i(v1)", 1.0)}
    return Deck(name="forms", text=main, vectors=vectors, parts=(part,))


@pytest.mark.parametrize(
    ("form", "behavioural", "limit"),
    [*((form, False, 1e-9) for form in FORMS), ("resonators", True, 1e-7)],
)
def test_every_form_is_the_same_device(model, form, behavioural, limit, tmp_path):
    """Numbers in B sources keep 11 digits, which the resonances magnify; in G sources all."""
    deck = ac_deck(model)
    ours = run_deck(deck, tmp_path / "ours")
    other = run_deck(with_form(deck, model, form, behavioural=behavioural), tmp_path / "other")
    for name in deck.vectors:
        assert np.abs(other[name] - ours[name]).max() <= limit * np.abs(ours[name]).max()


def test_ngspice_flies_the_same_loop(loop, exact, tmp_path):
    """The netlist comes from the parts, the exact solution from the laboratory's own equations."""
    error = compare(run_deck(make_deck(loop), tmp_path), exact)
    assert error["velocity_relative"] < 1e-4
    assert error["trajectory_m"] < 1e-6


def test_count_of_factorisations_is_that_of_the_code():
    chip = Chip(layers=3, mesh={"sectors": 4, "rings": 2, "ring_spacing": 300e-6, "outer_rings": 2})
    system, surface = quarter(chip), contact_surface(chip, 1e8, 1e-3)
    depth = np.linspace(0.0, 60e-6, 7)
    counted = factorisations(imprint(system, surface, depth).ring_force)
    assert counted == imprint_refactorised(system, surface, depth).iterations.sum()
