"""Physics checks pass on a good run and see runs that are wrong in silence."""

import dataclasses

import numpy as np
import pytest
from device import built
from support import SimulationError, form_verdict, require_passed

BALANCES = {"sphere", "contact", "kick"}
ALL = {
    "rating of kick", "rating of catch", "reduction of kick",
    "table_left", "outer_ring", "penetration", "touches", "saturation",
    "kick_drive drives as defined", "control_enable drives as defined",
    "sphere starts at rest on kick", "time steps of kick compared with its exact response",
    "interpolation error of the force table of catch",
    *(f"energy of {part}" for part in BALANCES),
}  # fmt: skip


def judged(waves, scene, table, model):
    return form_verdict(waves, built(scene, model, table))


def violated(waves, scene, table, model):
    return [c.name for c in judged(waves, scene, table, model).checks if not c.passed]


def changed(waves, **data):
    return dataclasses.replace(waves, data=waves.data | data)


def test_results_have_the_names_and_signs_of_the_contract(loop, waves):
    """The motion itself is held against exact ones in benchmarks."""
    assert set(waves.data) == {"time", *loop.vectors}
    forces = sum(waves[f"contact.force.ring{k}"] for k in range(6))
    np.testing.assert_allclose(waves["contact.force"], forces, rtol=1e-12)
    edge = (waves["time"] > 500.02e-6) & (waves["time"] < 500.08e-6)
    # the clamped capacitance at least is charged through the anode: C dV/dt = 28 A
    assert waves["kick.current"][edge].mean() > 20.0
    assert waves["kick.voltage"].max() == pytest.approx(80.0)
    np.testing.assert_allclose(waves["control.error"], 2.5e-3 - waves["sphere.y"], atol=1e-8)
    lower, upper = waves["coil.lower.current"], waves["coil.upper.current"]
    np.testing.assert_allclose(lower, -upper, rtol=1e-12)
    late = waves["time"] > 4.5e-3  # caught and held
    weight = 4 / 3 * np.pi * 1e-9 * 7850.0 * 9.81 / 0.65  # N over N/A
    assert upper[late].mean() == pytest.approx(weight, rel=0.2)


def test_good_run_passes(waves, scene, table, model):
    found = judged(waves, scene, table, model)
    require_passed(found.checks, "here")
    value = {c.name: c.value for c in found.checks}
    assert set(value) == ALL
    assert all(c.passed for c in found.checks)
    assert value["energy of sphere"] < 2e-5
    assert value["energy of contact"] < 1e-4


def test_energy_without_a_source_is_detected(waves, scene, table, model):
    faster = waves["sphere.v"] + np.linspace(0, 0.05, waves["time"].size)
    assert "energy of sphere" in violated(
        changed(waves, **{"sphere.v": faster}), scene, table, model
    )


def test_energy_gained_in_the_contact_is_detected(waves, scene, table, model):
    """Contact that lets go later than it took hold does work; here by 100 nm."""
    y = waves["sphere.y"]
    moving = 1e-7 * (np.gradient(waves["kick.u.ring0"] - y, waves["time"]) < 0)
    found = violated(changed(waves, **{"sphere.y": y - moving}), scene, table, model)
    assert "energy of contact" in found


def test_a_wrong_current_into_the_chip_is_detected(waves, scene, table, model):
    more = changed(waves, **{"kick.current": 1.3 * waves["kick.current"]})
    assert violated(more, scene, table, model) == [
        "time steps of kick compared with its exact response", "energy of kick",
    ]  # fmt: skip


def test_ringing_without_a_cause_in_the_forces_is_reported(waves, scene, table, model):
    """A chip in contact moves as its exact answer to voltage and forces; beside it a warning."""
    wrong = changed(waves, **{"kick.u.ring0": 1.05 * waves["kick.u.ring0"]})
    check = next(c for c in judged(wrong, scene, table, model).checks
                 if c.name == "time steps of kick compared with its exact response")  # fmt: skip
    assert not check.passed
    assert not check.is_fatal
    assert check.value == pytest.approx(0.05, rel=0.1)


def test_contact_beyond_the_last_ring_is_detected(waves, scene, table, model):
    wide = changed(waves, **{"contact.force.ring5": np.full_like(waves["time"], 0.1)})
    with pytest.raises(SimulationError, match="outermost ring"):
        require_passed(judged(wide, scene, table, model).checks, "here")


def test_a_controller_at_its_limit_is_reported(waves, varied, table, model):
    weak = varied(**{"control.current_limit": 1e-6, "control.enable_at": 0.0})
    always = changed(waves, **{"coil.upper.current": np.full_like(waves["time"], 1e-6)})
    assert "saturation" in violated(always, weak, table, model)


@pytest.mark.parametrize(("action", "fails"), [("fail", True), ("warn", False), ("off", False)])
def test_a_key_selects_the_action_on_a_violation(action, fails, waves, varied, table, model):
    free = varied(**{"checks.energy": action})
    bad = changed(waves, **{"kick.current": 2 * waves["kick.current"]})
    checks = judged(bad, free, table, model).checks
    assert any(c.is_fatal for c in checks) == fails
    assert ("energy of kick" in {c.name for c in checks}) == (action != "off")


@pytest.mark.parametrize("kept", [1, 2, 3])
def test_a_missing_ring_that_would_close_is_detected(kept, waves, varied, table, model):
    """The same waveforms, as a run without the outer rings would leave them; ring1 closes."""
    fewer = varied(**{"contact.rings": kept})
    closed = [waves[f"contact.force.ring{k}"].max() > 0 for k in range(6)]
    assert closed == [True, True, False, False, False, False]
    found = judged(waves, fewer, table, model).checks
    (check,) = (c for c in found if c.name == "ring_left_out")
    assert check.passed is not closed[kept]
    if closed[kept]:
        with pytest.raises(SimulationError, match=rf"more than {kept}, or to 'all'"):
            require_passed((check,), "here")
