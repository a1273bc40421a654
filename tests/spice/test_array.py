"""Every copy of an array does what the scene alone does."""

import numpy as np
import pytest
from device import deck_of
from support import UsageError, load_scene, make_array_deck, run_deck


@pytest.mark.parametrize("name", ["impact", "harmonic"])
def test_copies_have_the_results_of_the_scene(name, model, table, tmp_path):
    deck = deck_of(load_scene(name), model, table)
    array = make_array_deck(deck, 3)
    alone, together = run_deck(deck, tmp_path / "one"), run_deck(array, tmp_path / "three")
    for copy in (1, 3):
        for key in deck.vectors:
            one, many = alone[key], together[f"{copy}.{key}"]
            scale = np.abs(one).max()
            if "time" in alone:  # steps differ by rounding
                assert np.abs(many).max() == pytest.approx(scale, rel=1e-4, abs=1e-12), key
            else:
                np.testing.assert_allclose(many, one, rtol=1e-9, atol=1e-12 * scale)


def test_sweeps_and_wrong_numbers_are_refused(model, table):
    with pytest.raises(UsageError, match="sweep"):
        make_array_deck(deck_of(load_scene("imprint"), model, table), 2)
    with pytest.raises(UsageError, match="copies"):
        make_array_deck(deck_of(load_scene("impact"), model, table), 0)
