"""Points: crossed, zipped, drawn; which models they share; a million cost no memory."""

import itertools
import tracemalloc
from importlib import resources

import pytest

from kc2spice.core.errors import UsageError
from kc2spice.scene.keys import keys_of
from kc2spice.scene.load import load_scene
from kc2spice.workflow.sweep import plan as plans
from kc2spice.workflow.sweep import run
from kc2spice.workflow.sweep.plan import make_plan
from kc2spice.workflow.sweep.point import SceneText, scene_text
from kc2spice.workflow.sweep.study import (
    Request,
    make_study,
    read_plan,
    request_of,
    studies,
    write_plan,
)

SCENE = SceneText("kick_and_catch", None)
KEYS = keys_of(load_scene("kick_and_catch"))


def parse(text):
    return plans.parse(text, KEYS)


def study(*sets, **options):
    return make_study(Request(SCENE, sets, **options))


def points(plan):
    return [plan.values(i) for i in range(plan.size)]


def test_crossing_is_the_product_with_the_last_key_fastest():
    plan = make_plan([parse("control.kp=1,2"), parse("control.kd=1,2,3")])
    assert points(plan) == list(itertools.product((1.0, 2.0), (1.0, 2.0, 3.0)))


def test_zipping_steps_together():
    ranges = [parse("control.kp=1,2,3"), parse("control.kd=4:6:3")]
    assert points(make_plan(ranges, zipped=True)) == [(1.0, 4.0), (2.0, 5.0), (3.0, 6.0)]


def test_zipping_needs_equal_lengths():
    with pytest.raises(UsageError, match="unequal"):
        make_plan([parse("control.kp=1,2,3"), parse("control.kd=4,5")], zipped=True)


def test_draws_are_joint_and_crossed_with_grids():
    names = ("control.kp=normal(5e4,1e3,10)", "control.ki=1,2", "control.kd=uniform(1,2,10)")
    plan = make_plan([parse(name) for name in names])
    assert plan.size == 20
    first, second = points(plan)[:10], points(plan)[10:]
    assert [p[::2] for p in first] == [p[::2] for p in second]
    assert {p[1] for p in first} == {1.0}


def test_any_order_visits_every_point_once():
    plan = make_plan([parse(t) for t in ("control.kp=1,2", "control.kd=1,2,3", "control.ki=1,2")])
    for slow in ([], [1], [2, 0], [0, 1, 2]):
        assert sorted(plan.order(slow)) == list(range(12))
    kd = [plan.values(i)[1] for i in plan.order([1])]
    assert kd == sorted(kd)


def test_gains_need_one_model_of_each_kind():
    runs = study("control.kp=4e4:6e4:3", "control.kd=10:30:5").stages.runs
    assert runs == {"fe": {"kick": 1, "catch": 1}, "rom": {"kick": 1}, "netlists": 15,
                    "ngspice": 15}  # fmt: skip


@pytest.mark.parametrize(
    ("sets", "chip", "catch", "rom", "netlists"),
    [
        (("kick.drive.voltage=80,100", "kick.drive.width=20e-6,25e-6"), 1, 1, 1, 4),
        (("rom.order=20,30", "control.kd=10,20"), 1, 1, 2, 4),
        (("kick.damping.ratio=0.01,0.02", "rom.order=20,30"), 2, 1, 4, 4),
        (("catch.remanence=0.1:0.3:5",), 1, 1, 1, 5),  # the field is linear in it
        (("sphere.density=7000,7850",), 1, 1, 1, 2),
        (("sphere.radius=0.9 mm,1 mm", "control.kd=10,20"), 1, 2, 1, 4),
        (("catch.turns=4000,4074", "kick.layers=31,33"), 2, 2, 2, 4),
        (("param.pid.rail=12,15", "control.kd=10,20"), 1, 1, 1, 2),
    ],
)
def test_runs_are_counted_by_what_the_keys_reach(sets, chip, catch, rom, netlists):
    runs = study(*sets).stages.runs
    assert (runs["fe"], runs["rom"]) == ({"kick": chip, "catch": catch}, {"kick": rom})
    assert (runs["netlists"], runs["ngspice"]) == (netlists, study(*sets).plan.size)


def test_drivers_are_circuits_and_need_no_new_models():
    request = Request(SceneText("amplifier_kick", None),
                      ("kick.driver.amplifier.current_limit=2 A,5 A",))  # fmt: skip
    assert make_study(request).stages.runs == {
        "fe": {"kick": 1, "catch": 1}, "rom": {"kick": 1}, "netlists": 2, "ngspice": 2,
    }  # fmt: skip


@pytest.mark.parametrize("name", ["imprint", "em_force"])
def test_scenes_of_curves_have_their_largest_value(name):
    key = "contact.penalty=1e8,2e8" if name == "imprint" else "catch.remanence=0.1,0.2"
    found = make_study(Request(SceneText(name, None), (key,)))
    assert found.job.metrics == ({"imprint": "max_force_n", "em_force": "force_max_n"}[name],)


def test_a_scene_of_curves_alone_is_refused_with_what_to_do():
    with pytest.raises(UsageError, match="every metric is a curve") as caught:
        make_study(Request(SceneText("harmonic", None), ("kick.damping.ratio=0.01,0.02",)))
    assert "kc2spice run" in caught.value.hint


def test_points_that_need_models_of_their_own_come_first():
    found = study("control.kd=10,20,30", "rom.order=20,30", "kick.damping.ratio=0.01,0.02")
    order = list(run._share(found, None))
    assert sorted(order) == list(range(12))
    assert set(order[:4]) == set(found.stages.first)
    models = {found.plan.values(index)[1:] for index in order[:4]}
    assert models == {(order, ratio) for order in (20, 30) for ratio in (0.01, 0.02)}
    parts = [index for k in range(5) for index in run._share(found, run.Shard(k, 5))]
    assert sorted(parts) == list(range(12))


def test_points_that_share_a_chip_run_one_after_the_other():
    found = study("control.kd=10,20,30", "kick.damping.ratio=0.01,0.02")
    order = found.plan.order([found.plan.block(key) for key in found.stages.keys])
    ratios = [found.plan.values(i)[1] for i in order]
    assert ratios == sorted(ratios)


def test_a_million_points_are_not_held_in_memory():
    plan = make_plan(
        [parse(f"{key}=1:2:100") for key in ("control.kp", "control.ki", "control.kd")]
    )
    assert plan.size == 1_000_000
    tracemalloc.start()
    last = 0
    for index in plan.order([2]):
        last = index
        if index > 50_000:
            break
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert last > 0
    assert peak < 1_000_000  # bytes


@pytest.mark.parametrize(
    ("sets", "options", "word"),
    [
        (("control.kd=10",), {}, "nothing to sweep"),
        (("control.kd=10,20", "control.kd=30,40"), {}, "twice"),
        (("control.kd=10,20",), {"metrics": ("settling",)}, "metric"),
        (("control.kd=10,20",), {"format": "xlsx"}, "format"),
        (("control.kd=10,20", "control.setpoint=50 mm"), {}, "force table"),
        (("sphere.density=-1:1:3",), {}, "out of range"),
        (("control.kp=normal(1,1,5)", "control.kd=normal(1,1,6)"), {}, "unequal"),
        (tuple(f"{k}=1:2:1000" for k in ("control.kp", "control.kd", "control.ki")), {}, "many"),
    ],
)
def test_mistakes_are_found_before_anything_is_run(sets, options, word):
    with pytest.raises(UsageError, match=word):
        study(*sets, **options)


def test_a_plan_is_read_back_and_names_the_same_table(tmp_path):
    found = study("control.kd=10:20:3", "control.kp=normal(5e4,1e3,4)", seed=5, latin=True)
    write_plan(found, tmp_path, found.digest)
    request, digest = read_plan(tmp_path)
    assert request == found.request
    assert make_study(request).digest == digest


def test_whatever_decides_the_table_decides_the_digest():
    base = study("control.kd=10:20:3")
    others = [
        study("control.kd=10:20:4"),
        study("control.kd=10:20:3", "control.kp=4e4"),
        study("control.kd=10:20:3", "param.pid.rail=12"),
        study("control.kd=10:20:3", metrics=("caught",)),
        study("control.kd=10:20:3", format="parquet"),
    ]
    digests = {base.digest, *(other.digest for other in others)}
    assert len(digests) == 6
    assert study("control.kd=10:20:3", timeout=5.0).digest == base.digest


@pytest.mark.parametrize("name", studies())
def test_built_in_studies_are_sound(name):
    request = request_of(name)
    found = make_study(request)
    assert found.plan.size > 10
    smaller = request_of(name, sets=("solver.stop=7 ms",))
    assert make_study(smaller).digest != found.digest


def test_a_study_of_your_own_is_a_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('scene = "kick_and_catch"\n[set]\n"control.kd" = "10:20:3"\n')
    assert make_study(request_of(str(path))).plan.size == 3
    path.write_text('scene = "kick_and_catch"\nsets = 3\n')
    with pytest.raises(UsageError, match="not a key"):
        request_of(str(path))


def test_a_circuit_of_your_own_decides_the_table_too(tmp_path):
    folder = resources.files("kc2spice") / "scenes"
    for name in ("bring_your_own.toml", "bring_your_own.lib"):
        (tmp_path / name).write_text((folder / name).read_text(encoding="utf-8"), encoding="utf-8")

    def digest():
        scene = scene_text(str(tmp_path / "bring_your_own.toml"))
        return make_study(Request(scene, ("solver.reltol=1e-3,1e-4",))).digest

    before = digest()
    with (tmp_path / "bring_your_own.lib").open("a", encoding="utf-8") as file:
        file.write("* changed\n")
    assert digest() != before
