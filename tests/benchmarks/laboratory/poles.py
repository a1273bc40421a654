"""Part ``poles``: what a projection loses that does not eliminate the potentials first."""

from __future__ import annotations

import numpy as np

from kc2spice.rom.modal import resonators
from laboratory.fullmodel import full_system
from laboratory.naive import naive_poles
from laboratory.points import Outcome
from laboratory.setup import Setup


def poles(setup: Setup) -> Outcome:
    """Poles [1/s] of both projections of the scene ``harmonic`` at one order."""
    scene = setup.scene("harmonic")
    modal = resonators(setup.build(scene).model("kick"))
    root = np.sqrt((modal.damp / 2) ** 2 - modal.omega**2 + 0j)
    shipped = np.concatenate([-modal.damp / 2 + root, -modal.damp / 2 - root])
    naive = naive_poles(full_system(scene), modal.order)
    return Outcome(poles={"projected as one": naive, "potentials eliminated first": shipped})
