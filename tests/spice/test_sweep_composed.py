"""Sweeps in the general grammar: two devices, probes, files, parameters of subcircuits."""

import contextlib
import csv
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from scipy.io import mmwrite

from kc2spice.core.errors import UsageError
from kc2spice.netlist.parameters import declared, with_parameters
from kc2spice.scene.load import load_scene
from kc2spice.sim.ngspice import run_deck
from kc2spice.workflow.judge import verdict
from kc2spice.workflow.run import run as run_scene
from kc2spice.workflow.sweep import point, run
from kc2spice.workflow.sweep.point import judged, run_point, scene_text

TWO = """
name = "two_stacks"
[push]
part = "source"
pulse = { high = "100 V", width = "20 us", edge = "1 us", start = "5 us" }
pins = { out = "bridge.command" }
[bridge]
part = "half_bridge"
[left]
part = "piezo_stack"
layers = 4
height = "1 mm"
mesh = { outer_rings = 2, rings = 1 }
pins = { anode = "bridge.out" }
[right]
part = "piezo_stack"
layers = 6
height = "1 mm"
mesh = { outer_rings = 2, rings = 1 }
pins = { anode = "bridge.out" }
[m1]
part = "mass"
mass = "10 mg"
pins = { a = "left.ring0" }
[k1]
part = "spring"
stiffness = "1e5 N/m"
pins = { a = "left.ring0" }
[m2]
part = "mass"
mass = "10 mg"
pins = { a = "right.ring0" }
[k2]
part = "spring"
stiffness = "1e5 N/m"
pins = { a = "right.ring0" }
[rom]
order = 12
[solver]
stop = "60 us"
[probes]
left_top = { of = "left.u.ring0", take = "max" }
right_swing = { of = "right.u.ring0", take = "peak_to_peak" }
"""


@pytest.fixture
def two(tmp_path):
    path = tmp_path / "two.toml"
    path.write_text(TWO)
    return str(path)


def study(path, *sets, **options):
    return run.make_sweep(scene_text(path), sets, **options)


def threads():
    """Workers of this process."""
    return contextlib.nullcontext((ThreadPoolExecutor(1), 1))


def rows(summary):
    with Path(summary["table"]).open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_two_stacks_are_swept_with_their_probes_as_columns(two, tmp_path):
    found = study(two, "left.layers=4,6", "bridge.rail=50 V:100 V:2")
    assert found.models.runs["fe"] == {"left": 1, "right": 1}  # left with 6 layers is like right
    assert found.models.runs["rom"] == {"left": 1, "right": 1}
    summary = run.sweep(found, tmp_path / "o", threads)
    assert summary["failed"] == 0
    table = rows(summary)
    points = [(int(row["left.layers"]), float(row["bridge.rail"])) for row in table]
    assert points == [(4, 50.0), (4, 100.0), (6, 50.0), (6, 100.0)]
    left, right = ([float(row[name]) for row in table] for name in ("left_top", "right_swing"))
    # The stacks are linear: twice the voltage, twice the stroke but for the bridge's edges.
    assert left[1] == pytest.approx(2 * left[0], rel=0.05)
    assert left[2] / left[0] == pytest.approx(1.5, rel=0.2)  # the stroke is n d33 V
    assert right[0] == pytest.approx(right[2], rel=0.05)  # only the load of the bridge has changed
    alone = run_scene(load_scene(two, ["left.layers=6"]), tmp_path / "alone")["metrics"]
    assert {n: v for n, v in table[3].items() if n in alone} == {
        n: repr(float(v)) for n, v in alone.items()
    }


def test_equal_parts_share_their_models(two):
    both = study(two, "left.layers=6", "push.pulse.high=30,60")
    assert both.models.runs["fe"] == {"left": 1}
    swept = study(two, "left.layers=4,6", "right.layers=4,6", zipped=True)
    assert swept.models.runs["fe"] == {"left": 2}
    crossed = study(two, "left.layers=4,6", "right.layers=8,10")
    assert crossed.models.runs["fe"] == {"left": 2, "right": 2}
    assert len(crossed.models.shared) == 4


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("left.layer=4,6", "left.layers"),
        ("lefft.layers=4,6", "left.layers"),
        ("push.pulse.high=30 A:60 A:2", "V"),
        ("left.layers=4.5,6", "whole"),
        ("left.height=-1 mm:1 mm:3", "> 0"),
        ("probes.left_top.take=max,maximum", "peak_to_peak"),
        ("m1.mass=normal(10 mg, 1 mg)", "three values"),
    ],
)
def test_ranges_are_checked_against_the_parts_before_anything_runs(two, text, word):
    with pytest.raises(UsageError) as caught:
        study(two, text)
    error = caught.value
    said = " ".join(str(x) for x in (error.message, error.where, error.expected, error.hint))
    assert word in said
    assert "--set" in said


# --- parameters ---------------------------------------------------------------------------------

EARLY = ("kick.drive.start=20 us", "control.enable_at=20 us", "solver.stop=150 us",
         "solver.reltol=1e-3")  # fmt: skip


@pytest.fixture(scope="module")
def loop():
    found = study("kick_and_catch", "control.kd=10,20", *EARLY)
    return found, *point.testbench(found.job, point.overrides(found.plan.values(1)))


def test_a_helper_is_known_by_its_own_name_in_every_library(loop):
    _, _, deck = loop
    assert declared(deck)["opamp.a0"] == 1e7
    changed = with_parameters(deck, [("opamp.a0", 3e5), ("pid.kp", 4e4)])
    before, after = (next(p.text for p in d.parts if p.filename == "pid.lib")
                     for d in (deck, changed))  # fmt: skip
    lines = [(a, b) for a, b in zip(before.split("\n"), after.split("\n"), strict=True) if a != b]
    assert len(lines) == 3  # header and card of the controller, card of its amplifier
    assert sum("a0=300000.0" in b for _, b in lines) == 1
    assert sum("kp=40000.0" in b for _, b in lines) == 2


@pytest.mark.parametrize(
    ("key", "value"),
    [("sphere.mass", 0.0), ("sphere.mass", -1e-5), ("sphere.radius", 0.0), ("pid.kp", 0.0)],
)
def test_values_outside_a_parameters_range_are_refused(loop, key, value):
    with pytest.raises(UsageError, match="outside the range"):
        with_parameters(loop[2], [(key, value)])


def test_a_range_of_a_parameter_is_refused_at_its_worst_value(tmp_path):
    found = study("kick_and_catch", "param.sphere.mass=3e-5,0", *EARLY)
    with pytest.raises(UsageError, match="outside the range"):
        run.sweep(found, tmp_path / "o", threads)
    with pytest.raises(UsageError, match=r"param.pid.offst") as caught:
        wrong = study("kick_and_catch", "param.pid.offst=1,2", *EARLY)
        run.sweep(wrong, tmp_path / "p", threads)
    assert "pid.offset" in caught.value.hint


def test_checks_follow_what_the_parameters_change(loop):
    _, build, deck = loop
    gains = judged(build, deck, [("pid.kp", 4e4), ("pid.setpoint", 2e-3)])
    assert gains.scene.parts["control"].keys.kp == 4e4
    assert gains.scene.parts["control"].keys.setpoint == 2e-3
    assert gains.unjudged == frozenset()
    mass = judged(build, deck, [("sphere.mass", 4e-5)])
    assert mass.unjudged == {"sphere"}  # its keys give a density, not a mass
    assert judged(build, deck, [("opamp.a0", 1e5)]).unjudged == {"control"}


def checks(*values):
    found = study("kick_and_catch", "control.kd=10,20", *EARLY, *values)
    return run_point(found.job, found.plan.values(1))


def test_energy_is_balanced_while_gains_are_swept():
    """The balance of the sphere is asked for, and a wrong mass is not taken for its own."""
    fine = checks("param.pid.kp=4e4")
    assert fine.failure is None
    assert abs(fine.facts["checks.energy of sphere"]) < 1e-4
    gone = checks("param.sphere.mass=4e-5")
    assert gone.failure is None
    assert "checks.energy of sphere" not in gone.facts


def test_the_balance_would_see_a_mass_that_the_deck_has_not(loop, tmp_path):
    """Negative control of the two tests above: judged by the scene's mass the run must fail."""
    _, build, deck = loop
    heavy = with_parameters(deck, [("sphere.mass", 6e-5)])
    waves = run_deck(heavy, tmp_path)
    told = {c.name: c.passed for c in verdict(waves, build).checks}
    assert not told["energy of sphere"]
    other = verdict(waves, judged(build, deck, [("sphere.mass", 6e-5)])).checks
    assert "energy of sphere" not in {check.name for check in other}


# --- files --------------------------------------------------------------------------------------

OWN = """
name = "own"
[beam]
part = "matrices"
file = "beam.M.mtx"
sidecar = "beam.toml"
pins = { tip = "push.out" }
[push]
part = "source"
kind = "force"
file = "push.csv"
[solver]
stop = "2 ms"
max_step = "10 us"
[probes]
top = { of = "beam.u.tip", take = "max" }
"""


@pytest.fixture
def own(tmp_path):
    """A chain of three masses with its matrices, its ports and a force over time, in files."""
    home = tmp_path / "home"
    home.mkdir()
    (home / "own.toml").write_text(OWN)
    stiff = 1e4 * np.array([[2.0, -1, 0], [-1, 2, -1], [0, -1, 1]])
    arrays = {"M": 1e-3 * np.eye(3), "K": stiff, "E": 1e-5 * stiff, "B": np.eye(3)[:, 2:],
              "C": np.eye(3)[2:]}  # fmt: skip
    for name, array in arrays.items():
        mmwrite(home / f"beam.{name}.mtx", array)
    port = '[[ports]]\nname = "tip"\nkind = "mechanical"\ncolumn = 1\n'
    (home / "beam.toml").write_text(f'files = {{ K = "stiff.mtx" }}\n{port}')
    (home / "beam.K.mtx").rename(home / "stiff.mtx")
    (home / "push.csv").write_text("0,0\n1e-4,1\n1,1\n")
    return home


def test_files_of_the_parts_travel_with_the_sweep(own, tmp_path):
    path = str(own / "own.toml")
    names = {name for name, _ in scene_text(path).files}
    assert names == {"push.csv", "beam.toml", "stiff.mtx", *(f"beam.{x}.mtx" for x in "MEBC")}
    found = study(path, "solver.reltol=1e-3,1e-4")
    before = found.digest
    (own / "push.csv").write_text("0,0\n1e-4,2\n1,2\n")
    assert study(path, "solver.reltol=1e-3,1e-4").digest != before
    shutil.rmtree(own)  # as on another machine
    summary = run.sweep(found, tmp_path / "o", threads)
    assert summary["failed"] == 0
    # A step of 1 N within a fifth of the period: static 3e-4 m, overshoot below twice of it.
    assert all(3e-4 < float(row["top"]) < 6e-4 for row in rows(summary))


def test_every_number_of_a_result_may_be_a_column(tmp_path):
    scene = scene_text("buzzer_7bb_20_6")
    names = ("bvd.c0_f", "model.disc.mass_kg", "rom.order", "resonance_hz")
    asked = run.make_sweep(scene, ("disc.damping.quality=40,50",), metrics=names)
    summary = run.sweep(asked, tmp_path / "o", threads)
    found = rows(summary)
    record = run_scene(load_scene("buzzer_7bb_20_6", ["disc.damping.quality=50"]), tmp_path / "r")
    wanted = [record["metrics"]["bvd"]["c0_f"], record["model"]["disc"]["mass_kg"],
              record["rom"]["order"], record["metrics"]["resonance_hz"]]  # fmt: skip
    assert [float(found[1][name]) for name in names] == wanted
