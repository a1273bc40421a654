"""The grammar of ranges: exact values, units, draws, and one clear error for everything else."""

import numpy as np
import pytest
from scipy import stats

from kc2spice.core.errors import UsageError
from kc2spice.scene.keys import keys_of
from kc2spice.scene.load import load_scene
from kc2spice.workflow.sweep import plan as plans
from kc2spice.workflow.sweep.plan import (
    Grid,
    Random,
    first_value,
    make_plan,
    overrides,
    parameters,
)

KEYS = keys_of(load_scene("kick_and_catch"))


def parse(text):
    return plans.parse(text, KEYS)


def test_linear_range_has_both_ends():
    found = parse("kick.drive.voltage=80:120:5")
    assert found == Grid("kick.drive.voltage", (80.0, 90.0, 100.0, 110.0, 120.0))


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("control.setpoint=2 mm:3 mm:3", (2e-3, 2.5e-3, 3e-3)),
        ("control.setpoint=2e-3,2.5 mm, 3000 um", (2e-3, 2.5e-3, 3e-3)),
        ("control.ki=10 A/(m s),20 A/(m s)", (10.0, 20.0)),
        ("kick.damping.ratio=1 %:3 %:2", (0.01, 0.03)),
        ("rom.order=20:40:3", (20, 30, 40)),
        ("catch.polarity=parallel,antiparallel", ("parallel", "antiparallel")),
        ("param.pid.rail=12:15:2", (12.0, 15.0)),
    ],
)
def test_values_in_si(text, values):
    found = parse(text)
    assert isinstance(found, Grid)
    assert found.values == values


def test_logarithmic_range_has_equal_ratios_and_exact_ends():
    found = parse("contact.penalty=log:1e6:1e10:5")
    assert found.values == pytest.approx((1e6, 1e7, 1e8, 1e9, 1e10), rel=1e-12)
    assert (found.values[0], found.values[-1]) == (1e6, 1e10)


@pytest.mark.parametrize(
    "text",
    [
        "control.kd=20",
        "control.kd=25 A s/m",
        "rom.band=[0, 5e5]",
        'control.ki="10 A/(m s)"',
        "catch.polarity=antiparallel",
    ],
)
def test_one_value_is_no_range(text):
    assert first_value(text) is None


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
        "catch.polarity=1:2:3",
        "control.kdd=1:2:3",
        "param.pid=1:2:3",
    ],
)
def test_bad_ranges_name_the_option(text):
    with pytest.raises(UsageError) as caught:
        parse(text)
    assert caught.value.exit_code == 2
    assert "--set" in str(caught.value.where)


def test_overrides_keep_every_bit():
    keys = ("control.kd", "param.pid.rail", "rom.order")
    values = (0.1 + 0.2, 12.5, 30)
    texts = overrides(keys, values)
    assert texts == ("control.kd=0.30000000000000004", "rom.order=30")
    assert parameters(keys, values) == (("pid.rail", 12.5),)


def draws(text, **options):
    plan = make_plan([parse(text)], **options)
    return np.array([plan.values(i)[0] for i in range(plan.size)])


def test_draws_follow_their_distribution():
    # Kolmogorov-Smirnov against scipy's own distributions; 2000 draws, fixed seed.
    normal = draws("control.kd=normal(20, 2, 2000)", seed=3)
    uniform = draws("control.kd=uniform(10, 30, 2000)", seed=3)
    assert stats.kstest(normal, stats.norm(20, 2).cdf).pvalue > 0.01
    assert stats.kstest(uniform, stats.uniform(10, 20).cdf).pvalue > 0.01


def test_seed_decides_the_draws():
    text = "control.kd=normal(20, 2, 50)"
    assert np.array_equal(draws(text, seed=1), draws(text, seed=1))
    assert not np.array_equal(draws(text, seed=1), draws(text, seed=2))


def test_latin_hypercube_hits_every_stratum_of_every_key_once():
    plan = make_plan(
        [Random("control.kd", "uniform", 0.0, 1.0, 40), Random("control.kp", "normal", 0, 1, 40)],
        latin=True,
        seed=7,
    )
    points = np.array([plan.values(i) for i in range(plan.size)])
    shares = np.column_stack([points[:, 0], stats.norm.cdf(points[:, 1])])
    for column in shares.T:
        assert sorted(np.floor(40 * column)) == list(range(40))
    assert abs(np.corrcoef(shares.T)[0, 1]) < 0.5  # strata are paired at random, not in order
