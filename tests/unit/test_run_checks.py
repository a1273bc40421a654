"""What is judged of a finished run, on waveforms made by hand."""

from unittest.mock import MagicMock

import numpy as np
import pytest

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.progress import Clock
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.sphere import sphere_subcircuit
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.spice.deck import Deck
from kc2spice.spice.header import Header
from kc2spice.spice.read import subcircuits
from kc2spice.workflow import richer
from kc2spice.workflow.sweep.point import with_parameters

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


def test_a_thrown_sphere_need_not_rest():
    scene = load_scene(LOOP | {"contact": {"rings": "all"}}, {"sphere.velocity": -0.1})
    run = waves(np.full(3, 2e-3), np.zeros(3), scene)
    assert found(scene, run, "sphere starts at rest on kick") is None


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


def test_ranges_are_read_back_from_the_file():
    part = sphere_subcircuit(Header("test", "0"), 3e-5, 1e-3, 9.81)
    (read,) = subcircuits(part.text, "sphere.lib")
    assert [(p.low, p.high) for p in read.params] == [(p.low, p.high) for p in part.params]


class Model:
    order = 30


def test_reduction_is_compared_with_twice_the_states(monkeypatch):
    """And a tenth of the tolerances, on request or under a budget; the second run has no setting
    of a body's own."""
    scene = load_scene(LOOP, {"kick.rom.order": 12, "checks.reduction": "warn"})
    build = Build(scene, {"kick": Model()})
    other = richer.richer(build)
    assert (other.rom.order, other.rom.band) == (60, (0.0, 2e6))
    assert (other.solver.reltol, other.solver.chgtol) == (1e-5, pytest.approx(1e-9))
    assert other.parts["kick"].keys.rom is None
    time = np.array([0.0, 1.0, 2.0])
    ours, theirs = (Waveforms({"time": time, "sphere.y": y * time}, {}) for y in (1.04, 1.0))
    speeds = iter([0.30, 0.24, 0.30, 0.30, 0.30, 0.24, 0.30])
    monkeypatch.setattr(richer, "metrics", lambda *_: {"launch_velocity_m_s": next(speeds)})
    for name in ("build_models", "make_deck"):
        monkeypatch.setattr(richer, name, MagicMock())
    monkeypatch.setattr(richer, "simulate", lambda *_: MagicMock(waves=theirs))
    check = richer.reduction_check(build, ours, Clock())
    assert (check.value, check.limit) == (pytest.approx(0.25), 1e-2)
    assert not check.passed
    assert richer.reduction_check(build, ours, Clock()).value == pytest.approx(0.04)  # of heights
    bounded = Build(load_scene(LOOP, {"error_budget": 1e-3}), {"kick": Model()})
    check = richer.reduction_check(bounded, ours, Clock())
    assert (check.limit, check.action, check.passed) == (1e-3, "warn", False)

    def fails(*_):
        raise SimulationError("no convergence")

    monkeypatch.setattr(richer, "simulate", fails)
    assert not richer.reduction_check(build, ours, Clock()).passed
    for quiet in ({}, {"error_budget": 1e-3, "checks.reduction": "off"}):
        silent = Build(load_scene(LOOP, quiet), {"kick": Model()})
        assert richer.reduction_check(silent, ours, Clock()) is None
