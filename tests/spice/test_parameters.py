"""A parameter changed in the deck gives what a new export with that value gives."""

import re
from dataclasses import replace

import numpy as np
import pytest
from device import deck_of
from support import (
    AnalysisCommand,
    Deck,
    StackKeys,
    make_stack,
    reduce_model,
    require_valid_wiring,
    run_deck,
    subcircuit,
)

STOP = 0.56e-3


@pytest.fixture(scope="module")
def decks(model, table):
    def make(scene):
        return deck_of(scene, model, table)

    return make


def interface(text):
    """Defaults on the ``.subckt`` card of a library."""
    card = re.search(r"(?m)^\.subckt (.*)$", text.replace("\n+", ""))[1]
    return dict(w.split("=") for w in card.split() if "=" in w)


def overridden(base, other):
    """``base`` with the parameters of ``other`` set on its instances, and what was set."""
    deck, given = base, {}
    for ours, theirs in zip(base.parts, other.parts, strict=True):
        before, after = interface(ours.text), interface(theirs.text)
        changed = {k: v for k, v in after.items() if before[k] != v}
        if changed:
            deck = with_words(deck, ours.name, {k: str(v) for k, v in changed.items()})
            given |= {f"{kind(ours.name)}.{k}": v for k, v in changed.items()}
    return deck, given


def kind(name):
    """Name of a subcircuit without what tells it from others of its kind."""
    return re.sub(r"_[0-9a-f]{6}$", "", name)


def with_words(deck, subcircuit, words):
    """Parameters of the instance of a subcircuit."""
    name = re.compile(rf"{subcircuit}(_[0-9a-f]{{6}})?")
    (card,) = [item for item in deck.items if item.kind == "x" and name.fullmatch(item.model)]
    changed = replace(card, parameters=words)
    return replace(deck, items=tuple(changed if item is card else item for item in deck.items))


def short(deck):
    first, _, *rest = deck.command.words
    return replace(deck, command=AnalysisCommand("tran", (first, repr(STOP), *rest)), stop=STOP)


SECTIONS = {
    "contact": {"penalty": 7e7}, "sphere": {"density": 9000.0, "radius": 1.2e-3},
    "control": {"setpoint": 2.0e-3, "kp": 3e4, "ki": 1e3, "kd": 15.0, "rolloff": 2e-7,
                "current_limit": 0.06},
}  # fmt: skip


def test_changed_parameters_equal_a_new_export(scene, varied, decks, tmp_path):
    keys = {
        f"{part}.{key}": value for part, each in SECTIONS.items() for key, value in each.items()
    }
    base, exported = decks(scene), decks(varied(gravity=1.62, **keys))
    by_hand, given = overridden(base, exported)
    assert set(given) == {
        "contact.eps", "contact.radius", "sphere.mass", "sphere.radius", "sphere.gravity",
        *(f"pid.{key}" for key in SECTIONS["control"]),
    }  # fmt: skip
    require_valid_wiring(by_hand)
    runs = [run_deck(short(d), tmp_path / n) for n, d in
            (("base", base), ("hand", by_hand), ("export", exported))]  # fmt: skip
    for key in ("sphere.y", "contact.force", "kick.u.ring0", "coil.upper.current", "control.error"):
        hand, export = runs[1][key], runs[2][key]
        # the same numbers reach the same cards, so even the time steps are the same
        np.testing.assert_allclose(hand, export, rtol=1e-9, atol=1e-9 * np.max(np.abs(export)))
    assert not np.array_equal(runs[0]["sphere.y"], runs[2]["sphere.y"]), "the change does nothing"


def test_damping_of_the_chip_scales(header, tmp_path):
    """A chip of few elements, reduced anew with three times the damping, against ``damping=3``."""
    parts = [chip({"ratio": ratio}, header) for ratio in (0.01, 0.03)]
    cases = {"old": (parts[0], ""), "hand": (parts[0], "damping=3"), "export": (parts[1], "")}
    vectors = {"u": ("v(ring0)", 1e-6), "i": ("i(vkick)", -1.0)}
    waves = {}
    for case, (part, given) in cases.items():
        text = f"""* bench
.include kick.lib
Vkick anode 0 AC 1
Xkick anode 0 ring0 ring1 ring2 ring3 ring4 ring5 0 kick {given}
.ac lin 500 1e3 5e5
.save v(ring0) i(vkick)
.end
"""
        deck = Deck(name="bench", text=text, more={"kick.lib": part.text}, vectors=vectors)
        waves[case] = run_deck(deck, tmp_path / case)
    for key in vectors:
        np.testing.assert_allclose(waves["hand"][key], waves["export"][key], rtol=1e-9)
        assert np.abs(waves["old"][key] / waves["export"][key]).max() > 2.0  # at the resonance


def chip(damping, header):
    device = make_stack(StackKeys(damping=damping, mesh={"sectors": 4, "outer_rings": 3})).model
    return subcircuit(reduce_model(device, order=30, band=(0.0, 500e3)), "kick", header)
