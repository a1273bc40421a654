"""A table within a part changes what it names and keeps the rest of the part's default."""

import pytest

from kc2spice.core.errors import UsageError
from kc2spice.fem.magnetics.keys import Catch
from kc2spice.scene.load import load_scene

EM = {"name": "em", "em_force": {}, "catch": {}, "sphere": {}}


def test_one_key_of_a_nested_table_keeps_the_others():
    usual = Catch().ring
    ring = load_scene(EM, ["catch.ring.outer=6 mm"]).parts["catch"].keys.ring
    assert ring == usual.model_copy(update={"outer": 6e-3})
    lower = load_scene(EM | {"catch": {"lower": {"y": "1.1 mm"}}}).parts["catch"].keys.lower
    assert lower == Catch().lower.model_copy(update={"y": 1.1e-3})


def test_unknown_keys_of_a_nested_table_are_refused():
    with pytest.raises(UsageError, match="unknown key"):
        load_scene(EM, ["catch.ring.outter=6 mm"])
