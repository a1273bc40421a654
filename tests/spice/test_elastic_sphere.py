"""The elastic sphere in scenes: what is refused, and an impact on what hardly gives, by Hertz."""

import pytest
from support import UsageError, load_scene

PRESSED = ("contact.shape=pressure", "sphere.elastic=true")


@pytest.mark.parametrize(
    ("keys", "where"),
    [
        (["sphere.elastic=true"], "contact.shape"),
        ([*PRESSED, "contact.damping=0.1"], "contact.damping"),
        ([*PRESSED, "sphere.material=PZT-5A"], "sphere.material"),
        ([*PRESSED[:1], "sphere.elastic.damping.per_material=true"], "per_material"),
        ([*PRESSED[:1], "sphere.elastic.damping.ratoi=1"], "ratoi"),
        ([*PRESSED, "sphere.radius=0.2 mm"], "contact.shape"),
    ],
)
def test_keys_without_an_effect_on_the_sphere_are_rejected(keys, where):
    with pytest.raises(UsageError) as raised:
        load_scene("impact", keys)
    assert where in str(raised.value.where)


def test_an_elastic_sphere_has_one_contact():
    with pytest.raises(UsageError, match="one contact") as raised:
        load_scene("newtons_cradle", ["sphere2.elastic=true"])
    assert "sphere2.elastic" in str(raised.value.where)
    with pytest.raises(UsageError, match="one contact") as raised:
        load_scene({"name": "b", "sphere": {"elastic": True}, "analysis": {"type": "op"}})
    assert raised.value.got == "none"
