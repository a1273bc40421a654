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
    ("scene", "material", "key", "text", "unit", "values"),
    [
        ("harvester", 'beam.layers[1].material={like="brass"}', "density", "8 g/cm3:9 g/cm3:3",
         "kg/m3", (8000, 8500, 9000)),
        ("harvester", 'beam.layers[1].material={like="brass"}', "youngs_modulus", "9e10:11e10:3",
         "Pa", (9e10, 1e11, 1.1e11)),
        ("harvester", 'beam.layers[0].material={like="PZT-5A"}', "strain_coupling.d31",
         "log:-1.6e-10:-1.8e-10:2", "C/N", (-1.6e-10, -1.8e-10)),
        ("harvester", 'beam.layers[0].material={like="PZT-5A"}', "compliance.s11",
         "16e-12:17e-12:2", "1/Pa", (16e-12, 17e-12)),
        ("harvester", 'beam.layers[0].material={like="PZT-5A"}', "permittivity.eps33",
         "1700:1900:3", "", (1700, 1800, 1900)),
        ("harvester", 'beam.layers[0].material={like="PZT-5A"}', "quality", "50:90:2", "",
         (50, 90)),
        ("kick_and_catch", 'kick.material={like="PZT-5A"}', "density", "7600:7800:2", "kg/m3",
         (7600, 7800)),
        ("impact", 'sphere.material={like="steel"}', "youngs_modulus", "200 GPa:210 GPa:2", "Pa",
         (200e9, 210e9)),
    ],
)  # fmt: skip
def test_ranges_of_material_constants(scene, material, key, text, unit, values):
    name = f"{material.partition('=')[0]}.{key}"
    found = make_sweep(SceneInput(scene, None), (material, f"{name}={text}"))
    assert found.units == {name: unit}
    points = [found.plan.values(k)[name] for k in range(found.plan.size)]
    assert points == pytest.approx(values)


@pytest.mark.parametrize(
    ("key", "text", "mean", "half"),
    [
        ("strain_coupling.d31", "normal(-170e-12,8e-12,400)", -170e-12, 8e-12),
        ("density", "uniform(7600,7800,400)", 7700, 100 / 3**0.5),
    ],
)
def test_random_material_constants(key, text, mean, half):
    name = f"beam.layers[0].material.{key}"
    sets = ('beam.layers[0].material={like="PZT-5A"}', f"{name}={text}")
    plan = make_sweep(HARVESTER, sets, seed=1).plan
    drawn = [plan.values(k)[name] for k in range(plan.size)]
    assert sum(drawn) / 400 == pytest.approx(mean, abs=0.2 * half)
    variance = sum((value - mean) ** 2 for value in drawn) / 400
    assert variance**0.5 == pytest.approx(half, rel=0.15)


def test_a_material_key_that_is_not_a_number_has_no_range():
    sets = ('beam.layers[1].material={like="brass"}', "beam.layers[1].material.conductor=0:1:2")
    with pytest.raises(UsageError):
        make_sweep(HARVESTER, sets)


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
