"""The netlist of a pressure under a sphere against its law: at rest, and where contact ends."""

import pytest
from device import models
from support import find_separation, make_deck, run_deck, solve_laws

KEYS = ("contact.shape=pressure", "kick.layers=3", "kick.height=150 um")


@pytest.fixture
def solved(request, tmp_path):
    """Waves of ngspice, and the laws at the same points."""
    scene, *keys = request.param
    build = models(scene, *KEYS, *keys)
    waves = run_deck(make_deck(build), tmp_path)
    return waves, solve_laws(build, waves)


@pytest.mark.parametrize("solved", [("imprint", "imprint.depth=8 um", "imprint.steps=40")],
                         indirect=True)  # fmt: skip
def test_the_force_at_rest_equals_the_force_of_the_law(solved):
    found, exact = (waves["contact.force"][1:] for waves in (solved[0], solved[1].results))
    assert found == pytest.approx(exact, rel=1e-11)


@pytest.mark.parametrize("solved", [("impact",)], indirect=True)
def test_contact_ends_at_the_limit_of_the_law(solved):
    """The force ends while the surfaces still overlap by pace times their speed, 12 nm."""
    (time, speed), (exact_time, exact_speed) = (
        find_separation(w["time"], w["contact.force"], w["sphere.v"])
        for w in (solved[0], solved[1].results)
    )
    assert time == pytest.approx(exact_time, abs=5e-10)
    assert speed == pytest.approx(exact_speed, rel=4e-5)
    assert solved[1].imbalance < 2e-11  # where a dent begins and ends included
