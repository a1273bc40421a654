"""What is judged of a finished run, on waveforms made by hand."""

import numpy as np
import pytest

from kc2spice.core.waveforms import Waveforms
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build

LOOP = {"name": "loop", "kick": {}, "contact": {}, "sphere": {}}


def waves(y, force, scene):
    t = np.linspace(0.0, 1e-3, len(y))
    ports = [pin for part, pin in scene.nets if part == "contact" and pin.startswith("R")]
    data = {"time": t, "sphere.y": y, "sphere.v": 0 * t, "contact.force": force}
    data |= {f"contact.force.{port}": force / len(ports) for port in ports}
    return Waveforms(data | {f"kick.u.{port}": 0 * t for port in ports}, {})


def found(scene, run, name):
    build = Build(scene, {})
    kind = scene.parts["contact"].type
    checks = kind.checks(scene.parts["contact"], build, run)
    return next((check for check in checks if check.name == name), None)


@pytest.mark.parametrize(
    ("height", "force", "passed"),
    [(-1e-12, 3e-4, True), (5e-9, 0.0, True), (1.26e-3, 0.0, False)],
)
def test_a_sphere_that_floats_at_the_start_is_told(height, force, passed):
    """Magnets may lift it at the operating point, long before the kick."""
    scene = load_scene(LOOP | {"contact": {"rings": "all"}})
    run = waves(np.full(3, 1e-3 + height), np.array([force, 0.0, 0.0]), scene)
    check = found(scene, run, "sphere starts at rest on kick")
    assert check.passed is passed
    assert check.fatal is not passed


def test_a_thrown_sphere_need_not_rest():
    scene = load_scene(LOOP | {"contact": {"rings": "all"}}, {"sphere.velocity": -0.1})
    run = waves(np.full(3, 2e-3), np.zeros(3), scene)
    assert found(scene, run, "sphere starts at rest on kick") is None
