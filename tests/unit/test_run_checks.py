"""What is judged of a finished run, on waveforms made by hand."""

from contextlib import nullcontext
from dataclasses import replace
from unittest.mock import MagicMock

import numpy as np
import pytest

from kc2spice.core.errors import SimulationError, UsageError
from kc2spice.core.progress import Clock
from kc2spice.core.waveforms import Waveforms
from kc2spice.parts.sphere import sphere_subcircuit
from kc2spice.scene.judge import Check, Verdict
from kc2spice.scene.load import load_scene
from kc2spice.scene.parttype import Build
from kc2spice.sim.retries import Attempt, Outcome, RetriesFailedError
from kc2spice.spice.deck import Deck
from kc2spice.spice.header import Header
from kc2spice.spice.read import subcircuits
from kc2spice.workflow import richer, run
from kc2spice.workflow.sweep.point import with_parameters
from kc2spice.workflow.verify.compare import Solution

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


@pytest.fixture
def closer(monkeypatch):
    """``speeds`` of the first and the closer run, taken in turn; their heights are 4 % apart."""
    time = np.array([0.0, 1.0, 2.0])
    first, second = (Waveforms({"time": time, "sphere.y": y * time}, {}) for y in (1.04, 1.0))
    speeds: list[float] = []
    monkeypatch.setattr(
        richer, "solution", lambda w, _: Solution(w, {"launch_velocity_m_s": speeds.pop(0)})
    )
    for name in ("build_models", "make_deck"):
        monkeypatch.setattr(richer, name, MagicMock())
    monkeypatch.setattr(richer, "simulate", lambda *_: replace(OUTCOME, waves=second))
    return speeds, replace(OUTCOME, waves=first)


ATTEMPT = Attempt("first", "", None, None, None, None, 2.0, 3)
OUTCOME = Outcome(Deck(name="d", parts=()), Waveforms({}, {}), Verdict(), (ATTEMPT,))


def test_reduction_is_compared_with_twice_the_states(closer):
    """And a tenth of the tolerances, on request or under a budget; the second run has no setting
    of a body's own."""
    speeds, outcome = closer
    scene = load_scene(LOOP, {"kick.rom.order": 12, "checks.reduction": "warn"})
    build = Build(scene, {"kick": Model()})
    other = richer.richer(build)
    assert (other.rom.order, other.rom.band) == (60, (0.0, 2e6))
    assert (other.solver.reltol, other.solver.chgtol) == (1e-5, pytest.approx(1e-9))
    assert other.parts["kick"].keys.rom is None
    loop = load_scene("kick_and_catch", {"error_budget": 1e-3})
    assert loop.parts["catch"].keys.points == 101  # fewer show in a weak kick's energy
    assert richer.richer(Build(loop, {"kick": Model()})).parts["catch"].keys.points == 201
    speeds += [0.30, 0.24]
    check = richer.closer_run(build, outcome, Clock()).check
    assert (check.value, check.limit) == (pytest.approx(1.5 * 0.25), 1e-2)
    assert not check.passed
    speeds += [0.30, 0.30]
    assert richer.closer_run(build, outcome, Clock()).check.value == pytest.approx(1.5 * 0.04)
    bounded = Build(load_scene(LOOP, {"error_budget": 1e-3}), {"kick": Model()})
    speeds += [0.30, 0.24]
    check = richer.closer_run(bounded, outcome, Clock()).check
    assert (check.limit, check.action, check.passed) == (1e-3, "warn", False)
    for quiet in ({}, {"error_budget": 1e-3, "checks.reduction": "off"}):
        silent = Build(load_scene(LOOP, quiet), {"kick": Model()})
        speeds += [0.30]
        assert richer.closer_run(silent, outcome, Clock()) is None


@pytest.mark.parametrize(
    ("change", "own"),
    [
        ({}, 0.5 * 0.25),
        ({"kick.damping.ratio": 1e-3}, 2 * 0.25 + 5e-4),
        ({"kick.drive.voltage": -100.0}, 2 * 0.25 + 5e-4),
        ({"kick.damping.ratio": 1e-3, "kick.drive.voltage": -100.0}, 2 * 0.25 + 15e-4),
    ],
    ids=["neither", "lightly damped", "downwards", "both"],
)
def test_a_budget_allows_for_what_two_runs_may_both_miss(closer, change, own):
    """Light damping, a kick downwards: twice the states may agree and both be off."""
    speeds, outcome = closer
    scene = load_scene(LOOP, {"error_budget": 1e-4, **change})
    speeds += [0.30, 0.24]
    found = richer.closer_run(Build(scene, {"kick": Model()}), outcome, Clock())
    assert found.check.value == pytest.approx(0.25 + own)
    assert found.own.value == pytest.approx(own)


@pytest.mark.parametrize("volts", [-100.0, 40.0, 100.0])
def test_a_closer_run_asks_ngspice_for_less(volts):
    """Of what the decks say: a low kick asks for a thirtieth where its ringing is coarse."""
    change = {"kick.drive.voltage": volts, "error_budget": 1e-4}
    scene = load_scene(LOOP, change)
    first, closer = (
        each.solver.reltol * min(p.type.closeness(p, each) for p in each.parts.values())
        for each in (scene, richer.richer(Build(scene, {"kick": Model()})))
    )
    assert closer == pytest.approx(max(0.1 * first, 1e-7))


def test_a_closer_run_that_fails_leaves_no_number(closer, monkeypatch):
    def fails(*_):
        raise SimulationError("no convergence")

    speeds, outcome = closer
    speeds += [0.30]
    monkeypatch.setattr(richer, "simulate", fails)
    build = Build(load_scene(LOOP, {"checks.reduction": "warn"}), {"kick": Model()})
    assert not richer.closer_run(build, outcome, Clock()).passed


def test_heights_are_compared_on_cubics():
    """Steps of 50 us of a flight that a force bends: straight lines between them miss by 1e-4."""
    fine, few = np.linspace(0.0, 1e-3, 2001), np.linspace(0.0, 1e-3, 21)

    def flight(t):
        return Waveforms({"time": t, "sphere.y": t - 400 * t**2, "sphere.v": 1 - 800 * t}, {})

    ours, theirs = (Solution(flight(t), {"launch_velocity_m_s": 1.0}) for t in (fine, few))
    scene = load_scene(LOOP)
    assert richer._apart(scene, "launch_velocity_m_s", ours, theirs) < 1e-12


@pytest.mark.parametrize(
    ("change", "word"),
    [
        ({"kick.drive.voltage": -100.0}, "draws back first"),
        ({"kick.damping.ratio": 1e-3}, "damped by less than"),
        ({}, ""),
    ],
)
def test_a_doubt_is_measured_without_a_budget(closer, change, word):
    speeds, outcome = closer
    build = Build(load_scene(LOOP, change), {"kick": Model()})
    assert word in "; ".join(richer.doubts(build, outcome))
    speeds += [0.30, 0.30]
    found = richer.closer_run(build, outcome, Clock())
    assert (found is not None) == bool(word)
    if found is not None:
        assert found.check.value == pytest.approx(3 * 0.04)  # of heights; both may be off


def test_a_check_of_steps_near_its_limit_is_a_doubt(closer):
    _, outcome = closer
    build = Build(load_scene(LOOP), {"kick": Model()})
    for value, count in ((0.2, 0), (0.4, 1)):
        check = Check("energy of sphere", value, 1.0, "J", "", coarse=True)
        judged = replace(outcome, verdict=Verdict((check, replace(check, coarse=False))))
        assert len(list(richer.doubts(build, judged))) == count


@pytest.mark.parametrize(("second", "budget"), [(0.24, 1e-3), (0.24, None), (0.3003, 0.1)])
def test_a_run_beyond_its_budget_gives_way_to_the_closer_one(closer, tmp_path, second, budget):
    speeds, outcome = closer
    given = {"checks.reduction": "warn"} if budget is None else {"error_budget": budget}
    build = Build(load_scene(LOOP, given), {"kick": Model()})
    speeds += [0.30, second]
    taken = second == 0.24 and budget is not None
    with pytest.warns(UserWarning, match="closer run is the result") if taken else nullcontext():
        other, found = run._judged(build, outcome, Clock(), tmp_path)
    assert (other is not build) == (found.waves is not outcome.waves) == taken
    (check,) = found.verdict.checks
    apart = max(abs(0.30 / second - 1), 0.04)
    assert check.value == pytest.approx((0.5 if taken else 1.5) * apart)


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
    monkeypatch.setattr(run, "closer_run", lambda *_: None)
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
