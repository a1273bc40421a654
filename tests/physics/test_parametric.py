"""Reduced models over boxes of parameters against full ones at parameters that none had seen."""

from dataclasses import replace

import numpy as np
import pytest

import kc2spice as kc
from kc2spice.core.progress import Clock
from kc2spice.rom.parametric import Axis, parametric

BUZZER = {
    "name": "buzzer",
    "disc": {
        "part": "disc",
        "layers": [
            {"material": "brass", "diameter": 20e-3, "thickness": 0.2e-3},
            {"material": "PZT-5A", "diameter": 14e-3, "thickness": 0.22e-3},
        ],
        "damping": {"quality": 50},
    },
}


def buzzer(values):
    """The disc with its electrical port, on the mesh of the scene above."""
    like = kc.load_scene(BUZZER).part("disc")
    scene = kc.load_scene(BUZZER, {f"disc.{key}": value for key, value in values.items()})
    part = scene.part("disc")
    return part.type.varied(part, scene, Clock(), like).select(["anode"])


def oscillators(values):
    """Two masses on springs that a weak one couples; their frequencies cross where k1 = 2 N/m."""
    k1, k2, weak = values["k"], 2.0, 0.02
    K = np.array([[k1 + weak, -weak], [-weak, k2 + weak]])
    return kc.LinearModel(M=np.eye(2), K=K, B=np.eye(2), rayleigh=(0.02, 0.0))


def test_frequencies_may_cross_within_the_box():
    made = parametric(oscillators, [Axis("k", 1.0, 4.0)], (0.01, 0.5), degree=9)
    f = np.linspace(0.05, 0.5, 200)
    for k in (1.1, 1.97, 2.0, 2.05, 3.7):
        exact = oscillators({"k": k}).transfer(f)
        assert made.transfer({"k": k}, f) == pytest.approx(exact, rel=1e-6, abs=1e-9)


def test_sizes_and_losses_of_a_disc_within_the_stated_error():
    """Full models are solved at every frequency; the box is ten per cent of sizes, ten times of a
    loss, which is exact."""
    start = {"layers[0].thickness": 0.2e-3, "layers[1].diameter": 14e-3, "damping.quality": 50.0}
    axes = [Axis(key, value / 1.05, 1.05 * value) for key, value in start.items()][:2]
    axes += [Axis("damping.quality", 10.0, 100.0)]
    band = (1e3, 25e3)
    made = parametric(buzzer, axes, band, degree=6)
    assert [loss.axis.name for loss in made.losses] == ["damping.quality"]
    assert made.error < 2e-3
    f, draw = np.linspace(*band, 20), np.random.default_rng(5)
    for _ in range(3):
        values = {axis.name: axis.value(draw.uniform(-1, 1)) for axis in axes}
        exact = buzzer(values).transfer(f)
        assert np.max(np.abs(made.transfer(values, f) / exact - 1)) < max(2 * made.error, 1e-4)


def test_a_moved_mesh_is_that_of_the_body_itself():
    """Sizes that change nothing give the same matrices; others the same answer as their own mesh
    within what meshes are worth."""
    f = np.linspace(2e3, 25e3, 40)
    own = kc.build(BUZZER)["disc"].select(["anode"])
    assert np.array_equal(buzzer({}).K.uu.toarray(), own.K.uu.toarray())
    larger = {"layers[0].diameter": 21.5e-3}
    scene = kc.load_scene(BUZZER, {f"disc.{key}": value for key, value in larger.items()})
    exact = kc.build(scene)["disc"].select(["anode"]).transfer(f)
    assert np.max(np.abs(buzzer(larger).transfer(f) / exact - 1)) < 2e-2


def test_sizes_that_change_places_are_refused():
    like = kc.load_scene(BUZZER).part("disc")
    change = {"disc.layers[1].diameter": 22e-3, "checks.plausible": "off"}
    scene = kc.load_scene(BUZZER, change)
    part = scene.part("disc")
    with pytest.raises(kc.errors.UsageError, match="change their order"):
        part.type.varied(part, scene, Clock(), like)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda model, k: replace(model, C=2 * model.C), "no parametric model"),
        (lambda model, k: model if k < 2 else kc.LinearModel(M=[[1.0]], K=[[k]], B=[[1.0, 0.0]]),
         "changes its cells"),
    ],
)  # fmt: skip
def test_models_without_a_common_form_are_refused(change, said):
    def full(values):
        return change(oscillators(values), values["k"])

    with pytest.raises(kc.errors.UsageError, match=said):
        parametric(full, [Axis("k", 1.0, 3.0)], (0.01, 0.5))


@pytest.mark.parametrize("ends", [(1.0, 1.0), (-1.0, 1.0), (0.0, 1.0), (np.nan, 1.0)])
def test_a_range_has_two_ends_of_one_sign(ends):
    with pytest.raises(kc.errors.UsageError, match="not the range"):
        Axis("k", *ends)


def test_parameters_outside_of_the_box_are_refused():
    made = parametric(oscillators, [Axis("k", 1.0, 4.0)], (0.01, 0.5), degree=3, checks=0)
    for values in ({"k": 4.1}, {"k": -2.0}, {}):
        with pytest.raises(kc.errors.UsageError, match="outside"):
            made.at(values)
