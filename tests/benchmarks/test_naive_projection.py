"""Negative control: the projection that does not eliminate the potentials first is unstable."""

import pytest

from kc2spice.fem.piezo.assembly import assemble_kick
from kc2spice.rom.modal import resonators
from kc2spice.rom.reduce import reduce_condensed
from kc2spice.rom.schur import condense
from kc2spice.scene.schema import Kick, Rom
from laboratory.naive import naive_poles


@pytest.mark.parametrize(
    "kick",
    [
        Kick(),
        Kick(
            layers=5,
            mesh={
                "refine": 2, "sectors": 4, "rings": 2, "ring_spacing": 300e-6, "outer_rings": 2,
            },
        ),
    ],
)  # fmt: skip
def test_projection_is_unstable_unless_potentials_are_eliminated_first(kick):
    system = assemble_kick(kick)
    assert naive_poles(system, 30).real.max() > 1e6
    model = resonators(reduce_condensed(condense(system), Rom(order=30)))
    assert model.damp.min() > 0
