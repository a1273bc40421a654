"""An acceleration pin shakes the frame and draws what that takes, whatever the damping."""

import numpy as np
import pytest
from device import bench

from kc2spice.rom.linear import LinearModel, Port
from kc2spice.sim.ngspice import run_deck
from kc2spice.spice.realize import subcircuit

STIFF = 1e4 * np.array([1.6, 1.3, 1.0, 1.1, 1.8, 1.9])
MASS = 1e-3 * np.array([1.6, 1.7, 1.5, 1.9, 1.8, 1.0])


def chain(values):
    return np.diag(values + np.r_[values[1:], 0]) - np.diag(values[1:], 1) - np.diag(values[1:], -1)


@pytest.mark.parametrize("damper", [None, 0.3, 30.0])  # as the springs; one dashpot, one overdamped
@pytest.mark.parametrize("mass", [True, False])  # whether what moves with the frame is known
def test_reaction_and_motion_of_a_shaken_chain(damper, mass, tmp_path):
    """Against the forces of spring and dashpot on the frame and a rigid mass on it."""
    rigid = 2e-3 if mass else 0.0
    dashpots = 1e-5 * STIFF if damper is None else np.array([0, 0, damper, 0, 0, 0.05])
    K, E, M = chain(STIFF), chain(dashpots), np.diag(MASS)
    ports = (Port("tip", "mechanical"), Port("base", "acceleration"))
    facts = {"mass_kg": MASS.sum() + rigid} if mass else {}
    B = np.column_stack([np.eye(6)[-1], -MASS])
    part = subcircuit(LinearModel(M=M, E=E, K=K, B=B, ports=ports, facts=facts), "chain")
    cards = "Xc tip acc 0 chain\nVa acc 0 DC 0 AC 1\n.ac lin 60 20 1200"
    vectors = {"tip": ("v(tip)", 1e-6), "force": ("i(va)", -1.0)}
    waves = run_deck(bench([part], cards, vectors), tmp_path)
    for k, f in enumerate(waves["frequency"].real):
        w = 2 * np.pi * f
        x = np.linalg.solve(K + 1j * w * E - w**2 * M, -MASS)
        reaction = rigid - (STIFF[0] + 1j * w * dashpots[0]) * x[0]
        assert waves["tip"][k] == pytest.approx(x[-1], rel=1e-6)
        assert waves["force"][k] == pytest.approx(reaction, rel=1e-6, abs=1e-9)
