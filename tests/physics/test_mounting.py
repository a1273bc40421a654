"""Mounting of the bottom face of the chip: closed-form limits, and values of the usual chip."""

import numpy as np
import pytest
from support import StackKeys, StackMeshKeys, UsageError, load_scene, make_stack, make_stack_setup

MESH = StackMeshKeys(sectors=4, rings=2, outer_rings=4)


def chip(mounting, layers=4):
    return StackKeys(mounting=mounting, layers=layers, mesh=MESH)


@pytest.mark.parametrize("order", [1, 2])
def test_springs_cover_the_bottom_face_and_nothing_else(order):
    solid, setup = make_stack_setup(
        chip(1.0).model_copy(update={"mesh": MESH.model_copy(update={"order": order})})
    )
    springs = setup.springs
    for axis in range(3):
        shift = np.zeros(springs.shape[0])
        shift[axis::3] = 1.0
        assert shift @ springs @ shift == pytest.approx(1.5e-3**2, rel=1e-9)  # of the quarter
    z = solid.basis().doflocs[2]
    assert abs(springs[np.repeat(z > 0, 3)]).max() < 1e-12 * abs(springs).max()


def test_on_soft_springs_the_chip_swings_as_a_mass():
    stiffness = 1e10
    facts = make_stack(chip(stiffness)).model.facts
    own = np.sqrt(stiffness * 9e-6 / (7700 * 3e-3**2 * 2e-3)) / (2 * np.pi)
    assert facts["resonance_short_hz"] == pytest.approx(own, rel=2e-4)
    # nothing clamps it: it lengthens by d33 a layer, as on a frictionless roller
    roller = make_stack(chip("roller")).model.facts
    stroke = "free_stroke_ring0_m_per_100v"
    assert facts[stroke] == pytest.approx(roller[stroke], rel=1e-3)


def test_on_stiff_springs_the_chip_is_glued():
    stiff, glued = (make_stack(chip(each)).model.facts for each in (1e18, "glued"))
    for name in ("free_stroke_ring0_m_per_100v", "capacitance_free_f", "resonance_short_hz"):
        assert stiff[name] == pytest.approx(glued[name], rel=1e-4)


def test_a_free_chip_moves_as_a_whole():
    device = make_stack(chip("free"))
    M, K, up = device.model.M, device.model.K, np.zeros(device.displacement.shape[0])
    up[2::3] = 1.0
    shift = device.displacement.T @ up
    np.testing.assert_array_equal(device.displacement @ shift, up)  # nothing holds it
    assert np.abs(K @ shift).max() < 1e-6 * abs(K).max()
    assert shift @ M @ shift == pytest.approx(7700 * 3e-3**2 * 2e-3, rel=1e-9)


@pytest.mark.slow
def test_the_usual_chip_glued_down():
    """Stroke and resonance as on the paper's mesh; the roller's are 2.351 um and 270 kHz."""
    facts = make_stack(StackKeys(mounting="glued")).model.facts
    assert facts["free_stroke_ring0_m_per_100v"] == pytest.approx(1.983e-6, abs=0.5e-9)
    assert facts["resonance_short_hz"] == pytest.approx(308e3, abs=0.5e3)


@pytest.mark.parametrize("mounting", ["nailed", 0.0, -1.0, "1 N/m"])
def test_other_mountings_are_refused(mounting):
    with pytest.raises(UsageError, match="this mounting does not exist"):
        load_scene("kick_and_catch", {"kick.mounting": mounting})


def test_a_free_chip_does_not_support_a_sphere():
    with pytest.raises(UsageError, match="mounting of the chip is free"):
        load_scene("kick_and_catch", {"kick.mounting": "free"})
