"""Entries of lists by number: in overrides, sweeps, draws and Python; what is wrong with them."""

import pytest
from support import SceneInput, UsageError, make_sweep

import kc2spice as kc

HARVESTER = SceneInput("harvester", None)


def layers(scene):
    return scene.parts["beam"].keys.layers


def test_an_entry_is_counted_from_the_beginning_or_from_the_end():
    before = layers(kc.load_scene("harvester"))
    changed = {"beam.layers[0].thickness": "0.3 mm", "beam.layers[-1].material": "PZT-5H"}
    found = layers(kc.load_scene("harvester", changed))
    assert [layer.thickness for layer in found] == pytest.approx([3e-4, 1.4e-4, 2.6e-4])
    assert [found[0].material, found[2].material] == ["PZT-5A", "PZT-5H"]
    assert found[1] == before[1]


def test_entries_are_swept_and_drawn():
    sets = (
        "beam.layers[0].thickness=0.2 mm:0.3 mm:3",
        "beam.layers[-1].material=PZT-5A,PZT-5H",
        "beam.layers[1].thickness=normal(0.14 mm, 1 um, 4)",
    )
    found = make_sweep(HARVESTER, sets)
    assert found.plan.size == 24
    assert found.units == dict.fromkeys(
        ("beam.layers[0].thickness", "beam.layers[1].thickness"), "m"
    ) | {"beam.layers[-1].material": ""}
    values = found.plan.values(23)
    scene = found.job.load(values)
    assert layers(scene)[0].thickness == 3e-4
    assert layers(scene)[1].thickness == values["beam.layers[1].thickness"]
    assert layers(scene)[2].material == "PZT-5H"
    assert found.run_counts == {"netlists": 24, "ngspice": 24}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("beam.layers[3].thickness=1 mm", ("no such entry", "beam.layers[0] … beam.layers[2]")),
        ("beam.layers[-4].thickness=1 mm", ("no such entry", "beam.layers[-4]")),
        ("beam.layers.thickness=1 mm", ("beam.layers is a list, not a table", "beam.layers[0]")),
        ("beam.length[0]=1 mm", ("beam.length is not a list",)),
        ("beam.layers[0].thicknes=1 mm", ("unknown key", "thickness")),
        ("beam.layers[0].thickness=1 kg", ("beam.layers[0].thickness=1 kg",)),
        ("beam.layers[x].thickness=1 mm", ("not the name of a key",)),
        ("beam.layers[].thickness=1 mm", ("not the name of a key",)),
        ("beam.[0]=1 mm", ("not the name of a key",)),
    ],
)
def test_errors_of_a_path_state_the_fault(text, words):
    from support import load_scene

    with pytest.raises(UsageError) as caught:
        load_scene("harvester", [text])
    error = caught.value
    said = " ".join(map(str, (error.message, error.where, error.got, error.expected, error.hint)))
    assert all(word in said for word in words), said
    assert "--set" in said
