"""What is judged of a finished run, on waveforms made by hand."""

from unittest.mock import MagicMock

import numpy as np
import pytest

from kc2spice.core.errors import UsageError
from kc2spice.core.waveforms import Waveforms
from kc2spice.netlist.deck import Deck
from kc2spice.netlist.parameters import with_parameters
from kc2spice.netlist.read import subcircuits
from kc2spice.parts.sphere import sphere_subcircuit
from kc2spice.scene.judge import Verdict
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.sim.retries import Attempt, Outcome, RetriesFailedError
from kc2spice.spice.header import Header
from kc2spice.workflow import run

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


ATTEMPT = Attempt("first", "", None, None, None, None, 2.0, 3)
OUTCOME = Outcome(Deck(name="d", parts=()), Waveforms({}, {}), Verdict(), (ATTEMPT,))


def test_rings_that_are_too_few_are_mended_where_nobody_chose_them(monkeypatch, tmp_path):
    """The check says by which key; complete runs again with it, and says so."""
    tried = []

    def simulated(build, *_args, **_keys):
        tried.append(build.scene.parts["contact"].keys.rings)
        if tried[-1] == 3:
            return OUTCOME
        error = RetriesFailedError("the result contradicts physics: ring_left_out", got="5 um")
        error.mends = {"contact.rings": 3} if tried[-1] == "needed" else {}
        raise error

    monkeypatch.setattr(run, "find_ngspice", MagicMock())
    monkeypatch.setattr(run, "build_models", lambda scene, *_, **__: Build(scene, {}))
    for name in ("make_deck", "lint", "write_files"):
        monkeypatch.setattr(run, name, MagicMock())
    monkeypatch.setattr(run, "converge", lambda *_: None)
    monkeypatch.setattr(run, "simulate", simulated)
    with pytest.warns(UserWarning, match=r"run again with contact\.rings = 3"):
        done = run.complete(load_scene(LOOP), tmp_path)
    assert tried == ["needed", 3]
    assert done.build.scene.parts["contact"].keys.rings == 3
    with pytest.raises(RetriesFailedError):
        run.complete(load_scene(LOOP, {"contact.rings": 2}), tmp_path)


@pytest.mark.parametrize(("rings", "mend"), [("needed", ("contact.rings", 3)), (2, None)])
def test_the_check_of_rings_left_out_names_its_cure(rings, mend):
    scene = load_scene(LOOP, {"contact.rings": rings, "kick.drive.voltage": 100})
    kind = scene.parts["kick"].type
    run_ = waves(np.full(3, 1e-3), np.zeros(3), scene)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(type(kind), "static_compliance", lambda *_: np.zeros((2, 2)))
        assert found(scene, run_, "ring_left_out").mend == mend
