"""What is judged of a finished run, on waveforms made by hand."""

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.parameters import with_parameters
from kc2spice.parts.sphere import sphere_subcircuit
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.spice.header import Header

LOOP = {"name": "loop", "kick": {}, "contact": {}, "sphere": {}}


def waves(y, force, scene):
    t = np.linspace(0.0, 1e-3, len(y))
    ports = [pin for part, pin in scene.nets if part == "contact" and pin.startswith("ring")]
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


def test_parameters_outside_their_range_are_refused():
    """A sphere without mass would leave at 6.7e8 m/s, and nothing else tells."""
    part = sphere_subcircuit(Header("test", "0"), 3e-5, 1e-3, 9.81)
    deck = Deck(name="d", parts=(part,))
    assert "mass=2e-05" in with_parameters(deck, [("sphere.mass", 2e-5)]).files["sphere.lib"]
    for name in ("mass", "radius"):
        for value in (0.0, -1.0):
            with pytest.raises(UsageError, match="outside the range"):
                with_parameters(deck, [(f"sphere.{name}", value)])
    assert with_parameters(deck, [("sphere.gravity", -9.81)]) != deck  # any sign


def test_a_peak_at_the_end_of_a_rise_says_so():
    scene = load_scene(LOOP)
    kind, y = scene.parts["sphere"].type, np.array([1.0, 2.0, 3.0])
    for end, v, rising in ((3.0, 0.5, True), (3.0, 0.0, None), (2.5, 0.5, None)):
        data = {
            "time": np.arange(3.0),
            "sphere.y": np.r_[y, end][1:],
            "sphere.v": np.r_[1.0, 1.0, v],
        }
        data["sphere.y"][1] = 2.9
        found = kind.metrics(scene.parts["sphere"], Build(scene, {}), Waveforms(data, {}))
        assert found.get("still_rising") is rising
