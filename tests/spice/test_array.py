"""Every copy of an array does what the scene alone does."""

import dataclasses

import numpy as np
import pytest
from device import deck_of

from kc2spice.core.errors import UsageError
from kc2spice.netlist.array import array_deck
from kc2spice.netlist.deck import Block, Deck
from kc2spice.netlist.dialect import translate
from kc2spice.scene.load import load_scene
from kc2spice.sim.ngspice import run_deck


@pytest.mark.parametrize("name", ["impact", "harmonic"])
def test_copies_do_what_the_scene_does(name, model, table, tmp_path):
    deck = deck_of(load_scene(name), model, table)
    array = array_deck(deck, 3)
    alone, together = run_deck(deck, tmp_path / "one"), run_deck(array, tmp_path / "three")
    for copy in (1, 3):
        for key in deck.vectors:
            one, many = alone[key], together[f"{copy}.{key}"]
            scale = np.abs(one).max()
            if "time" in alone:  # steps differ by rounding
                assert np.abs(many).max() == pytest.approx(scale, rel=1e-4, abs=1e-12), key
            else:
                np.testing.assert_allclose(many, one, rtol=1e-9, atol=1e-12 * scale)


def test_other_decks_have_copies_too(model, table):
    array = array_deck(deck_of(load_scene("impact"), model, table), 2)
    assert translate(array, "xyce").vectors["2.sphere.y"][0] == "V(x2:sphere_y)"


def test_sweeps_and_wrong_numbers_are_refused(model, table):
    with pytest.raises(UsageError, match="sweep"):
        array_deck(deck_of(load_scene("imprint"), model, table), 2)
    with pytest.raises(UsageError, match="copies"):
        array_deck(deck_of(load_scene("impact"), model, table), 0)


def test_as_many_copies_as_asked():
    deck = Deck(name="one", blocks=(Block("", ("R1 a 0 1",)),), vectors={"a": ("v(a)", 2.0)},
                initial={"a": 3.0}, units={"a": "m"})  # fmt: skip
    for count in (1, 2, 10_000):
        array = array_deck(deck, count)
        copies = array.blocks[-1].cards
        assert copies == tuple(f"X{k} 0 one_unit" for k in range(1, count + 1))
        assert len(array.vectors) == len(array.initial) == count
    for count in (-1, 0, 10_001):
        with pytest.raises(UsageError, match="copies"):
            array_deck(deck, count)
    array = array_deck(deck, 2)
    assert array.vectors == {"1.a": ("v(x1.a)", 2.0), "2.a": ("v(x2.a)", 2.0)}
    assert (array.initial, array.units) == ({"x1.a": 3.0, "x2.a": 3.0}, {"1.a": "m", "2.a": "m"})
    text = array.files["one.cir"]
    assert text.index(".subckt one_unit common") < text.index("R1 a 0 1") < text.index(".ends one")


def test_a_current_of_a_source_is_that_of_the_copys(model, table):
    deck = deck_of(load_scene("impact"), model, table)
    one = dataclasses.replace(deck, vectors={"i": ("i(Vmeter)", 1.0), "n": ("i(v.xa.vb)", 1.0)})
    found = {name: text for name, (text, _) in array_deck(one, 2).vectors.items()}
    assert found["2.i"].lower() == "i(v.x2.vmeter)"
    assert found["1.n"] == "i(v.x1.xa.vb)"
