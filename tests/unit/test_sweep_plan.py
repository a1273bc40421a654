"""Plan of a sweep: ranges in their units, random samples, order of points, shared models."""

import numpy as np
import pytest
from scipy import stats
from support import SceneInput, UsageError, load_named_sweep, make_sweep

LOOP = SceneInput("kick_and_catch", None)


def swept(*sets, **options):
    return make_sweep(LOOP, sets, **options)


def points(*sets, **options):
    """Values of the swept keys at every point, in the order of the table."""
    plan = swept(*sets, **options).plan
    return [tuple(plan.values(index).values()) for index in range(plan.size)]


def column(*sets, **options):
    return [point[0] for point in points(*sets, **options)]


# --- ranges -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("kick.drive.voltage=80:120:5", [80.0, 90.0, 100.0, 110.0, 120.0]),
        ("control.setpoint=2 mm:3 mm:3", [2e-3, 2.5e-3, 3e-3]),
        ("control.setpoint=2e-3,2.5 mm, 3000 um", [2e-3, 2.5e-3, 3e-3]),
        ("control.ki=10 A/(m s),20 A/(m s)", [10.0, 20.0]),
        ("kick.damping.ratio=1 %:3 %:2", [0.01, 0.03]),
        ("rom.order=20:40:3", [20, 30, 40]),
        ("catch.polarity=parallel,antiparallel", ["parallel", "antiparallel"]),
        ("param.pid.rail=12:15:2", [12.0, 15.0]),
        ("rom.band=[0, 4e5],[0, 5e5]", [[0, 4e5], [0, 5e5]]),
    ],
)
def test_values_are_in_si(text, values):
    assert column(text) == values


def test_a_logarithmic_range_has_equal_ratios_and_exact_ends():
    found = column("contact.penalty=log:1e7:1e9:3")
    assert (found[0], found[-1]) == (1e7, 1e9)
    assert found == pytest.approx((1e7, 1e8, 1e9), rel=1e-12)


@pytest.mark.parametrize(
    "text",
    [
        "control.kd=1:2",
        "control.kd=1:2:3:4",
        "control.kd=1:2:1",
        "control.kd=1:2:x",
        "control.kd=1:2:-3",
        "control.kd=a:b:3",
        "control.kd=1:nan:3",
        "control.kd=log:0:1:3",
        "control.kd=log:-1:1:3",
        "control.kd=1,1",
        "control.kd=5:5:3",
        "control.kd=1 kg:2 kg:3",
        "control.kd=normal(1,2)",
        "control.kd=normal(1,-2,5)",
        "control.kd=uniform(2,1,5)",
        "rom.order=1:2:3",
        "rom.order=normal(1,2,3)",
        "catch.polarity=parallel,up",
        "catch.polarity=parallel:antiparallel:3",
        "control.kdd=1:2:3",
        "param.pid=1:2:3",
    ],
)
def test_bad_ranges_name_the_option(text):
    with pytest.raises(UsageError) as caught:
        swept(text)
    assert caught.value.exit_code == 2
    assert "--set" in str(caught.value.where)


@pytest.mark.parametrize(
    ("sets", "options", "word"),
    [
        (("control.kd=10",), {}, "no option --set contains a range"),
        (("control.kd=10,20", "control.kd=30,40"), {}, "twice"),
        (("control.kd=10,20", "control.setpoint=50 mm"), {}, "force table"),
        (("sphere.density=7e3:-1:3",), {}, "out of range"),
        (
            ("control.kp=normal(1,1,5)", "control.kd=normal(1,1,6)"),
            {},
            "different numbers of values",
        ),
        (("control.kp=1,2,3", "control.kd=4,5"), {"zipped": True}, "different numbers of values"),
        (tuple(f"{k}=1:2:1000" for k in ("control.kp", "control.kd", "control.ki")), {}, "many"),
    ],
)
def test_mistakes_are_found_before_anything_is_run(sets, options, word):
    with pytest.raises(UsageError, match=word):
        swept(*sets, **options)


# --- points -------------------------------------------------------------------------------------


def test_draws_are_joint_and_crossed_with_grids():
    found = points("control.kp=normal(5e4,1e3,10)", "control.ki=1,2", "control.kd=uniform(1,2,10)")
    assert len(found) == 20
    assert [p[::2] for p in found[:10]] == [p[::2] for p in found[10:]]
    assert {p[1] for p in found[:10]} == {1.0}


def test_a_latin_hypercube_hits_every_stratum_of_every_key_once():
    found = np.array(
        points("control.kd=uniform(0, 1, 40)", "control.kp=normal(9, 1, 40)", latin=True, seed=7)
    )
    shares = np.column_stack([found[:, 0], stats.norm.cdf(found[:, 1] - 9)])
    for each in shares.T:
        assert sorted(np.floor(40 * each)) == list(range(40))
    assert abs(np.corrcoef(shares.T)[0, 1]) < 0.5  # strata are paired at random, not in order


# --- runs --------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("sets", "netlists"),
    [
        (("control.kp=4e4:6e4:3", "control.kd=10:30:5"), 15),
        (("rom.order=20,30", "control.kd=10,20"), 4),
        (("param.pid.rail=12,15", "control.kd=10,20"), 2),
    ],
)
def test_parameters_of_subcircuits_share_a_netlist(sets, netlists):
    found = swept(*sets)
    assert found.run_counts == {"netlists": netlists, "ngspice": found.plan.size}
    assert f"{netlists} netlists, {found.plan.size} ngspice runs" in found.describe()


def test_a_proposal_concerns_its_own_key_among_equal_ranges():
    sets = [f"{key}=1e-3:2e-3:3" for key in ("sphere.radius", "impact.velocity")]
    with pytest.raises(UsageError, match="does not move towards the contact") as caught:
        make_sweep(SceneInput("impact", None), sets)
    assert caught.value.hint == "write --set impact.velocity=-1e-3:-2e-3:3"


# --- studies ------------------------------------------------------------------------------------


def test_a_user_study_is_a_file(tmp_path):
    path = tmp_path / "mine.toml"
    path.write_text('scene = "kick_and_catch"\nzip = true\n[set]\n"control.kd" = "10:20:3"\n')
    assert load_named_sweep(str(path)).plan.size == 3
    both = load_named_sweep(str(path), ["control.kp=1e4,2e4,3e4", "control.kd=1,2,3"])
    assert both.plan.values(1) == {"control.kd": 2.0, "control.kp": 2e4}
    path.write_text('scene = "kick_and_catch"\nsets = 3\n')
    with pytest.raises(UsageError, match="key of the study is not valid") as caught:
        load_named_sweep(str(path))
    assert "key sets" in caught.value.where
